"""Obstacles: their shapes and poses, in the scene and in its file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, model_validator
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.errors import InputError
from cmbot.common.representation import short_repr
from cmbot.common.validation import CheckedFields, FileModel, plain, require_type, shown
from cmbot.scene.fields import Angles, Length, Slug, Text, Vector, exactly_one, one_of_schema

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "Mesh",
    "Obstacle",
    "ObstacleFile",
    "Shape",
    "Sphere",
    "obstacle_data",
    "obstacle_from_file",
    "pose",
]

_SHAPES = ("box", "cylinder", "capsule", "sphere", "mesh")


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
    """

    name: str
    shape: Shape
    X_WO: FloatArray
    workpiece: bool = False

    __repr__ = short_repr

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


class ObstacleFile(FileModel):
    """An obstacle: exactly one shape, placed in W."""

    model_config = ConfigDict(json_schema_extra=one_of_schema(_SHAPES))

    name: Slug
    box: tuple[Length, Length, Length] | None = None
    """Edge lengths along its x, y, z, m."""
    cylinder: tuple[Length, Length] | None = None
    """[radius, length along z], m."""
    capsule: tuple[Length, Length] | None = None
    """[radius, length along z between the centres of its two half spheres], m."""
    sphere: Length | None = None
    """Radius, m."""
    mesh: Text | None = None
    """Path of a mesh file in metres, relative to the scene file."""
    xyz: Vector
    """Centre (of a mesh: its origin) in W, m."""
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw as in URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    workpiece: bool = False
    """The tool works on it, so it may come close."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, _SHAPES)
        return self


def obstacle_from_file(file: ObstacleFile, key: str, find: Callable[[str, str], Path]) -> Obstacle:
    """Return the obstacle that an entry of a scene file describes; `find` gives the path of a file."""
    shape: Shape
    if file.box is not None:
        shape = Box(size=file.box)
    elif file.cylinder is not None:
        shape = Cylinder(radius=file.cylinder[0], length=file.cylinder[1])
    elif file.capsule is not None:
        shape = Capsule(radius=file.capsule[0], length=file.capsule[1])
    elif file.sphere is not None:
        shape = Sphere(radius=file.sphere)
    else:
        mesh = cast("str", file.mesh)  # `_check` lets exactly one through
        shape = Mesh(path=find(mesh, f"{key}.mesh"))
    X_WO = pose(file.xyz, np.radians(file.rpy_deg))
    return Obstacle(name=file.name, shape=shape, X_WO=X_WO, workpiece=file.workpiece)


def obstacle_data(obstacle: Obstacle, entry: ObstacleFile | None) -> dict[str, Any]:
    """Return the file's entry of an obstacle; its numbers as they stand there, where they are the same."""
    X = obstacle.X_WO
    xyz, rpy_deg = X[:3, 3].tolist(), Rotation.from_matrix(X[:3, :3]).as_euler("xyz", degrees=True).tolist()
    if entry is not None and np.array_equal(pose(entry.xyz, np.radians(entry.rpy_deg)), X):
        xyz, rpy_deg = entry.xyz, entry.rpy_deg
    data = {"name": obstacle.name, "xyz": xyz, "rpy_deg": rpy_deg, "workpiece": obstacle.workpiece}
    match obstacle.shape:
        case Box(size=size):
            return data | {"box": plain(size, "Box")}
        case Cylinder(radius=radius, length=length):
            return data | {"cylinder": plain([radius, length], "Cylinder")}
        case Capsule(radius=radius, length=length):
            return data | {"capsule": plain([radius, length], "Capsule")}
        case Sphere(radius=radius):
            return data | {"sphere": plain(radius, "Sphere")}
        case Mesh(path=path):
            text = entry.mesh if entry is not None else None
            return data | {"mesh": text if text and Path(text).name == path.name else str(path)}


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
    return read_only(X)
