"""What a scene file says of rasters: parallel rows over a rectangle, a cylinder or faces of a mesh.

Rows are in pieces, these in cells: pieces that follow on each other from row to row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.fields import (
    LONGEST,
    MILLIMETRES,
    SHORTEST_LEG,
    Angle,
    Length,
    LongVector,
    MeshName,
    Slug,
    UnitVector,
    Vector,
    given_of,
    is_mesh_file,
    no_thousands,
)
from cmbot.common.reading.validation import CheckedFields, shown
from cmbot.common.representation import ShortRepr

MOST_ROWS = 500
"""Of a raster."""

Interval = tuple[float, float]
"""Where a piece of a row begins and ends, m along it."""

# Longer edges, and what is further off a surface, m, are millimetres.
_LONGEST_EDGE_M, _FURTHEST_OFF_M = 50.0, 5.0
_Edge = Annotated[LongVector, no_thousands(_LONGEST_EDGE_M, MILLIMETRES)]
_Off = Annotated[float, Field(ge=0, le=LONGEST), no_thousands(_FURTHEST_OFF_M, MILLIMETRES)]
_Along = Annotated[float, Field(ge=-1e-3, le=1e5)]
# Cosine of the angle between two edges that are at right angles.
_RIGHT_ANGLE_COSINE = 1e-6
_Lean = Annotated[float, Field(ge=-60, le=60)]
_RECTANGLE, _FACES = ("origin", "u", "v"), ("mesh", "faces", "along")


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


@dataclass(frozen=True, kw_only=True)
class CylinderPatch(CheckedFields):
    """A part of a cylinder's surface.

    Attributes
    ----------
    centre : three floats
        Point of its axis in the middle of its length, m, in the raster's `frame`.
    axis : three floats
        Direction of its axis in that frame, a unit vector.
    radius : float
        Of its surface, m.
    from_deg, to_deg : float
        Angles about the axis between which it lies, by the right-hand rule. At 0 is the z axis of the frame,
        made square to the cylinder's; of a cylinder within 10 degrees of z the frame's x axis.
    length : float
        Along the axis, m.
    rows : str
        ``along`` the axis, the first at `from_deg`; or ``around`` it from `from_deg` to `to_deg`, the first
        one at the end from which the axis points away.

    Raises
    ------
    InputError
        When a field is out of its bounds, or the angles are the same or more than a turn apart.
    """

    centre: Vector
    axis: UnitVector
    radius: Length
    from_deg: Angle
    to_deg: Angle
    length: Length
    rows: Literal["along", "around"] = "along"

    def _check(self) -> None:
        if not 0 < abs(self.to_deg - self.from_deg) <= 360:
            expected = f"another angle than from_deg {self.from_deg:g}, and at most 360 from it"
            raise InputError("CylinderPatch", "to_deg", f"{self.to_deg:g}", expected)

    @property
    def angle(self) -> float:
        """Angle from the beginning to the end, rad."""
        return float(np.radians(self.to_deg - self.from_deg))

    @property
    def is_closed(self) -> bool:
        """Whether it goes all the way round."""
        return abs(self.to_deg - self.from_deg) == 360


@dataclass(frozen=True, kw_only=True)
class FaceSelection(CheckedFields):
    """Which faces of a mesh: all that pass.

    Attributes
    ----------
    normal : three floats
        Direction out of the mesh, in the raster's `frame`, a unit vector.
    within_deg : float
        Angle from there to the normal of a face at most.
    box : two corners or None
        Smallest and largest coordinates, m, in that frame, between which all corners of a face lie. Left out:
        everywhere.

    Raises
    ------
    InputError
        When a field is out of its bounds, or the box is none.
    """

    normal: UnitVector
    within_deg: Annotated[float, Field(ge=0, le=80)] = 20.0
    box: tuple[Vector, Vector] | None = None

    def _check(self) -> None:
        if self.box is not None and not (np.array(self.box[0]) < np.array(self.box[1])).all():
            expected = "smallest coordinates, then larger ones"
            raise InputError("FaceSelection", "box", shown(self.box), expected)


@dataclass(frozen=True, kw_only=True)
class Raster(CheckedFields, ShortRepr):
    """Parallel rows, to and fro, with the tool square to a surface, or leaning.

    That is a rectangle, a part of a cylinder or faces of a mesh. The first and the last row lie on the edges
    of a rectangle or a cylinder, over faces half a spacing inside of their ends. There rows follow smoothed
    normals, and what is flat to 0.1 mm is a plane. From row to row the tool goes straight. Gaps in a plane up
    to the spacing are passed with the tool on. Where rows are in several pieces, at holes, notches or where
    the arm's reach ends, each part whose rows follow each other is a stroke, with free moves between them.

    Attributes
    ----------
    origin : three floats or None
        Corner of a rectangle at which the first row begins, m, in `frame`.
    u, v : three floats or None
        Its edges from there, m, in `frame`, at right angles: rows run along `u`, the next one lies along `v`.
        The tool's z axis points against ``u x v``.
    cylinder : CylinderPatch or None
        Part of a cylinder, worked on from outside: the tool's z axis points at the cylinder's.
    mesh : str or None
        The name of an obstacle that is a mesh, or the path of a mesh file (GLB, OBJ, OFF, PLY or STL),
        relative to the scene file, placed in `frame`; a file is no obstacle.
    faces : FaceSelection or None
        Those of its faces that are worked on. Left out: all, within 80 degrees of their mean normal.
    along : three floats or None
        Direction in `frame` of the first row over them; the next one lies towards ``normal x along``. Of a
        curved row points at most half a spacing apart, and at least 5, are on a spline. Left out: the faces'
        longer side.
    spacing_m : float
        Distance of two rows at most, m: on the surface, and on faces across their mean normal.
    stand_off_m : float
        Distance of the tool point from the surface, m; of a leaning tool along its axis, which meets the
        surface on the row.
    lean_deg : two floats or None
        Angles from the normal to the tool behind its point, the same on all rows: along the first one, and
        towards the next one.
    overscan_m : float
        By how much rows begin before the surface and end behind it, m; around a cylinder measured on it.
    cover : str
        ``reachable``: what the arm cannot reach is left out, and reported; ``all``: without it there is no
        plan.
    pieces : tuple of RowPiece or None
        Pieces of rows in the order in which they are worked on, to and fro: in the scenes of plans, or to
        leave something out. Left out: all rows.
    frame : str
        ``world``, ``tool`` or the name of one of `frames`.

    Raises
    ------
    InputError
        When a field is out of its bounds, the edges are not at right angles, or the surface is none or two.
    """

    origin: Vector | None = None
    u: _Edge | None = None
    v: _Edge | None = None
    cylinder: CylinderPatch | None = None
    mesh: MeshName | None = None
    faces: FaceSelection | None = None
    along: LongVector | None = None
    spacing_m: Length
    stand_off_m: _Off
    lean_deg: tuple[_Lean, _Lean] | None = None
    overscan_m: _Off = 0.0
    cover: Literal["reachable", "all"] = "reachable"
    pieces: Annotated[tuple[RowPiece, ...] | None, Field(min_length=1, max_length=MOST_ROWS)] = None
    frame: Slug = "world"

    def _check(self) -> None:
        kinds = [
            (names, given)
            for names in (_RECTANGLE, ("cylinder",), _FACES)
            if (given := given_of(self, names))
        ]
        if len(kinds) != 1:
            got = " and ".join(name for _, given in kinds for name in given) or "none"
            expected = "either origin, u and v, or cylinder, or mesh"
            raise InputError("Raster", "", got, expected)
        ((names, given),) = kinds
        for name in names[:1] if names == _FACES else names:
            if name not in given:
                raise InputError("Raster", name, "nothing", "a value beside " + " and ".join(given))
        if self.rectangle is not None:
            _, u, v = map(np.array, self.rectangle)
            if abs(float(u @ v)) > _RIGHT_ANGLE_COSINE * float(np.linalg.norm(u) * np.linalg.norm(v)):
                raise InputError("Raster", "v", shown(self.v), "an edge at right angles to u")
            if self.spacing_m > self.sides[1] * (1 + _RIGHT_ANGLE_COSINE):
                expected = f"at most the length of v, {self.sides[1]:g} m (all are metres)"
                raise InputError("Raster", "spacing_m", self.spacing_m, expected)
        if self.rows > MOST_ROWS:
            raise InputError("Raster", "spacing_m", self.spacing_m, f"at most {MOST_ROWS} rows")
        self._check_pieces()

    def _check_pieces(self) -> None:
        for k, piece in enumerate(self.pieces or ()):
            if k > 0 and self.pieces and piece.row == self.pieces[k - 1].row:
                expected = "another row than that of the piece before"
                raise InputError("Raster", f"pieces[{k}].row", piece.row, expected)
            if self.mesh is None:
                self.check_piece(k, piece, self.rows, self.sides[0])

    @staticmethod
    def check_piece(k: int, piece: RowPiece, rows: int, length: float) -> None:
        """Refuse a piece, the one of number `k`, that is on none of the rows, or beyond their length, m."""
        if piece.row >= rows:
            raise InputError("Raster", f"pieces[{k}].row", piece.row, f"less than {rows}, the number of rows")
        if piece.begin_m < -_RIGHT_ANGLE_COSINE * length or piece.end_m > length * (1 + _RIGHT_ANGLE_COSINE):
            got = f"{piece.begin_m:g} to {piece.end_m:g}"
            raise InputError("Raster", f"pieces[{k}]", got, f"0 to {length:g} m, the length of a row")

    def away(self, along: FloatArray, across: FloatArray, normal: FloatArray) -> FloatArray:
        """Return unit vectors (..., 3) against the tool's z axis.

        Those along the first row, towards the next one and out of the surface are given, (..., 3) each.
        """
        if self.lean_deg is None:
            return normal
        ahead, aside = np.tan(np.radians(self.lean_deg))
        leaning = normal + ahead * along + aside * across
        return np.asarray(leaning / np.linalg.norm(leaning, axis=-1, keepdims=True))

    @property
    def mesh_file(self) -> Path | None:
        """The path of a mesh file; None where `mesh` names an obstacle, or is left out."""
        return Path(self.mesh) if self.mesh is not None and is_mesh_file(self.mesh) else None

    @property
    def rectangle(self) -> tuple[Vector, Vector, Vector] | None:
        """Origin and edges of a rectangle."""
        if self.origin is None or self.u is None or self.v is None:
            return None
        return self.origin, self.u, self.v

    @property
    def sides(self) -> tuple[float, float]:
        """Lengths of the surface along its rows and across them, m; zero of faces, which are in a file."""
        if self.rectangle is not None:
            _, u, v = self.rectangle
            return float(np.linalg.norm(u)), float(np.linalg.norm(v))
        pipe = self.cylinder
        if pipe is None:
            return 0.0, 0.0
        around = pipe.radius * abs(pipe.angle)
        return (pipe.length, around) if pipe.rows == "along" else (around, pipe.length)

    @property
    def steps(self) -> int:
        """Number of steps from row to row in which the whole surface is crossed."""
        return max(int(np.ceil(self.sides[1] / self.spacing_m - _RIGHT_ANGLE_COSINE)), 1)

    @property
    def rows(self) -> int:
        """Number of rows: the last one would be the first again where rows along it go all round a pipe."""
        pipe = self.cylinder
        return self.steps + (0 if pipe is not None and pipe.is_closed and pipe.rows == "along" else 1)

    @property
    def area(self) -> float:
        """Area of the surface, m2."""
        along, across = self.sides
        return along * across
