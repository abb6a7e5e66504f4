"""Which links of a robot need not be checked against each other, decided by sampling.

The rule is that of MoveIt's setup assistant (Coleman et al. 2014): links that a joint joins (Adjacent), links
that are nearly always near each other (Always), and links that never come near each other (Never). Shapes are
convex hulls, which overlap where the links themselves do not; without this, many an arm would have no posture
that counts as clear.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import BoolArray, FloatArray, IntArray

NEAR = 0.02
"""Distance below which links count as near, m: the default safety margin."""
SAMPLES = 200
"""Random postures in which links are looked at before they count as always near."""
MOST_FAR = 10
"""In so many of these they may be further away: 5 %."""

PAIR = "disable_collisions"
"""The SRDF's tag of a pair of links that is not checked."""

# Random postures in none of which links are near that count as never near.
_NEVER_SAMPLES = 10_000
_SEED = 2014
# Ranges that end beyond it are none, as in `JointLimits`; such a joint turns, and is sampled over one turn.
_ENDLESS = 1e9

_LinkPair = tuple[str, str]
_ShapePairs = list[tuple[int, int]]


def sampled_postures(lower: FloatArray, upper: FloatArray, number: int = SAMPLES) -> FloatArray:
    """Return random postures (N, n) within the ranges `lower` to `upper` (n,), the same in every call.

    A joint without a range is sampled over one turn.
    """
    lower = np.where(np.abs(lower) >= _ENDLESS, -np.pi, lower)
    upper = np.where(np.abs(upper) >= _ENDLESS, np.pi, upper)
    return np.asarray(lower + np.random.default_rng(_SEED).random((number, len(lower))) * (upper - lower))


def near_pairs(
    model: Any,
    collision: Any,
    enabled: BoolArray,
    led: Callable[[FloatArray], FloatArray] = lambda q: q,
) -> dict[_LinkPair, _ShapePairs]:
    """Return the pairs of links that are nearly always near, each with its pairs of shapes.

    Parameters
    ----------
    model, collision
        Pinocchio's; the pairs of `collision` are replaced.
    enabled : (S, S)
        The pairs of shapes that are looked at.
    led : callable
        From random positions of all joints to those that the arm has, where some follow others.
    """
    pairs = _by_links(model, collision, enabled)
    keys, distances = list(pairs), _Nearness(model, collision, list(pairs.values()))
    far, active = np.zeros(len(keys), dtype=int), np.arange(len(keys))
    for q in sampled_postures(model.lowerPositionLimit, model.upperPositionLimit):
        if len(active) == 0:
            break
        far[active] += ~distances.near(led(q), active)
        active = active[far[active] <= MOST_FAR]
    return {keys[k]: pairs[keys[k]] for k in active}


def srdf_of(model: Any, collision: Any, name: str, kept: Sequence[ElementTree.Element] = ()) -> str:
    """Return the SRDF of a robot: the pairs of links that need not be checked, each with its reason.

    Parameters
    ----------
    model, collision
        Pinocchio's, of all joints; the pairs of `collision` are replaced.
    name : str
        Of the robot.
    kept : sequence of xml.etree.ElementTree.Element
        What comes before the pairs, such as group states.
    """
    joints = np.array([shape.parentJoint for shape in collision.geometryObjects], dtype=int)
    parents = np.array(model.parents, dtype=int)[joints]
    neighbours = (parents[:, None] == joints) | (parents == joints[:, None]) | (joints[:, None] == joints)
    reasons = dict.fromkeys(_by_links(model, collision, neighbours), "Adjacent")
    others = _by_links(model, collision, ~neighbours)
    reasons |= dict.fromkeys(near_pairs(model, collision, ~neighbours), "Always")
    left = [pair for pair in others if pair not in reasons]
    never = _never_near(model, collision, [others[pair] for pair in left])
    reasons |= {pair: "Never" for pair, apart in zip(left, never, strict=True) if apart}
    root = ElementTree.Element("robot", name=name)
    root.extend(kept)
    for (one, other), reason in sorted(reasons.items()):
        ElementTree.SubElement(root, PAIR, link1=one, link2=other, reason=reason)
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _never_near(model: Any, collision: Any, pairs: Sequence[_ShapePairs]) -> BoolArray:
    """Which of the pairs of links are near in no sampled posture."""
    distances, apart = _Nearness(model, collision, pairs), np.ones(len(pairs), dtype=np.bool_)
    for q in sampled_postures(model.lowerPositionLimit, model.upperPositionLimit, _NEVER_SAMPLES):
        active = np.flatnonzero(apart)
        if len(active) == 0:
            break
        apart[active] = ~distances.near(q, active)
    return apart


def _by_links(model: Any, collision: Any, wanted: BoolArray) -> dict[_LinkPair, _ShapePairs]:
    """The wanted pairs of shapes, by the names of their links."""
    names = [model.frames[shape.parentFrame].name for shape in collision.geometryObjects]
    pairs: dict[_LinkPair, _ShapePairs] = {}
    for first, second in zip(*np.nonzero(np.triu(wanted, 1)), strict=True):
        if names[first] != names[second]:
            key = (min(names[first], names[second]), max(names[first], names[second]))
            pairs.setdefault(key, []).append((int(first), int(second)))
    return pairs


class _Nearness:
    """Tells which pairs of links are near in a posture; a pair of links has one or more pairs of shapes."""

    def __init__(self, model: Any, collision: Any, pairs: Sequence[_ShapePairs]) -> None:
        self._model, self._geometry = model, collision
        collision.removeAllCollisionPairs()
        for first, second in (shapes for each in pairs for shapes in each):
            collision.addCollisionPair(pin.CollisionPair(first, second))
        numbers: IntArray = np.array([len(each) for each in pairs], dtype=np.intp)
        # Places of each pair of links among the pairs of shapes.
        self._ends = np.cumsum(numbers)
        self._starts = self._ends - numbers
        self._shapes = np.array([pair for each in pairs for pair in each], dtype=np.intp).reshape(-1, 2)
        self._data, self._geometry_data = model.createData(), pin.GeometryData(collision)
        self._centres, radii = [], []
        for shape in collision.geometryObjects:
            shape.geometry.computeLocalAABB()
            self._centres.append(np.array(shape.geometry.aabb_center))
            radii.append(shape.geometry.aabb_radius)
        self._reach = np.array(radii)[self._shapes].sum(axis=1) + NEAR

    def near(self, q: FloatArray, which: IntArray) -> BoolArray:
        """Which of the pairs of links `which` are near in posture `q` (n,)."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, q)
        placements = self._geometry_data.oMg
        centres = np.array([placements[k].act(centre) for k, centre in enumerate(self._centres)])
        between = centres[self._shapes[:, 0]] - centres[self._shapes[:, 1]]
        possible = np.linalg.norm(between, axis=1) < self._reach
        return np.array([self._any_near(k, possible) for k in which], dtype=np.bool_)

    def _any_near(self, pair: int, possible: BoolArray) -> bool:
        places = range(self._starts[pair], self._ends[pair])
        return any(possible[k] and self._distance(k) < NEAR for k in places)

    def _distance(self, place: int) -> float:
        return float(pin.computeDistance(self._geometry, self._geometry_data, place).min_distance)
