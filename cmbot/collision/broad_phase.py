"""How near the shapes of many postures can be at most, all pairs at once: far pairs cost next to nothing.

Every shape is enclosed in a rounded box: a box, of which some edges may be zero, grown by a radius. That is
exact for boxes, capsules and spheres. Two boxes that are apart along some direction are at least that far
apart. First such directions are the axes of the second box, for all pairs; then, for pairs that this leaves
in doubt, the direction between points of both that are near each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.robot import Chain, Robot

__all__ = ["BroadPhase", "LowerBounds"]

# Postures are looked at in blocks of this many, whose arrays fit the processor's cache.
_BLOCK = 512
# How often points of two boxes are projected onto each other's box: a direction need not be the best one.
_PROJECTIONS = 4


@dataclass(frozen=True, kw_only=True)
class _RoundedBox:
    """A box grown by a radius, fixed to a joint (0: to W); lengths in m.

    Attributes
    ----------
    joint : int
    axes : (3, 3)
        Directions of its edges, one a row, in the joint's frame.
    centre, half : (3,)
        In the joint's frame; half its edges' lengths.
    radius : float
    """

    joint: int
    axes: FloatArray
    centre: FloatArray
    half: FloatArray
    radius: float

    @property
    def long(self) -> IntArray:
        """Which edges are not zero."""
        return np.flatnonzero(self.half)

    def vectors(self, with_axes: bool) -> FloatArray:
        """Return its centre, half its edges and, if asked for, its axes, (1 + k, 3) or (4 + k, 3)."""
        edges = self.half[self.long, None] * self.axes[self.long]
        return np.vstack([self.centre, edges, self.axes[: 3 if with_axes else 0]])


@dataclass(frozen=True, kw_only=True)
class _Moved:
    """A rounded box in N postures, in W: its centre (3, N), half edges (k, 3, N) and, if asked for, axes."""

    centre: FloatArray
    edges: FloatArray
    axes: FloatArray


@dataclass(frozen=True, kw_only=True)
class _Group:
    """One moving shape and the B shapes that it may touch and that do not move.

    Attributes
    ----------
    shape : int
    pairs : (B,)
    place : (P,)
        Where a pair of them all stands in `pairs`; -1 where it does not.
    axes : (3 B, 3)
        The first axis of every box, then the second and the third ones.
    offset : (3 B, 1), m
        Position of the boxes' centres along these axes.
    half : (3, B), m
        Half their edges' lengths.
    radius : (B,), m
        Sum of both radii.
    """

    shape: int
    pairs: IntArray
    place: IntArray
    axes: FloatArray
    offset: FloatArray
    half: FloatArray
    radius: FloatArray


@dataclass(frozen=True, kw_only=True)
class LowerBounds:
    """What the distances of P pairs are not below in N postures.

    Attributes
    ----------
    some : slice
        Which of the postures asked about these are.
    value : (P, N), m
        Negative in overlaps.
    """

    some: slice
    value: FloatArray
    _moved: dict[int, _Moved]
    _groups: list[_Group]

    def tightened(self, pair: IntArray, posture: IntArray) -> FloatArray:
        """Return better bounds (M,), m, of pairs (M,) in postures (M,): nearly exact where both are boxes."""
        better = self.value[pair, posture]
        for group in self._groups:
            mine = np.flatnonzero(group.place[pair] >= 0)
            if len(mine):
                other, at, moved = group.place[pair[mine]], posture[mine], self._moved[group.shape]
                axes, half = group.axes.reshape(3, -1, 3)[:, other], group.half[:, other]
                centre = _components(axes, moved.centre[:, at]) - group.offset.reshape(3, -1)[:, other]
                edges = [_components(axes, edge[:, at]) for edge in moved.edges]
                apart = _apart(centre, edges, half) - group.radius[other]
                better[mine] = np.maximum(better[mine], apart)
        return better


class BroadPhase:
    """Lower bounds of the distances of pairs of shapes.

    Parameters
    ----------
    robot : Robot
    shapes : sequence of pinocchio.GeometryObject
    pairs : sequence of two int
        Indices of shapes: the first moves, the second is carried by an earlier joint or does not move.
    """

    def __init__(self, robot: Robot, shapes: Sequence[Any], pairs: Sequence[tuple[int, int]]) -> None:
        self._boxes = [_rounded_box(shape) for shape in shapes]
        self._number = len(pairs)
        self._both_move: list[tuple[int, int, int]] = []
        still: dict[int, list[tuple[int, int]]] = {}
        for pair, (first, second) in enumerate(pairs):
            if self._boxes[second].joint > 0:
                self._both_move.append((pair, first, second))
            else:
                still.setdefault(first, []).append((pair, second))
        self._groups = [self._group(shape, others) for shape, others in still.items()]
        # Where both move, gaps are seen along the axes of the second.
        with_axes = {second for _, _, second in self._both_move}
        moving = sorted({shape for pair in pairs for shape in pair if self._boxes[shape].joint > 0})
        self._vectors = {shape: self._boxes[shape].vectors(shape in with_axes) for shape in moving}
        joints = range(1, robot.dof + 1)
        self._carried = [[k for k in moving if self._boxes[k].joint == joint] for joint in joints]
        none = np.empty((0, 3))
        vectors = [np.vstack([none, *(self._vectors[k] for k in carried)]) for carried in self._carried]
        self._chain = Chain(robot.model, vectors)

    def look(self, q: FloatArray) -> Iterator[LowerBounds]:
        """Go through postures `q` (N, n), rad, in blocks."""
        for start in range(0, len(q), _BLOCK):
            some = slice(start, min(start + _BLOCK, len(q)))
            yield self._bounds(q[some].T, some)

    def _group(self, shape: int, others: list[tuple[int, int]]) -> _Group:
        boxes = [self._boxes[other] for _, other in others]
        pairs, place = np.array([pair for pair, _ in others]), np.full(self._number, -1)
        place[pairs] = np.arange(len(pairs))
        axes = np.stack([box.axes for box in boxes], axis=1)
        return _Group(
            shape=shape,
            pairs=pairs,
            place=place,
            axes=axes.reshape(-1, 3),
            offset=np.stack([box.axes @ box.centre for box in boxes], axis=1).reshape(-1, 1),
            half=np.stack([box.half for box in boxes], axis=1),
            radius=np.array([box.radius + self._boxes[shape].radius for box in boxes]),
        )

    def _bounds(self, q: FloatArray, some: slice) -> LowerBounds:
        at: dict[int, _Moved] = {}
        for carried, (origin, _, vectors) in zip(self._carried, self._chain.walk(q), strict=True):
            k = 0
            for shape in carried:
                axes, end = k + 1 + len(self._boxes[shape].long), k + len(self._vectors[shape])
                at[shape] = _Moved(
                    centre=vectors[k] + origin, edges=vectors[k + 1 : axes], axes=vectors[axes:end]
                )
                k = end
        value = np.empty((self._number, q.shape[1]))
        for group in self._groups:
            moved, size = at[group.shape], (3, len(group.pairs), -1)
            centre = (group.axes @ moved.centre - group.offset).reshape(size)
            edges = ((group.axes @ edge).reshape(size) for edge in moved.edges)
            value[group.pairs] = _gap(centre, edges, group.half) - group.radius[:, None]
        for pair, first, second in self._both_move:
            one, other, box = at[first], at[second], self._boxes[second]
            centre = _along(other.axes, one.centre - other.centre)
            edges = (_along(other.axes, edge) for edge in one.edges)
            value[pair] = _gap(centre, edges, box.half) - (self._boxes[first].radius + box.radius)
        return LowerBounds(some=some, value=value, _moved=at, _groups=self._groups)


def _along(axes: FloatArray, vectors: FloatArray) -> FloatArray:
    """Components (3, N) of `vectors` (3, N) along `axes` (3, 3, N)."""
    return np.asarray((axes * vectors).sum(axis=1))


def _components(axes: FloatArray, vectors: FloatArray) -> FloatArray:
    """Components (3, M) of `vectors` (3, M) along `axes` (3, M, 3)."""
    return np.asarray(np.einsum("amc,cm->am", axes, vectors))


def _gap(centre: FloatArray, edges: Iterable[FloatArray], half: FloatArray) -> FloatArray:
    """Distance at least of two boxes along the axes of the second, at the origin and half as long as `half`.

    Components lead. Where they overlap along all three, the way out is no longer than the shortest overlap.
    """
    gap = np.abs(centre)
    for edge in edges:
        gap -= np.abs(edge)
    gap -= half[..., None]
    widest = gap.max(axis=0)
    np.maximum(gap, 0.0, out=gap)
    gap *= gap
    return np.asarray(np.where(widest > 0, np.sqrt(gap[0] + gap[1] + gap[2]), widest))


def _apart(centre: FloatArray, edges: Sequence[FloatArray], half: FloatArray) -> FloatArray:
    """Distance at least of two boxes that are apart, as in `_gap`; no bound at all where none is found."""
    squares = [(edge * edge).sum(axis=0) for edge in edges]
    point = centre
    for _ in range(_PROJECTIONS):
        away = np.clip(point, -half, half) - centre
        point = centre
        for edge, square in zip(edges, squares, strict=True):
            point = point + edge * np.clip((away * edge).sum(axis=0) / square, -1.0, 1.0)
    u = point - np.clip(point, -half, half)
    length = np.sqrt((u * u).sum(axis=0))
    between = (u * centre).sum(axis=0) - (np.abs(u) * half).sum(axis=0)
    for edge in edges:
        between -= np.abs((u * edge).sum(axis=0))
    return np.where(length > 0, between / np.maximum(length, np.finfo(float).tiny), -np.inf)


def _rounded_box(shape: Any) -> _RoundedBox:
    geometry = shape.geometry
    centre, half, radius = np.zeros(3), np.zeros(3), 0.0
    match geometry:
        case coal.Sphere():
            radius = geometry.radius
        case coal.Capsule():
            half[2], radius = geometry.halfLength, geometry.radius
        case coal.Cylinder():
            half[:] = geometry.radius, geometry.radius, geometry.halfLength
        case coal.Box():
            half[:] = geometry.halfSide
        case _:
            geometry.computeLocalAABB()
            box = geometry.aabb_local
            centre, half = 0.5 * (box.min_ + box.max_), 0.5 * (box.max_ - box.min_)
    return _RoundedBox(
        joint=int(shape.parentJoint),
        axes=np.array(shape.placement.rotation.T),
        centre=np.array(shape.placement.act(centre)),
        half=half,
        radius=float(radius),
    )
