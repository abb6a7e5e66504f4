"""A timed path with the tool on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from cmbot.common.arrays import FloatArray
from cmbot.scene.path.face_rows import FaceRows
from cmbot.scene.path.path_file import StrokeFile
from cmbot.scene.path.tool_path import ToolPath

__all__ = ["Stroke"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Stroke:
    """A path with the tool on.

    Attributes
    ----------
    name : str
    key : str
        Of its description in the scene file.
    file : StrokeFile
        Its description.
    path : ToolPath
    begins_elsewhere : bool
        Whether the arm has to be brought to its start: not the first one from the tool's pose in the scene's
        posture.
    coverage : FaceRows or None
        Of a raster over faces of a mesh.
    """

    name: str
    key: str
    file: StrokeFile
    path: ToolPath
    begins_elsewhere: bool
    coverage: FaceRows | None = None

    @cached_property
    def via_times(self) -> FloatArray:
        """Times of its via-points (k,), s."""
        return self.path.via_times(self.file.via_points)

    def leg_key(self, leg: int) -> str:
        """Return the key of a leg of the timed path, as far as it has one of its own."""
        if not self.file.legs:
            return f"{self.key}.waypoints" if self.file.raster is None else f"{self.key}.raster"
        legs = len(self.file.legs)
        number, at = divmod(leg, legs)
        if (number % 2 == 1) != self.file.backwards:
            at = legs - 1 - at
        return f"{self.key}.legs[{at}]" if self.file.blend_radius_m is None else f"{self.key}.legs"
