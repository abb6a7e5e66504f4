"""Lower bounds of the distances of all pairs of shapes in many postures at once, at little cost.

Every shape is enclosed in a rounded box: a box, of which some edges may be zero, grown by a radius. That is
exact for boxes, capsules and spheres. Two boxes that are apart along some direction are at least that far
apart. The first directions are the axes of the second box, for all pairs; `LowerBounds.tightened` then takes
the direction between points of both that are near each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.robot import Chain, Robot, box_about

# Postures are treated in blocks of this many, whose arrays fit the processor's cache.
_POSTURES_PER_BLOCK = 512
# How often points of two boxes are projected onto each other's box: a direction need not be the best one.
_PROJECTION_STEPS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class _RoundedBox:
    """A box grown by a radius, in the frame of a joint (0: W); its axes (3, 3) are rows; lengths in m."""

    joint: int
    axes: FloatArray
    centre: FloatArray
    half: FloatArray
    radius: float

    def edges(self) -> FloatArray:
        """Half its edges (k, 3), without those of length zero."""
        long = self.half > 0
        return self.half[long, None] * self.axes[long]


@dataclass(frozen=True, kw_only=True, eq=False)
class _PlacedBox:
    """A rounded box in N postures, in W: its centre (3, N), half edges (k, 3, N) and, where needed, axes."""

    centre: FloatArray
    edges: FloatArray
    axes: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class _Group:
    """One moving shape and the B shapes at rest that it may touch; lengths in m.

    `pairs` (B,) are their numbers, `position` (P,) where each of all pairs stands in them, -1: nowhere.
    `axes` (3 B, 3) has the first axis of every box, then the second and the third ones, `offset` (3 B, 1) the
    positions of the centres along them, `half` (3, B) half the edges, `radius` (B,) the sum of both radii.
    """

    shape: int
    pairs: IntArray
    position: IntArray
    axes: FloatArray
    offset: FloatArray
    half: FloatArray
    radius: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class _MovingGroup:
    """One moving shape, and B shapes with as many edges each that move, too, and may touch it.

    `pairs` (B,) are their numbers, `radius` (B,), m, the sum of both radii.
    """

    shape: int
    others: list[int]
    pairs: IntArray
    radius: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class LowerBounds:
    """Lower bounds of the distances of P pairs in a block of N postures."""

    block: slice  # which of all postures these are
    value: FloatArray  # (P, N), m; negative in overlaps
    _placed: dict[int, _PlacedBox]
    _groups: list[_Group]

    def tightened(self, pair: IntArray, posture: IntArray) -> FloatArray:
        """Return better bounds (M,), m, of pairs (M,) in postures (M,): nearly exact where both are boxes."""
        better = self.value[pair, posture]
        for group in self._groups:
            mine = np.flatnonzero(group.position[pair] >= 0)
            if len(mine):
                other, at, placed = group.position[pair[mine]], posture[mine], self._placed[group.shape]
                axes, half = group.axes.reshape(3, -1, 3)[:, other], group.half[:, other]
                along = [np.einsum("amc,cm->am", axes, v[:, at]) for v in (placed.centre, *placed.edges)]
                centre = along[0] - group.offset.reshape(3, -1)[:, other]
                apart = _separation(centre, along[1:], half) - group.radius[other]
                better[mine] = np.maximum(better[mine], apart)
        return better


class BroadPhase:
    """Lower bounds of the distances of pairs of shapes, pinocchio's GeometryObjects.

    A pair has the numbers of two shapes: the first moves, the second is carried by an earlier joint or does
    not move.
    """

    def __init__(self, robot: Robot, shapes: Sequence[Any], pairs: Sequence[tuple[int, int]]) -> None:
        self._boxes = [_rounded_box(shape) for shape in shapes]
        self._number = len(pairs)
        both_move: dict[tuple[int, int], list[tuple[int, int]]] = {}
        resting: dict[int, list[tuple[int, int]]] = {}
        for pair, (first, second) in enumerate(pairs):
            if self._boxes[second].joint > 0:
                alike = (second, len(self._boxes[first].edges()))
                both_move.setdefault(alike, []).append((pair, first))
            else:
                resting.setdefault(first, []).append((pair, second))
        self._both_move = [self._moving(shape, others) for (shape, _), others in both_move.items()]
        self._groups = [self._group(shape, others) for shape, others in resting.items()]
        # The vectors of each moving box: centre, half edges and, where it is a second one, axes.
        with_axes = {group.shape for group in self._both_move}
        moving = sorted({shape for pair in pairs for shape in pair if self._boxes[shape].joint > 0})
        joints = range(1, robot.model.njoints)
        self._carried = [[k for k in moving if self._boxes[k].joint == joint] for joint in joints]
        self._vectors: dict[int, FloatArray] = {}
        for k in moving:
            box = self._boxes[k]
            self._vectors[k] = np.vstack([box.centre, box.edges(), box.axes[: 3 * (k in with_axes)]])
        none = np.empty((0, 3))
        vectors = [np.vstack([none, *(self._vectors[k] for k in carried)]) for carried in self._carried]
        self._chain, self._coupling = Chain(robot.model, vectors), robot.coupling

    def lower_bounds(self, q: FloatArray) -> Iterator[LowerBounds]:
        """Yield the bounds in postures `q` (N, n), rad, block by block."""
        for start in range(0, len(q), _POSTURES_PER_BLOCK):
            block = slice(start, min(start + _POSTURES_PER_BLOCK, len(q)))
            yield self._bounds(self._coupling.positions(q[block]).T, block)

    def _group(self, shape: int, others: list[tuple[int, int]]) -> _Group:
        boxes = [self._boxes[other] for _, other in others]
        pairs, position = np.array([pair for pair, _ in others]), np.full(self._number, -1)
        position[pairs] = np.arange(len(pairs))
        return _Group(
            shape=shape,
            pairs=pairs,
            position=position,
            axes=np.stack([box.axes for box in boxes], axis=1).reshape(-1, 3),
            offset=np.stack([box.axes @ box.centre for box in boxes], axis=1).reshape(-1, 1),
            half=np.stack([box.half for box in boxes], axis=1),
            radius=np.array([box.radius + self._boxes[shape].radius for box in boxes]),
        )

    def _moving(self, shape: int, others: list[tuple[int, int]]) -> _MovingGroup:
        return _MovingGroup(
            shape=shape,
            others=[other for _, other in others],
            pairs=np.array([pair for pair, _ in others]),
            radius=np.array([self._boxes[other].radius + self._boxes[shape].radius for _, other in others]),
        )

    def _bounds(self, q: FloatArray, block: slice) -> LowerBounds:
        placed: dict[int, _PlacedBox] = {}
        for carried, (origin, _, vectors) in zip(self._carried, self._chain.walk(q), strict=True):
            k = 0
            for shape in carried:
                axes, end = k + 1 + len(self._boxes[shape].edges()), k + len(self._vectors[shape])
                placed[shape] = _PlacedBox(
                    centre=vectors[k] + origin, edges=vectors[k + 1 : axes], axes=vectors[axes:end]
                )
                k = end
        value = np.empty((self._number, q.shape[1]))
        for group in self._groups:
            box, size = placed[group.shape], (3, len(group.pairs), -1)
            centre = (group.axes @ box.centre - group.offset).reshape(size)
            edges = ((group.axes @ edge).reshape(size) for edge in box.edges)
            value[group.pairs] = _gap(centre, edges, group.half) - group.radius[:, None]
        for moving in self._both_move:
            box, others = placed[moving.shape], [placed[other] for other in moving.others]
            along = box.axes[:, None]
            centre = (along * (np.stack([other.centre for other in others]) - box.centre)).sum(axis=2)
            # Of each shape the first edges, then the second ones.
            each = zip(*(other.edges for other in others), strict=True)
            edges = ((along * np.stack(edge)).sum(axis=2) for edge in each)
            half = self._boxes[moving.shape].half[:, None]
            value[moving.pairs] = _gap(centre, edges, half) - moving.radius[:, None]
        return LowerBounds(block=block, value=value, _placed=placed, _groups=self._groups)


def _gap(centre: FloatArray, edges: Iterable[FloatArray], half: FloatArray) -> FloatArray:
    """Bound on the distance of two boxes by the axes of the second one, which is at the origin.

    Components along these lead. Where the boxes overlap along all three, the way out is no longer than the
    shortest overlap.
    """
    gap = np.abs(centre)
    for edge in edges:
        gap -= np.abs(edge)
    gap -= half[..., None]
    widest = gap.max(axis=0)
    np.maximum(gap, 0.0, out=gap)
    gap *= gap
    return np.asarray(np.where(widest > 0, np.sqrt(gap[0] + gap[1] + gap[2]), widest))


def _separation(centre: FloatArray, edges: Sequence[FloatArray], half: FloatArray) -> FloatArray:
    """Bound on the distance of two boxes, as in `_gap`, by one direction; -inf where none is found."""
    squares = [(edge * edge).sum(axis=0) for edge in edges]
    point = centre
    for _ in range(_PROJECTION_STEPS):
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
            low, high = box_about(geometry)
            centre, half = 0.5 * (low + high), 0.5 * (high - low)
    return _RoundedBox(
        joint=int(shape.parentJoint),
        axes=np.array(shape.placement.rotation.T),
        centre=np.array(shape.placement.act(centre)),
        half=half,
        radius=float(radius),
    )
