"""Timed paths of the tool: curves, time laws, legs and rows over surfaces that make them."""

from cmbot.toolpath.builder import timed_path
from cmbot.toolpath.curves import Arc, Blend, Curve, Line, Rolled, Spline
from cmbot.toolpath.legs import AUTO, ArcTo, Goal, Leg, SecondsOrAuto, Speed, ViaPoints
from cmbot.toolpath.path_source import PathDescription, PathSource
from cmbot.toolpath.raster.face_rows import FaceSurface
from cmbot.toolpath.raster.pieces import RowPiece, cells_of, without
from cmbot.toolpath.raster.raster import CylinderPatch, FaceSelection, Raster
from cmbot.toolpath.raster.surface import Coverage, PlainSurface, Surface
from cmbot.toolpath.shaper import Shaper, extra_insensitive, two_hump
from cmbot.toolpath.stretches import SAME_PLACE, distinct, merged, waypoint_poses
from cmbot.toolpath.time_law import LegLaw, SpeedProfile, TimeLaw
from cmbot.toolpath.tool_path import Segment, ToolPath, share_out_segments
from cmbot.toolpath.tool_poses import ToolPoses, shortest_turns

__all__ = [
    "AUTO",
    "SAME_PLACE",
    "Arc",
    "ArcTo",
    "Blend",
    "Coverage",
    "Curve",
    "CylinderPatch",
    "FaceSelection",
    "FaceSurface",
    "Goal",
    "Leg",
    "LegLaw",
    "Line",
    "PathDescription",
    "PathSource",
    "PlainSurface",
    "Raster",
    "Rolled",
    "RowPiece",
    "SecondsOrAuto",
    "Segment",
    "Shaper",
    "Speed",
    "SpeedProfile",
    "Spline",
    "Surface",
    "TimeLaw",
    "ToolPath",
    "ToolPoses",
    "ViaPoints",
    "cells_of",
    "distinct",
    "extra_insensitive",
    "merged",
    "share_out_segments",
    "shortest_turns",
    "timed_path",
    "two_hump",
    "waypoint_poses",
    "without",
]
