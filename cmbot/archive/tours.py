"""A tour from its folder: work and walks, each beginning where the one before ends, on one bridge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from cmbot.archive.consistency import Entry, require_same
from cmbot.archive.folder import read_folder
from cmbot.archive.names import PLAN_FILE, TOUR_FILE, WALK_FILE
from cmbot.archive.reading import load_plan
from cmbot.archive.walks import load_walk
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.common.representation import short_repr
from cmbot.common.validation import given_path, validated
from cmbot.planning import Plan
from cmbot.scene import Scene
from cmbot.stances import Candidate
from cmbot.stances.walking import Walk, part_data, stance_of

# Figures, stances and postures are the same but for so much.
_SAME = 1e-6
# What scenes of one bridge differ in: the work in each stance.
_OWN = ("name", "start", "tool_path")


@dataclass(frozen=True, kw_only=True, eq=False)
class TourPart:
    """Work from a stance, or a walk to the next one.

    Attributes
    ----------
    name : str
        ``work_1``, ``walk_1`` and so on: the folder of the part.
    begin : float, s
        On the clock of the tour.
    motion : Plan or Walk
    """

    name: str
    begin: float
    motion: Plan | Walk

    __repr__ = short_repr


class _PartFile(Entry):
    name: Annotated[str, Field(pattern=r"^(work|walk)_[1-9]\d{0,3}$")]


class _TourFile(Entry):
    seconds: float
    parts: Annotated[tuple[_PartFile, ...], Field(min_length=1, max_length=1000)]


def load_tour(directory: str | Path, *, verify: bool = False) -> tuple[TourPart, ...]:
    """Read the tour of a folder that ``cmbot tour`` wrote.

    Each part has to begin in the stance and the posture in which the one before ends, on the same bridge; the
    motions of walks are certified again, and what the file says of a part has to be what is found.

    Parameters
    ----------
    directory : str or Path
    verify : bool
        Certify the work again, too, as `load_plan` does.

    Raises
    ------
    InputError
        When `directory` is no path.
    ArchiveError
        When a file is missing, damaged, of another version, or contradicts the others.
    SceneError
        When a scene is none.
    LimitViolation
        When a motion breaks a promise.

    Examples
    --------
    >>> parts = cmbot.load_tour("out/two_brackets_tour")  # doctest: +SKIP
    """
    folder = given_path(directory, "cmbot.load_tour", "directory", "the path of a folder")

    def read(part: Path) -> Plan | Walk:
        return load_walk(part) if (part / WALK_FILE).exists() else load_plan(part, verify=verify)

    return read_tour(folder, read)


def read_tour(folder: Path, read: Callable[[Path], Plan | Walk]) -> tuple[TourPart, ...]:
    """Return the parts of a tour, each of which is read by `read` from its folder, as `load_tour` does."""
    source = str(folder / TOUR_FILE)
    data, _ = read_folder(
        folder, TOUR_FILE, lambda hashes: [name for name in hashes if (folder / name).exists()]
    )
    file = validated(_TourFile, data, source, ArchiveError)
    clock, here, parts = 0.0, None, list[TourPart]()
    for k, entry in enumerate(file.parts):
        part, key = TourPart(name=entry.name, begin=clock, motion=read(folder / entry.name)), f"parts[{k}]"
        found = part_data(part.name, clock, part.motion)
        require_same(data["parts"][k], found, source, key, _SAME, _SAME, "its folder says")
        begins, ends = ends_of(part.motion)
        if here is not None and not np.allclose(begins, here, rtol=0, atol=_SAME):
            got = f"{entry.name}: another stance or posture"
            raise ArchiveError(source, f"{key}.name", got, "that in which the part before ends")
        parts.append(part)
        first, record = parts[0], PLAN_FILE if isinstance(part.motion, Plan) else WALK_FILE
        own, common = bridge_of(part.motion.scene), bridge_of(first.motion.scene)
        require_same(own, common, str(folder / entry.name / record), "scene", why=f"in {first.name}")
        clock, here = clock + found["seconds"], ends
    require_same(file.seconds, clock, source, "seconds", _SAME, _SAME, "its parts say")
    return tuple(parts)


def bridge_of(scene: Scene) -> dict[str, Any]:
    """Return what a scene says beside its work and where the robot is, ready for JSON."""
    data = {name: value for name, value in scene.as_data().items() if name not in _OWN}
    if "guardrail" in data:
        data["guardrail"] = {name: value for name, value in data["guardrail"].items() if name != "stance"}
    return data


def ends_of(part: Plan | Walk) -> tuple[FloatArray, FloatArray]:
    """Return where a plan or a walk begins and ends: foot 1, climber and arm, in a row each."""
    stance, posture = stance_of(part.scene), np.array(part.scene.posture)
    begin = place(stance, posture)
    if isinstance(part, Plan):
        return begin, place(stance, part.job.trajectory.q[-1])
    arms = [move.segment.trajectory.q[-1] for move in part.moves if move.kind == "arm"]
    return begin, place(part.goal, arms[-1] if arms else posture)


def place(stance: Candidate, posture: FloatArray) -> FloatArray:
    """Pose of foot 1, angles of the climber and posture of the arm, in a row."""
    return np.concatenate([stance.root.ravel(), stance.climber, posture])
