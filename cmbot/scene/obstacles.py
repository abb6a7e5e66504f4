"""Obstacles: their shapes and poses, in the scene and in its file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Self, cast

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.errors import InputError
from cmbot.common.representation import short_repr
from cmbot.common.validation import CheckedFields, FileModel, refusal, require_type, shown
from cmbot.scene.fields import (
    LONGEST,
    SHORTEST,
    Angles,
    Length,
    Slug,
    Vector,
    exactly_one,
    given_of,
    one_of_schema,
)
from cmbot.scene.files import FilePath

_SHAPES = ("box", "cylinder", "capsule", "sphere", "mesh")
# From micrometres to kilometres, m.
_LEAST_SCALE, _MOST_SCALE = 1e-6, 1e3
# As it is written; in metres it has the bounds of `Length`.
_Written = Annotated[float, Field(ge=0, le=LONGEST / _LEAST_SCALE)]


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
    scale : float or None, m
        The unit of the shape's dimensions in the scene file; `shape` has them in metres. Where one is given
        they are meant, however large.
    """

    name: str
    shape: Shape
    X_WO: FloatArray
    workpiece: bool = False
    scale: float | None = None

    __repr__ = short_repr

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


def _require_scale(scale: object, kind: str) -> None:
    is_number = isinstance(scale, (int, float)) and not isinstance(scale, bool)
    if not (is_number and _LEAST_SCALE <= cast("float", scale) <= _MOST_SCALE):
        raise InputError(kind, "scale", shown(scale), f"a number from {_LEAST_SCALE:g} to {_MOST_SCALE:g}")


class ObstacleFile(FileModel):
    """An obstacle: exactly one shape, placed in W."""

    model_config = ConfigDict(json_schema_extra=one_of_schema(_SHAPES))

    name: Slug
    box: tuple[_Written, _Written, _Written] | None = None
    """Edge lengths along its x, y, z, m."""
    cylinder: tuple[_Written, _Written] | None = None
    """[radius, length along z], m."""
    capsule: tuple[_Written, _Written] | None = None
    """[radius, length along z between the centres of its two half spheres], m."""
    sphere: _Written | None = None
    """Radius, m."""
    mesh: FilePath | None = None
    """Path of a mesh file, relative to the scene file; in metres without `scale`."""
    xyz: Vector
    """Centre (of a mesh: its origin) in W, m."""
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw as in URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    workpiece: bool = False
    """The tool works on it, so it may come close."""
    scale: Annotated[float, Field(ge=_LEAST_SCALE, le=_MOST_SCALE)] | None = None
    """Factor that makes metres of the numbers of its shape, or of its mesh file: 0.001 where they are
    millimetres. ``xyz`` is in metres anyway. 1 says that an obstacle is meant to be as large and as far away
    as it is."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        exactly_one(self, _SHAPES)
        for index, number in enumerate(self.in_metres):
            if not SHORTEST <= number <= LONGEST:
                written = np.atleast_1d(getattr(self, self.kind)).tolist()[index]
                got = f"{written}" if self.scale is None else f"{written} times scale {self.scale:g}"
                bound = f"at least {SHORTEST:g}" if number < SHORTEST else f"at most {LONGEST:g}"
                key = (self.kind,) if self.kind == "sphere" else (self.kind, index)
                raise refusal(bound, got=got, key=key)
        return self

    @property
    def kind(self) -> str:
        """The key that has its shape."""
        return given_of(self, _SHAPES)[0]

    @property
    def in_metres(self) -> list[float]:
        """The numbers of its shape, m; of a mesh there are none."""
        if self.mesh is not None:
            return []
        unit = 1.0 if self.scale is None else self.scale
        return [unit * number for number in np.atleast_1d(getattr(self, self.kind)).tolist()]


@lru_cache(maxsize=1024)
def obstacle_from_file(file: ObstacleFile) -> Obstacle:
    """Return the obstacle that an entry of a scene file describes; its mesh has an absolute path."""
    shape: Shape
    match file.kind, file.in_metres:
        case "box", (x, y, z):
            shape = Box(size=(x, y, z))
        case "cylinder", (radius, length):
            shape = Cylinder(radius=radius, length=length)
        case "capsule", (radius, length):
            shape = Capsule(radius=radius, length=length)
        case "sphere", (radius,):
            shape = Sphere(radius=radius)
        case _:
            shape = Mesh(path=Path(cast("str", file.mesh)), scale=1.0 if file.scale is None else file.scale)
    X_WO = pose(file.xyz, np.radians(file.rpy_deg))
    return Obstacle(name=file.name, shape=shape, X_WO=X_WO, workpiece=file.workpiece, scale=file.scale)


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
