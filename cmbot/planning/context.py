"""From a scene to what planning works on: the robot, its task, what is around."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cmbot.collision.clearance import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ModelError, SceneError
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.sag import Sag
from cmbot.elastic.tool_sag import ToolSag
from cmbot.planning.path.task import ToolTask
from cmbot.planning.progress import ProgressReporter
from cmbot.planning.torque.objectives import Objective, objective_of
from cmbot.planning.torque.wrench_functions import WrenchFunction
from cmbot.robot import Kinematics, Robot, load_robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.scene.obstacles import pose
from cmbot.scene.tool_path import ToolPath

__all__ = ["PlanningContext", "bending_arm", "build_context", "robot_of", "sag_of", "task_of"]


@dataclass(frozen=True, kw_only=True)
class PlanningContext:
    """What every stage of planning needs.

    Attributes
    ----------
    robot : Robot
    posture : (n,), rad
        The scene's.
    task : ToolTask
    clearances : Clearances
    times : (k,), s
        Of the via-points.
    options : PlannerOptions
    objective : Objective
        What is made small.
    arm : ElasticArm or None
        The arm on its guardrail as it bends; None where nothing does.
    sag : ToolSag or None
        Where it is to be compensated.
    teller : ProgressReporter
        What is told of the work while it goes on.
    """

    robot: Robot
    posture: FloatArray
    task: ToolTask
    clearances: Clearances
    times: FloatArray
    options: PlannerOptions
    objective: Objective
    arm: ElasticArm | None
    sag: ToolSag | None
    reporter: ProgressReporter = field(default_factory=ProgressReporter)


def build_context(
    scene: Scene,
    options: PlannerOptions,
    own: WrenchFunction | None = None,
    reporter: ProgressReporter | None = None,
) -> PlanningContext:
    """Bring a scene and its robot together.

    Parameters
    ----------
    scene : Scene
    options : PlannerOptions
    own : WrenchFunction, optional
        What is made small, in place of what the options say.
    teller : ProgressReporter, optional
        Of the work that will be done; by default nobody is told.

    Raises
    ------
    SceneError, ModelError
        When they do not fit together.
    InputError
        When `own` is no function of the wrench.
    """
    robot = robot_of(scene)
    task = task_of(scene, robot)
    posture = np.array(scene.posture)
    arm = bending_arm(scene, robot)
    sag = sag_of(scene, arm, options)
    return PlanningContext(
        robot=robot,
        posture=posture,
        task=task,
        clearances=Clearances(robot, scene.obstacles),
        times=task.path.via_times(scene.via_points),
        options=options,
        objective=objective_of(robot, options, own, posture, sag),
        arm=arm,
        sag=sag if options.compensate else None,
        reporter=reporter or ProgressReporter(),
    )


def bending_arm(scene: Scene, robot: Robot) -> ElasticArm | None:
    """Return a scene's arm on its guardrail as it bends; None where nothing does."""
    arm = elastic_arm(robot, elastic_base(scene.guardrail))
    return arm if len(arm.elastic) else None


def sag_of(scene: Scene, arm: ElasticArm | None, options: PlannerOptions) -> ToolSag | None:
    """Return the predicted sag of the tool where the options need it.

    Parameters
    ----------
    scene : Scene
    arm : ElasticArm or None
        From `bending_arm`.
    options : PlannerOptions

    Raises
    ------
    SceneError
        When they need it, and nothing bends.
    """
    if not (options.compensate or options.objective == "sag"):
        return None
    if arm is None:
        raise SceneError(
            scene.source,
            "guardrail",
            "no guardrail, and a robot without link tubes",
            "something that bends: guardrail.bays, guardrail.stiffness or robot.elasticity",
        )
    return ToolSag(Sag(arm))


def robot_of(scene: Scene) -> Robot:
    """Load the robot that a scene names.

    Raises
    ------
    ModelError
        When its files cannot be used.
    SceneError
        When the scene names a frame that is none of its robot's.
    """
    source = scene.robot
    mount = None
    if source.mount_xyz is not None and source.mount_rpy is not None:
        mount = pose(source.mount_xyz, source.mount_rpy)
    try:
        return load_robot(
            source.model,
            base_frame=source.base_frame,
            tool_frame=source.tool_frame,
            limits=source.limits,
            srdf=source.srdf,
            elasticity=source.elasticity,
            mount=mount,
            tool_length=source.tool_length,
            payload=source.payload,
        )
    except ModelError as error:
        if error.key not in ("base_frame", "tool_frame"):
            raise
        # What has to be changed stands in the scene.
        key = f"robot.{error.key}"
        raise SceneError(scene.source, key, error.got, error.expected, error.choices) from error


def task_of(scene: Scene, robot: Robot) -> ToolTask:
    """Return the timed tool path of a scene, from the tool pose of its posture.

    Raises
    ------
    SceneError
        When the posture does not fit the robot.
    """
    posture = robot.posture(scene.posture, source=scene.source, key="posture_deg", error_type=SceneError)
    X_WT = Kinematics(robot).tool_pose(posture)
    steps = np.array([leg.by for leg in scene.legs])
    path = ToolPath(
        corners=X_WT.translation + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]),
        orientation=X_WT.rotation,
        seconds=np.array([leg.seconds for leg in scene.legs]),
        profile=scene.speed_profile,
    )
    return ToolTask(path, scene.keep)
