"""One run of all benchmarks: a table per theme, ratios first, then every goal beside what was measured.

    python benchmarks/run.py            # or: make bench
    python benchmarks/run.py --quick    # what takes a minute

Results go to benchmarks/results/latest.json, their figure beside it; ``--document`` makes them those that the
documentation shows. Processor times but for whole commands; only ratios mean something on another machine.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from growth import in_a_process
from kernels import kernels
from measure import machine
from planning import planned, start_up
from programs.comparison import compared_programs
from report.document import LATEST, REFERENCE, RESULTS, make_reference
from report.goals import goals
from report.plot import draw
from report.tables import goal_sheet, print_sheets, sheets
from rich.console import Console
from solvers.comparison import compared
from solvers.formulations import formulated
from threadpoolctl import threadpool_limits

from cmbot.common.errors import CmbotError

SCENES = ("triangle", "line")
_SIZES, _QUICK_SIZES = (50, 200, 1000, 5000), (50, 200)
_LITERAL_SECONDS, _IPOPT_SECONDS, _DRAKE_SECONDS = 300.0, 45.0, 45.0
FORMAT = "cmbot-benchmarks/1"
# The widest table; what is narrower would cut its cells.
_WIDTH = 170


def formulations(arguments: argparse.Namespace, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Solve the same problems in other formulations, by Drake's solvers too."""
    return [asdict(each) for each in formulated(seconds=_DRAKE_SECONDS, tell=tell)]


def programs(_: argparse.Namespace, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Solve programs of others by the SQP itself and by other solvers."""
    return list(compared_programs(tell))


def scenes(arguments: argparse.Namespace, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Plan and simulate the shipped scenes."""
    found = []
    for name in SCENES:
        tell(f"planning and simulating: {name}")
        found.append(asdict(planned(name, repeats=2 if arguments.quick else 3)))
    return found


def started(_: argparse.Namespace, tell: Callable[[str], None]) -> dict[str, float]:
    """Start processes."""
    tell("start-up")
    return start_up()


# What can be measured alone; the first two take long.
APART = {"formulations": formulations, "programs": programs, "planned": scenes, "start_up": started}
_LONG = ("formulations", "programs")


def measured(arguments: argparse.Namespace, tell: Callable[[str], None]) -> dict[str, Any]:
    """Measure everything that the arguments ask for."""
    if arguments.only:
        results = json.loads(REFERENCE.read_text(encoding="utf-8"))
        results |= {theme: APART[theme](arguments, tell) for theme in arguments.only}
        return results | {"goals": [asdict(goal) for goal in goals(results)]}
    quick = arguments.quick
    results: dict[str, Any] = {"format": FORMAT, "quick": quick, "machine": machine()}
    # First: a fresh process inherits the peak of the memory of the one that starts it.
    results["growth"] = []
    for size in _QUICK_SIZES if quick else _SIZES:
        tell(f"growth: {size} via-points")
        results["growth"].append(asdict(in_a_process(size)))
    results["start_up"] = started(arguments, tell)
    tell("kernels")
    results["kernels"] = kernels()
    results["planned"] = scenes(arguments, tell)
    results["solvers"] = [
        asdict(solved)
        for solved in compared(
            quick=quick,
            literal_seconds=0.0 if quick else arguments.literal_seconds,
            ipopt_seconds=0.0 if arguments.no_ipopt else _IPOPT_SECONDS,
            tell=tell,
        )
    ]
    if not quick:
        results |= {theme: APART[theme](arguments, tell) for theme in _LONG}
    results["goals"] = [asdict(goal) for goal in goals(results)]
    return results


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description="Measure what cmbot costs.")
    parser.add_argument("--quick", action="store_true", help="leave out what takes long")
    parser.add_argument(
        "--literal-seconds",
        type=float,
        default=_LITERAL_SECONDS,
        help="when the literal problem is cut (default: %(default)g); 0 leaves it out",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        choices=list(APART),
        default=[],
        help="measure these themes alone, and take the others from the last results that were documented",
    )
    parser.add_argument("--no-ipopt", action="store_true", help="leave out Ipopt, which needs casadi")
    parser.add_argument("--document", action="store_true", help="put the results into the documentation, too")
    arguments = parser.parse_args()
    console, progress = Console(width=max(_WIDTH, Console().width)), Console(stderr=True)
    try:
        with threadpool_limits(limits=1):
            results = measured(arguments, lambda what: progress.print(what, style="dim"))
        RESULTS.mkdir(exist_ok=True)
        LATEST.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
        print_sheets([*sheets(results), goal_sheet(goals(results))], console)
        draw(results, LATEST.with_suffix(".png"))
    except CmbotError as error:
        sys.exit(f"error: {error}")
    console.print(f"Written to {LATEST}.")
    if arguments.document:
        make_reference()


if __name__ == "__main__":
    main()
