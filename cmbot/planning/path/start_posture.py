"""A start posture for a new scene: inverse kinematics from random postures, and a leg that it can follow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from cmbot.collision import Obstacle
from cmbot.common.arrays import BoolArray, FloatArray, read_only
from cmbot.common.errors import InputError, PlanningError
from cmbot.common.reading.validation import counted
from cmbot.planning.path.place_search import worst_missed
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.postures.sampler import PostureSampler
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.workcell import Workcell
from cmbot.robot import Robot, sampled_postures
from cmbot.scene import PlannerOptions
from cmbot.toolpath import SpeedProfile, ToolPath, ToolPoses

# Random postures that Newton's method starts from, its most steps, and how many results are tried with a leg.
_RESTARTS, _MAX_START_STEPS, _TRIED = 2000, 60, 30
# The first leg: its longest length, m, and as a share of the reach; shares of that which are tried; the steps
# in which it is followed; the tool's speed, m/s, and the share of a joint's velocity limit, both on average.
_LEG, _LEG_SHARE, _SHORTER, _LEG_STEPS = 0.10, 0.15, (1.0, 0.5, 0.25), 10
_TOOL_SPEED_M_S, _VELOCITY_SHARE, _LEAST_SECONDS = 0.05, 0.15, 4.0
# Safety margins that are tried, as shares of the default: as convex hulls, some arms are near themselves.
_MARGIN_SHARES = (1.0, 0.5, 0.25, 0.1)
_KEEPS: tuple[Literal["pose", "axis", "position"], ...] = ("pose", "axis", "position")
# What a start leaves: of the joints' ranges, of the clearance (m), and of the torque limits at rest.
_RANGE_LEFT, _CLEARANCE_LEFT, _TORQUE_USE = 0.02, 0.002, 0.9
# Smallest singular value of the task Jacobian below which a posture counts as singular.
_MIN_VALUE = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class StartPosture:
    """Where a new scene starts, and a first leg.

    Attributes
    ----------
    posture : (n,), rad, of joints that slide m
        Rounded to 0.0001 deg, and where joints slide to 1e-5 rad and m.
    keep : str
        What the arm can keep of the tool along the leg.
    by : tuple of float
        The leg (3,), m.
    seconds : float
        Its duration, s.
    safety_margin : float
        Which posture and leg keep, m.
    """

    posture: FloatArray
    keep: Literal["pose", "axis", "position"]
    by: tuple[float, float, float]
    seconds: float
    safety_margin: float


def find_start(
    robot: Robot,
    obstacles: Sequence[Obstacle],
    point: FloatArray,
    orientation: FloatArray | None = None,
    near: Mapping[str, float] | None = None,
) -> StartPosture:
    """Find a posture that holds the tool, and a short leg that the arm can follow from it.

    It is within the joints' ranges, clear and strong enough; of those found the one nearest to what is asked
    for, or furthest from singularities and the ends of the ranges. The same arguments give the same posture.

    Parameters
    ----------
    robot : Robot
    obstacles : sequence of Obstacle
    point : (3,), m
        The tool point in W.
    orientation : (3, 3), optional
        R_WT; left out: any.
    near : mapping, optional
        Where some of its joints are to be about, rad or m.

    Raises
    ------
    InputError
        When the arm has fewer than three joints.
    PlanningError
        When no such posture is found; it says what most of them lacked.
    """
    if robot.dof < 3:
        raise InputError(
            str(robot.urdf), "joints", robot.dof, "an arm of at least 3 joints, to hold a tool point"
        )
    search = _Search(robot, obstacles, near or {})
    held: Literal["pose", "axis", "position"] = "position" if orientation is None else search.keep
    task = _task(point, np.eye(3) if orientation is None else orientation, held)
    q = search.postures(task)
    margins = [share * PlannerOptions().safety_margin_m for share in _MARGIN_SHARES] if len(q) else []
    for keep, margin in product(search.keeps, margins):
        search.keep = keep
        for posture in search.best(q, margin):
            if (start := search.first_leg(posture, margin)) is not None:
                return start
    reason, X_WB = search.reason(task, point, q), robot.base_pose
    if len(q) == 0 and robot.base_place:
        reason += f"; it is in W, where {robot.base_frame} is at {robot.base_place}"
        turned = X_WB.rotation @ (np.eye(3) if orientation is None else orientation)
        if len(search.postures(_task(X_WB.act(point), turned, held))):
            meant = ", ".join(f"{x:.4g}" for x in X_WB.act(point) + 0.0)
            reason += f"; these numbers there are ({meant}) m in W, where the tool can be held"
    raise PlanningError(reason)


def _task(point: FloatArray, orientation: FloatArray, keep: Literal["pose", "axis", "position"]) -> ToolTask:
    corners = np.array([point, point])
    path = ToolPath.straight(corners, orientation, np.ones(1), SpeedProfile().law)
    return ToolTask(path=path, keep=keep)


class _Search:
    """What postures of one robot among obstacles are good for."""

    def __init__(self, robot: Robot, obstacles: Sequence[Obstacle], near: Mapping[str, float]) -> None:
        self._robot, self._limits, self._near = robot, robot.limits, near
        self._cell = Workcell.of(robot, obstacles, PlannerOptions())
        self._batch, self._clearances = self._cell.postures, self._cell.clearances
        # What is kept of the tool: less of it where an arm cannot, such as one whose last two axes are one.
        self.keeps = _KEEPS[max(0, 6 - robot.dof) :] if robot.dof >= 5 else _KEEPS[-1:]
        self.keep = self.keeps[0]

    def postures(self, task: ToolTask) -> FloatArray:
        """Postures (N, n) on the task within the ranges of the joints."""
        start = sampled_postures(self._limits.lower, self._limits.upper, _RESTARTS)
        sampler = PostureSampler(cell=self._cell, task=task, steps=_MAX_START_STEPS)
        q, reached = sampler.held(start, task.path.poses([0.0]))
        return q[reached & self._within(q)]

    def best(self, q: FloatArray, margin: float) -> Iterator[FloatArray]:
        """The postures that are clear and strong enough, the nearest, or furthest from all limits, first."""
        q = q[self._strong(q)]
        q = q[self._clearances.query(q).distance >= margin + _CLEARANCE_LEFT]
        # Without a range there is all the room.
        endless = np.isinf(self._limits.range_half)
        room = np.where(endless, 1.0, self._room(q) / np.where(endless, 1.0, self._limits.range_half))
        values = [self._singular_value(posture) for posture in q]
        score = np.array(
            [value * each.min() for value, each in zip(values, 1.0 - (1.0 - room) ** 2, strict=True)]
        )
        if self._near:
            asked = [self._robot.joints.index(name) for name in self._near]
            score = -np.linalg.norm(q[:, asked] - list(self._near.values()), axis=1)
        for k in np.argsort(-score)[:_TRIED]:
            if values[k] > _MIN_VALUE:
                slides = self._limits.prismatic.any()
                yield np.round(q[k], 5) if slides else np.deg2rad(np.round(np.rad2deg(q[k]), 4))

    def first_leg(self, posture: FloatArray, margin: float) -> StartPosture | None:
        """The posture with the longest leg along an axis of W that the arm follows from it; None without."""
        at = self._batch.tool_at(posture[None])
        p, task = at.tool_point[0], _task(at.tool_point[0], at.tool_rotation[0], self.keep)
        longest = min(_LEG, _LEG_SHARE * self._robot.reach)
        for share in _SHORTER:
            # Up, and to the sides, before down and inward.
            for direction in (*np.eye(3)[[1, 0, 2]], *-np.eye(3)[[1, 0, 2]]):
                by = np.round(share * longest * direction, 3) + 0.0
                points = p + np.linspace(0.0, 1.0, _LEG_STEPS + 1)[1:, None] * by
                q = self._followed(task, posture, points)
                if q is None or (self._clearances.query(q).distance < margin + _CLEARANCE_LEFT).any():
                    continue
                moved = np.abs(np.diff(q, axis=0, prepend=posture[None])).sum(axis=0)
                seconds = max(
                    _LEAST_SECONDS,
                    float(np.linalg.norm(by)) / _TOOL_SPEED_M_S,
                    float((moved / self._limits.velocity).max()) / _VELOCITY_SHARE,
                )
                x, y, z = map(float, by)
                return StartPosture(
                    posture=read_only(posture),
                    keep=self.keep,
                    by=(x, y, z),
                    seconds=float(np.ceil(seconds)),
                    safety_margin=margin,
                )
        return None

    def reason(self, task: ToolTask, point: FloatArray, q: FloatArray) -> str:
        """Why none of the postures `q` (N, n) will do."""
        away = float(np.linalg.norm(point - self._robot.base_point))
        axis = ", ".join(f"{x:.2g}" for x in task.path.poses([0.0]).rotation[0, :, 2].round(3) + 0.0)
        held = "the tool there" + f", its axis along ({axis}) of W," * (task.keep != "position")
        if len(q) == 0:
            within = "within" if away <= self._robot.reach else "beyond"
            return (
                f"no start posture: none of {_RESTARTS} random ones leads to one that holds {held} within "
                f"the joints' ranges; the point is {away:.3f} m from the arm's first joint, {within} its "
                f"reach of {self._robot.reach:.3f} m (lengths are in metres){self._nearest(task)}"
            )
        strong = q[self._strong(q)]
        text = (
            f"no start posture: {counted(len(q), 'posture')} found that hold {held}, {len(strong)} of them "
            "strong enough"
        )
        if not len(strong):
            return f"{text}: {self._too_weak(q)}"
        clear = self._clearances.query(strong)
        k = int(clear.distance.argmax())
        text += f"; the clearest one keeps {1e3 * clear.distance[k]:.1f} mm"
        if clear.pair[k] >= 0:
            pair = self._clearances.pairs[clear.pair[k]]
            text += f" ({pair.link} to {pair.other})"
            own = self._robot.model.existFrame(pair.other)
            if own and clear.distance[k] < _MARGIN_SHARES[-1] * PlannerOptions().safety_margin_m:
                return f"{text}: choose another place; or robot.srdf says that these may touch"
        return f"{text}; none is clear, not singular, and can follow a short leg"

    def _nearest(self, task: ToolTask) -> str:
        """How far the nearest posture is off a task, and where it has the tool."""
        left = _RANGE_LEFT * np.where(np.isfinite(self._limits.range_half), self._limits.range_half, 0.0)
        limits = replace(self._limits, lower=self._limits.lower + left, upper=self._limits.upper - left)
        begin = sampled_postures(limits.lower, limits.upper, 1)[0]
        robot, goals = replace(self._robot, limits=limits), task.goals(np.zeros(1))
        if (missed := worst_missed(robot, task, goals, begin)) is None:
            return ""
        where = ", ".join(f"{x:.4f}" for x in self._batch.tool_at(missed.best[None]).tool_point[0])
        return f"; {missed.off(task.keep)}, at ({where}) m"

    def _too_weak(self, q: FloatArray) -> str:
        """The joint that is too weak in the posture of `q` (N, n) that comes nearest, its need and limit."""
        needs = np.abs(self._batch.at(q).joint_torque)
        use = needs / self._limits.torque
        k = int(use.max(axis=1).argmin())
        joint = int(use[k].argmax())
        unit = self._limits.units(joint).torque
        need, limit = (f"{value:.3g} {unit}" for value in (needs[k, joint], self._limits.torque[joint]))
        return (
            f"at best {self._robot.joints[joint]} needs {need} to hold the arm at rest, and has {limit}, of "
            f"which {_TORQUE_USE:.0%} may be used; effort in a joint-limits file is its effort"
        )

    def _followed(self, task: ToolTask, posture: FloatArray, points: FloatArray) -> FloatArray | None:
        """Postures that hold the tool at `points` (N, 3), each from the one before; None where one fails."""
        q = [posture]
        for goal in ToolPoses(point=points, rotation=task.path.poses([0.0]).rotation):
            step, reached = project_onto_task(self._batch, task, q[-1][None], goal, steps=10)
            if not reached[0] or not self._within(step)[0] or self._singular_value(step[0]) < _MIN_VALUE:
                return None
            q.append(step[0])
        followed = np.array(q[1:])
        return followed if self._strong(followed).all() else None

    def _room(self, q: FloatArray) -> FloatArray:
        """How far (N, n) joints are from the nearer end of their ranges, rad or m."""
        return np.minimum(q - self._limits.lower, self._limits.upper - q)

    def _within(self, q: FloatArray) -> BoolArray:
        half = np.where(np.isfinite(self._limits.range_half), self._limits.range_half, 0.0)
        return np.asarray((self._room(q) >= _RANGE_LEFT * half).all(axis=1))

    def _strong(self, q: FloatArray) -> BoolArray:
        return self._cell.strong(self._batch.at(q), _TORQUE_USE)

    def _singular_value(self, q: FloatArray) -> float:
        at = self._batch.tool_at(q[None])
        return _task(at.tool_point[0], at.tool_rotation[0], self.keep).smallest_singular_value(self._robot, q)
