"""Obstacles: their shapes and poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.fields import Length
from cmbot.common.reading.validation import CheckedFields, require_type, shown
from cmbot.common.representation import ShortRepr

LEAST_SCALE, MOST_SCALE = 1e-6, 1e3
"""Units of a shape: from micrometres to kilometres, m."""


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
        Of the file, absolute.
    scale : float, m
        The unit of its coordinates: 0.001 where they are millimetres.
    """

    path: Path
    scale: float = 1.0

    def __post_init__(self) -> None:
        require_type(self.path, Path, "Mesh", "path", "a path, as pathlib.Path")
        _require_scale(self.scale, "Mesh")


Shape = Box | Cylinder | Capsule | Sphere | Mesh


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacle(ShortRepr):
    """An obstacle: a shape, placed in W.

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
    scale : float or None, m
        The unit of the shape's dimensions in the scene file; `shape` has them in metres. Where one is given
        they are meant, however large.
    contact : float, m
        Length of the tool's tip that may touch it: no distance from it counts.
    """

    name: str
    shape: Shape
    X_WO: FloatArray
    workpiece: bool = False
    scale: float | None = None
    contact: float = 0.0

    def __post_init__(self) -> None:
        require_type(self.name, str, "Obstacle", "name", "text")
        kinds = (Box, Cylinder, Capsule, Sphere, Mesh)
        require_type(self.shape, kinds, "Obstacle", "shape", "a Box, Cylinder, Capsule, Sphere or Mesh")
        require_type(self.workpiece, bool, "Obstacle", "workpiece", "true or false")
        if self.scale is not None:
            _require_scale(self.scale, "Obstacle")
        X = self.X_WO
        sized = isinstance(X, np.ndarray) and X.dtype.kind in "fi" and X.shape == (4, 4)
        if not (sized and np.isfinite(X).all()):
            got = shown(X.tolist() if isinstance(X, np.ndarray) else X)
            raise InputError("Obstacle", "X_WO", got, "a pose: an array (4, 4) of finite numbers")

    def contains(self, points: FloatArray) -> BoolArray:
        """Return which points (N, 3), m, in W lie in it, (N,); none is said to lie in a mesh."""
        local = (points - self.X_WO[:3, 3]) @ self.X_WO[:3, :3]
        aside, above = np.hypot(local[:, 0], local[:, 1]), np.abs(local[:, 2])
        match self.shape:
            case Box(size=size):
                return np.asarray((np.abs(local) < 0.5 * np.array(size)).all(axis=1))
            case Cylinder(radius=radius, length=length):
                return np.asarray((aside < radius) & (above < 0.5 * length))
            case Capsule(radius=radius, length=length):
                return np.asarray(np.hypot(aside, np.maximum(above - 0.5 * length, 0.0)) < radius)
            case Sphere(radius=radius):
                return np.asarray(np.hypot(aside, above) < radius)
            case Mesh():
                return np.zeros(len(points), dtype=np.bool_)


def _require_scale(scale: object, kind: str) -> None:
    is_number = isinstance(scale, (int, float)) and not isinstance(scale, bool)
    if not (is_number and LEAST_SCALE <= cast("float", scale) <= MOST_SCALE):
        raise InputError(kind, "scale", shown(scale), f"a number from {LEAST_SCALE:g} to {MOST_SCALE:g}")
