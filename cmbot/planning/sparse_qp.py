"""The quadratic programs of the sparse solver, handed to PIQP."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from cmbot.arrays import FloatArray
from cmbot.errors import MissingExtra

__all__ = ["LocalModel", "Step", "piqp_module", "solve_qp"]

# What PIQP is asked for, and what is still good enough to step by: the step is judged by what it brings.
_ACCURACY = 1e-9


def piqp_module() -> Any:
    """Import PIQP.

    Raises
    ------
    MissingExtra
        When it is not installed.
    """
    try:
        return importlib.import_module("piqp")
    except ImportError as error:
        raise MissingExtra("piqp", "fast") from error


@dataclass(frozen=True, kw_only=True)
class LocalModel:
    """A problem to second order around a point: ``min f + b, c_peaks <= b, c_others <= 0`` by a step p.

    Attributes
    ----------
    objective : float
        f.
    gradient : (n,)
    hessian : (n, n)
        Positive semidefinite, sparse.
    value : (K,)
        c.
    jacobian : (K, n)
        Sparse.
    peaks : int
        How many of c, the first ones, are compared with b. Without any there is no b.
    face_value : (F,)
        Of functions that never exceed some of c, but reach what these overlook to first order.
    face_jacobian : (F, n)
        Sparse.
    """

    objective: float
    gradient: FloatArray
    hessian: sparse.csr_array
    value: FloatArray
    jacobian: sparse.csr_array
    peaks: int
    face_value: FloatArray
    face_jacobian: sparse.csr_array

    @property
    def violation(self) -> float:
        """Largest of the constraints that are violated, or 0."""
        return float(self.value[self.peaks :].max(initial=0.0))

    def linear_violation(self, p: FloatArray) -> float:
        """Largest violation after the step `p` (n,), to first order."""
        others = slice(self.peaks, None)
        return float((self.value[others] + self.jacobian[others] @ p).max(initial=0.0))

    def merit(self, penalty: float) -> float:
        """Objective and peak, and the largest violation times `penalty`."""
        peak = float(self.value[: self.peaks].max()) if self.peaks else 0.0
        return self.objective + peak + penalty * self.violation

    def after(self, p: FloatArray, penalty: float) -> float:
        """What the merit would be after the step `p` (n,), to this order."""
        value = self.value + self.jacobian @ p
        peak = float(value[: self.peaks].max()) if self.peaks else 0.0
        quadratic = float(self.gradient @ p + 0.5 * p @ (self.hessian @ p))
        return self.objective + quadratic + peak + penalty * float(value[self.peaks :].max(initial=0.0))


@dataclass(frozen=True, kw_only=True)
class Step:
    """Solution of a quadratic program.

    Attributes
    ----------
    p : (n,)
    multipliers : (K,)
        Of the constraints.
    solved : bool
        Whether PIQP says so; without that p is still a step, only not the best.
    """

    p: FloatArray
    multipliers: FloatArray
    solved: bool


def solve_qp(model: LocalModel, penalty: float, radius: float) -> Step:
    """Minimise the model with violations weighed by `penalty`, no entry of p larger than `radius`."""
    piqp = piqp_module()
    value = np.concatenate([model.value, model.face_value])
    n, peaks, rows = len(model.gradient), model.peaks, len(value)
    bound = (np.arange(rows) < peaks)[:, None]
    # Behind p come the peak b and the largest violation e.
    J = sparse.vstack([model.jacobian, model.face_jacobian])
    G = sparse.hstack([J, np.where(bound, -1.0, 0.0), np.where(bound, 0.0, -1.0)], format="csc")
    P = sparse.block_diag([model.hessian, sparse.csc_array((2, 2))], format="csc")
    c = np.concatenate([model.gradient, [1.0 if peaks else 0.0, penalty]])
    highest = float(np.abs(model.value).max(initial=1.0))
    low = np.concatenate([np.full(n, -radius), [-10 * highest, 0.0]])
    high = np.concatenate([np.full(n, radius), [10 * highest, np.inf]])
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = _ACCURACY
    solver.settings.eps_rel = _ACCURACY
    solver.settings.check_duality_gap = False
    solver.setup(
        sparse.csc_matrix(P),
        c,
        None,
        None,
        sparse.csc_matrix(G),
        np.full(rows, -np.inf),
        -value,
        low,
        high,
    )
    solved = solver.solve() == piqp.PIQP_SOLVED
    p, multipliers = np.array(solver.result.x[:n]), np.array(solver.result.z_u[: len(model.value)])
    if not (np.isfinite(p).all() and np.isfinite(multipliers).all()):
        return Step(p=np.zeros(n), multipliers=np.zeros(len(model.value)), solved=False)
    return Step(p=np.clip(p, -radius, radius), multipliers=multipliers, solved=solved)
