"""The flat contact of a foot: what it takes to tilt it, to open a gap, and to make it slip.

A load presses the contact with the force P at the centre of pressure e, takes the friction T and turns it by
M about the normal. With E = P e the load's tipping moments, a plate on stiff ground has a pressure that is
linear over the contact, p = a + b . x, and where that would be a tension a gap opens: p = max(0, a + b . x).

    tip   e leaves the convex hull of the contact:     P >= g(E), the hull's gauge
    gap   somewhere the linear pressure is zero:       P >= max over corners x of -x' J^-1 E
    slip  for every centre c of turning                |M + T x c| <= mu H(P, E, c)

with J the contact's second moments over its area and H the integral of p |x - c|: see `Friction`. All P are
positively homogeneous in the load.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
import shapely

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.representation import ShortRepr
from cmbot.hold.friction import Friction, Slipping

Gap = Literal["none", "allowed"]
Ring = tuple[tuple[float, float], ...]

MAGNET_PRESSURE = 2.0**2 / (2 * 4e-7 * np.pi)
"""No magnet pulls more than B^2 / (2 mu_0), Pa; iron is saturated at B = 2 T."""

# Slipping is judged of pressures whose centre is nearer than this share of the way to the hull's edge.
_BEFORE_EDGE = 0.998
# H changes with E by at most the first; if the hull has obtuse corners, what is pressed may be wide and
# narrow, and the second times R / r / sqrt(1 - s) bounds it, with R and r of its farthest corner and nearest
# edge and the share s of the way to the edge. Both are sampled, not proven.
BY_MOMENT, BY_MOMENT_AT_EDGE = 2.5, 0.8
# Changes of friction are judged with forces that are at least so many times what they press.
_STEADY = 10.0
# Loads whose work is in memory at once.
_LOADS_AT_ONCE = 2000
# Halvings, of the logarithm, that find a force which is surely enough.
_HALVINGS = 5
# Beyond any load: more overflows, and nothing holds it.
_HUGE_N = 1e100


@dataclass(frozen=True, kw_only=True)
class Contact(ShortRepr):
    """A flat contact, in the plate's frame: its origin is the centroid, coordinates along and across, m.

    Attributes
    ----------
    outline : tuple of rings of two floats, m
        The parts of the contact, such as several pads, each counter-clockwise without a repeated corner.
    """

    outline: tuple[Ring, ...]

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

    def slip(
        self, load: FloatArray, friction: float, gap: Gap, above: FloatArray | float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return P (N,), N, at which it slips, and the gradients (N, 5).

        Parameters
        ----------
        load : (N, 5), N and Nm
            Friction along and across, tipping moments E along and across, moment about the normal.
        friction : float
        gap : str
            Whether the pressure is linear throughout, or a gap may be open.
        above : float or (N,), N, optional
            What is not above this may be given lower.
        """
        above = np.broadcast_to(above, len(load))
        if len(load) > _LOADS_AT_ONCE:
            ends = range(_LOADS_AT_ONCE, len(load), _LOADS_AT_ONCE)
            parts = zip(np.split(load, ends), np.split(above, ends), strict=True)
            values, slopes = zip(*(self.slip(part, friction, gap, a) for part, a in parts), strict=True)
            return np.concatenate(values), np.concatenate(slopes)
        slide, whole = np.hypot(load[:, 0], load[:, 1]) / friction, self.gap(load[:, 2:4])[0]
        value, slope = slide.copy(), np.zeros((len(load), 5))
        slope[:, :2] = load[:, :2] / (friction**2 * np.maximum(slide, 1e-300)[:, None])
        upright = whole if gap == "none" else self.tip(load[:, 2:4])[0]
        least = np.max([slide, upright, above], axis=0)
        force, turning = self._turning(load, friction, least, whole)
        turns = force > 0
        value[turns], slope[turns] = force[turns], turning[turns]
        return value, slope

    def slip_without_gap(self, load: FloatArray, friction: float) -> tuple[FloatArray, FloatArray]:
        """Return P (N,), N, at which loads (N, 5) slip if no gap opens, and the gradients (N, 5).

        A few percent too low at most.
        """
        tables = _tables(self)
        unit, order, back = tables.unit(friction), [0, 1, 4, 2, 3], [0, 1, 3, 4, 2]
        parts = np.split((load / unit)[:, order], range(_LOADS_AT_ONCE, len(load), _LOADS_AT_ONCE))
        needed, which = zip(*map(tables.friction.least, parts), strict=True)
        gradient = tables.friction.by_load.T[np.concatenate(which)][:, back] / unit
        return np.concatenate(needed), gradient

    def bears(self, load: FloatArray, pressed: FloatArray, friction: float, gap: Gap) -> BoolArray:
        """Return whether loads (N, 5) neither tip nor slip with all P from `pressed` (N,), N, on."""
        whole = self.gap(load[:, 2:4])[0]
        upright = whole if gap == "none" else self.tip(load[:, 2:4])[0]
        good = np.maximum(np.hypot(load[:, 0], load[:, 1]) / friction, upright) <= pressed
        left = load[good], friction, pressed[good], whole[good]
        good[good] = self._turning(*left, only_whether=True)[0] == 0
        return np.asarray(good)

    def _turning(
        self,
        load: FloatArray,
        friction: float,
        least: FloatArray,
        whole: FloatArray,
        *,
        only_whether: bool = False,
    ) -> tuple[FloatArray, FloatArray]:
        """P (N,) at which it slips, zero where that is below `least`, and its gradients (N, 5).

        With `only_whether` it may be infinite where it is not below.
        """
        tables = _tables(self)
        unit = tables.unit(friction)
        scaled, tips = load / unit, load[:, 2:4] @ tables.edges.T
        edge = tips.argmax(axis=1)
        tip = tips[np.arange(len(load)), edge]
        least = np.maximum(least, tip / _BEFORE_EDGE)
        force, gradient = np.zeros(len(load)), np.zeros((len(load), 5))
        left = np.flatnonzero(~tables.surely_holds(scaled, least))
        if not len(left):
            return force, gradient
        scaled, least, whole, sides = scaled[left], least[left], whole[left], tables.sides[edge[left]]
        sure = tables.sure(scaled, least, np.maximum(least, whole))
        slips, moment = scaled[:, [0, 1, 4]], scaled[:, 2:4]
        found = Slipping(
            *(tables.friction, slips, moment, least, whole, tip[left], sides, sure), only_whether=only_whether
        )
        force[left], gradient[left] = found.force, found.gradient / unit
        return force, gradient

    def suffices(
        self,
        load: FloatArray,
        size: FloatArray,
        friction: float,
        gap: Gap,
        above: FloatArray | float = -np.inf,
    ) -> FloatArray:
        """Return P (N,), N, with which no load tips or slips that is off by at most `size` from one of these.

        Parameters
        ----------
        load : (N, 5), N and Nm
            As for `slip`.
        size : (N, 3), N and Nm
            Of changes of friction, of the tipping moments and of the moment about the normal.
        friction : float
        gap : str
        above : float or (N,), N, optional
            Less than that is not looked for.
        """
        tables = _tables(self)
        tips = self.tip(load[:, 2:4])[0] + size[:, 1] * np.linalg.norm(tables.edges, axis=1).max()
        opens = self.gap(load[:, 2:4])[0] + size[:, 1] * np.linalg.norm(tables.corners, axis=1).max()
        upright = opens if gap == "none" else tips
        slides = (np.hypot(load[:, 0], load[:, 1]) + size[:, 0]) / friction
        steady = _STEADY * size[:, 0] / friction
        least = np.maximum(np.max([upright, slides, steady], axis=0), above)
        finite = np.max([np.abs(load).max(axis=1), size.max(axis=1), least], axis=0) < _HUGE_N
        least[~finite] = np.inf
        grown, size, tips, enough = load[finite], size[finite], tips[finite], least[finite]
        left = 1 - size[:, 0] / (friction * np.maximum(enough, 1e-300))
        grown[:, [0, 1, 4]] /= left[:, None]
        share = np.zeros(len(grown))
        # Where the edge counts, the second time it is known how near the centre of pressure may be to it.
        for _ in range(2 if tables.at_edge else 1):
            by_moment = np.maximum(BY_MOMENT, tables.at_edge / np.sqrt(1 - np.minimum(share, _BEFORE_EDGE)))
            # With |c| <= H / P + |e| the friction of all centres is that of the load with a larger moment.
            twist = size[:, 2] + friction * by_moment * size[:, 1] + tables.size * size[:, 0]
            turned = np.stack([grown] * 2)
            turned[:, :, 4] += np.array([[-1.0], [1.0]]) * twist / left
            slips = self.slip(turned.reshape(-1, 5), friction, gap, np.tile(enough, 2))[0].reshape(2, -1)
            enough = np.maximum(enough, slips.max(axis=0))
            share = tips / np.maximum(enough, 1e-300)
        least[finite] = enough
        return np.asarray(least)


def polygons(region: shapely.Geometry) -> list[shapely.Polygon]:
    """Return the polygons of a geometry, the larger ones of a collection's parts first; without slivers."""
    parts = [part for part in shapely.get_parts(region) if part.geom_type == "Polygon"]
    return [part for part in parts if part.area > 1e-10]


def _largest(moment: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    values = moment @ rows.T
    which = values.argmax(axis=1)
    return values[np.arange(len(moment)), which], rows[which]


@lru_cache(maxsize=64)
def _tables(contact: Contact) -> _Tables:
    return _Tables(contact)


class _Tables:
    """What is found once for a contact.

    Attributes
    ----------
    edges, corners : (k, 2), 1/m
        Rows of which the largest with E is P: of tilting, and of a gap.
    size : float, m
        Of the farthest point from the centroid, the unit of `friction`.
    at_edge : float
        `BY_MOMENT_AT_EDGE` times R / r; zero of a hull without obtuse corners.
    friction : Friction
    """

    def __init__(self, contact: Contact) -> None:
        region = contact.region
        hull = np.array(shapely.orient_polygons(region.convex_hull).exterior.coords)
        side = np.diff(hull, axis=0)
        normal = np.column_stack([side[:, 1], -side[:, 0]]) / np.hypot(*side.T)[:, None]
        self.edges = normal / (normal * hull[:-1]).sum(axis=1)[:, None]
        self.size = float(np.linalg.norm(hull, axis=1).max())
        self.sides = np.stack([hull[:-1], hull[1:]], axis=1) / self.size
        obtuse = ((normal * np.roll(normal, 1, axis=0)).sum(axis=1) > 1e-6).any()
        steepest = float(np.linalg.norm(self.edges, axis=1).max())
        self.at_edge = BY_MOMENT_AT_EDGE * self.size * steepest * float(obtuse)
        self.friction = Friction(
            [(np.array(ring) @ np.array([1.0, 1j])) / self.size for ring in contact.outline]
        )
        second = self.size**2 * self.friction.whole[1:, 1:] / self.friction.whole[0, 0]
        self.corners = -hull[:-1] @ np.linalg.inv(second)
        convex = len(contact.outline) == 1 and region.convex_hull.area - region.area < 1e-9 * region.area
        self._rows = self.edges * self.size
        # Of a contact that is not convex no pressure is known to be spread.
        self._depths = 1 / np.linalg.norm(self._rows, axis=1) if convex else np.full(len(self._rows), 1e-300)

    def surely_holds(self, load: FloatArray, pressed: FloatArray) -> BoolArray:
        """Return which loads (N, 5), in units, do not slip with any force from `pressed` (N,) on.

        About any centre c friction does the work D(c) >= P |e - c|, with e the centre of pressure (Jensen),
        and D >= D0, the least; so T and the moment M_e about e hold where |T| / P + |M_e| / D0 <= 1. In a
        convex contact the pressure at e is at least half the largest, and its mean over the disc about e is
        no less: with the distance r of e from the outline no density exceeds 2 / (pi r^2) of the force. Of
        all such densities a disc has the least mean distance: D0 >= P r sqrt(2) / 3. With more force e moves
        straight to the centroid: r is no less than at either end (it is concave), and |M_e| no more.
        """
        P = np.maximum(pressed, 1e-300)
        e, T, M = load[:, 2:4] / P[:, None], load[:, :2], load[:, 4]
        depth = (self._depths * (1 - e @ self._rows.T)).min(axis=1)
        depth = np.clip(depth, 1e-300, self._depths.min())
        about = np.maximum(np.abs(M), np.abs(M - e[:, 0] * T[:, 1] + e[:, 1] * T[:, 0]))
        return np.asarray(np.hypot(T[:, 0], T[:, 1]) + about * 3 / (np.sqrt(2) * depth) <= P)

    def sure(self, load: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return forces (N,) between two from which on that is so; else infinity."""
        high = np.where(self.surely_holds(load, high), high, np.inf)
        for _ in range(_HALVINGS):
            middle = np.sqrt(np.maximum(low, 1e-300) * high)
            holds = self.surely_holds(load, middle)
            low, high = np.where(holds, low, middle), np.where(holds, middle, high)
        return high

    def unit(self, friction: float) -> FloatArray:
        """Of loads (5,), with which friction and sizes are one."""
        return np.array([friction, friction, self.size, self.size, friction * self.size])
