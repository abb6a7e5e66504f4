"""The arm on a base at the origin of its own frame: postures that hold the tool at poses, in batches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.first_order import BAND_HZ, FirstOrder
from cmbot.planning import ToolTask, project_onto_task
from cmbot.robot import JointLimits, PostureBatch, Postures, Robot, load_robot
from cmbot.scene import Scene
from cmbot.stances.loads import StanceLoads
from cmbot.toolpath import ToolPoses

# Postures of the table.
_TABLE_POSTURES = 60_000
# How long steps along the self-motion are, rad: of walks, and to where the objective is less, at first.
_STRIDE, _LENGTH = 0.2, 0.25
# A metre of the tool counts as so many rad when neighbours are sought.
_RAD_PER_METRE = 2.0
# The tool's velocity is that between poses this long before and after, s.
_DIFFERENCE_S = 1e-3
# Weights of the joints are tried so often where the quickest joint decides; none is lighter than this.
_WEIGHINGS, _MIN_JOINT_WEIGHT = 20, 1e-3
# Added to the diagonal of Gram matrices, for singular Jacobians.
_REGULARIZATION_SHARE = 1e-9


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


FIGURES = ("bound", "torque", "adhesion", "sag_mm", "first_hz", "sway_mm", "holding_nm", "holding_of_effort")
"""At rest in a posture: what is ranked, and by what else stances are judged; see `StanceFigures`."""
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
        times = np.clip([time, time - _DIFFERENCE_S, time + _DIFFERENCE_S], 0.0, task.path.duration)

        def placed(pose: ToolPoses) -> ToolPoses:
            point = np.einsum("cji,cj->ci", R, pose.point[0] - p)
            return ToolPoses(point=point, rotation=R.transpose(0, 2, 1) @ pose.rotation[0])

        at, before, after = (placed(task.path.poses([t])) for t in times)
        return _Goals(task=task, at=at, before=before, after=after, seconds=float(times[2] - times[1]))


class _Table:
    """Postures drawn from all over the joints' ranges, by the tool poses in them."""

    def __init__(self, postures: Postures, limits: JointLimits) -> None:
        self.q = limits.drawn(np.random.default_rng(0), _TABLE_POSTURES)
        self._at, self._trees = postures.tool_at(self.q), dict[str, cKDTree]()

    def near(self, keep: str, at: ToolPoses, count: int) -> IntArray:
        """Numbers (C, count) of those that hold the tool nearest to poses (C)."""
        if keep not in self._trees:
            own = _features(keep, self._at.tool_point, self._at.tool_rotation)
            self._trees[keep] = cKDTree(own)
        return np.asarray(self._trees[keep].query(_features(keep, at.point, at.rotation), k=count)[1])


class BaseArm:
    """The arm on a base at the origin of its own frame."""

    def __init__(self, scene: Scene, robot: Robot) -> None:
        file = scene.robot
        own = load_robot(
            **file.files,
            mount=np.eye(4),
            tool_length=file.tool_length_m,
            payload=file.payload_kg,
            locked=dict(file.locked or ()),
        )
        self.robot = replace(
            own, elasticity=robot.elasticity, joint_elasticity=robot.joint_elasticity, limits=robot.limits
        )
        self.postures, self.limits = Postures(self.robot), self.robot.limits
        self._elastic = FirstOrder(elastic_arm(self.robot, None))
        self._force, self._mass = np.array(robot.tool_force), self.robot.arm_mass

    @cached_property
    def _table(self) -> _Table:
        return _Table(self.postures, self.limits)

    def __getstate__(self) -> dict[str, Any]:
        """All but the table, which is large and drawn anew where it is asked for."""
        return {name: value for name, value in vars(self).items() if name != "_table"}

    def least(
        self,
        task: ToolTask,
        time: float,
        bases: FloatArray,
        loads: StanceLoads,
        number: IntArray,
        effort: Effort,
    ) -> FloatArray:
        """Figures of the best admissible postures of C stances at a time, as `FIGURES` has them, (8, C).

        `number` (C,) are those of the stances in `loads`.
        """
        goals = _Goals.of(task, time, bases)
        q, of = self._near(goals, effort.tried, steps=8)
        q, of = self._walked(goals, q, of, effort.walked)
        q, of, value = self._best(q, of, self._judged(q, of, goals, loads, number), effort.improved)
        length = np.full(len(q), _LENGTH)
        for _ in range(effort.steps):
            slope = self._along_self_motion(task, q, self._slope(q, number[of], loads))
            size = np.linalg.norm(slope, axis=1)
            step = -length[:, None] * slope / np.maximum(size, 1e-12)[:, None]
            tried, good = self._placed(goals, q + step, of, steps=4)
            trial = np.full(len(q), np.inf)
            if good.any():
                trial[good] = self._judged(tried[good], of[good], goals, loads, number)
            better = trial < value
            q[better], value[better] = tried[better], trial[better]
            length[~better] *= 0.4
        if loads.objective == "sway" and len(q):
            value = self.figures(q, number[of], loads)[0]
        elif loads.objective == "hold":
            value = loads.adhesion(number[of], self._loaded(q, number[of], loads)[1])[0]
        q, of, value = self._best(q, of, value, 1)
        least = np.full((len(FIGURES), len(bases)), np.nan)
        least[0] = np.inf
        if len(q):
            least[:, of] = self.figures(q, number[of], loads)
        return least

    def figures(self, q: FloatArray, stance: IntArray, loads: StanceLoads) -> FloatArray:
        """Return `FIGURES` (8, N) at rest of postures (N, n) in stances; NaN of what does not bend."""
        at, wrench, push = self._loaded(q, stance, loads)
        torque, adhesion = loads.torque(stance, wrench)[0], loads.adhesion(stance, wrench)[0]
        sag = hz = sway = np.full(len(q), np.nan)
        if loads.bends:
            batch = self._elastic.at(at.q, loads.bases(stance))
            sag = 1e3 * self._sag(at.q, stance, push, loads)
            hz, sway = batch.first_hz, 1e3 * batch.shaken(self.robot.damping_ratio, BAND_HZ)
        held, _, of_effort = loads.held(stance, wrench)
        ranked = {"torque": torque, "hold": adhesion, "sag": sag, "sway": sway}.get(loads.objective)
        ranked = loads.use(stance, wrench) if ranked is None else ranked
        return np.array([ranked, torque, adhesion, sag, hz, sway, held, of_effort])

    def at_rest(self, q: FloatArray, stance: int, loads: StanceLoads) -> FloatArray:
        """Return what is ranked (N,) at rest in postures (N, n) of one stance; as `_ranked` has it."""
        which = np.full(len(q), stance)
        _, wrench, push = self._loaded(q, which, loads)
        return self._ranked(q, which, wrench, push, loads)

    def use(self, q: FloatArray, stance: IntArray, loads: StanceLoads) -> FloatArray:
        """Shares (N, n + 1) of what joints bear, and feet, at rest in postures (N, n), with the tool off."""
        at, wrench, _ = self._loaded(q, stance, loads, 0.0)
        joints = np.abs(self._carried(at, stance, loads)) / self.limits.torque
        return np.column_stack([joints, loads.use(stance, wrench)])

    def _loaded(
        self, q: FloatArray, stance: IntArray, loads: StanceLoads, share: float = 1.0
    ) -> tuple[PostureBatch, FloatArray, FloatArray]:
        """Postures (N, n) in the base's frame, the arm's wrench (N, 6) in W, the force (N, 3) on the tool.

        With a share of that force.
        """
        at = self.postures.at(q)
        push = at.tool_rotation @ (share * self._force)
        moment = np.einsum("b,kbi->ki", at.arm.mass, at.centre)
        return at, loads.wrench(stance, moment, self._mass, push, at.tool_point), push

    @staticmethod
    def _carried(at: PostureBatch, stance: IntArray, loads: StanceLoads) -> FloatArray:
        """Torques (N, n) of the joints by the weight that they carry."""
        carried = at.carried_moment.transpose(2, 0, 1)
        weight = np.cross(loads.gravity[stance][:, None], carried)
        return at.arm.coupling.projected(np.einsum("kni,kni->kn", at.axis, weight))

    def _ranked(
        self, q: FloatArray, stance: IntArray, wrench: FloatArray, push: FloatArray, loads: StanceLoads
    ) -> FloatArray:
        """What is ranked (N,), or what falls with it and costs less.

        In place of the sway the sag, mm, and of the adhesion that of contacts that are pressed all over.
        """
        if loads.objective == "torque":
            return loads.torque(stance, wrench)[0]
        if loads.objective == "hold":
            return loads.adhesion(stance, wrench, nearly=True)[0]
        if loads.objective == "use":
            return loads.use(stance, wrench)
        return 1e3 * self._sag(q, stance, push, loads)

    def _sag(self, q: FloatArray, stance: IntArray, push: FloatArray, loads: StanceLoads) -> FloatArray:
        sag = self._elastic.sag(q, loads.bases(stance), loads.gravity[stance], push)
        return np.asarray(np.linalg.norm(sag, axis=1))

    def _near(self, goals: _Goals, count: int, steps: int) -> tuple[FloatArray, IntArray]:
        """Postures (N, n) that hold the tool at the goals, from the nearest of the table, and whose (N,)."""
        keep = goals.task.keep
        near = self._table.near(keep, goals.at, count)
        of = np.repeat(np.arange(len(near)), count)
        q, good = self._placed(goals, self._table.q[near.ravel()], of, steps)
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
    ) -> FloatArray:
        """What is ranked (N,) at rest in postures (N, n); infinite where they are inadmissible."""
        q, stance = self.limits.turned_to_middle(q), number[of]
        at, wrench, push = self._loaded(q, stance, loads)
        torque = self._carried(at, stance, loads)
        if push.any():
            torque -= np.einsum("kij,ki->kj", at.jacobian[:, :3], push)
        good = (np.abs(torque) <= self.limits.torque).all(axis=1) & self.limits.contain(q)
        good &= loads.holds(stance, wrench)
        good[good] = ~self._too_fast(q[good], of[good], goals)
        value = np.full(len(q), np.inf)
        value[good] = self._ranked(q[good], stance[good], wrench[good], push[good], loads)
        if loads.sags and np.isfinite(loads.most_sag):
            sag = self._sag(q[good], stance[good], push[good], loads)
            value[good] = np.where(sag <= loads.most_sag, value[good], np.inf)
        return value

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
            gram += (
                _REGULARIZATION_SHARE
                * np.trace(gram, axis1=1, axis2=2)[:, None, None]
                * np.eye(gram.shape[1])
            )
            share = (by.transpose(0, 2, 1) @ np.linalg.solve(gram, rate[open_, :, None]))[:, :, 0]
            least = (weight[open_] * share**2).sum(axis=1)
            fast[open_[least > 1]] = True
            undecided = (least <= 1) & (np.abs(share).max(axis=1) > 1)
            open_, share = open_[undecided], share[undecided]
            if not len(open_):
                break
            heavier = weight[open_] * np.abs(share) + _MIN_JOINT_WEIGHT
            weight[open_] = heavier / heavier.sum(axis=1, keepdims=True)
        return fast

    def _slope(self, q: FloatArray, of: IntArray, loads: StanceLoads) -> FloatArray:
        """Derivatives (N, n) of what is ranked at rest, without the force on the tool."""
        at, wrench, _ = self._loaded(q, of, loads)
        moved = np.cross(at.axis, at.carried_moment.transpose(2, 0, 1))
        torques = np.cross(moved, loads.gravity[of][:, None])
        by_torque = loads.slope(of, wrench, at.tool_point)
        return at.arm.coupling.projected(np.einsum("kni,ki->kn", torques, by_torque))

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
    return np.hstack([_RAD_PER_METRE * point, turned])
