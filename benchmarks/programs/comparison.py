"""cmbot's SQP by itself, on programs of others, beside SLSQP, Ipopt and SNOPT."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

from programs.hock_schittkowski_larger import PROBLEMS
from programs.nonlinear import SOLVERS, Nonlinear, solve
from programs.random_programs import random_program

__all__ = ["compared_programs"]

_RANDOM = 3


def compared_programs(tell: Callable[[str], None]) -> Iterator[dict[str, Any]]:
    """Solve every program with every solver.

    Raises
    ------
    MissingExtra
        When PIQP, casadi or Drake is not installed.
    """
    made = [(lambda problem=problem: Nonlinear(problem)) for problem in PROBLEMS]
    made += [(lambda seed=seed: random_program(seed)) for seed in range(1, _RANDOM + 1)]
    for make in made:
        program = make()
        tell(program.problem.name)
        known = program.problem.optimum == program.problem.optimum
        yield {
            "problem": program.problem.name,
            "unknowns": len(program.start),
            "rows": int(program.g.numel_out(0)),
            "optimum": program.problem.optimum if known else None,
            "remark": program.problem.remark,
            "outcomes": [asdict(solve(program, solver)) for solver in SOLVERS],
        }
