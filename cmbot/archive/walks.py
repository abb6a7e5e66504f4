"""Walks and tours from their files: read strictly, every motion of walks certified again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from cmbot.archive.folder import read_folder
from cmbot.archive.reading import load_plan
from cmbot.archive.records import PLAN_FILE, TOUR_FILE, WALK_FILE, Entry, require_same
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.reading.validation import FileModel, given_path, shown, validated
from cmbot.common.representation import ShortRepr
from cmbot.planning import Plan
from cmbot.robot import ARM_JOINTS, Climber, Side, other_foot
from cmbot.scene import LIFT_M, Scene, StanceFile, foothold_pose
from cmbot.stances import Candidate, candidate_at, in_world
from cmbot.stances.walking import (
    Kind,
    Move,
    Step,
    Walk,
    blocked_end,
    certified_move,
    part_data,
    stance_of,
    walk_data,
)
from cmbot.trajectory import QuinticTrajectory

# Moves join where they are nearer, rad; feet are where they should be, m; figures that are computed again.
_SAME_POSTURE, _SAME_PLACE, _SAME, _SAME_ZERO = 1e-9, 1e-6, 1e-6, 1e-9
# Near its place a foot's shapes do not count: there it goes along the normal, aside by so much at most, m and
# as a share of its height; samples at which that is looked at.
_ASIDE, _ASLANT, _SAMPLES = 1e-4, 0.002, 300
# Points of a foot in its frame, m: the middle of its plate, and about its corners.
_PLATE = np.array([[0.0, 0.0, 0.0], *([x, 0.0, z] for x in (-0.065, 0.065) for z in (-0.075, 0.075))])


class _MoveFile(Entry):
    kind: Kind
    holds: tuple[Side, ...]
    arm: Annotated[tuple[float, ...], Field(min_length=len(ARM_JOINTS), max_length=len(ARM_JOINTS))]
    knots: QuinticTrajectory


class _StepFile(Entry):
    foot: Side
    before: StanceFile
    after: StanceFile
    moves: Annotated[tuple[_MoveFile, ...], Field(min_length=1)]


class _WalkFile(Entry):
    scene: Scene
    goal: StanceFile
    max_foot_speed: Annotated[float, Field(gt=0)]
    steps: Annotated[tuple[_StepFile, ...], Field(min_length=1)]
    last: _MoveFile | None
    failures: tuple[str, ...]


def load_walk(directory: str | Path) -> Walk:
    """Read the walk of a folder that ``cmbot walk`` wrote, or part of a tour.

    The steps have to lead from stance to stance without a jump, and every motion is certified again: what the
    file says of it has to be what is found.

    Parameters
    ----------
    directory : str or Path

    Raises
    ------
    InputError
        When `directory` is no path.
    ArchiveError
        When the file is missing, damaged, of another version, or contradicts itself or what is computed
        again.
    SceneError
        When its scene is none.
    LimitViolation
        When a motion breaks a promise.

    Examples
    --------
    >>> steps = cmbot.load_walk("out/walk")  # doctest: +SKIP
    """
    folder = given_path(directory, "cmbot.load_walk", "directory", "the path of a folder")
    path, (data, _) = folder / WALK_FILE, read_folder(folder, WALK_FILE, lambda hashes: ())
    file = validated(_WalkFile, data, str(path), ArchiveError)
    scene = file.scene.with_source(str(path))
    reader = _Reader(str(path), scene, file.max_foot_speed)
    steps = tuple(reader.step(step, f"steps[{k}]") for k, step in enumerate(file.steps))
    goal = reader.node(file.goal, "goal")
    reader.require_stance(goal, "goal")
    last = None if file.last is None else reader.move(file.last, "last", "arm")
    failures, speed = file.failures, file.max_foot_speed
    walk = Walk(scene=scene, goal=goal, steps=steps, last=last, failures=failures, speed=speed)
    again = walk_data(walk) | {name: data.get(name) for name in ("scene", "cmbot")}
    require_same(data, again, str(path), "", _SAME, _SAME_ZERO)
    return walk


@dataclass
class _Reader:
    """Follows a walk from move to move."""

    source: str
    scene: Scene
    speed: float

    def __post_init__(self) -> None:
        self._world, self._climber = in_world(self.scene), Climber()
        self._here = stance_of(self.scene)
        self._arm, self._angles = np.array(self.scene.posture), self._here.climber

    def node(self, file: StanceFile, key: str) -> Candidate:
        """The stance of an entry; the climber has to reach both feet."""
        if file.climber_deg is None:
            raise self._error(f"{key}.climber_deg", "nothing", "five angles")
        try:
            # How its feet hold is judged with every move.
            self.scene.guardrail.changed(hold=None, stance=file)
        except InputError as error:
            where = error.key.replace("stance", key, 1)
            raise ArchiveError(self.source, where, error.got, error.expected, error.choices) from error
        poses = [foothold_pose(self.scene.elastic_guardrail, place) for place in file.held]
        node = candidate_at(*file.places, poses[0], np.radians(file.climber_deg), self._climber)
        reached = node.root @ self._climber.poses(node.climber)[0]
        if len(poses) > 1 and np.abs(reached - poses[1]).max() > _SAME_PLACE:
            raise self._error(f"{key}.climber_deg", "other angles", "those that put foot 2 in its place")
        return node

    def require_stance(self, node: Candidate, key: str) -> None:
        """The walk has to be in a stance."""
        away = max(np.abs(node.root - self._here.root).max(), np.abs(node.climber - self._angles).max())
        if away > _SAME_PLACE:
            raise self._error(key, "another stance", "that in which the walk is then")

    def step(self, file: _StepFile, key: str) -> Step:
        before, after = self.node(file.before, f"{key}.before"), self.node(file.after, f"{key}.after")
        self.require_stance(before, f"{key}.before")
        self._here = before
        holds = other_foot(file.foot)
        places = [node.stance.places[file.foot - 1] for node in (before, after)]
        # A foot that is free is neither lifted nor set; while one is off, the arm is still.
        order = [kind for kind, place in zip(("lift", "set"), places, strict=True) if place is not None]
        order.insert("lift" in order, "swing")
        kinds = [entry.kind for entry in file.moves]
        if kinds[kinds.count("arm") :] != order or set(kinds[: -len(order)]) > {"arm"}:
            expected = f"moves of the arm, if any, then {', '.join(order)}"
            raise self._error(f"{key}.moves", ", ".join(kinds), expected)
        if (blocked := blocked_end(self._world, before, after, file.foot)) is not None:
            end, other = blocked
            raise self._error(f"{key}.{end}.foot_{file.foot}", f"a place beside {other}", "a free one")
        moves = list[Move]()
        for k, entry in enumerate(file.moves):
            kind: Kind | None = "arm" if entry.kind == "arm" else None
            if kind is None and entry.holds != (holds,):
                raise self._error(f"{key}.moves[{k}].holds", shown(list(entry.holds)), f"[{holds}]")
            moves.append(self.move(entry, f"{key}.moves[{k}]", kind))
            if entry.kind in ("lift", "set"):
                self._require_straight(moves[-1], f"{key}.moves[{k}].knots")
        stays = [node.foot_pose(holds) for node in (before, after)]
        if np.abs(stays[0] - stays[1]).max() > _SAME_PLACE:
            raise self._error(f"{key}.after", "another place", f"foot {holds} where it holds")
        self._here = after
        self.require_stance(after, f"{key}.after")
        return Step(foot=file.foot, before=before, after=after, moves=tuple(moves))

    def _require_straight(self, move: Move, key: str) -> None:
        """A foot has to leave its place along the face's normal, ever further, or to come there so.

        Only there its own shapes do not count, so it may go no further than a foot is lifted.
        """
        trajectory, turn = move.segment.trajectory, -1 if move.holds == (2,) else 1
        times = np.linspace(trajectory.t[0], trajectory.t[-1], _SAMPLES)
        poses = [self._climber.poses(angles)[0] for angles in trajectory.evaluate(times)[:, ::turn]]
        X = np.array(poses if turn == 1 else [np.linalg.inv(pose) for pose in poses])
        X = X if move.kind == "lift" else X[::-1]
        points = X[:, None, :3, 3] + np.einsum("kij,pj->kpi", X[:, :3, :3], _PLATE)
        away = points - points[0]
        out = X[0, :3, 1]
        height = away @ out
        aside = np.linalg.norm(away - height[..., None] * out, axis=2) - _ASLANT * np.abs(height)
        if aside.max() > _ASIDE or (np.diff(height, axis=0) < -_SAME_PLACE).any():
            expected = "one along the face's normal, ever further from it, or nearer to it"
            raise self._error(key, f"another {move.kind} of the foot", expected)
        if np.abs(height[-1] - LIFT_M).max() > _ASIDE:
            got = f"a {move.kind} by {1e3 * height[-1, 0]:.1f} mm"
            raise self._error(key, got, f"{1e3 * LIFT_M:g} mm; what is beyond is a swing")

    def move(self, file: _MoveFile, key: str, kind: Kind | None) -> Move:
        """A move from where the walk is, which goes on where it ends."""
        if kind is not None and file.kind != kind:
            raise self._error(f"{key}.kind", file.kind, kind)
        arm, trajectory = np.array(file.arm), file.knots
        self._require_posture(arm, self._arm, f"{key}.arm")
        if file.kind == "arm" and file.holds != (both := self._here.feet):
            raise self._error(f"{key}.holds", shown(list(file.holds)), shown(list(both)))
        number = len(ARM_JOINTS) if file.kind == "arm" else len(self._angles)
        if trajectory.q.shape[1] != number:
            raise self._error(f"{key}.knots.q", f"{trajectory.q.shape[1]} columns", f"{number}")
        move = certified_move(self._world, self._here, file.kind, file.holds, arm, trajectory, self.speed)
        # On foot 2 the joints are in the other order.
        turn = -1 if file.holds == (2,) else 1
        first, end = trajectory.q[0][::turn], trajectory.q[-1][::turn]
        self._require_posture(first, self._arm if file.kind == "arm" else self._angles, f"{key}.knots.q")
        if file.kind == "arm":
            self._arm = end
        else:
            self._angles = end
        return move

    def _require_posture(self, found: FloatArray, expected: FloatArray, key: str) -> None:
        if np.abs(found - expected).max() > _SAME_POSTURE:
            raise self._error(key, "another posture", "that in which the move before ends")

    def _error(self, key: str, got: str, expected: str) -> ArchiveError:
        return ArchiveError(self.source, key, got, expected)


# What scenes of one bridge differ in: the work in each stance.
_KEYS_OF_ONE_STANCE = ("name", "start", "tool_path")


@dataclass(frozen=True, kw_only=True, eq=False)
class TourPart(ShortRepr):
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


class _PartFile(Entry):
    name: Annotated[str, Field(pattern=r"^(work|walk)_[1-9]\d{0,3}$")]


class _TourFile(FileModel):
    format: Any
    cmbot: Any
    words: Any
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
    data = {name: value for name, value in scene.as_data().items() if name not in _KEYS_OF_ONE_STANCE}
    data["guardrail"].pop("stance", None)
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
