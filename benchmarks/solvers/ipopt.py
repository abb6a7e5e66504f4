"""Ipopt, through casadi, on the problem with all samples as rows.

First derivatives come from cmbot's kernels, the Hessian from casadi's derivatives of the same dynamics, or
from L-BFGS.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from measure import required
from scipy import sparse

from cmbot.common.arrays import FloatArray
from cmbot.trajectory.quintic import QuinticTrajectory
from solvers.cases import Case
from solvers.lagrangian import LagrangianHessian
from solvers.sampled import SampledProblem

__all__ = ["Answer", "solve_sampled"]

# On Ipopt's scaled optimality conditions; constraints as closely as cmbot meets them.
_TOLERANCE, _CONSTRAINTS = 1e-6, 1e-5
# The start is near the optimum: a first barrier as large as Ipopt's own, 0.1, would lead far away from it.
# Where via-points slide, it has to be smaller, and monotone, which with L-BFGS is not the default.
_BARRIER = {"mu_init": 1e-4}
_SLIDING_BARRIER = {"mu_init": 1e-6, "mu_strategy": "monotone"}


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a solver found.

    Attributes
    ----------
    trajectory : QuinticTrajectory
    iterations : int
    status : str
        In the solver's words.
    rows : int
        Constraints.
    seconds : float
        Of processor time.
    """

    trajectory: QuinticTrajectory
    iterations: int
    status: str
    rows: int
    seconds: float


def solve_sampled(case: Case, *, exact: bool, seconds: float = 600.0) -> Answer:
    """Solve a case with all samples as rows, cut after `seconds` of processor time.

    Raises
    ------
    MissingExtra
        When casadi is not installed.
    """
    begin = time.process_time()
    sampled = SampledProblem(case)
    program = _Program(
        start=sampled.start,
        lowest=sampled.lowest,
        highest=sampled.highest,
        low=sampled.low,
        high=sampled.high,
        objective=sampled.objective,
        values=sampled.values,
        jacobian=sampled.jacobian,
        pattern=sampled.pattern,
        hessian=LagrangianHessian(sampled) if exact else None,
    )
    options = {"tol": _TOLERANCE, "constr_viol_tol": _CONSTRAINTS}
    options |= _SLIDING_BARRIER if case.sliding else _BARRIER
    ended = _solve(program, {**options, "max_cpu_time": float(seconds)})
    return Answer(
        trajectory=sampled.trajectory(ended.x),
        iterations=ended.iterations,
        status=ended.status,
        rows=len(sampled.low),
        seconds=time.process_time() - begin,
    )


@dataclass(frozen=True, kw_only=True)
class _Program:
    """``min f(x), low <= g(x) <= high, lowest <= x <= highest``.

    Attributes
    ----------
    start, lowest, highest : (D,)
    low, high : (K,)
    objective : callable
        x to f and its gradient (D,).
    values : callable
        x to g (K,).
    jacobian : callable
        x to the nonzeros of the Jacobian, in the order of `pattern`.
    pattern : csc array (K, D)
    hessian : callable, optional
        x, the objective's weight and multipliers (K,) to the nonzeros of the Lagrangian's upper triangle, in
        the order of its own `pattern` (D, D); without it Ipopt approximates it (L-BFGS).
    """

    start: FloatArray
    lowest: FloatArray
    highest: FloatArray
    low: FloatArray
    high: FloatArray
    objective: Callable[[FloatArray], tuple[float, FloatArray]]
    values: Callable[[FloatArray], FloatArray]
    jacobian: Callable[[FloatArray], FloatArray]
    pattern: sparse.csc_array
    hessian: Any = None


@dataclass(frozen=True, kw_only=True)
class _Ended:
    """Where Ipopt ended, after how many iterations, and what it says."""

    x: FloatArray
    iterations: int
    status: str


def _solve(program: _Program, options: dict[str, Any]) -> _Ended:
    """Solve a program with Ipopt."""
    ca = required("casadi")
    n, rows = len(program.start), len(program.low)
    dense, column = ca.Sparsity.dense, ca.Sparsity.dense(rows, 1)
    inputs = (dense(n, 1), dense(0, 0))
    J = _sparsity(program.pattern)

    def objective_and_rows(x: FloatArray) -> list[Any]:
        return [program.objective(x)[0], program.values(x)]

    def gradient(x: FloatArray) -> list[Any]:
        value, slope = program.objective(x)
        return [value, slope]

    def jacobian(x: FloatArray) -> list[Any]:
        # Ipopt takes the values from elsewhere.
        return [np.zeros(rows), ca.DM(J, program.jacobian(x))]

    functions = {
        "f": _Function("f", objective_and_rows, inputs, (dense(1, 1), column)),
        "grad_f": _Function("grad_f", gradient, inputs, (dense(1, 1), dense(n, 1))),
        "jac_g": _Function("jac_g", jacobian, inputs, (column, J)),
    }
    settings: dict[str, Any] = {"print_level": 0, "sb": "yes", **options}
    if program.hessian is None:
        settings["hessian_approximation"] = "limited-memory"
    else:
        H = _sparsity(program.hessian.pattern)

        def hessian(x: FloatArray, _: Any, of_objective: FloatArray, multipliers: FloatArray) -> list[Any]:
            return [ca.DM(H, program.hessian(x, float(of_objective[0]), multipliers))]

        of_lagrangian = (*inputs, dense(1, 1), column)
        functions["hess_lag"] = _Function("hess_lag", hessian, of_lagrangian, (H,))
    f = functions.pop("f")
    x = ca.MX.sym("x", n)
    p = ca.MX.sym("p", 0, 0)
    value, g = f.function(x, p)
    own = {name: function.function for name, function in functions.items()}
    # What would need derivatives of the callbacks, and what Ipopt itself does not.
    without = {"no_nlp_grad": True, "calc_lam_p": False, "print_time": False}
    nlp = {"x": x, "p": p, "f": value, "g": g}
    solver = ca.nlpsol("ipopt", "ipopt", nlp, {"ipopt": settings, **without, **own})
    found = solver(
        x0=program.start, lbx=program.lowest, ubx=program.highest, lbg=program.low, ubg=program.high
    )
    stats = solver.stats()
    return _Ended(
        x=np.array(found["x"]).ravel(), iterations=int(stats["iter_count"]), status=stats["return_status"]
    )


def _sparsity(pattern: sparse.csc_array) -> Any:
    return required("casadi").Sparsity(*pattern.shape, pattern.indptr.tolist(), pattern.indices.tolist())


@dataclass
class _Function:
    """A casadi Callback around a NumPy function; casadi does not keep it alive, this does."""

    name: str
    call: Callable[..., list[Any]]
    inputs: tuple[Any, ...]
    outputs: tuple[Any, ...]
    function: Any = field(init=False)

    def __post_init__(self) -> None:
        ca, own = required("casadi"), self

        class External(ca.Callback):  # type: ignore[misc, name-defined]
            def __init__(self) -> None:
                ca.Callback.__init__(self)
                self.construct(own.name, {"enable_fd": False})

            def get_n_in(self) -> int:
                return len(own.inputs)

            def get_n_out(self) -> int:
                return len(own.outputs)

            def get_sparsity_in(self, i: int) -> Any:
                return own.inputs[i]

            def get_sparsity_out(self, i: int) -> Any:
                return own.outputs[i]

            def eval(self, arguments: Any) -> list[Any]:
                arrays = [np.array(a, dtype=float).ravel() for a in arguments]
                if len(arrays) == 2:
                    arrays = arrays[:1]
                return own.call(*arrays)

        self.function = External()
