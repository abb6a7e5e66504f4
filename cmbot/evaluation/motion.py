"""A motion given by points in time, as the curve through them that is judged."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from cmbot.common.arrays import FloatArray
from cmbot.common.representation import short_repr
from cmbot.scene import StrokeFile
from cmbot.trajectory import QuinticTrajectory

# Times in each interval at which two curves are compared.
_COMPARED_TIMES_PER_INTERVAL = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class JointMotion:
    """Points of a motion, in the order of the robot's joints.

    Attributes
    ----------
    t : (N,), s
    q : (N, n), rad, of joints that slide m
    v, a : (N, n) or None
        Where they are given.
    unknown : tuple of str
        What of a file was not read: columns, joints that are none of the arm's.
    strokes : tuple of StrokeFile
        Of the plan whose motion it is, with the time laws that it chose; empty: it is of no plan.
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray | None = None
    a: FloatArray | None = None
    unknown: tuple[str, ...] = ()
    strokes: tuple[StrokeFile, ...] = ()

    __repr__ = short_repr

    @property
    def is_quintic(self) -> bool:
        """Whether it is the quintics of its velocities and accelerations; else the C2 spline."""
        return self.v is not None and self.a is not None

    @cached_property
    def spline(self) -> QuinticTrajectory:
        """The cubic spline through the points; at rest at both ends where no velocity is given there."""
        return QuinticTrajectory.through(
            self.t - self.t[0], self.q, None if self.v is None else self.v[[0, -1]]
        )

    @cached_property
    def trajectory(self) -> QuinticTrajectory:
        """The curve that is judged, from time 0.

        Raises
        ------
        InputError
            When times do not increase, or a number is not finite.
        """
        if self.v is not None and self.a is not None:
            return QuinticTrajectory(t=self.t - self.t[0], q=self.q, v=self.v, a=self.a)
        return self.spline

    @property
    def spread(self) -> float:
        """Largest distance of a joint between the curves that a controller may drive, rad and m.

        Those are the C2 spline and what the given velocities, and accelerations, make. 0 where only positions
        are given.
        """
        if self.v is None:
            return 0.0
        t = self.t - self.t[0]
        shares = np.arange(_COMPARED_TIMES_PER_INTERVAL) / _COMPARED_TIMES_PER_INTERVAL
        every = np.append((t[:-1, None] + shares * np.diff(t)[:, None]).ravel(), t[-1])
        other = CubicHermiteSpline(t, self.q, self.v)(every)
        if self.is_quintic:
            other = self.trajectory.evaluate(every)
        return float(np.abs(self.spline.evaluate(every) - other).max())
