"""What a path is made of: its description, where that is, and the frames of its poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.reading.validation import shown
from cmbot.toolpath.legs import Goal, Leg
from cmbot.toolpath.raster.raster import Raster
from cmbot.toolpath.time_law import SpeedProfile


class PathDescription(Protocol):
    """Legs, waypoints or a raster, and how they are timed: with the units of a scene's ``tool_path``."""

    legs: tuple[Leg, ...]
    """From where the path begins, each from rest to rest."""
    waypoints: tuple[tuple[float, ...], ...] | None
    """In place of legs waypoints: x, y, z, qw, qx, qy, qz in W."""
    corner_deg: float
    """Where waypoints bend by more the tool may rest."""
    raster: Raster | None
    """In place of legs rows over a surface."""
    start_pose: Goal | None
    """Where the legs begin, in place of the tool's pose before."""
    blend_radius_m: float | None
    """By which corners are rounded, m."""
    seconds: float | Literal["auto"] | None
    """Duration of the waypoints or of the raster, s."""
    speed_m_s: float | None
    """In place of that the speed at which the tool cruises, m/s."""
    speed_tolerance: float | None
    """By what share the tool's speed may miss that of the process."""
    lead_in_m: float | None
    """Length of the lead before the path, m."""
    lead_out_m: float | None
    """Length of the lead behind it, m."""
    speed_profile: SpeedProfile
    """Of every leg."""

    @property
    def kept(self) -> str:
        """What of the tool's orientation counts: ``pose``, ``axis`` or ``position``."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PathSource:
    """Where a path is described, and the frames in which its poses are.

    Attributes
    ----------
    source, key : str
        The scene's, and the path's in it, for messages.
    frames : mapping of str to (4, 4)
        Poses in W of the frames that the scene names.
    on_part : bool
        The path is that of a fixed tool, in the frame of the part that the arm holds.
    max_speed : float or None
        Of the tool point, m/s: seconds that are to be found begin slower.
    deviation, rotation : float, m and rad
        Of the tool from its path at most.
    """

    source: str
    key: str
    frames: Mapping[str, FloatArray]
    on_part: bool = False
    max_speed: float | None = None
    deviation: float = 1e-3
    rotation: float = 1e-2

    def frame(self, name: str, key: str, X_WT: FloatArray) -> FloatArray:
        """Return the pose (4, 4) in W of the frame that `key` names; ``tool`` is `X_WT`.

        Raises
        ------
        SceneError
            When there is no such frame.
        """
        frames = {"world": np.eye(4), "tool": X_WT, **self.frames}
        if name not in frames:
            expected = "a frame of the scene"
            if self.on_part:
                expected = (
                    "no frame, for that of the part, or tool: beside tool.fixed the path is on the part"
                )
            raise SceneError(self.source, f"{key}.frame", shown(name), expected, tuple(frames))
        return frames[name]
