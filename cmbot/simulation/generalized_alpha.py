"""Generalized-alpha integration of elastic coordinates with driven joints (Chung and Hulbert, 1993).

In the form of Arnold and Brüls (2007): the equation of motion holds at every step, and the method's auxiliary
acceleration is `a`::

    (1 - alpha_m) a' + alpha_m a = (1 - alpha_f) qdd' + alpha_f qdd
    q'  = q + h qd + h^2 ((1/2 - beta) a + beta a')
    qd' = qd + h ((1 - gamma) a + gamma a')

It is of second order and unconditionally stable for linear systems. `rho_inf` is the spectral radius at
infinite frequency: the factor by which a step damps motions that it cannot resolve.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dpotrf, dpotrs

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import SimulationDiverged
from cmbot.elastic.arm import ElasticArm
from cmbot.simulation.prescribed_motion import PrescribedMotion

__all__ = ["ElasticMotion", "ElasticSystem", "GeneralizedAlpha"]

# Displacement, m or rad, beyond which the model of springs between rigid bodies is not valid.
_MAX_DISPLACEMENT = 1.0
# Steps between two reports of progress.
_PROGRESS_STEPS = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticSystem:
    """A mechanism of d driven and f elastic coordinates; configurations are vectors.

    Its equation of motion, with q_a prescribed, is that of the elastic coordinates alone::

        (M_ff + added_mass) qdd_f = - stiffness q_f - damping qd_f - h_f(q, qd) - M_fa qdd_a

    The force on the tool is part of h_f.
    """

    model: Any  # pinocchio.Model
    driven: IntArray  # (d,), indices of the driven coordinates
    elastic: IntArray  # (f,), indices of the others
    stiffness: FloatArray  # (f, f), symmetric
    damping: FloatArray  # (f, f), symmetric
    added_mass: FloatArray  # (f, f), symmetric: mass outside the model, such as the guardrail's own
    external_forces: Any = None  # by joint, in their frames; None without

    @classmethod
    def of(cls, arm: ElasticArm, damping: FloatArray) -> ElasticSystem:
        """Return the system of an arm with a damping matrix (f, f)."""
        shared = ("model", "driven", "elastic", "stiffness", "added_mass", "external_forces")
        return cls(damping=damping, **{name: getattr(arm, name) for name in shared})


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticMotion:
    """The motion of a system at every step."""

    t: FloatArray  # (N,), s
    joints: FloatArray  # (N, d), rad: the driven coordinates
    u: FloatArray  # (N, f): the elastic coordinates, m and rad
    v: FloatArray  # (N, f): their rates
    a: FloatArray  # (N, f): their accelerations


class GeneralizedAlpha:
    """The integrator of one system; it owns working memory, so threads must not share it.

    No step is longer than `step`, s. `rho_inf` is the spectral radius at infinite frequency, 0 to 1: 1 damps
    nothing. `corrections` is the number of Newton corrections a step.
    """

    def __init__(self, system: ElasticSystem, *, step: float, rho_inf: float, corrections: int) -> None:
        self._system, self._step, self._corrections = system, step, corrections
        self._alpha_m = (2 * rho_inf - 1) / (rho_inf + 1)
        self._alpha_f = rho_inf / (rho_inf + 1)
        self._gamma = 0.5 + self._alpha_f - self._alpha_m
        self._beta = 0.25 * (self._gamma + 0.5) ** 2
        f, n = len(system.elastic), system.model.nv
        self._external = system.external_forces
        if self._external is None:
            self._external = pin.StdVec_Force()
            self._external.extend([pin.Force.Zero()] * system.model.njoints)
        self._data = system.model.createData()
        # Rows act on accelerations, displacements and rates, stacked in this order in `_state`.
        self._linear = np.hstack([system.added_mass, system.stiffness, system.damping])
        self._state = np.zeros(3 * f)
        self._q, self._v, self._a = np.zeros(n), np.zeros(n), np.zeros(n)
        self._block = (system.elastic[:, None] * n + system.elastic).ravel()
        self._mass, self._force = np.empty((f, f)), np.empty(f)

    def run(
        self,
        motions: Sequence[PrescribedMotion],
        u: FloatArray,
        v: FloatArray,
        progress: Callable[[float], None] | None = None,
        forces: Sequence[Any] | None = None,
    ) -> ElasticMotion:
        """Integrate along prescribed motions, one after the other, from `u` and `v` (f,).

        Each continues the one before in position and velocity. Where the acceleration jumps, a step ends.
        `forces` are the external ones along each motion, in place of the system's.
        `progress` is called every 100 steps with the time that has been reached, s.

        Raises
        ------
        SimulationDiverged
            When the state is not finite or outside the validity of the model.
        """
        parts, start = [], 0.0
        # An overflow shows in the state, which every step checks.
        with np.errstate(over="ignore", invalid="ignore"):
            for number, motion in enumerate(motions):
                if forces is not None:
                    self._external = forces[number]
                part = self._along(motion, u, v, start, progress or (lambda _: None))
                u, v, start = part.u[-1], part.v[-1], start + motion.duration
                parts.append(part)
        first, *others = parts

        def joined(name: str) -> FloatArray:
            # At a junction the state is the same; of the two accelerations the earlier is kept.
            return np.concatenate([getattr(first, name), *(getattr(part, name)[1:] for part in others)])

        return ElasticMotion(**{field.name: joined(field.name) for field in fields(ElasticMotion)})

    def _along(
        self,
        motion: PrescribedMotion,
        u: FloatArray,
        v: FloatArray,
        start: float,
        progress: Callable[[float], None],
    ) -> ElasticMotion:
        steps = max(int(np.ceil(motion.duration / self._step * (1 - 1e-12))), 1)
        h = motion.duration / steps
        t = np.linspace(0.0, motion.duration, steps + 1)
        joints, rates, accelerations = motion.states(t)
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
            # The predictor keeps the acceleration.
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
            # Also false for NaN.
            if not abs(us[k]).max() < _MAX_DISPLACEMENT:
                raise SimulationDiverged(time=start + float(t[k]), state=us[k].tolist())
            if k % _PROGRESS_STEPS == 0:
                progress(start + float(t[k]))
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
            if failed:  # not positive definite: the check of the next state raises, with its time
                return np.full(f, np.nan)
        force = pin.rnea(system.model, self._data, self._q, self._v, self._a, self._external)
        force.take(elastic, out=self._force, mode="clip")
        self._force += self._linear @ state
        change, _ = dpotrs(self._factor, self._force)
        return np.asarray(-change)
