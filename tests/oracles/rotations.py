"""Rotation matrices from their formulas, for a second opinion."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray

__all__ = ["rodrigues", "rpy", "skew"]


def rpy(rpy_deg: tuple[float, float, float]) -> FloatArray:
    """Return the rotation matrix ``Rz(yaw) Ry(pitch) Rx(roll)`` of angles in degrees."""
    roll, pitch, yaw = np.radians(rpy_deg)
    x, y, z = np.eye(3)
    return np.asarray(rodrigues(yaw * z) @ rodrigues(pitch * y) @ rodrigues(roll * x))


def rodrigues(turn: FloatArray) -> FloatArray:
    """Return the rotation matrix of a rotation vector, rad."""
    angle = float(np.linalg.norm(turn))
    if angle == 0:
        return np.eye(3)
    K = skew(turn / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * K + 2 * np.sin(angle / 2) ** 2 * K @ K)


def skew(v: FloatArray) -> FloatArray:
    """Return the matrix of the cross product with a vector (3,)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
