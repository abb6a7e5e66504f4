"""Copies of the shipped robot's files, changed and loaded by the tests."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.robot import Robot, load_robot


def pose(rpy: tuple[float, float, float], xyz: tuple[float, float, float]) -> Any:
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def load_copy(folder: Path, **options: Any) -> Robot:
    return load_robot(folder / "cmbot.urdf", **{"base_frame": "arm_base", "tool_frame": "tool0", **options})


def replace(file: Path, old: str, new: str, count: int = -1) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, count), encoding="utf-8")


# Vertices of meshes without volume.
FLAT: dict[str, list[list[float]]] = {
    "flat": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]],
    "tilted": [[0, 0, 0], [1, 0, 0.25], [0, 1, 0.5], [1, 1, 0.75]],
    "tilted by odd angles": [[0, 0, 0], [1, 0.1, 0.3], [0.2, 1, 0.7], [1.2, 1.1, 1.0]],
    "nearly flat": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1e-9]],
    "nearly flat, tilted": [[0, 0, 0], [1, 0, 0.25], [0, 1, 0.5], [1, 1, 0.75 + 3e-8]],
    "a line": [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]],
    "one triangle": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
}


def write_flat_obj(file: Path, vertices: list[list[float]]) -> None:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + ["f 1 2 3"] + ["f 2 3 4"] * (len(vertices) > 3)
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
