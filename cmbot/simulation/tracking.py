"""How far the tool of the bending arm is from where the joints would put it: the tracking error."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from threadpoolctl import threadpool_limits

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, ElasticOptions, elastic_arm
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan, ToolTask, require_plan, robot_of
from cmbot.robot import Kinematics, Robot
from cmbot.simulation.drive import PrescribedMotion, drive_along, drive_through, held
from cmbot.simulation.generalized_alpha import ElasticMotion, GeneralizedAlpha
from cmbot.simulation.metrics import ErrorFigures, error_figures
from cmbot.simulation.options import SimulationOptions, checked
from cmbot.simulation.system import ElasticSystem

__all__ = ["MotionTracking", "Tracking", "completed", "elastic_arm_of", "foreseen", "simulate", "track"]

# Sag is computed every so often, s, and a cubic spline in between: on the shipped scenes within 3e-5 mm.
_SAG_STEP = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionTracking:
    """The tracking error of one motion, in W, every `output_step_s`.

    Attributes
    ----------
    t : (N,), s
    stop : float, s
        When the joints stop; what comes after is what is left of the vibration.
    error : (N, 3), m
        Tool point of the bending arm less where the motion's maker expects it: where a rigid arm with the
        same joint angles has it and, where the sag was compensated, the predicted sag from there.
    static : (N, 3), m
        The same at rest: the sag of the posture at that time, or what of it was not predicted.
    command : (N, 3), m
        Where the motion's maker expects the tool point less where the tool path has it at that time: it comes
        from the joint motion, not from bending.
    path_error : (N, 3), m
        From the nearest point of the leg of that time to the bending arm's tool point.
    figures : ErrorFigures
    """

    t: FloatArray
    stop: float
    error: FloatArray
    static: FloatArray
    command: FloatArray
    path_error: FloatArray
    figures: ErrorFigures

    @property
    def dynamic(self) -> FloatArray:
        """The error less its static part, (N, 3), m."""
        return self.error - self.static


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracking:
    """The tracking errors of a plan and of the baseline that it is compared with.

    Attributes
    ----------
    options : SimulationOptions
        What they were simulated with.
    baseline, planned : MotionTracking
    seconds : float, s
        Wall time.
    """

    options: SimulationOptions
    baseline: MotionTracking
    planned: MotionTracking
    seconds: float


def simulate(
    plan: Plan,
    options: SimulationOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> Tracking:
    """Drive the elastic arm of a plan's scene with its baseline and with its planned motion.

    The joints do exactly what they are told; guardrail and links bend. The planned motion is driven as it is,
    the baseline by the cubic spline through its postures.

    Parameters
    ----------
    plan : Plan
    options : SimulationOptions, optional
    progress : callable, optional
        Called every so often with the share of the simulated time that is done, 0 to 1.

    Raises
    ------
    InputError
        When `plan` is none, an option is out of its bounds, nothing of the arm bends, or it is too soft to
        carry itself.
    SimulationDiverged
        When the motion cannot be integrated.
    """
    require_plan(plan, "cmbot.simulate")
    options = checked(options if options is not None else SimulationOptions())
    started = time.perf_counter()
    # The matrices are small: more threads of linear algebra than one only wait for each other.
    with threadpool_limits(limits=1, user_api="blas"):
        arm = elastic_arm_of(plan, options)
        drives = drive_through(plan.baseline.t, plan.baseline.q), drive_along(plan.trajectory)
        first, second = (drive.duration + options.settle_s for drive in drives)

        def tell(reached: float) -> None:
            if progress is not None:
                progress(reached / (first + second))

        baseline = track(arm, plan.task, drives[0], options, tell)
        planned = track(arm, plan.task, drives[1], options, lambda reached: tell(first + reached), plan.sag)
    seconds = time.perf_counter() - started
    return Tracking(options=options, baseline=baseline, planned=planned, seconds=seconds)


def elastic_arm_of(plan: Plan, options: SimulationOptions) -> ElasticArm:
    """Return the elastic arm of a plan's scene.

    Raises
    ------
    InputError
        When nothing of it bends.
    """
    robot = plan.robot
    if options.payload_kg is not None:
        source = replace(plan.scene.robot, payload=options.payload_kg)
        robot = robot_of(replace(plan.scene, robot=source))
    elastic = ElasticOptions(
        segments=options.segments,
        guardrail_factor=options.guardrail_factor,
        link_factor=options.link_factor,
    )
    arm = elastic_arm(robot, elastic_base(plan.scene.guardrail), elastic)
    if not len(arm.elastic):
        expected = "a guardrail with posts or a stiffness, or an elasticity file of the robot"
        raise InputError(plan.scene.source, "guardrail", "nothing that bends", expected)
    return arm


def track(
    arm: ElasticArm,
    task: ToolTask,
    drive: PrescribedMotion,
    options: SimulationOptions,
    tell: Callable[[float], None] | None = None,
    sag: Sag | None = None,
) -> MotionTracking:
    """Drive an elastic arm once.

    Parameters
    ----------
    arm : ElasticArm
    task : ToolTask
        Whose path the tool is to follow.
    drive : PrescribedMotion
    options : SimulationOptions
    tell : callable, optional
        Called every so often with the time that has been reached, s.
    sag : Sag, optional
        What the motion's maker reckoned with: the error is measured from there. Without it the rigid arm is
        expected.

    Raises
    ------
    InputError
        When the arm is too soft to carry itself.
    SimulationDiverged
        When the motion cannot be integrated.
    """
    modes = arm_modes(arm, drive.states([0.0])[0][0])
    system = ElasticSystem.of(arm, modes.damping(options.damping))
    start = modes.u if options.initial == "equilibrium" else np.zeros_like(modes.u)
    drives = [drive]
    if options.settle_s > 0:
        drives.append(held(drive.states([drive.duration])[0][0], options.settle_s))
    integrator = GeneralizedAlpha(
        system, step=options.step_s, rho_inf=options.spectral_radius, corrections=options.corrections
    )
    motion = integrator.run(drives, start, np.zeros_like(start), tell)

    t = _output_times(float(motion.t[-1]), options.output_step_s)
    rigid, predicted = foreseen(arm.robot, drive, t, sag)
    error = _bent_tool(arm, drive.states(t)[0], motion, t) - rigid - predicted
    static = _sag(arm, drive, t) - predicted
    return completed(task, drive, t, rigid + predicted, error, static, modes.frequencies)


def foreseen(
    robot: Robot, drive: PrescribedMotion, t: FloatArray, sag: Sag | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the rigid arm's tool points at times `t` (N,), and the sag reckoned with, each (N, 3), m."""
    q = drive.states(t)[0]
    rigid, _ = Kinematics(robot).tool_poses(q)
    return rigid, np.zeros_like(rigid) if sag is None else sag.along(t, q)


def completed(
    task: ToolTask,
    drive: PrescribedMotion,
    t: FloatArray,
    expected: FloatArray,
    error: FloatArray,
    static: FloatArray,
    frequencies: FloatArray,
) -> MotionTracking:
    """Add to a tracking error what follows from it and from the motion.

    Parameters
    ----------
    task : ToolTask
        Whose path the tool is to follow.
    drive : PrescribedMotion
    t : (N,), s
        Equal steps, from 0 to the stop or beyond.
    expected : (N, 3), m
        Where the motion's maker expects the tool point.
    error, static : (N, 3), m
    frequencies : (f,), Hz
        Of the modes in the motion's first posture, ascending.
    """
    path_error = task.path.leg_offset(t, expected + error)
    moving = int(np.searchsorted(t, drive.duration * (1 + 1e-12), side="right"))
    return MotionTracking(
        t=t,
        stop=drive.duration,
        error=error,
        static=static,
        command=expected - task.path.position(t),
        path_error=path_error,
        figures=error_figures(t, error, static, path_error, moving, frequencies),
    )


def _output_times(duration: float, step: float) -> FloatArray:
    return step * np.arange(int(np.floor(duration / step * (1 + 1e-12))) + 1, dtype=np.float64)


def _sag(arm: ElasticArm, drive: PrescribedMotion, t: FloatArray) -> FloatArray:
    """Displacement (N, 3), m, of the tool at rest in the postures at times `t` (N,)."""
    # As in `cmbot.simulation.drive`: not for those who only plan.
    from scipy.interpolate import CubicSpline

    steps = max(int(np.ceil(drive.duration / _SAG_STEP * (1 - 1e-12))), 1)
    some = np.linspace(0.0, drive.duration, steps + 1)
    tool = CubicSpline(some, Sag(arm).at(drive.states(some)[0]).tool)
    # After the stop the posture stays.
    return np.asarray(tool(np.minimum(t, drive.duration)))


def _bent_tool(arm: ElasticArm, q: FloatArray, motion: ElasticMotion, t: FloatArray) -> FloatArray:
    """Tool points (N, 3), m, at times `t` (N,), between the steps of the motion too."""
    from scipy.interpolate import CubicHermiteSpline

    # Of fourth order, so finer than the integrator's own error.
    u = CubicHermiteSpline(motion.t, motion.u, motion.v)(t)
    model, data, tool = arm.model, arm.model.createData(), arm.tool_frame_id
    p = np.empty((len(t), 3))
    for k, bent in enumerate(arm.configuration(q, u)):
        pin.forwardKinematics(model, data, bent)
        p[k] = pin.updateFramePlacement(model, data, tool).translation
    return p
