"""What of a ratio is the solver's and what the formulation's: SNOPT and Ipopt through Drake beside cmbot's.

The problems are those of `solvers.cases`, the splines the same. Samples are rows: 10 or 40 of every segment,
of the peak alone or of all constraints. SNOPT in cmbot's exchange has the same rows as SLSQP there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

from measure import in_a_child, required

from cmbot import load_scene
from cmbot.common.errors import OptimisationFailed
from cmbot.common.reading.validation import counted
from cmbot.optimization.exchange import Result
from solvers.cases import Case, case_of, judged, random_scene
from solvers.comparison import FAST, SLSQP
from solvers.drake_exchange import solve_by_exchange
from solvers.drake_sampled import solve_by_drake
from solvers.ipopt import Answer

__all__ = ["EXCHANGE", "Formulated", "formulated", "formulated_case", "solved_in_time"]

EXCHANGE = "exchange"
# Solved again, for the shortest time, while all of it takes no longer than this, s.
_WORTH, _REPEATS = 3.0, 3


@dataclass(frozen=True, kw_only=True)
class Formulated:
    """What a solver made of a problem in one formulation.

    Attributes
    ----------
    problem, knots, solver, rows : str
        Rows are those of the ``exchange``, ``peak`` or ``all``.
    samples : int
        Of every segment; of the exchange those at which it looks for violations.
    seconds : float
        Processor time, the shortest; where it was cut, until then.
    objective : float or None
        Peak in units of the start's, and the smoothing; judged on all samples. None where it was cut.
    violation : float or None
        Largest of all constraints, as a share of the bound, whether or not they were rows.
    iterations, constraints : int
        0 where it was cut.
    status : str
    """

    problem: str
    knots: str
    solver: str
    rows: str
    samples: int
    seconds: float
    objective: float | None = None
    violation: float | None = None
    iterations: int = 0
    constraints: int = 0
    status: str


def formulated(*, seconds: float, tell: Callable[[str], None]) -> Iterator[Formulated]:
    """Solve every problem in every formulation, each cut after so many `seconds` of processor time.

    Raises
    ------
    MissingExtra
        When PIQP or Drake is not installed.
    """
    required("pydrake.solvers")
    line, triangle = load_scene("line"), load_scene("triangle")
    posed = [(random_scene(), "fixed"), (line, "fixed"), (line, "sliding"), (triangle, "sliding")]
    for scene, knots in posed:
        case = case_of(scene, knots)
        yield from formulated_case(case, seconds, tell)


def formulated_case(case: Case, seconds: float, tell: Callable[[str], None]) -> Iterator[Formulated]:
    """Solve one problem in every formulation; what was cut with fewer rows is not tried with more."""
    cut: list[tuple[str, str, int]] = []
    for solver, rows, samples, way in _ways(case):
        if any(solver == s and rows in (r, "all") and samples >= n for s, r, n in cut):
            yield replace(_unsolved(case, solver, rows, samples), status="cut with fewer rows")
            continue
        tell(f"{case.name}, {case.knots}: {solver}, {rows}, {samples} samples a segment")
        found = solved_in_time(case, solver, rows, samples, way, seconds)
        if found.status.startswith("cut"):
            cut.append((solver, rows, samples))
        yield found


def _ways(case: Case) -> Iterator[tuple[str, str, int, Callable[[], Answer]]]:
    """Solvers, rows, samples and what solves the case with them."""
    samples = case.request.cell.options.samples_per_segment
    for solver in (FAST, SLSQP):
        yield solver, EXCHANGE, samples, partial(_by_exchange, partial(case.solve, solver))
    yield "snopt", EXCHANGE, samples, partial(_by_exchange, partial(solve_by_exchange, case))
    for solver, rows, samples in product(("snopt", "ipopt"), ("peak", "all"), (10, 40)):
        yield (
            solver,
            rows,
            samples,
            partial(solve_by_drake, case, solver, samples=samples, peak_alone=rows == "peak"),
        )


def solved_in_time(
    case: Case, solver: str, rows: str, samples: int, way: Callable[[], Answer], seconds: float
) -> Formulated:
    """Solve a case in a child process and judge the answer."""
    begin = _unsolved(case, solver, rows, samples)
    ended = in_a_child(lambda: _quickest(way), seconds)
    if ended is None:
        return replace(begin, seconds=seconds, status=f"cut after {seconds:.0f} s")
    if isinstance(ended, str):
        return replace(begin, status=ended)
    judgement = judged(case, case.problem(), ended.trajectory)
    return replace(
        begin,
        seconds=ended.seconds,
        objective=judgement.objective,
        violation=judgement.violation,
        iterations=ended.iterations,
        constraints=ended.rows,
        status=ended.status,
    )


def _unsolved(case: Case, solver: str, rows: str, samples: int) -> Formulated:
    return Formulated(
        problem=case.name,
        knots=case.knots,
        solver=solver,
        rows=rows,
        samples=samples,
        seconds=0.0,
        status="not solved",
    )


def _quickest(way: Callable[[], Answer]) -> Answer | str:
    """The quickest of several answers, or the reason why there is none."""
    begin, answers = time.process_time(), []
    try:
        while len(answers) < _REPEATS and time.process_time() - begin < _WORTH:
            answers.append(way())
    except OptimisationFailed as error:
        return str(error)
    return min(answers, key=lambda answer: answer.seconds)


def _by_exchange(solve: Callable[[], Result]) -> Answer:
    begin = time.process_time()
    found = solve()
    return Answer(
        trajectory=found.parametrization.trajectory,
        iterations=sum(each.iterations for each in found.passes),
        status=counted(len(found.passes), "pass", "passes"),
        rows=found.passes[-1].constraints,
        seconds=time.process_time() - begin,
    )
