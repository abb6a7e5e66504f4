"""Stretches of a path through waypoints: between corners, where it rests, lines, splines and turns in place.

A corner is a waypoint at which the path bends by more than an angle within a spacing, and more than twice as
much as it does beside: what bends evenly is a curve. By more than 60 degrees it is a corner in any case.
Of dense waypoints a spline passes those alone that keep all others within a share of the tolerance; where
none does, slighter bends are corners, too, as those of a polygon.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.toolpath.curves import Spline

SAME_PLACE = 1e-4
"""Waypoints nearer to each other, m, are at one place: hardly an arm tells them apart, and a spline through
both has a loop where the digits of a file lead sideways."""

NO_TURN = 1e-3
"""A turn by less, rad, may be what a file rounds."""

# A corner in any case, and how many times as much a corner bends as the path beside it.
_SHARP, _TIMES_AS_MUCH = np.radians(60), 2.0
# A bend is tight whose directions so far, m, before and behind it are apart as those of a corner in any case.
_TIGHT_M = 0.015
# The share of its angle from which on a bend is one where no spline keeps dense waypoints.
_SLIGHT = 1 / 3
# A direction is that over so many tolerances at least: noise of a point is less than one.
_DIRECTION_TOLERANCES = 4.0
# The share of the tolerance that a path may miss its waypoints by; it is missed only where this share of them
# suffices, and there are so many.
_SHARE, _SUFFICES, _DENSE = 0.25, 0.5, 20
# Places on a piece of a spline at which distances are taken.
_PLACES_PER_PIECE = 24


@dataclass(frozen=True, kw_only=True)
class Fit:
    """How a path follows its waypoints.

    Attributes
    ----------
    kept : str
        What of the orientation counts: ``pose``, ``axis`` or ``position``.
    corner : float, rad
        What bends by more may be a corner.
    deviation, rotation : float, m and rad
        Of the tool from its path at most; waypoints may be off by a quarter of that.
    rests : bool
        Whether the tool rests in tight bends, too. Where its shortest time is sought hardly any speed is left
        there, and one law for all of a long path has no room for stops so short.
    """

    kept: str
    corner: float
    deviation: float
    rotation: float
    rests: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretch:
    """A part of a path from rest to rest.

    Attributes
    ----------
    points : (K, 3), m
        Two of a line; of a turn in place the same.
    orientations : (K, 3, 3)
        R_WT.
    """

    points: FloatArray
    orientations: FloatArray

    @property
    def is_straight(self) -> bool:
        """Whether it is a line, or a turn in place about a fixed axis."""
        return len(self.points) == 2

    @cached_property
    def turn(self) -> FloatArray:
        """Rotation vector (3,), rad, in W from its start to its end."""
        turn = Rotation.from_matrix(self.orientations[-1] @ self.orientations[0].T).as_rotvec()
        return np.asarray(turn)


def waypoint_poses(rows: Sequence[Sequence[float]]) -> tuple[FloatArray, FloatArray]:
    """Return points (N, 3), m, and orientations (N, 3, 3) in W of rows x, y, z, qw, qx, qy, qz."""
    table = np.array(rows, dtype=float)
    return table[:, :3], np.asarray(Rotation.from_quat(table[:, [4, 5, 6, 3]]).as_matrix())


def distinct(points: FloatArray) -> IntArray:
    """Return the numbers of the waypoints (N, 3) that are left when neighbours at one place are merged.

    The first of them stays; one that comes back to an earlier place is no neighbour of it.
    """
    left = [0]
    for k in range(1, len(points)):
        if np.linalg.norm(points[k] - points[left[-1]]) >= SAME_PLACE:
            left.append(k)
    return np.array(left)


def merged(points: FloatArray, orientations: FloatArray, kept: str) -> int:
    """Return how many waypoints are at the place of the one before, and turned as that is."""
    same = np.diff(np.searchsorted(distinct(points), np.arange(len(points)), side="right")) == 0
    still = _angles(orientations[:-1], orientations[1:], kept) <= NO_TURN
    return int((same & still).sum())


def stretches(points: FloatArray, orientations: FloatArray, fit: Fit) -> list[Stretch]:
    """Return the stretches of a path through waypoints.

    Parameters
    ----------
    points : (N, 3), m
    orientations : (N, 3, 3)
    fit : Fit
    """
    first = distinct(points)
    last = np.append(first[1:], len(points)) - 1
    found, begin = list[Stretch](), 0
    rests = {len(first) - 1, *(k for k in range(len(first)) if _turns(orientations, first[k], last[k], fit))}
    rests |= {begin + k for k in _corners(points[first], fit)}
    for place in range(len(first)):
        if place in rests:
            if place > begin:
                run = slice(begin, place + 1)
                # It leaves the place before as it is turned there, and comes to others as they are first.
                R = np.concatenate([orientations[last[begin : begin + 1]], orientations[first[run][1:]]])
                found += _fitted(points[first[run]], R, fit)
            begin = place
            if _turns(orientations, first[place], last[place], fit):
                found += _in_place(points[first[place]], orientations[first[place] : last[place] + 1], fit)
    return found


def off_path(points: FloatArray, orientations: FloatArray, curve: Spline) -> tuple[FloatArray, FloatArray]:
    """Return how far waypoints are from a spline, (N,), m, and from its orientation there, (N,), rad."""
    knots = np.concatenate([[0.0], curve.breaks, [1.0]])
    steps = np.arange(_PLACES_PER_PIECE) / _PLACES_PER_PIECE
    share = np.append((knots[:-1, None] + steps * np.diff(knots)[:, None]).ravel(), 1.0)
    places = curve.position(share)
    near = cKDTree(places).query(points)[1]
    away, at = np.full(len(points), np.inf), share[near]
    for before in (np.maximum(near - 1, 0), np.minimum(near, len(share) - 2)):
        edge = places[before + 1] - places[before]
        along = np.einsum("nd,nd->n", points - places[before], edge) / np.einsum("nd,nd->n", edge, edge)
        along = np.clip(along, 0.0, 1.0)
        distance = np.linalg.norm(points - places[before] - along[:, None] * edge, axis=1)
        nearer = distance < away
        away = np.where(nearer, distance, away)
        at = np.where(nearer, share[before] + along * (share[before + 1] - share[before]), at)
    R = curve.rotation(at)
    return away, np.zeros(len(points)) if R is None else _angles(R, orientations, "pose")


def _angles(R: FloatArray, other: FloatArray, kept: str) -> FloatArray:
    """Angles (N,), rad, between orientations, as far as they count."""
    if kept == "position":
        return np.zeros(max(len(R), len(other)))
    if kept == "pose":
        return np.asarray(Rotation.from_matrix(np.swapaxes(R, 1, 2) @ other).magnitude())
    z, z_other = np.broadcast_arrays(R[:, :, 2], other[:, :, 2])
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(z, z_other), axis=1), (z * z_other).sum(axis=1)))


def _turns(orientations: FloatArray, first: int, last: int, fit: Fit) -> bool:
    """Whether the tool turns in place."""
    here = orientations[first : last + 1]
    return bool(_angles(here[:1], here, fit.kept).max() > NO_TURN)


def _in_place(point: FloatArray, orientations: FloatArray, fit: Fit) -> Iterator[Stretch]:
    """Yield turns about fixed axes: the longest that keep all orientations."""
    begin, points, most = 0, np.stack([point, point]), _SHARE * fit.rotation

    def is_one(end: int) -> bool:
        between = orientations[begin : end + 1]
        return bool(_off_geodesic(between).max() <= most)

    while begin < len(orientations) - 1:
        end = begin + 1
        while end + 1 < len(orientations) and is_one(end + 1):
            end += 1
        yield Stretch(points=points, orientations=orientations[[begin, end]])
        begin = end


def _off_geodesic(orientations: FloatArray) -> FloatArray:
    """How far orientations (K, 3, 3) are from the turn about a fixed axis between first and last, rad."""
    R = Rotation.from_matrix(orientations)
    whole = (R[-1] * R[0].inv()).as_rotvec()
    turned = (R * R[0].inv()).as_rotvec()
    share = np.clip(turned @ whole / max(float(whole @ whole), np.finfo(float).tiny), 0.0, 1.0)
    back = np.diff(share, prepend=0.0).min() < -NO_TURN
    off = (Rotation.from_rotvec(share[:, None] * whole) * R[0] * R.inv()).magnitude()
    return np.full(len(off), np.inf) if back else np.asarray(off)


def _corners(points: FloatArray, fit: Fit) -> list[int]:
    """Numbers of the places (K, 3) at which a path bends so that it rests there."""
    if len(points) < 3:
        return []
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    found = _most_bent(points, along, _DIRECTION_TOLERANCES * fit.deviation, fit.corner, _SHARP)
    for k in _most_bent(points, along, _TIGHT_M, _SHARP) if fit.rests else ():
        if np.abs(along[found] - along[k]).min(initial=np.inf) > 2 * _TIGHT_M:
            found.append(k)
    return found


def _most_bent(
    points: FloatArray, along: FloatArray, reach: float, corner: float, sharp: float = np.inf
) -> list[int]:
    """Numbers of the places (K, 3) at which a path bends by more than a corner, rad, and than beside.

    Directions are those over a `reach`, m, of the way `along` (K,), or to the next place where that is
    further. What bends by more than is `sharp` is one whatever is beside.
    """
    count, places = len(points), np.arange(len(points))
    # Never further than the neighbours where these are further apart than that.
    before = np.minimum(np.searchsorted(along, along - reach, side="right") - 1, places - 1)
    after = np.maximum(np.searchsorted(along, along + reach, side="left"), places + 1)
    before, after = np.maximum(before, 0), np.minimum(after, count - 1)
    into, out = points - points[before], points[after] - points
    sine = np.linalg.norm(np.cross(into, out), axis=1)
    angle = np.arctan2(sine, np.einsum("kd,kd->k", into, out))
    angle[[0, -1]] = 0.0
    found = list[int]()
    for k in range(1, count - 1):
        near = angle[before[k] + 1 : after[k]]
        if angle[k] <= corner or angle[k] < near.max():
            continue
        # Of ends nothing is known: what bends between them alone may be a curve.
        inner = [angle[j] for j in (before[k], after[k]) if 0 < j < count - 1]
        beside = max(inner, default=angle[k])
        if (angle[k] > sharp or angle[k] > _TIMES_AS_MUCH * beside) and not (found and found[-1] > before[k]):
            found.append(k)
    return found


def _fitted(points: FloatArray, orientations: FloatArray, fit: Fit) -> list[Stretch]:
    """A line where all waypoints are near it; of many those through which a spline is near all.

    Where no spline is, the path is parted at what may be the corners of a polygon.
    """
    ends = [0, len(points) - 1]
    if len(points) == 2 or _is_line(points, orientations, fit):
        return [Stretch(points=points[ends], orientations=orientations[ends])]
    whole = [Stretch(points=points, orientations=orientations)]
    if len(points) < _DENSE:
        return whole
    chosen: Sequence[int] = [0, len(points) // 2, len(points) - 1]
    while len(chosen) <= _SUFFICES * len(points):
        curve = Spline(points[chosen], orientations[chosen])
        away, turned = off_path(points, orientations, curve)
        miss = np.maximum(away / (_SHARE * fit.deviation), turned / (_SHARE * fit.rotation))
        if fit.kept == "position":
            miss = away / (_SHARE * fit.deviation)
        if miss.max() <= 1.0:
            return [Stretch(points=points[chosen], orientations=orientations[chosen])]
        worst = [
            low + 1 + int(miss[low + 1 : high].argmax())
            for low, high in pairwise(chosen)
            if high > low + 1 and miss[low + 1 : high].max() > 1.0
        ]
        if not worst:
            break
        chosen = sorted({*chosen, *worst})
    slight = fit.corner if fit.corner > _SHARP else _SLIGHT * fit.corner
    corners = _corners(points, replace(fit, corner=slight))
    if not corners:
        return whole
    runs = pairwise([0, *corners, len(points) - 1])
    return [
        part
        for low, high in runs
        for part in _fitted(points[low : high + 1], orientations[low : high + 1], fit)
    ]


def _is_line(points: FloatArray, orientations: FloatArray, fit: Fit) -> bool:
    """Whether all waypoints are near the line from the first to the last, one after the other."""
    way = points[-1] - points[0]
    length = float(np.linalg.norm(way))
    if length < SAME_PLACE:
        return False
    share = (points - points[0]) @ way / length**2
    off = np.linalg.norm(points - points[0] - share[:, None] * way, axis=1)
    # As exactly as files have them, where they are not dense.
    most = _SHARE * fit.deviation if len(points) >= _DENSE else min(_SHARE * fit.deviation, SAME_PLACE / 100)
    if off.max() > most or (np.diff(share) < 0).any():
        return False
    if fit.kept == "position":
        return True
    turning = Slerp([0.0, 1.0], Rotation.from_matrix(orientations[[0, -1]]))
    planned = turning(np.clip(share, 0.0, 1.0)).as_matrix()
    return bool(_angles(planned, orientations, fit.kept).max() <= _SHARE * fit.rotation)
