"""Obstacles as a scene file describes them."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, cast

import numpy as np
from pydantic import Field

from cmbot.collision import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere
from cmbot.collision.obstacles import LEAST_SCALE, MOST_SCALE
from cmbot.common.poses import pose
from cmbot.common.reading.fields import LONGEST, SHORTEST, Angles, FilePath, OneOf, Slug, Vector
from cmbot.common.reading.validation import refusal
from cmbot.scene.robot_entry import MountFile

# As it is written; in metres it has the bounds of `Length`.
_Written = Annotated[float, Field(ge=0, le=LONGEST / LEAST_SCALE)]


class ObstacleFile(OneOf):
    """An obstacle: exactly one shape, placed in W or in a workpiece's frame."""

    one_of = ("box", "cylinder", "capsule", "sphere", "mesh")

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
    frame: Slug | None = None
    """Of a workpiece, with which it moves; left out: it is placed in W."""
    xyz: Vector
    """Centre (of a mesh: its origin) in its frame, m."""
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw as in URDF."""
    workpiece: bool = False
    """The tool works on it, up to the safety margin."""
    scale: Annotated[float, Field(ge=LEAST_SCALE, le=MOST_SCALE)] | None = None
    """Factor that makes metres of the numbers of its shape, or of its mesh file: 0.001 where they are
    millimetres. ``xyz`` is in metres anyway. 1 says that an obstacle is meant to be as large and as far away
    as it is."""

    def _check(self) -> None:
        super()._check()
        for index, number in enumerate(self.in_metres):
            if not SHORTEST <= number <= LONGEST:
                written = np.atleast_1d(getattr(self, self.given)).tolist()[index]
                got = f"{written}" if self.scale is None else f"{written} times scale {self.scale:g}"
                bound = f"at least {SHORTEST:g}" if number < SHORTEST else f"at most {LONGEST:g}"
                key = (self.given,) if self.given == "sphere" else (self.given, index)
                raise refusal(bound, got=got, key=key)

    @property
    def in_metres(self) -> list[float]:
        """The numbers of its shape, m; of a mesh there are none."""
        if self.mesh is not None:
            return []
        unit = 1.0 if self.scale is None else self.scale
        return [unit * number for number in np.atleast_1d(getattr(self, self.given)).tolist()]


@lru_cache(maxsize=1024)
def obstacle_from_file(file: ObstacleFile, frame: MountFile | None = None) -> Obstacle:
    """Return the obstacle that an entry of a scene file describes; its mesh has an absolute path.

    `frame` is the pose in W of the frame that the entry names.
    """
    shape: Shape
    match file.given, file.in_metres:
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
    X_FO = pose(file.xyz, np.radians(file.rpy_deg))
    X_WO = X_FO if frame is None else frame.matrix @ X_FO
    return Obstacle(name=file.name, shape=shape, X_WO=X_WO, workpiece=file.workpiece, scale=file.scale)
