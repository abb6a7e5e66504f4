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
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dpotrf, dpotrs

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import SimulationDiverged
from cmbot.elastic.arm import ElasticArm

# Displacement, m or rad, beyond which the model of springs between rigid bodies is not valid.
_MAX_DISPLACEMENT = 1.0
# Steps of one length, between two reports of progress, and between two trials of a second correction.
_BLOCK, _RENEWED = 100, 10
# Share of the tolerance that the error of a longer step may have, and that from which they become twice as
# long: that makes it eight times as large.
_MAY_LACK, _LACKS_LITTLE = 1e-2, 1e-3


ExternalForces = Callable[[float], Any]
"""External forces by joint, in their frames, as pinocchio takes them, at a time, s."""


class DrivenMotion(Protocol):
    """What is prescribed to the driven coordinates."""

    @property
    def duration(self) -> float:
        """How long it moves, s."""

    def states(self, times: FloatArray, /) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, rates and accelerations at `times` (N,) from 0 to `duration`, each (N, d)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticSystem:
    """A mechanism of d driven and f elastic coordinates; configurations are vectors.

    Its equation of motion, with q_a prescribed, is that of the elastic coordinates alone::

        (M_ff + added_mass) qdd_f = - stiffness q_f - damping qd_f - h_f(q, qd) - (M_fa + added_coupling)
        qdd_a

    The force on the tool is part of h_f.
    """

    model: Any  # pinocchio.Model
    driven: IntArray  # (d,), indices of the driven coordinates
    elastic: IntArray  # (f,), indices of the others
    stiffness: FloatArray  # (f, f), symmetric
    damping: FloatArray  # (f, f), symmetric
    added_mass: FloatArray  # (f, f), symmetric: mass outside the model, such as the guardrail's own
    external_forces: Any = None  # by joint, in their frames; None without
    added_coupling: FloatArray | None = None  # (f, d): mass outside the model, which driven coordinates move

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


@dataclass(frozen=True, kw_only=True, eq=False)
class _Scheme:
    """The method with steps of one length.

    Rows of a state are acceleration, displacement, rate and auxiliary acceleration; the predictor keeps the
    first.
    """

    predictor: FloatArray  # (4, 4)
    corrector: FloatArray  # (4, 1): what a change of the acceleration makes of them
    tangent: FloatArray  # (f, f): of all forces by the acceleration, but those of the mass
    truncation: float  # s2

    def error(self, accelerations: FloatArray) -> float:
        """Largest error of a step in any coordinate, by the `accelerations` (N + 1, f) before and after each.

        What the displacement's next term of Taylor's series lacks (Hulbert and Jang, 1995).
        """
        return float(self.truncation * np.abs(np.diff(accelerations, axis=0)).max(initial=0.0))


class GeneralizedAlpha:
    """The integrator of one system; it owns working memory, so threads must not share it.

    No step is longer than `step`, s. `rho_inf` is the spectral radius at infinite frequency, 0 to 1: 1 damps
    nothing. `corrections` is the number of Newton corrections a step. With a `tolerance`, m or rad, all of
    them are tried every few steps only; where a second one moves nothing by more than that, the steps until
    then have one, with the mass matrix of the first of them. While their error is below a hundredth of the
    tolerance, steps are longer, up to `longest` times, a power of two.
    """

    def __init__(
        self,
        system: ElasticSystem,
        *,
        step: float,
        rho_inf: float,
        corrections: int,
        tolerance: float = 0.0,
        longest: int = 1,
    ) -> None:
        self._system, self._step, self._corrections = system, step, corrections
        self._tolerance, self._longest = tolerance, longest
        self._alpha_m = (2 * rho_inf - 1) / (rho_inf + 1)
        self._alpha_f = rho_inf / (rho_inf + 1)
        self._gamma = 0.5 + self._alpha_f - self._alpha_m
        self._beta = 0.25 * (self._gamma + 0.5) ** 2
        f, n = len(system.elastic), system.model.nv
        external = system.external_forces
        if external is None:
            external = pin.StdVec_Force()
            external.extend([pin.Force.Zero()] * system.model.njoints)
        self._stated: ExternalForces = lambda _: external
        self._data = system.model.createData()
        # Rows act on accelerations, displacements and rates, stacked in this order.
        self._linear = np.hstack([system.added_mass, system.stiffness, system.damping])
        # Where these are among positions, rates and accelerations of all coordinates, in this order.
        self._place = np.concatenate([2 * n + system.elastic, system.elastic, n + system.elastic])
        self._block = (system.elastic[:, None] * n + system.elastic).ravel()
        self._mass, self._force = np.empty((f, f)), np.empty(f)

    def run(
        self,
        motions: Sequence[DrivenMotion],
        u: FloatArray,
        v: FloatArray,
        progress: Callable[[float], None] | None = None,
        forces: Sequence[ExternalForces] | None = None,
    ) -> ElasticMotion:
        """Integrate along prescribed motions, one after the other, from `u` and `v` (f,).

        Each continues the one before in position and velocity. Where the acceleration jumps, a step ends.
        `forces` are the external ones along each motion, from a time on its clock, in place of the system's.
        `progress` is called about every 100 steps with the time that has been reached, s.

        Raises
        ------
        SimulationDiverged
            When the state is not finite or outside the validity of the model.
        """
        parts, start = [], 0.0
        # An overflow shows in the state, which every step checks.
        with np.errstate(over="ignore", invalid="ignore"):
            for number, motion in enumerate(motions):
                self._forces = self._stated if forces is None else forces[number]
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
        motion: DrivenMotion,
        u: FloatArray,
        v: FloatArray,
        start: float,
        progress: Callable[[float], None],
    ) -> ElasticMotion:
        count = max(int(np.ceil(motion.duration / self._step * (1 - 1e-12))), 1)
        t = np.linspace(0.0, motion.duration, count + 1)
        state = np.zeros((4, len(u)))
        state[1], state[2] = u, v
        joints, *rates = motion.states(t[:1])
        coordinates = self._coordinates(joints, *rates)[0]
        self._external = self._forces(0.0)
        state[0] += self._correction(coordinates, state, self._system.added_mass, refactor=True)
        state[3] = state[0]
        # Times, driven coordinates, and the rows of the state but the last, block by block.
        blocks = [(t[:1], joints, state[None, :3])]
        done, length, self._careful = 0, 1, self._tolerance == 0
        while done < count:
            while length > count - done:
                length //= 2
            number = min(_BLOCK, (count - done) // length)
            some = t[done + length * np.arange(1, number + 1)]
            joints, *rates = motion.states(some)
            scheme = self._scheme(motion.duration / count * length)
            after, states = self._block_of(some, self._coordinates(joints, *rates), state, scheme)
            error = scheme.error(np.concatenate([state[None, 0], states[:, 0]]))
            # Also false for NaN.
            if length > 1 and not error < _MAY_LACK * self._tolerance:
                length //= 2
                continue
            valid = np.abs(states[:, 1]).max(axis=1, initial=0.0) < _MAX_DISPLACEMENT
            if not valid.all():
                k = int(np.argmin(valid))
                raise SimulationDiverged(time=start + float(some[k]), state=states[k, 1].tolist())
            state, done = after, done + length * number
            blocks.append((some, joints, states))
            if number == _BLOCK:
                progress(start + float(some[-1]))
            if error < _LACKS_LITTLE * self._tolerance:
                length = min(2 * length, self._longest)
        times, joints, states = (np.concatenate(each) for each in zip(*blocks, strict=True))
        a, u, v = (np.ascontiguousarray(states[:, row]) for row in range(3))
        return ElasticMotion(t=start + times, joints=joints, u=u, v=v, a=a)

    def _scheme(self, h: float) -> _Scheme:
        """The method with steps of `h`, s."""
        alpha_m, beta, gamma = self._alpha_m, self._beta, self._gamma
        share = (1 - self._alpha_f) / (1 - alpha_m)
        to_v, to_u = h * gamma * share, h**2 * beta * share
        kept, last = 1 / (1 - alpha_m), -alpha_m / (1 - alpha_m)
        predictor = [
            [1.0, 0.0, 0.0, 0.0],
            [h**2 * beta * kept, 1.0, h, h**2 * (0.5 - beta + beta * last)],
            [h * gamma * kept, 0.0, 1.0, h * (1 - gamma + gamma * last)],
            [kept, 0.0, 0.0, last],
        ]
        system = self._system
        return _Scheme(
            predictor=np.array(predictor),
            corrector=np.array([1.0, to_u, to_v, share])[:, None],
            tangent=system.added_mass + to_u * system.stiffness + to_v * system.damping,
            truncation=h**2 * abs(beta - 1 / 6),
        )

    def _block_of(
        self, t: FloatArray, prescribed: FloatArray, state: FloatArray, scheme: _Scheme
    ) -> tuple[FloatArray, FloatArray]:
        """Steps from a `state` (4, f): the one after them, and at each (N, 3, f) the rows but the last."""
        states, to_u = np.empty((len(prescribed), 3, state.shape[1])), scheme.corrector[1, 0]
        for k, coordinates in enumerate(prescribed):
            careful, tried = self._careful, k % _RENEWED == _RENEWED - 1
            self._external = self._forces(float(t[k]))
            state = scheme.predictor @ state
            for correction in range(self._corrections if careful or tried else 1):
                renewed = correction == 0 and (careful or k % _RENEWED == 0)
                change = self._correction(coordinates, state, scheme.tangent, refactor=renewed)
                state += scheme.corrector * change
                if tried and correction == 1:
                    self._careful = not to_u * np.abs(change).max(initial=0.0) < self._tolerance
            states[k] = state[:3]
        return state, states

    def _coordinates(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Positions, rates and accelerations (N, 3 n) of all coordinates, the driven ones (N, d) set."""
        n = self._system.model.nv
        whole = np.zeros((len(q), 3, n))
        for row, each in enumerate((q, v, a)):
            whole[:, row, self._system.driven] = each
        return whole.reshape(len(q), 3 * n)

    def _correction(
        self, coordinates: FloatArray, state: FloatArray, tangent: FloatArray, *, refactor: bool
    ) -> FloatArray:
        """Change of the accelerations (f,) by one Newton step with the matrix M_ff + `tangent`."""
        system, n = self._system, self._system.model.nv
        own = state[:3].reshape(-1)
        coordinates[self._place] = own
        q, v, a = coordinates[:n], coordinates[n : 2 * n], coordinates[2 * n :]
        if refactor:
            M = pin.crba(system.model, self._data, q)
            M.take(self._block, out=self._mass.reshape(-1), mode="clip")
            self._mass += tangent
            self._factor, failed = dpotrf(self._mass.T, overwrite_a=True, clean=False)
            if failed:  # not positive definite: the check of the next state raises, with its time
                self._factor = np.full_like(self._mass, np.nan)
        force = pin.rnea(system.model, self._data, q, v, a, self._external)
        force.take(system.elastic, out=self._force, mode="clip")
        if system.added_coupling is not None:
            self._force += system.added_coupling @ a[system.driven]
        self._force += self._linear @ own
        change, _ = dpotrs(self._factor, self._force)
        return np.asarray(-change)
