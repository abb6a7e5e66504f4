"""Rows over faces of a mesh: plane sections, clipped to the faces, with smoothed normals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbot.common.arrays import FloatArray, interpolated
from cmbot.common.errors import SceneError, optional_module
from cmbot.common.reading.validation import counted
from cmbot.toolpath.raster.raster import MOST_ROWS, FaceSelection, Interval, Raster, RowPiece, united
from cmbot.toolpath.raster.surface import Surface

if TYPE_CHECKING:
    import trimesh

FLAT = 1e-4
"""Height, m, up to which faces are taken as a plane."""
LEAST_NODES = 5
"""Of a row that is no straight line; otherwise they are half of the rows' spacing apart at most."""

# Rounding of numbers of rows and nodes, lengths and heights below which there is none, m, and areas, m2.
_WHOLE, _NO_LENGTH, _NO_AREA = 1e-6, 1e-9, 1e-12
# Share by which areas of faces may differ from that of their union, and a cosine from its bound.
_FACE_TOLERANCE = 1e-9
# Cosine of 80 degrees: the angle by which faces may be turned from their mean.
_MIN_FACE_COSINE = 0.17365
# Share by which the sides of a square differ.
_SQUARE_TOLERANCE = 0.01

_Refusal = Callable[[str, str, str], SceneError]


@dataclass(frozen=True, eq=False)
class FaceSurface(Surface):
    """Some faces of a mesh, in coordinates along the rows, across them and out of the faces.

    Attributes
    ----------
    raster : Raster
    mesh : Trimesh
        The faces, in these coordinates.
    axes : (3, 3)
        The directions of the coordinates in W.
    region : shapely geometry
        What the faces cover, seen from outside.
    refusal : callable
        What to raise, by a key below the raster's, what is there and what is expected.
    """

    raster: Raster
    mesh: trimesh.Trimesh
    axes: FloatArray
    region: Any
    refusal: _Refusal

    @property
    def found(self) -> str:
        """What was chosen of their normal and the rows' direction, in words; empty where both are given."""
        if self.raster.faces is not None and self.raster.along is not None:
            return ""
        along, _, out = ((np.round(axis, 3) + 0.0).tolist() for axis in self.axes)
        return f"found in W: normal {out}, rows along {along}"

    @staticmethod
    def of(
        raster: Raster,
        mesh: trimesh.Trimesh,
        X_WM: FloatArray,
        X_WF: FloatArray,
        refusal: _Refusal,
    ) -> FaceSurface:
        """Return the faces of a mesh that a raster is over.

        Parameters
        ----------
        raster : Raster
        mesh : Trimesh
        X_WM, X_WF : (4, 4)
            Poses in W of the mesh and of the raster's frame.
        refusal : callable

        Raises
        ------
        SceneError
            When no face is chosen, faces hide each other, or a piece is beyond them.
        MissingExtra
            When shapely is not installed.
        """
        shapely = _shapely()
        chosen = _chosen(raster.faces, mesh, X_WM, X_WF, refusal)
        out = (chosen.area_faces[:, None] * chosen.face_normals).sum(axis=0)
        out /= max(np.linalg.norm(out), _NO_AREA)
        if (chosen.face_normals @ out).min() < _MIN_FACE_COSINE:
            got, expected = "faces that are steep to each other", "faces within 80 degrees of their mean"
            raise refusal("faces", got, expected)
        along = _longest(chosen, out, X_WF) if raster.along is None else X_WF[:3, :3] @ np.array(raster.along)
        along = along - (along @ out) * out
        if np.linalg.norm(along) < _WHOLE:
            raise refusal("along", "the direction of the faces' normal", "a direction across it")
        along /= np.linalg.norm(along)
        E = np.stack([along, np.cross(out, along), out])
        chosen.vertices = chosen.vertices @ E.T
        triangles = shapely.polygons(chosen.triangles[:, :, :2])
        region = shapely.union_all(triangles)
        if shapely.area(triangles).sum() > region.area * (1 + _WHOLE):
            raise refusal("faces", "faces behind each other along their normal", "one layer: a box around it")
        surface = FaceSurface(raster, chosen, E, region, refusal)
        if surface.count > MOST_ROWS:
            raise refusal("spacing_m", f"{raster.spacing_m:g}", f"at most {MOST_ROWS} rows")
        for k, piece in enumerate(raster.pieces or ()):
            raster.check_piece(k, piece, surface.count, region.bounds[2] - region.bounds[0])
        return surface

    @property
    def count(self) -> int:
        """Number of rows."""
        _, low, _, high = self.region.bounds
        return max(int(np.ceil((high - low) / self.raster.spacing_m - _WHOLE)), 1)

    @property
    def area(self) -> float:
        """Area of the faces, m2."""
        return float(self.mesh.area_faces.sum())

    @cached_property
    def spans(self) -> list[list[Interval]]:
        """Of each row the pieces over the faces; in a plane they pass gaps up to the rows' spacing."""
        shapely = _shapely()
        low, _, high, _ = self.region.bounds
        ends = ([[low - 1, place], [high + 1, place]] for place in self._places)
        gap = self.raster.spacing_m if self._is_flat else _NO_LENGTH
        rows = list[list[Interval]]()
        for pieces in shapely.intersection(shapely.linestrings(list(ends)), self.region):
            parts = [part.bounds for part in shapely.get_parts(pieces) if part.length > _NO_LENGTH]
            rows.append(
                [
                    (float(begin - low), float(end - gap - low))
                    for begin, end in united([(part[0], part[2] + gap) for part in parts])
                ]
            )
        return rows

    def covered(self, pieces: Sequence[RowPiece]) -> float:
        """Return the area, m2, of the faces below the strips along pieces of rows with overscan."""
        shapely, over = _shapely(), self.raster.overscan_m
        low, places, half = self.region.bounds[0], self._places, 0.5 * self._pitch
        strips = [
            shapely.box(
                low + one.begin_m - over,
                places[one.row] - half,
                low + one.end_m + over,
                places[one.row] + half,
            )
            for one in pieces
        ]
        triangles = shapely.polygons(self.mesh.triangles[:, :, :2])
        inside = shapely.area(shapely.intersection(triangles, shapely.union_all(strips)))
        return float((inside / shapely.area(triangles) * self.mesh.area_faces).sum())

    def rows(self, pieces: Sequence[RowPiece]) -> FaceRows:
        """Return the rows over pieces, to and fro.

        Raises
        ------
        SceneError
            When there is a step along one.
        """
        raster, low = self.raster, self.region.bounds[0]
        points, axes = list[FloatArray](), list[FloatArray]()
        for k, piece in enumerate(pieces):
            begin, end, place = low + piece.begin_m, low + piece.end_m, self._places[piece.row]
            if self._is_flat:
                surface = np.array([[begin, place, self._level], [end, place, self._level]])
                normals = np.tile([0.0, 0.0, 1.0], (2, 1))
            else:
                nodes = _nodes(begin, end, raster.spacing_m)
                surface, normals = _section(self.mesh, place, nodes, self.refusal)
            along = np.array([1.0, 0.0, 0.0]) - normals[:, :1] * normals
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            away = raster.away(along, np.cross(normals, along), normals)
            tool, away = _extended(surface + raster.stand_off_m * away, away, raster.overscan_m * along)
            way = 1 if k % 2 == 0 else -1
            points.append((tool @ self.axes)[::way])
            axes.append((-away @ self.axes)[::way])
        return FaceRows(points=tuple(points), axes=tuple(axes))

    @cached_property
    def _pitch(self) -> float:
        """Distance of two rows, m."""
        _, low, _, high = self.region.bounds
        return float((high - low) / self.count)

    @cached_property
    def _places(self) -> FloatArray:
        """Where the rows are, across them."""
        return np.asarray(self.region.bounds[1] + (np.arange(self.count) + 0.5) * self._pitch)

    @cached_property
    def _level(self) -> float:
        """Height of the plane that the faces are near to."""
        heights = self.mesh.triangles[:, :, 2].mean(axis=1)
        return float(np.average(heights, weights=self.mesh.area_faces))

    @cached_property
    def _is_flat(self) -> bool:
        return bool(np.abs(self.mesh.triangles[:, :, 2] - self._level).max() <= FLAT)


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceRows:
    """Rows to and fro.

    Attributes
    ----------
    points : tuple of (K, 3), m
        Of each row the tool points, in W: its two ends where it is straight.
    axes : tuple of (K, 3)
        The tool's z axes there, in W.
    """

    points: tuple[FloatArray, ...]
    axes: tuple[FloatArray, ...]


def _shapely() -> Any:
    return optional_module("shapely", "shapely", "surfaces")


def _chosen(
    faces: FaceSelection | None, mesh: trimesh.Trimesh, X_WM: FloatArray, X_WF: FloatArray, refusal: _Refusal
) -> trimesh.Trimesh:
    """The chosen faces as a mesh in W."""
    import trimesh

    placed = trimesh.Trimesh(mesh.vertices @ X_WM[:3, :3].T + X_WM[:3, 3], mesh.faces, process=False)
    corners = placed.triangles
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(across, axis=1)
    inside = sizes > 2 * _NO_AREA
    if faces is None:
        normal, least = np.zeros(3), 0.0
    else:
        normal = X_WF[:3, :3] @ (np.array(faces.normal) / np.linalg.norm(faces.normal))
        least = np.cos(np.radians(faces.within_deg))
    cosines = across @ normal / np.maximum(sizes, 2 * _NO_AREA)
    if faces is not None and faces.box is not None:
        local = (corners - X_WF[:3, 3]) @ X_WF[:3, :3]
        lower, upper = np.array(faces.box)
        inside &= ((local >= lower - _NO_LENGTH) & (local <= upper + _NO_LENGTH)).all(axis=(1, 2))
    found = inside & (cosines >= least - _FACE_TOLERANCE)
    if not found.any():
        away = np.degrees(np.arccos(np.clip(cosines[inside].max(initial=-1.0), -1, 1)))
        got = f"no face of {counted(len(corners), 'face')}"
        if inside.any():
            got += f", the nearest is {away:.3g} degrees away"
        raise refusal("faces", got, "faces that are within_deg of normal and inside of the box")
    chosen = trimesh.Trimesh(placed.vertices, placed.faces[found], process=False)
    chosen.remove_unreferenced_vertices()
    return chosen


def _longest(chosen: trimesh.Trimesh, out: FloatArray, X_WF: FloatArray) -> FloatArray:
    """The longer side in W of the least rectangle about faces in W, seen along their normal (3,).

    Of a square it is the side that is nearer to an axis of the frame across the normal.
    """
    from trimesh.bounds import oriented_bounds_2D

    first = X_WF[:3, int(np.abs(out @ X_WF[:3, :3]).argmax() == 0)]
    x = first - (first @ out) * out
    plane = np.stack([x, np.cross(out, x)]) / np.linalg.norm(x)
    turned, lengths = oriented_bounds_2D(chosen.vertices @ plane.T)  # type: ignore[no-untyped-call]
    sides = np.asarray(turned)[:2, :2]
    is_square = abs(lengths[0] - lengths[1]) <= _SQUARE_TOLERANCE * max(lengths)
    side = sides[np.abs(sides[:, 0]).argmax() if is_square else np.argmax(lengths)]
    return np.asarray((-side if side[0] < 0 else side) @ plane)


def _nodes(begin: float, end: float, spacing: float) -> FloatArray:
    """Places (K,) of a row's points."""
    number = max(int(np.ceil((end - begin) / (0.5 * spacing) - _WHOLE)) + 1, LEAST_NODES)
    return np.linspace(begin, end, number)


def _section(
    chosen: trimesh.Trimesh, place: float, nodes: FloatArray, refusal: _Refusal
) -> tuple[FloatArray, FloatArray]:
    """Points (K, 3) of the section at a place, and unit normals (K, 3) that change linearly on each face."""
    from trimesh import intersections
    from trimesh.triangles import points_to_barycentric

    # trimesh takes vertices within 1e-8 as on the plane: by these distances those within 1e-12 m.
    ends, face = intersections.mesh_plane(  # type: ignore[no-untyped-call]
        chosen,
        [0.0, 1.0, 0.0],
        [0.0, place, 0.0],
        return_faces=True,
        cached_dots=1e4 * (chosen.vertices[:, 1] - place),
    )
    both = np.repeat(face, 2)
    corners, flat_ends = chosen.triangles[both], ends.reshape(-1, 3)
    shares = points_to_barycentric(corners, flat_ends)  # type: ignore[no-untyped-call]
    normals = np.einsum("nk,nkd->nd", shares, chosen.vertex_normals[chosen.faces[both]]).reshape(ends.shape)
    order = np.argsort(ends[:, :, 0], axis=1)[:, :, None]
    ends, normals = (np.take_along_axis(each, order, axis=1) for each in (ends, normals))
    order = np.argsort(ends[:, :, 0].sum(axis=1))
    ends, normals = ends[order], normals[order]
    on = (ends[:, 1, 0] >= nodes[0] - _NO_LENGTH) & (ends[:, 0, 0] <= nodes[-1] + _NO_LENGTH)
    ends, normals = ends[on], normals[on]
    step = np.abs(ends[1:, 0, 2] - ends[:-1, 1, 2])
    if step.max(initial=0.0) > FLAT:
        got = f"faces with a step of {step.max():.3g} m"
        raise refusal("faces", got, "faces that are connected along the rows: a box around some")
    x, height = ends[:, :, 0].ravel(), ends[:, :, 2].ravel()
    surface = np.stack([nodes, np.full(len(nodes), place), np.interp(nodes, x, height)], axis=1)
    smooth = interpolated(nodes, x, normals.reshape(-1, 3))
    return surface, smooth / np.linalg.norm(smooth, axis=1, keepdims=True)


def _extended(tool: FloatArray, away: FloatArray, beyond: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A row that goes on straight at its ends, by vectors (K, 3) along it."""
    if not beyond.any():
        return tool, away
    before, behind = tool[:1] - beyond[:1], tool[-1:] + beyond[-1:]
    if len(tool) == 2:
        return np.vstack([before, behind]), away
    return np.vstack([before, tool, behind]), np.vstack([away[:1], away, away[-1:]])
