"""Boxes of joint angles, and what narrows them: intervals of angles, of directions, of linear equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import Batch, BoolArray, FloatArray, IntArray, cross
from cmbot.robot import frame_about

# Added to intervals of angles, rad.
_ANGLE_ROUNDING = 1e-9
# Determinants, sines and derivatives below which nothing is inferred from them.
_SINGULAR_VALUE = 1e-9
_TURN = 2 * np.pi
# The other three of four columns.
_OTHER_COLUMNS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


@dataclass(frozen=True, eq=False)
class JointBoxes(Batch):
    """Boxes of joint angles between `lower` and `upper` (N, n), rad.

    `side` (N,) says on which of its two solutions the middle angle of the spherical joint is, 1 or -1.
    """

    lower: FloatArray
    upper: FloatArray
    side: IntArray

    @property
    def middle(self) -> FloatArray:
        """Middles (N, n), rad."""
        return 0.5 * (self.lower + self.upper)

    @property
    def half(self) -> FloatArray:
        """Half the edges (N, n), rad."""
        return 0.5 * (self.upper - self.lower)

    def halved(self, joint: IntArray) -> JointBoxes:
        """Return both halves of each box across a `joint` (N,) of its own."""
        k, middle = np.arange(len(self)), self.middle
        upper, lower = self.upper.copy(), self.lower.copy()
        upper[k, joint] = middle[k, joint]
        lower[k, joint] = middle[k, joint]
        halves = JointBoxes(self.lower, upper, self.side), JointBoxes(lower, self.upper, self.side)
        return JointBoxes.joined(*halves)


def narrowed(
    boxes: JointBoxes, joint: int, angle: FloatArray, width: FloatArray, keep: BoolArray
) -> tuple[JointBoxes, IntArray]:
    """Narrow `joint` of boxes to what is within `width` of `angle`, (N,), up to whole turns.

    Returns those of the boxes to `keep` (N,) that have such angles, and their numbers.
    """
    low, high = boxes.lower[:, joint], boxes.upper[:, joint]
    angle = angle + _TURN * np.round((0.5 * (low + high) - angle) / _TURN)
    lower, upper = np.full(len(boxes), np.inf), np.full(len(boxes), -np.inf)
    for shift in (-_TURN, 0.0, _TURN):
        first = np.maximum(low, angle + shift - width - _ANGLE_ROUNDING)
        last = np.minimum(high, angle + shift + width + _ANGLE_ROUNDING)
        meets = first <= last
        lower = np.where(meets, np.minimum(lower, first), lower)
        upper = np.where(meets, np.maximum(upper, last), upper)
    kept = np.flatnonzero(keep & (lower <= upper))
    boxes = boxes[kept]
    lower_all, upper_all = boxes.lower.copy(), boxes.upper.copy()
    lower_all[:, joint], upper_all[:, joint] = lower[kept], upper[kept]
    return JointBoxes(lower_all, upper_all, boxes.side), kept


def azimuth_between(
    axis: FloatArray, z: FloatArray, z_off: FloatArray, y: FloatArray, y_off: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return angles (N,), rad, about `axis` (3,) from directions `y` to `z` (N, 3).

    Also by how much they may differ where the directions are off by angles up to `y_off` and `z_off` (N,).
    """
    frame = frame_about(axis)
    angle, width = np.zeros(len(z)), np.zeros(len(z))
    for direction, off, sign in ((z, z_off, 1.0), (y, y_off, -1.0)):
        x = direction @ frame
        sine = np.hypot(x[:, 0], x[:, 1])
        angle += sign * np.arctan2(x[:, 1], x[:, 0])
        # A cap that holds the axis has all azimuths.
        away = np.arctan2(sine, np.abs(x[:, 2])) > off
        share = np.sin(np.minimum(off, 0.5 * np.pi)) / np.maximum(sine, _SINGULAR_VALUE)
        width += np.where(away, np.arcsin(np.minimum(share, 1.0)), np.pi)
    return angle, width


def common_moves(
    base: FloatArray, room: FloatArray, tilt: FloatArray, most: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the first and last moves t (N,), within plus and minus `most` (N,), that leave room.

    That is, ``|base - tilt t| <= room`` (N, n).
    """
    tells = (np.abs(tilt) > _SINGULAR_VALUE) & np.isfinite(room)
    divisor, room = np.where(tells, tilt, 1.0), np.where(tells, room, 0.0)
    ends = np.stack([(base - room) / divisor, (base + room) / divisor])
    first = np.where(tells, ends.min(axis=0), -np.inf).max(axis=1)
    last = np.where(tells, ends.max(axis=0), np.inf).min(axis=1)
    return np.maximum(first, -most), np.minimum(last, most)


def without_pivot(J: FloatArray) -> tuple[IntArray, IntArray, FloatArray, BoolArray]:
    """Return which column of matrices (N, 3, 4) is best left out, (N,), and the others, (N, 3).

    Also the inverses (N, 3, 3) of the others, and which exist.
    """
    minors = np.stack([np.abs(_determinants(J[:, :, others])) for others in _OTHER_COLUMNS], axis=1)
    pivot = minors.argmax(axis=1)
    others = _OTHER_COLUMNS[pivot]
    return pivot, others, *inverses(np.take_along_axis(J, others[:, None, :], axis=2))


def inverses(A: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the inverses of matrices (N, 3, 3), zero where there is none, and where there is one, (N,)."""
    a, b, c = A[:, :, 0], A[:, :, 1], A[:, :, 2]
    rows = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=1)
    determinant = (a * rows[:, 0]).sum(axis=1)
    exists = np.abs(determinant) > _SINGULAR_VALUE
    return rows / np.where(exists, determinant, np.inf)[:, None, None], exists


def _determinants(A: FloatArray) -> FloatArray:
    return np.asarray((cross(A[:, :, 0], A[:, :, 1]) * A[:, :, 2]).sum(axis=1))
