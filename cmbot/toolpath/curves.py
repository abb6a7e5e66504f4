"""Curves that a leg of the tool path follows where it is not straight: arcs, splines, blended lines.

A curve is parametrised by the share of its length, from 0 to 1, that is covered. Between its breaks it is a
polynomial in that share or a turn about an axis by an angle in proportion to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import RotationSpline

# Points of the Gauss rule that measures the length of a spline's piece.
_GAUSS_POINTS = 12
# Cosine of the largest angle, 150 deg, by which a rounded corner turns.
_MIN_CORNER_COSINE = -0.866
# Share of its mean below which the rate of a spline counts as this share: a cusp.
_MIN_RATE_SHARE = 1e-9
# Distance of three points from a line, as a share of their own distances, below which they have no circle.
_COLLINEAR_SHARE = 1e-6
# Instead of no length, or its square.
_MIN_LENGTH = 1e-300
# Of a spline that bends by more, rad, as much counts for its bends as for its way.
_FULL_BEND = np.pi


class Curve(ABC):
    """The curve of one leg, from the share 0 of its length to the share 1."""

    @property
    @abstractmethod
    def length(self) -> float:
        """Length, m."""

    @property
    def breaks(self) -> FloatArray:
        """Shares (B,) between 0 and 1 at which its pieces meet."""
        return np.empty(0)

    @property
    @abstractmethod
    def curvature(self) -> float:
        """Largest curvature, 1/m."""

    @property
    def turns(self) -> bool:
        """Whether the curve prescribes the tool's orientation."""
        return False

    def turned(self, share: FloatArray) -> FloatArray:
        """Return angles (N,), rad: the tangent turns by no more than they differ between two shares (N,)."""
        return self.curvature * self.length * np.asarray(share)

    def bend_share(self, share: FloatArray) -> FloatArray:
        """Return the shares (N,) of all bend that are before the shares of the length.

        They count as far as the curvature is uneven, and half a turn or more is bent: else they are less.
        """
        return np.zeros(len(share))

    @abstractmethod
    def reversed(self) -> Curve:
        """Return the same curve from its end to its start."""

    @abstractmethod
    def position(self, share: FloatArray) -> FloatArray:
        """Return points (N, 3), m, at shares (N,)."""

    @abstractmethod
    def slope(self, share: FloatArray) -> FloatArray:
        """Return derivatives (N, 3), m, of `position` by the share."""

    def tangent(self, share: FloatArray) -> FloatArray:
        """Return unit vectors (N, 3) along the curve."""
        slope = self.slope(share)
        return np.asarray(slope / np.linalg.norm(slope, axis=1, keepdims=True))

    def offset(self, share: FloatArray, p: FloatArray) -> FloatArray:
        """Return the vectors (N, 3), m, to points (N, 3) from the nearest points of the tangents."""
        away, tangent = p - self.position(share), self.tangent(share)
        return np.asarray(away - np.einsum("nd,nd->n", away, tangent)[:, None] * tangent)

    def arc_angle(self, share: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the angles (N,), rad, and radii (N,), m, of the arcs on which the shares `at` (N,) lie.

        The angles are linear in the share; both are zero where the curve is a polynomial.
        """
        return np.zeros(len(share)), np.zeros(len(share))

    def rotation(self, share: FloatArray) -> FloatArray | None:
        """Return orientations R_WT (N, 3, 3), where the curve prescribes them."""
        return None

    def rotation_rate(self, share: FloatArray) -> FloatArray | None:
        """Return how fast the prescribed orientation turns, (N, 3), rad in W per share."""
        return None

    def turn(self, share: FloatArray, at: FloatArray) -> FloatArray | None:
        """Return rotation vectors (N, 3), rad, from the orientation where the piece of `at` (N,) begins.

        They are polynomials of the share on every piece. None where the curve prescribes no orientation.
        """
        return None

    def roll(self, at: FloatArray) -> FloatArray:
        """Return curvatures (N,), 1/m, of the cylinder on which the plane of the shares `at` (N,) is rolled.

        There `arc_angle` is that of an arc in the plane, on which the tool turns with the cylinder and `turn`
        is zero. Zero where nothing is rolled.
        """
        return np.zeros(len(at))


@dataclass(frozen=True, eq=False)
class Arc(Curve):
    """A circular arc about `axis`, a unit vector, by `angle`, rad, from the point `start`."""

    centre: FloatArray
    axis: FloatArray
    start: FloatArray
    angle: float

    @classmethod
    def through(cls, start: FloatArray, via: FloatArray, end: FloatArray) -> Arc | None:
        """Return the arc from `start` through `via` to `end`; None where these are on a line."""
        a, b = via - start, end - start
        normal = np.cross(a, b)
        size = float(normal @ normal)
        if size <= (_COLLINEAR_SHARE * (a @ a + b @ b)) ** 2:
            return None
        centre = start + np.cross((a @ a) * b - (b @ b) * a, normal) / (2 * size)
        axis = normal / np.sqrt(size)
        first, last = start - centre, end - centre
        angle = float(np.arctan2(axis @ np.cross(first, last), first @ last)) % (2 * np.pi)
        return cls(centre, axis, start, angle)

    @property
    def radius(self) -> float:
        """Radius, m."""
        return float(np.linalg.norm(self._arm))

    @property
    def length(self) -> float:
        """Length, m."""
        return self.radius * abs(self.angle)

    @property
    def curvature(self) -> float:
        """Curvature, 1/m."""
        return 1.0 / self.radius

    def reversed(self) -> Arc:
        """Return the arc from its end to its start."""
        return Arc(self.centre, self.axis, self.position(np.ones(1))[0], -self.angle)

    @cached_property
    def _arm(self) -> FloatArray:
        arm = self.start - self.centre
        return np.asarray(arm - (arm @ self.axis) * self.axis)

    def position(self, share: FloatArray) -> FloatArray:
        """Return points (N, 3), m."""
        angle = (self.angle * share)[:, None]
        foot = self.start - self._arm
        return np.asarray(foot + np.cos(angle) * self._arm + np.sin(angle) * np.cross(self.axis, self._arm))

    def slope(self, share: FloatArray) -> FloatArray:
        """Return derivatives (N, 3), m."""
        angle = (self.angle * share)[:, None]
        along = np.cos(angle) * np.cross(self.axis, self._arm) - np.sin(angle) * self._arm
        return np.asarray(self.angle * along)

    def arc_angle(self, share: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the angle and the radius."""
        return self.angle * share, np.full(len(share), self.radius)


@dataclass(frozen=True, eq=False)
class Spline(Curve):
    """A cubic spline through `points` (K, 3), m, with parameters in proportion to their distances.

    Attributes
    ----------
    points : (K, 3), m
    orientations : (K, 3, 3) or None
        R_WT at the points; between them a spline of rotations (SciPy's `RotationSpline`).
    """

    points: FloatArray
    orientations: FloatArray | None = None

    @property
    def turns(self) -> bool:
        """Whether orientations are given."""
        return self.orientations is not None

    def reversed(self) -> Spline:
        """Return the spline from its last point to its first."""
        return Spline(self.points[::-1], None if self.orientations is None else self.orientations[::-1])

    @cached_property
    def _spline(self) -> CubicSpline:
        # Imported where needed: it takes a while to load, and few paths need it.
        from scipy.interpolate import CubicSpline

        # Parameters in proportion to the chords. In proportion to the spline's own lengths they would be more
        # even, but iterations towards that diverge on points that are a little uneven.
        chords = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return CubicSpline(np.append(0.0, np.cumsum(chords)) / chords.sum(), self.points)

    @cached_property
    def length(self) -> float:
        """Length, m."""
        return float(_lengths(self._spline).sum())

    @property
    def breaks(self) -> FloatArray:
        """Shares (K - 2,) of the inner points."""
        return np.asarray(self._spline.x[1:-1])

    @cached_property
    def curvature(self) -> float:
        """Bound of the curvature, 1/m: the second derivative is linear between the points.

        Times the length it bounds how fast the tangent turns by the share, too: nowhere is the rate of the
        share's way smaller than where it is least, and nor is its mean, the length.
        """
        second = np.linalg.norm(self._spline(self._spline.x, 2), axis=1)
        return float(second.max() / max(self._slowest.min(), _MIN_RATE_SHARE * self.length) ** 2)

    @cached_property
    def _slowest(self) -> FloatArray:
        """Least norm (K - 1,) of the derivative by the share between two points each.

        Its square is of fourth degree there.
        """
        from scipy.interpolate import PPoly

        first = self._spline.derivative()
        square = np.zeros((5, first.c.shape[1]))
        for j, k in np.ndindex(3, 3):
            square[j + k] += np.einsum("pd,pd->p", first.c[j], first.c[k])
        turning = PPoly(square, first.x).derivative().roots(extrapolate=False)
        turning = turning[np.isfinite(turning)]
        ends = np.linalg.norm(first(first.x), axis=1)
        least = np.minimum(ends[:-1], ends[1:])
        np.minimum.at(least, self._piece(turning), np.linalg.norm(first(turning), axis=1))
        return np.asarray(least)

    @cached_property
    def _turned(self) -> FloatArray:
        """Bounds (K,), rad, of how far the tangent has turned up to the points."""
        second = np.linalg.norm(self._spline(self._spline.x, 2), axis=1)
        rate = np.maximum(second[:-1], second[1:]) / np.maximum(self._slowest, _MIN_RATE_SHARE * self.length)
        return np.append(0.0, np.cumsum(rate * np.diff(self._spline.x)))

    def turned(self, share: FloatArray) -> FloatArray:
        """Return angles (N,), rad: the tangent turns by no more than they differ between two shares (N,)."""
        return np.asarray(np.interp(share, self._spline.x, self._turned))

    def bend_share(self, share: FloatArray) -> FloatArray:
        """Return the shares (N,) of all bend that are before the shares of the length.

        As the tangents at the points turn, and in between in proportion to the share.
        """
        slope = self.slope(self._spline.x)
        tangent = slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), _MIN_LENGTH)
        steps = np.linalg.norm(np.diff(tangent, axis=0), axis=1)
        turned = np.append(0.0, np.cumsum(2 * np.arcsin(np.minimum(0.5 * steps, 1.0))))
        return np.asarray(np.interp(share, self._spline.x, turned / max(turned[-1], _FULL_BEND)))

    def position(self, share: FloatArray) -> FloatArray:
        """Return points (N, 3), m."""
        return np.asarray(self._spline(share))

    def slope(self, share: FloatArray) -> FloatArray:
        """Return derivatives (N, 3), m."""
        return np.asarray(self._spline(share, 1))

    @cached_property
    def _rotations(self) -> RotationSpline | None:
        if self.orientations is None:
            return None
        from scipy.spatial.transform import RotationSpline

        return RotationSpline(self._spline.x, Rotation.from_matrix(self.orientations))

    def rotation(self, share: FloatArray) -> FloatArray | None:
        """Return orientations R_WT (N, 3, 3)."""
        return None if self._rotations is None else self._rotations(share).as_matrix()

    def rotation_rate(self, share: FloatArray) -> FloatArray | None:
        """Return how fast the tool turns, (N, 3), rad in W per share."""
        if self._rotations is None:
            return None
        # SciPy's rates are along the axes that turn.
        return np.asarray(self._rotations(share).apply(self._rotations(share, 1)))

    def turn(self, share: FloatArray, at: FloatArray) -> FloatArray | None:
        """Return rotation vectors (N, 3), rad, cubic in the share between two points."""
        if self._rotations is None or self.orientations is None:
            return None
        before = self.orientations[self._piece(at)]
        now = self._rotations(share).as_matrix()
        return np.asarray(Rotation.from_matrix(before.transpose(0, 2, 1) @ now).as_rotvec())

    def _piece(self, at: FloatArray) -> IntArray:
        last = len(self.points) - 2
        return np.clip(np.searchsorted(self._spline.x, at, side="right") - 1, 0, last)


def rounded(before: FloatArray, corner: FloatArray, after: FloatArray) -> bool:
    """Whether a corner is one to round off, not one at which the tool turns back."""
    a, b = corner - before, after - corner
    return bool(a @ b > _MIN_CORNER_COSINE * np.linalg.norm(a) * np.linalg.norm(b))


@dataclass(frozen=True, eq=False)
class Blend(Curve):
    """Straight lines through `corners` (K, 3), whose inner ones are rounded off by arcs of `radius`, m.

    An arc is smaller where a line is too short for it.
    """

    corners: FloatArray
    radius: float

    def reversed(self) -> Blend:
        """Return the lines from the last corner to the first."""
        return Blend(self.corners[::-1], self.radius)

    @cached_property
    def _parts(self) -> list[Curve]:
        corners, parts = self.corners, list[Curve]()
        edges = np.diff(corners, axis=0)
        lengths = np.linalg.norm(edges, axis=1)
        along = edges / lengths[:, None]
        start = corners[0]
        for k in range(1, len(corners) - 1):
            a, b = along[k - 1], along[k]
            angle = float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
            if angle < _COLLINEAR_SHARE:
                continue
            # Half of a line is left to the corner at its other end.
            cut = min(self.radius * np.tan(0.5 * angle), 0.5 * lengths[k - 1], 0.5 * lengths[k])
            axis = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
            first = corners[k] - cut * a
            centre = first + np.cross(axis, a) * cut / np.tan(0.5 * angle)
            parts += [Line(start, first), Arc(centre, axis, first, angle)]
            start = corners[k] + cut * b
        return [*parts, Line(start, corners[-1])]

    @cached_property
    def _ends(self) -> FloatArray:
        lengths = np.array([part.length for part in self._parts])
        return np.concatenate([[0.0], np.cumsum(lengths) / lengths.sum()])

    @cached_property
    def length(self) -> float:
        """Length, m."""
        return sum(part.length for part in self._parts)

    @property
    def breaks(self) -> FloatArray:
        """Shares at which lines and arcs meet."""
        return self._ends[1:-1]

    @property
    def curvature(self) -> float:
        """Largest curvature, 1/m."""
        return max(part.curvature for part in self._parts)

    def position(self, share: FloatArray) -> FloatArray:
        """Return points (N, 3), m."""
        return self._of_parts(share, share, lambda part, s, _: part.position(s))

    def slope(self, share: FloatArray) -> FloatArray:
        """Return derivatives (N, 3), m."""
        return self._of_parts(share, share, lambda part, s, scale: scale * part.slope(s))

    def arc_angle(self, share: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the angles and radii of the arcs; zero on the lines."""
        both = self._of_parts(share, at, lambda part, s, _: np.stack(part.arc_angle(s, s), axis=1), 2)
        return both[:, 0], both[:, 1]

    def _of_parts(self, share: FloatArray, at: FloatArray, of: object, columns: int = 3) -> FloatArray:
        """What a function of part, its own share and their ratio yields on the parts where `at` (N,) lies."""
        values = np.empty((len(share), columns))
        which = np.clip(np.searchsorted(self._ends, at, side="right") - 1, 0, len(self._parts) - 1)
        for k in np.unique(which):
            here = which == k
            scale = 1.0 / (self._ends[k + 1] - self._ends[k])
            values[here] = of(self._parts[k], (share[here] - self._ends[k]) * scale, scale)  # type: ignore[operator]
        return values


@dataclass(frozen=True, eq=False)
class CylinderCurve(Curve):
    """A curve in a plane that is rolled on a cylinder; the tool turns with the cylinder's surface.

    Attributes
    ----------
    plane : Curve
        With x around the cylinder and y along it, m.
    X_WC : (4, 4)
        The cylinder: z is its axis; where x and y are zero in the plane, the cylinder's x axis passes.
    radius : float
        Of the cylinder, m.
    orientation : (3, 3)
        R_WT where the curve begins.
    """

    plane: Curve
    X_WC: FloatArray
    radius: float
    orientation: FloatArray

    turns = True

    @property
    def length(self) -> float:
        """Length, m: rolling keeps it."""
        return self.plane.length

    @property
    def breaks(self) -> FloatArray:
        """Shares at which the pieces of the curve in the plane meet."""
        return self.plane.breaks

    @property
    def curvature(self) -> float:
        """Bound of the curvature, 1/m: that in the plane, and that of the cylinder square to it."""
        return float(np.hypot(self.plane.curvature, 1.0 / self.radius))

    def reversed(self) -> CylinderCurve:
        """Return the curve from its end to its start."""
        turn = (self._angle(np.ones(1)) - self._angle(np.zeros(1))) * self.X_WC[:3, 2]
        orientation = Rotation.from_rotvec(turn).as_matrix() @ self.orientation
        return CylinderCurve(self.plane.reversed(), self.X_WC, self.radius, orientation)

    def position(self, share: FloatArray) -> FloatArray:
        """Return points (N, 3), m."""
        x, y, _ = self.plane.position(share).T
        angle = x / self.radius
        around = np.stack([self.radius * np.cos(angle), self.radius * np.sin(angle), y], axis=1)
        return np.asarray(around @ self.X_WC[:3, :3].T + self.X_WC[:3, 3])

    def slope(self, share: FloatArray) -> FloatArray:
        """Return derivatives (N, 3), m."""
        angle = self._angle(share)
        x, y, _ = self.plane.slope(share).T
        along = np.stack([-x * np.sin(angle), x * np.cos(angle), y], axis=1)
        return np.asarray(along @ self.X_WC[:3, :3].T)

    def rotation(self, share: FloatArray) -> FloatArray | None:
        """Return orientations R_WT (N, 3, 3)."""
        turned = self._angle(share) - self._angle(np.zeros(1))
        R = Rotation.from_rotvec(turned[:, None] * self.X_WC[:3, 2]).as_matrix()
        return np.asarray(R @ self.orientation)

    def rotation_rate(self, share: FloatArray) -> FloatArray | None:
        """Return how fast the tool turns, (N, 3), rad in W per share."""
        return np.asarray(self.plane.slope(share)[:, :1] / self.radius * self.X_WC[:3, 2])

    def arc_angle(self, share: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the angles and radii of the arcs in the plane; zero on its lines."""
        return self.plane.arc_angle(share, at)

    def turn(self, share: FloatArray, at: FloatArray) -> FloatArray | None:
        """Return rotation vectors (N, 3), rad, from where the plane's x is zero; on arcs in it, zero."""
        on_line = self.plane.arc_angle(share, at)[1] == 0
        return np.asarray(np.where(on_line, self._angle(share), 0.0)[:, None] * self.X_WC[:3, 2])

    def roll(self, at: FloatArray) -> FloatArray:
        """Return the curvature of the cylinder."""
        return np.full(len(at), 1.0 / self.radius)

    def _angle(self, share: FloatArray) -> FloatArray:
        return np.asarray(self.plane.position(share)[:, 0] / self.radius)


@dataclass(frozen=True, eq=False)
class Line(Curve):
    """A straight line from `start` to `end`, m."""

    start: FloatArray
    end: FloatArray

    curvature = 0.0

    @property
    def length(self) -> float:
        """Length, m."""
        return float(np.linalg.norm(self.end - self.start))

    def reversed(self) -> Line:
        """Return the line from its end to its start."""
        return Line(self.end, self.start)

    def position(self, share: FloatArray) -> FloatArray:
        """Return points (N, 3), m."""
        return np.asarray(self.start + share[:, None] * (self.end - self.start))

    def slope(self, share: FloatArray) -> FloatArray:
        """Return derivatives (N, 3), m."""
        return np.broadcast_to(self.end - self.start, (len(share), 3))

    def tangent(self, share: FloatArray) -> FloatArray:
        """Return unit vectors (N, 3); zero where it has no length."""
        return np.asarray(self.slope(share) / max(self.length, _MIN_LENGTH))

    def offset(self, share: FloatArray, p: FloatArray) -> FloatArray:
        """Return the vectors (N, 3), m, to points (N, 3) from the nearest points of the line."""
        edge, away = self.end - self.start, p - self.start
        along = away @ edge / max(self.length**2, _MIN_LENGTH)
        return np.asarray(away - np.clip(along, 0.0, 1.0)[:, None] * edge)


def _lengths(spline: CubicSpline) -> FloatArray:
    """Lengths (K - 1,) of the pieces of a spline."""
    x, weight = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
    middle, half = 0.5 * (spline.x[1:] + spline.x[:-1]), 0.5 * np.diff(spline.x)
    speed = np.linalg.norm(spline(middle[:, None] + half[:, None] * x, 1), axis=2)
    return np.asarray(half * (speed @ weight))
