"""Tables of a reproduction: goals with their figures, and numbers as text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

Row = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class GoalRow:
    """Figures of one quantity, and their goal."""

    setting: str  # which motion, in which simulation
    what: str  # the quantity with its unit: per cent or mm
    values: tuple[float | None, ...]  # None where nothing is judged
    goal: str = ""  # empty in a row that only compares or explains
    holds: bool | None = None  # None without a goal, or without a value to judge


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One requirement, what was found, and whether it is met."""

    asked: str
    found: str
    holds: bool


@dataclass(frozen=True, kw_only=True)
class GoalTable:
    """The figures of one goal."""

    title: str
    columns: tuple[str, ...]  # names of the rows' values
    rows: tuple[GoalRow, ...]
    remarks: tuple[str, ...]  # whether the goal holds and, where it does not, why
    verdicts: tuple[Verdict, ...] = ()  # the same in short; empty without a requirement


def cells(table: GoalTable) -> Iterator[Row]:
    """Yield the headings, then the rows, as text; the goal has a column where any row has one."""
    judged = any(row.goal for row in table.rows)
    yield "", "", *table.columns, *(("goal", "holds") if judged else ())
    for row in table.rows:
        digits = 1 if row.what.endswith("%") else 2
        verdict = {True: "yes", False: "no", None: ""}[row.holds]
        values = ("-" if value is None else decimals([value], digits)[0] for value in row.values)
        yield row.setting, row.what, *values, *((row.goal, verdict) if judged else ())


def markdown_table(rows: Iterable[Row], *, text_columns: int) -> Iterator[str]:
    """Yield the lines of a Markdown table; the first row has the headings, the last columns are numbers."""
    head, *others = rows
    yield f"| {' | '.join(head)} |"
    yield f"|{'|'.join('---' if number < text_columns else '--:' for number in range(len(head)))}|"
    for row in others:
        yield f"| {' | '.join(row)} |"


def decimals(values: ArrayLike, digits: int) -> Row:
    """Return numbers as text with `digits` decimals, zero without a sign."""
    return tuple(f"{value:z.{digits}f}" for value in np.asarray(values, float).tolist())


def numbers(*parts: ArrayLike) -> tuple[float, ...]:
    """Return arrays and numbers as one tuple of numbers."""
    return tuple(np.hstack(parts).tolist())
