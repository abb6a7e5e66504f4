"""Timed paths of the tool: curves, time laws, legs and rows over surfaces that make them."""

from cmbot.toolpath.builder import timed_path as timed_path
from cmbot.toolpath.curves import Curve as Curve, Line as Line, Spline as Spline
from cmbot.toolpath.legs import (
    AUTO as AUTO,
    ArcTo as ArcTo,
    Goal as Goal,
    Leg as Leg,
    SecondsOrAuto as SecondsOrAuto,
    Speed as Speed,
    ViaPoints as ViaPoints,
)
from cmbot.toolpath.path_source import PathSource as PathSource
from cmbot.toolpath.raster.face_rows import FaceSurface as FaceSurface
from cmbot.toolpath.raster.raster import (
    CylinderPatch as CylinderPatch,
    FaceSelection as FaceSelection,
    Raster as Raster,
    RowPiece as RowPiece,
    cells_of as cells_of,
    without as without,
)
from cmbot.toolpath.raster.surface import (
    Coverage as Coverage,
    PlainSurface as PlainSurface,
    Surface as Surface,
)
from cmbot.toolpath.shaper import (
    Shaper as Shaper,
    extra_insensitive as extra_insensitive,
    two_hump as two_hump,
)
from cmbot.toolpath.stretches import (
    SAME_PLACE as SAME_PLACE,
    distinct as distinct,
    merged as merged,
    waypoint_poses as waypoint_poses,
)
from cmbot.toolpath.time_law import LegLaw as LegLaw, SpeedProfile as SpeedProfile, TimeLaw as TimeLaw
from cmbot.toolpath.tool_path import (
    Segment as Segment,
    ToolPath as ToolPath,
    share_out_segments as share_out_segments,
)
from cmbot.toolpath.tool_poses import ToolPoses as ToolPoses, shortest_turns as shortest_turns
