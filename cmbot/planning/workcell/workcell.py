"""The workcell: robot, clearances, what bends, objectives and options, none of which changes during a job.

A stiffness that a scene says was identified takes the place of the model's, with its covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.accuracy import ramped, stroke_sway
from cmbot.collision import Clearances, Obstacle, extent_of
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import InputError, ModelError, SceneError
from cmbot.common.reading.fields import LONGEST_TUBE_M, MILLIMETRES
from cmbot.common.reading.validation import counted
from cmbot.common.representation import ShortRepr
from cmbot.elastic import Guardrail, elastic_base, shares
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.modes import arm_modes, frequency_slopes
from cmbot.elastic.sag import Sag, TooSoftError
from cmbot.elastic.stiffness_parameters import StiffnessParameters
from cmbot.hold import Foot
from cmbot.planning.workcell.objectives import Objective, WrenchFunction, objective_of
from cmbot.planning.workcell.units import require_metres
from cmbot.robot import PostureBatch, Postures, Robot, load_robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.toolpath import AUTO
from cmbot.trajectory import QuinticTrajectory

# What `load_robot` refuses by these keys stands in the scene.
_KEYS_OF_SCENES = ("base_frame", "tool_frame", "total_mass_kg", "xacro", "locked", "carried_from")
# Links that a remark lists.
_MOST_LOADS_NAMED = 6
# How far from the arm a tube may end; what is between them is taken as rigid.
_MOST_BESIDE_M = 0.5
# From where on that is told: a flange or a plate is as high.
_TOLD_BESIDE_M = 0.05
# How much of a tube its obstacle may leave out.
_MOST_LEFT_OUT_M = 0.1
# By what share a modelled stiffness may differ from what an identified one was compared with.
_STIFFNESS_TOLERANCE = 1e-6
# Standard deviations of the modes' stiffness that are allowed for.
_COVERED_SIGMAS = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Workcell(ShortRepr):
    """What is there while a job is planned, and how it is planned.

    Attributes
    ----------
    robot : Robot
    clearances : Clearances
    options : PlannerOptions
    objective : Objective
        What is minimised.
    idle_objective : Objective
        The same with the tool off.
    arm : ElasticArm or None
        On its guardrail; None where both are rigid.
    sag : Sag or None
        Where it is to be compensated.
    """

    robot: Robot
    clearances: Clearances
    options: PlannerOptions
    objective: Objective
    idle_objective: Objective
    arm: ElasticArm | None = None
    sag: Sag | None = None

    @classmethod
    def of(cls, robot: Robot, obstacles: Sequence[Obstacle], options: PlannerOptions) -> Workcell:
        """Return the workcell of a robot among obstacles, on a base that does not bend."""
        objective, clearances = objective_of(robot, options), Clearances(robot, obstacles)
        return cls(
            robot=robot,
            clearances=clearances,
            options=options,
            objective=objective,
            idle_objective=objective,
        )

    def with_options(self, **changes: Any) -> Workcell:
        """Return the workcell with other options."""
        return replace(self, options=replace(self.options, **changes))

    def ramped(self, q: FloatArray) -> Workcell:
        """Return the workcell with a process force that sets in slowly in posture `q` (n,), see `ramped`."""
        if self.arm is None:
            return self
        arm = ramped(self.arm, q)
        return replace(self, arm=arm, robot=replace(self.robot, tool_ramp=arm.robot.tool_ramp))

    @cached_property
    def tool_off(self) -> Workcell:
        """The workcell of motions with the tool off: no process force acts on it."""
        if not self.robot.pushed:
            return self
        return replace(self, robot=self.robot.tool_off, objective=self.idle_objective)

    @cached_property
    def postures(self) -> Postures:
        """Kinematics and statics of the robot in batches."""
        return Postures(self.robot)

    def clear(self, q: FloatArray) -> BoolArray:
        """Return which of postures (N, n) keep the safety margin, (N,)."""
        margin = self.options.safety_margin_m
        return np.asarray(self.clearances.query(q, margin).distance >= margin)

    def admissible(self, q: FloatArray, most_use: float = 1.0) -> BoolArray:
        """Return which of postures (N, n) are within the joint ranges, strong enough and clear, (N,).

        Strong enough are those in which joints and feet use at most a share of their bounds at rest.
        """
        holds = self.robot.limits.contain(q)
        holds[holds] = self.strong(self.postures.at(q[holds]), most_use)
        holds[holds] = self.clear(q[holds])
        return holds

    def strong(self, at: PostureBatch, most_use: float = 1.0) -> BoolArray:
        """Return in which of N postures joints and feet use at most a share of their bounds at rest, (N,)."""
        use, wrench, holding = *self._use_of_joints(at), self.robot.holding
        strong = use <= most_use
        if holding is not None and holding.bounded:
            strong[strong] = holding.bears(wrench[strong], most_use)
        return strong

    def sway_of(self, trajectory: QuinticTrajectory) -> tuple[float, float]:
        """Return the largest sway and swing of a stroke, m, over the interval of the stiffness.

        Zero where nothing bends. What a process force adds as it sets in no motion changes: it is left out.

        Raises
        ------
        TooSoftError
            Where the base does not bear the arm at the least stiffness.
        """
        share = self.options.quiet_stiffness_share
        if self.arm is None:
            return 0.0, 0.0
        return stroke_sway(self.arm, trajectory, share, sets_in=False).largest

    def sway_of_legs(self, trajectory: QuinticTrajectory, times: FloatArray) -> FloatArray:
        """Return the largest sway (L,), m, on legs that begin or end at L + 1 times, s; errors as above."""
        share = self.options.quiet_stiffness_share
        legs = np.zeros(len(times) - 1)
        if self.arm is None:
            return legs
        return stroke_sway(self.arm, trajectory, share, sets_in=False).of_legs(times)

    def lowest_frequency(self, q: FloatArray) -> float | None:
        """Return the lowest natural frequency, Hz, in posture `q` (n,); None where nothing bends.

        Nor is there one where the base does not bear the arm.
        """
        if self.arm is None:
            return None
        try:
            return float(arm_modes(self.arm, q).frequencies[0])
        except TooSoftError:
            return None

    def use_at_rest(self, at: PostureBatch, above: float = 0.0) -> FloatArray:
        """Return the largest shares (N,) of their bounds that joints and feet use at rest in N postures.

        What is not above a share may be given lower: friction of feet is then looked at there alone.
        """
        use, wrench, holding = *self._use_of_joints(at), self.robot.holding
        if holding is None or not holding.bounded:
            return use
        return np.asarray(np.maximum(use, holding.share(wrench, np.maximum(use, above))[0]))

    def _use_of_joints(self, at: PostureBatch) -> tuple[FloatArray, FloatArray]:
        """The largest shares (N,) that joints use, also of a climber, and wrenches (N, 6) on the base."""
        wrench = at.guardrail_wrench
        use = (np.abs(at.joint_torque) / self.robot.limits.torque).max(axis=1)
        return np.maximum(use, self.robot.holding_use(wrench).max(axis=1, initial=0.0)), wrench


def build_workcell(scene: Scene, options: PlannerOptions, own: WrenchFunction | None = None) -> Workcell:
    """Bring a scene and its robot together; the objective is the function `own` where given.

    Raises
    ------
    SceneError, ModelError
        When they do not fit together.
    InputError
        When `own` is no function of the wrench.
    """
    robot = robot_of(scene)
    require_metres(scene, robot)
    posture = np.array(scene.posture)
    if options.objective == "hold" and not (robot.holding and robot.holding.flat):
        expected = "a foot on flat steel, for objective: hold: base.hold, or guardrail.bays and no round bar"
        raise SceneError(scene.source, "guardrail", "none", expected)
    arm = bending_arm(scene, robot)
    options = resolved_options(scene, arm, options)
    sag = sag_of(scene, arm, options)
    objective = idle = objective_of(robot, options, own, posture, sag)
    if robot.pushed:
        off = robot.tool_off
        idle = objective_of(off, options, own, posture, sag_of(scene, bending_arm(scene, off), options))
    return Workcell(
        robot=robot,
        clearances=Clearances(robot, scene.all_obstacles),
        options=options,
        objective=objective,
        idle_objective=idle,
        arm=arm,
        sag=sag if options.compensate is True else None,
    )


def rigid_parts_remark(scene: Scene, robot: Robot) -> str:
    """Say what is taken to be rigid, without an elasticity file or beside what bends, and what loads that."""
    return " ".join(filter(None, (tube_warning(scene, robot), load_remark(scene, robot))))


def load_remark(scene: Scene, robot: Robot) -> str:
    """Say that the arm is taken to be rigid, and what else loads what bends."""
    base, told = scene.base_name, list[str]()
    if not (robot.elasticity or robot.joint_elasticity) and bending_arm(scene, robot) is not None:
        only = f"only the {base} bends"
        told.append(f"Links and joints are taken to be rigid, without an elasticity file; {only}.")
    loads = {} if scene.on_guardrail else robot.loads_beside
    if loads and elastic_base(held_guardrail(scene, robot)) is not None:
        each = [f"{name} ({mass:.4g} kg)" for name, mass in loads.items()]
        listed = ", ".join([*each[:_MOST_LOADS_NAMED], *["…"] * (len(each) > _MOST_LOADS_NAMED)])
        told.append(
            f"{sum(loads.values()):.4g} kg before {robot.base_frame} count as load of the {base}: {listed}; "
            "robot.carried_from leaves out what stands on the floor."
        )
    return " ".join(told)


def tube_warning(scene: Scene, robot: Robot) -> str:
    """Say that a base bends beside the arm, or a tube is longer than its obstacle; empty where all fits."""
    (away, place), base, told = _beside_stiffness(scene, robot), scene.base_name, list[str]()
    if away > _TOLD_BESIDE_M:
        elsewhere = "bends at the origin of W,", "robot.mount"
        ends, key = ("ends", "base.tube.end_m") if _tube_end(scene) else elsewhere
        told.append(
            f"The {base} {ends} {away:.2g} m from {place}: what is between is taken to be rigid ({key})."
        )
    tube = None if scene.base is None else scene.base.tube
    for obstacle in scene.all_obstacles:
        if tube is not None and obstacle.name == base:
            ends_m, (low, high) = np.array([tube.start_m, tube.end_m]), extent_of(obstacle)
            left_out = float(max(*(low - ends_m.min(axis=0)), *(ends_m.max(axis=0) - high)))
            if left_out > _MOST_LEFT_OUT_M:
                told.append(f"The obstacle {base} leaves out {left_out:.2g} m of base.tube.")
    return " ".join(told)


def stiffness_point(scene: Scene) -> tuple[float, float, float] | None:
    """Return where a base's stiffness acts, (3,), m, in W; None: it is rigid, or below feet."""
    if end := _tube_end(scene):
        return end
    rigid = scene.on_guardrail or elastic_base(scene.elastic_guardrail) is None
    return None if rigid else (0.0, 0.0, 0.0)


def _tube_end(scene: Scene) -> tuple[float, float, float] | None:
    tube = None if scene.base is None else scene.base.tube
    return None if tube is None else tube.end_m


def bending_arm(scene: Scene, robot: Robot) -> ElasticArm | None:
    """Return a scene's elastic arm on its guardrail; None where both are rigid."""
    arm = elastic_arm(robot, elastic_base(held_guardrail(scene, robot)))
    return arm if len(arm.elastic) else None


def held_guardrail(scene: Scene, robot: Robot) -> Guardrail:
    """Return a scene's guardrail with the legs of its robot, between the feet and the arm's base."""
    # An identified base is what the arm stood on, legs included.
    legs = None if scene.identified and scene.identified.base else robot.leg_compliance
    return replace(scene.elastic_guardrail, leg_compliance=legs)


def resolved_options(scene: Scene, arm: ElasticArm | None, options: PlannerOptions) -> PlannerOptions:
    """Return options with `compensate` decided, and `quiet_stiffness_share` by what was identified.

    Where `compensate` is ``auto``, it is so wherever something bends. The arm is that of `bending_arm`. One
    that is too soft to carry itself where it starts has no sag; its plan says so.
    """
    if arm is not None:
        options = known_share(scene, arm, options)
    if options.compensate != AUTO:
        return options
    try:
        bends = arm is not None and len(Sag(arm).at(np.array([scene.posture])).u) > 0
    except TooSoftError:
        bends = False
    return replace(options, compensate=bends)


def sag_of(scene: Scene, arm: ElasticArm | None, options: PlannerOptions) -> Sag | None:
    """Return the predicted sag of the tool where the options need it.

    Parameters
    ----------
    scene : Scene
    arm : ElasticArm or None
        From `bending_arm`.
    options : PlannerOptions
        From `resolved_options`; ``compensate: auto`` asks for none.

    Raises
    ------
    SceneError
        When they need it, and nothing bends.
    """
    if not (options.compensate is True or options.objective in ("sag", "sway")):
        return None
    if arm is None:
        raise SceneError(
            scene.source,
            "guardrail",
            "no guardrail, and a robot without link tubes",
            "something that bends: guardrail.bays, base.tube, guardrail.stiffness or robot.elasticity",
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
            locked=dict(file.locked or ()) if stance is None else stance.locked,
        )
    except ModelError as error:
        if error.key.partition(".")[0] not in _KEYS_OF_SCENES:
            raise
        # The scene holds the key that has to be changed.
        key = f"robot.{error.key}"
        raise SceneError(scene.source, key, error.got, error.expected, error.choices) from error
    if file.range_margin_deg or file.range_margin_m:
        margins = float(np.radians(file.range_margin_deg)), file.range_margin_m
        try:
            robot = replace(robot, limits=robot.limits.narrowed(*margins))
        except InputError as error:
            raise SceneError(scene.source, "robot.range_margin_deg", error.got, error.expected) from error
    _require_on_its_tube(scene, robot)
    robot = robot if file.joints == "elastic" else robot.with_rigid_joints
    robot = with_identified_stiffness(robot, scene)
    fixed = None if scene.tool.fixed is None else pin.SE3(np.array(scene.tool.fixed.matrix))
    force, ramp = scene.tool.process_force_n, scene.tool.process_ramp_s
    robot = replace(robot, tool_force=force, tool_ramp=ramp, fixed_tool=fixed, feet=_feet_of(scene, robot))
    if len(robot.feet) < 2 or robot.leg_compliance is None:
        return robot
    # How far the legs give way says what of the wrench each foot bears.
    held = replace(scene.elastic_guardrail, leg_compliance=robot.leg_compliance)
    feet = zip(robot.feet, shares(held), strict=True)
    return replace(robot, feet=tuple(replace(foot, share=share) for foot, share in feet))


def _require_on_its_tube(scene: Scene, robot: Robot) -> None:
    """Refuse a tube that ends beside the arm's base frame and first joint, as where `end_m` was left out."""
    tube, held, mount = scene.base and scene.base.tube, standing_point(scene, robot), scene.robot.mount
    if not tube or min(math.dist(tube.end_m, point) for point in (held, robot.base_point)) <= _MOST_BESIDE_M:
        return
    end, length = _numbers(tube.end_m), math.dist(tube.start_m, held)
    if mount and length > LONGEST_TUBE_M:
        metres = _numbers([x / 1000 for x in mount.xyz])
        got = f"[{_numbers(mount.xyz)}], {length:.3g} m from base.tube.start_m"
        raise SceneError(scene.source, "robot.mount.xyz", got, f"{MILLIMETRES}? then [{metres}]")
    along = np.subtract(tube.end_m, tube.start_m)
    got = f"an end {math.dist(tube.end_m, held):.3g} m from what it holds, the arm at ({_numbers(held)})"
    expected = f"at most {_MOST_BESIDE_M:g} m; set end_m: [{_numbers(held)}], "
    # Clamped where the arm is: a mast stands, so that its start is below its end.
    below = _numbers(np.subtract(held, -along if along[2] < 0 else along).tolist())
    expected += f"start_m: [{below}]" if length <= _MOST_BESIDE_M else f"so that it is {length:.3g} m long"
    if not scene.on_guardrail:
        expected += f", or robot.mount: {{xyz: [{end}], rpy_deg: [0, 0, 0]}}"
    raise SceneError(scene.source, "base.tube.end_m", got, expected)


def held_point(scene: Scene, robot: Robot) -> Sequence[float]:
    """Return where the base holds the robot, m, in W: a tube's end, the foot, or the arm's base frame."""
    return _tube_end(scene) or standing_point(scene, robot)


def standing_point(scene: Scene, robot: Robot) -> Sequence[float]:
    """Return the foot of a climber, or the origin of the arm's base frame, m, in W."""
    frame: list[float] = robot.base_pose.translation.tolist()
    return robot.foot_point if scene.on_guardrail else frame


def _beside_stiffness(scene: Scene, robot: Robot) -> tuple[float, str]:
    """How far from the arm a base's stiffness acts, m, zero without one, and from which place, in words."""
    at, held, joint = stiffness_point(scene), standing_point(scene, robot), robot.base_point.tolist()
    places = [("the arm's base", held), ("the arm's first joint", joint)]
    # A column that lifts an arm may end at its first joint; where that turns, a mount says where the arm is.
    if scene.robot.mount and _tube_end(scene) and not robot.limits.prismatic[0]:
        places.pop()
    away, name, place = min((math.dist(at or held, point), name, point) for name, point in places)
    return away * (at is not None), f"{name} at ({_numbers(place)}) m"


def _numbers(point: Sequence[float]) -> str:
    return ", ".join(f"{x:.3g}" for x in point)


def _feet_of(scene: Scene, robot: Robot) -> tuple[Foot, ...]:
    """Its feet: those on the guardrail, or the link that is held."""
    hold = None if scene.base is None else scene.base.hold
    if hold is None:
        return scene.feet
    links = {
        frame.name: frame
        for frame in robot.model.frames
        if frame.parentJoint == 0 and frame.name != "universe"
    }
    link = links.get(robot.base_frame if hold.link is None else hold.link)
    if link is None:
        expected = "a link that the arm's joints do not move"
        raise SceneError(scene.source, "base.hold.link", hold.link, expected, tuple(links))
    return (hold.foot(link.placement.homogeneous, np.array(robot.foot_point)),)


def modelled_stiffness(robot: Robot) -> dict[tuple[str, str], float]:
    """Return what factors are of: of links E I, N m2, of joints Nm/rad, by kind and name."""
    links = {("link", name): tube.young * tube.second_moment for name, tube in robot.elasticity.items()}
    return links | {("joint", name): spring.stiffness for name, spring in robot.joint_elasticity.items()}


def with_identified_stiffness(robot: Robot, scene: Scene) -> Robot:
    """Return a robot whose links and joints are as stiff, and whose modes damped, as a scene says.

    Raises
    ------
    SceneError
        When they were identified for another robot.
    """
    if (identified := scene.identified) is None:
        return robot
    modelled = modelled_stiffness(robot)
    given = (*identified.links, *identified.joints)
    for spring, each in zip(identified.springs, given, strict=True):
        key = f"identified.{spring[0]}s"
        known = modelled.get(spring)
        if known is None:
            names = tuple(name for kind, name in modelled if kind == spring[0])
            raise SceneError(scene.source, key, each.name, f"a {spring[0]} that bends", names)
        if abs(each.modelled / known - 1) > _STIFFNESS_TOLERANCE:
            expected = f"{known:g}, as the robot's model has it: the stiffness is that of another robot"
            raise SceneError(scene.source, f"{key} of {each.name}", f"modelled: {each.modelled:g}", expected)
    factors = {spring: each.factor for spring, each in zip(identified.springs, given, strict=True)}
    tubes = {
        name: replace(tube, young=by * tube.young, shear=by * tube.shear)
        for name, tube in robot.elasticity.items()
        for by in [factors.get(("link", name), 1.0)]
    }
    springs = {
        name: replace(spring, stiffness=by * spring.stiffness, tilting=spring.tilting and by * spring.tilting)
        for name, spring in robot.joint_elasticity.items()
        for by in [factors.get(("joint", name), 1.0)]
    }
    damping = robot.damping_ratio if identified.damping is None else identified.damping.ratio
    return replace(robot, elasticity=tubes, joint_elasticity=springs, damping_ratio=damping)


def identified_in_words(scene: Scene) -> str | None:
    """Return what is as stiff as identified, and which keys of the scene that replaces; None: nothing is."""
    if (identified := scene.identified) is None:
        return None
    of = [counted(len(identified.links), "link"), counted(len(identified.joints), "joint")]
    replaced = []
    if identified.base is not None:
        of.append(scene.base_name)
        given = scene.guardrail
        replaced = [
            f"guardrail.{key}"
            for key in ("stiffness", "mass", "stiffness_factor")
            if getattr(given, key) is not None
        ]
    instead = f" It replaces {' and '.join(replaced)} of the scene." if replaced else ""
    damping = identified.damping and f" Damping as identified: {100 * identified.damping.ratio:.2g} %."
    return f"Stiffness as identified, not as modelled: {', '.join(of)}.{instead}{damping or ''}"


def known_share(scene: Scene, arm: ElasticArm, options: PlannerOptions) -> PlannerOptions:
    """Return options whose `quiet_stiffness_share` is what an identified stiffness leaves open.

    Twice the standard deviation of the stiffness of the slowest modes, by their frequencies in the scene's
    posture, where that is less.
    """
    if (covariance := covariance_of(scene, arm)) is None:
        return options
    parameters = StiffnessParameters(arm)
    zero = np.zeros(parameters.count)
    posture = np.array(scene.posture)
    slowest = arm_modes(arm, posture).shapes[:, : max(options.quiet_modes, 1)]
    _, slopes = frequency_slopes(arm, parameters, zero, posture, slowest)
    # A mode's stiffness goes with the square of its frequency.
    deviation = 2 * np.sqrt(np.einsum("kp,pr,kr->k", slopes, covariance, slopes).max())
    share = min(options.quiet_stiffness_share, round(float(_COVERED_SIGMAS * deviation), 3))
    return replace(options, quiet_stiffness_share=share)


def covariance_of(scene: Scene, arm: ElasticArm) -> FloatArray | None:
    """Return the covariance (p, p) of the `StiffnessParameters` of a scene's arm; None where none is known.

    Raises
    ------
    SceneError
        When it is of other parameters.
    """
    if (identified := scene.identified) is None:
        return None
    parameters = StiffnessParameters(arm)
    if parameters.springs != identified.springs or parameters.has_base != (identified.base is not None):
        wanted = [name for _, name in parameters.springs] + ["base"] * parameters.has_base
        got = [name for _, name in identified.springs] + ["base"] * (identified.base is not None)
        by = identified.measured and f" (measured by {', '.join(identified.measured.sheets)})"
        order = f"what bends in this scene, in this order: {', '.join(wanted)}"
        expected = f"{order}; the stiffness is that of another robot, or on another base"
        raise SceneError(scene.source, "identified", f"{', '.join(got)}{by or ''}", expected)
    return np.asarray(identified.covariance_matrix)
