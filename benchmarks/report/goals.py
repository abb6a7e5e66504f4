"""What was to be reached, and whether this run did: worked out from the results alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["MEGABYTE", "SAME_OPTIMUM", "Goal", "beside", "goals", "ratio", "total"]

# Objectives nearer than this share are the same optimum; violations up to it are none.
SAME_OPTIMUM = 1e-4
# Memory is measured in units of the first, byte, and shown in decimal ones.
MEGABYTE, _GIGABYTE = 2.0**20, 1e9


@dataclass(frozen=True, kw_only=True)
class Goal:
    """One goal.

    Attributes
    ----------
    what : str
    bound : str
        What was to be reached, in words and units.
    measured : float or None
        None: not measured in this run.
    unit : str
    met : bool or None
    remark : str
        Which problem decided, and what else a reader should know.
    """

    what: str
    bound: str
    measured: float | None
    unit: str
    met: bool | None
    remark: str = ""


def goals(results: Mapping[str, Any]) -> list[Goal]:
    """Compare the results of a run with the goals."""
    solvers = results["solvers"]
    return [
        _times_quicker("quicker than Ipopt, fixed via-points", 50, solvers, "ipopt, "),
        _times_quicker("quicker than the literal problem", 1000, solvers, "literal slsqp"),
        _quicker_than_snopt(results.get("formulations", [])),
        _slowest("core problem, fixed via-points", 0.15, "core", results),
        _slowest("sliding polish, as planned", 0.5, "polish", results),
        _command(results),
        *_growth(results),
    ]


def beside(solvers: Sequence[Mapping[str, Any]], row: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what the fast solver made of a row's problem."""
    return next(
        other
        for other in solvers
        if other["solver"] == "sqp" and all(other[key] == row[key] for key in ("problem", "knots"))
    )


def ratio(solvers: Sequence[Mapping[str, Any]], row: Mapping[str, Any]) -> float:
    """Time of a row in units of the fast solver's on the same problem."""
    return float(row["seconds"] / beside(solvers, row)["seconds"])


def _times_quicker(what: str, bound: float, solvers: Sequence[Mapping[str, Any]], kind: str) -> Goal:
    """The least ratio over the problems; of a solver's variants the quickest that got there counts."""
    text = f"at least {bound} x, same optimum or better"
    best: dict[str, Mapping[str, Any]] = {}
    for row in solvers:
        if not row["solver"].startswith(kind) or row["knots"] != "fixed":
            continue
        other = best.get(row["problem"])
        if other is None or (not arrived(solvers, row), row["seconds"]) < (
            not arrived(solvers, other),
            other["seconds"],
        ):
            best[row["problem"]] = row
    if not best:
        return Goal(what=what, bound=text, measured=None, unit="x", met=None, remark="not measured")
    least = min(best.values(), key=lambda row: ratio(solvers, row))
    measured = ratio(solvers, least)
    same = all(as_good(beside(solvers, row), row) for row in best.values())
    remark = f"on {least['problem']}, {least['solver']}"
    if not same:
        remark += "; the optimum is worse"
    if least["status"].startswith("cut"):
        remark += f"; {least['status']}"
    return Goal(
        what=what, bound=text, measured=measured, unit="x", met=measured >= bound and same, remark=remark
    )


def _quicker_than_snopt(rows: Sequence[Mapping[str, Any]]) -> Goal:
    """The least ratio of SNOPT's time to sqp's, both in the exchange."""
    what, text = "quicker than SNOPT in the exchange", "more than 1 x on every problem"
    ratios = []
    for row in rows:
        if (row["rows"], row["solver"]) == ("exchange", "snopt"):
            same = (other for other in rows if all(other[k] == row[k] for k in ("problem", "knots")))
            fast = next(other for other in same if other["solver"] == "sqp")
            remark = f"on {row['problem']}, {row['knots']}"
            if row["objective"] is None:
                remark += f"; {row['status']}"
            ratios.append((row["seconds"] / fast["seconds"], remark))
    if not ratios:
        return Goal(what=what, bound=text, measured=None, unit="x", met=None, remark="not measured")
    least, remark = min(ratios)
    return Goal(what=what, bound=text, measured=least, unit="x", met=least > 1, remark=remark)


def as_good(fast: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether the fast solver's optimum is the other's or better, and keeps the constraints."""
    reached = fast["violation"] <= SAME_OPTIMUM
    return bool(reached and fast["objective"] <= other["objective"] * (1 + SAME_OPTIMUM))


def arrived(solvers: Sequence[Mapping[str, Any]], row: Mapping[str, Any]) -> bool:
    """Whether a row is no further than that from the fast solver's optimum."""
    fast = beside(solvers, row)
    return bool(
        row["violation"] <= SAME_OPTIMUM and row["objective"] <= fast["objective"] * (1 + SAME_OPTIMUM)
    )


def _slowest(what: str, bound: float, stage: str, results: Mapping[str, Any]) -> Goal:
    """The shipped scene on which a stage of planning takes longest."""
    times = {row["scene"]: row[stage] for row in results["planned"] if row[stage] is not None}
    scene = max(times, key=times.__getitem__, default="")
    return _below(what, bound, times.get(scene), "s", f"on {scene}, the slowest")


def _command(results: Mapping[str, Any]) -> Goal:
    triangle = next(row for row in results["planned"] if row["scene"] == "triangle")
    remark = f"wall time, solver {triangle['solver']}"
    return _below("whole `cmbot plan triangle`", 1.8, triangle["command"], "s", remark)


def _growth(results: Mapping[str, Any]) -> list[Goal]:
    largest = next((row for row in results["growth"] if row["via_points"] == 5000), None)
    time = None if largest is None else largest["global_stage"] + largest["optimisation"]
    memory = None if largest is None else largest["memory"] * MEGABYTE / _GIGABYTE
    remark = "global stage and optimisation"
    return [
        _below("5,000 via-points", 60.0, time, "s", remark),
        _below("5,000 via-points, memory", 2.0, memory, "GB"),
    ]


def total(row: Mapping[str, Any]) -> float:
    """Processor time of all stages of a size, s."""
    return float(row["global_stage"] + row["optimisation"] + row["certificate"])


def _below(what: str, bound: float, measured: float | None, unit: str, remark: str = "") -> Goal:
    met = None if measured is None else measured < bound
    remark = remark if measured is not None else "not measured"
    return Goal(
        what=what, bound=f"below {bound:g} {unit}", measured=measured, unit=unit, met=met, remark=remark
    )
