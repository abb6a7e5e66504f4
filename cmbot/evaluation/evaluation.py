"""What a motion does to the base, certified and measured as a plan is, beside what `plan` gives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic_core import from_json, to_json

from cmbot.accuracy import Accuracy, Work, WorkPath, accuracy_of, sway_along
from cmbot.collision import Clearances
from cmbot.common.errors import InputError
from cmbot.common.limit import Limit
from cmbot.common.reading.validation import counted, require_type
from cmbot.common.representation import aligned
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag, TooSoftError
from cmbot.evaluation.motion import JointMotion
from cmbot.evaluation.strokes import FollowedPath, Part, cut, parts_of_motion
from cmbot.planning import (
    RETURN,
    Certificate,
    Check,
    Job,
    Plan,
    Samples,
    Segment,
    ToolTask,
    bending_arm,
    certify,
    certify_move,
    covariance_of,
    free_move_name,
    joined_samples,
    measure,
    robot_of,
    sag_of,
    strokes_of,
    task_of,
    work_of,
)
from cmbot.robot import Kinematics, Robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.toolpath import AUTO
from cmbot.trajectory import QuinticTrajectory

# Between two postures whose sag is computed, s, and postures of a segment at most.
_SAG_INTERVAL, _POSTURES_OF_SEGMENT = 0.05, 400
# Between two samples of a table, s.
_TABLE_STEP_S = 0.01
# Columns that are named.
_MAX_NAMED_COLUMNS = 5
# What counts as the scene's start, rad and m.
_START_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Bending:
    """How the tool moves by what bends, over a whole job.

    Attributes
    ----------
    sag_mm : float
        Largest displacement of the tool at rest in the postures of the motion.
    sway_mm : float
        Largest displacement beside that, by small vibrations about the moving equilibrium.
    accuracy : Accuracy or None
        Of the strokes.
    """

    sag_mm: float
    sway_mm: float
    accuracy: Accuracy | None


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """What a motion does, segment by segment, and what a plan of the same job does.

    Attributes
    ----------
    scene : Scene
    options : PlannerOptions
        Whose bounds the certificate is judged by.
    robot : Robot
    motion : JointMotion
    job : Job
        The strokes that were found in it, and the free moves around them, with their certificates; checks may
        not hold. The tool of a stroke in another timing than the scene's is measured, not certified, from the
        nearest place of its path.
    untimed : tuple of str
        Names of the strokes in another timing.
    missing : tuple of str
        Names of the strokes that the motion does not follow.
    bending : Bending or None
        None where nothing bends, or what bends is too soft to carry itself.
    plan : Plan or None
        The plan beside which it is told.
    planned_bending : Bending or None
        Of that.
    """

    scene: Scene
    options: PlannerOptions
    robot: Robot
    motion: JointMotion
    job: Job
    untimed: tuple[str, ...]
    missing: tuple[str, ...]
    bending: Bending | None
    plan: Plan | None
    planned_bending: Bending | None

    def __repr__(self) -> str:
        peak, broken = self.job.figures.peak_guardrail_torque, len(self.broken)
        return (
            f"<Evaluation {self.scene.name}: peak torque on the {self.scene.base_name} {peak:.1f} Nm in "
            f"{self.job.duration:.1f} s; {broken} of {len(list(self.job.checks()))} checks do not hold>"
        )

    @property
    def broken(self) -> tuple[tuple[Segment, Check], ...]:
        """The checks that do not hold, each with its segment, on the clock of the motion."""
        return tuple((segment, check) for segment, check in self.job.checks() if not check.holds)

    @cached_property
    def samples(self) -> tuple[Samples, tuple[str, ...]]:
        """The motion every 0.01 s on its clock, and the name of each sample's segment."""
        clearances = Clearances(self.robot, self.scene.all_obstacles)
        each = list[tuple[str, float, Samples, bool]]()
        for segment in self.job.segments:
            robot = self.robot if segment.kind == "stroke" else self.robot.tool_off
            distances = segment.distances(clearances, self.options.safety_margin_m)
            t = np.linspace(0.0, segment.duration, int(np.ceil(segment.duration / _TABLE_STEP_S)) + 1)
            motion = [segment.trajectory.evaluate(t, order) for order in range(4)]
            held = segment.task.held_at_start()
            each.append((segment.name, segment.begin, measure(robot, held, distances, t, motion), False))
        return joined_samples(each)

    def rows(self) -> Iterator[tuple[str, str, str]]:
        """Yield the figures, each as its name and unit, the motion's value and the planned one."""
        jobs = (self.job, None if self.plan is None else self.plan.job)
        for name, attribute, factor, digits, at_work in _FIGURE_ROWS:
            values = [_figure(job, attribute, at_work=at_work) for job in jobs]
            if values[0] is not None:
                yield _row(name.format(base=self.scene.base_name), values, factor, digits)
        needed = [None if job is None else job.figures.adhesion_needed for job in jobs]
        if needed[0] is not None:
            peaks = [None if each is None else each.peak for each in needed]
            yield _row("adhesion needed, kN", peaks, 1e-3, 2)
        bending = (self.bending, self.planned_bending)
        if self.bending is not None:
            sag, sway = ([getattr(each, name, None) for each in bending] for name in ("sag_mm", "sway_mm"))
            yield _row("sag of the tool, mm", sag, 1.0, 2)
            yield _row("sway of the tool, mm", sway, 1.0, 2)
            if (accuracy := self.bending.accuracy) is not None:
                within = [getattr(getattr(each, "accuracy", None), "within_mm", None) for each in bending]
                yield _row(f"within its path with {100 * accuracy.probability:g} %, mm", within, 1.0, 2)
        yield _row("largest share of a joint's bound", [_largest_use(job) for job in jobs], 1.0, 3)
        yield _row("time, s", [getattr(job, "duration", None) for job in jobs], 1.0, 2)

    def summary(self) -> str:
        """Return the figures as an aligned table of plain text."""
        return aligned([("", "motion", "planned"), *self.rows()])

    def remarks(self) -> Iterator[str]:
        """Yield what is to be said of how it was judged, and which checks do not hold."""
        motion, job = self.motion, self.job
        kind = "the quintics of its velocities and accelerations" if motion.is_quintic else "a C2 spline"
        apart = (
            f"; the other curve is up to {motion.spread:.2g} rad (or m) away" if motion.v is not None else ""
        )
        yield f"Judged as {kind} through {len(motion.t)} points{apart}."
        checks, broken = list(job.checks()), self.broken
        if not broken:
            bounds = job.certificate.at_all_times(self.scene.base_name)
            yield f"Certified: {len(checks)} checks hold; {bounds}."
        for segment, check in broken:
            sign = "at least" if check.at_least else "at most"
            yield (
                f"Broken in {segment.name}, at {check.time:.2f} s: {check.quantity} is {check.value:.4g} "
                f"{check.unit}, {sign} {check.bound:.4g} is allowed."
            )
        if self.untimed:
            yield (
                f"In another timing than the scene's: {', '.join(self.untimed)}; there the tool is compared "
                "with the nearest place of its path, at samples, and not certified."
            )
        if self.missing:
            yield f"Not followed: {', '.join(self.missing)}; what is no stroke is taken with the tool off."
        start = float(np.abs(motion.q[0] - self.scene.posture).max())
        if start > _START_TOLERANCE:
            yield f"It starts up to {start:.4g} rad (or m) a joint from the scene's posture."
        rates = np.abs(job.trajectory.v[[0, -1]]) / self.robot.limits.velocity
        if rates.max() > _START_TOLERANCE:
            which = "begin" if rates[0].max() > _START_TOLERANCE else "end"
            yield f"It does not {which} at rest."
        if motion.unknown:
            more = "" if len(motion.unknown) <= _MAX_NAMED_COLUMNS else " and so on"
            yield f"Not read: {', '.join(motion.unknown[:_MAX_NAMED_COLUMNS])}{more}."


def evaluate(
    scene: Scene,
    t: ArrayLike | JointMotion,
    q: ArrayLike | None = None,
    v: ArrayLike | None = None,
    a: ArrayLike | None = None,
    *,
    options: PlannerOptions | None = None,
    plan: Plan | None = None,
) -> Evaluation:
    """Judge a motion that was planned elsewhere by a scene, as plans are judged.

    It is taken as the quintics that its velocities and accelerations give, or, without these, as the C2
    spline through its points. Torque on the base, joint torques, clearance, hold and the bounds of joints are
    certified for all times; where the tool follows the scene's path in the scene's timing, so is the tool.

    Parameters
    ----------
    scene : Scene
    t : (N,), s
        Or a `JointMotion` with all of it, as `read_motion` gives it.
    q : (N, n), rad, of joints that slide m
        In the order of the arm's joints.
    v, a : (N, n), optional
        Velocities and accelerations.
    options : PlannerOptions, optional
        In place of the scene's own. With ``compensate: auto`` the tool that is held to the path is the bent
        arm's where that is nearer to it than the rigid arm's.
    plan : Plan, optional
        Of the same scene, beside which it is told; strokes then have the timing that was planned. The motion
        of a plan directory has its own, where the scene has that plan's strokes.

    Raises
    ------
    InputError
        When these are no such numbers, or times do not increase.
    SceneError, ModelError
        When scene and robot do not fit together.

    Examples
    --------
    >>> motion = plan.job.trajectory
    >>> report = cmbot.evaluate(plan.scene, motion.t, motion.q, motion.v, motion.a)
    >>> f"{report.job.figures.peak_guardrail_torque:.1f} Nm"
    '486.4 Nm'
    """
    require_type(scene, Scene, "cmbot.evaluate", "scene", "a Scene, as cmbot.load_scene returns it")
    motion = t if isinstance(t, JointMotion) else _given(t, q, v, a)
    options, robot = options or scene.planner, robot_of(scene)
    if motion.q.shape[1] != robot.dof:
        got = counted(motion.q.shape[1], "column")
        raise InputError("cmbot.evaluate", "q", got, f"{robot.dof}, one for each joint of the arm")
    timed = _timed_as(motion, scene)
    if plan is None or timed is not scene:
        strokes = strokes_of(timed, robot)
        names = [stroke.name for stroke in strokes]
        tasks = [task_of(stroke, scene) for stroke in strokes]
    else:
        names = [segment.name for segment in plan.job.strokes]
        tasks = [segment.task for segment in plan.job.strokes]
    parts = parts_of_motion(robot, motion.trajectory, tasks, options)
    compensated = options.compensate
    if compensated == AUTO:
        compensated = _follows_bent(bending_arm(scene, robot), motion.trajectory, parts, tasks)
    options = replace(options, compensate=compensated)
    sag = sag_of(scene, bending_arm(scene, robot), options) if compensated else None
    judge = _Judge(scene=scene, robot=robot, options=options, names=names, tasks=tasks, sag=sag)
    job = Job(segments=tuple(judge.segments(motion, parts)))
    untimed = {names[part.number] for part in parts if part.number is not None and not part.is_timed}
    found = {segment.name for segment in job.strokes}
    return Evaluation(
        scene=scene,
        options=options,
        robot=robot,
        motion=motion,
        job=job,
        untimed=tuple(name for name in names if name in untimed),
        missing=tuple(name for name in names if name not in found),
        bending=_bending(scene, robot, job, untimed, compensated=compensated),
        plan=plan,
        planned_bending=None if plan is None else _planned_bending(plan),
    )


def _timed_as(motion: JointMotion, scene: Scene) -> Scene:
    """The scene with the time laws of the plan whose motion it is, where that has the same strokes else."""
    planned = [
        each.changed(time_laws=None, via_points=own.via_points)
        for each, own in zip(motion.strokes, scene.strokes, strict=False)
    ]
    same = motion.strokes and tuple(planned) == scene.strokes
    return scene.with_strokes(motion.strokes, scene.order) if same else scene


def evaluation_json(evaluation: Evaluation) -> dict[str, Any]:
    """Return an evaluation as plain data for JSON; what is infinite is null."""
    plan = evaluation.plan
    return {
        "scene": evaluation.scene.name,
        "points": len(evaluation.motion.t),
        "spread_rad": evaluation.motion.spread,
        "motion": _told(evaluation.job, evaluation.bending),
        "planned": None if plan is None else _told(plan.job, evaluation.planned_bending),
        "segments": [
            {
                "name": segment.name,
                "kind": segment.kind,
                "begin": segment.begin,
                "end": segment.end,
                "checks": [{**_plain(check), "holds": check.holds} for check in segment.certificate.checks],
            }
            for segment in evaluation.job.segments
        ],
        "untimed": list(evaluation.untimed),
        "missing": list(evaluation.missing),
        "remarks": list(evaluation.remarks()),
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class _Judge:
    """By what the parts of a motion are judged."""

    scene: Scene
    robot: Robot
    options: PlannerOptions
    names: list[str]
    tasks: list[ToolTask]
    sag: Sag | None

    def segments(self, motion: JointMotion, parts: list[Part]) -> Iterator[Segment]:
        """Yield the parts of a motion as segments with their certificates."""
        clearances, begin = Clearances(self.robot, self.scene.all_obstacles), 0.0
        for k, part in enumerate(parts):
            after = next((each.number for each in parts[k:] if each.number is not None), None)
            task = self.tasks[len(self.tasks) - 1 if after is None else after]
            is_timed = part.number is not None and part.is_timed
            duration = task.path.duration if is_timed else part.end - part.begin
            trajectory = cut(motion.trajectory, part.begin, part.end, duration)
            own = task if is_timed else task.held_at_start()
            given = self.robot, own, trajectory, clearances, self.options
            if part.number is None:
                certificate = certify_move(*given)
            elif is_timed:
                arm = bending_arm(self.scene, self.robot)
                certificate = certify(*given, via_points=0, sag=self.sag, arm=arm)
            else:
                certificate = self._with_nearest(certify(*given, via_points=None), trajectory, task)
            name = free_move_name(after) if after is not None else RETURN
            yield Segment(
                name=name if part.number is None else self.names[part.number],
                kind="free" if part.number is None else "stroke",
                begin=begin,
                trajectory=trajectory,
                certificate=_without_continuity(certificate),
                task=own if part.number is None else task,
            )
            begin += duration

    def _with_nearest(self, certificate: Certificate, trajectory: Any, task: ToolTask) -> Certificate:
        """The certificate with the tool's distance from the nearest place of its path."""
        followed = FollowedPath(path=task.path, robot=self.robot, trajectory=trajectory)
        distance, rotation = followed.largest_offsets(task)
        figures = replace(
            certificate.figures, max_tool_deviation=distance, max_tool_rotation=rotation, max_tool_lag=0.0
        )
        return replace(certificate, figures=figures)


def _without_continuity(certificate: Certificate) -> Certificate:
    """The certificate without what a C2 motion need not keep: a jerk without jumps, and rest at its ends."""
    kept = tuple(check for check in certificate.checks if check.limit is not Limit.CONTINUITY)
    return replace(certificate, checks=kept)


def _bending(scene: Scene, robot: Robot, job: Job, untimed: set[str], *, compensated: bool) -> Bending | None:
    """What bends moves the tool by so much; None where nothing does, or it is too soft."""
    arm, off = bending_arm(scene, robot), bending_arm(scene, robot.tool_off)
    if arm is None or off is None:
        return None
    try:
        moved = [_moved(arm if segment.kind == "stroke" else off, segment) for segment in job.segments]
        accuracy = _accuracy(scene, robot, arm, job, untimed, compensated=compensated)
    except TooSoftError:
        return None
    sag, sway = np.max(moved, axis=0)
    return Bending(sag_mm=1e3 * float(sag), sway_mm=1e3 * float(sway), accuracy=accuracy)


def _follows_bent(
    arm: ElasticArm | None, trajectory: QuinticTrajectory, parts: Sequence[Part], tasks: Sequence[ToolTask]
) -> bool:
    """Whether a motion leads the bent arm's tool nearer to its timed path than the rigid one's."""
    rigid = bent = 0.0
    for part in parts:
        if arm is None or part.number is None or not part.is_timed:
            continue
        path, share = tasks[part.number].path, np.linspace(0.0, 1.0, _POSTURES_OF_SEGMENT)
        q = trajectory.evaluate(part.begin + share * (part.end - part.begin))
        point = Kinematics(arm.robot).tool_poses(q)[0]
        try:
            sag = Sag(arm).following(q)
        except TooSoftError:
            return False
        off = (path.leg_offset(share * path.duration, each) for each in (point, point + sag))
        rigid, bent = np.add((rigid, bent), [float(np.linalg.norm(each, axis=1).sum()) for each in off])
    return bool(bent < rigid)


def _moved(arm: ElasticArm, segment: Segment) -> tuple[float, float]:
    """Largest sag and sway of the tool in a segment, m."""
    motion = segment.trajectory
    count = int(np.clip(np.ceil(motion.duration / _SAG_INTERVAL), 2, _POSTURES_OF_SEGMENT)) + 1
    t = np.linspace(motion.t[0], motion.t[-1], count)
    sag = np.linalg.norm(Sag(arm).along(t, motion.evaluate(t)), axis=1)
    sway = sway_along(arm, motion.evaluate, motion.duration, arm.robot.damping_ratio)
    return float(sag.max()), float(np.linalg.norm(sway.tool[0], axis=1).max())


def _accuracy(
    scene: Scene, robot: Robot, arm: ElasticArm, job: Job, untimed: set[str], *, compensated: bool
) -> Accuracy | None:
    """The accuracy budget of the strokes; None without any."""
    works = list[Work]()
    for segment in job.strokes:
        path: WorkPath = segment.task.path
        if segment.name in untimed:
            path = FollowedPath(path=segment.task.path, robot=robot, trajectory=segment.trajectory)
        works.append(work_of(robot, segment.trajectory, path))
    if not works:
        return None
    known = covariance_of(scene, arm)
    asked = (scene.uncertainty, scene.tool.tolerance)
    return accuracy_of(arm, works, *asked, compensated=compensated, covariance=known)


def _planned_bending(plan: Plan) -> Bending | None:
    """The same of a plan."""
    compensated = plan.compensation is not None
    return _bending(plan.scene, plan.robot, plan.job, set(), compensated=compensated)


def _given(t: ArrayLike, q: ArrayLike | None, v: ArrayLike | None, a: ArrayLike | None) -> JointMotion:
    """A motion from the arguments of `evaluate`."""
    given = {"t": t, "q": q, "v": v, "a": a}
    if q is None:
        raise InputError("cmbot.evaluate", "q", "nothing", "positions (N, n) at the times t")
    try:
        arrays = {k: np.asarray(x, dtype=np.float64) for k, x in given.items() if x is not None}
        still = np.zeros_like(arrays["q"])
        QuinticTrajectory(**({"v": still, "a": still} | arrays))
    except InputError as error:
        raise InputError("cmbot.evaluate", error.key, error.got, error.expected) from error
    except (TypeError, ValueError) as error:
        raise InputError("cmbot.evaluate", "", str(error), "arrays of numbers, t (N,) and (N, n)") from error
    return JointMotion(t=arrays["t"], q=arrays["q"], v=arrays.get("v"), a=arrays.get("a"))


_FIGURE_ROWS: tuple[tuple[str, str, float, int, bool], ...] = (
    ("peak torque on the {base}, whole job, Nm", "peak_guardrail_torque", 1.0, 2, False),
    ("peak torque at work, Nm", "peak_guardrail_torque", 1.0, 2, True),
    ("mean torque, whole job, Nm", "mean_guardrail_torque", 1.0, 2, False),
    ("smallest clearance, mm", "min_clearance", 1e3, 1, False),
    ("largest tool deviation, mm", "max_tool_deviation", 1e3, 3, True),
    ("largest tool rotation, deg", "max_tool_rotation", float(np.rad2deg(1.0)), 3, True),
)


def _figure(job: Job | None, attribute: str, *, at_work: bool) -> float | None:
    """A figure of a job, or of its strokes; None without any."""
    if job is None or (at_work and not job.strokes):
        return None
    return float(getattr(job.stroke_figures if at_work else job.figures, attribute))


def _row(name: str, values: Sequence[float | None], factor: float, digits: int) -> tuple[str, str, str]:
    """A row of the table, of the motion's value and the planned one."""
    left, right = ("-" if value is None else f"{factor * value:.{digits}f}" for value in values)
    return name, left, right


def _largest_use(job: Job | None) -> float | None:
    """The largest share of a joint's bound on velocity, acceleration, jerk or torque."""
    if job is None:
        return None
    use = job.figures.limit_use
    return float(max(getattr(use, field.name) for field in fields(use)))


def _told(job: Job, bending: Bending | None) -> dict[str, Any]:
    """Figures of a job and of its strokes, bounds that hold at all times, and what bends."""
    certificate = job.certificate
    bounds = ("clearance_bound", "guardrail_torque_bound", "adhesion_bound")
    return {
        "job": _plain(job.figures),
        "work": _plain(job.stroke_figures) if job.strokes else None,
        **{name: _plain(getattr(certificate, name)) for name in bounds},
        "bending": _plain(bending),
    }


def _plain(value: object) -> Any:
    """Dataclasses and numbers as JSON has them: null where a number is infinite."""
    return from_json(to_json(value, inf_nan_mode="null"))
