"""The tool along the work under inputs in time: a linear arm whose modes change as it moves.

In each posture the modes, and a damper as a second mass s that is relative to the deck, are a system of first
order, which is integrated exactly under inputs that are linear between steps::

    eta'' + 2 zeta w eta' + w^2 eta = gamma x + P^T F,        s'' = -a - F / m
    F = c (s' - P eta') + k (s - P eta)

From posture i to j the elastic coordinates go on as they are: ``eta_j = Phi_j^T M_j Phi_i eta_i``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, expm

from cmbot.common.arrays import FloatArray
from cmbot.excitation.response import AXES, ModalResponse


@dataclass(frozen=True, kw_only=True, eq=False)
class PostureSystem:
    """The system of a posture, ``x' = A x + B u``: of slow modes, a damper's place, and their rates.

    Attributes
    ----------
    response : ModalResponse
    slow : int
        Modes that are taken.
    rates, gain, tool : (s, s), (s, m), (3, s)
        A, B, and the tool's displacement by the state.
    """

    response: ModalResponse
    slow: int
    rates: FloatArray
    gain: FloatArray
    tool: FloatArray

    @classmethod
    def of(cls, response: ModalResponse, fastest: float) -> PostureSystem:
        """Return that of the modes below a frequency, Hz."""
        k, damper = int(np.searchsorted(response.frequencies, fastest)), response.damper
        w, P, gain = 2 * np.pi * response.frequencies[:k], response.place[:, :k], response.gain[:k]
        stiffness, friction = np.diag(w**2), np.diag(2 * response.damping[:k] * w)
        if damper is not None:
            # Of what stretches the springs, s - P eta; the damper's row is divided by its mass.
            wd, share = 2 * np.pi * damper.frequency, np.hstack([-P, np.eye(AXES)])
            pulled = np.vstack([-damper.mass * P.T, np.eye(AXES)]) @ share
            stiffness = block_diag(stiffness, np.zeros((AXES, AXES))) + wd**2 * pulled
            friction = block_diag(friction, np.zeros((AXES, AXES))) + 2 * damper.damping * wd * pulled
            gain = np.vstack([gain, -np.eye(AXES, gain.shape[1])])
        d = len(stiffness)
        return cls(
            response=response,
            slow=k,
            rates=np.block([[np.zeros((d, d)), np.eye(d)], [-stiffness, -friction]]),
            gain=np.vstack([np.zeros_like(gain), gain]),
            tool=np.hstack([response.tool[:, :k], np.zeros((AXES, 2 * d - k))]),
        )

    def from_posture(self, other: PostureSystem) -> FloatArray:
        """Return what makes of a state (s',) in another posture that in this one, (s, s')."""
        passed = self.response.momenta[:, : self.slow].T @ other.response.shapes[:, : other.slow]
        if self.response.damper is not None:
            passed = block_diag(passed, np.eye(AXES))
        return np.asarray(block_diag(passed, passed))

    def step(self, h: float) -> FloatArray:
        """Return what makes the next state of one and the inputs before and after a step, s, (s, s + 2 m)."""
        s, m = self.gain.shape
        rates = np.zeros((s + 2 * m, s + 2 * m))
        rates[:s, :s], rates[:s, s : s + m], rates[s : s + m, s + m :] = self.rates, self.gain, np.eye(m) / h
        E = expm(rates * h)[:s]
        return np.hstack([E[:, :s], E[:, s : s + m] - E[:, s + m :], E[:, s + m :]])

    def steady(self, f: FloatArray, spectra: FloatArray) -> FloatArray:
        """Return the sums over frequency (s, R) of states under inputs of spectra (F, m, R) at f (F,), Hz."""
        s, m = self.gain.shape
        dynamic = 2j * np.pi * f[:, None, None] * np.eye(s) - self.rates
        G = np.linalg.solve(dynamic, np.broadcast_to(self.gain, (len(f), s, m)))
        return np.asarray(
            G.transpose(1, 0, 2).reshape(s, -1).astype(spectra.dtype) @ spectra.reshape(len(f) * m, -1)
        )


def tool_along(
    systems: Sequence[PostureSystem],
    at: FloatArray,
    inputs: FloatArray,
    step: float,
    start: FloatArray | None = None,
) -> FloatArray:
    """Return the tool's displacements (N, R, 3), m, in W, of R records.

    Parameters
    ----------
    systems : sequence of K PostureSystem
        Of postures at equal steps of the work.
    at : (N,)
        Share of the work that is done at each time, ascending: the nearest posture is taken.
    inputs : (N, m, R)
        Every `step` s, linear between.
    start : (s, R), optional
        State at the begin; left out: at rest.
    """
    N, m, R = inputs.shape
    number = np.rint(at * (len(systems) - 1)).astype(int)
    tool = np.empty((N, R, AXES), dtype=inputs.dtype)
    state = np.zeros((len(systems[0].rates), R)) if start is None else start
    for k, system in enumerate(systems):
        if k:
            state = system.from_posture(systems[k - 1]) @ state
        s = len(state)
        known, E = np.empty((s + 2 * m, R), dtype=inputs.dtype), system.step(step).astype(inputs.dtype)
        C = system.tool.astype(inputs.dtype)
        known[:s] = state
        for n in np.flatnonzero(number == k):
            if n:
                known[s:] = inputs[n - 1 : n + 1].reshape(2 * m, R)
                known[:s] = E @ known
            tool[n] = (C @ known[:s]).T
        state = known[:s]
    return tool
