"""The folders of plans, walks and tours, verified: certified anew, and computed a second time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cmbot.archive.folder import read_folder, without_hashes
from cmbot.archive.names import PLAN_FILE, TOUR_FILE, WALK_FILE
from cmbot.archive.reading import load_plan
from cmbot.archive.walks import load_walk
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, LimitViolation
from cmbot.common.validation import FileModel, given_path, validated
from cmbot.planning import Check, Plan
from cmbot.siting import Candidate, in_world
from cmbot.walking import Walk, second_opinion_of, stance_of

__all__ = ["VerifiedMotion", "verified_motions"]

# Figures, and stances and postures of parts that follow on each other, are the same but for so much.
_SAME = 1e-6


@dataclass(frozen=True, kw_only=True)
class VerifiedMotion:
    """A motion whose checks all hold.

    Attributes
    ----------
    part : str
        Of a tour, such as ``work_1``; otherwise empty.
    name : str
        Such as ``approach``.
    seconds : float
    checks : tuple of Check
        Of its certificate, and of a second computation.
    """

    part: str
    name: str
    seconds: float
    checks: tuple[Check, ...]


class _PartFile(FileModel):
    name: Annotated[str, Field(pattern=r"^(work|walk)_[1-9]\d{0,3}$")]
    kind: Literal["work", "walk"]
    begin: float
    seconds: float
    adhesion_needed: float | None
    strokes: tuple[str, ...] | None = None
    peak_torque: float | None = None
    peak_torque_at_work: float | None = None
    steps: int | None = None


class _TourFile(FileModel):
    format: Literal["cmbot-tour/1"]
    cmbot: str
    seconds: float
    parts: Annotated[tuple[_PartFile, ...], Field(min_length=1, max_length=1000)]
    words: tuple[str, ...]


def verified_motions(directory: str | Path) -> tuple[VerifiedMotion, ...]:
    """Verify the folder of a plan, a walk or a tour; return its motions.

    Raises
    ------
    InputError
        When `directory` is no path.
    ArchiveError
        When a file is missing, damaged or contradicts the others, or a motion breaks a promise.
    SceneError, ModelError
        When its scene or its robot cannot be used.
    """
    folder = given_path(directory, "cmbot verify", "DIR", "the path of a folder")
    if (folder / TOUR_FILE).exists():
        return tuple(_tour(folder))
    return tuple(_verified(folder)[1])


def _verified(folder: Path, name: str = "") -> tuple[Plan | Walk, list[VerifiedMotion]]:
    """A plan or a walk, and its motions; `name` is that of a part of a tour."""
    is_walk = (folder / WALK_FILE).exists()
    try:
        part = load_walk(folder) if is_walk else load_plan(folder, verify=True)
        return part, list(_motions(name, part))
    except LimitViolation as error:
        raise _broken(folder / (WALK_FILE if is_walk else PLAN_FILE), error) from error


def _broken(file: Path, error: LimitViolation) -> ArchiveError:
    got = f"{error.value:.6g} {error.unit} at t = {error.time:.3f} s"
    return ArchiveError(str(file), error.quantity, got, f"a value within {error.bound:.6g} {error.unit}")


def _motions(name: str, part: Plan | Walk) -> Iterator[VerifiedMotion]:
    if isinstance(part, Plan):
        for segment in part.job.segments:
            checks, seconds = segment.certificate.checks, segment.duration
            yield VerifiedMotion(part=name, name=segment.name, seconds=seconds, checks=checks)
        return
    scene = in_world(part.scene)
    for number, move in enumerate(part.moves, start=1):
        known, seconds = move.segment.certificate, move.segment.duration
        certificate = replace(known, checks=(*known.checks, *second_opinion_of(move, scene)))
        certificate.require()
        title = f"{move.kind}_{number}"
        yield VerifiedMotion(part=name, name=title, seconds=seconds, checks=certificate.checks)


def _tour(folder: Path) -> Iterator[VerifiedMotion]:
    """Verify the parts, and that each begins where the one before ends."""
    source = folder / TOUR_FILE
    data, _ = read_folder(
        folder, TOUR_FILE, lambda hashes: [name for name in hashes if (folder / name).exists()]
    )
    file = validated(_TourFile, without_hashes(data), str(source), ArchiveError)
    clock, here = 0.0, None
    for k, entry in enumerate(file.parts):
        part, motions = _verified(folder / entry.name, entry.name)
        yield from motions
        is_plan, seconds = isinstance(part, Plan), sum(motion.seconds for motion in motions)
        key, stance, posture = f"parts[{k}]", stance_of(part.scene), np.array(part.scene.posture)
        if is_plan != (entry.kind == "work"):
            raise ArchiveError(str(source), f"{key}.kind", entry.kind, "work" if is_plan else "walk")
        if here is not None and not np.allclose(_place(stance, posture), here, rtol=0, atol=_SAME):
            got = f"{entry.name}: another stance or posture"
            raise ArchiveError(str(source), f"{key}.name", got, "that in which the part before ends")
        for name, read, found in (("begin", entry.begin, clock), ("seconds", entry.seconds, seconds)):
            _require_same(source, f"{key}.{name}", read, found)
        clock += seconds
        if isinstance(part, Plan):
            here = _place(stance, part.job.trajectory.q[-1])
        else:
            arms = [move.segment.trajectory.q[-1] for move in part.moves if move.kind == "arm"]
            here = _place(part.goal, [posture, *arms][-1])
    _require_same(source, "seconds", file.seconds, clock)


def _require_same(source: Path, key: str, read: float, found: float) -> None:
    if not np.isclose(read, found, rtol=_SAME, atol=_SAME):
        raise ArchiveError(str(source), key, f"{read:g}", f"{found:g}, as its parts say")


def _place(stance: Candidate, posture: FloatArray) -> FloatArray:
    """Pose of foot 1, angles of the climber and posture of the arm, in a row."""
    return np.concatenate([stance.root.ravel(), stance.climber, posture])
