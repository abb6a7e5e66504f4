"""Programs of others: formulas with their published optima, and the SQP on them."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from finite_differences import check_derivative

pytest.importorskip("casadi")

from programs.hock_schittkowski_larger import PROBLEMS
from programs.nonlinear import Nonlinear, solve
from programs.random_programs import random_program
from report import tables

# Those that end elsewhere, and where: local optima, a flat start, an optimum without multipliers.
_ELSEWHERE = {2: 4.94122931, 16: 23.1446609, 20: 40.1987298, 25: 32.835}
_WITHOUT_MULTIPLIERS = 13


@cache
def made(number: int) -> Nonlinear:
    return Nonlinear(next(problem for problem in PROBLEMS if problem.number == number))


NUMBERS = [problem.number for problem in PROBLEMS]


def test_there_are_fifty_two_and_no_two_alike() -> None:
    assert len(NUMBERS) == len(set(NUMBERS)) == 52


@pytest.mark.parametrize("number", NUMBERS)
def test_derivatives(number: int) -> None:
    program = made(number)
    # The start of number 25 is flat.
    start = np.array([60.0, 20.0, 1.4]) if number == 25 else program.start
    x = np.clip(start, program.low, program.high) * 1.01 + 0.003
    f, rows = program.values(x)
    slope, J = program.derivatives(x)
    size = np.maximum(1.0, np.abs(x))

    def scaled(y: np.ndarray) -> np.ndarray:
        value, own = program.values(y * size)
        return np.append(value / max(1.0, abs(f)), own / np.maximum(1.0, np.abs(rows)))

    expected = np.vstack([slope / max(1.0, abs(f)), J.toarray() / np.maximum(1.0, np.abs(rows))[:, None]])
    check_derivative(scaled, x / size, expected * size, rtol=1e-5)


@pytest.mark.parametrize("number", NUMBERS)
def test_the_published_optimum_is_found(number: int) -> None:
    """By the SQP; or, as listed above, another local optimum."""
    if number == _WITHOUT_MULTIPLIERS:
        # There a constraint is the cube of the distance: a violation v moves the objective by 2 v**(1/3).
        outcome = solve(made(number), "slsqp", 1)
        assert outcome.violation <= 1e-9
        assert outcome.objective == pytest.approx(1.0, abs=2 * 1e-9 ** (1 / 3))
        return
    program, outcome = made(number), solve(made(number), "sqp", 1)
    assert outcome.violation <= 1e-5
    optimum = _ELSEWHERE.get(number, program.problem.optimum)
    assert outcome.objective == pytest.approx(optimum, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize(
    ("number", "x"), [(2, None), (16, [0.5, 0.25]), (20, [0.5, 0.75**0.5]), (25, [50, 25, 1.5])]
)
def test_optima_where_no_solver_goes(number: int, x: list[float] | None) -> None:
    program = made(number)
    if x is None:
        a = (598 / 1200) ** 0.5
        x = [2 * a * np.cos(np.arccos(1 / (400 * a**3)) / 3), 1.5]
    objective, violation = program.outcome(np.array(x))
    assert objective == pytest.approx(program.problem.optimum, rel=1e-7, abs=1e-7)
    assert violation <= 1e-7


def test_a_random_program_has_derivatives_and_one_optimum(rng: np.random.Generator) -> None:
    program = random_program(1, blocks=3)
    x = 0.3 * rng.normal(size=len(program.start))
    slope, J = program.derivatives(x)
    check_derivative(lambda y: program.values(y)[0], x, slope, rtol=1e-7)
    check_derivative(lambda y: program.values(y)[1], x, J.toarray(), rtol=1e-6)
    by_sqp, by_slsqp = (solve(program, solver, 1) for solver in ("sqp", "slsqp"))
    assert by_sqp.status == "converged"
    assert by_sqp.violation <= 1e-7
    assert by_sqp.objective == pytest.approx(by_slsqp.objective, rel=1e-6)


def test_how_a_solver_ended() -> None:
    def outcome(objective: float, violation: float, status: str) -> dict[str, Any]:
        return {"objective": objective, "violation": violation, "status": status}

    row = {"optimum": 2.0, "outcomes": [outcome(2.0, 0.0, "solved")]}
    assert tables._end(row, outcome(2.000001, 0.0, "stalled")) == ""
    assert tables._end(row, outcome(3.0, 0.0, "solved")) == "elsewhere"
    assert tables._end(row, outcome(3.0, 0.0, "iteration limit")) == "not solved"
    assert tables._end(row, outcome(2.0, 1e-3, "solved")) == "not solved"
    assert tables._end(row | {"optimum": None}, outcome(2.1, 0.0, "solved")) == "elsewhere"
