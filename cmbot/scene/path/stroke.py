"""A timed path with the tool on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import remedy_for
from cmbot.scene.path.path_file import StrokeFile
from cmbot.scene.path.tool_path import ToolPath
from cmbot.scene.raster.face_rows import FaceRows

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
    via_points : int
        In all, with the ends of the legs.
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
    via_points: int
    begins_elsewhere: bool
    coverage: FaceRows | None = None

    @property
    def areas(self) -> tuple[float, float] | None:
        """Area, m2, of the surface that a raster goes over, and what of it its rows leave out; else None.

        A place is left out where it is further than half the distance of two rows from all of them, or beyond
        their ends. Rows over rectangles and cylinders leave nothing out.
        """
        if self.coverage is not None:
            return self.coverage.area, self.coverage.left_out
        return None if self.file.raster is None else (self.file.raster.area, 0.0)

    @cached_property
    def via_times(self) -> FloatArray:
        """Times of its via-points (k,), s."""
        return self.path.via_times(self.via_points)

    def leg_key(self, leg: int) -> str:
        """Return the key of a leg of the timed path, as far as it has one of its own."""
        if not self.file.legs:
            return f"{self.key}.waypoints" if self.file.raster is None else f"{self.key}.raster"
        return f"{self.key}.legs" if self.file.blend_radius_m else f"{self.key}.legs[{self._in_file(leg)}]"

    def asked_speed(self, leg: int) -> float | None:
        """Return the speed, m/s, that the scene asks for on a leg of the timed path; None: seconds."""
        if not self.file.legs:
            return self.file.speed_m_s
        # What is blended has one time law for several legs.
        return None if self.file.blend_radius_m else self.file.legs[self._in_file(leg)].speed_m_s

    @property
    def more_time(self) -> str:
        """What gives the joints more time along it, by the keys that it has in the scene."""
        if not self.file.legs:
            return (
                f"more {self.key}.seconds" if self.file.speed_m_s is None else f"a lower {self.key}.speed_m_s"
            )
        moving = [leg for leg in self.file.legs if leg.pause is None]
        fast = sum(leg.speed_m_s is not None for leg in moving)
        more = {0: "more seconds", len(moving): "lower speeds"}.get(fast, "more seconds or lower speeds")
        return f"{more} in {self.key}.legs"

    def remedy_for(self, constraint: str) -> str:
        """Return what most often helps where a constraint cannot be kept, by the keys of the scene."""
        is_smooth = self.file.speed_profile.kind == "jerk_limited"
        smoother = "" if is_smooth else f", or {self.key}.speed_profile.kind jerk_limited,"
        return remedy_for(constraint, path=self.key, more_time=self.more_time, smoother=smoother)

    def _in_file(self, leg: int) -> int:
        """The number in the file of a leg of the timed path, which may go back and in passes."""
        legs = len(self.file.legs)
        number, at = divmod(leg, legs)
        return legs - 1 - at if (number % 2 == 1) != self.file.backwards else at
