"""Surfaces that are worked on in rows, and what of them rows cover."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from cmbot.toolpath.raster.raster import Interval, Raster, RowPiece, cells_of, united

# Shares of an area below which nothing is left out.
_AREA_TOLERANCE = 1e-6


class Surface(ABC):
    """A surface in rows."""

    @property
    @abstractmethod
    def spans(self) -> Sequence[Sequence[Interval]]:
        """Of each row the pieces that are on the surface, m along it."""

    @property
    @abstractmethod
    def area(self) -> float:
        """Area, m2."""

    @abstractmethod
    def covered(self, pieces: Sequence[RowPiece]) -> float:
        """Return the area, m2, within half the distance of two rows from pieces of rows with overscan."""

    @property
    def pieces(self) -> tuple[RowPiece, ...]:
        """All of the rows."""
        return tuple(piece for cell in self.cells for piece in cell)

    @property
    def cells(self) -> list[tuple[RowPiece, ...]]:
        """Its pieces in cells."""
        return cells_of(self.spans)


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """What rows cover of a surface.

    Attributes
    ----------
    area : float
        Of the surface, m2.
    left_out : float
        What of it is further than half the distance of two rows from all rows, or beyond their ends, m2.
    unreached : float
        What of that whole rows would cover, m2: it is out of the arm's reach, or `Raster.pieces` leave it
        out.
    """

    area: float
    left_out: float = 0.0
    unreached: float = 0.0

    @property
    def covered(self) -> float:
        """Area that is covered, m2."""
        return self.area - self.left_out

    @staticmethod
    def of(surface: Surface, pieces: Sequence[RowPiece]) -> Coverage:
        """Return what pieces of rows cover."""
        covered = surface.covered(pieces)
        left_out, unreached = surface.area - covered, surface.covered(surface.pieces) - covered
        least = _AREA_TOLERANCE * surface.area
        return Coverage(
            area=surface.area,
            left_out=left_out if left_out > least else 0.0,
            unreached=unreached if unreached > least else 0.0,
        )


@dataclass(frozen=True)
class PlainSurface(Surface):
    """A rectangle or a part of a cylinder: its rows cross all of it."""

    raster: Raster

    @property
    def spans(self) -> Sequence[Sequence[Interval]]:
        """All of each row."""
        return [[(0.0, self.raster.sides[0])]] * self.raster.rows

    @property
    def area(self) -> float:
        """Area, m2."""
        return self.raster.area

    def covered(self, pieces: Sequence[RowPiece]) -> float:
        """Return the area of the strips along pieces of rows; beside the first and the last row, of half."""
        raster = self.raster
        (length, height), over = raster.sides, raster.overscan_m
        pitch, closed = height / raster.steps, raster.rows == raster.steps
        total = 0.0
        for row in {piece.row for piece in pieces}:
            width = pitch if closed or 0 < row < raster.rows - 1 else 0.5 * pitch
            own = [(one.begin_m - over, one.end_m + over) for one in pieces if one.row == row]
            total += width * sum(max(min(end, length) - max(begin, 0.0), 0.0) for begin, end in united(own))
        return total
