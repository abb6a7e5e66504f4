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


def wavy_sheet(number: int = 24) -> trimesh.Trimesh:
    """A sheet without thickness, 0.6 m x 0.4 m, in waves of 40 mm, with a hole of 80 mm in its middle."""
    x, y = np.meshgrid(np.linspace(-0.3, 0.3, number + 1), np.linspace(-0.2, 0.2, number + 1), indexing="ij")
    height = 0.02 * np.sin(12 * x) * np.cos(9 * y)
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    points = np.stack([x, y, height], -1).reshape(-1, 3)
    outside = (np.linalg.norm(points[faces][:, :, :2], axis=2) >= 0.04).all(axis=1)
    return trimesh.Trimesh(points, faces[outside])


def raster_scene(
    folder: Path, solid: trimesh.Trimesh, more: dict[str, Any] | None = None, **raster: Any
) -> Scene:
    """Its obstacle is in the frame of the raster; what is None is left out of the raster."""
    file = folder / "part.stl"
    file.write_bytes(solid.export(file_type="stl"))
    data = copy.deepcopy(SECOND)
    data["tool_path"] = {"via_points": 300, **(more or {"speed_m_s": 0.1})}
    data["tool_path"]["raster"] = {k: v for k, v in {**RASTER, **raster}.items() if v is not None}
    data["obstacles"] = [{"name": "part", "mesh": str(file), **data["frames"]["bracket"]}]
    return load_scene(data)
