"""Scenes with a raster over the faces of a mesh."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from timed_paths import SECOND

from cmbot import load_scene
from cmbot.scene import Scene

SPACING, STAND_OFF, OVERSCAN = 0.05, 0.1, 0.02
RASTER = {
    "mesh": "part",
    "faces": {"normal": [0, 0, 1]},
    "along": [1, 0, 0],
    "spacing_m": SPACING,
    "stand_off_m": STAND_OFF,
    "overscan_m": OVERSCAN,
    "frame": "bracket",
}


def prism(outline: list[tuple[float, float]]) -> trimesh.Trimesh:
    """A plate of 10 mm whose upper face, at z = 0, is a convex polygon."""
    corners = np.array(outline)
    points = np.vstack([np.column_stack([corners, np.full(len(corners), z)]) for z in (-0.01, 0.0)])
    return trimesh.convex.convex_hull(points)


HOLE = trimesh.util.concatenate([prism([(x, 0), (x + 0.1, 0), (x + 0.1, 0.2), (x, 0.2)]) for x in (0, 0.13)])


def raster_scene(
    folder: Path, solid: trimesh.Trimesh, more: dict[str, Any] | None = None, **raster: Any
) -> Scene:
    """Its obstacle is in the frame of the raster."""
    file = folder / "part.stl"
    file.write_bytes(solid.export(file_type="stl"))
    data = copy.deepcopy(SECOND)
    data["tool_path"] = {"via_points": 300, "raster": {**RASTER, **raster}, **(more or {"speed_m_s": 0.1})}
    data["obstacles"] = [{"name": "part", "mesh": str(file), **data["frames"]["bracket"]}]
    return load_scene(data)
