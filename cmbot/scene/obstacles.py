"""Shapes, and where they stand in W."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.validation import CheckedFields, require_type, shown
from cmbot.scene.fields import Length

__all__ = ["Box", "Capsule", "Cylinder", "Mesh", "Obstacle", "Shape", "Sphere", "pose"]


@dataclass(frozen=True, kw_only=True)
class Box(CheckedFields):
    """A cuboid about its centre.

    Attributes
    ----------
    size : tuple of float
        (3,), edge lengths along x, y, z, m.
    """

    size: tuple[Length, Length, Length]


@dataclass(frozen=True, kw_only=True)
class Cylinder(CheckedFields):
    """A cylinder along z, about its centre.

    Attributes
    ----------
    radius, length : float
        m.
    """

    radius: Length
    length: Length


@dataclass(frozen=True, kw_only=True)
class Capsule(CheckedFields):
    """A capsule along z, about its centre.

    Attributes
    ----------
    radius : float
        m.
    length : float
        Between the centres of its two half spheres, m; over all it is ``length + 2 radius`` long.
    """

    radius: Length
    length: Length


@dataclass(frozen=True, kw_only=True)
class Sphere(CheckedFields):
    """A ball about its centre.

    Attributes
    ----------
    radius : float
        m.
    """

    radius: Length


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """A triangle mesh in a file.

    Attributes
    ----------
    path : Path
        Of the file, absolute; its coordinates are metres.
    """

    path: Path

    def __post_init__(self) -> None:
        require_type(self.path, Path, "Mesh", "path", "a path, as pathlib.Path")


Shape = Box | Cylinder | Capsule | Sphere | Mesh


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacle:
    """Something that must not be hit.

    Attributes
    ----------
    name : str
        Unique in its scene.
    shape : Box, Cylinder, Capsule, Sphere or Mesh
    X_WO : array
        (4, 4), pose of the shape in W, m; read-only.
    workpiece : bool
        The tool works on it: it stays in every clearance that is reported or constrained, but does not push
        the tool away.
    """

    name: str
    shape: Shape
    X_WO: FloatArray
    workpiece: bool = False

    def __post_init__(self) -> None:
        require_type(self.name, str, "Obstacle", "name", "text")
        kinds = (Box, Cylinder, Capsule, Sphere, Mesh)
        require_type(self.shape, kinds, "Obstacle", "shape", "a Box, Cylinder, Capsule, Sphere or Mesh")
        require_type(self.workpiece, bool, "Obstacle", "workpiece", "true or false")
        X = self.X_WO
        sized = isinstance(X, np.ndarray) and X.dtype.kind in "fi" and X.shape == (4, 4)
        if not (sized and np.isfinite(X).all()):
            got = shown(X.tolist() if isinstance(X, np.ndarray) else X)
            raise InputError("Obstacle", "X_WO", got, "a pose: an array (4, 4) of finite numbers")


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
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("xyz", np.asarray(rpy, dtype=float)).as_matrix()
    X[:3, 3] = xyz
    X.setflags(write=False)
    return X
