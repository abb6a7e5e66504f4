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
