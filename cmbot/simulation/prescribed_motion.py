"""The motion that is prescribed to the joints: position, velocity and acceleration that are consistent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.planning import QuinticTrajectory

# scipy.interpolate is slow to import and planning does not need it: it is imported where it is used.
if TYPE_CHECKING:
    from scipy.interpolate import PPoly

__all__ = ["PrescribedMotion"]


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
