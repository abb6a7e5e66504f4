"""Pieces of rows, and cells: pieces that follow on each other from row to row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from cmbot.common.errors import InputError
from cmbot.common.reading.fields import SHORTEST_LEG
from cmbot.common.reading.validation import CheckedFields

MOST_ROWS = 500
"""Of a raster."""

Interval = tuple[float, float]
"""Where a piece of a row begins and ends, m along it."""

_Along = Annotated[float, Field(ge=-1e-3, le=1e5)]


@dataclass(frozen=True, kw_only=True)
class RowPiece(CheckedFields):
    """A piece of a row.

    Attributes
    ----------
    row : int
        Counted from 0.
    begin_m, end_m : float
        Where it begins and ends, m along the row, without overscan: of a rectangle from the edge `v`, of a
        cylinder on its surface, over faces across `along` from where the first of all faces begins.

    Raises
    ------
    InputError
        When a field is out of its bounds, or it ends before it begins.
    """

    row: Annotated[int, Field(ge=0, lt=MOST_ROWS)]
    begin_m: _Along
    end_m: _Along

    def _check(self) -> None:
        if self.end_m - self.begin_m < SHORTEST_LEG:
            expected = f"more than begin_m, {self.begin_m:g}"
            raise InputError("RowPiece", "end_m", f"{self.end_m:g}", expected)

    @property
    def length(self) -> float:
        """Length, m."""
        return self.end_m - self.begin_m


def cells_of(rows: Sequence[Sequence[Interval]]) -> list[tuple[RowPiece, ...]]:
    """Return the cells of rows that are in pieces, by where they begin (Choset and Pignon, 1998).

    A piece continues the cell of the piece before where each of both overlaps the other alone, or both are
    all of their rows. Where rows split or join, at a hole or a notch, cells end and others begin.

    Parameters
    ----------
    rows : sequence of sequences of (float, float)
        The pieces of each row, in order along it.
    """
    cells, open_cells = list[list[RowPiece]](), list[list[RowPiece]]()
    before: Sequence[Interval] = ()
    for k, pieces in enumerate(rows):
        over = [[i for i, one in enumerate(before) if _overlap(one, piece)] for piece in pieces]
        shared = [sum(i in each for each in over) for i in range(len(before))]
        now = list[list[RowPiece]]()
        for (begin, end), each in zip(pieces, over, strict=True):
            piece = RowPiece(row=k, begin_m=begin, end_m=end)
            if len(before) == len(pieces) == 1:
                each = [0]
                shared = [1]
            if len(each) == 1 and shared[each[0]] == 1:
                now.append(open_cells[each[0]])
            else:
                now.append([])
                cells.append(now[-1])
            now[-1].append(piece)
        before, open_cells = pieces, now
    return [tuple(cell) for cell in cells]


def united(intervals: Sequence[Interval]) -> list[Interval]:
    """Return the union of intervals, as intervals in order that do not touch."""
    union = list[Interval]()
    for begin, end in sorted(intervals):
        if union and begin <= union[-1][1]:
            union[-1] = (union[-1][0], max(end, union[-1][1]))
        else:
            union.append((begin, end))
    return union


def without(intervals: Sequence[Interval], others: Sequence[Interval]) -> list[Interval]:
    """Return what of intervals is in none of the others, where that is longer than a micrometre."""
    left = list[Interval]()
    for begin, end in intervals:
        for first, last in united(others):
            if first > begin and last > begin and first < end:
                left.append((begin, first))
            begin = max(begin, last) if first < end else begin
        left.append((begin, end))
    return [(begin, end) for begin, end in left if end - begin > SHORTEST_LEG]


def _overlap(one: Interval, other: Interval) -> bool:
    return one[0] < other[1] and other[0] < one[1]
