"""The quadratic programs of the sparse solver, handed to PIQP."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from cmbot.arrays import FloatArray, IntArray
from cmbot.errors import MissingExtra

__all__ = ["LocalModel", "Step", "piqp_module", "solve_qp"]

# What PIQP is asked for, and what is still good enough to step by: the step is judged by what it brings.
_ACCURACY = 1e-8


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
    least : float
        b is not lowered below this.
    kind : (K,)
        What kind of constraint each of c is; each kind has a penalty of its own.
    face_value : (F,)
        Of functions that never exceed some of c, but reach what these overlook to first order.
    face_jacobian : (F, n)
        Sparse.
    face_kind : (F,)
        What kind of constraint they belong to.
    along : (n,)
        Unknowns in an order that puts those side by side that are coupled.
    """

    objective: float
    gradient: FloatArray
    hessian: sparse.csr_array
    value: FloatArray
    jacobian: sparse.csr_array
    peaks: int
    kind: IntArray
    face_value: FloatArray
    face_jacobian: sparse.csr_array
    face_kind: IntArray
    along: IntArray
    least: float = -np.inf

    @property
    def peak(self) -> float:
        """Largest of the constraints that are compared with b, or the least that counts; 0 without any."""
        return float(self.value[: self.peaks].max(initial=self.least)) if self.peaks else 0.0

    @property
    def violation(self) -> float:
        """Largest of the constraints that are violated, or 0."""
        return float(self.value[self.peaks :].max(initial=0.0))

    def violations(self, p: FloatArray | None = None, *, kinds: int) -> FloatArray:
        """Largest violation (kinds,) of each kind, here or to first order after the step `p` (n,)."""
        value = self.value if p is None else self.value + self.jacobian @ p
        largest = np.zeros(kinds)
        np.maximum.at(largest, self.kind[self.peaks :], value[self.peaks :])
        return largest

    def merit(self, penalty: FloatArray) -> float:
        """Objective and peak, and the largest violation of each kind times its `penalty` (kinds,)."""
        return self.objective + self.peak + float(penalty @ self.violations(kinds=len(penalty)))

    def after(self, p: FloatArray, penalty: FloatArray) -> float:
        """What the merit would be after the step `p` (n,), to this order."""
        value = self.value + self.jacobian @ p
        peak = float(value[: self.peaks].max(initial=self.least)) if self.peaks else 0.0
        quadratic = float(self.gradient @ p + 0.5 * p @ (self.hessian @ p))
        left = self.violations(p, kinds=len(penalty))
        return self.objective + quadratic + peak + float(penalty @ left)


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


def solve_qp(model: LocalModel, penalty: FloatArray, radius: float, damping: float = 0.0) -> Step:
    """Minimise the model with violations weighed by `penalty`, no entry of p larger than `radius`.

    Half of `damping` times the square of p is added.
    """
    piqp = piqp_module()
    n, peaks, kinds = len(model.gradient), model.peaks, len(penalty)
    value = np.concatenate([model.value, model.face_value])
    # Behind p come the peak b and the largest violation of each kind.
    column = np.concatenate([np.zeros(peaks, dtype=np.intp), 1 + model.kind[peaks:], 1 + model.face_kind])
    rows = len(value)
    less = sparse.csr_array((np.full(rows, -1.0), (np.arange(rows), column)), shape=(rows, 1 + kinds))
    G = sparse.hstack([sparse.vstack([model.jacobian, model.face_jacobian]), less], format="csc")
    H = model.hessian + damping * sparse.eye_array(n)
    P = sparse.block_diag([H, sparse.csc_array((1 + kinds, 1 + kinds))], format="csc")
    c = np.concatenate([model.gradient, [1.0 if peaks else 0.0], penalty])
    highest = float(np.abs(model.value).max(initial=1.0))
    low = np.concatenate([np.full(n, -radius), [max(-10 * highest, model.least)], np.zeros(kinds)])
    high = np.concatenate([np.full(n, radius), [10 * highest], np.full(kinds, np.inf)])
    # What is coupled side by side is what makes PIQP's multistage solver quick, and b and e last.
    along = np.append(model.along, np.arange(n, n + 1 + kinds))
    P, G = (sparse.csc_matrix(matrix) for matrix in (P[along][:, along], G[:, along]))
    P.sort_indices()
    G.sort_indices()
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = _ACCURACY
    solver.settings.eps_rel = _ACCURACY
    solver.settings.check_duality_gap = False
    solver.settings.kkt_solver = piqp.KKTSolver.sparse_multistage
    solver.setup(
        P,
        c[along],
        None,
        None,
        G,
        np.full(rows, -np.inf),
        -value,
        low[along],
        high[along],
    )
    solved = solver.solve() == piqp.PIQP_SOLVED
    p, multipliers = np.empty(n), np.array(solver.result.z_u[: len(model.value)])
    p[along[:n]] = solver.result.x[:n]
    if not (np.isfinite(p).all() and np.isfinite(multipliers).all()):
        return Step(p=np.zeros(n), multipliers=np.zeros(len(model.value)), solved=False)
    return Step(p=np.clip(p, -radius, radius), multipliers=multipliers, solved=solved)
