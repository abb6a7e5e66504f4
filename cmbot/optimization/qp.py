"""Quadratic programs with an epigraph and elastic constraints, solved by PIQP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import optional_module
from cmbot.optimization.constraint_set import OBJECTIVE

# What PIQP is asked for, and what is still good enough to step by: the step is judged by what it brings.
_QP_TOLERANCE = 1e-8


def piqp_module() -> Any:
    """Import PIQP.

    Raises
    ------
    MissingExtra
        When it is not installed.
    """
    return optional_module("piqp", "piqp", "fast")


@dataclass(frozen=True, kw_only=True, eq=False)
class NlpValues:
    """A nonlinear program at a point: ``min f + b, c_k <= b for k in the epigraph, c_k <= 0 for the others``.

    The epigraph is the objective's family; where `epigraph` is false there is no b.
    """

    objective: float  # f
    value: FloatArray  # (K,): c
    family: IntArray  # (K,), of each constraint; each has a penalty of its own
    epigraph: bool
    least: float = -np.inf  # b is not lowered below this

    @property
    def peak(self) -> float:
        """Largest value in the epigraph, or the least that counts; 0 without an epigraph."""
        return self._peak(self.value)

    @property
    def violation(self) -> float:
        """Largest of the constraints that are violated, or 0."""
        return float(self.value[~self.in_epigraph].max(initial=0.0))

    @property
    def in_epigraph(self) -> BoolArray:
        """Which of the constraints (K,) are compared with b."""
        return np.asarray((self.family == OBJECTIVE) & self.epigraph)

    def merit(self, penalty: FloatArray) -> float:
        """Objective and peak, and the largest violation of each family times its `penalty` (families,)."""
        return self.objective + self.peak + float(penalty @ self._violations(self.value, len(penalty)))

    def _peak(self, value: FloatArray) -> float:
        return float(value[self.in_epigraph].max(initial=self.least)) if self.epigraph else 0.0

    def _violations(self, value: FloatArray, families: int) -> FloatArray:
        largest, others = np.zeros(families), ~self.in_epigraph
        np.maximum.at(largest, self.family[others], value[others])
        return largest


@dataclass(frozen=True, kw_only=True, eq=False)
class NlpModel(NlpValues):
    """A nonlinear program to second order around a point, for a step p.

    What is coupled lies side by side in p, as far as can be: it is what makes the programs quick. Cuts are
    direction cuts, see `cmbot.optimization.program.Linearization`.
    """

    gradient: FloatArray  # (n,)
    hessian: sparse.csr_array  # (n, n), positive semidefinite
    jacobian: sparse.csr_array  # (K, n)
    cut_value: FloatArray  # (C,)
    cut_jacobian: sparse.csr_array  # (C, n)
    cut_family: IntArray  # (C,)

    def violations(self, p: FloatArray | None = None, *, families: int) -> FloatArray:
        """Largest violation (families,) of each family, here or to first order after the step `p` (n,)."""
        return self._violations(self.value if p is None else self.value + self.jacobian @ p, families)

    def after(self, p: FloatArray, penalty: FloatArray) -> float:
        """What the merit would be after the step `p` (n,), to this order."""
        value = self.value + self.jacobian @ p
        quadratic = float(self.gradient @ p + 0.5 * p @ (self.hessian @ p))
        left = self._violations(value, len(penalty))
        return self.objective + quadratic + self._peak(value) + float(penalty @ left)


@dataclass(frozen=True, kw_only=True, eq=False)
class QpStep:
    """Solution of a quadratic program: a step, and the multipliers of the constraints."""

    p: FloatArray  # (n,)
    multipliers: FloatArray  # (K,)
    solved: bool  # as PIQP says; without that p is still a step, only not the best


def solve_qp(
    model: NlpModel, penalty: FloatArray, radius: float, damping: float = 0.0, *, close_gap: bool = False
) -> QpStep:
    """Minimise the model with violations weighed by `penalty`, no entry of p larger than `radius`.

    Half of `damping` times the square of p is added. The duality gap is asked to be as small as the residuals
    where `close_gap` says so.
    """
    piqp = piqp_module()
    n, families = len(model.gradient), len(penalty)
    value = np.concatenate([model.value, model.cut_value])
    # Behind p come the peak b and the largest violation of each family.
    c = np.concatenate([model.gradient, [1.0 if model.epigraph else 0.0], penalty])
    highest = float(np.abs(model.value).max(initial=1.0))
    low = np.concatenate([np.full(n, -radius), [max(-10 * highest, model.least)], np.zeros(families)])
    high = np.concatenate([np.full(n, radius), [10 * highest], np.full(families, np.inf)])
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = _QP_TOLERANCE
    solver.settings.eps_rel = _QP_TOLERANCE
    solver.settings.check_duality_gap = close_gap
    solver.settings.eps_duality_gap_abs = _QP_TOLERANCE
    solver.settings.eps_duality_gap_rel = _QP_TOLERANCE
    solver.settings.kkt_solver = piqp.KKTSolver.sparse_multistage
    P, G = _damped(model.hessian, damping, 1 + families), _relaxed(model, families)
    solver.setup(P, c, None, None, G, np.full(len(value), -np.inf), -value, low, high)
    solved = solver.solve() == piqp.PIQP_SOLVED
    p, multipliers = np.array(solver.result.x[:n]), np.array(solver.result.z_u[: len(model.value)])
    if not (np.isfinite(p).all() and np.isfinite(multipliers).all()):
        return QpStep(p=np.zeros(n), multipliers=np.zeros(len(model.value)), solved=False)
    return QpStep(p=np.clip(p, -radius, radius), multipliers=multipliers, solved=solved)


def _damped(hessian: sparse.csr_array, damping: float, more: int) -> sparse.csc_matrix:
    """Hessian by p and so many unknowns behind it, on which nothing depends but the linear terms."""
    n = hessian.shape[0]
    # It is symmetric, so its rows are its columns.
    H = sparse.csr_array(hessian + damping * sparse.eye_array(n, format="csr"))
    H.sum_duplicates()
    ends = np.append(H.indptr, np.full(more, H.indptr[-1], dtype=H.indptr.dtype))
    return sparse.csc_matrix((H.data, H.indices, ends), shape=(n + more, n + more))


def _relaxed(model: NlpModel, families: int) -> sparse.csc_matrix:
    """Derivatives of the constraints and their cuts by p, the peak b and the largest violations."""
    rows = len(model.value) + len(model.cut_value)
    J, cuts = model.jacobian, model.cut_jacobian
    both = sparse.csr_array(
        (
            np.concatenate([J.data, cuts.data]),
            np.concatenate([J.indices, cuts.indices]),
            np.concatenate([J.indptr, J.indptr[-1] + cuts.indptr[1:]]),
        ),
        shape=(rows, J.shape[1]),
    ).tocsc()
    # Each row has one more entry, for the peak or for its family's largest violation.
    of_constraints = np.where(model.in_epigraph, 0, 1 + model.family)
    column = np.concatenate([of_constraints, 1 + model.cut_family])
    ends = both.indptr[-1] + np.cumsum(np.bincount(column, minlength=1 + families))
    return sparse.csc_matrix(
        (
            np.concatenate([both.data, np.full(rows, -1.0)]),
            np.concatenate([both.indices, np.argsort(column, kind="stable")]),
            np.concatenate([both.indptr, ends]),
        ),
        shape=(rows, J.shape[1] + 1 + families),
    )
