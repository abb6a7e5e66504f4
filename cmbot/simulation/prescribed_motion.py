"""The motion that is prescribed to the joints: position, velocity and acceleration that are consistent.

Along one stroke, or over the whole work of a plan.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.planning import Plan, QuinticTrajectory
from cmbot.toolpath import ToolPath

# scipy.interpolate is slow to import and planning does not need it: it is imported where it is used.
if TYPE_CHECKING:
    from scipy.interpolate import PPoly

# Share of a time by which it may be off, by rounding.
_TIME_ROUNDING_SHARE = 1e-12


@dataclass(frozen=True, eq=False)
class PrescribedMotion:
    """Joint positions as piecewise polynomials of time; rates and accelerations are their exact derivatives.

    Attributes
    ----------
    curve : scipy.interpolate.PPoly
        From 0 to `duration`, s; its value is (n,), rad.
    """

    curve: PPoly

    @classmethod
    def along(cls, trajectory: QuinticTrajectory) -> PrescribedMotion:
        """Return the motion of a trajectory, exactly; it starts at time 0."""
        from scipy.interpolate import PPoly

        h = np.diff(trajectory.t)
        powers = np.arange(5, -1, -1)
        c = trajectory.coefficients[:, :, powers].transpose(2, 0, 1) / h[:, None] ** powers[:, None, None]
        return cls(PPoly(c, trajectory.t - trajectory.t[0], extrapolate=False))

    @classmethod
    def through(cls, t: FloatArray, q: FloatArray) -> PrescribedMotion:
        """Return a motion through sampled positions, from rest to rest.

        The curve is the clamped cubic spline: velocity and acceleration are continuous and belong to the
        positions. The baseline's own rates are not used: by the Euler steps of Eq. (22) they are mean rates
        to the next sample. As they are, the joint velocity would jump every 0.01 s; taken as rates at the
        samples they would lead the positions by half a step.

        Parameters
        ----------
        t : (N,), s
            Increasing, from 0.
        q : (N, n), rad

        Raises
        ------
        InputError
            When the shapes do not fit, times do not increase from 0, or a number is not finite.
        """
        source = "PrescribedMotion.through"
        ordered = t.ndim == 1 and len(t) >= 2 and t[0] == 0.0 and bool((np.diff(t) > 0).all())
        if not ordered or not np.isfinite(t).all():
            raise InputError(source, "t", "other times", "two or more finite times, increasing from 0")
        if q.ndim != 2 or len(q) != len(t) or not np.isfinite(q).all():
            raise InputError(source, "q", f"shape {q.shape}", f"finite numbers, ({len(t)}, n)")
        from scipy.interpolate import CubicSpline

        return cls(CubicSpline(t, q, bc_type="clamped", extrapolate=False))

    @classmethod
    def held(cls, q: FloatArray, seconds: float) -> PrescribedMotion:
        """Return the motion that holds the joints at `q` (n,), rad, for `seconds`."""
        from scipy.interpolate import PPoly

        return cls(PPoly(q[None, None, :], np.array([0.0, seconds]), extrapolate=False))

    @property
    def duration(self) -> float:
        """How long it moves, s."""
        return float(self.curve.x[-1])

    @property
    def end(self) -> FloatArray:
        """The last posture, (n,), rad."""
        return np.asarray(self.curve(self.duration))

    def states(self, times: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration at `times` (N,) from 0 to `duration`, each (N, n).

        At the ends these are the limits from within: the acceleration may differ before and after.
        """
        t: FloatArray = np.clip(np.asarray(times, dtype=np.float64), 0.0, self.duration)
        return self.curve(t), self.curve(t, 1), self.curve(t, 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class WorkPart:
    """A stroke, or a free move between strokes, where the tool is off.

    Attributes
    ----------
    motion : PrescribedMotion
        Its own clock begins at 0.
    path : ToolPath or None
        That of the stroke; None on a free move.
    begin : float, s
        When it begins on the clock of the work.
    """

    motion: PrescribedMotion
    path: ToolPath | None
    begin: float


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
    def of(cls, each: Iterable[tuple[PrescribedMotion, ToolPath | None]]) -> PrescribedWork:
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
        return cls.of(
            (PrescribedMotion.along(segment.trajectory), paths.get(segment.name))
            for segment in plan.work.segments
        )

    @classmethod
    def baseline(cls, plan: Plan) -> PrescribedWork | None:
        """Return the baseline, its strokes and its free moves through their samples; None without one."""
        if plan.baseline is None:
            return None
        names = (stroke.name for stroke in plan.strokes)
        paths = {name: task.path for name, task in zip(names, plan.baseline_tasks, strict=True)}
        return cls.of(
            (PrescribedMotion.through(segment.samples.t, segment.samples.q), paths.get(segment.name))
            for segment in plan.baseline.work
        )

    @property
    def duration(self) -> float:
        """How long the joints move, s."""
        return self.parts[-1].begin + self.parts[-1].motion.duration

    @property
    def end(self) -> FloatArray:
        """The last posture, (n,), rad."""
        return self.parts[-1].motion.end

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
        q = np.empty((len(times), len(self.end)))
        for part, at, t in self.split(times):
            q[at] = part.motion.states(t)[0]
        return q
