"""The job: strokes and free moves in order, on one clock, from the start posture to where the arm ends."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.representation import ShortRepr
from cmbot.hold import AdhesionPeak
from cmbot.planning.certification.certificate import Certificate
from cmbot.planning.certification.check import Check
from cmbot.planning.certification.metrics import LimitUse, MotionMetrics, Samples
from cmbot.planning.task import ToolTask
from cmbot.robot import Robot
from cmbot.scene import StrokeFile
from cmbot.trajectory import QuinticTrajectory, SplineSpace

APPROACH, RETURN = "approach", "return"
"""Names of the free move to the first stroke and of the way back."""

# Intervals of a piece of a spline at whose ends it is looked at, and share by which times may differ.
_PLACES_OF_A_PIECE, _SAME_TIME = 6, 1e-9


def stands_of(name: str, ramp: float) -> tuple[float, float]:
    """Return how long the arm stands before and after a free move: beside strokes for the force's `ramp`."""
    return ramp * (name != APPROACH), ramp * (name != RETURN)


def force_share(robot: Robot, t: FloatArray, duration: float, name: str = "") -> FloatArray:
    """Return the share of the process force on a free move, at times `t` (N,), s, on its own clock.

    Beside strokes it ends, and sets in again, while the arm stands; without a ramp it is off all along.
    """
    before, after = stands_of(name, robot.tool_ramp)
    share = 1 - robot.force_share(t) if before else np.zeros_like(t)
    return share + robot.force_share(t - (duration - after)) if after else share


def free_move_name(stroke: int) -> str:
    """Return the name of the free move that leads to a stroke, counted from 0."""
    return f"free_{stroke}" if stroke else APPROACH


@dataclass(frozen=True, kw_only=True)
class _Timed(ShortRepr):
    """A part of a job, on its clock."""

    name: str
    kind: Literal["stroke", "free"]
    begin: float

    @property
    @abstractmethod
    def duration(self) -> float:
        """Its duration, s."""

    @property
    def end(self) -> float:
        """When it ends on the job's clock, s."""
        return self.begin + self.duration


@dataclass(frozen=True, kw_only=True)
class Segment(_Timed):
    """A part of a job: a stroke with the tool on, or a free move with the tool off.

    Attributes
    ----------
    name : str
        That of a stroke, ``work`` where it has none; of a free move ``approach``, ``free_1`` and so on
        between strokes, ``return``.
    kind : str
        ``stroke`` or ``free``.
    begin : float, s
        When it begins on the job's clock.
    trajectory : QuinticTrajectory
        From rest to rest, its own clock begins at 0.
    certificate : Certificate
        Of a free move the tool deviation is the distance of the tool point from where the work starts; it is
        not bounded.
    task : ToolTask
        Of a stroke its tool path; of a free move the tool held where the work starts.
    along_self_motion : bool
        The path of a free move leads along the self-motion, so that the tool stays about where it is.
    """

    trajectory: QuinticTrajectory
    certificate: Certificate
    task: ToolTask
    along_self_motion: bool = False

    @property
    def duration(self) -> float:
        """Its duration, s."""
        return self.trajectory.duration

    @property
    def in_words(self) -> str:
        """What messages call a free move: the approach, free_1, the return."""
        return f"the {self.name}" if self.name in (APPROACH, RETURN) else self.name

    @property
    def figures(self) -> MotionMetrics:
        """Its figures, as certified."""
        return self.certificate.figures

    def distances(self, clearances: Clearances, margin: float) -> Clearances:
        """Return the distances that count along it: of a free move those of `Clearances.no_deeper`."""
        if self.kind == "stroke":
            return clearances
        return clearances.no_deeper(self.trajectory.q[[0, -1]], margin)

    def moved_in_ramps(self, ramp: float) -> float:
        """Return how far joints move, rad or m, in a free move's `stands_of`; infinite if it is shorter."""
        t, moved = self.trajectory.t, 0.0
        before, after = stands_of(self.name, ramp)
        if self.duration < (1 - _SAME_TIME) * (before + after):
            return np.inf
        for first, last, rest in (
            (t[0], t[0] + before, self.trajectory.q[0]),
            (t[-1] - after, t[-1], self.trajectory.q[-1]),
        ):
            ends = np.concatenate([[first], t[(t > first) & (t < last)], [last]])
            # A polynomial of the fifth degree that is the same at six places is constant.
            places = np.linspace(0, len(ends) - 1, _PLACES_OF_A_PIECE * (len(ends) - 1) + 1)
            at = self.trajectory.evaluate(np.interp(places, np.arange(len(ends)), ends))
            moved = max(moved, float(np.abs(at - rest).max()))
        return moved

    def unshaped(self, file: StrokeFile) -> QuinticTrajectory | None:
        """Return a quiet stroke's joint path by the law of its profile alone; None if no law was chosen."""
        if file.is_open or not file.time_laws:
            return None
        plain = self.task.path.with_law(file.speed_profile.law, {law.leg for law in file.time_laws})
        space = SplineSpace(plain.times_at(*self.task.path.leg_shares(self.trajectory.t)))
        return space.trajectory(space.least_jerk(self.trajectory.q))


@dataclass(frozen=True, kw_only=True)
class BaselineSegment(_Timed):
    """A part of the baseline's job, as of the planned one.

    Attributes
    ----------
    name : str
    kind : str
        ``stroke`` or ``free``.
    begin : float, s
        When it begins on the clock of the baseline's job.
    samples : Samples
        Its own clock begins at 0.
    figures : MotionMetrics
    """

    samples: Samples
    figures: MotionMetrics

    @property
    def duration(self) -> float:
        """Its duration, s."""
        return float(self.samples.t[-1])


T = TypeVar("T", Segment, BaselineSegment)


class Timeline(Generic[T], ShortRepr):
    """Segments one after the other, on one clock from 0."""

    segments: tuple[T, ...]

    @property
    def duration(self) -> float:
        """Time of all of it, s."""
        return self.segments[-1].end

    @property
    def strokes(self) -> tuple[T, ...]:
        """The segments with the tool on."""
        return tuple(segment for segment in self.segments if segment.kind == "stroke")

    @property
    def moves_between(self) -> tuple[T, ...]:
        """The free moves between strokes."""
        free = (segment for segment in self.segments if segment.kind == "free")
        return tuple(segment for segment in free if segment.name not in (APPROACH, RETURN))

    def segment(self, name: str) -> T | None:
        """Return the segment of that name; None where there is none."""
        return next((segment for segment in self.segments if segment.name == name), None)

    @cached_property
    def free_figures(self) -> MotionMetrics | None:
        """The figures of the free moves together; None without any."""
        moves = [segment for segment in self.segments if segment.kind == "free"]
        return job_metrics(moves) if moves else None


@dataclass(frozen=True, kw_only=True)
class Job(Timeline[Segment]):
    """A certified motion: segments one after the other, continuous postures and rest at the joins.

    Attributes
    ----------
    segments : tuple of Segment
        In the order of time; the first begins at 0.
    """

    segments: tuple[Segment, ...]

    def changed(self, name: str, **changes: Any) -> Job:
        """Return the job with other fields of the segment of that name."""
        return replace(
            self,
            segments=tuple(
                replace(segment, **changes) if segment.name == name else segment for segment in self.segments
            ),
        )

    @cached_property
    def work(self) -> Job:
        """What lies between the beginning of the first stroke and the end of the last one, from time 0."""
        return _from_zero(at_work(self.segments))

    @cached_property
    def figures(self) -> MotionMetrics:
        """The figures of all segments together; the tool's are those of the strokes."""
        return job_metrics(self.segments)

    @cached_property
    def stroke_figures(self) -> MotionMetrics:
        """The figures of the strokes together."""
        return job_metrics(self.strokes, begin=self.strokes[0].begin)

    @cached_property
    def stroke_certificate(self) -> Certificate:
        """The promises of the strokes as one statement, times from the beginning of the first one."""
        strokes = self.strokes
        return _from_zero(strokes).certificate if len(strokes) > 1 else strokes[0].certificate

    @cached_property
    def trajectory(self) -> QuinticTrajectory:
        """The whole motion on the job's clock."""
        timed = (replace(each.trajectory, t=each.begin + each.trajectory.t) for each in self.segments)
        return QuinticTrajectory.joined(list(timed))

    @cached_property
    def certificate(self) -> Certificate:
        """All promises of all segments as one statement, times on the job's clock."""
        each = [segment.certificate for segment in self.segments]
        return Certificate(
            checks=tuple(check for _, check in self.checks()),
            figures=self.figures,
            clearance_bound=min(certificate.clearance_bound for certificate in each),
            guardrail_torque_bound=max(certificate.guardrail_torque_bound for certificate in each),
            adhesion_bound=max(certificate.adhesion_bound for certificate in each),
        )

    def checks(self) -> Iterator[tuple[Segment, Check]]:
        """Yield every promise with the segment that makes it, its time on the job's clock."""
        for segment in self.segments:
            for check in segment.certificate.checks:
                yield segment, replace(check, time=segment.begin + check.time)


def at_work(segments: Sequence[T]) -> Sequence[T]:
    """Return the segments from the first stroke to the last one."""
    strokes = [number for number, segment in enumerate(segments) if segment.kind == "stroke"]
    return segments[strokes[0] : strokes[-1] + 1]


def _from_zero(segments: Sequence[Segment]) -> Job:
    """Segments of a job as one of their own."""
    begin = segments[0].begin
    return Job(segments=tuple(replace(each, begin=each.begin - begin) for each in segments))


def job_metrics(segments: Iterable[Segment | BaselineSegment], begin: float = 0.0) -> MotionMetrics:
    """Return the figures of segments one after the other.

    Parameters
    ----------
    segments : iterable of Segment or BaselineSegment
        Where the tool is off, its place is no figure: of free moves alone those are 0.
    begin : float, s
        From which times are counted, on the job's clock.
    """
    segments = list(segments)
    each = [segment.figures for segment in segments]
    strokes = [segment.figures for segment in segments if segment.kind == "stroke"]
    seconds = np.array([segment.duration for segment in segments])
    mean = np.average([figures.mean_guardrail_torque for figures in each], weights=seconds)
    square = np.square([figures.rms_guardrail_torque for figures in each])
    use = {
        field.name: max(getattr(figures.limit_use, field.name) for figures in each)
        for field in fields(LimitUse)
    }
    return MotionMetrics(
        peak_guardrail_torque=max(figures.peak_guardrail_torque for figures in each),
        mean_guardrail_torque=float(mean),
        rms_guardrail_torque=float(np.sqrt(np.average(square, weights=seconds))),
        peak_static_guardrail_torque=max(figures.peak_static_guardrail_torque for figures in each),
        min_clearance=min(figures.min_clearance for figures in each),
        max_tool_deviation=max((figures.max_tool_deviation for figures in strokes), default=0.0),
        max_tool_rotation=max((figures.max_tool_rotation for figures in strokes), default=0.0),
        max_tool_lag=max((figures.max_tool_lag for figures in strokes), default=0.0),
        limit_use=LimitUse(**use),
        adhesion_needed=_largest_adhesion(segments, begin),
        duration=float(seconds.sum()),
        guardrail_torque_integral=float(mean * seconds.sum()),
    )


def _largest_adhesion(segments: Iterable[Segment | BaselineSegment], begin: float) -> AdhesionPeak | None:
    """The largest of segments, against tipping and a gap too; None where one is not known."""
    peaks = list[AdhesionPeak]()
    for segment in segments:
        needed = segment.figures.adhesion_needed
        if needed is None:
            return None
        peaks.append(replace(needed, time=segment.begin - begin + needed.time))
    tip, gap = max(each.tip for each in peaks), max(each.gap for each in peaks)
    return replace(max(peaks, key=lambda each: each.peak), tip=tip, gap=gap)
