"""The tracking error: the tool of the elastic arm against the tool that the joint angles give."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import CheckedFields, checked_options
from cmbot.common.representation import ShortRepr, card
from cmbot.common.watching import watched_share
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, ElasticOptions, elastic_arm
from cmbot.elastic.generalized_alpha import (
    DrivenMotion,
    ElasticMotion,
    ElasticSystem,
    ExternalForces,
    GeneralizedAlpha,
)
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan, held_guardrail, held_point, require_plan, robot_of
from cmbot.robot import Coupling, Kinematics, Robot
from cmbot.simulation.accelerated_base import GroundAcceleration, on_accelerated_base
from cmbot.simulation.execution import executed, is_executed
from cmbot.simulation.metrics import ErrorMetrics, error_metrics
from cmbot.simulation.options import SimulationOptions
from cmbot.simulation.prescribed_work import PrescribedWork, WorkPart
from cmbot.trajectory import QuinticTrajectory

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

Distance = Annotated[float, Field(ge=0)]

# Displacement, m or rad, by which a second correction of a step has to move something to be made, and which
# the error of a step longer than asked for may have; how much longer steps may be.
_CORRECTION_TOLERANCE, _MAX_STEP_FACTOR = 1e-8, 8
# Step, s, at which the sag is computed where joints move at this speed, rad/s, or quicker; the cubic spline
# between is within 3e-5 mm on the shipped scenes. Slower ones have longer steps, up to so many times.
_SAG_STEP, _QUICK_JOINT_RAD_S, _LONGEST_SAG_STEP = 0.02, 0.1, 8.0


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionTracking(ShortRepr):
    """The tracking error of one motion, in W, every `output_step_s`.

    Attributes
    ----------
    t : (N,), s
    stop : float, s
        When the joints stop; after it there is only residual vibration.
    error : (N, 3), m
        Tool point of the elastic arm less the expected tool point: that of a rigid arm with the same joint
        angles and, where the sag was compensated, the predicted sag added.
    static : (N, 3), m
        The error at rest: the sag of the posture at that time, less the predicted one. It jumps where a
        process force sets in or ends.
    command : (N, 3), m
        Expected tool point less that of the tool path at that time: it comes from the joint motion, not from
        bending. NaN between strokes, where there is no path.
    path_error : (N, 3), m
        From the nearest point of the current leg to the elastic arm's tool point. NaN between strokes.
    metrics : ErrorMetrics
    execution : (N, 3), m, or None
        Part of the error: the tool point of a rigid arm as the controller moves its joints, less that of the
        commanded ones. None where joints follow exactly.
    base : (N, 9), m, rad and Nm, or None
        Displacement of the base where it holds the arm (`held_point`) along the axes of W, and its rotation,
        first about x, then about the turned y, then about the turned z; the torque on it about O0, with sag
        and vibration, which `Samples.guardrail_torque` has without them: stiffness times deflection, less the
        weight of what the joints do not move. None where the base is rigid.
    """

    t: FloatArray
    stop: float
    error: FloatArray
    static: FloatArray
    command: FloatArray
    path_error: FloatArray
    metrics: ErrorMetrics
    execution: FloatArray | None = None
    base: FloatArray | None = None

    @property
    def dynamic(self) -> FloatArray:
        """The error less its static part, (N, 3), m."""
        return self.error - self.static

    @property
    def off_path(self) -> FloatArray:
        """Distance of the bent tool from the current leg, (N,), m; NaN between strokes."""
        return np.asarray(np.linalg.norm(self.path_error, axis=1))

    @cached_property
    def at_work(self) -> MotionTracking:
        """What of it is along strokes, as samples alone."""
        return self._some(np.isfinite(self.command[:, 0]))

    @cached_property
    def on_free_moves(self) -> MotionTracking | None:
        """What of it is between strokes, likewise; None of one stroke."""
        between = np.isnan(self.command[:, 0])
        return self._some(between) if between.any() else None

    def _some(self, which: BoolArray) -> MotionTracking:
        arrays: dict[str, Any] = {
            name: each[which] for name, each in vars(self).items() if isinstance(each, np.ndarray)
        }
        return replace(self, **arrays)

    @property
    def largest_off_path(self) -> float:
        """Largest distance of the bent tool from its path along the strokes, m."""
        return self.largest(self.path_error)

    @property
    def largest_base_displacement(self) -> float:
        """How far the base moves where it holds the arm while the joints move, m; 0 where it is rigid."""
        return 0.0 if self.base is None else self.largest(self.base[:, :3])

    @property
    def largest_base_rotation(self) -> float:
        """Angle by which the base turns while the joints move, rad; 0 where it is rigid."""
        if self.base is None:
            return 0.0
        return self.largest(Rotation.from_euler("XYZ", self.base[:, 3:6]).as_rotvec())

    @property
    def largest_base_torque(self) -> float:
        """Largest torque on the bent base while the joints move, Nm; 0 where it is rigid."""
        return 0.0 if self.base is None else self.largest(self.base[:, 6:])

    def largest(self, error: FloatArray) -> float:
        """Return the largest norm of an error (N, 3) while the joints move, m; rows of NaN are left out."""
        moving = self.t <= self.stop * (1 + 1e-12)
        return float(np.nanmax(np.linalg.norm(error[moving], axis=1)))


@dataclass(frozen=True, kw_only=True)
class StiffnessCase(CheckedFields):
    """What matters of the motions where all stiffness is another.

    Attributes
    ----------
    stiffness : float
        Factor on all stiffness of the simulation's options.
    off_path : tuple of float, m
        Largest distance of the bent tool from its path along the strokes, of the motions of `Tracking`.
    swing : tuple of float, m, or None
        Largest distance between two positions of the tool after the stop, of each; None where that is not
        simulated.
    """

    stiffness: Annotated[float, Field(gt=0)]
    off_path: Annotated[tuple[Distance, ...], Field(min_length=1, max_length=2)]
    swing: Annotated[tuple[Distance, ...], Field(min_length=1, max_length=2)] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracking:
    """The tracking errors of a plan, and of its baseline where it has one.

    Attributes
    ----------
    options : SimulationOptions
    baseline : MotionTracking or None
    planned : MotionTracking
    seconds : float, s
        Wall time.
    interval : tuple of StiffnessCase
        At the ends of the interval that `SimulationOptions.stiffness_share` gives.
    """

    options: SimulationOptions
    baseline: MotionTracking | None
    planned: MotionTracking
    seconds: float
    interval: tuple[StiffnessCase, ...] = ()

    def __repr__(self) -> str:
        return f"<Tracking: {self._in_words}>"

    def _repr_html_(self) -> str:
        """Card in a notebook."""
        rows = []
        parts = {"error": "total", "at rest": "static", "vibration": "dynamic", "off its path": "path"}
        for name, part in parts.items():
            values = (1e3 * getattr(motion.metrics, part).rms[3] for _, motion in self.motions)
            rows.append((f"{name}, RMS, mm", *(f"{value:.3f}" for value in values)))
        return card("Tracking", self._in_words, rows, self.headings)

    @property
    def headings(self) -> tuple[str, ...]:
        """What the columns are called of a table with a value of each motion."""
        return "", *(name for name, _ in self.motions)

    @property
    def _in_words(self) -> str:
        each = ", ".join(
            f"{1e3 * motion.metrics.total.rms[3]:.2f} mm ({name})" for name, motion in self.motions
        )
        return f"RMS error of the bent tool {each}"

    @property
    def motions(self) -> tuple[tuple[Literal["baseline", "planned"], MotionTracking], ...]:
        """The motions with their names, the planned one last."""
        planned: tuple[Literal["planned"], MotionTracking] = ("planned", self.planned)
        return (planned,) if self.baseline is None else (("baseline", self.baseline), planned)


def simulate(
    plan: Plan,
    options: SimulationOptions | None = None,
    *,
    progress: Callable[[float], None] | Literal[False] | None = None,
) -> Tracking:
    """Simulate the elastic arm of a plan's scene under its planned motion, and under its baseline if any.

    The joints follow their motion exactly from the first stroke's beginning to the last one's end; guardrail
    and links bend. The process force acts on the bent tool along the strokes, and on after the joints stop.
    The baseline's motions, along each stroke and between strokes, are cubic splines through their postures.

    Parameters
    ----------
    plan : Plan
    options : SimulationOptions, optional
    progress : callable, optional
        Called repeatedly with the share of the simulated time that is done, 0 to 1. Left out, that is shown
        on a terminal and in a notebook; with False nowhere.

    Raises
    ------
    InputError
        When `plan` is no plan, an option is out of its bounds, nothing of the arm bends, or it is too soft to
        carry itself.
    SimulationDiverged
        When the motion cannot be integrated.

    Examples
    --------
    >>> tracking = cmbot.simulate(plan, progress=False)
    >>> f"{1e3 * tracking.planned.largest_off_path:.1f} mm off its path, bent"
    '0.2 mm off its path, bent'
    """
    require_plan(plan, "cmbot.simulate")
    options = SimulationOptions() if options is None else options
    options = checked_options(SimulationOptions, options, "SimulationOptions")
    options = replace(options, damping=options.damping_or(plan.robot.damping_ratio))
    started = time.perf_counter()
    # The matrices are too small for several threads of linear algebra.
    with threadpool_limits(limits=1, user_api="blas"), watched_share(progress, "simulating") as told:
        works = [(PrescribedWork.planned(plan), plan.sag)]
        if (other := PrescribedWork.baseline(plan)) is not None:
            works.insert(0, (other, None))
        share, held = options.stiffness_share, held_point(plan.scene, plan.robot)
        factors = (1.0, 1 - share, 1 + share) if share else (1.0,)
        total, before = len(factors) * sum(work.duration + options.settle_s for work, _ in works), 0.0

        def report(reached: float) -> None:
            if told is not None:
                told((before + reached) / total)

        stated, cases = elastic_arm_of(plan, options), []
        for factor in factors:
            arm, motions = stated.softened(factor), list[MotionTracking]()
            for work, sag in works:
                motions.append(track_work(arm, work, options, report, sag, held=held))
                before += work.duration + options.settle_s
            cases.append(motions)
    *baseline, planned = cases[0]
    return Tracking(
        options=options,
        baseline=baseline[0] if baseline else None,
        planned=planned,
        seconds=time.perf_counter() - started,
        interval=tuple(
            _case(factor, *motions) for factor, motions in zip(factors[1:], cases[1:], strict=True)
        ),
    )


def _case(factor: float, *motions: MotionTracking) -> StiffnessCase:
    off = [motion.largest_off_path for motion in motions]
    swings = [motion.metrics.residual.diameter for motion in motions if motion.metrics.residual is not None]
    swing = tuple(swings) if len(swings) == len(off) else None
    return StiffnessCase(stiffness=factor, off_path=tuple(off), swing=swing)


def elastic_arm_of(plan: Plan, options: SimulationOptions) -> ElasticArm:
    """Return the elastic arm of a plan's scene; an `InputError` when nothing of it bends."""
    robot = plan.robot
    if options.payload_kg is not None:
        robot = robot_of(plan.scene.with_payload(options.payload_kg))
    shared = ("segments", "guardrail_factor", "link_factor", "joint_factor")
    elastic = ElasticOptions(**{name: getattr(options, name) for name in shared})
    arm = elastic_arm(robot, elastic_base(held_guardrail(plan.scene, robot)), elastic)
    if not len(arm.elastic):
        expected = (
            "guardrail.bays, base.tube, guardrail.stiffness or robot.elasticity in the scene that is planned"
        )
        raise InputError(plan.scene.source, "guardrail", "nothing that bends", expected)
    return arm


def track_work(
    arm: ElasticArm,
    work: PrescribedWork,
    options: SimulationOptions,
    progress: Callable[[float], None] | None = None,
    sag: Sag | None = None,
    ground: GroundAcceleration | None = None,
    held: Sequence[float] | None = None,
) -> MotionTracking:
    """Simulate an elastic arm under the motions of a work and at rest after it.

    Parameters
    ----------
    arm : ElasticArm
        Its tool is on along the strokes and after the stop.
    work : PrescribedWork
    options : SimulationOptions
    progress : callable, optional
        Called repeatedly with the time that has been reached, s.
    sag : Sag, optional
        The sag that the motion compensates.
    ground : callable, optional
        The acceleration (N, 3), m/s2, in W, of what the arm stands on, at times (N,); errors are relative to
        it.
    held : three floats, m, optional
        Point of the base whose motion is told; left out: O0.

    Raises
    ------
    InputError
        When the arm is too soft to carry itself.
    SimulationDiverged
        When the motion cannot be integrated.
    """
    first = work.postures(np.zeros(1))
    modes = arm_modes(arm, first[0])
    start, rate = np.zeros((2, len(modes.u)))
    if options.initial == "equilibrium":
        # The tool comes on when the work begins, or just before.
        start = Sag(arm.tool_off).equilibria(first)[0][0]
    motions: list[DrivenMotion] = [part.motion for part in work.parts]
    forces = [_forces(arm, part) for part in work.parts]
    if options.settle_s > 0:
        motions.append(QuinticTrajectory.held(work.end, options.settle_s))
        forces.append(lambda _: arm.external_forces)
    curve = None
    if is_executed(options):
        curve, moved = executed(work, options)
        motions = list(moved)
    if not arm.robot.coupling.is_free:
        motions = [_OfAllJoints(motion, arm.robot.coupling) for motion in motions]
    system = ElasticSystem.of(arm, modes.damping(options.damping_or(arm.robot.damping_ratio)) + arm.damping)
    integrator = partial(
        GeneralizedAlpha,
        step=options.step_s,
        rho_inf=options.spectral_radius,
        corrections=options.corrections,
        tolerance=_CORRECTION_TOLERANCE,
        # What a controller does between the ends of longer steps would be left out.
        longest=_MAX_STEP_FACTOR if curve is None else 1,
    )
    if arm.robot.tool_ramp and options.initial == "equilibrium":
        waits = _OfAllJoints(QuinticTrajectory.held(first[0], arm.robot.tool_ramp), arm.robot.coupling)
        before = integrator(system).run([waits], start, rate, None, [_force_by(arm, arm.robot.force_share)])
        start, rate = before.u[-1], before.v[-1]
    if ground is not None:
        system, motions, forces = on_accelerated_base(system, motions, forces, ground)
    bent = integrator(system).run(motions, start, rate, progress, forces)

    outputs = int(np.floor(bent.t[-1] / options.output_step_s * (1 + 1e-12))) + 1
    t = options.output_step_s * np.arange(outputs, dtype=np.float64)
    rigid, predicted = expected_tool(arm.robot, work, t, sag)
    q = work.postures(t) if curve is None else curve(t)
    u = _elastic_coordinates(bent, t)
    error = arm.tool_points(q, u, arm.model.createData()) - rigid - predicted
    static = -predicted
    for part, at, own in work.split(t):
        share, sagging = part.force_share(arm.robot, own), partial(_sag, motion=part.motion, t=own)
        static[at] += _with_share(share, partial(sagging, arm), partial(sagging, arm.tool_off))
    execution = execution_error(arm.robot, work, t, options, curve)
    base = None if arm.base is None else _base(arm, u, held)
    return motion_tracking(work, t, rigid + predicted, error, static, modes.frequencies, execution, base)


def _forces(arm: ElasticArm, part: WorkPart) -> ExternalForces:
    """The external forces along a part of the work, from times on its clock."""
    if part.path is None and arm.robot.tool_ramp:
        return _force_by(arm, partial(part.force_share, arm.robot))
    # Nothing is to be worked out at every step of a stroke.
    forces = (arm if part.path is not None else arm.tool_off).external_forces
    return lambda _: forces


def _force_by(arm: ElasticArm, share: Callable[[FloatArray], FloatArray]) -> ExternalForces:
    """External forces of which a share is on the tool, from times (N,)."""

    @lru_cache(maxsize=2)
    def of(share: float) -> Any:
        return arm.pushed_by(share).external_forces

    return lambda t: of(float(share(np.array([t]))[0]))


def _with_share(share: FloatArray, on: Callable[[], FloatArray], off: Callable[[], FloatArray]) -> FloatArray:
    """What a share (N,) of the process force moves (N, 3), of what all of it and none of it does."""
    if (share == 1).all():
        return on()
    none = off()
    return none + share[:, None] * (on() - none) if share.any() else none


@dataclass(frozen=True)
class _OfAllJoints:
    """A motion of all joints, of which some follow those of `motion`."""

    motion: DrivenMotion
    coupling: Coupling

    @property
    def duration(self) -> float:
        return self.motion.duration

    def states(self, times: FloatArray, /) -> tuple[FloatArray, FloatArray, FloatArray]:
        q, v, a = self.motion.states(times)
        return self.coupling.positions(q), self.coupling.rates(v), self.coupling.rates(a)


def _base(arm: ElasticArm, u: FloatArray, held: Sequence[float] | None) -> FloatArray:
    """Motion of a point of the base and torque on it (N, 9) at elastic coordinates `u` (N, f)."""
    at, foot = arm.springs["base", ""], np.array(arm.robot.foot_point)
    base = u[:, at]
    torque = (base @ arm.stiffness[np.ix_(at, at)])[:, 3:] - arm.robot.carrier_torque
    lever = (foot if held is None else np.array(held)) - foot
    base[:, :3] += Rotation.from_euler("XYZ", base[:, 3:]).apply(lever) - lever
    return np.hstack([base, torque])


def expected_tool(
    robot: Robot, work: PrescribedWork, t: FloatArray, sag: Sag | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the rigid arm's tool points at times `t` (N,) and the predicted sag, each (N, 3), m.

    Between strokes it is the sag with the tool off.
    """
    q = work.postures(t)
    rigid, _ = Kinematics(robot).tool_poses(q)
    predicted = np.zeros_like(rigid)
    if sag is not None:
        off = Sag(sag.arm.tool_off)
        for part, at, own in work.split(t):
            along = (partial(some.along, own, q[at]) for some in (sag, off))
            predicted[at] = _with_share(part.force_share(robot, own), *along)
    return rigid, predicted


def execution_error(
    robot: Robot,
    work: PrescribedWork,
    t: FloatArray,
    options: SimulationOptions,
    curve: CubicHermiteSpline | None = None,
) -> FloatArray | None:
    """Return what a controller adds to the error at times `t` (N,), (N, 3), m; None where it adds nothing.

    `curve` is what the joints do, as `executed` finds it; left out, it is found here.
    """
    if not is_executed(options):
        return None
    if curve is None:
        curve, _ = executed(work, options)
    kinematics = Kinematics(robot)
    return kinematics.tool_poses(curve(t))[0] - kinematics.tool_poses(work.postures(t))[0]


def motion_tracking(
    work: PrescribedWork,
    t: FloatArray,
    expected: FloatArray,
    error: FloatArray,
    static: FloatArray,
    frequencies: FloatArray,
    execution: FloatArray | None = None,
    base: FloatArray | None = None,
) -> MotionTracking:
    """Return a tracking error with all that follows from it and from the motion.

    Parameters
    ----------
    work : PrescribedWork
    t : (N,), s
        Equal steps, from 0 to the stop or beyond.
    expected : (N, 3), m
        The expected tool points.
    error, static : (N, 3), m
    frequencies : (f,), Hz
        Of the modes in the motion's first posture, ascending.
    execution : (N, 3), m, optional
        From `execution_error`.
    base : (N, 9), m, rad and Nm, optional
        Displacement and rotation of an elastic base, and the torque on it.
    """
    command, path_error = np.full_like(error, np.nan), np.full_like(error, np.nan)
    for part, at, own in work.split(t):
        if part.path is not None:
            command[at] = expected[at] - part.path.position(own)
            path_error[at] = part.path.leg_offset(own, expected[at] + error[at])
    moving = int(np.searchsorted(t, work.duration * (1 + 1e-12), side="right"))
    return MotionTracking(
        t=t,
        stop=work.duration,
        error=error,
        static=static,
        command=command,
        path_error=path_error,
        execution=execution,
        base=base,
        metrics=error_metrics(t, error, static, path_error, moving, frequencies),
    )


def _sag(arm: ElasticArm, motion: QuinticTrajectory, t: FloatArray) -> FloatArray:
    """Displacement (N, 3), m, of the tool at rest in the postures at times `t` (N,)."""
    from scipy.interpolate import CubicSpline

    def times(step: float) -> FloatArray:
        steps = max(int(np.ceil(motion.duration / step * (1 - 1e-12))), 1)
        return np.linspace(0.0, motion.duration, steps + 1)

    fastest = float(np.abs(motion.states(times(_SAG_STEP))[1]).max())
    slower = min(_QUICK_JOINT_RAD_S / fastest, _LONGEST_SAG_STEP) if fastest > 0 else 1.0
    some = times(_SAG_STEP * max(slower, 1.0))
    tool = CubicSpline(some, Sag(arm).following(motion.states(some)[0]))
    return np.asarray(tool(np.minimum(t, motion.duration)))


def _elastic_coordinates(bent: ElasticMotion, t: FloatArray) -> FloatArray:
    """Elastic coordinates (N, f) at times `t` (N,), which may be between the steps of the integrator."""
    from scipy.interpolate import CubicHermiteSpline

    # Of fourth order: its error is below that of the integrator.
    return np.asarray(CubicHermiteSpline(bent.t, bent.u, bent.v)(t))
