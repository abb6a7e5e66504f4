"""The plan: a certified trajectory, beside the baseline that it is compared with where one is asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from cmbot.accuracy import (
    Accuracy,
    Quietness,
    Shaking,
    Sway,
    Work,
    WorkPath,
    accuracy_of,
    quietness_of,
    stroke_sway,
)
from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.limit import Limit
from cmbot.common.reading.file_types import NonNegative
from cmbot.common.reading.validation import require_type
from cmbot.common.representation import aligned, card
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag, TooSoftError
from cmbot.hold import AdhesionPeak
from cmbot.planning.certification.certificate import Certificate
from cmbot.planning.certification.metrics import MotionMetrics, Samples, measure
from cmbot.planning.certification.sag_spread import across_path, spread_times
from cmbot.planning.job import APPROACH, Job, Segment, force_share
from cmbot.planning.request import end_posture_of, strokes_of
from cmbot.planning.result.baseline import Baseline, baseline_of, joined_samples
from cmbot.planning.result.holding import emergency_stop
from cmbot.planning.result.stroke_plan import StrokePlan, baseline_task, combined
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.workcell import bending_arm, covariance_of, sag_of
from cmbot.robot import Kinematics, Robot
from cmbot.scene import WORK, PlannerOptions, Scene, Stroke, coverage_of, pieces_left_out, rows_alone
from cmbot.toolpath import Coverage, ToolPath
from cmbot.trajectory import QuinticTrajectory, sample_step

if TYPE_CHECKING:
    from cmbot.planning.result.rows import Row

# Steps of time in a period for what the baseline's sway is: its acceleration may jump.
_BASELINE_STEPS = 48


@dataclass(frozen=True, kw_only=True)
class Seconds:
    """Wall time of each stage, s."""

    path: NonNegative
    optimise: NonNegative
    certify: NonNegative
    total: NonNegative


@dataclass(frozen=True, kw_only=True)
class Plan(StrokePlan):
    """A motion whose certificate holds, and the baseline where one is asked for.

    What a `StrokePlan` says of its stroke, a plan says of all of them: of several strokes, the task and the
    start of the first one, the largest peaks and bounds.

    Attributes
    ----------
    scene : Scene
    options : PlannerOptions
        What it was planned with.
    robot : Robot
    baseline : Baseline or None
        That of the whole job.
    job : Job
        The planned motion: strokes in their order; before each the free move that leads to it, where it
        starts elsewhere than the arm is; last the return, where the scene asks for one.
    several : tuple of StrokePlan
        What is planned of each stroke; empty where there is one, which is the plan's own.
    sag : Sag or None
        The sag that was compensated.
    missing : tuple of str
        Names of the scene's strokes that could not be planned, where that was allowed (`plan`, partial).
    fallbacks : tuple of str
        What failed, and what was done instead, a sentence each.
    stopped : str or None
        ``time``: planning was stopped by its time limit. Otherwise the plan is the same on every machine.
    seconds : Seconds
    """

    scene: Scene
    options: PlannerOptions
    robot: Robot
    baseline: Baseline | None
    job: Job
    several: tuple[StrokePlan, ...] = ()
    sag: Sag | None
    fallbacks: tuple[str, ...]
    stopped: Literal["time"] | None = None
    seconds: Seconds
    missing: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        strokes: Sequence[StrokePlan],
        clearances: Clearances,
        *,
        scene: Scene,
        robot: Robot,
        **own: Any,
    ) -> Plan:
        """Return the plan of a job from what is planned of its strokes, and the other fields by name."""
        start, end = np.array(scene.posture), end_posture_of(scene, robot)
        own |= {"scene": scene, "robot": robot}
        own["baseline"] = baseline_of(robot, clearances, strokes, start, end)
        if len(strokes) == 1:
            return cls(**(vars(strokes[0]) | own))
        return cls(**combined(strokes), name=WORK, several=tuple(strokes), **own)

    def __repr__(self) -> str:
        return f"<Plan {self.scene.name}: {self._in_words}>"

    def __str__(self) -> str:
        """Return what is shown first: the `summary`, and at most five sentences."""
        # They are told of what is planned, so they stand above.
        from cmbot.planning.result.words import first_remarks

        return "\n".join([self.summary(), *first_remarks(self)])

    def _repr_html_(self) -> str:
        """Card in a notebook."""
        return card(f"Plan of {self.scene.name}", self._in_words, self.rows(first=True), self.headings)

    @property
    def headings(self) -> tuple[str, ...]:
        """What the columns of `rows` are called."""
        return ("", "planned") if self.baseline is None else ("", "baseline", "planned")

    @property
    def _in_words(self) -> str:
        job, work = (figures.peak_guardrail_torque for figures in (self.job.figures, self.figures))
        other = self.baseline
        before = "" if other is None else f" (baseline {other.figures.peak_guardrail_torque:.1f} Nm)"
        checks = [check for segment in self.job.segments for check in segment.certificate.checks]
        held = sum(check.holds for check in checks)
        return (
            f"peak torque on the {self.scene.base_name} {job:.1f} Nm in {self.job.duration:.1f} s, at work "
            f"{work:.1f} Nm{before}; {held} of {len(checks)} checks hold"
        )

    @property
    def strokes(self) -> tuple[StrokePlan, ...]:
        """What is planned of each stroke."""
        return self.several or (self,)

    @property
    def work(self) -> Job:
        """What lies between the beginning of the first stroke and the end of the last one, from time 0."""
        return self.job.work

    @cached_property
    def trajectory(self) -> QuinticTrajectory:
        """The motion of the work."""
        first, *others = self.work.segments
        return self.work.trajectory if others else first.trajectory

    @property
    def certificate(self) -> Certificate:
        """The certificate of the strokes, times from the beginning of the first one."""
        return self.job.stroke_certificate

    @property
    def figures(self) -> MotionMetrics:
        """Figures of the strokes, as certified."""
        return self.job.stroke_figures if self.several else self.certificate.figures

    @property
    def approach(self) -> Segment | None:
        """The free move from the scene's posture to the start of the work; None where it starts there."""
        return self.job.segment(APPROACH)

    @cached_property
    def samples(self) -> Samples:
        """The work every 0.01 s, from time 0; jobs of more than 400 s have longer steps."""
        first, *others = self.work.segments
        if not others:
            return self.segment_samples[first.name]
        return joined_samples(self._on_the_clock(segment) for segment in self.work.segments)[0]

    @cached_property
    def accuracy(self) -> Accuracy | None:
        """Within how much of its path the tool stays at work.

        None where nothing bends, or where the arm is too soft to carry itself.
        """
        return self.accuracy_while(None)

    def accuracy_while(self, shaking: Shaking | None) -> Accuracy | None:
        """Return `accuracy` while something shakes the base; None as there.

        Parameters
        ----------
        shaking : Shaking or None
            On the clock of the work.
        """
        arm = bending_arm(self.scene, self.robot)
        if arm is None:
            return None
        covariance, begin = covariance_of(self.scene, arm), self.job.strokes[0].begin
        share = self.scene.uncertainty.stiffness_share
        try:
            works = [
                replace(
                    work_of(self.robot, each.trajectory, each.task.path),
                    sway=sway,
                    shaking=shaking and replace(shaking, t=shaking.t - (each.begin - begin)),
                )
                for each, sway in zip(self.job.strokes, self._swaying(arm, share), strict=True)
            ]
            return accuracy_of(
                arm,
                works,
                self.scene.uncertainty,
                self.scene.tool.tolerance,
                compensated=self.compensation is not None,
                covariance=covariance,
            )
        except TooSoftError:
            # Remarks say that the arm is too soft to carry itself.
            return None

    @cached_property
    def _sway_by_share(self) -> dict[float, tuple[Sway, ...]]:
        return {}

    def _swaying(self, arm: ElasticArm, share: float) -> tuple[Sway, ...]:
        """The sway of each stroke, where all stiffness may differ by a share: integrated once for each."""
        if share not in self._sway_by_share:
            self._sway_by_share[share] = tuple(
                stroke_sway(arm, each.trajectory, share) for each in self.job.strokes
            )
        return self._sway_by_share[share]

    @cached_property
    def sway(self) -> Quietness | None:
        """How far the tool sways at work and swings after it; None as of `accuracy`."""
        arm = bending_arm(self.scene, self.robot)
        if arm is None:
            return None
        files = self.scene.strokes
        unshaped = [segment.unshaped(file) for file, segment in zip(files, self.job.strokes, strict=True)]
        share = self.options.quiet_stiffness_share
        try:
            plain = [None if each is None else stroke_sway(arm, each, share) for each in unshaped]
            return quietness_of(share, self._swaying(arm, share), plain)
        except TooSoftError:
            return None

    @cached_property
    def baseline_sway(self) -> tuple[float, float] | None:
        """Largest sway at work, and swing after it, of the baseline, m; None without one, or as of `sway`."""
        arm, baseline = bending_arm(self.scene, self.robot), self.baseline
        if arm is None or baseline is None:
            return None
        share, each = self.options.quiet_stiffness_share, (segment.samples for segment in baseline.strokes)
        motions = (QuinticTrajectory.through(samples.t, samples.q) for samples in each)
        try:
            found = [stroke_sway(arm, motion, share, _BASELINE_STEPS).largest for motion in motions]
        except TooSoftError:
            return None
        return max(sway for sway, _ in found), max(swing for _, swing in found)

    @property
    def approach_samples(self) -> Samples | None:
        """The approach every 0.01 s, from time 0; its tool deviation is that from where the work starts."""
        return self.segment_samples.get(APPROACH)

    @cached_property
    def job_samples(self) -> tuple[Samples, tuple[str, ...]]:
        """The whole job every 0.01 s on one clock, and the name of each sample's segment.

        A join belongs to the segment that ends there. Where sag is compensated the tool is expected with its
        predicted sag in the free moves, too.
        """
        return joined_samples(self._on_the_clock(segment) for segment in self.job.segments)

    def _on_the_clock(self, segment: Segment) -> tuple[str, float, Samples, bool]:
        samples = self.segment_samples[segment.name]
        expected = samples.expected_tool_point
        if self.sag is not None and expected is None:
            # The tool is off: no process force bends the arm.
            sag = sag_of(self.scene, bending_arm(self.scene, self.robot.tool_off), self.options) or self.sag
            expected = samples.tool_point + sag.along(samples.t, samples.q)
        return segment.name, segment.begin, replace(samples, expected_tool_point=expected), False

    @cached_property
    def segment_samples(self) -> dict[str, Samples]:
        """Each segment of the job by its name, every 0.01 s, from time 0."""
        clearances = Clearances(self.robot, self.scene.all_obstacles)
        return {segment.name: self._sampled(segment, clearances) for segment in self.job.segments}

    def _sampled(self, segment: Segment, clearances: Clearances) -> Samples:
        duration, step = segment.duration, sample_step(self.job.duration)
        # The last step is shorter if need be.
        t = step * np.arange(int(np.floor(duration / step * (1 + 1e-12))) + 1, dtype=np.float64)
        t = t if duration - t[-1] < 1e-9 * duration else np.append(t, duration)
        motion = [segment.trajectory.evaluate(t, order) for order in range(4)]
        sag, share = self.sag, None
        if segment.kind == "free":
            sag, share = None, force_share(self.robot, t, duration, segment.name)
        distances = segment.distances(clearances, self.options.safety_margin_m)
        return measure(self.robot, segment.task, distances, t, motion, sag, share=share)

    @cached_property
    def deviation_with_spread(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """What each stroke's tool deviation may be, where sag is compensated by an identified stiffness.

        Times on the job's clock, s, and the expected deviation, m, with as many standard deviations of the
        stiffness as `shown_sigmas` says, `across_path`. Empty where no covariance is known.
        """
        if self.sag is None or self.sag.covariance is None:
            return ()
        found = []
        for segment in self.job.strokes:
            t, samples = spread_times(segment.trajectory), self.segment_samples[segment.name]
            spread = across_path(segment.task.path, self.sag, t, segment.trajectory.evaluate(t))
            expected = np.interp(t, samples.t, samples.tool_deviation)
            found.append((segment.begin + t, expected + self.shown_sigmas * spread))
        return tuple(found)

    @property
    def baseline_tasks(self) -> tuple[ToolTask, ...]:
        """What the baseline follows along each stroke."""
        files = {file.name: file for file in self.scene.strokes}
        return tuple(baseline_task(one.task, files[one.name], self.options) for one in self.strokes)

    @property
    def shown_sigmas(self) -> float:
        """The standard deviations of `deviation_with_spread`: those that are promised, else two."""
        return self.options.deviation_sigmas or 2.0

    @property
    def largest_torque_difference(self) -> tuple[float, float] | None:
        """Largest value over time of baseline's less planned torque norm, Nm, and when in the job, s.

        None without a baseline.
        """
        differences = []
        for stroke, segment in zip(self.strokes, self.job.strokes, strict=True):
            if stroke.baseline is None:
                return None
            samples, other = self.segment_samples[stroke.name], stroke.baseline.samples
            baseline, planned = (np.linalg.norm(each.guardrail_torque, axis=1) for each in (other, samples))
            difference = baseline - np.interp(other.t, samples.t, planned)
            k = int(difference.argmax())
            differences.append((float(difference[k]), float(segment.begin + other.t[k])))
        return max(differences, key=lambda each: each[0])

    @property
    def torque_floor(self) -> float | None:
        """Lower bound of the torque on the guardrail, Nm; None without one, or of another objective."""
        return self.objective.floor if self.objective.is_guardrail_torque else None

    @property
    def torque_floor_kind(self) -> Literal["proven", "estimated"] | None:
        """Whether `torque_floor` is proven or estimated; None without one."""
        bound = None if self.torque_floor is None else self.lower_bound
        return None if bound is None else bound.kind

    @property
    def torque_floor_error(self) -> float | None:
        """How far the true value of `torque_floor` may lie below it, Nm; None without one."""
        bound = None if self.torque_floor is None else self.lower_bound
        return None if bound is None else bound.error

    @property
    def gap_to_floor(self) -> float | None:
        """How far the certified peak torque lies above its lower bound, as a share of it; None without one.

        Negative where a moving arm undercuts the static bound a little.
        """
        return self.objective.gap if self.objective.is_guardrail_torque else None

    @property
    def gap_to_sequences(self) -> float | None:
        """How far the planned peak lies above `least_of_sequences`, as a share of it; None without one."""
        least = self.least_of_sequences
        return self.objective.planned_peak / least - 1.0 if least else None

    @property
    def least_of_sequences(self) -> float | None:
        """Least peak at rest of the sequences of postures that were found, an estimate; None without one."""
        choice = self.choice
        pinned = choice is not None and self.options.start == "pinned" and choice.pinned is not None
        return None if choice is None else choice.pinned if pinned else choice.free

    @property
    def peak_static_reduction(self) -> float | None:
        """How much lower the planned motion's static torque peak is than the baseline's, as a share.

        None without a baseline. Of one that breaks limits (`cmbot.planning.baseline_faults`) that is no gain.
        """
        if self.baseline is None:
            return None
        baseline = self.baseline.figures.peak_static_guardrail_torque
        return 1.0 - self.figures.peak_static_guardrail_torque / baseline

    @cached_property
    def asked_strokes(self) -> tuple[Stroke, ...]:
        """The strokes of the scene, of rasters those of their parts."""
        return strokes_of(self.scene, self.robot)

    @cached_property
    def coverage(self) -> dict[str, Coverage]:
        """What the strokes cover of the surface of each raster, by the raster's name.

        The tool is within its tolerances all along, or there would be no plan.
        """
        return coverage_of(self.asked_strokes)

    @property
    def whole_coverage(self) -> Coverage:
        """What the strokes cover of the surfaces of all rasters together."""
        names = ("area", "left_out", "unreached")
        return Coverage(**{name: sum(getattr(of, name) for of in self.coverage.values()) for name in names})

    @cached_property
    def outlines(self) -> tuple[FloatArray, ...]:
        """Where the tool is to go on each stroke: points (k, 3), m, in W.

        That of a fixed tool is where the part has it when the stroke begins.
        """
        each = zip(self.strokes, self.job.strokes, strict=True)
        return tuple(self._drawn(stroke.task.path, segment.trajectory) for stroke, segment in each)

    def _drawn(self, path: ToolPath, trajectory: QuinticTrajectory) -> FloatArray:
        points = path.outline()
        return Kinematics(self.robot).in_world(np.repeat(trajectory.q[:1], len(points), axis=0), points)

    @cached_property
    def rows_left_out(self) -> tuple[FloatArray, ...]:
        """Where the tool would be along the pieces of rows that rasters leave out: points (k, 3), m, each."""
        lines = list[FloatArray]()
        for file, piece in pieces_left_out(self.asked_strokes):
            if file.raster is not None and file.raster.frame != "tool":
                rows = rows_alone(file, replace(file.raster, pieces=(piece,), overscan_m=0.0))
                (stroke,) = self.scene.with_strokes((rows,)).timed_strokes(np.eye(4))
                lines.append(self._drawn(stroke.path, self.job.strokes[0].trajectory))
        return tuple(lines)

    @cached_property
    def emergency_stop(self) -> AdhesionPeak | None:
        """Largest adhesion needed in an emergency stop; None where no foot holds by adhesion."""
        return emergency_stop(self.scene, self.robot, self.job)

    @property
    def holding_torque(self) -> FloatArray:
        """Largest torques (k,), Nm, of `Robot.holding_joints` over the job, as certified."""
        held = [check for _, check in self.job.checks() if check.limit is Limit.HOLDING_TORQUE]
        peaks = (
            max((check.value for check in held if check.joint == joint.name), default=0.0)
            for joint in self.robot.holding_joints
        )
        return np.array(list(peaks))

    @cached_property
    def bent_deviation(self) -> tuple[list[tuple[FloatArray, FloatArray]], ...]:
        """How far the arm, bent at rest in every posture, is off its path: baseline's strokes, and planned.

        Of each stroke times, s, of the planned on the job's clock, and distances, m, infinite where the arm
        is too soft to carry itself. What sag is compensated is counted. Empty where nothing bends.
        """
        planned, baseline = list[tuple[FloatArray, FloatArray]](), list[tuple[FloatArray, FloatArray]]()
        arm = bending_arm(self.scene, self.robot)
        if arm is None:
            return baseline, planned
        sag, kinematics = Sag(arm), Kinematics(self.robot)

        def offset(task: ToolTask, t: FloatArray, q: FloatArray) -> FloatArray:
            try:
                bent = kinematics.tool_poses(q)[0] + sag.following(q)
            except InputError:
                return np.full(len(t), np.inf)
            return np.asarray(np.linalg.norm(task.path.leg_offset(t, bent), axis=1))

        each = zip(self.strokes, self.baseline_tasks, self.job.strokes, strict=True)
        for stroke, task, segment in each:
            t = spread_times(segment.trajectory)
            planned.append((segment.begin + t, offset(segment.task, t, segment.trajectory.evaluate(t))))
            if stroke.baseline is not None:
                samples = stroke.baseline.samples
                near = np.searchsorted(samples.t, t).clip(max=len(samples.t) - 1)
                baseline.append((samples.t[near], offset(task, samples.t[near], samples.q[near])))
        return baseline, planned

    @property
    def bent_offsets(self) -> tuple[float | None, float | None]:
        """The largest such distance of the baseline, and of the planned motion; None without one."""
        before, after = (max((float(y.max()) for _, y in each), default=None) for each in self.bent_deviation)
        return before, after

    def summary(self) -> str:
        """Return the figures that are shown first as an aligned table of plain text, of at most ten lines."""
        return aligned([self.headings, *self.rows(first=True)])

    @cached_property
    def table(self) -> tuple[Row, ...]:
        """The figures beside the baseline's, those that are shown first at the top."""
        # It is told of what is planned, so it stands above.
        from cmbot.planning.result.rows import plan_rows

        return plan_rows(self)

    def rows(self, *, first: bool = False) -> Iterator[tuple[str, ...]]:
        """Yield the figures, each as its name and unit and the values under `headings`.

        Parameters
        ----------
        first : bool
            Those alone that are shown first, at most ten.
        """
        for row in self.table:
            if row.is_shown_first or not first:
                name, before, planned = row.cells
                yield (name, planned) if self.baseline is None else (name, before, planned)


def require_plan(value: object, source: str) -> None:
    """Refuse what is no plan, such as the path of a plan directory, as an argument of `source`.

    Raises
    ------
    InputError
    """
    require_type(value, Plan, source, "plan", "a Plan, as cmbot.plan and cmbot.load_plan return it")


def work_of(robot: Robot, trajectory: QuinticTrajectory, path: WorkPath) -> Work:
    """Return a stroke of a job, moved along its path by a trajectory, as the accuracy budget takes it."""
    kinematics = Kinematics(robot)

    def tool(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        return kinematics.tool_poses(trajectory.evaluate(t))

    return Work(
        path=path,
        motion=trajectory.evaluate,
        commanded=lambda t: tool(t)[0],
        rotation=lambda t: tool(t)[1],
    )
