"""What the feet bear, computed a second time from the description in the documents."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.hold import Foot
from cmbot.planning.certification.check import Check, largest_check
from cmbot.robot import Robot

# What two computations may differ by, as a share of what presses the foot most, below and above, and N; by
# what share a bound may be missed. This one has cells, and few centres of turning.
_MORE_THAN_FOUND, _LESS_THAN_FOUND, _LEAST_DIFFERENCE, _OF_BOUND = 0.005, 0.25, 1e-6, 1e-9
# Cells along each side of the contact's box, and at least of its smallest part's; centres of turning on a
# circle, the share of the way to its edge up to which cells have a centre of pressure, and circles in half
# sides of the box.
_SECOND_CELLS, _CELLS_OF_PART, _ON_CIRCLE, _INNER_WAY = 32, 8, 24, 0.94
_SECOND_CIRCLES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.5, 5.0)
# Steps of Newton's method for the pressure, where it ends, and steps of the search for the adhesion.
_SECOND_STEPS, _SECOND_CLOSE, _SECOND_HALVINGS = 40, 1e-8, 12


def hold_checks(robot: Robot, times: FloatArray, wrench: FloatArray) -> Iterator[Check]:
    """Yield what the package's adhesion differs by, and what feet bear against their bounds.

    How two feet share a wrench is the elastic frame's, which is not judged.

    Parameters
    ----------
    robot : Robot
    times : (N,), s
    wrench : (N, 6), N and Nm
        Of the moving arm on the guardrail, about O0 in W.
    """
    if robot.holding is None:
        return
    # The constant part is that of one body.
    rest = robot.model.inertias[0]
    weight = rest.mass * np.array(robot.model.gravity.linear)
    whole = wrench + np.hstack([weight, np.cross(rest.lever - np.array(robot.foot_point), weight)])
    for number, foot in enumerate(robot.feet):
        which = f" of foot {number + 1}" if len(robot.feet) > 1 else ""
        force, torque = np.split(whole @ foot.share.T, 2, axis=1)
        load = np.hstack([force @ foot.axes.T, (torque - np.cross(foot.centre, force)) @ foot.axes.T])
        if foot.contact is not None:
            theirs = robot.holding.needed(number, wrench)
            own = _Plate(foot).adhesion(load, theirs)
            quantity = f"difference of the adhesion needed{which} from a second computation"
            # A foot that stands on something hardly needs adhesion: the force that presses it counts.
            pressed = float(np.abs(own - load[:, 2]).max())
            low, high = _MORE_THAN_FOUND * pressed, _LESS_THAN_FOUND * pressed
            off = np.maximum(
                (own - theirs) / max(low, _LEAST_DIFFERENCE), (theirs - own) / max(high, _LEAST_DIFFERENCE)
            )
            yield largest_check(quantity, times, off, 1.0, "of what is allowed")
            if foot.adhesion is not None:
                bound = foot.adhesion / foot.safety * (1 + _MORE_THAN_FOUND)
                quantity = f"adhesion needed{which} by a second computation"
                yield largest_check(quantity, times, np.maximum(own, 0.0), bound, "N")
        if foot.force is not None and foot.moment is not None:
            use = foot.safety * (np.abs(load) / np.array([*foot.force, *foot.moment])).max(axis=1)
            quantity = f"load of the clamp{which} by a second computation"
            yield largest_check(quantity, times, use, 1 + _OF_BOUND, "of its bounds")


class _Plate:
    """A flat contact by cells of its box, from its outline alone."""

    def __init__(self, foot: Foot) -> None:
        if foot.contact is None:
            raise ValueError("a foot without a flat contact")
        rings = [np.array(ring) for ring in foot.contact.outline]
        self.corners = np.vstack(rings)
        low, high = self.corners.min(axis=0), self.corners.max(axis=0)
        # Cells of one size, so that all weigh the same.
        smallest = np.min([np.ptp(ring, axis=0) for ring in rings], axis=0)
        size = np.minimum((high - low) / _SECOND_CELLS, smallest / _CELLS_OF_PART)
        self.points = np.vstack([_cells(ring, size) for ring in rings])
        self.foot = foot
        side = ConvexHull(self.corners).equations
        self.edges = -side[:, :2] / side[:, 2:]
        angle = 2 * np.pi * np.arange(_ON_CIRCLE) / _ON_CIRCLE
        circle = np.column_stack([np.cos(angle), np.sin(angle)]) * (high - low) / 2
        self.centres = np.unique(np.vstack([radius * circle for radius in _SECOND_CIRCLES]), axis=0)
        self.away = np.linalg.norm(self.points[:, None] - self.centres, axis=2)
        self.second = self.points.T @ self.points / len(self.points)

    def adhesion(self, load: FloatArray, near: FloatArray) -> FloatArray:
        """What is needed (N,), N, under loads (N, 6), of which something is known that is `near`."""
        T, pull, E = load[:, :2], load[:, 2], np.column_stack([load[:, 4], -load[:, 3]])
        least = np.maximum(np.hypot(*T.T) / self.foot.friction, (E @ self.edges.T).max(axis=1))
        if self.foot.gap == "none":
            least = np.maximum(least, (-E @ np.linalg.inv(self.second) @ self.corners.T).max(axis=1))
        least = np.maximum(least, 1e-9)
        turning = load[:, 5:] + T[:, :1] * self.centres[:, 1] - T[:, 1:] * self.centres[:, 0]
        work = np.abs(turning) / self.foot.friction

        def enough(force: FloatArray, of: IntArray) -> BoolArray:
            share = self._pressures(E[of] / force[:, None]) @ self.away
            return np.asarray((work[of] <= force[:, None] * share).all(axis=1))

        tips = (E @ self.edges.T).max(axis=1) > _INNER_WAY * np.maximum(near - pull, 1e-9)
        found, left = np.where(tips, np.maximum(least, near - pull), least), np.flatnonzero(~tips)
        left = left[~enough(least[left], left)]
        low, high = least[left], np.maximum(1.1 * (near - pull), 1.1 * least)[left]
        for _ in range(_SECOND_HALVINGS):
            holds = enough(middle := 0.5 * (low + high), left)
            low, high = np.where(holds, low, middle), np.where(holds, middle, high)
        found[left] = high
        return np.asarray(pull + found)

    def _pressures(self, e: FloatArray) -> FloatArray:
        """Forces (N, K) on the cells, one in all, linear and without tension, whose centre is at e (N, 2)."""
        X = np.column_stack([np.ones(len(self.points)), self.points / np.abs(self.points).max(axis=0)])
        # The cells' middles do not reach the edge.
        e = e * np.minimum(1.0, _INNER_WAY / np.maximum((e @ self.edges.T).max(axis=1), 1e-9))[:, None]
        goal = np.column_stack([np.ones(len(e)), e / np.abs(self.points).max(axis=0)])
        c = goal @ np.linalg.inv(X.T @ X)
        pairs = (X[:, :, None] * X[:, None, :]).reshape(-1, 9)
        for step in range(_SECOND_STEPS):
            force = c @ X.T
            lack = np.maximum(force, 0.0) @ X - goal
            if np.abs(lack).max(initial=0.0) < _SECOND_CLOSE:
                break
            slope = ((force > 0).astype(float) @ pairs).reshape(-1, 3, 3) + 1e-9 * np.eye(3)
            c -= (1.0 if step < _SECOND_STEPS // 2 else 0.3) * np.linalg.solve(slope, lack[:, :, None])[
                :, :, 0
            ]
        pressure = np.maximum(c @ X.T, 0.0)
        return np.asarray(pressure / pressure.sum(axis=1, keepdims=True))


def _cells(ring: FloatArray, size: FloatArray) -> FloatArray:
    """Middles (K, 2) of the cells of about a size (2,), m, within a ring; they fill its box evenly."""
    low, sides = ring.min(axis=0), np.ptp(ring, axis=0)
    counts = np.rint(sides / size).astype(int)
    u, w = (low[k] + sides[k] * (np.arange(counts[k]) + 0.5) / counts[k] for k in (0, 1))
    points = np.array(np.meshgrid(u, w)).reshape(2, -1).T
    return np.asarray(points[_inside(ring, points)])


def _inside(ring: FloatArray, points: FloatArray) -> BoolArray:
    """Which points (N, 2) a ring has inside, by how often a ray from each crosses it."""
    start, end = ring, np.roll(ring, -1, axis=0)
    over = (start[:, 1] > points[:, 1:]) != (end[:, 1] > points[:, 1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (points[:, 1:] - start[:, 1]) / (end[:, 1] - start[:, 1])
    return np.asarray(
        (over & (points[:, :1] < start[:, 0] + share * (end - start)[:, 0])).sum(axis=1) % 2 == 1
    )
