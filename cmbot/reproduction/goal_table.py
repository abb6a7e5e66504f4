"""A table of figures beside what they are to be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray

__all__ = ["GoalRow", "GoalTable", "Verdict", "axes_where", "cells", "values"]


@dataclass(frozen=True, kw_only=True)
class GoalRow:
    """Some figures, and what they are to be.

    Attributes
    ----------
    setting : str
        Of which motion, in which simulation.
    what : str
        With its unit: per cent or mm.
    values : tuple of float or None
        None where nothing is asked.
    goal : str
        Empty where the row is there to compare or to explain.
    holds : bool or None
        None where there is no goal, or no value that it asks for.
    """

    setting: str
    what: str
    values: tuple[float | None, ...]
    goal: str = ""
    holds: bool | None = None


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One thing that is asked, and whether it is so.

    Attributes
    ----------
    asked, found : str
    holds : bool
    """

    asked: str
    found: str
    holds: bool


@dataclass(frozen=True, kw_only=True)
class GoalTable:
    """The figures of one goal.

    Attributes
    ----------
    title : str
    columns : tuple of str
        Names of the rows' values.
    rows : tuple of GoalRow
    remarks : tuple of str
        Whether the goal holds and, where it does not, why.
    verdicts : tuple of Verdict
        The same in short; none where nothing is asked.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[GoalRow, ...]
    remarks: tuple[str, ...]
    verdicts: tuple[Verdict, ...] = ()


def cells(table: GoalTable) -> Iterator[tuple[str, ...]]:
    """Yield the headings, then the rows, as text; without a goal in any row there is no column for it."""
    judged = any(row.goal for row in table.rows)
    yield "", "", *table.columns, *(("goal", "holds") if judged else ())
    for row in table.rows:
        digits = 1 if row.what.endswith("%") else 2
        verdict = {True: "yes", False: "no", None: ""}[row.holds]
        numbers = (_cell(value, digits) for value in row.values)
        yield row.setting, row.what, *numbers, *((row.goal, verdict) if judged else ())


def values(*parts: FloatArray | float) -> tuple[float, ...]:
    """Return arrays and numbers as one tuple of numbers."""
    return tuple(float(value) for part in parts for value in np.atleast_1d(part))


def axes_where(true: object) -> list[int]:
    """Return the indices at which an array is true."""
    return [int(axis) for axis in np.flatnonzero(np.asarray(true))]


def _cell(value: float | None, digits: int) -> str:
    # Adding zero turns -0.0 into 0.0.
    return "-" if value is None else f"{round(value, digits) + 0.0:.{digits}f}"
