"""Plan a scene: read `plan` as the paper's abstract."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NoReturn, Self

from threadpoolctl import threadpool_limits

from cmbot.common.errors import InputError, PathNotFound, PlanningError
from cmbot.common.poses import rpy_deg
from cmbot.common.reading.validation import checked_options, require_type
from cmbot.common.reading.yaml_reader import line_of
from cmbot.common.watching import watched
from cmbot.planning.attempts.advice import slower_legs
from cmbot.planning.attempts.agenda import Solved
from cmbot.planning.attempts.failure import NoWay, OutOfTime, attempted, error_of, in_words
from cmbot.planning.attempts.reconfigurations import Reconfigurations
from cmbot.planning.attempts.stroke import PlannedStroke, advice, in_given_time, plan_stroke
from cmbot.planning.budget import CANDIDATE_RUNS, SHORTEST_TIME_RUNS, Deadline
from cmbot.planning.composition import composed
from cmbot.planning.path.raster_reach import reached_scene
from cmbot.planning.precheck import (
    failures_explained,
    require_reasonable_size,
    require_seconds,
    require_sound_path,
    solver_of,
)
from cmbot.planning.progress import Progress, ProgressReporter
from cmbot.planning.reach import (
    firmer,
    leaning,
    lighter,
    require_posture,
    require_postures,
    require_within_reach,
    upright,
    without_posture,
)
from cmbot.planning.request import JobState, Motion, StrokeRequest, build_request, strokes_of, with_cuts
from cmbot.planning.result.plan import Plan, require_plan
from cmbot.planning.stroke_order import in_least_travel
from cmbot.planning.workcell.objectives import WrenchFunction
from cmbot.planning.workcell.workcell import robot_of
from cmbot.scene import PlannerOptions, Scene, StrokeFile, allowed_cuts
from cmbot.toolpath import Goal

# Peaks of two orders of strokes that differ by less are the same.
_PEAK_TOLERANCE_FACTOR = 1.001


def plan(
    scene: Scene,
    *,
    options: PlannerOptions | None = None,
    objective: WrenchFunction | None = None,
    partial: bool = False,
    progress: Callable[[Progress], None] | Literal[False] | None = None,
) -> Plan:
    """Plan the motion of a scene's arm.

    With sliding knots, charts of the self-motion and dynamic programming over them give via-points with the
    least torque on the guardrail at rest; with fixed knots, gradient projection gives those of the paper.
    Quintic splines through them are optimised for a small peak of the torque and little jerk. The result is
    certified apart from the optimiser, and so is the approach to its start.

    Parameters
    ----------
    scene : Scene
    options : PlannerOptions, optional
        In place of the scene's own.
    objective : callable, optional
        A function of the wrench on the guardrail to minimise in place of what the options say: from
        wrenches (N, 6) to values (N,), never negative, and gradients (N, 6); see
        `cmbot.planning.WrenchFunction`. A plan directory holds its name only.
    partial : bool
        Plan the strokes that can be planned where others cannot: `Plan.missing` names those.
    progress : callable, optional
        Called with a `Progress` as the work goes on. Left out, that is shown on a terminal and in a notebook;
        with False nowhere.

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    InputError
        When an option is out of its bounds, or `objective` is no such function.
    MissingExtra
        When the options ask for a solver that is not installed.
    PathNotFound
        When the path ends at an obstacle, a joint's range or out of reach, from the scene's posture and from
        the others that were tried.
    OptimisationFailed
        When no trajectory through the path's via-points keeps the limits.
    LimitViolation
        When the certificate does not hold.

    Examples
    --------
    >>> plan = cmbot.plan(cmbot.load_scene("triangle"), progress=False)
    >>> plan
    <Plan triangle: peak torque on the guardrail 486.4 Nm in 30.6 s, at work 385.5 Nm ...>
    >>> f"{plan.figures.peak_guardrail_torque:.1f} Nm at work"
    '385.5 Nm at work'
    >>> plan.trajectory.q.shape[1]
    7
    """
    require_type(scene, Scene, "cmbot.plan", "scene", "a Scene, as cmbot.load_scene returns it")
    for key, value in (("objective", objective), ("progress", progress)):
        if not (value is None or value is False or callable(value)):
            raise InputError("cmbot.plan", key, type(value).__name__, "something to call, or None")
    given = scene.planner if options is None else checked_options(PlannerOptions, options, "PlannerOptions")
    deadline = Deadline(given.time_limit_s)
    # The matrices are small: more threads of linear algebra than one only wait for each other.
    with threadpool_limits(limits=1, user_api="blas"), failures_explained(scene), _advised(scene):
        scene = reached_scene(scene, given, deadline)
        with watched(progress) as report:
            planner = _Planner.of(given, report, deadline, objective)
            return planner.partial(scene) if partial else planner.whole(scene)


@contextmanager
def _advised(scene: Scene) -> Iterator[None]:
    """Add to the error of a path without postures what would do."""
    try:
        yield
    except PathNotFound as error:
        for found in without_posture(scene) if error.key else ():
            if found.key == error.key and found.remedy and found.remedy not in error.hints:
                error.add_hint(found.remedy)
        raise


def plan_candidate(
    scene: Scene, options: PlannerOptions, deadline: Deadline, *, wanted: bool = False
) -> Plan:
    """Plan a `reached_scene` that is one of many, as a stance is.

    Nothing is found that is only told of a plan: not the lower bound where laws were chosen, and in place of
    a refusal not what would do. Unless this one is `wanted`, strokes take few runs of optimise-and-certify.

    Raises
    ------
    CmbotError
        As `plan` does.
    """
    with threadpool_limits(limits=1, user_api="blas"), failures_explained(scene):
        runs = SHORTEST_TIME_RUNS if wanted else CANDIDATE_RUNS
        planner = replace(_Planner.of(options, None, deadline), brief=True, most_runs=runs)
        return planner.whole(scene)


def replan(
    plan: Plan, scene: Scene, *, progress: Callable[[Progress], None] | Literal[False] | None = None
) -> Plan:
    """Plan a scene from the postures of an earlier plan, where frames moved or loads changed a little.

    The earlier motion is put onto the tool path as it is now, and certified as any plan; where it is not
    certified it is changed until it meets the constraints, with a peak of at most 5 % more. So are the free
    moves of that plan. The self-motion is not charted, so nothing is known of the least peak:
    `Plan.lower_bound`, `Plan.torque_floor` and `Plan.choice` are None, and it may be larger than by `plan`.
    The order, the times and the laws that the earlier plan found are kept; else the scene's options count.

    Where no certified plan comes of it, as behind a new obstacle, the scene is planned as `cmbot.plan` does,
    and the first of `Plan.fallbacks` says why.

    Parameters
    ----------
    plan : Plan
        Of a scene with the same arm and the same strokes.
    scene : Scene
        Its frames may have moved by about 20 mm and 1 degree.
    progress : callable, optional
        As of `cmbot.plan`.

    Raises
    ------
    InputError
        When the arm, or the strokes' names or numbers of legs, are others than in the plan.
    CmbotError
        As `cmbot.plan` does, where it is planned anew.

    Examples
    --------
    >>> heavier = cmbot.replan(plan, plan.scene.with_payload(0.5), progress=False)
    >>> heavier.certificate.holds, heavier.torque_floor
    (True, None)
    """
    require_plan(plan, "cmbot.replan")
    require_type(scene, Scene, "cmbot.replan", "scene", "a Scene, as cmbot.load_scene returns it")
    given, deadline = scene.planner, Deadline(scene.planner.time_limit_s)
    # As in `plan`.
    with threadpool_limits(limits=1, user_api="blas"), failures_explained(scene), _advised(scene):
        near = _timed_as(plan, reached_scene(scene, given, deadline))
        with watched(progress) as report:
            outcome = _Planner.of(given, report, deadline).job(near, deadline, plan)
    if isinstance(outcome, Plan):
        told = "Planned near an earlier plan: how far its peak is from the least one is not known."
        return replace(outcome, fallbacks=(told, *outcome.fallbacks))
    anew = _plan(scene, progress=progress)
    told = f"Planned anew, as near the earlier plan none was found: {in_words(outcome.trial.failure)}."
    return replace(anew, fallbacks=(told, *anew.fallbacks))


# Where a parameter has its name.
_plan = plan


def _timed_as(plan: Plan, scene: Scene) -> Scene:
    """The scene with the order, via-points and laws that an earlier plan found; an error where it is another.

    Raises
    ------
    InputError
    """
    # An arm by the same files needs no loading to be compared.
    arms = [plan.robot if scene.robot == plan.scene.robot else robot_of(scene), plan.robot]
    joints, before = ((arm.joints, tuple(arm.limits.velocity)) for arm in arms)
    if joints != before:
        raise InputError("cmbot.replan", "scene.robot", "another arm", "the arm of the plan")
    cuts = {str(file.name): allowed_cuts(file, plan.scene.strokes) for file in scene.strokes}
    scene = with_cuts(scene, plan.robot, cuts)
    files, earlier = ({stroke.name: stroke for stroke in each.strokes} for each in (scene, plan.scene))
    legs, planned = ({name: len(file.legs) for name, file in each.items()} for each in (files, earlier))
    if legs != planned:
        raise InputError("cmbot.replan", "scene.tool_path", "other strokes", "the strokes of the plan")
    best = scene.order == "best"
    timed = [
        files[name].changed(
            via_points=earlier[name].via_points,
            time_laws=files[name].time_laws or earlier[name].time_laws,
            backwards=(earlier if best else files)[name].backwards,
        )
        for name in (earlier if best else files)
    ]
    return scene.with_strokes(timed)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Planner:
    """How the jobs of one call of `plan` are planned."""

    options: PlannerOptions
    objective: WrenchFunction | None
    reporter: ProgressReporter
    deadline: Deadline
    brief: bool = False  # without what is only told of a plan
    most_runs: int = SHORTEST_TIME_RUNS

    @classmethod
    def of(
        cls,
        given: PlannerOptions,
        report: Callable[[Progress], None] | None,
        deadline: Deadline,
        objective: WrenchFunction | None = None,
    ) -> Self:
        """Return the planner by options as they are given: a plan holds the solver that it was made with."""
        return cls(
            options=replace(given, solver=solver_of(given)),
            objective=objective,
            reporter=ProgressReporter(report),
            deadline=deadline,
        )

    def whole(self, scene: Scene) -> Plan:
        """Return the plan of all strokes."""
        if scene.order == "best":
            return self.in_best_order(scene)
        outcome = self.job(scene, self.deadline)
        return outcome if isinstance(outcome, Plan) else self.refuse(scene, outcome)

    def partial(self, scene: Scene) -> Plan:
        """Return the plan of the strokes that can be planned, in their order; the first error where none can.

        What fails is left out, and the others are planned anew: free moves lead past it then.
        """
        if scene.order == "best":
            with suppress(PlanningError):
                return self.in_best_order(scene)
        missing = dict[str, PlanningError]()
        for stroke in scene.strokes if len(scene.strokes) > 1 else ():
            try:
                self._require_reach(_alone(scene, str(stroke.name)), self.deadline)
            except PlanningError as error:
                missing[str(stroke.name)] = error
        while len(missing) < len(scene.strokes):
            left = _without(scene, missing.keys())
            outcome = self.job(left, self.deadline)
            if isinstance(outcome, Plan):
                told = (f"Not planned: {name}: {error}." for name, error in missing.items())
                return replace(outcome, missing=tuple(missing), fallbacks=(*told, *outcome.fallbacks))
            try:
                self.refuse(left, outcome)
            except PlanningError as error:
                missing[outcome.trial.chain[0].attempt.request.stroke.name] = error
        raise next(iter(missing.values()))

    def in_best_order(self, scene: Scene) -> Plan:
        """Return the plan in the order of least travel, or in the given one where the peak of that is lower.

        Of two peaks that are about the same, the quicker job counts.
        """
        given, travels_least = scene.with_strokes(scene.strokes), in_least_travel(scene)
        orders = [travels_least, *([given] if travels_least.strokes != given.strokes else [])]
        made, refused = list[Plan](), list[tuple[Scene, PlannedStroke]]()
        for number, order in enumerate(orders):
            if number and self.deadline.expired():
                break
            outcome = self.job(order, self.deadline.part(len(orders) - number))
            if isinstance(outcome, Plan):
                made.append(outcome)
            else:
                refused.append((order, outcome))
        if not made:
            return self.refuse(*refused[-1])
        plan = made[-1] if _is_better_order(made[-1], made[0]) else made[0]
        names = ", ".join(
            f"{stroke.name}{' backwards' if stroke.backwards else ''}" for stroke in plan.scene.strokes
        )
        chosen = f"Order of the strokes: {names}."
        return replace(plan, fallbacks=(chosen, *plan.fallbacks), stopped=self.deadline.mark)

    def job(self, scene: Scene, deadline: Deadline, earlier: Plan | None = None) -> Plan | PlannedStroke:
        """Return the plan of a job, or the stroke that could not be planned; by an earlier plan if given."""
        request = self._require_reach(scene, deadline)
        parts = () if earlier is None else earlier.job.segments
        before = {part.name: Motion(task=part.task, trajectory=part.trajectory) for part in parts}
        request = replace(request, earlier=before)
        made, state, asked = list[PlannedStroke](), [request.state], scene
        cuts, uncut = Reconfigurations(scene), dict[str | None, PlannedStroke]()
        while len(made) < len(request.strokes):
            stroke = _at_stroke(request, len(made), state[-1])
            planned = plan_stroke(stroke)
            if earlier is None and not isinstance(planned.trial.outcome, Solved):
                planned = self._in_given_time(scene, stroke, planned, state[-1])
            outcome, file = planned.trial.outcome, stroke.stroke.file
            if isinstance(outcome, Solved):
                made.append(planned)
                last = outcome.result.job.segments[-1]
                reached = max(state[-1].reached, outcome.result.peak)
                state.append(JobState(posture=last.trajectory.q[-1], begin=last.end, reached=reached))
                continue
            # What is told is why the whole path failed.
            refused = uncut.setdefault(file.part_of or file.name, planned)
            is_slow = earlier is not None or planned.shortest is not None
            if is_slow or deadline.expired() or not cuts.cut(planned.trial.chain[0].attempt, outcome):
                return refused
            scene = with_cuts(asked, request.cell.robot, cuts.ends)
            try:
                request = self._require_reach(scene, deadline)
            except PathNotFound:
                return refused
        plan = composed(scene, made, custom=self.objective is not None)
        return replace(plan, fallbacks=(*cuts.in_words, *plan.fallbacks))

    def refuse(self, scene: Scene, stroke: PlannedStroke) -> NoReturn:
        """Raise why a stroke of a scene is not planned, with what would do."""
        trial, request, missed = stroke.trial, stroke.trial.chain[0].attempt.request, None
        starts_near = isinstance(trial.failure, NoWay) and trial.failure.is_start_near
        if not starts_near:
            # Before anything else is advised; and it says by how much a place is missed.
            missed = attempted(request, lambda: require_posture(request, is_clear=True))
            trial = trial if missed is None else replace(trial, outcome=missed)
        error, own = error_of(trial.failure), f"this is stroke {request.stroke.name}"
        if len(request.strokes) > 1 and own not in error.hints:
            error.add_hint(own)
        if not self.brief:
            blocked = upright(request) if missed is None else ""
            leant = (leaning(scene, request) or lighter(scene, request)) if blocked or missed else ""
            for hint in filter(None, (blocked, leant, firmer(scene, request))):
                error.add_hint(hint)
        if stroke.shortest is not None:
            where = "the legs of " * bool(request.stroke.file.legs) + request.stroke.key
            ramp = request.stroke.file.speed_profile.ramp
            keys = f"seconds: auto on {where}, with speed_profile: {{kind: shortest, ramp: {ramp:g}}},"
            error.add_hint(f"{keys} would do, and takes {stroke.shortest:.3g} s")
        elif request.deadline.expired():
            if not isinstance(trial.failure, OutOfTime):
                error.add_hint(f"then {request.deadline.in_words}, was over")
        elif words := "" if self.brief else advice(trial):
            error.add_hint(words)
        if isinstance(error, PathNotFound) and not starts_near:
            leg = request.stroke.leg_key(request.task.path.leg_to(error.time))
            if line := line_of(Path(scene.source), leg):
                error.add_source(f"line {line}")
        raise error

    def _in_given_time(
        self, scene: Scene, request: StrokeRequest, refused: PlannedStroke, state: JobState
    ) -> PlannedStroke:
        """A refused stroke whose time is too short, by its shortest motion where that takes no longer.

        Where the shortest is asked for, by one from where the arm is: advice says what such a motion takes.
        """
        shortest, first = scene.strokes[request.number].in_shortest_time(), refused.trial.chain[0].attempt
        if request.deadline.expired():
            return refused
        if request.task.path.open_legs and not first.is_pinned and request.cell.options.knots == "sliding":
            again = plan_stroke(request, stays=True)
            return again if isinstance(again.trial.outcome, Solved) else refused
        if shortest is None or request.task.path.open_legs:
            return refused
        if slower_legs(request, refused.trial.failure) is None:
            return refused
        self.reporter.step("trying seconds: auto")
        files = (*scene.strokes[: request.number], shortest, *scene.strokes[request.number + 1 :])
        silent = replace(self, reporter=ProgressReporter())
        try:
            fast = silent._require_reach(scene.with_strokes(files), self.deadline)
        except PlanningError:
            return refused
        stroke, found = _at_stroke(fast, request.number, state), refused
        # Another start may be better at rest, and slower; with fixed knots there is none.
        is_quiet = request.stroke.file.speed_profile.kind == "quiet"
        for stays in (False, True) if request.cell.options.knots == "sliding" else (False,):
            planned = plan_stroke(stroke, stays=stays)
            found = in_given_time(found, request.stroke, planned)
            is_quick = found.shortest is not None and found.shortest <= request.task.path.duration
            if isinstance(found.trial.outcome, Solved) or (is_quick and not is_quiet):
                break
        return found

    def _require_reach(self, scene: Scene, deadline: Deadline) -> StrokeRequest:
        """Return the request of a job whose strokes are of reasonable size and within reach."""
        self.reporter.stage("path")
        request = build_request(scene, self.options, self.objective, self.reporter, deadline)
        request = replace(request, proves=not self.brief, most_runs=self.most_runs)
        for number, stroke in enumerate(request.strokes):
            require_reasonable_size(scene, stroke, request.cell.robot.dof, self.options)
            require_sound_path(scene, stroke)
            try:
                at_stroke = request.at_stroke(number)
                require_within_reach(at_stroke)
                require_seconds(at_stroke)
            except PathNotFound as error:
                if len(request.strokes) > 1:
                    error.add_hint(f"this is stroke {stroke.name}")
                raise
        require_postures(request)
        return request


def _alone(scene: Scene, name: str) -> Scene:
    """The scene with one of its strokes."""
    return _without(scene, [str(stroke.name) for stroke in scene.strokes if stroke.name != name])


def _without(scene: Scene, names: Collection[str]) -> Scene:
    """The scene without some strokes; those that begin where one of these ends say where that is."""
    if not names:
        return scene
    left, timed = list[StrokeFile](), strokes_of(scene, robot_of(scene))
    for k, file in enumerate(scene.strokes):
        if file.name in names:
            continue
        if k and timed[k - 1].name in names and not file.has_own_start:
            X = timed[k - 1].path.end_pose
            file = file.changed(start_pose=Goal(xyz=tuple(X[:3, 3].tolist()), rpy_deg=rpy_deg(X[:3, :3])))
        left.append(file)
    return scene.with_strokes(left)


def _is_better_order(plan: Plan, best: Plan) -> bool:
    """Whether the peak of a job is lower than that of another one, or about the same in less time."""
    peak, lowest = (each.job.figures.peak_guardrail_torque for each in (plan, best))
    if max(peak, lowest) <= _PEAK_TOLERANCE_FACTOR * min(peak, lowest):
        return plan.job.duration < best.job.duration
    return peak < lowest


def _at_stroke(request: StrokeRequest, number: int, state: JobState) -> StrokeRequest:
    """The request of a stroke after those that are planned."""
    left, name = len(request.strokes) - number, request.strokes[number].name
    if left > 1:
        # Only the last stroke leads to where the job ends.
        request = replace(request, end_posture=None)
    if len(request.strokes) > 1:
        request.reporter.begin_stroke(name)
        request = replace(request, deadline=request.deadline.part(left, name))
    return request.at_stroke(number, state)
