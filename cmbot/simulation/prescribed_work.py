"""The motion that is prescribed to the joints over the whole work of a plan."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.planning import Plan, force_share
from cmbot.robot import Robot
from cmbot.toolpath import ToolPath
from cmbot.trajectory import QuinticTrajectory

# Share of a time by which it may be off, by rounding.
_TIME_ROUNDING_SHARE = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class WorkPart:
    """A stroke, or a free move between strokes, where the tool is off.

    Attributes
    ----------
    motion : QuinticTrajectory
        Its own clock begins at 0.
    path : ToolPath or None
        That of the stroke; None on a free move.
    begin : float, s
        When it begins on the clock of the work.
    """

    motion: QuinticTrajectory
    path: ToolPath | None
    begin: float

    def force_share(self, robot: Robot, times: FloatArray) -> FloatArray:
        """Return the share of the process force at `times` (N,) on its own clock."""
        if self.path is not None:
            return np.ones_like(times)
        return force_share(robot, times, self.motion.duration)

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration at `times` (N,) on its own clock, after it its last."""
        return self.motion.states(np.minimum(times, self.motion.duration))


@dataclass(frozen=True, eq=False)
class PrescribedWork:
    """What the joints do from the beginning of the first stroke to the end of the last one.

    Attributes
    ----------
    parts : tuple of WorkPart
        One after the other, the first from time 0; they join at rest.
    """

    parts: tuple[WorkPart, ...]

    @classmethod
    def of(cls, each: Iterable[tuple[QuinticTrajectory, ToolPath | None]]) -> PrescribedWork:
        """Return the work of motions one after the other, each with its path, None on a free move."""
        parts, begin = list[WorkPart](), 0.0
        for motion, path in each:
            parts.append(WorkPart(motion=motion, path=path, begin=begin))
            begin += motion.duration
        return cls(tuple(parts))

    @classmethod
    def planned(cls, plan: Plan) -> PrescribedWork:
        """Return the planned motion, exactly."""
        paths = {stroke.name: stroke.task.path for stroke in plan.strokes}
        return cls.of((segment.trajectory, paths.get(segment.name)) for segment in plan.work.segments)

    @classmethod
    def baseline(cls, plan: Plan) -> PrescribedWork | None:
        """Return the baseline, its strokes and its free moves through their samples; None without one.

        Its own rates are not used: by the Euler steps of Eq. (22) they are mean rates to the next sample. As
        they are, the joint velocity would jump every 0.01 s; taken as rates at the samples they would lead
        the positions by half a step.
        """
        if plan.baseline is None:
            return None
        names = (stroke.name for stroke in plan.strokes)
        paths = {name: task.path for name, task in zip(names, plan.baseline_tasks, strict=True)}
        return cls.of(
            (QuinticTrajectory.through(segment.samples.t, segment.samples.q), paths.get(segment.name))
            for segment in plan.baseline.work
        )

    @property
    def duration(self) -> float:
        """How long the joints move, s."""
        return self.parts[-1].begin + self.parts[-1].motion.duration

    @property
    def end(self) -> FloatArray:
        """The last posture, (n,), rad."""
        return np.asarray(self.parts[-1].motion.q[-1])

    def split(self, times: FloatArray) -> Iterator[tuple[WorkPart, IntArray, FloatArray]]:
        """Yield each part in which some of `times` (N,) lie, their indices, and these times on its own clock.

        A join belongs to the stroke, all after the stop to the last part.
        """
        joins = [
            part.begin * (1 + _TIME_ROUNDING_SHARE if part.path is None else 1 - _TIME_ROUNDING_SHARE)
            for part in self.parts[1:]
        ]
        number = np.searchsorted(joins, times, side="right")
        for k, part in enumerate(self.parts):
            at = np.flatnonzero(number == k)
            if len(at):
                yield part, at, times[at] - part.begin

    def postures(self, times: FloatArray) -> FloatArray:
        """Return the joint positions at `times` (N,) from 0, (N, n), rad; after the stop the last ones."""
        return self.states(times)[0]

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `postures`, and the joint velocities there, rad/s; after the stop they are zero."""
        q, v = np.empty((2, len(times), len(self.end)))
        for part, at, t in self.split(times):
            q[at], v[at], _ = part.states(t)
        v[times > self.duration] = 0.0
        return q, v
