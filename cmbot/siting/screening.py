"""Screening: what a stance asks at least at some via-points, by sampled postures, for thousands of stances.

The arm is the same in every stance; only its base is elsewhere. So all postures are found in the base's
frame, in a few large batches: near neighbours of the tool's pose in a table of random postures, put on the
task and moved along the self-motion to where the objective is less. Obstacles are left out, so a stance may
be blocked; joint ranges, joint torques and the feet's bounds count. The largest, over the via-points, of the
smallest value that was found is an estimate of the stance's lower bound from above.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.elastic import SharedFrame
from cmbot.hold import Holding, needed_by_load
from cmbot.planning import ToolTask, project_onto_task
from cmbot.robot import Climber, Postures, Robot, load_robot
from cmbot.scene import PlannerOptions, Scene, ToolPoses, axis_point, feet_at
from cmbot.siting.candidates import Candidate

__all__ = ["Screening", "screen"]

# Postures of the table, those that are tried for a via-point, and those of them that are improved.
_TABLE, _TRIED, _IMPROVED = 60_000, 12, 3
# Postures that are tried at each via-point of a stance that is checked for obstacles, and via-points.
_MANY, _CHECKED = 400, 12
# Steps along the self-motion, and how long they are at first, rad.
_STEPS, _LENGTH = 5, 0.25
# Via-points of a stroke that are looked at.
_VIA_POINTS = 4
# A metre of the tool counts as so many rad when neighbours are sought.
_METRE = 2.0
_AT_ONCE = 400


@dataclass(frozen=True, kw_only=True, eq=False)
class Screening:
    """What is known of C candidates.

    Attributes
    ----------
    within_reach : (C,)
        Whether the tool's places are within reach of the arm's links.
    bound : (C,)
        What each asks at least, in the objective's unit; infinite where no posture was found.
    torque, adhesion : (C,), Nm and N
        Largest torque and adhesion at rest in the postures of that bound.
    times : (K,), s
        Of the via-points that were looked at, of each stroke from its beginning.
    clearing : callable
        From a candidate, clearances of its robot and a margin, m, to its bound by more postures, those too
        near to something left out, and a posture (n,) that keeps clear where the first stroke begins; None
        where there is none at some via-point.
    """

    within_reach: BoolArray
    bound: FloatArray
    torque: FloatArray
    adhesion: FloatArray
    times: FloatArray
    clearing: Callable[[Candidate, Clearances, float], tuple[float, FloatArray | None]]


def screen(
    scene: Scene,
    robot: Robot,
    tasks: Sequence[ToolTask],
    candidates: Sequence[Candidate],
    options: PlannerOptions,
    report: Callable[[float], None] = lambda _: None,
) -> Screening:
    """Screen candidates.

    Parameters
    ----------
    scene : Scene
    robot : Robot
        In the scene's stance.
    tasks : sequence of ToolTask
        Of the strokes, in W.
    candidates : sequence of Candidate
    options : PlannerOptions
        The objective is ``torque`` or ``hold``.
    report : callable
        Takes the share that is done.
    """
    arm = _Arm(scene, robot)
    count = len(candidates)
    bound, torque, adhesion = np.full(count, -np.inf), np.zeros(count), np.zeros(count)
    within, times = np.ones(count, dtype=np.bool_), []
    goals = []
    for task in tasks:
        t = np.linspace(0.0, task.path.duration, _VIA_POINTS)
        times.append(t)
        goals.append(task.path.poses(t))
    bases = np.array([candidate.base for candidate in candidates])
    for each in goals:
        for k in range(len(each)):
            away = np.linalg.norm(each.point[k] - bases[:, :3, 3], axis=1)
            within &= (away <= robot.reach) & (away >= robot.inner_reach)
    bound[~within] = np.inf
    left = np.flatnonzero(within)
    if not len(left):
        times_of = np.concatenate(times)
        return Screening(
            within_reach=within,
            bound=bound,
            torque=torque,
            adhesion=adhesion,
            times=times_of,
            clearing=lambda *_: (np.inf, None),
        )
    loads = _Loads(scene, [candidates[k] for k in left.tolist()], options, robot)
    number = np.cumsum(within) - 1  # among those within reach
    looks = [(task, each[k]) for task, each in zip(tasks, goals, strict=True) for k in range(len(each))]
    for done, (task, goal) in enumerate(looks):
        for first in range(0, len(left), _AT_ONCE):
            some = left[first : first + _AT_ONCE]
            found = arm.least(task, goal, bases[some], loads, number[some])
            bound[some] = np.maximum(bound[some], found[0])
            torque[some] = np.maximum(torque[some], found[1])
            adhesion[some] = np.maximum(adhesion[some], found[2])
            report((done + first / max(len(left), 1)) / len(looks))
        left = left[np.isfinite(bound[left])]
    closer = [
        (task, pose)
        for task in tasks
        for pose in task.path.poses(np.linspace(0.0, task.path.duration, _CHECKED))
    ]

    def clearing(
        candidate: Candidate, clearances: Clearances, margin: float
    ) -> tuple[float, FloatArray | None]:
        load = _Loads(scene, [candidate], options, robot)
        largest, begins = 0.0, None
        for task, goal in closer:
            q, value = arm.several(task, goal, candidate.base, load)
            order = np.argsort(value, kind="stable")
            near = clearances.check_collision(q[order], margin)
            if near.all():
                return np.inf, None
            first = order[int(np.flatnonzero(~near)[0])]
            largest = max(largest, float(value[first]))
            begins = q[first] if begins is None else begins
        return largest, begins

    return Screening(
        within_reach=within,
        bound=bound,
        torque=torque,
        adhesion=adhesion,
        times=np.concatenate(times),
        clearing=clearing,
    )


class _Shares:
    """What the feet of each candidate bear of a wrench."""

    def __init__(self, scene: Scene, candidates: Sequence[Candidate]) -> None:
        self._guardrail, self._number = scene.guardrail, dict[tuple[float, ...], int]()
        points = list[FloatArray]()
        for candidate in candidates:
            if candidate.stance.foot_2 is not None:
                for place in (candidate.stance.foot_1, candidate.stance.foot_2):
                    point = axis_point(scene.guardrail, place)
                    if self._key(point) not in self._number:
                        self._number[self._key(point)] = len(points)
                        points.append(point)
        self._frame = SharedFrame(scene.guardrail, np.array(points)) if points else None

    @staticmethod
    def _key(point: FloatArray) -> tuple[float, ...]:
        return tuple(np.round(point, 3).tolist())

    def of(self, candidate: Candidate) -> tuple[FloatArray, ...]:
        """The shares (6, 6) of its feet."""
        stance = candidate.stance
        if stance.foot_2 is None or self._frame is None:
            return (np.eye(6),)
        first, second = (
            self._number[self._key(axis_point(self._guardrail, place))]
            for place in (stance.foot_1, stance.foot_2)
        )
        return self._frame.shares(first, second, candidate.root[:3, 3])


@dataclass(frozen=True)
class _Contacts:
    """Flat contacts, one a load."""

    half: tuple[FloatArray, FloatArray]
    radius: FloatArray
    friction: FloatArray


class _Loads:
    """What stances make of the arm's wrench: values and gradients in the base's frame."""

    def __init__(
        self, scene: Scene, candidates: Sequence[Candidate], options: PlannerOptions, robot: Robot
    ) -> None:
        shared, climber = _Shares(scene, candidates), Climber()
        gravity = np.array(robot.model.gravity.linear)
        base = np.array([each.base for each in candidates])
        root = np.array([each.root for each in candidates])
        self.rotation = base[:, :3, :3]
        away = root[:, :3, 3] - base[:, :3, 3]
        self.foot = np.einsum("cji,cj->ci", self.rotation, away)
        self.gravity = np.einsum("cji,j->ci", self.rotation, gravity)
        weights = [climber.weight(each.climber) for each in candidates]
        mass, centre = (np.array(part) for part in zip(*weights, strict=True))
        still = mass[:, None] * gravity
        lever = np.einsum("cij,cj->ci", root[:, :3, :3], centre)
        self._still = np.hstack([still, np.cross(lever, still)])
        feet = [
            feet_at(scene.file.guardrail, each.stance, scene.guardrail, shared.of(each))
            for each in candidates
        ]
        # Where there is no second foot, the first one stands for it.
        self._feet = [[each[min(k, len(each) - 1)] for each in feet] for k in (0, 1)]
        self._from_wrench = [np.array([foot.from_wrench for foot in part]) for part in self._feet]
        flat = [np.array([foot.half or (np.nan, np.nan) for foot in part]) for part in self._feet]
        radius = [np.array([foot.radius or np.nan for foot in part]) for part in self._feet]
        friction = [np.array([foot.friction for foot in part]) for part in self._feet]
        self._flat = list(zip(flat, radius, friction, strict=True))
        self._holding = [Holding(each, self._still[k]) for k, each in enumerate(feet)]
        self._bounded = any(holding.bounded for holding in self._holding)
        self._torque = options.objective == "torque"
        self._point = -away if options.moment_about == "base" else np.zeros_like(away)
        self._weights = np.array(options.axis_weights)

    def wrench(
        self, of: IntArray, first_moment: FloatArray, mass: float, push: FloatArray, tool: FloatArray
    ) -> FloatArray:
        """Wrench (N, 6) about O0 in W from first moments (N, 3) and pushes at tool points, in the base."""
        force = mass * self.gravity[of] + push
        torque = np.cross(first_moment - mass * self.foot[of], self.gravity[of])
        if push.any():
            torque += np.cross(tool - self.foot[of], push)
        R = self.rotation[of]
        return np.hstack([np.einsum("kij,kj->ki", R, part) for part in (force, torque)])

    def adhesion(self, of: IntArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Adhesion (N,) that the feet need, and its gradients (N, 6); zero where none is flat."""
        value, gradient = np.zeros(len(of)), np.zeros((len(of), 6))
        whole = wrench + self._still[of]
        for by_wrench, (half, radius, friction) in zip(self._from_wrench, self._flat, strict=True):
            contact = _Contacts((half[of, 0], half[of, 1]), radius[of], friction[of])
            load = np.einsum("kij,kj->ki", by_wrench[of], whole)
            with np.errstate(invalid="ignore"):
                needed, by_load = needed_by_load(contact, load)
            more = needed > value
            value[more] = needed[more]
            gradient[more] = np.einsum("ki,kij->kj", by_load[more], by_wrench[of][more])
        return value, gradient

    def value(self, of: IntArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Objective (N,) and its derivatives (N, 3) by the torque in the base's frame."""
        if self._torque:
            moment = self._weights * (wrench[:, 3:] - np.cross(self._point[of], wrench[:, :3]))
            value = np.linalg.norm(moment, axis=1)
            by_torque = self._weights * moment / np.maximum(value, 1e-9)[:, None]
        else:
            value, gradient = self.adhesion(of, wrench)
            by_torque = gradient[:, 3:]
        return value, np.einsum("kij,ki->kj", self.rotation[of], by_torque)

    def holds(self, of: IntArray, wrench: FloatArray) -> BoolArray:
        """Whether the feet bear it."""
        good = np.ones(len(of), dtype=np.bool_)
        for c in np.unique(of) if self._bounded else ():
            rows = of == c
            good[rows] = self._holding[c].share(wrench[rows])[0] <= 1.0
        return good


class _Arm:
    """The arm on a base at the origin of its own frame."""

    def __init__(self, scene: Scene, robot: Robot) -> None:
        source = scene.robot
        self.robot = load_robot(mount=np.eye(4), tool_length=source.tool_length, payload=source.payload)
        self.postures, self.limits = Postures(self.robot), self.robot.limits
        self._force, self._mass = np.array(robot.tool_force), self.robot.arm_mass
        rng = np.random.default_rng(0)
        half = self.limits.sampled_half
        low, high = self.limits.range_middle - half, self.limits.range_middle + half
        self._table = rng.uniform(low, high, (_TABLE, self.robot.dof))
        at = self.postures.tool_at(self._table)
        self._points, self._rotations = at.tool_point, at.tool_rotation
        self._trees: dict[str, cKDTree] = {}

    def least(
        self, task: ToolTask, goal: ToolPoses, bases: FloatArray, loads: _Loads, number: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Smallest objective of admissible postures of C stances at a pose, its torque and its adhesion.

        `number` (C,) are those of the stances in `loads`.
        """
        C = len(bases)
        R, p = bases[:, :3, :3], bases[:, :3, 3]
        point = np.einsum("cji,cj->ci", R, goal.point[0] - p)
        rotation = R.transpose(0, 2, 1) @ goal.rotation[0]
        _, near = self._tree(task).query(_features(task.keep, point, rotation), k=_TRIED)
        of = np.repeat(np.arange(C), _TRIED)
        q = self._table[near.ravel()]
        q, good = self._placed(task, q, point[of], rotation[of], steps=8)
        q, of = q[good], of[good]
        value, *_ = self._judged(q, number[of], loads)
        q, of, value = self._best(q, of, value, _IMPROVED)
        length = np.full(len(q), _LENGTH)
        for _ in range(_STEPS):
            slope = self._slope(q, number[of], loads)
            slope = self._along_self_motion(task, q, slope)
            size = np.linalg.norm(slope, axis=1)
            step = -length[:, None] * slope / np.maximum(size, 1e-12)[:, None]
            tried, good = self._placed(task, q + step, point[of], rotation[of], steps=4)
            trial = np.full(len(q), np.inf)
            if good.any():
                trial[good], *_ = self._judged(tried[good], number[of[good]], loads)
            better = trial < value
            q[better], value[better] = tried[better], trial[better]
            length[~better] *= 0.4
        least, torque, adhesion = np.full(C, np.inf), np.zeros(C), np.zeros(C)
        _, pulls, moments = self._judged(q, number[of], loads)
        order = np.argsort(-value, kind="stable")
        least[of[order]], torque[of[order]] = value[order], moments[order]
        adhesion[of[order]] = pulls[order]
        return least, torque, adhesion

    def several(
        self, task: ToolTask, goal: ToolPoses, base: FloatArray, loads: _Loads
    ) -> tuple[FloatArray, FloatArray]:
        """Admissible postures (N, n) of one stance at a pose, and the objective in each (N,)."""
        R = base[:3, :3]
        point, rotation = (R.T @ (goal.point[0] - base[:3, 3]))[None], (R.T @ goal.rotation[0])[None]
        _, near = self._tree(task).query(_features(task.keep, point, rotation), k=_MANY)
        q = self._table[near.ravel()]
        point, rotation = (np.repeat(each, len(q), axis=0) for each in (point, rotation))
        q, good = self._placed(task, q, point, rotation, steps=10)
        q = self.limits.turned_to_middle(q[good])
        value, *_ = self._judged(q, np.zeros(len(q), dtype=np.intp), loads)
        admissible = np.isfinite(value)
        return q[admissible], value[admissible]

    def _tree(self, task: ToolTask) -> cKDTree:
        if task.keep not in self._trees:
            self._trees[task.keep] = cKDTree(_features(task.keep, self._points, self._rotations))
        return self._trees[task.keep]

    def _placed(
        self, task: ToolTask, q: FloatArray, point: FloatArray, rotation: FloatArray, steps: int
    ) -> tuple[FloatArray, BoolArray]:
        goals = ToolPoses(point=point, rotation=rotation)
        return project_onto_task(self.postures, task, q, goals, steps=steps, tolerance=1e-6)

    def _judged(
        self, q: FloatArray, of: IntArray, loads: _Loads
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Objective at rest (infinite where inadmissible), adhesion and torque in postures (N, n)."""
        q = self.limits.turned_to_middle(q)
        at = self.postures.at(q)
        push = at.tool_rotation @ self._force
        moment = np.einsum("b,kbi->ki", at.mass, at.centre)
        carried = at.carried_moment.transpose(2, 0, 1)
        wrench = loads.wrench(of, moment, self._mass, push, at.tool_point)
        torque = np.einsum("kni,kni->kn", at.axis, np.cross(loads.gravity[of][:, None], carried))
        if push.any():
            torque -= np.einsum("kij,ki->kj", at.jacobian[:, :3], push)
        good = (np.abs(torque) <= self.limits.torque).all(axis=1) & self.limits.contain(q)
        good &= loads.holds(of, wrench)
        value = np.where(good, loads.value(of, wrench)[0], np.inf)
        return value, loads.adhesion(of, wrench)[0], np.linalg.norm(wrench[:, 3:], axis=1)

    def _slope(self, q: FloatArray, of: IntArray, loads: _Loads) -> FloatArray:
        """Derivatives (N, n) of the objective at rest, without the force on the tool."""
        at = self.postures.at(q)
        push = at.tool_rotation @ self._force
        moment = np.einsum("b,kbi->ki", at.mass, at.centre)
        moved = np.cross(at.axis, at.carried_moment.transpose(2, 0, 1))
        wrench = loads.wrench(of, moment, self._mass, push, at.tool_point)
        _, by_torque = loads.value(of, wrench)
        torques = np.cross(moved, loads.gravity[of][:, None])
        return np.asarray(np.einsum("kni,ki->kn", torques, by_torque))

    def _along_self_motion(self, task: ToolTask, q: FloatArray, slope: FloatArray) -> FloatArray:
        at = self.postures.tool_at(q)
        J = task.jacobian(at.tool_rotation, at.jacobian)
        y = np.linalg.solve(J @ J.transpose(0, 2, 1) + 1e-9 * np.eye(J.shape[1]), (J @ slope[:, :, None]))
        return np.asarray(slope - (J.transpose(0, 2, 1) @ y)[:, :, 0])

    @staticmethod
    def _best(
        q: FloatArray, of: IntArray, value: FloatArray, number: int
    ) -> tuple[FloatArray, IntArray, FloatArray]:
        """The `number` best postures of each stance, among those that are admissible."""
        order = np.lexsort((value, of))
        order = order[np.isfinite(value[order])]
        rank = np.arange(len(order)) - np.searchsorted(of[order], of[order])
        kept = order[rank < number]
        return q[kept], of[kept], value[kept]


def _features(keep: str, point: FloatArray, rotation: FloatArray) -> FloatArray:
    """Coordinates in which tool poses that a task takes for near are near."""
    columns = {"pose": rotation.reshape(len(rotation), -1), "axis": rotation[:, :, 2]}
    turned = columns.get(keep, np.zeros((len(rotation), 0)))
    return np.hstack([_METRE * point, turned])
