"""The folders of plans, walks and tours, verified: certified anew, and computed a second time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cmbot.archive.folder import read_file, read_folder, without_hashes
from cmbot.archive.names import PLAN_FILE, TOUR_FILE, WALK_FILE
from cmbot.archive.reading import read_plan
from cmbot.archive.tables import require_table
from cmbot.archive.verification.asked import looser_promises, require_asked
from cmbot.archive.walks import load_walk
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, InputError, LimitViolation
from cmbot.common.validation import FileModel, given_path, validated
from cmbot.planning import Check, Plan
from cmbot.scene import Scene, StanceFile
from cmbot.stances import Candidate, in_world
from cmbot.stances.walking import Walk, WalkOptions, goal_stance, second_opinion_of, stance_of, walk_csv

# Figures, and stances and postures of parts that follow on each other, are the same but for so much.
_SAME = 1e-6
_WALK_TABLE = "walk.csv"


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


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What was verified of a folder, and what was not.

    Attributes
    ----------
    looser : tuple of str
        What its plans promise less, or otherwise, than the scenes in them ask for.
    motions : tuple of VerifiedMotion
    not_verified : tuple of str
        What it says that was not computed again: keys of records, and names of files.
    """

    looser: tuple[str, ...]
    motions: tuple[VerifiedMotion, ...]
    not_verified: tuple[str, ...]


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


def verified_motions(
    directory: str | Path, scene: Scene | None = None, goal: Scene | StanceFile | None = None
) -> Verdict:
    """Verify the folder of a plan, a walk or a tour.

    Parameters
    ----------
    directory : str or Path
    scene : Scene, optional
        That was asked for: the folder has to be a plan, or a walk, of it.
    goal : Scene or StanceFile, optional
        Where the walk was to end.

    Raises
    ------
    InputError
        When `directory` is no path, a tour is to be of one scene, or a goal is given for no walk.
    ArchiveError
        When a file is missing, damaged or contradicts the others, a motion breaks a promise, or it is not
        what was asked for.
    SceneError, ModelError
        When its scene or its robot cannot be used.
    """
    folder = given_path(directory, "cmbot verify", "DIR", "the path of a folder")
    if len(records := [name for name in (PLAN_FILE, WALK_FILE, TOUR_FILE) if (folder / name).exists()]) > 1:
        raise ArchiveError(str(folder), "", " and ".join(records), "one of them: the folder of one thing")
    if goal is not None and not (folder / WALK_FILE).exists():
        raise InputError("cmbot verify", "--to", str(folder), "the folder of a walk, which has a goal")
    if not (folder / TOUR_FILE).exists():
        return _verified(folder, "", scene, goal)[1]
    if scene is not None:
        raise InputError("cmbot verify", "--scene", "a tour", "a plan or a walk, such as a part of it")
    return _together(_tour(folder))


def _together(verdicts: Iterable[Verdict]) -> Verdict:
    each = tuple(verdicts)
    names = [field.name for field in fields(Verdict)]
    return Verdict(**{name: tuple(chain.from_iterable(getattr(one, name) for one in each)) for name in names})


def _verified(
    folder: Path, name: str = "", scene: Scene | None = None, goal: Scene | StanceFile | None = None
) -> tuple[Plan | Walk, Verdict]:
    """A plan or a walk, and what was verified of it; `name` is that of a part of a tour."""
    is_walk = (folder / WALK_FILE).exists()
    part: Plan | Walk
    looser, skipped = tuple[str, ...](), tuple[str, ...]()
    try:
        if is_walk:
            part = load_walk(folder)
            if part.speed > (usual := WalkOptions().speed):
                looser = (f"max_foot_speed {part.speed:g} m/s (where none is asked {usual:g})",)
            skipped = _walk_files(folder, part)
            if scene is not None:
                require_asked(part.scene, scene, str(folder / WALK_FILE))
            if goal is not None:
                _require_goal(part, goal, str(folder / WALK_FILE))
        else:
            part, skipped = read_plan(folder, verify=True, asked=scene)
            looser = looser_promises(part.options, part.scene.planner)
            skipped = (*_claims(part), *skipped)
        motions = tuple(_motions(name, part))
    except LimitViolation as error:
        raise _broken(folder / (WALK_FILE if is_walk else PLAN_FILE), error) from error
    said = (tuple(f"{name}: {text}" if name else text for text in texts) for texts in (looser, skipped))
    return part, Verdict(motions=motions, **dict(zip(("looser", "not_verified"), said, strict=True)))


def _walk_files(folder: Path, walk: Walk) -> tuple[str, ...]:
    """Compare the table of a walk with its knots; return the names of the other files."""
    names = [path.name for path in sorted(folder.iterdir()) if path.name != WALK_FILE and path.name[0] != "."]
    if _WALK_TABLE in names:
        table = folder / _WALK_TABLE
        require_table(read_file(table), walk_csv(walk).encode(), str(table))
    return tuple(name for name in names if name != _WALK_TABLE)


def _claims(plan: Plan) -> Iterator[str]:
    """The keys of plan.json whose values only planning anew could confirm."""
    if plan.baseline is not None:
        yield "baseline (that it is the motion it is compared with)"
    if plan.torque_floor is not None:
        yield f"torque_floor ({plan.torque_floor:.6g} Nm, {plan.torque_floor_kind}), gap_to_floor"
    for name in ("lower_bound", "choice", "suppression", "compensation"):
        if any(getattr(stroke, name) is not None for stroke in plan.strokes):
            yield name.replace("lower_bound", "floor")
    for name, coverage in plan.coverage.items():
        if coverage.left_out or coverage.unreached:
            yield f"raster {name} (that nothing reaches the rows that it leaves out)"
    yield "passes, fallbacks, seconds, versions"


def _require_goal(walk: Walk, goal: Scene | StanceFile, source: str) -> None:
    """Refuse a walk that ends in another stance than it was to."""
    posture = _arm_at_end(walk)
    wanted = _place(
        goal_stance(goal, walk.scene), np.array(goal.posture) if isinstance(goal, Scene) else posture
    )
    if not np.allclose(_place(walk.goal, posture), wanted, rtol=0, atol=_SAME):
        raise ArchiveError(source, "goal", "another stance or posture", "that which was asked for")


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


def _tour(folder: Path) -> Iterator[Verdict]:
    """Verify the parts, and that each begins where the one before ends."""
    source = folder / TOUR_FILE
    data, _ = read_folder(
        folder, TOUR_FILE, lambda hashes: [name for name in hashes if (folder / name).exists()]
    )
    file = validated(_TourFile, without_hashes(data), str(source), ArchiveError)
    clock, here = 0.0, None
    for k, entry in enumerate(file.parts):
        part, verdict = _verified(folder / entry.name, entry.name)
        yield verdict
        is_plan, seconds = isinstance(part, Plan), sum(motion.seconds for motion in verdict.motions)
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
            here = _place(part.goal, _arm_at_end(part))
    _require_same(source, "seconds", file.seconds, clock)


def _require_same(source: Path, key: str, read: float, found: float) -> None:
    if not np.isclose(read, found, rtol=_SAME, atol=_SAME):
        raise ArchiveError(str(source), key, f"{read:g}", f"{found:g}, as its parts say")


def _arm_at_end(walk: Walk) -> FloatArray:
    arms = [move.segment.trajectory.q[-1] for move in walk.moves if move.kind == "arm"]
    return np.asarray(arms[-1] if arms else walk.scene.posture)


def _place(stance: Candidate, posture: FloatArray) -> FloatArray:
    """Pose of foot 1, angles of the climber and posture of the arm, in a row."""
    return np.concatenate([stance.root.ravel(), stance.climber, posture])
