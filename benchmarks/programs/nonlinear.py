"""A program with casadi's derivatives, as every solver takes it: SQP, SLSQP, Ipopt, SNOPT."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from measure import process_time, required
from scipy import optimize, sparse
from solvers.drake import Block, DrakeProgram, solve_with_drake

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.optimization.curvature import convexified
from cmbot.optimization.qp import NlpModel, NlpValues
from cmbot.optimization.sqp import SqpOptions, SqpStatus, solve_sqp
from programs.hock_schittkowski import Problem

__all__ = ["SOLVERS", "Nonlinear", "Outcome", "solve"]

SOLVERS = ("sqp", "slsqp", "ipopt", "snopt")
# Slopes of the objective and of rows at the start are scaled down to this, as Ipopt does; and optimality.
_STEEPEST, _ACCURACY, _FIRMEST = 100.0, 1e-8, 1e8
_MOST = 500


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a solver made of a program.

    Attributes
    ----------
    problem, solver : str
    objective, violation : float
        Not scaled: the largest of constraints and bounds.
    iterations, evaluations : int
        Evaluations are those of the constraints' derivatives.
    seconds : float
        Processor time, the shortest of three.
    status : str
    """

    problem: str
    solver: str
    objective: float
    violation: float
    iterations: int
    evaluations: int
    seconds: float
    status: str


class Nonlinear:
    """``min f(x) + b, c(x) <= b, g(x) >= 0, low <= x <= high``; without c there is no b.

    Parameters
    ----------
    problem : Problem
    peaks : callable, optional
        x to a list, c.
    block_ends : (b,), optional
        Where blocks of unknowns end that are coupled with the next three at most; one block without it.
    """

    def __init__(
        self,
        problem: Problem,
        peaks: Callable[[Any], list[Any]] | None = None,
        block_ends: IntArray | None = None,
    ) -> None:
        ca = required("casadi")
        n = len(problem.start)
        self.problem, self.start = problem, np.array(problem.start)
        self.low, self.high = np.array(problem.low), np.array(problem.high)
        self.epigraph = peaks is not None
        symbol = ca.SX.sym("x", n)
        x = [symbol[k] for k in range(n)]
        f = problem.objective(x)
        g = ca.vertcat(*([] if peaks is None else peaks(x)), *(-each for each in problem.constraints(x)))
        g = g if g.numel() else ca.SX.zeros(0, 1)
        self.peaks = 0 if peaks is None else len(peaks(x))
        z, s = ca.SX.sym("z", g.numel()), ca.SX.sym("s")
        lagrangian = s * f + ca.dot(z, g)
        self.f = ca.Function("f", [symbol], [f])
        self.g = ca.Function("g", [symbol], [g])
        self.gradient = ca.Function("df", [symbol], [ca.gradient(f, symbol)])
        self.jacobian = ca.Function("dg", [symbol], [ca.jacobian(g, symbol)])
        self.hessian = ca.Function("H", [symbol, s, z], [ca.hessian(lagrangian, symbol)[0]])
        self.nlp = {"x": symbol, "f": f, "g": g}
        self.evaluations = 0
        self.block_ends = np.array([n]) if block_ends is None else block_ends

    def values(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Return f, and the rows of c and -g (K,)."""
        return float(self.f(x)), np.array(self.g(x)).ravel()

    def derivatives(self, x: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        """Return the gradient (n,) and the Jacobian (K, n) of the rows."""
        self.evaluations += 1
        J = self.jacobian(x)
        if J.numel() == 0:
            return np.array(self.gradient(x)).ravel(), sparse.csr_array((0, len(x)))
        return np.array(self.gradient(x)).ravel(), sparse.csr_array(J.sparse())

    @cached_property
    def ipopt(self) -> Any:
        """Ipopt through casadi, with the exact Hessian; made once, as the other solvers' derivatives are."""
        ca = required("casadi")
        x, f, g = self.nlp["x"], self.nlp["f"], self.nlp["g"]
        if self.epigraph:
            b = ca.SX.sym("b")
            x, f, g = ca.vertcat(x, b), f + b, ca.vertcat(g[: self.peaks] - b, g[self.peaks :])
        quiet = {"print_level": 0, "sb": "yes", "tol": _ACCURACY, "max_iter": _MOST}
        return ca.nlpsol("s", "ipopt", {"x": x, "f": f, "g": g}, {"ipopt": quiet, "print_time": False})

    def outcome(self, x: FloatArray) -> tuple[float, float]:
        """Objective, with the peak, and the largest violation."""
        f, rows = self.values(x)
        peak = float(rows[: self.peaks].max(initial=-np.inf)) if self.epigraph else 0.0
        beside = max(float((self.low - x).max()), float((x - self.high).max()))
        return f + peak, max(0.0, beside, float(rows[self.peaks :].max(initial=0.0)))


def solve(program: Nonlinear, solver: str, repeats: int = 3) -> Outcome:
    """Solve a program with one of `SOLVERS`.

    Raises
    ------
    MissingExtra
        When casadi, PIQP or Drake is not installed.
    """
    if solver == "ipopt":
        program.ipopt  # noqa: B018 - made before the clock runs
    way = {"sqp": _by_sqp, "slsqp": _by_slsqp, "ipopt": _by_ipopt, "snopt": _by_snopt}[solver]

    def once() -> tuple[FloatArray, int, int, str]:
        program.evaluations = 0
        return way(program)

    seconds, (x, iterations, evaluations, status) = process_time(once, repeats)
    objective, violation = program.outcome(x)
    return Outcome(
        problem=program.problem.name,
        solver=solver,
        objective=objective,
        violation=violation,
        iterations=iterations,
        evaluations=evaluations,
        seconds=seconds,
        status=status,
    )


@dataclass(frozen=True, kw_only=True)
class _Scales:
    """What makes a program dimensionless: units of the unknowns (n,), factors of f and the rows (K,)."""

    unit: FloatArray
    f: float
    rows: FloatArray

    @staticmethod
    def of(program: Nonlinear) -> _Scales:
        """Units are the start's sizes; factors bring slopes down to 1."""
        unit = np.maximum(1.0, np.abs(program.start))
        slope, J = program.derivatives(program.start)
        steep = np.abs(J.toarray() * unit).max(axis=1, initial=0.0)
        rows = _STEEPEST / np.maximum(steep, _STEEPEST)
        f = _STEEPEST / max(float(np.abs(slope * unit).max()), _STEEPEST)
        if program.epigraph:
            rows[: program.peaks] = f = min(f, float(rows[: program.peaks].min()))
        return _Scales(unit=unit, f=f, rows=rows)


@dataclass(frozen=True, eq=False)
class _Iterate:
    """A point for cmbot's SQP: bounds on unknowns are rows of a family of their own."""

    program: Nonlinear
    scales: _Scales
    y: FloatArray

    @cached_property
    def _bounded(self) -> tuple[IntArray, IntArray]:
        return np.flatnonzero(np.isfinite(self.program.low)), np.flatnonzero(np.isfinite(self.program.high))

    @cached_property
    def values(self) -> NlpValues:
        p, unit, x = self.program, self.scales.unit, self.y * self.scales.unit
        (low, high), (f, rows) = self._bounded, p.values(x)
        value = [
            rows * self.scales.rows,
            (p.low[low] - x[low]) / unit[low],
            (x[high] - p.high[high]) / unit[high],
        ]
        family = np.full(len(rows) + len(low) + len(high), 2)
        family[: len(rows)], family[: p.peaks] = 1, 0
        return NlpValues(
            objective=f * self.scales.f, value=np.concatenate(value), family=family, epigraph=p.epigraph
        )

    @cached_property
    def model(self) -> NlpModel:
        p, unit, n = self.program, self.scales.unit, len(self.y)
        slope, J = p.derivatives(self.y * unit)
        one, (low, high) = sparse.eye_array(n, format="csr"), self._bounded
        J = sparse.diags_array(self.scales.rows) @ J @ sparse.diags_array(unit)
        return NlpModel(
            **vars(self.values),
            gradient=slope * unit * self.scales.f,
            hessian=sparse.csr_array((n, n)),
            jacobian=sparse.csr_array(sparse.vstack([J, -one[low], one[high]])),
            cut_value=np.empty(0),
            cut_jacobian=sparse.csr_array((0, n)),
            cut_family=np.empty(0, dtype=np.intp),
        )

    def hessian(self, multipliers: FloatArray) -> sparse.csr_array:
        p, unit = self.program, self.scales.unit
        z = multipliers[: len(self.scales.rows)] * self.scales.rows
        H = sparse.csr_array(p.hessian(self.y * unit, self.scales.f, z).sparse())
        H = sparse.diags_array(unit) @ H @ sparse.diags_array(unit)
        return convexified(sparse.csr_array(H), p.block_ends)

    def displaced(self, step: FloatArray) -> Self:
        return replace(self, y=self.y + step)

    def separated(self) -> Self:
        return self

    def refresh(self, other: Self) -> Self:
        return self

    def drop_constraints(self, multipliers: FloatArray) -> tuple[Self, FloatArray]:
        return self, multipliers


def _by_sqp(program: Nonlinear) -> tuple[FloatArray, int, int, str]:
    scales = _Scales.of(program)
    start = _Iterate(program, scales, program.start / scales.unit)
    options = SqpOptions(
        optimality_tolerance=_ACCURACY,
        feasibility_tolerance=1e-7,
        stall_tolerance=_ACCURACY,
        max_penalty=_FIRMEST,
        close_gap=True,
        max_iterations=_MOST,
    )
    found = solve_sqp(start, 3, options)
    names = {SqpStatus.INFEASIBLE: "infeasible", SqpStatus.ITERATION_LIMIT: "iteration limit"}
    status = names.get(found.status, found.status.name.lower())
    return found.iterate.y * scales.unit, found.iterations, program.evaluations, status


def _extended(program: Nonlinear) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Start and bounds, with b behind the unknowns where there is a peak."""
    if not program.epigraph:
        return program.start, program.low, program.high
    peak = float(program.values(program.start)[1][: program.peaks].max())
    return np.append(program.start, peak), np.append(program.low, -np.inf), np.append(program.high, np.inf)


def _objective(program: Nonlinear, x: FloatArray) -> tuple[float, FloatArray]:
    n = len(program.start)
    slope = np.array(program.gradient(x[:n])).ravel()
    value = float(program.f(x[:n]))
    return (value + x[n], np.append(slope, 1.0)) if program.epigraph else (value, slope)


def _rows(program: Nonlinear, x: FloatArray) -> FloatArray:
    rows = np.array(program.g(x[: len(program.start)])).ravel()
    if program.epigraph:
        rows[: program.peaks] -= x[-1]
    return rows


def _jacobian(program: Nonlinear, x: FloatArray) -> FloatArray:
    program.evaluations += 1
    J = np.array(program.jacobian(x[: len(program.start)]))
    column = np.zeros((len(J), int(program.epigraph)))
    column[: program.peaks] = -1.0
    return np.hstack([J, column])


def _by_slsqp(program: Nonlinear) -> tuple[FloatArray, int, int, str]:
    start, low, high = _extended(program)
    rows = {
        "type": "ineq",
        "fun": lambda x: -_rows(program, x),
        "jac": lambda x: -_jacobian(program, x),
    }
    found = optimize.minimize(
        lambda x: _objective(program, x),
        np.clip(start, low, high),
        jac=True,
        method="SLSQP",
        bounds=optimize.Bounds(low, high),
        constraints=[rows] if len(_rows(program, start)) else [],
        options={"maxiter": _MOST, "ftol": _ACCURACY},
    )
    x = found.x[: len(program.start)]
    return x, int(found.nit), int(found.njev), "solved" if found.success else str(found.message).lower()


def _by_ipopt(program: Nonlinear) -> tuple[FloatArray, int, int, str]:
    start, low, high = _extended(program)
    solver = program.ipopt
    found = solver(x0=start, lbx=low, ubx=high, lbg=-np.inf, ubg=0.0)
    stats = solver.stats()
    end = np.array(found["x"]).ravel()[: len(program.start)]
    status = "solved" if stats["success"] else stats["return_status"].replace("_", " ").lower()
    calls = stats.get("n_call_nlp_jac_g", 0) or stats.get("n_call_nlp_grad_f", 0)
    return end, int(stats["iter_count"]), int(calls), status


def _by_snopt(program: Nonlinear) -> tuple[FloatArray, int, int, str]:
    start, low, high = _extended(program)
    rows, blocks = len(_rows(program, start)), []
    if rows:
        pattern = np.array(required("casadi").DM(program.jacobian.sparsity_out(0), 1)) != 0
        column = np.zeros((rows, int(program.epigraph)), dtype=bool)
        column[: program.peaks] = True
        blocks.append(
            Block(
                of=np.arange(len(start)),
                low=np.full(rows, -np.inf),
                high=np.zeros(rows),
                rows=lambda x: _rows(program, x),
                jacobian=lambda x: (_rows(program, x), _jacobian(program, x)),
                pattern=np.hstack([pattern, column]),
            )
        )
    given = DrakeProgram(
        start=np.clip(start, low, high),
        lowest=low,
        highest=high,
        objective=lambda x: _objective(program, x),
        blocks=tuple(blocks),
    )
    found = solve_with_drake(given, "snopt", **{"Major optimality tolerance": _ACCURACY**0.5 * 1e-2})
    return (
        found.x[: len(program.start)],
        found.iterations,
        found.evaluations,
        ("solved" if found.solved else found.status),
    )
