"""Waypoints: the poses through which a spline leads the tool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.common.fields import Coordinate
from cmbot.common.validation import refusal

SAME_PLACE = 1e-4
"""Waypoints nearer to each other, m, are at one place: hardly an arm tells them apart, and a spline through
both has a loop where the digits of a file lead sideways."""

# A turn by less, rad, may be what a file rounds.
_NO_TURN = 1e-3
# A unit quaternion up to what files round.
_LENGTH_OF_QUATERNION = 1e-3


def _unit_quaternion(row: tuple[float, ...]) -> tuple[float, ...]:
    if abs(float(np.linalg.norm(row[3:])) - 1.0) > _LENGTH_OF_QUATERNION:
        raise refusal("x, y, z and a unit quaternion qw, qx, qy, qz", got=row)
    return row


Waypoint = Annotated[
    tuple[Coordinate, ...], Field(min_length=7, max_length=7), AfterValidator(_unit_quaternion)
]
"""Point, m, and unit quaternion (w, x, y, z) of the tool in W."""


def distinct(rows: Sequence[Sequence[float]]) -> list[int]:
    """Return the numbers of the waypoints that are left when neighbours at one place are merged.

    The first of them stays; one that comes back to an earlier place is no neighbour of it.
    """
    points = np.array(rows, dtype=float)[:, :3]
    left = [0]
    for k in range(1, len(points)):
        if np.linalg.norm(points[k] - points[left[-1]]) >= SAME_PLACE:
            left.append(k)
    return left


def turned_in_place(rows: Sequence[Sequence[float]], kept: str) -> tuple[int, float] | None:
    """Return the first waypoint at which the tool would turn without moving, and the angle, rad.

    Parameters
    ----------
    rows : sequence of Waypoint
    kept : str
        What of the tool's orientation counts: ``pose`` all of it, ``axis`` its z axis, ``position`` nothing.
    """
    left = distinct(rows)
    if kept == "position" or len(left) == len(rows):
        return None
    angle = _turns(np.array(rows, dtype=float)[:, 3:], np.repeat(left, np.diff([*left, len(rows)])), kept)
    turned = np.flatnonzero(angle > _NO_TURN)
    return (int(turned[0]), float(angle[turned[0]])) if len(turned) else None


def _turns(quaternions: FloatArray, of: Sequence[int] | FloatArray, kept: str) -> FloatArray:
    """Angles (K,), rad, of orientations (K, 4) to those of other numbers (K,)."""
    R = Rotation.from_quat(quaternions, scalar_first=True)
    if kept == "pose":
        return np.asarray((R[of].inv() * R).magnitude())
    z = R.apply([0.0, 0.0, 1.0])
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(z[of], z), axis=1), (z[of] * z).sum(axis=1)))
