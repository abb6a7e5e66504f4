"""The motion of an attempt: optimised, certified, with the free moves that go with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import LimitViolation, OptimisationFailed, PathNotFound
from cmbot.optimization import ExchangeReport
from cmbot.planning.attempts.agenda import Solved
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.attempts.failure import Failure, attempted, failure_of
from cmbot.planning.attempts.remedies import is_little_nearer
from cmbot.planning.certification.certificate import Certificate, certify
from cmbot.planning.flexibility.sag_compensation import Compensation, optimise_bent
from cmbot.planning.flexibility.vibration_suppression import suppress_vibration
from cmbot.planning.free_motion.approach import approach_way, plan_approach
from cmbot.planning.free_motion.free_move import largest_objective
from cmbot.planning.free_motion.return_move import SAME_POSTURE, plan_return
from cmbot.planning.initial_guess import Aim, InitialGuess, leap_failure
from cmbot.planning.job import Job, Segment
from cmbot.planning.request import StrokeRequest
from cmbot.planning.result.stroke_plan import Start
from cmbot.planning.torque import Optimised, optimise
from cmbot.trajectory import QuinticTrajectory

# Durations that differ by less are the same, as a share.
_SAME_DURATION_SHARE = 1e-9


@dataclass(frozen=True, kw_only=True)
class StrokeMotion:
    """The optimised and certified motion of a stroke, with the free moves that go with it.

    Attributes
    ----------
    request : StrokeRequest
    guess : InitialGuess
        What it was planned from.
    optimised : Optimised
    compensation : Compensation or None
    start : Start
    job : Job
    peak : float
        Largest value of the objective over the job.
    """

    request: StrokeRequest
    guess: InitialGuess
    optimised: Optimised
    compensation: Compensation | None
    start: Start
    job: Job
    peak: float

    @property
    def work(self) -> Segment:
        """The stroke itself."""
        return self.job.strokes[0]

    @property
    def approach(self) -> Segment | None:
        """The free move to its start, if there is one."""
        first = self.job.segments[0]
        return first if first.kind == "free" else None


def certified_motion(attempt: Attempt) -> Solved[StrokeMotion] | Failure:
    """Optimise and certify the motion of an attempt, with the free moves that go with it."""
    request, guess = attempt.request, attempt.guess
    if not isinstance(guess, InitialGuess):
        return guess
    try:
        guess = _with_way(request, guess)
        optimised, compensation = _optimised(request, guess)
        request.reporter.stage("certify")
        posture = optimised.trajectory.q[0]
        moved = _moved(request, posture)
        start = request.state.posture if moved <= SAME_POSTURE else None
        if start is not None:
            # It follows on what was before without a jump: a file has one knot there.
            optimised = replace(optimised, trajectory=optimised.trajectory.begun_at(start))
        certificate = _certified(request, optimised, start)
        if not isinstance(certificate, Certificate):
            return certificate
        approach: Segment | None = None
        if start is not None:
            posture, moved = start, 0.0
        else:
            approach = _approach(request, guess, optimised.trajectory)
        work = Segment(
            name=request.stroke.name,
            kind="stroke",
            begin=request.state.begin if approach is None else approach.end,
            trajectory=optimised.trajectory,
            certificate=certificate,
            task=request.task,
        )
        before = () if approach is None else (approach,)
        back = _return(request, (*before, work))
        job = Job(segments=(*before, work, *(() if back is None else (back,))))
        motion = StrokeMotion(
            request=request,
            guess=guess,
            optimised=optimised,
            compensation=compensation,
            start=Start(posture=posture, moved=moved, failures=guess.failures),
            job=job,
            peak=peak_of(request, job.segments),
        )
        return Solved(result=motion)
    except (PathNotFound, OptimisationFailed, LimitViolation) as error:
        return failure_of(request, error)


def with_way(attempt: Attempt) -> Solved[Attempt] | Failure:
    """Find the way to where an attempt starts: the attempt with it, or why nothing leads there."""
    request, guess = attempt.request, attempt.guess
    if not isinstance(guess, InitialGuess):
        return guess
    found = attempted(request, lambda: _with_way(request, guess))
    return Solved(result=replace(attempt, guess=found)) if isinstance(found, InitialGuess) else found


def is_better(request: StrokeRequest) -> Callable[[StrokeMotion, StrokeMotion], bool]:
    """Return how motions of a stroke compare: the shorter one is better, then that of the smaller peak."""
    margin = 1 + request.cell.options.min_gain

    def better(motion: StrokeMotion, best: StrokeMotion) -> bool:
        seconds, most = motion.work.duration, best.work.duration
        if abs(seconds - most) > _SAME_DURATION_SHARE * most:
            return seconds < most
        return margin * motion.peak <= best.peak

    return better


def peak_of(request: StrokeRequest, parts: Sequence[Segment]) -> float:
    """Return the largest value of the objective over segments."""
    return max(
        largest_objective(
            request.cell if segment.kind == "stroke" else request.cell.tool_off, segment.trajectory
        )
        for segment in parts
    )


def _optimised(request: StrokeRequest, guess: InitialGuess) -> tuple[Optimised, Compensation | None]:
    """The optimised motion, with sag compensated and vibration suppressed where something bends."""
    cell = request.cell
    request.reporter.stage("optimise")

    def each_pass(report: ExchangeReport) -> None:
        request.reporter.passed(report, request.objective.unit)

    compensation, problem = None, guess.problem
    kept = Optimised.start(problem) if guess.aim is Aim.KEPT else None
    try:
        if cell.sag is None:
            feasible = guess.aim is Aim.FEASIBLE
            optimised = kept or optimise(problem, each_pass, feasible=feasible)
        else:
            optimised, compensation, problem = optimise_bent(request, guess, cell.sag, each_pass)
    except OptimisationFailed as failure:
        leaps = leap_failure(guess.problem)
        if leaps is None:
            raise
        raise leaps from failure
    # What is kept was brought to rest before.
    if kept is None and cell.arm is not None and cell.options.knots == "sliding" and cell.options.quiet_modes:
        optimised = suppress_vibration(cell.arm, problem, optimised)
    return optimised, compensation


def _certified(
    request: StrokeRequest, optimised: Optimised, start: FloatArray | None
) -> Certificate | Failure:
    """The certificate of an optimised motion; where none holds, the failure is the solver's if it has one."""
    cell = request.cell
    certificate = certify(
        cell.robot,
        request.task,
        optimised.trajectory,
        cell.clearances,
        cell.options,
        via_points=len(request.times),
        start=start,
        sag=cell.sag,
        arm=cell.arm,
    )
    try:
        certificate.require()
    except LimitViolation as violation:
        failure = failure_of(request, violation, optimised.trajectory)
        if optimised.failure is not None and not is_little_nearer(failure):
            return failure_of(request, optimised.failure)
        return failure
    return certificate


def _moved(request: StrokeRequest, posture: FloatArray) -> float:
    """How far a posture (n,) is from where the arm is."""
    return float(np.abs(request.cell.robot.metric.coordinates(posture - request.state.posture)).max())


def _with_way(request: StrokeRequest, guess: InitialGuess) -> InitialGuess:
    """The guess with a way to where it starts: where none leads there nothing need be optimised."""
    start = guess.problem.parametrization.via_points[0]
    is_known = guess.way is not None or guess.aim is not Aim.OPTIMUM
    if is_known or _moved(request, start) <= SAME_POSTURE:
        return guess
    way = approach_way(request, start, _chart(request, guess), dispensable=_is_dispensable(request, guess))
    return replace(guess, way=way)


def _approach(request: StrokeRequest, guess: InitialGuess, trajectory: QuinticTrajectory) -> Segment:
    """The free move to where a trajectory starts."""
    request.reporter.step("planning the approach to the start")
    allowed = float(request.cell.objective.at_rest(request.cell.postures.at(trajectory.q)).max())
    chart, others = _chart(request, guess), _is_dispensable(request, guess)
    return plan_approach(request, trajectory.q[0], chart, way=guess.way, allowed=allowed, dispensable=others)


def _chart(request: StrokeRequest, guess: InitialGuess) -> FloatArray:
    """Postures (M, n) that hold the tool where the stroke starts."""
    return request.first[None] if guess.search is None else guess.search.first_chart.q


def _is_dispensable(request: StrokeRequest, guess: InitialGuess) -> bool:
    """Whether there are other starts than a guess's, or the arm can stay where it is."""
    others = guess.search is not None and request.stroke.begins_elsewhere and guess.way is None
    return others or (guess.choice is not None and guess.choice.pinned is not None)


def _return(request: StrokeRequest, before: tuple[Segment, ...]) -> Segment | None:
    """The return of a job after what is planned of it."""
    if request.end_posture is None:
        return None
    request.reporter.step("planning the return")
    work, allowed = before[-1], max(request.state.reached, peak_of(request, before))
    return plan_return(request, work.trajectory.q[-1], begin=work.end, allowed=allowed)
