"""What prescribes the joints: position, velocity and acceleration that belong together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.planning import QuinticTrajectory

# scipy.interpolate takes a while to come, and who only plans has no use for it: it is imported where it is
# needed.
if TYPE_CHECKING:
    from scipy.interpolate import PPoly

__all__ = ["PrescribedMotion", "drive_along", "drive_through", "held"]


@dataclass(frozen=True, eq=False)
class PrescribedMotion:
    """Joint positions as piecewise polynomials of time; rates and accelerations are their exact derivatives.

    Attributes
    ----------
    curve : scipy.interpolate.PPoly
        From 0 to `duration`, s; its value is (n,), rad.
    """

    curve: PPoly

    @property
    def duration(self) -> float:
        """How long it moves, s."""
        return float(self.curve.x[-1])

    def states(self, times: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration at `times` (N,) from 0 to `duration`, each (N, n).

        At either end these are the limits from within: what comes before and after may have another
        acceleration.
        """
        t: FloatArray = np.clip(np.asarray(times, dtype=np.float64), 0.0, self.duration)
        return self.curve(t), self.curve(t, 1), self.curve(t, 2)


def drive_along(trajectory: QuinticTrajectory) -> PrescribedMotion:
    """Drive the joints along a trajectory, exactly."""
    from scipy.interpolate import PPoly

    h = np.diff(trajectory.t)
    powers = np.arange(5, -1, -1)
    c = trajectory.coefficients[:, :, powers].transpose(2, 0, 1) / h[:, None] ** powers[:, None, None]
    return PrescribedMotion(PPoly(c, trajectory.t - trajectory.t[0], extrapolate=False))


def drive_through(t: FloatArray, q: FloatArray) -> PrescribedMotion:
    """Drive the joints through sampled positions, from rest to rest.

    The curve is the cubic spline through the positions: they are met exactly, velocity and acceleration are
    continuous and belong to them. The baseline's own rates are not used. By Eq. (22)'s Euler steps they are
    the mean rates to the next sample, not the rates at the samples; taken literally they would make the
    joints jump in velocity every 0.01 s, and taken as rates at the samples they would lead half a step
    away from the positions. The spline's ends are at rest because the arm is, before and after.

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
    ordered = t.ndim == 1 and len(t) >= 2 and t[0] == 0.0 and bool((np.diff(t) > 0).all())
    if not ordered or not np.isfinite(t).all():
        raise InputError("drive_through", "t", "other times", "two or more finite times, increasing from 0")
    if q.ndim != 2 or len(q) != len(t) or not np.isfinite(q).all():
        raise InputError("drive_through", "q", f"shape {q.shape}", f"finite numbers, ({len(t)}, n)")
    from scipy.interpolate import CubicSpline

    return PrescribedMotion(CubicSpline(t, q, bc_type="clamped", extrapolate=False))


def held(q: FloatArray, seconds: float) -> PrescribedMotion:
    """Hold the joints at `q` (n,), rad, for `seconds`."""
    from scipy.interpolate import PPoly

    return PrescribedMotion(PPoly(q[None, None, :], np.array([0.0, seconds]), extrapolate=False))
