"""The quadratic programs of the sparse solver, handed to PIQP."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import MissingExtra

__all__ = ["LocalModel", "LocalValues", "Step", "piqp_module", "solve_qp"]

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
class LocalValues:
    """A problem at a point: ``min f + b, c_peaks <= b, c_others <= 0``.

    Attributes
    ----------
    objective : float
        f.
    value : (K,)
        c.
    peaks : int
        How many of c, the first ones, are compared with b. Without any there is no b.
    kind : (K,)
        What kind of constraint each of c is; each kind has a penalty of its own.
    least : float
        b is not lowered below this.
    """

    objective: float
    value: FloatArray
    peaks: int
    kind: IntArray
    least: float = -np.inf

    @property
    def peak(self) -> float:
        """Largest of the constraints that are compared with b, or the least that counts; 0 without any."""
        return self._peak(self.value)

    @property
    def violation(self) -> float:
        """Largest of the constraints that are violated, or 0."""
        return float(self.value[self.peaks :].max(initial=0.0))

    def merit(self, penalty: FloatArray) -> float:
        """Objective and peak, and the largest violation of each kind times its `penalty` (kinds,)."""
        return self.objective + self.peak + float(penalty @ self._violations(self.value, len(penalty)))

    def _peak(self, value: FloatArray) -> float:
        return float(value[: self.peaks].max(initial=self.least)) if self.peaks else 0.0

    def _violations(self, value: FloatArray, kinds: int) -> FloatArray:
        largest = np.zeros(kinds)
        np.maximum.at(largest, self.kind[self.peaks :], value[self.peaks :])
        return largest


@dataclass(frozen=True, kw_only=True)
class LocalModel(LocalValues):
    """A problem to second order around a point, for a step p.

    What is coupled lies side by side in p, as far as can be: it is what makes the programs quick.

    Attributes
    ----------
    gradient : (n,)
    hessian : (n, n)
        Positive semidefinite, sparse.
    jacobian : (K, n)
        Sparse.
    face_value : (F,)
        Of functions that never exceed some of c, but reach what these overlook to first order.
    face_jacobian : (F, n)
        Sparse.
    face_kind : (F,)
        What kind of constraint they belong to.
    """

    gradient: FloatArray
    hessian: sparse.csr_array
    jacobian: sparse.csr_array
    face_value: FloatArray
    face_jacobian: sparse.csr_array
    face_kind: IntArray

    def violations(self, p: FloatArray | None = None, *, kinds: int) -> FloatArray:
        """Largest violation (kinds,) of each kind, here or to first order after the step `p` (n,)."""
        return self._violations(self.value if p is None else self.value + self.jacobian @ p, kinds)

    def after(self, p: FloatArray, penalty: FloatArray) -> float:
        """What the merit would be after the step `p` (n,), to this order."""
        value = self.value + self.jacobian @ p
        quadratic = float(self.gradient @ p + 0.5 * p @ (self.hessian @ p))
        left = self._violations(value, len(penalty))
        return self.objective + quadratic + self._peak(value) + float(penalty @ left)


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
    c = np.concatenate([model.gradient, [1.0 if peaks else 0.0], penalty])
    highest = float(np.abs(model.value).max(initial=1.0))
    low = np.concatenate([np.full(n, -radius), [max(-10 * highest, model.least)], np.zeros(kinds)])
    high = np.concatenate([np.full(n, radius), [10 * highest], np.full(kinds, np.inf)])
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = _ACCURACY
    solver.settings.eps_rel = _ACCURACY
    solver.settings.check_duality_gap = False
    solver.settings.kkt_solver = piqp.KKTSolver.sparse_multistage
    P, G = _damped(model.hessian, damping, 1 + kinds), _relaxed(model, kinds)
    solver.setup(P, c, None, None, G, np.full(len(value), -np.inf), -value, low, high)
    solved = solver.solve() == piqp.PIQP_SOLVED
    p, multipliers = np.array(solver.result.x[:n]), np.array(solver.result.z_u[: len(model.value)])
    if not (np.isfinite(p).all() and np.isfinite(multipliers).all()):
        return Step(p=np.zeros(n), multipliers=np.zeros(len(model.value)), solved=False)
    return Step(p=np.clip(p, -radius, radius), multipliers=multipliers, solved=solved)


def _damped(hessian: sparse.csr_array, damping: float, more: int) -> sparse.csc_matrix:
    """Hessian by p and so many unknowns behind it, on which nothing depends but the linear terms."""
    n = hessian.shape[0]
    # It is symmetric, so its rows are its columns.
    H = sparse.csr_array(hessian + damping * sparse.eye_array(n, format="csr"))
    H.sum_duplicates()
    ends = np.append(H.indptr, np.full(more, H.indptr[-1], dtype=H.indptr.dtype))
    return sparse.csc_matrix((H.data, H.indices, ends), shape=(n + more, n + more))


def _relaxed(model: LocalModel, kinds: int) -> sparse.csc_matrix:
    """Derivatives of the constraints and their faces by p, the peak b and the largest violations."""
    peaks, rows = model.peaks, len(model.value) + len(model.face_value)
    J, faces = model.jacobian, model.face_jacobian
    both = sparse.csr_array(
        (
            np.concatenate([J.data, faces.data]),
            np.concatenate([J.indices, faces.indices]),
            np.concatenate([J.indptr, J.indptr[-1] + faces.indptr[1:]]),
        ),
        shape=(rows, J.shape[1]),
    ).tocsc()
    # Each row has one more entry, for the peak or for its kind's largest violation.
    column = np.concatenate([np.zeros(peaks, dtype=np.intp), 1 + model.kind[peaks:], 1 + model.face_kind])
    ends = both.indptr[-1] + np.cumsum(np.bincount(column, minlength=1 + kinds))
    return sparse.csc_matrix(
        (
            np.concatenate([both.data, np.full(rows, -1.0)]),
            np.concatenate([both.indices, np.argsort(column, kind="stable")]),
            np.concatenate([both.indptr, ends]),
        ),
        shape=(rows, J.shape[1] + 1 + kinds),
    )
