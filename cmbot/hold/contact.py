"""The flat contact of a foot: what it takes to tilt it, to open a gap, and to make it slip.

A load presses the contact with the force P at the centre of pressure e, takes the friction T and turns it by
M about the normal. With E = P e the load's tipping moments, a plate on stiff ground has a pressure that is
linear over the contact, p = a + b . x, and where that would be a tension a gap opens: p = max(0, a + b . x).

    tip   e leaves the convex hull of the contact:     P >= g(E), the hull's gauge
    gap   somewhere the linear pressure is zero:       P >= max over corners x of -x' J^-1 E
    slip  for every centre c of turning                |M + T x c| <= mu P h(E / P, c)

with J the contact's second moments over its area and h the mean distance of the pressure from c. Slipping is
Goyal, Ruina and Papadopoulos (1991): the work of the load against that of friction. Without a gap h is linear
in e, so P is a maximum of linear functions. With one, h is found for some centres of pressure and
interpolated between them, and P is a root. All P are positively homogeneous in the load.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
import shapely
from scipy.spatial.distance import cdist

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.representation import short_repr

Gap = Literal["none", "allowed"]
Ring = tuple[tuple[float, float], ...]

MAGNET_PRESSURE = 2.0**2 / (2 * 4e-7 * np.pi)
"""No magnet pulls more than B^2 / (2 mu_0), Pa; iron is saturated at B = 2 T."""

# Cells along the longer side of the contact's box; centres of turning: along each side of the box, closer
# towards its corners, and on circles around it, by their radius in half sides and how many; points along the
# hull's edge, and shares of the way to it, of centres of pressure.
_CONTACT_CELLS, _TURNING_CENTRES = 24, 21
_TURNING_CIRCLES = {1.15: 48, 1.4: 64, 1.8: 64, 2.3: 64, 3.2: 80, 6.0: 80, 20.0: 80}
_RIM_POINTS, _WAYS_OUT = 72, (0.0, 0.2, 0.34, 0.45, 0.55, 0.65, 0.74, 0.82, 0.88, 0.93, 0.965, 0.985)
# Friction torques are taken lower by this share of what they have beside plain sliding: for centres of
# turning and of pressure between those above, and the cells. By more where only some cells are pressed,
# near corners: from the second share of cells on down to the first one, so much that none of the loads
# of `benchmarks/holding.py` is missed.
_TABLE_MARGIN, _MARGIN_ON_FEW, _FEW_CELLS, _MANY_CELLS = 0.07, 0.4, 0.02, 0.35
# Share of the mean distance without a gap by which P h grows with P at least.
_STEADY = 0.3
# Newton's steps at most for pressures, and where they end, as a share.
_PRESSURE_STEPS, _PRESSURE_CLOSE = 60, 1e-9
# Centres of turning that are tried of each load before all are: the second is mostly the one that decides.
_LIKELY_CENTRES = 2
# Share that rounding to single precision takes from a force at most.
_SINGLE = 1 - 1e-5
# Loads whose work about all centres is in memory at once: as many as a processor's cache holds.
_LOADS_AT_ONCE = 256


@dataclass(frozen=True, kw_only=True)
class Contact:
    """A flat contact, in the plate's frame: its origin is the centroid, coordinates along and across, m.

    Attributes
    ----------
    outline : tuple of rings of two floats, m
        The parts of the contact, such as several pads, each counter-clockwise without a repeated corner.
    """

    outline: tuple[Ring, ...]

    __repr__ = short_repr

    @staticmethod
    def of(region: shapely.Geometry) -> tuple[Contact, FloatArray]:
        """Return the contact of a region's outer outlines, and its centroid (2,), m."""
        parts = [shapely.Polygon(part.exterior) for part in polygons(region)]
        whole = shapely.MultiPolygon(parts)
        centroid = np.array(whole.centroid.coords[0])
        rings = (np.array(shapely.orient_polygons(part).exterior.coords)[:-1] - centroid for part in parts)
        outline = tuple(tuple((float(u), float(w)) for u, w in np.round(ring, 9)) for ring in rings)
        return Contact(outline=outline), centroid

    @staticmethod
    def rectangle(along: float, across: float) -> Contact:
        """Return a rectangle with these sides, m."""
        return Contact.of(shapely.box(-along / 2, -across / 2, along / 2, across / 2))[0]

    @cached_property
    def region(self) -> shapely.MultiPolygon:
        """As a geometry of shapely."""
        return shapely.MultiPolygon([shapely.Polygon(ring) for ring in self.outline])

    @property
    def area(self) -> float:
        """Area, m2."""
        return float(self.region.area)

    @property
    def size(self) -> tuple[float, float]:
        """Its extent along and across, m."""
        low_u, low_w, high_u, high_w = self.region.bounds
        return high_u - low_u, high_w - low_w

    def tip(self, moment: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return P (N,), N, at which it tilts under moments E (N, 2), Nm, and the gradients (N, 2)."""
        return _largest(moment, _tables(self).edges)

    def gap(self, moment: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return P (N,), N, at which a gap opens under moments E (N, 2), Nm, and the gradients (N, 2)."""
        return _largest(moment, _tables(self).corners)

    def slip(self, load: FloatArray, friction: float, gap: Gap) -> tuple[FloatArray, FloatArray]:
        """Return P (N,), N, at which it slips, and the gradients (N, 5).

        Parameters
        ----------
        load : (N, 5), N and Nm
            Friction along and across, tipping moments E along and across, moment about the normal.
        friction : float
        gap : str
            Whether the pressure is linear throughout, or a gap may be open.
        """
        if len(load) > _LOADS_AT_ONCE:
            parts = np.split(load, range(_LOADS_AT_ONCE, len(load), _LOADS_AT_ONCE))
            values, slopes = zip(*(self.slip(part, friction, gap) for part in parts), strict=True)
            return np.concatenate(values), np.concatenate(slopes)
        tables = _tables(self)
        slide = np.hypot(load[:, 0], load[:, 1])
        straight = np.zeros((len(load), 5))
        straight[:, :2] = load[:, :2] / (friction * np.maximum(slide, 1e-300)[:, None])
        if gap == "none":
            turning, slope = tables.turning_without_gap(load, friction)
        else:
            least = np.maximum(slide / friction, self.tip(load[:, 2:4])[0])
            turning, slope = tables.turning_with_gap(load, friction, least)
        turns = turning > slide / friction
        return np.where(turns, turning, slide / friction), np.where(turns[:, None], slope, straight)

    def steepness(self, friction: float) -> tuple[float, float, float]:
        """Bounds of how P of any kind changes with friction T, moments E and the moment M, per N and Nm."""
        tables = _tables(self)
        along, across = (np.linalg.norm(rows, axis=1).max() for rows in (tables.edges, tables.corners))
        return (
            max(tables.by_friction / friction, 1 / friction),
            max(tables.by_moment, float(along), float(across)),
            tables.by_torsion / friction,
        )


def polygons(region: shapely.Geometry) -> list[shapely.Polygon]:
    """Return the polygons of a geometry, the larger ones of a collection's parts first; without slivers."""
    parts = [part for part in shapely.get_parts(region) if part.geom_type == "Polygon"]
    return [part for part in parts if part.area > 1e-10]


def _largest(moment: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    values = moment @ rows.T
    which = values.argmax(axis=1)
    return values[np.arange(len(moment)), which], rows[which]


def _largest_of_rows(row: IntArray, value: FloatArray) -> IntArray:
    """The numbers of the largest values of each row, for M values of which each belongs to a row."""
    order = np.lexsort((-value, row))
    return np.asarray(order[np.concatenate([[True], np.diff(row[order]) > 0])])


@lru_cache(maxsize=64)
def _tables(contact: Contact) -> _Tables:
    return _Tables(contact)


class _Tables:
    """What is found once for a contact: its edges and corners, and mean distances of pressures.

    Attributes
    ----------
    edges, corners : (k, 2), 1/m
        Rows of which the largest with E is P: of tilting, and of a gap.
    centres : (C, 2), m
        Of turning.
    mean, by_pressure : (C,) and (C, 2), m and 1
        Mean distance from them without a gap: mean + by_pressure . e.
    distance : (W, B, C), m
        Mean distance with a gap, by the share of the way to the hull's edge and the bearing.
    by_friction, by_moment, by_torsion : float, 1, 1/m, 1/m
        Bounds of P's slopes, times the friction but for the moment.
    """

    def __init__(self, contact: Contact) -> None:
        region = contact.region
        hull = np.array(shapely.orient_polygons(region.convex_hull).exterior.coords)
        side = np.diff(hull, axis=0)
        normal = np.column_stack([side[:, 1], -side[:, 0]]) / np.hypot(*side.T)[:, None]
        self.edges = normal / (normal * hull[:-1]).sum(axis=1)[:, None]
        half = np.abs(hull).max(axis=0)
        self._points, self._areas, side = _cells(region)
        second = self._points.T @ (self._areas[:, None] * self._points) / self._areas.sum()
        second += np.diag(self._areas @ side**2) / (12 * self._areas.sum())
        self.corners = -hull[:-1] @ np.linalg.inv(second)
        angles = [2 * np.pi * np.arange(number) / number for number in _TURNING_CIRCLES.values()]
        circles = [
            r * np.column_stack([np.cos(a), np.sin(a)]) for r, a in zip(_TURNING_CIRCLES, angles, strict=True)
        ]
        along = np.sin(np.linspace(-np.pi / 2, np.pi / 2, _TURNING_CENTRES))
        inside = np.array(np.meshgrid(along, along)).reshape(2, -1).T
        self.centres = np.vstack([inside, *circles]) * half
        away = cdist(self._points, self.centres)
        share = self._areas / self._areas.sum()
        self.mean = self._lowered(share @ away, np.zeros((1, 2)), np.ones(1))
        self.by_pressure = (np.linalg.inv(second) @ (self._points.T * share) @ away).T
        self._lay_bearings(hull)
        e = (np.array(_WAYS_OUT)[:, None, None] * self._rim).reshape(-1, 2)
        pressure = _pressures(self._points, self._areas, e)
        found = self._lowered(pressure @ away, e, (pressure > 0).mean(axis=1))
        table = found.reshape(len(_WAYS_OUT), len(self._rim), -1)
        # Beyond the last one, up to the edge, as between the last two.
        outward = (table[-1] - table[-2]) / (_WAYS_OUT[-1] - _WAYS_OUT[-2])
        self._ways = np.array([*_WAYS_OUT, 1.0])
        self.distance = np.concatenate([table, (table[-1] + (1.0 - _WAYS_OUT[-1]) * outward)[None]])
        # With e towards a corner, P h may hardly change with P; so much it does: see `_STEADY`.
        for k in range(1, len(self._ways) - 1):
            inner, outer = self._ways[k : k + 2]
            most = (outer * self.distance[k] - _STEADY * self.mean * (outer - inner)) / inner
            self.distance[k + 1] = np.minimum(self.distance[k + 1], most)
        ring = np.minimum(self.distance[:-1], self.distance[1:])
        self._most_by_cell = (1 / np.minimum(ring[:, :-1], ring[:, 1:])).astype(np.float32)
        self._levers = np.array([np.ones(len(self.centres)), self.centres[:, 1], -self.centres[:, 0]])
        self._bounds()

    def _lay_bearings(self, hull: FloatArray) -> None:
        """Lay points along the hull's edges, closer together towards corners: bearings of the table."""
        lengths = np.hypot(*np.diff(hull, axis=0).T)
        counts = np.maximum(1, np.rint(_RIM_POINTS * lengths / lengths.sum())).astype(int)
        shares = [0.5 - 0.5 * np.cos(np.pi * np.arange(count + 1) / count) for count in counts]
        corners = zip(hull[:-1], np.diff(hull, axis=0), shares, strict=True)
        self._rim = np.vstack([start + share[:, None] * side for start, side, share in corners])
        self._shares, self._first = np.concatenate(shares), np.cumsum([0, *(counts + 1)])
        self._hull, self._along = hull[:-1], np.diff(hull, axis=0) / lengths[:, None] ** 2

    def _lowered(self, distance: FloatArray, e: FloatArray, cells: FloatArray) -> FloatArray:
        """Distances (…, C) less a share, by that of pressed `cells`, of what they have beside that of e."""
        plain = cdist(e, self.centres).reshape(distance.shape)
        lower = np.interp(cells, [_FEW_CELLS, _MANY_CELLS], [_MARGIN_ON_FEW, _TABLE_MARGIN])
        return np.asarray(distance - lower.reshape(-1, *(1,) * (distance.ndim - 1)) * (distance - plain))

    def _bounds(self) -> None:
        """How P changes at most: with H = P h(E / P, c), by the slopes of h along the ways and between."""
        rise = np.diff(self.distance, axis=0) / np.diff(self._ways)[:, None, None]
        # dH/dP at a fixed E is h - s dh/ds, constant between two ways.
        by_force = (self.distance[1:] - self._ways[1:, None, None] * rise).min(axis=(0, 1))
        width, long = np.diff(self._shares), np.linalg.norm(self._along, axis=1)
        edge = np.searchsorted(self._first, np.arange(len(width)), side="right") - 1
        by_moment = long * (1 + np.abs(self._hull).max() * 1.5 * np.linalg.norm(self.edges, axis=1))
        inside = width > 0  # not from the last point of an edge to the first of the next
        turn = np.abs(np.diff(self.distance, axis=1))[1:, inside] / self._ways[1:, None, None]
        across = (turn * (by_moment[edge] / np.where(inside, width, 1.0))[inside, None]).max(axis=(0, 1))
        slope = np.abs(rise).max(axis=(0, 1)) * np.linalg.norm(self.edges, axis=1).max() + across
        slope = np.maximum(slope, np.linalg.norm(self.by_pressure, axis=1))
        least = np.minimum(by_force, self.mean)
        self.by_torsion = float((1 / least).max())
        self.by_friction = float((np.linalg.norm(self.centres, axis=1) / least).max())
        self.by_moment = float((slope / least).max())

    def _work(self, load: FloatArray, which: IntArray, friction: float) -> FloatArray:
        """|Moment about a centre each| / friction, (N,)."""
        c = self.centres[which]
        return np.asarray(np.abs(load[:, 4] + load[:, 0] * c[:, 1] - load[:, 1] * c[:, 0]) / friction)

    def _slope(self, load: FloatArray, which: IntArray, friction: float, by_moment: FloatArray) -> FloatArray:
        """Gradients (N, 5) of |moment about a centre| / friction, and of E by what is given (N, 2)."""
        c = self.centres[which]
        moment = load[:, 4] + load[:, 0] * c[:, 1] - load[:, 1] * c[:, 0]
        sign = np.sign(moment) / friction
        return np.column_stack([sign * c[:, 1], -sign * c[:, 0], by_moment, sign])

    def turning_without_gap(self, load: FloatArray, friction: float) -> tuple[FloatArray, FloatArray]:
        """Return P (N,) for turning about any centre, and gradients (N, 5): see `Contact.slip`."""
        lever, pressure = (
            (rows / self.mean).astype(np.float32) for rows in (self._levers, self.by_pressure.T)
        )
        # In single precision: it says which centres may decide.
        turned, pressed = (load[:, [4, 0, 1]] / friction).astype(np.float32), load[:, 2:4].astype(np.float32)
        rough = np.abs(turned @ lever)
        rough -= pressed @ pressure
        size = np.abs(turned) @ np.abs(lever).max(axis=1) + np.abs(pressed) @ np.abs(pressure).max(axis=1)
        likely = np.flatnonzero(rough >= (rough.max(axis=1) - (1 - _SINGLE) * size)[:, None])
        row, centre = np.divmod(likely, len(self.centres))
        by_pressure = self.by_pressure[centre]
        work = self._work(load[row], centre, friction) - (load[row, 2:4] * by_pressure).sum(axis=1)
        values = work / self.mean[centre]
        first = _largest_of_rows(row, values)
        which = centre[first]
        slope = self._slope(load, which, friction, -by_pressure[first])
        return values[first], slope / self.mean[which, None]

    def turning_with_gap(
        self, load: FloatArray, friction: float, least: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return P (N,) for turning about any centre, and gradients (N, 5); zero where `least` suffices."""
        place, rows = self._place(load[:, 2:4]), np.arange(len(load))
        value, slope = np.zeros(len(load)), np.zeros((len(load), 5))
        # In single precision: it says about which centres friction may be too little.
        work = np.abs((load[:, [4, 0, 1]] / friction).astype(np.float32) @ self._levers.astype(np.float32))
        start, likely = np.maximum(least, 1e-12), np.zeros(len(load), dtype=np.intp)
        for _ in range(_LIKELY_CENTRES):
            best = (work * self._most_by_cell[self._between(place, start), place.bearing]).argmax(axis=1)
            force, _ = self._roots(self._work(load, best, friction), place, start, best)
            likely, start = np.where(force > start, best, likely), force
        # Centres about which friction is enough with that are so with more.
        most = self._most_by_cell[self._between(place, start), place.bearing]
        open_ = np.flatnonzero(work * most >= (_SINGLE * start[:, None]).astype(np.float32))
        row, centre = np.divmod(open_, len(self.centres))
        if not len(row):
            return value, slope
        pair = place[row]
        force, k = self._roots(self._work(load[row], centre, friction), pair, start[row], centre)
        # Of those with which nothing grew, the likely one alone is at its root.
        force[(force <= start[row]) & (centre != likely[row])] = -np.inf
        first = _largest_of_rows(row, force)
        first = first[force[first] > np.maximum(least[row[first]], 1e-12)]
        rows, c, pair, k, force = row[first], centre[first], pair[first], k[first], force[first]
        value[rows] = force
        inner, width = self._ways[k], self._ways[k + 1] - self._ways[k]
        ends = [[self.distance[a, b, c] for b in (pair.bearing, pair.bearing + 1)] for a in (k, k + 1)]
        low, high = ((1 - pair.share) * one + pair.share * next_ for one, next_ in ends)
        by_way, share = (high - low) / width, (pair.tip / force - inner) / width
        by_bearing = (1 - share) * (ends[0][1] - ends[0][0]) + share * (ends[1][1] - ends[1][0])
        by_moment = -(by_way[:, None] * pair.by_tip + (force * by_bearing)[:, None] * pair.by_bearing)
        slope[rows] = self._slope(load[rows], c, friction, by_moment) / (low - inner * by_way)[:, None]
        return value, slope

    def _place(self, moment: FloatArray) -> _Place:
        """Where the centres of pressure of moments E (N, 2) are."""
        tip, by_tip = _largest(moment, self.edges)
        tip = np.maximum(tip, 1e-300)
        edge, rows = (moment @ self.edges.T).argmax(axis=1), np.arange(len(moment))
        along = self._along[edge]
        share = ((moment / tip[:, None] - self._hull[edge]) * along).sum(axis=1)
        by_share = (along - (along * moment).sum(axis=1)[:, None] / tip[:, None] * by_tip) / tip[:, None]
        bearing = np.empty(len(rows), dtype=np.intp)
        for number in np.unique(edge):
            first, end = self._first[[number, number + 1]]
            at = rows[edge == number]
            k = np.searchsorted(self._shares[first:end], share[at], side="right") - 1
            bearing[at] = first + np.clip(k, 0, end - first - 2)
        width = self._shares[bearing + 1] - self._shares[bearing]
        share = np.clip((share - self._shares[bearing]) / width, 0.0, 1.0)
        return _Place(np.where(tip > 1e-300, tip, 0.0), by_tip, bearing, share, by_share / width[:, None])

    def _roots(
        self, work: FloatArray, place: _Place, least: FloatArray, centre: IntArray
    ) -> tuple[FloatArray, IntArray]:
        """P (M,), from `least` on, with which friction is enough about a centre, and between which ways.

        Between two ways P h is linear in P, and it grows with P.
        """
        y, j = place.share, place.bearing
        h = (1 - y) * self.distance[:, j, centre] + y * self.distance[:, j + 1, centre]
        enough = place.tip * h[1:] >= work * self._ways[1:, None]
        k, rows = np.minimum(enough.sum(axis=0), self._between(place, least)), np.arange(len(work))
        inner, low = self._ways[k], h[k, rows]
        by_way = (h[k + 1, rows] - low) / (self._ways[k + 1] - inner)
        return np.maximum((work - place.tip * by_way) / (low - inner * by_way), least), k

    def _between(self, place: _Place, force: FloatArray) -> IntArray:
        """The numbers (N,) of the last of the ways that are not beyond places, with a force (N,)."""
        k = np.searchsorted(self._ways, place.tip / force, side="right") - 1
        return np.asarray(np.clip(k, 0, len(self._ways) - 2))


@dataclass(frozen=True, eq=False)
class _Place:
    """Where centres of pressure are: P at which each tilts, and on which bearing; with derivatives by E."""

    tip: FloatArray
    by_tip: FloatArray
    bearing: IntArray
    share: FloatArray
    by_bearing: FloatArray

    def __getitem__(self, rows: IntArray | BoolArray) -> _Place:
        floats = (self.tip[rows], self.by_tip[rows])
        return _Place(*floats, self.bearing[rows], self.share[rows], self.by_bearing[rows])


def _cells(region: shapely.MultiPolygon) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centroids (K, 2), m, and areas (K,), m2, of a region's cells, and sides (K, 2), m, of whole ones."""
    low_u, low_w, high_u, high_w = region.bounds
    sides = np.array([high_u - low_u, high_w - low_w])
    counts = np.maximum(_CONTACT_CELLS // 2, np.rint(_CONTACT_CELLS * sides / sides.max())).astype(int)
    # Narrow at the edges, so that centres of pressure near them are those of some pressure.
    ends = [0.5 - 0.5 * np.cos(np.pi * np.arange(count + 1) / count) for count in counts]
    u, w = low_u + sides[0] * ends[0], low_w + sides[1] * ends[1]
    left, low = (part.ravel() for part in np.meshgrid(u[:-1], w[:-1], indexing="ij"))
    size = np.array(np.meshgrid(np.diff(u), np.diff(w), indexing="ij")).reshape(2, -1).T
    parts = shapely.intersection(shapely.box(left, low, left + size[:, 0], low + size[:, 1]), region)
    area = shapely.area(parts)
    kept = area > 1e-6 * area.max()
    centre = shapely.get_coordinates(shapely.centroid(parts[kept]))
    return centre, area[kept], size[kept]


def _pressures(points: FloatArray, areas: FloatArray, e: FloatArray) -> FloatArray:
    """Forces (M, K) on the cells, without tension and one in all, whose centre is at `e` (M, 2)."""
    X = np.column_stack([np.ones(len(points)), points / np.abs(points).max(axis=0)])
    goal = np.column_stack([np.ones(len(e)), e / np.abs(points).max(axis=0)])
    gram, pairs = X.T @ (areas[:, None] * X), (X[:, :, None] * X[:, None, :]).reshape(-1, 9)
    c, rows = np.linalg.solve(gram, goal.T).T, np.arange(len(e))
    for step in range(_PRESSURE_STEPS):
        pressure = c[rows] @ X.T
        on = np.where(pressure > 0, areas, 0.0)
        lack = (on * pressure) @ X - goal[rows]
        open_ = np.abs(lack).max(axis=1) > _PRESSURE_CLOSE
        rows, on, lack = rows[open_], on[open_], lack[open_]
        if not len(rows):
            break
        active = (on @ pairs).reshape(-1, 3, 3) + 1e-9 * gram
        change = np.linalg.solve(active, lack[:, :, None])[:, :, 0]
        # Where cells come and go the whole step may lead to and fro.
        c[rows] -= change if step < _PRESSURE_STEPS // 3 else 0.3 * change
    pressure = np.maximum(c @ X.T, 0.0) * areas
    return np.asarray(pressure / pressure.sum(axis=1, keepdims=True))
