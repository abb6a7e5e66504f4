"""A second opinion on the moves of a walk, from the robot's files."""

from __future__ import annotations

from cmbot.planning import Check
from cmbot.planning.verification.described_arm import DescribedArm
from cmbot.planning.verification.second_opinion import judged_motion
from cmbot.robot import ARM_JOINTS, robot_files
from cmbot.scene import Scene
from cmbot.stances import scene_at
from cmbot.stances.walking.steps import Move


def second_opinion_of(move: Move, scene: Scene) -> tuple[Check, ...]:
    """Compute again what a move's certificate stands on: see `cmbot.planning.verification`.

    Parameters
    ----------
    move : Move
    scene : Scene
        In which it is made, as `cmbot.stances.in_world` returns it.
    """
    robot, obstacles, margin = move.robot, scene.all_obstacles, scene.planner.safety_margin_m
    if move.kind == "arm":
        arm = DescribedArm.of(scene_at(scene, move.node, move.arm), robot)
    else:
        srdf, limits = (robot.urdf.with_name(name) for name in ("climbing.srdf", "joint_limits.yaml"))
        arm = DescribedArm.in_files(
            robot_files(robot.urdf, srdf=srdf, limits=limits),
            robot,
            carrier="tool0",
            X_WR=move.node.foot_pose(move.holds[0]),
            locked=dict(zip(ARM_JOINTS, move.arm.tolist(), strict=True)),
            tool_length=scene.robot.tool_length_m,
            payload=scene.robot.payload_kg,
        )
    return judged_motion(arm, robot, obstacles, move.segment.trajectory, margin)
