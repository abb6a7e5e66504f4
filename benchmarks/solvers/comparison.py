"""Solvers on the same problems (`solvers.cases`): cmbot's two, Ipopt, SLSQP in the paper's formulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from measure import process_time

from cmbot import load_scene
from cmbot.common.reading.validation import counted
from cmbot.trajectory.quintic import QuinticTrajectory
from solvers.cases import Case, case_of, judged, random_scene
from solvers.ipopt import Answer, solve_sampled
from solvers.literal import solve_literal

__all__ = ["Solved", "compared", "solved_by_cmbot", "solved_by_other", "to_the_letter"]

FAST, SLSQP, LITERAL = "sqp", "slsqp", "literal slsqp"
# With all samples as rows, by L-BFGS or with the exact Hessian.
IPOPT = {"ipopt, l-bfgs": False, "ipopt, exact": True}


@dataclass(frozen=True, kw_only=True)
class Solved:
    """What a solver made of a problem.

    Attributes
    ----------
    problem, knots, solver : str
    seconds : float
        Processor time from the via-points to the trajectory.
    peak : float, Nm
    objective : float
        Peak in units of the start's, and the smoothing; judged on all samples.
    violation : float
        Largest, as a share of the bound.
    iterations, rows : int
        Of all exchange iterations together; constraints of the last.
    status : str
        How it ended, in the solver's words.
    """

    problem: str
    knots: str
    solver: str
    seconds: float
    peak: float
    objective: float
    violation: float
    iterations: int
    rows: int
    status: str


def compared(
    *, quick: bool, literal_seconds: float, ipopt_seconds: float, tell: Callable[[str], None]
) -> Iterator[Solved]:
    """Solve every problem with every solver.

    Parameters
    ----------
    quick : bool
        Only the random path and the sliding ones, and only cmbot's solvers.
    literal_seconds, ipopt_seconds : float
        When they are stopped; 0: left out.
    tell : callable
        Called with what is being measured.

    Raises
    ------
    MissingExtra
        When PIQP, or with Ipopt casadi, is not installed.
    """
    random, line, triangle = case_of(random_scene(), "fixed"), load_scene("line"), load_scene("triangle")
    # With fixed via-points the triangle's peak is at a resting end: there is nothing to compare.
    fixed = [random] if quick else [random, case_of(line, "fixed")]
    for case in (*fixed, case_of(line, "sliding"), case_of(triangle, "sliding")):
        for solver in (FAST, SLSQP):
            tell(f"{case.name}, {case.knots}: {solver}")
            yield solved_by_cmbot(case, solver)
        for solver, exact in () if quick or not ipopt_seconds else IPOPT.items():
            tell(f"{case.name}, {case.knots}: {solver}")
            yield solved_by_other(case, solver, solve_sampled(case, exact=exact, seconds=ipopt_seconds))
    if literal_seconds:
        tell(f"{random.name}, fixed: {LITERAL}, {literal_seconds:.0f} s at most")
        yield to_the_letter(random, literal_seconds)


def to_the_letter(case: Case, seconds: float) -> Solved:
    """Solve the literal problem once."""
    taken, answer = process_time(lambda: solve_literal(case, seconds=seconds), repeats=1)
    status = f"cut after {seconds:.0f} s" if answer.cut else answer.status
    return _solved(case, LITERAL, taken, answer.trajectory, answer.iterations, answer.rows, status)


def solved_by_cmbot(case: Case, solver: str, repeats: int = 3) -> Solved:
    """Solve a case with ``sqp`` or ``slsqp``."""
    seconds, found = process_time(lambda: case.solve(solver), repeats)
    iterations = sum(report.iterations for report in found.passes)
    rows = found.passes[-1].constraints
    status = counted(len(found.passes), "pass", "passes")
    return _solved(case, solver, seconds, found.parametrization.trajectory, iterations, rows, status)


def solved_by_other(case: Case, solver: str, answer: Answer) -> Solved:
    """Judge what another solver found."""
    return _solved(
        case, solver, answer.seconds, answer.trajectory, answer.iterations, answer.rows, answer.status
    )


def _solved(
    case: Case,
    solver: str,
    seconds: float,
    trajectory: QuinticTrajectory,
    iterations: int,
    rows: int,
    status: str,
) -> Solved:
    found = judged(case, case.problem(), trajectory)
    return Solved(
        problem=case.name,
        knots=case.knots,
        solver=solver,
        seconds=seconds,
        peak=found.peak,
        objective=found.objective,
        violation=found.violation,
        iterations=iterations,
        rows=rows,
        status=status,
    )
