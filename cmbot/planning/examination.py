"""A look at a scene before it is planned."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.planning.setting import robot_of, task_of
from cmbot.robot import Dynamics, Kinematics
from cmbot.scene import Scene
from cmbot.scene.clearance import Clearances
from cmbot.validation import counted

__all__ = ["examine_scene"]


def examine_scene(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield what a scene asks for and how it begins, as names and values with units.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    """
    robot = robot_of(scene)
    task = task_of(scene, robot)
    yield "scene", f"{scene.name} ({scene.source})"
    joints, legs = counted(robot.dof, "joint"), counted(len(scene.legs), "leg")
    yield "robot", f"{robot.name}: {joints}, {robot.mass:.2f} kg ({robot.arm_mass:.2f} kg moving)"
    path = task.path
    yield (
        "tool path",
        f"{legs}, {path.lengths.sum():.3f} m in {path.duration:g} s, keeps the tool's {scene.keep}",
    )
    yield "via-points", str(len(path.via_times(scene.via_points)))
    workpieces = counted(sum(obstacle.workpiece for obstacle in scene.obstacles), "workpiece")
    yield "obstacles", f"{len(scene.obstacles)}, of them {workpieces}"
    q = scene.posture
    point = ", ".join(f"{x:.4f}" for x in path.corners[0])
    yield "tool point at the start", f"({point}) m"
    clearances = Clearances(robot, scene.obstacles)
    smallest = clearances.smallest(q[None])
    if smallest.pair[0] >= 0:
        pair = clearances.pairs[smallest.pair[0]]
        yield "clearance at the start", f"{smallest.distance[0]:.4f} m ({pair.link} to {pair.other})"
    X_WT, J = Kinematics(robot).tool_jacobian(q)
    yield "smallest singular value there", f"{task.smallest_singular_value(X_WT, J):.4f}"
    efforts = Dynamics(robot).static_efforts(q[None])
    share = np.abs(efforts.joint_torque[0]) / robot.limits.torque
    yield "torque on the guardrail there", f"{np.linalg.norm(efforts.guardrail_torque):.2f} Nm"
    yield "largest joint torque there", f"{share.max():.2f} of the bound of {robot.joints[share.argmax()]}"
