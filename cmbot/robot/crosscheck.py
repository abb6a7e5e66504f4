"""A second opinion on a robot's kinematics: yourdfpy reads the same URDF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yourdfpy

from cmbot.common.errors import ModelError
from cmbot.robot.kinematics import Kinematics
from cmbot.robot.robot import Robot

__all__ = ["kinematics_difference"]

_POSTURES = 20
_SEED = 20211115


def kinematics_difference(robot: Robot) -> float:
    """Compare tool poses, relative to the arm's base frame, between pinocchio and yourdfpy.

    Parameters
    ----------
    robot : Robot
        Loaded without a changed tool length.

    Returns
    -------
    float
        Largest difference of an entry of the (4, 4) poses over 20 random postures, m or 1.

    Raises
    ------
    ModelError
        When yourdfpy cannot read the URDF.
    """
    other = _load(robot.urdf)
    model = robot.model
    base = model.frames[model.getFrameId(robot.base_frame)].placement
    lower, upper = np.maximum(robot.limits.lower, -np.pi), np.minimum(robot.limits.upper, np.pi)
    kinematics, rng = Kinematics(robot), np.random.default_rng(_SEED)
    worst = 0.0
    for q in rng.uniform(lower, upper, (_POSTURES, robot.dof)):
        X_BT = base.inverse() * kinematics.tool_pose(q)
        other.update_cfg(dict(zip(robot.joints, q, strict=True)))
        theirs = other.get_transform(robot.tool_frame, robot.base_frame)
        worst = max(worst, float(np.abs(X_BT.homogeneous - theirs).max()))
    return worst


def _load(urdf: Path) -> yourdfpy.URDF:
    try:
        return yourdfpy.URDF.load(
            str(urdf), build_scene_graph=True, load_meshes=False, load_collision_meshes=False
        )
    except (ValueError, OSError, KeyError, AttributeError, TypeError) as error:
        raise ModelError(str(urdf), "", f"a file that yourdfpy refuses ({error})", "a URDF") from error
