"""Where the strokes of a scene are in a motion, and how far its tool is from a path in another timing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning import ToolTask
from cmbot.robot import Kinematics, Robot
from cmbot.scene import PlannerOptions
from cmbot.toolpath import ToolPath
from cmbot.trajectory import QuinticTrajectory

# A joint that uses less of its bound of velocity rests.
_RESTING_VELOCITY_SHARE = 1e-3
# Times of a stroke at which the tool is compared with its timed place, and by what share of the path's length
# it may miss it, beside what the options allow: more is another timing.
_TIMES_OF_STROKE, _OTHER_TIMING = 200, 0.02
# A stroke in another timing covers so much of its path at least.
_MIN_PATH_SHARE = 0.9
# Points of a path, and of a motion, between which lines are drawn.
_PATH_POINTS, _MOTION_POINTS = 2000, 1000
# Times that differ by less, s, are the same: messages have whole nanoseconds.
_SAME_TIME_S = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A part of a motion from rest to rest.

    Attributes
    ----------
    begin, end : float, s
        On the clock of the motion.
    number : int or None
        Of the stroke, from 0; None of a free move.
    is_timed : bool
        The tool is where the scene has it at each time.
    """

    begin: float
    end: float
    number: int | None = None
    is_timed: bool = True


def parts_of_motion(
    robot: Robot, trajectory: QuinticTrajectory, tasks: Sequence[ToolTask], options: PlannerOptions
) -> list[Part]:
    """Return the strokes in a motion, which come in their order, and the free moves around them.

    A stroke begins and ends where the motion rests: where the tool follows its timed path best, or, if it
    follows none in that timing, between the places nearest to the ends of its path.
    """
    rests = _rests(robot, trajectory)
    parts, at = list[Part](), float(trajectory.t[0])
    for number, task in enumerate(tasks):
        others = len(tasks) - number - 1
        part = _timed_part(robot, trajectory, task, rests[rests >= at], options)
        part = part or _nearest_part(robot, trajectory, task, rests[rests >= at], last=others == 0)
        if part is None:
            continue
        if part.begin > at:
            parts.append(Part(begin=at, end=part.begin))
        parts.append(Part(begin=part.begin, end=part.end, number=number, is_timed=part.is_timed))
        at = part.end
    end = float(trajectory.t[-1])
    if end > at or not parts:
        parts.append(Part(begin=at, end=end))
    return parts


def cut(trajectory: QuinticTrajectory, begin: float, end: float, duration: float) -> QuinticTrajectory:
    """Return a part of a trajectory on a clock of its own, of `duration` s, as far as rounding goes."""
    inside = trajectory.t[(trajectory.t > begin + _SAME_TIME_S) & (trajectory.t < end - _SAME_TIME_S)]
    t = np.concatenate([[begin], inside, [end]])
    q, v, a = trajectory.states(t)
    own = (t - begin) * (duration / (end - begin))
    own[-1] = duration
    return QuinticTrajectory(t=own, q=q, v=v, a=a)


def _rests(robot: Robot, trajectory: QuinticTrajectory) -> FloatArray:
    """Times of the knots at which all joints rest; both ends count."""
    still = np.asarray((np.abs(trajectory.v) <= _RESTING_VELOCITY_SHARE * robot.limits.velocity).all(axis=1))
    still[[0, -1]] = True
    return np.asarray(trajectory.t[still])


def _timed_part(
    robot: Robot, trajectory: QuinticTrajectory, task: ToolTask, rests: FloatArray, options: PlannerOptions
) -> Part | None:
    """Where a motion follows a timed path."""
    path, kinematics = task.path, Kinematics(robot)
    share, end = np.linspace(0.0, 1.0, _TIMES_OF_STROKE), float(trajectory.t[-1])
    begins = rests[rests + path.duration <= end + _SAME_TIME_S]
    if not len(begins):
        return None
    places = path.position(share * path.duration)
    # What is far at the beginning is no candidate.
    points = kinematics.tool_poses(trajectory.evaluate(begins))[0]
    near = np.linalg.norm(points - places[0], axis=1)
    allowed = options.max_tool_deviation_m + options.max_tool_lag_m
    allowed += _OTHER_TIMING * float(path.lengths.sum())
    spreads = list[tuple[float, float]]()
    for begin in begins[near <= allowed]:
        t = np.minimum(begin + share * path.duration, end)
        away = kinematics.tool_poses(trajectory.evaluate(t))[0] - places
        if np.linalg.norm(away, axis=1).max() <= allowed:
            # A tool beside its path all along, as where sag is compensated, is not late.
            spreads.append((float(away.var(axis=0).sum()), float(begin)))
    if not spreads:
        return None
    _, begin = min(spreads)
    finish = begin + path.duration
    knot = float(rests[np.abs(rests - finish).argmin()])
    return Part(begin=begin, end=knot if abs(knot - finish) <= _SAME_TIME_S else min(finish, end))


def _nearest_part(
    robot: Robot, trajectory: QuinticTrajectory, task: ToolTask, rests: FloatArray, *, last: bool
) -> Part | None:
    """Where a motion leads along a path in another timing; None where it does not come that far."""
    t = np.union1d(rests, np.linspace(rests[0], trajectory.t[-1], _MOTION_POINTS)) if len(rests) else rests
    if len(t) < 2:
        return None
    points = Kinematics(robot).tool_poses(trajectory.evaluate(t))[0]
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    places, resting = task.path.position([0.0, task.path.duration]), np.flatnonzero(np.isin(t, rests))
    away = np.linalg.norm(points[resting, None] - places, axis=2)
    first = int(away[:, 0].argmin())
    far = travelled[resting] - travelled[resting[first]] >= _MIN_PATH_SHARE * float(task.path.lengths.sum())
    ends = np.flatnonzero(far & (np.arange(len(resting)) > first))
    if not len(ends):
        return None
    nearest = away[ends, 1]
    # A path that ends where it begins is passed to its last visit there.
    among = ends[nearest <= nearest.min() + _SAME_TIME_S]
    end = int(among[-1 if last else 0])
    return Part(begin=float(t[resting[first]]), end=float(t[resting[end]]), is_timed=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class FollowedPath:
    """A tool path as a motion follows it in a timing of its own: the nearest place counts.

    Attributes
    ----------
    path : ToolPath
    robot : Robot
    trajectory : QuinticTrajectory
        Of the stroke, from time 0.
    """

    path: ToolPath
    robot: Robot
    trajectory: QuinticTrajectory

    @property
    def duration(self) -> float:
        """Of the motion, s."""
        return self.trajectory.duration

    def leg_directions(self, times: FloatArray) -> FloatArray:
        """Return unit vectors (N, 3) along the path at its places nearest to the tool at `times` (N,)."""
        points = Kinematics(self.robot).tool_poses(self.trajectory.evaluate(times))[0]
        return np.asarray(self.path.leg_directions(self.nearest(points)))

    def leg_offset(self, times: FloatArray, p: FloatArray) -> FloatArray:
        """Return the vectors (N, 3), m, to points `p` (N, 3) from the nearest places of the path."""
        return np.asarray(self.path.leg_offset(self.nearest(p), p))

    def nearest(self, points: FloatArray) -> FloatArray:
        """Return the times (N,) on the path's own clock at which it is nearest to points (N, 3)."""
        t, places = self._outline
        found = np.empty(len(points))
        for k, distance, share in self._distances(points, places):
            piece = int(distance.argmin())
            found[k] = t[piece] + share[piece] * (t[piece + 1] - t[piece])
        return found

    def largest_offsets(self, task: ToolTask) -> tuple[float, float]:
        """Return the largest distance, m, and rotation, rad, of the tool from the path, at samples."""
        t = np.linspace(self.trajectory.t[0], self.trajectory.t[-1], _MOTION_POINTS)
        points, R_WT = Kinematics(self.robot).tool_poses(self.trajectory.evaluate(t))
        on_path = self.nearest(points)
        away = np.linalg.norm(self.path.leg_offset(on_path, points), axis=1)
        return float(away.max()), float(task.rotation(R_WT, self.path.poses(on_path)).max())

    @cached_property
    def _outline(self) -> tuple[FloatArray, FloatArray]:
        t = np.union1d(np.linspace(0.0, self.path.duration, _PATH_POINTS), self.path.leg_times)
        return t, self.path.position(t)

    @staticmethod
    def _distances(points: FloatArray, places: FloatArray) -> Iterator[tuple[int, FloatArray, FloatArray]]:
        """Yield of each point its number, and its distances from the lines between places, with shares."""
        edges = np.diff(places, axis=0)
        lengths = np.maximum((edges**2).sum(axis=1), np.finfo(float).tiny)
        for k, point in enumerate(points):
            away = point - places[:-1]
            share = np.clip((away * edges).sum(axis=1) / lengths, 0.0, 1.0)
            yield k, np.linalg.norm(away - share[:, None] * edges, axis=1), share
