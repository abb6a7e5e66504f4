"""The planning context: robot, task, clearances and options of a scene, in one frozen object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ModelError, PathNotFound, SceneError
from cmbot.common.representation import short_repr
from cmbot.common.validation import counted
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.sag import Sag
from cmbot.planning.budget import Deadline
from cmbot.planning.objectives import Objective, WrenchFunction, objective_of
from cmbot.planning.progress import ProgressReporter
from cmbot.planning.stiffness import covariance_of, known_share, with_identified_stiffness
from cmbot.planning.task import ToolTask
from cmbot.planning.units import require_metres
from cmbot.robot import Kinematics, PostureBatch, Postures, Robot, load_robot
from cmbot.scene import SPEED_TOLERANCE, STOW, NamedState, PlannerOptions, Scene, Stroke
from cmbot.toolpath import ToolPoses

SAMPLE_STEP = 0.01
"""Step of the sampled motions, s; of long ones it is longer: `sample_step`."""

# Steps of a motion at most; steps grow by these factors.
_MOST_STEPS, _LONGER = 40_000, (1.0, 2.0, 5.0)
# Beside what the arm asks anyway this share of it is nothing.
_NEGLIGIBLE = 1e-2


def sample_step(duration: float, step: float = SAMPLE_STEP) -> float:
    """Return the step, s, by which a motion of a duration, s, is sampled: the number of steps is bounded.

    That is `step`, or it times 2, 5, 10, 20 and so on.
    """
    power = 1.0
    while True:
        for factor in _LONGER:
            if duration <= _MOST_STEPS * step * factor * power:
                return step * factor * power
        power *= 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanningContext:
    """What every stage of planning needs."""

    robot: Robot
    posture: FloatArray  # (n,), rad and m: where the arm is before, at first the scene's
    end_posture: FloatArray | None  # (n,), rad and m, of the whole job; None: where the work ends
    first: FloatArray  # (n,), rad and m: that in which the work starts unless another one is better
    strokes: tuple[Stroke, ...]  # of the job
    number: int  # of the stroke that is planned, from 0
    task: ToolTask
    clearances: Clearances
    times: FloatArray  # (k,), s, of the via-points
    options: PlannerOptions
    objective: Objective  # what is minimised
    idle_objective: Objective  # the same with the tool off
    arm: ElasticArm | None  # on its guardrail; None where both are rigid
    sag: Sag | None  # where it is to be compensated
    begin: float = 0.0  # s, on the job's clock: what is planned begins there
    reached: float = 0.0  # value of the objective that the job before reaches
    spare_clearance: float = 0.0  # m, of what is optimised: more than the safety margin, which is certified
    deadline: Deadline = field(default_factory=Deadline)
    reporter: ProgressReporter = field(default_factory=ProgressReporter)

    __repr__ = short_repr

    @property
    def stroke(self) -> Stroke:
        """The stroke that is planned."""
        return self.strokes[self.number]

    @property
    def before_in_words(self) -> str:
        """What messages call the posture in which the arm is before."""
        if self.number == 0:
            return "the scene's posture"
        return f"the end of stroke {self.strokes[self.number - 1].name}"

    @property
    def time_in_words(self) -> str:
        """What messages call the time that planning has, and the part of it that the stroke has."""
        limit, own = self.options.time_limit_s, self.deadline.limit
        part = f", of which {self.stroke.name} had {own:.3g} s" if own < limit else ""
        return f"the time, {limit:g} s (planner.time_limit_s){part}"

    @property
    def time_over(self) -> str:
        """What messages say where the time was over."""
        return f"{self.time_in_words}, was over after {self.deadline.used:.3g} s,"

    def at_stroke(
        self, number: int, scene: Scene, posture: FloatArray, begin: float, reached: float
    ) -> PlanningContext:
        """Return the context of a later stroke of a scene: the arm comes from `posture` (n,)."""
        stroke = self.strokes[number]
        return replace(
            self,
            number=number,
            posture=posture,
            first=posture,
            task=task_of(stroke, scene),
            times=stroke.via_times,
            begin=begin,
            reached=reached,
        )

    @cached_property
    def tool_off(self) -> PlanningContext:
        """The context of motions with the tool off: no process force acts on it."""
        if not self.robot.pushed:
            return self
        return replace(self, robot=self.robot.tool_off, objective=self.idle_objective)

    @cached_property
    def negligible(self) -> float:
        """Value of the objective that is nothing beside what the arm asks anyway, at rest where it is before.

        Or on the job before. A peak at rest may be zero, as where the arm's mass can be held above its base;
        shares of that say nothing.
        """
        off = self.tool_off
        before = float(off.objective.at_rest(off.postures.at(self.posture[None]))[0])
        return _NEGLIGIBLE * max(self.reached, before)

    @cached_property
    def on_axis(self) -> PlanningContext:
        """The context of holding the tool's axis in the middle of its cone; without a cone this one."""
        return self if self.task.cone is None else replace(self, task=self.task.on_axis)

    @cached_property
    def postures(self) -> Postures:
        """Kinematics and statics of the robot in batches."""
        return Postures(self.robot)

    @cached_property
    def goals(self) -> ToolPoses:
        """Timed poses of the tool at the via-points."""
        return self.task.goals(self.times)

    def path_not_found(
        self,
        reason: str,
        q: FloatArray,
        time: float = 0.0,
        pair: tuple[str, str] | None = None,
        pace: float = 1.0,
        *,
        stopped: bool = False,
    ) -> PathNotFound:
        """Return the error of a path that ends at posture `q` (n,), `time` s after its start."""
        return PathNotFound(
            reason,
            time=float(time),
            progress=self.task.path.progress(float(time)),
            smallest_singular_value=self.task.smallest_singular_value(self.robot, q),
            pair=pair,
            pace=pace,
            stopped=stopped,
        )

    def most_often_near(self, q: FloatArray) -> tuple[str, str] | None:
        """Return the link and the obstacle, or second link, that are nearest in most of postures (N, n)."""
        nearest = self.clearances.smallest(q).pair
        nearest = nearest[nearest >= 0]
        if not len(nearest):
            return None
        pair = self.clearances.pairs[int(np.bincount(nearest).argmax())]
        return pair.link, pair.other

    def use_at_rest(self, at: PostureBatch) -> FloatArray:
        """Return the largest shares (N,) of their bounds that joints and feet use at rest in N postures."""
        use = (np.abs(at.joint_torque) / self.robot.limits.torque).max(axis=1)
        holding = self.robot.holding
        if holding is None or not holding.bounded:
            return np.asarray(use)
        wrench = np.hstack([at.guardrail_force, at.guardrail_torque])
        return np.asarray(np.maximum(use, holding.share(wrench)[0]))

    def weakest_joint(self, q: FloatArray) -> str:
        """Return the joint that at rest uses most of its torque in most of postures (N, n), or the feet."""
        at = self.postures.at(q)
        use = np.abs(at.joint_torque) / self.robot.limits.torque
        if (self.use_at_rest(at) > use.max(axis=1)).mean() > 0.5:
            return "a foot"
        return self.robot.joints[int(np.bincount(use.argmax(axis=1)).argmax())]

    def out_of_range(self, q: FloatArray) -> str:
        """Return the joint that is out of its range in most of postures (N, n); empty where none is."""
        limits = self.robot.limits
        number = ((q < limits.lower) | (q > limits.upper)).sum(axis=0)
        return self.robot.joints[int(number.argmax())] if number.any() else ""

    def nearest_to_end(self, q: FloatArray) -> str:
        """Return the joint that in a posture (n,) is nearest to an end of its range."""
        limits = self.robot.limits
        room = self.robot.metric.coordinates(np.minimum(q - limits.lower, limits.upper - q))
        return self.robot.joints[int(room.argmin())]


def no_start_left(failures: Sequence[PathNotFound]) -> PathNotFound:
    """Return the first failure, with the number of the others."""
    first, others = failures[0], len(failures) - 1
    reason = first.reason
    if others:
        furthest = max(failure.progress for failure in failures)
        fail = "fails" if others == 1 else "fail"
        reason += (
            f"; {counted(others, 'other starting posture')} {fail} as well "
            f"(the best at {furthest:.0%} of the path)"
        )
    return PathNotFound(
        reason,
        time=first.time,
        progress=first.progress,
        smallest_singular_value=first.smallest_singular_value,
        pair=first.pair,
        pace=first.pace,
    )


def build_context(
    scene: Scene,
    options: PlannerOptions,
    own: WrenchFunction | None = None,
    reporter: ProgressReporter | None = None,
    deadline: Deadline | None = None,
) -> PlanningContext:
    """Bring a scene and its robot together; the objective is the function `own` where given.

    Raises
    ------
    SceneError, ModelError
        When they do not fit together.
    InputError
        When `own` is no function of the wrench.
    """
    robot = robot_of(scene)
    strokes = strokes_of(scene, robot)
    require_metres(scene, robot)
    posture = np.array(scene.posture)
    if options.objective == "hold" and not (robot.holding and robot.holding.flat):
        expected = (
            "a foot on flat steel, for objective: hold: guardrail.bays and a member that is no round bar"
        )
        raise SceneError(scene.source, "guardrail", "none", expected)
    arm = bending_arm(scene, robot)
    if arm is not None:
        options = known_share(scene, arm, options)
    sag = sag_of(scene, arm, options)
    objective = idle = objective_of(robot, options, own, posture, sag)
    if robot.pushed:
        off = robot.tool_off
        idle = objective_of(off, options, own, posture, sag_of(scene, bending_arm(scene, off), options))
    return PlanningContext(
        robot=robot,
        posture=posture,
        end_posture=end_posture_of(scene, robot),
        first=posture,
        strokes=strokes,
        number=0,
        task=task_of(strokes[0], scene),
        clearances=Clearances(robot, scene.all_obstacles),
        times=strokes[0].via_times,
        options=options,
        objective=objective,
        idle_objective=idle,
        arm=arm,
        sag=sag if options.compensate else None,
        reporter=reporter or ProgressReporter(),
        deadline=deadline or Deadline(),
    )


def end_posture_of(scene: Scene, robot: Robot) -> FloatArray | None:
    """Return the posture (n,), rad and m, in which a scene's job ends; None: where its work ends.

    It ends in a named state; an arm without a stow posture is put away where it started.

    Raises
    ------
    SceneError
        When its SRDF has no such state, or that is out of the joint ranges.
    """
    if scene.return_to == "none":
        return None
    name = scene.return_to.state if isinstance(scene.return_to, NamedState) else STOW
    state = robot.group_states.get(name)
    if state is None and isinstance(scene.return_to, NamedState):
        expected = "a group state of the arm's SRDF that sets all its joints"
        raise SceneError(scene.source, "return.state", repr(name), expected, tuple(robot.group_states))
    if scene.return_to == "start" or state is None:
        return np.array(scene.posture)
    return np.array(robot.posture(state, source=scene.source, key="return", error_type=SceneError))


def rigid_arm_remark(scene: Scene, robot: Robot) -> str:
    """Say that only the base bends, where the arm has no elasticity file; otherwise empty."""
    if robot.elasticity or robot.joint_elasticity or bending_arm(scene, robot) is None:
        return ""
    only = f"only the {scene.base_name} bends"
    return f"Links and joints are taken to be rigid, without an elasticity file; {only}."


def bending_arm(scene: Scene, robot: Robot) -> ElasticArm | None:
    """Return a scene's elastic arm on its guardrail; None where both are rigid."""
    arm = elastic_arm(robot, elastic_base(scene.elastic_guardrail))
    return arm if len(arm.elastic) else None


def sag_of(scene: Scene, arm: ElasticArm | None, options: PlannerOptions) -> Sag | None:
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
    return Sag(arm, covariance_of(scene, arm))


def robot_of(scene: Scene) -> Robot:
    """Load the robot that a scene names, its tool on: the process force acts on it.

    Raises
    ------
    ModelError
        When its files cannot be used.
    SceneError
        When the scene names a frame that is none of its robot's.
    """
    file, stance = scene.robot, scene.stance
    try:
        robot = load_robot(
            **file.files,
            mount=None if file.mount is None else file.mount.matrix,
            tool_length=file.tool_length_m,
            payload=file.payload_kg,
            root=None if stance is None else stance.root,
            locked=None if stance is None else stance.locked,
        )
    except ModelError as error:
        if error.key not in ("base_frame", "tool_frame", "total_mass_kg") and "xacro." not in error.key:
            raise
        # The scene holds the key that has to be changed.
        key = f"robot.{error.key}"
        raise SceneError(scene.source, key, error.got, error.expected, error.choices) from error
    robot = robot if file.joints == "elastic" else robot.with_rigid_joints
    robot = with_identified_stiffness(robot, scene)
    return replace(robot, tool_force=scene.tool.process_force_n, feet=scene.feet)


def strokes_of(scene: Scene, robot: Robot) -> tuple[Stroke, ...]:
    """Return the strokes of a scene, from the tool pose of its posture; each cell of a raster is one.

    Raises
    ------
    SceneError
        When the posture does not fit the robot, or a tool path is none.
    """
    return in_cells(scene, robot).timed_strokes(_start_pose(scene, robot))


def in_cells(scene: Scene, robot: Robot) -> Scene:
    """Return a scene with a stroke for each cell of the rows of a raster.

    Raises
    ------
    SceneError
        As `strokes_of`.
    """
    return scene.in_cells(_start_pose(scene, robot))


def _start_pose(scene: Scene, robot: Robot) -> FloatArray:
    """Pose (4, 4) of the tool in a scene's posture."""
    key, slides = scene.posture_key, np.flatnonzero(robot.limits.prismatic)
    if len(slides) and key == "start.posture_deg":
        got = f"degrees, but {robot.joints[slides[0]]} slides"
        expected = "start: {posture: [...]} in place of it, in rad and, of joints that slide, m"
        raise SceneError(scene.source, key, got, expected)
    posture = robot.posture(scene.posture, source=scene.source, key=key, error_type=SceneError)
    return np.asarray(Kinematics(robot).tool_pose(posture).homogeneous)


def task_of(stroke: Stroke, scene: Scene) -> ToolTask:
    """Return what a stroke of a scene prescribes of the tool."""
    speed = scene.tool.max_speed_m_s
    most = None if speed is None else speed * (1 + SPEED_TOLERANCE)
    task = ToolTask.of(stroke.path, stroke.file.keep, most, stroke.file.speed_tolerance)
    return replace(task, max_base_torque=stroke.file.max_base_torque_nm)
