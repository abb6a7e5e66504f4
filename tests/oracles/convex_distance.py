"""Distances of convex shapes as minimum-norm points, apart from the package's collision library.

The distance of two shapes is the norm of the shortest vector in the set of their points' differences. That
set is known by its support function alone. A Frank-Wolfe method that corrects fully (Wolfe 1976; in three
dimensions, Gilbert, Johnson and Keerthi 1988) keeps the hull of at most three of its points. The shortest
vector of that hull is an upper bound of the distance; the support against its direction is a lower bound,
whatever the rounding of the steps between. Balls about the shapes are taken off at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from cmbot.common.arrays import BoolArray, FloatArray, IntArray

__all__ = ["ConvexShape", "Proven", "hull", "smallest_distances"]

# Width of the bounds, m, at which a distance is known, and most steps towards it.
_WIDTH, _MOST_STEPS = 1e-7, 100
# Norm, m, below which a point of the differences is taken for the origin: the shapes overlap.
_ORIGIN = 1e-7
# Pairs at states that are looked at at once.
_BLOCK = 1 << 17


@dataclass(frozen=True, kw_only=True, eq=False)
class ConvexShape:
    """The sum of a box, a disc across z and a ball, each about the origin; or the hull of points.

    Attributes
    ----------
    half : (3,), m
        Half edges of the box.
    disc, radius : float, m
        Radii of the disc and of the ball. A cylinder is an edge and a disc, a capsule an edge and a ball.
    points : (V, 3), m, or None
        In place of the three; their hull has to hold the origin.
    """

    half: FloatArray = field(default_factory=lambda: np.zeros(3))
    disc: float = 0.0
    radius: float = 0.0
    points: FloatArray | None = None

    @property
    def bounding_radius(self) -> float:
        """Radius of a ball about the origin that holds the shape, m."""
        if self.points is not None:
            return float(np.linalg.norm(self.points, axis=1).max())
        return float(np.hypot(np.hypot(*self.half[:2]) + self.disc, self.half[2])) + self.radius


def hull(points: FloatArray) -> tuple[FloatArray, ConvexShape]:
    """Return the convex hull of `points` (N, 3), m, about its centre (3,), and that centre."""
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:
        # Too flat for its precision. The points inside only cost time.
        corners = points
    centre = corners.mean(axis=0)
    return centre, ConvexShape(points=corners - centre)


@dataclass(frozen=True, kw_only=True, eq=False)
class Proven:
    """The smallest distance of several pairs of shapes, at N states.

    Attributes
    ----------
    lower, upper : (N,), m
        Bounds. Where shapes overlap both are negative, and only that is meant: their depth is not sought.
        Infinite without pairs.
    pair : (N,)
        The nearest; -1 without pairs.
    """

    lower: FloatArray
    upper: FloatArray
    pair: IntArray


@dataclass(kw_only=True, eq=False)
class _Items:
    """Pairs at states whose distances are sought, M of them; the origin is each second shape's.

    `hull` (M, 3, 3) has up to three points of the differences, NaN where there are fewer; `nearest` (M, 3) is
    the shortest vector of their hull.
    """

    state: IntArray
    pair: IntArray
    R_1: FloatArray
    R_2: FloatArray
    shift: FloatArray
    radius: FloatArray
    nearest: FloatArray
    hull: FloatArray
    lower: FloatArray

    def only(self, which: BoolArray) -> _Items:
        """The items that are marked."""
        return _Items(**{name: value[which] for name, value in vars(self).items()})


def smallest_distances(
    shapes: Sequence[ConvexShape], R: FloatArray, p: FloatArray, pairs: Sequence[tuple[int, int]]
) -> Proven:
    """Return the smallest distance of P pairs at N states.

    Parameters
    ----------
    shapes : S shapes
    R, p : (S, N, 3, 3) and (S, N, 3), m
        Their orientations and positions in W.
    pairs : P pairs of indices of shapes
    """
    N = p.shape[1]
    if not pairs:
        far = np.full(N, np.inf)
        return Proven(lower=far, upper=far, pair=np.full(N, -1, dtype=np.intp))
    some = max(1, _BLOCK // len(pairs))
    indices = np.array(pairs, dtype=np.intp)
    parts = [
        _smallest_distances(shapes, R[:, k : k + some], p[:, k : k + some], indices)
        for k in range(0, N, some)
    ]
    lower, upper, pair = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Proven(lower=lower, upper=upper, pair=pair)


def _smallest_distances(
    shapes: Sequence[ConvexShape], R: FloatArray, p: FloatArray, pairs: IntArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """The fields of a `Proven`, of states that fit into memory together."""
    N = p.shape[1]
    best, nearest, proven = np.full(N, np.inf), np.full(N, -1, dtype=np.intp), np.full(N, np.inf)
    supports = _Supports(shapes, pairs)
    items = _near_items(shapes, R, p, pairs)
    for _ in range(_MOST_STEPS):
        point = supports.difference(items)
        length = np.linalg.norm(items.nearest, axis=1)
        along = np.einsum("kd,kd->k", items.nearest, point) / np.maximum(length, _ORIGIN)
        np.maximum(items.lower, along - items.radius, out=items.lower)
        items.lower[np.isnan(items.lower)] = -np.inf
        improved = _shortest(items, point)
        upper = np.linalg.norm(items.nearest, axis=1) - items.radius
        overlap = upper + items.radius <= _ORIGIN
        # Cores that meet overlap by more than the balls about them.
        upper[overlap] = -items.radius[overlap] - _WIDTH
        items.lower[overlap] = upper[overlap]
        _keep_least(best, nearest, upper, items)
        done = (upper - items.lower <= _WIDTH) | ~improved
        ended = items.only(done)
        np.minimum.at(proven, ended.state, ended.lower)
        items = items.only(~done & (items.lower <= best[items.state]))
        if len(items.state) == 0:
            break
    np.minimum.at(proven, items.state, items.lower)
    return np.minimum(proven, best), best, nearest


def _near_items(shapes: Sequence[ConvexShape], R: FloatArray, p: FloatArray, pairs: IntArray) -> _Items:
    """The pairs that may be nearest at their state, by the balls that hold them."""
    first, second = pairs.T
    ball, outer = (np.array([getattr(s, name) for s in shapes]) for name in ("radius", "bounding_radius"))
    between = p[first] - p[second]
    centres = np.linalg.norm(between, axis=2)
    upper = centres - (ball[first] + ball[second])[:, None]
    lower = centres - (outer[first] + outer[second])[:, None]
    # Where a place is no number all pairs stay: then nothing is known of the distance.
    pair, state = np.nonzero(~(lower > upper.min(axis=0) + _WIDTH))
    one, other = first[pair], second[pair]
    hull = np.full((len(pair), 3, 3), np.nan)
    hull[:, 0] = shift = between[pair, state]
    return _Items(
        state=state,
        pair=pair,
        R_1=R[one, state],
        R_2=R[other, state],
        shift=shift,
        radius=ball[one] + ball[other],
        nearest=shift,
        hull=hull,
        lower=lower[pair, state],
    )


class _Supports:
    """Support functions of all shapes at once."""

    def __init__(self, shapes: Sequence[ConvexShape], pairs: IntArray) -> None:
        self.half = np.array([shape.half for shape in shapes])
        self.disc = np.array([shape.disc for shape in shapes])
        self.points = {k: shape.points for k, shape in enumerate(shapes) if shape.points is not None}
        self.first, self.second = pairs.T

    def difference(self, items: _Items) -> FloatArray:
        """Points (M, 3) of the differences that reach furthest against `items.nearest`."""
        one = self._furthest(self.first[items.pair], items.R_1, -items.nearest)
        other = self._furthest(self.second[items.pair], items.R_2, items.nearest)
        return np.asarray(items.shift + one - other)

    def _furthest(self, shape: IntArray, R: FloatArray, direction: FloatArray) -> FloatArray:
        own = np.einsum("kji,kj->ki", R, direction)
        point = np.copysign(self.half[shape], own)
        across = np.hypot(own[:, 0], own[:, 1])
        point[:, :2] += (self.disc[shape] / np.maximum(across, 1e-300))[:, None] * own[:, :2]
        for k, points in self.points.items():
            of_it = np.flatnonzero(shape == k)
            if len(of_it):
                point[of_it] = points[(own[of_it] @ points.T).argmax(axis=1)]
        return np.asarray(np.einsum("kij,kj->ki", R, point))


def _shortest(items: _Items, point: FloatArray) -> BoolArray:
    """Take a point (M, 3) into each hull and leave out what its shortest vector does not need.

    Returns where that vector became shorter. The points of a hull were all needed, so the new one is: only
    the hulls of it and some of the others are tried.
    """
    edges = items.hull - point[:, None]
    gram, along = edges @ edges.transpose(0, 2, 1), -np.einsum("kid,kd->ki", edges, point)
    weights = _candidate_weights(gram, along)
    # Points that are not there have weight zero.
    vectors = point[:, None] + weights @ np.nan_to_num(edges)
    size = np.where(np.isnan(weights).any(axis=2), np.inf, np.einsum("ksd,ksd->ks", vectors, vectors))
    best = size.argmin(axis=1)
    row = np.arange(len(point))
    improved = size[row, best] < np.einsum("kd,kd->k", items.nearest, items.nearest)
    changed = np.flatnonzero(improved)
    items.nearest = items.nearest.copy()
    items.nearest[changed] = vectors[changed, best[changed]]
    used = weights[row, best] > 0
    items.hull = np.where(used[:, :, None], items.hull, np.nan)
    free = np.argmin(used, axis=1)
    # Three others and the new point hold the origin; then nothing is left to be sought.
    items.hull[row, free] = point
    return np.asarray(improved)


def _candidate_weights(gram: FloatArray, along: FloatArray) -> FloatArray:
    """Weights (M, 8, 3) of three edges at the shortest vectors of the planes of some of them; NaN outside."""
    M = len(along)
    weights = np.zeros((M, 8, 3))
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in range(3):
            weights[:, 1 + i, i] = along[:, i] / gram[:, i, i]
            j = (i + 1) % 3
            determinant = gram[:, i, i] * gram[:, j, j] - gram[:, i, j] ** 2
            for a, b in ((i, j), (j, i)):
                upper = along[:, a] * gram[:, b, b] - along[:, b] * gram[:, i, j]
                weights[:, 4 + i, a] = upper / determinant
        cofactors = np.cross(gram[:, [1, 2, 0]], gram[:, [2, 0, 1]])
        determinant = np.einsum("kd,kd->k", gram[:, 0], cofactors[:, 0])
        weights[:, 7] = np.einsum("kji,kj->ki", cofactors, along) / determinant[:, None]
        inside = (weights >= 0).all(axis=2) & (weights.sum(axis=2) <= 1)
    weights[~inside] = np.nan
    return weights


def _keep_least(best: FloatArray, nearest: IntArray, upper: FloatArray, items: _Items) -> None:
    """Lower the `best` distances (N,) to those of items, and note their pairs."""
    order = np.lexsort((upper, items.state))
    state, first = np.unique(items.state[order], return_index=True)
    least = order[first]
    lower = upper[least] < best[state]
    best[state[lower]], nearest[state[lower]] = upper[least[lower]], items.pair[least[lower]]
