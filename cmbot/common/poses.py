"""Poses as homogeneous matrices."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray, read_only


def pose(xyz: ArrayLike, rpy: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """Return a pose from URDF's position and angles.

    Parameters
    ----------
    xyz : (3,), m
    rpy : (3,), rad
        Roll, pitch, yaw: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.

    Returns
    -------
    (4, 4)
        Homogeneous, read-only.
    """
    return read_only(turned_pose(xyz, Rotation.from_euler("xyz", np.asarray(rpy, dtype=float)).as_matrix()))


def turned_pose(xyz: ArrayLike, R: ArrayLike) -> FloatArray:
    """Return the pose (4, 4) of a position (3,), m, and a rotation (3, 3)."""
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, xyz
    return X


def rpy_deg(R: FloatArray) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a rotation (3, 3), degrees, as `pose` takes them in radians.

    At a pitch of 90 degrees many turn alike: one of these.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock detected", UserWarning)
        roll, pitch, yaw = Rotation.from_matrix(R).as_euler("xyz", degrees=True).tolist()
    return roll, pitch, yaw
