"""Generalized-alpha integration of springs behind driven joints (Chung and Hulbert, 1993).

In the form of Arnold and Brüls (2007): the equation of motion holds at every step, and a filtered
acceleration `a` carries the method's memory::

    (1 - alpha_m) a' + alpha_m a = (1 - alpha_f) qdd' + alpha_f qdd
    q'  = q + h qd + h^2 ((1/2 - beta) a + beta a')
    qd' = qd + h ((1 - gamma) a + gamma a')

It is of second order, unconditionally stable for linear systems, and damps what is too fast for the step:
`rho_inf` is the factor by which it shrinks the infinitely fast at each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dpotrf, dpotrs

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SimulationDiverged
from cmbot.simulation.drive import PrescribedMotion
from cmbot.simulation.system import ElasticSystem

__all__ = ["ElasticMotion", "GeneralizedAlpha"]

# Bent further than this, m or rad, springs between rigid bodies mean nothing any more.
_FURTHEST = 1.0
# Steps from one report of progress to the next.
_REPORTED = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticMotion:
    """The motion of a system, step by step.

    Attributes
    ----------
    t : (N,), s
    joints : (N, d), rad
        The driven coordinates.
    u, v, a : (N, f)
        The elastic coordinates, their rates and accelerations: m and rad, over s and s2.
    """

    t: FloatArray
    joints: FloatArray
    u: FloatArray
    v: FloatArray
    a: FloatArray


class GeneralizedAlpha:
    """The integrator of one system; it owns working memory, so it is not to be shared between threads.

    Parameters
    ----------
    system : ElasticSystem
    step : float, s
        No step is longer.
    rho_inf : float
        Spectral radius at infinite frequency, 0 to 1: 1 damps nothing.
    corrections : int
        Newton corrections a step.
    """

    def __init__(self, system: ElasticSystem, *, step: float, rho_inf: float, corrections: int) -> None:
        self._system, self._step, self._corrections = system, step, corrections
        self._alpha_m = (2 * rho_inf - 1) / (rho_inf + 1)
        self._alpha_f = rho_inf / (rho_inf + 1)
        self._gamma = 0.5 + self._alpha_f - self._alpha_m
        self._beta = 0.25 * (self._gamma + 0.5) ** 2
        f, n = len(system.elastic), system.model.nv
        self._data = system.model.createData()
        # Rows act on accelerations, displacements and rates, stacked in this order in `_state`.
        self._linear = np.hstack([system.added_mass, system.stiffness, system.damping])
        self._state = np.zeros(3 * f)
        self._q, self._v, self._a = np.zeros(n), np.zeros(n), np.zeros(n)
        self._block = (system.elastic[:, None] * n + system.elastic).ravel()
        self._mass, self._force = np.empty((f, f)), np.empty(f)

    def run(
        self,
        drives: Sequence[PrescribedMotion],
        u: FloatArray,
        v: FloatArray,
        tell: Callable[[float], None] | None = None,
    ) -> ElasticMotion:
        """Integrate along drives, one after the other.

        Each joins the last in position and velocity; acceleration may jump in between, and there the step
        ends and begins anew.

        Parameters
        ----------
        drives : sequence of PrescribedMotion
        u, v : (f,)
            The elastic coordinates and their rates at first.
        tell : callable, optional
            Called every so often with the time that has been reached, s.

        Raises
        ------
        SimulationDiverged
            When the state is not finite or far beyond what the model can mean.
        """
        parts, start = [], 0.0
        # What overflows on the way is found by the look at every state.
        with np.errstate(over="ignore", invalid="ignore"):
            for drive in drives:
                part = self._along(drive, u, v, start, tell or (lambda _: None))
                u, v, start = part.u[-1], part.v[-1], start + drive.duration
                parts.append(part)
        first, *others = parts
        # Where two meet, the state is the same and the acceleration that of the earlier.
        return ElasticMotion(
            t=np.concatenate([first.t, *(part.t[1:] for part in others)]),
            joints=np.vstack([first.joints, *(part.joints[1:] for part in others)]),
            u=np.vstack([first.u, *(part.u[1:] for part in others)]),
            v=np.vstack([first.v, *(part.v[1:] for part in others)]),
            a=np.vstack([first.a, *(part.a[1:] for part in others)]),
        )

    def _along(
        self,
        drive: PrescribedMotion,
        u: FloatArray,
        v: FloatArray,
        start: float,
        tell: Callable[[float], None],
    ) -> ElasticMotion:
        steps = max(int(np.ceil(drive.duration / self._step * (1 - 1e-12))), 1)
        h = drive.duration / steps
        t = np.linspace(0.0, drive.duration, steps + 1)
        joints, rates, accelerations = drive.states(t)
        f = len(u)
        us, vs, as_ = (np.empty((steps + 1, f)) for _ in range(3))
        alpha_m, alpha_f, beta, gamma = self._alpha_m, self._alpha_f, self._beta, self._gamma
        share = (1 - alpha_f) / (1 - alpha_m)
        to_v, to_u = h * gamma * share, h**2 * beta * share
        system = self._system
        tangent = system.added_mass + to_u * system.stiffness + to_v * system.damping
        state = self._state
        qdd, u1, v1 = state[:f], state[f : 2 * f], state[2 * f :]
        qdd[:], u1[:], v1[:] = 0.0, u, v
        self._prescribe(joints[0], rates[0], accelerations[0])
        qdd += self._correction(system.added_mass, refactor=True)
        a = qdd.copy()
        us[0], vs[0], as_[0] = u1, v1, qdd
        for k in range(1, steps + 1):
            # The first guess: the acceleration stays what it is.
            a1 = (qdd - alpha_m * a) / (1 - alpha_m)
            u1 += h * v1
            u1 += h**2 * ((0.5 - beta) * a + beta * a1)
            v1 += h * ((1 - gamma) * a + gamma * a1)
            self._prescribe(joints[k], rates[k], accelerations[k])
            for correction in range(self._corrections):
                change = self._correction(tangent, refactor=correction == 0)
                qdd += change
                u1 += to_u * change
                v1 += to_v * change
                a1 += share * change
            a = a1
            us[k], vs[k], as_[k] = u1, v1, qdd
            # False for what is not a number, too.
            if not abs(us[k]).max() < _FURTHEST:
                raise SimulationDiverged(time=start + float(t[k]), state=us[k].tolist())
            if k % _REPORTED == 0:
                tell(start + float(t[k]))
        return ElasticMotion(t=start + t, joints=joints, u=us, v=vs, a=as_)

    def _prescribe(self, q: FloatArray, v: FloatArray, a: FloatArray) -> None:
        driven = self._system.driven
        self._q[driven], self._v[driven], self._a[driven] = q, v, a

    def _correction(self, tangent: FloatArray, *, refactor: bool) -> FloatArray:
        """Change of the accelerations (f,) by one Newton step with the matrix M_ff + `tangent`."""
        system, state, f = self._system, self._state, len(self._force)
        elastic = system.elastic
        self._a[elastic], self._q[elastic], self._v[elastic] = state[:f], state[f : 2 * f], state[2 * f :]
        if refactor:
            M = pin.crba(system.model, self._data, self._q)
            M.take(self._block, out=self._mass.reshape(-1), mode="clip")
            self._mass += tangent
            self._factor, failed = dpotrf(self._mass.T, overwrite_a=True, clean=False)
            if failed:  # no mass moves like that; the look at the state that follows says when
                return np.full(f, np.nan)
        pin.rnea(system.model, self._data, self._q, self._v, self._a).take(
            elastic, out=self._force, mode="clip"
        )
        self._force += self._linear @ state
        change, _ = dpotrs(self._factor, self._force)
        return np.asarray(-change)
