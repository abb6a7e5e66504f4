"""Mounts: where the base frame of an arm may be held, among which `cmbot stand` chooses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field

from cmbot.common.arrays import FloatArray
from cmbot.common.reading.fields import Angles, LongVector, OneOf, Slug, Vector
from cmbot.common.reading.validation import FileModel
from cmbot.scene.base.matrices import Stiffness6
from cmbot.scene.robot_entry import MountFile

_Count = Annotated[int, Field(ge=1, le=1000)]


class MountGridFile(FileModel):
    """Positions over a parallelogram."""

    origin: Vector
    """Its first corner, m."""
    u: LongVector
    """From there along one side, m."""
    v: LongVector
    """And along the other one, m."""
    count: tuple[_Count, _Count]
    """Positions along both, the ends among them."""

    @property
    def points(self) -> Iterator[FloatArray]:
        """Positions (3,), m."""
        along, across = (np.linspace(0.0, 1.0, number) for number in self.count)
        for s in along:
            for t in across:
                yield np.array(self.origin) + s * np.array(self.u) + t * np.array(self.v)


class MountRailFile(FileModel):
    """Positions along a straight rail."""

    origin: Vector
    """Where it begins, m."""
    along: LongVector
    """From there to its end, m."""
    count: _Count
    """Positions, the ends among them."""

    @property
    def points(self) -> Iterator[FloatArray]:
        """Positions (3,), m."""
        for s in np.linspace(0.0, 1.0, self.count):
            yield np.array(self.origin) + s * np.array(self.along)


class MountsFile(OneOf):
    """One pose of the base frame, or several by a grid or a rail, and how what it stands on bends."""

    one_of = ("xyz", "grid", "rail")

    name: Slug = "mount"
    """What messages and tables call it."""
    xyz: Vector | None = None
    """Position of the base frame, m."""
    grid: MountGridFile | None = None
    """Positions over an area."""
    rail: MountRailFile | None = None
    """Positions along a line."""
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of the base frame, as in URDF."""
    stiffness: Stiffness6 | None = None
    """6 x 6 stiffness at the origin of the base frame along the axes of W, linear then angular (N/m, N/rad,
    Nm/rad), or the 6 numbers of its diagonal; left out: rigid."""

    @property
    def each(self) -> Iterator[MountFile]:
        """The poses."""
        several = self.grid or self.rail
        for point in [self.xyz] if several is None else (tuple(point.tolist()) for point in several.points):
            yield MountFile.model_validate({"xyz": point, "rpy_deg": self.rpy_deg})
