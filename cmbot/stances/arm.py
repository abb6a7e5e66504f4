"""The arm on a base at the origin of its own frame: postures that hold the tool at poses, in batches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning import ToolTask, project_onto_task
from cmbot.robot import Postures, Robot, load_robot
from cmbot.scene import Scene
from cmbot.stances.loads import StanceLoads
from cmbot.toolpath import ToolPoses

# Postures of the table.
_TABLE = 60_000
# How long steps along the self-motion are, rad: of walks, and to where the objective is less, at first.
_STRIDE, _LENGTH = 0.2, 0.25
# A metre of the tool counts as so many rad when neighbours are sought.
_METRE = 2.0
# The tool's velocity is that between poses this long before and after, s.
_MOMENT = 1e-3
# Weights of the joints are tried so often where the quickest joint decides; none is lighter than this.
_WEIGHINGS, _LIGHTEST = 20, 1e-3
# Added to the diagonal of Gram matrices, for singular Jacobians.
_REGULAR = 1e-9


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How closely postures are sought.

    Attributes
    ----------
    tried : int
        Postures of the table that are put on the task.
    walked : int
        Steps along the self-motion from each of them, both ways.
    improved : int
        The best of them, which are moved along the self-motion.
    steps : int
        Steps of these.
    """

    tried: int
    walked: int
    improved: int
    steps: int


ROUGHLY = Effort(tried=30, walked=0, improved=5, steps=5)
CLOSELY = Effort(tried=120, walked=3, improved=15, steps=6)


@dataclass(frozen=True, kw_only=True)
class _Goals:
    """The pose of the tool at a time in the bases of C stances, and those just before and after."""

    task: ToolTask
    at: ToolPoses
    before: ToolPoses
    after: ToolPoses
    seconds: float  # from before to after

    @staticmethod
    def of(task: ToolTask, time: float, bases: FloatArray) -> _Goals:
        """Return them for bases (C, 4, 4) in W."""
        R, p = bases[:, :3, :3], bases[:, :3, 3]
        times = np.clip([time, time - _MOMENT, time + _MOMENT], 0.0, task.path.duration)

        def placed(pose: ToolPoses) -> ToolPoses:
            point = np.einsum("cji,cj->ci", R, pose.point[0] - p)
            return ToolPoses(point=point, rotation=R.transpose(0, 2, 1) @ pose.rotation[0])

        at, before, after = (placed(task.path.poses([t])) for t in times)
        return _Goals(task=task, at=at, before=before, after=after, seconds=float(times[2] - times[1]))


class BaseArm:
    """The arm on a base at the origin of its own frame."""

    def __init__(self, scene: Scene, robot: Robot) -> None:
        source = scene.robot
        self.robot = load_robot(mount=np.eye(4), tool_length=source.tool_length_m, payload=source.payload_kg)
        self.postures, self.limits = Postures(self.robot), self.robot.limits
        self._force, self._mass = np.array(robot.tool_force), self.robot.arm_mass
        rng = np.random.default_rng(0)
        self._table = self.limits.drawn(rng, _TABLE)
        at = self.postures.tool_at(self._table)
        self._points, self._rotations = at.tool_point, at.tool_rotation
        self._trees: dict[str, cKDTree] = {}

    def least(
        self,
        task: ToolTask,
        time: float,
        bases: FloatArray,
        loads: StanceLoads,
        number: IntArray,
        effort: Effort,
    ) -> FloatArray:
        """Smallest objective of admissible postures of C stances at a time, its torque and adhesion, (3, C).

        `number` (C,) are those of the stances in `loads`.
        """
        C, goals = len(bases), _Goals.of(task, time, bases)
        q, of = self._near(goals, effort.tried, steps=8)
        q, of = self._walked(goals, q, of, effort.walked)
        value, *_ = self._judged(q, of, goals, loads, number)
        q, of, value = self._best(q, of, value, effort.improved)
        length = np.full(len(q), _LENGTH)
        for _ in range(effort.steps):
            slope = self._slope(q, number[of], loads)
            slope = self._along_self_motion(task, q, slope)
            size = np.linalg.norm(slope, axis=1)
            step = -length[:, None] * slope / np.maximum(size, 1e-12)[:, None]
            tried, good = self._placed(goals, q + step, of, steps=4)
            trial = np.full(len(q), np.inf)
            if good.any():
                trial[good], *_ = self._judged(tried[good], of[good], goals, loads, number)
            better = trial < value
            q[better], value[better] = tried[better], trial[better]
            length[~better] *= 0.4
        least, torque, adhesion = np.full(C, np.inf), np.zeros(C), np.zeros(C)
        _, pulls, moments = self._judged(q, of, goals, loads, number)
        order = np.argsort(-value, kind="stable")
        least[of[order]], torque[of[order]] = value[order], moments[order]
        adhesion[of[order]] = pulls[order]
        return np.array([least, torque, adhesion])

    def _near(self, goals: _Goals, count: int, steps: int) -> tuple[FloatArray, IntArray]:
        """Postures (N, n) that hold the tool at the goals, from the nearest of the table, and whose (N,)."""
        keep = goals.task.keep
        if keep not in self._trees:
            self._trees[keep] = cKDTree(_features(keep, self._points, self._rotations))
        _, near = self._trees[keep].query(_features(keep, goals.at.point, goals.at.rotation), k=count)
        of = np.repeat(np.arange(len(near)), count)
        q, good = self._placed(goals, self._table[near.ravel()], of, steps)
        return q[good], of[good]

    def _walked(self, goals: _Goals, q: FloatArray, of: IntArray, steps: int) -> tuple[FloatArray, IntArray]:
        """Postures (N, n) with those along the self-motion from them, and whose (N,)."""
        ahead = np.random.default_rng(0).normal(size=q.shape)
        found = [(q, of)]
        for way in (ahead, -ahead):
            here, whose = q, of
            for _ in range(steps):
                way = self._along_self_motion(goals.task, here, way)
                way = way / np.maximum(np.linalg.norm(way, axis=1), 1e-12)[:, None]
                here, good = self._placed(goals, here + _STRIDE * way, whose, steps=3)
                here, whose, way = here[good], whose[good], way[good]
                found.append((here, whose))
        postures, of_stances = zip(*found, strict=True)
        return np.concatenate(postures), np.concatenate(of_stances)

    def _placed(self, goals: _Goals, q: FloatArray, of: IntArray, steps: int) -> tuple[FloatArray, BoolArray]:
        return project_onto_task(self.postures, goals.task, q, goals.at[of], steps=steps, tolerance=1e-6)

    def _judged(
        self, q: FloatArray, of: IntArray, goals: _Goals, loads: StanceLoads, number: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Objective at rest (infinite where inadmissible), adhesion and torque in postures (N, n)."""
        q, stance = self.limits.turned_to_middle(q), number[of]
        at = self.postures.at(q)
        push = at.tool_rotation @ self._force
        moment = np.einsum("b,kbi->ki", at.mass, at.centre)
        carried = at.carried_moment.transpose(2, 0, 1)
        wrench = loads.wrench(stance, moment, self._mass, push, at.tool_point)
        torque = np.einsum("kni,kni->kn", at.axis, np.cross(loads.gravity[stance][:, None], carried))
        if push.any():
            torque -= np.einsum("kij,ki->kj", at.jacobian[:, :3], push)
        good = (np.abs(torque) <= self.limits.torque).all(axis=1) & self.limits.contain(q)
        good &= loads.holds(stance, wrench)
        good[good] = ~self._too_fast(q[good], of[good], goals)
        value = np.where(good, loads.value(stance, wrench)[0], np.inf)
        return value, loads.adhesion(stance, wrench)[0], np.linalg.norm(wrench[:, 3:], axis=1)

    def _too_fast(self, q: FloatArray, of: IntArray, goals: _Goals) -> BoolArray:
        """Which of postures (N, n) no joint velocities within their bounds lead through as it goes.

        The smallest largest share of a bound is approached by least squares with weights (Lawson, 1961): for
        any weights the weighted mean square of the shares is a lower bound of it.
        """
        task, at = goals.task, self.postures.tool_at(q)
        ahead, behind = (
            task.errors(at.tool_point, at.tool_rotation, pose[of]) for pose in (goals.after, goals.before)
        )
        rate = (ahead - behind) / goals.seconds
        J = task.jacobian(at.tool_rotation, at.jacobian) * self.limits.velocity
        fast, open_ = np.zeros(len(q), dtype=np.bool_), np.arange(len(q))
        weight = np.full(q.shape, 1 / q.shape[1])
        for _ in range(_WEIGHINGS):
            each, by = J[open_], J[open_] / weight[open_, None, :]
            gram = by @ each.transpose(0, 2, 1)
            gram += _REGULAR * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(gram.shape[1])
            share = (by.transpose(0, 2, 1) @ np.linalg.solve(gram, rate[open_, :, None]))[:, :, 0]
            least = (weight[open_] * share**2).sum(axis=1)
            fast[open_[least > 1]] = True
            undecided = (least <= 1) & (np.abs(share).max(axis=1) > 1)
            open_, share = open_[undecided], share[undecided]
            if not len(open_):
                break
            heavier = weight[open_] * np.abs(share) + _LIGHTEST
            weight[open_] = heavier / heavier.sum(axis=1, keepdims=True)
        return fast

    def _slope(self, q: FloatArray, of: IntArray, loads: StanceLoads) -> FloatArray:
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
