"""SNOPT and Ipopt through Drake's MathematicalProgram, for programs in blocks of a few unknowns each.

Drake takes derivatives from automatic differentiation. Functions here come with derivatives of their own, so
what it gets are values with gradients already in them.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from measure import required
from scipy import sparse

from cmbot.common.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Block", "DrakeProgram", "Ended", "solve_with_drake"]

# What a solver prints of its iterations; of SNOPT the major ones count.
_PRINTED = {
    "snopt": re.compile(r"No\. of major iterations\s+(\d+)"),
    "ipopt": re.compile(r"Number of Iterations\.*:\s+(\d+)"),
}
# As closely as cmbot meets constraints; the objective is about 1.
_OPTIONS: dict[str, dict[str, float | str]] = {
    "snopt": {
        "Major optimality tolerance": 1e-6,
        "Major feasibility tolerance": 1e-6,
        "Major print level": 1,
        "Major iterations limit": 1000,
        "Iterations limit": 1_000_000,
        "Superbasics limit": 2000,
    },
    "ipopt": {
        "tol": 1e-6,
        "constr_viol_tol": 1e-6,
        "hessian_approximation": "limited-memory",
        "file_print_level": 3,
        "print_level": 0,
    },
}
# What SNOPT's most frequent numbers mean (SNOPT 7.6, User's Guide, Section 8.6).
_INFORM = {
    1: "optimality conditions satisfied",
    2: "feasible point found",
    3: "requested accuracy could not be achieved",
    13: "nonlinear infeasibilities minimized",
    31: "iteration limit reached",
    32: "major iteration limit reached",
    41: "current point cannot be improved",
}


@dataclass(frozen=True, kw_only=True)
class Block:
    """Rows ``low <= g(x[of]) <= high`` of some unknowns.

    Attributes
    ----------
    of : (m,)
        Which unknowns.
    low, high : (k,)
    rows : callable
        x[of] to values (k,).
    jacobian : callable
        x[of] to values (k,) and their derivatives (k, m).
    pattern : (k, m), optional
        Where the derivatives may be other than zero; anywhere without it.
    """

    of: IntArray
    low: FloatArray
    high: FloatArray
    rows: Callable[[FloatArray], FloatArray]
    jacobian: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
    pattern: BoolArray | None = None


@dataclass(frozen=True, kw_only=True)
class DrakeProgram:
    """``min f(x)`` with rows in blocks, linear rows, and bounds on the unknowns.

    Attributes
    ----------
    start, lowest, highest : (n,)
    objective : callable or tuple
        x to f and its gradient (n,); or Q (n, n) and c (n,) of ``x Q x / 2 + c x``.
    blocks : tuple of Block
    linear : tuple of (sparse array (k, n), (k,), (k,))
        Matrices with the least and largest values of their rows.
    """

    start: FloatArray
    lowest: FloatArray
    highest: FloatArray
    objective: Callable[[FloatArray], tuple[float, FloatArray]] | tuple[FloatArray, FloatArray]
    blocks: tuple[Block, ...]
    linear: tuple[tuple[sparse.sparray, FloatArray, FloatArray], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Ended:
    """Where a solver ended.

    Attributes
    ----------
    x : (n,)
    iterations : int
        Of SNOPT the major ones.
    evaluations : int
        Of the derivatives of the first block, or of the objective where there is none.
    status : str
    solved : bool
        As the solver says.
    """

    x: FloatArray
    iterations: int
    evaluations: int
    status: str
    solved: bool


def solve_with_drake(program: DrakeProgram, solver: str, **options: float | str) -> Ended:
    """Solve a program with ``snopt`` or ``ipopt``, whose own options go over those that are set here.

    Raises
    ------
    MissingExtra
        When Drake is not installed.
    """
    solvers, of_drake = required("pydrake.solvers"), required("pydrake.autodiffutils")
    made = solvers.MathematicalProgram()
    x = made.NewContinuousVariables(len(program.start))
    _bound(made, x, program)
    counts = []
    for block in program.blocks:
        rows = _Function(of_drake, block.rows, block.jacobian)
        added = made.AddConstraint(rows, _endless(block.low), _endless(block.high), x[block.of])
        if block.pattern is not None:
            added.evaluator().SetGradientSparsityPattern(np.argwhere(block.pattern).tolist())
        counts.append(rows)
    for A, low, high in program.linear:
        made.AddLinearConstraint(sparse.csc_matrix(A), _endless(low), _endless(high), x)
    if isinstance(program.objective, tuple):
        Q, c = program.objective
        curved = np.flatnonzero(np.abs(Q).sum(axis=0))
        if len(curved):
            made.AddQuadraticCost(Q[np.ix_(curved, curved)], np.zeros(len(curved)), x[curved], is_convex=True)
        made.AddLinearCost(c, 0.0, x)
    else:
        objective = program.objective
        cost = _Function(of_drake, lambda y: objective(y)[0], objective)
        made.AddCost(cost, x)
        counts.append(cost)
    with tempfile.TemporaryDirectory() as folder:
        printed = Path(folder, "printed.txt")
        result = _solved(solvers, made, solver, program.start, printed, options)
        found = _PRINTED[solver].findall(printed.read_text(encoding="utf-8", errors="replace"))
    details = result.get_solver_details()
    if solver == "snopt":
        status = _INFORM.get(details.info, f"EXIT {details.info}")
    else:
        status = details.ConvertStatusToString()
    return Ended(
        x=np.clip(result.GetSolution(x), program.lowest, program.highest),
        iterations=int(found[-1]) if found else 0,
        evaluations=counts[0].derivatives if counts else 0,
        status=status,
        solved=bool(result.is_success()),
    )


def _solved(
    solvers: Any,
    made: Any,
    solver: str,
    start: FloatArray,
    printed: Path,
    own: dict[str, float | str],
) -> Any:
    engine = {"snopt": solvers.SnoptSolver, "ipopt": solvers.IpoptSolver}[solver]()
    options = solvers.SolverOptions()
    for name, value in {**_OPTIONS[solver], **own}.items():
        options.SetOption(engine.id(), name, value)
    options.SetOption(solvers.CommonSolverOption.kPrintFileName, str(printed))
    printed.touch()
    return engine.Solve(made, start, options)


def _bound(made: Any, x: Any, program: DrakeProgram) -> None:
    low, high = _endless(program.lowest), _endless(program.highest)
    there = np.isfinite(low) | np.isfinite(high)
    if there.any():
        made.AddBoundingBoxConstraint(low[there], high[there], x[there])


def _endless(bound: FloatArray) -> FloatArray:
    """Bounds as Drake has them: infinite where there is none."""
    return np.where(np.abs(bound) >= 1e19, np.copysign(np.inf, bound), bound)


@dataclass
class _Function:
    """A function with derivatives of its own as Drake calls it: with numbers, or values with gradients."""

    of_drake: Any
    values: Callable[[FloatArray], Any]
    jacobian: Callable[[FloatArray], tuple[Any, FloatArray]]
    derivatives: int = field(default=0)

    def __call__(self, x: Any) -> Any:
        if x.dtype != object:
            return self.values(x)
        self.derivatives += 1
        at, by = self.of_drake.ExtractValue(x).ravel(), self.of_drake.ExtractGradient(x)
        value, slope = self.jacobian(at)
        single = np.ndim(value) == 0
        slope = np.atleast_2d(slope)
        if by.shape[0] != by.shape[1] or not np.array_equal(by, np.eye(len(at))):
            slope = slope @ by
        made = self.of_drake.InitializeAutoDiff(np.atleast_1d(value)[:, None], slope)
        return made[0, 0] if single else made[:, 0]
