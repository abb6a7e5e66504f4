"""Retries: more samples, shorter steps, more or fewer via-points, other starts, the other solver, in order.

And which solver makes a plan at first.
"""

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_scenes import context_of, problem_of, short_scene
from urdf_arms import panda_scene, path_of, six_joint_scene

from cmbot.archive import load_plan, save
from cmbot.cli.inspection import examine
from cmbot.common.errors import LimitViolation, MissingExtra, OptimisationFailed, PathNotFound
from cmbot.optimization import exchange
from cmbot.planning import Plan, plan, planner, remarks
from cmbot.planning.free_motion.approach import reachable
from cmbot.planning.initial_guess import (
    InitialGuess,
    initial_guess,
    leap,
    leap_failure,
    roughness,
    sliding_guess,
)
from cmbot.planning.precheck import solver_of
from cmbot.planning.progress import ProgressReporter
from cmbot.planning.retries import (
    Attempt,
    clearer_guess,
    fewer_via_points,
    finer_samples,
    guesses_in_shorter_steps,
    more_via_points,
    scene_start,
    shorter_steps,
    spare_clearance,
    with_retries,
)
from cmbot.planning.selfmotion import global_search
from cmbot.planning.torque.constraints import ClearanceMargin
from cmbot.planning.torque.decomposition import Optimised, optimise
from cmbot.scene import PlannerOptions, Scene

FAILURE = OptimisationFailed("no", constraint="jerk of joint_3", violation=1.0)
POSTURE = [41, 119, -70, 85, 48, -67]
TURNED = path_of("pose", 25, ([-0.086, 0.027, 0.101], 4.3), ([-0.081, 0.096, 0.037], 3.6))
UNREACHED = PathNotFound("no approach", time=0.0, progress=0.0, smallest_singular_value=1.0)


def rough_scene(start: str = "pinned") -> Scene:
    """Its charts are so coarse that the sequence of least torque jumps to and fro."""
    return short_scene(planner={"knots": "sliding", "start": start, "chart_spacing": 0.4, "quiet_modes": 0})


@pytest.fixture(scope="module")
def rough() -> Attempt:
    return attempt_at(rough_scene())


def attempt_at(scene: Scene, **options: Any) -> Attempt:
    context = context_of(scene, **options)
    guess = sliding_guess(context) if context.options.knots == "sliding" else initial_guess(context)
    return Attempt(context=context, guess=guess, automatic=True)


def turned_wrist(folder: Path, **planner: object) -> Scene:
    """A UR3: of its two ways to hold the tool's pose the one with less torque turns a wrist too fast."""
    return six_joint_scene(folder, "ur3", POSTURE, TURNED, **planner)


def test_when_the_time_is_over_nothing_else_is_tried(rough: Attempt) -> None:
    over = ProgressReporter(clock=lambda: 2.0, limit=-1.0)
    late = replace(rough, context=replace(rough.context, reporter=over))
    failing = Failing(FAILURE)
    with pytest.raises(OptimisationFailed, match="no"):
        with_retries(late, failing)
    assert len(failing.attempts) == 1
    assert not list(guesses_in_shorter_steps(late, FAILURE))


@pytest.mark.parametrize("knots", ["sliding", "fixed"])
def test_a_time_limit_that_is_over_at_once(knots: str) -> None:
    """Charts are a must; on a path that is known the first trajectory may already meet the constraints."""
    scene = short_scene(planner={"knots": knots, "time_limit_s": 1e-3})
    if knots == "sliding":
        with pytest.raises(
            PathNotFound, match=r"the time, 0\.001 s \(planner\.time_limit_s\), was over when"
        ):
            plan(scene)
    else:
        made = plan(scene)
        assert made.certificate.holds
        assert len(made.passes) == 1
        # About z there is a lower peak to find: the best motion so far is planned, if there is one.
        scene = scene.with_options(axis_weights=(0.05, 0.05, 1.0))
        assert any("the best motion so far" in sentence for sentence in plan(scene).fallbacks)
        scene = scene.with_options(max_tool_deviation_m=1e-6)
        over = r"the time, 0\.001 s \(planner\.time_limit_s\), was over after \S+ s, before every constraint"
        with pytest.raises(OptimisationFailed, match=over):
            plan(scene)


class Failing:
    """Work that fails in the order of `failures`, then returns the number of attempts."""

    def __init__(self, *failures: Exception | None) -> None:
        self.failures, self.attempts = list(failures), list[Attempt]()

    def __call__(self, attempt: Attempt) -> int:
        self.attempts.append(attempt)
        failure = self.failures.pop(0) if self.failures else None
        if failure is not None:
            raise failure
        return len(self.attempts)


def raised_by(attempt: Attempt, work: Failing, *retries: Any) -> Exception:
    with pytest.raises((OptimisationFailed, PathNotFound)) as caught:
        with_retries(attempt, work, *retries)
    return caught.value


def test_what_failed_is_not_worked_at_again(rough: Attempt) -> None:
    """Remedies of remedies lead to the same guess; the next one begins where it may differ."""
    guess = rough.guess
    smaller = replace(rough.context, options=replace(rough.context.options, gap_target=0.0))
    others = [
        replace(rough, fallbacks=("told apart by nothing that matters",)),
        replace(rough, guess=sliding_guess(rough.context)),
        replace(rough, context=smaller),
        replace(rough, guess=replace(guess, pinned=not guess.pinned)),
        replace(rough, guess=replace(guess, way=np.zeros((2, 7)))),
        replace(rough, guess=guess_in_half_steps(rough)),
    ]

    def each(failed: Attempt, failure: Exception, run: Any) -> Any:
        for other in others:
            with pytest.raises(OptimisationFailed) as caught:
                run(other)
            assert caught.value is FAILURE
        raise failure

    work = Failing(*9 * [FAILURE])
    assert raised_by(rough, work, [each, each]) is FAILURE
    assert [id(attempt) for attempt in work.attempts] == [id(attempt) for attempt in [rough, *others[2:]]]


def guess_in_half_steps(attempt: Attempt) -> InitialGuess:
    return sliding_guess(attempt.context, search=attempt.guess.search.halved(0.1))


def test_half_the_steps_from_the_same_charts(rough: Attempt) -> None:
    search = rough.guess.search
    assert search.step_share == rough.context.options.step_share
    half = search.halved()
    assert half.step_share == 0.5 * search.step_share
    assert half.lower_bound is search.lower_bound
    # Shorter steps are some of the longer ones, and what was known before stays as it was.
    assert half.solve(pinned=True).peak >= search.solve(pinned=True).peak
    again = sliding_guess(rough.context).problem.parametrization.via_points
    np.testing.assert_array_equal(again, rough.guess.problem.parametrization.via_points)


def test_roughness_is_the_largest_share_of_any_bound(rough: Attempt) -> None:
    start, limits = rough.guess.problem.parametrization.trajectory, rough.context.robot.limits
    t = np.linspace(start.t[0], start.t[-1], 20001)
    shares = [
        np.abs(start.evaluate(t, order)).max(axis=0) / bound
        for order, bound in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk))
    ]
    assert roughness(rough.guess.problem) == pytest.approx(np.max(shares), rel=1e-3)


def test_a_first_guess_is_smooth_where_that_costs_next_to_no_torque(rough: Attempt) -> None:
    guess = initial_guess(rough.context)
    assert roughness(guess.problem) <= 0.9 * roughness(rough.guess.problem)
    assert guess.problem.at_via_points.max() <= 1.001 * rough.guess.problem.at_via_points.max()
    assert guess.search.step_share < rough.guess.search.step_share
    assert guess.choice == rough.guess.choice


def test_other_guesses_are_few_and_each_is_smoother(rough: Attempt) -> None:
    found = list(guesses_in_shorter_steps(rough, FAILURE))
    assert 1 <= len(found) <= 2
    for before, after in zip([rough, *found], found, strict=False):
        assert roughness(after.guess.problem) <= 0.9 * roughness(before.guess.problem)
        assert after.guess.search.step_share < before.guess.search.step_share
        assert after.guess.pinned
        (sentence,) = after.fallbacks
        assert "jerk of joint_3" in sentence
        assert f"planned with {after.guess.search.step_share:.3g} instead" in sentence
    assert not rough.fallbacks


def test_with_fixed_knots_there_is_no_other_guess() -> None:
    attempt, work = attempt_at(short_scene()), Failing(FAILURE)
    assert not list(guesses_in_shorter_steps(attempt, FAILURE))
    assert raised_by(attempt, work, [shorter_steps]) is FAILURE
    assert work.attempts == [attempt]


def test_the_first_smoother_guess_that_is_followed_is_taken(rough: Attempt) -> None:
    assert with_retries(rough, Failing()) == (rough, 1)
    work = Failing(FAILURE)
    attempt, done = with_retries(rough, work)
    assert done == 2
    assert work.attempts == [rough, attempt]


def test_where_none_is_followed_the_first_failure_is_raised(rough: Attempt) -> None:
    other = OptimisationFailed("neither", constraint="velocity of joint_1", violation=2.0)
    work = Failing(FAILURE, *9 * [other])
    assert raised_by(rough, work) is FAILURE
    # Another start is among them.
    assert len(work.attempts) > 1 + len(list(guesses_in_shorter_steps(rough, FAILURE)))
    starts = [attempt.guess.problem.parametrization.via_points[0] for attempt in work.attempts]
    assert np.ptp(starts, axis=0).max() > 0.01


@pytest.mark.parametrize(("start", "expected"), [("free", UNREACHED), ("pinned", FAILURE)])
def test_an_approach_that_fails_is_raised_where_the_start_may_be_given_up(
    monkeypatch: pytest.MonkeyPatch, start: str, expected: Exception
) -> None:
    monkeypatch.setattr("cmbot.planning.retries.SMOOTHER", np.inf)
    attempt = attempt_at(rough_scene(start), gap_target=0.0)
    others = guesses_in_shorter_steps(attempt, FAILURE)
    assert [other.guess.pinned for other in others] == 2 * [start == "pinned"]

    def unreached(_: Attempt) -> Any:
        raise UNREACHED

    with pytest.raises((OptimisationFailed, PathNotFound)) as caught:
        shorter_steps(attempt, FAILURE, unreached)
    assert caught.value is expected


def test_where_no_approach_leads_to_a_better_start_the_scenes_is_taken() -> None:
    attempt, work = attempt_at(rough_scene("free"), gap_target=0.0), Failing(UNREACHED, UNREACHED)
    assert not attempt.guess.pinned
    found, done = with_retries(attempt, work)
    assert done == 3
    assert found.guess.pinned
    assert found.guess.failures == (UNREACHED,)
    first = found.guess.problem.parametrization.via_points[0]
    np.testing.assert_allclose(first, attempt.context.posture, rtol=0, atol=1e-12)
    # It is the last: what fails then is raised.
    again = OptimisationFailed("again", constraint="jerk", violation=1.0)
    assert raised_by(attempt, Failing(UNREACHED, UNREACHED, *9 * [again])) is again


def test_where_no_trajectory_leads_on_from_a_better_start_the_scenes_is_taken() -> None:
    attempt, work = attempt_at(rough_scene("free"), gap_target=0.0), Failing(FAILURE)
    found, done = with_retries(attempt, work, [scene_start])
    assert done == 2
    assert found.guess.pinned
    first = found.guess.problem.parametrization.via_points[0]
    np.testing.assert_allclose(first, attempt.context.posture, rtol=0, atol=1e-12)
    (sentence,) = found.fallbacks
    assert "From a better start no trajectory was found (no; jerk of joint_3)" in sentence
    # From the scene's posture there is no other to try.
    assert raised_by(attempt_at(rough_scene()), Failing(FAILURE), [scene_start]) is FAILURE


@pytest.mark.parametrize(("seconds", "leaps"), [(3.0, False), (300.0, True)])
def test_a_guess_that_leaps_between_branches_is_made_in_shorter_steps(
    tmp_path: Path, seconds: float, leaps: bool
) -> None:
    """In much time joints could go anywhere between via-points; the tool would leave its path there."""
    leg = ([0.0, 0.0, -0.15], seconds)
    context = context_of(six_joint_scene(tmp_path, "ur3", POSTURE, path_of("axis", 9, leg)))
    rough, smooth = sliding_guess(context), initial_guess(context)
    via_points = [each.problem.parametrization.via_points for each in (rough, smooth)]
    assert [leap(context, q) > 0 for q in via_points] == [leaps, False]
    assert (smooth.search.step_share < rough.search.step_share) == leaps


def test_a_guess_that_leaps_is_optimised_once(tmp_path: Path) -> None:
    """Hardly any trajectory follows it, whatever the optimiser and the number of its via-points."""
    leg = ([0.0, 0.0, -0.15], 300.0)
    context = context_of(six_joint_scene(tmp_path, "ur3", POSTURE, path_of("axis", 9, leg)))
    guess, smooth = sliding_guess(context), initial_guess(context)
    attempt, work = Attempt(context=context, guess=guess), Failing(FAILURE, FAILURE)
    failure = leap_failure(guess.problem)
    assert re.match(r"only by leaps to other", str(failure))
    assert failure.violation > 0.1
    assert leap_failure(smooth.problem) is None
    assert more_via_points_is_refused(attempt, failure)

    def again(failed: Attempt, failure: Exception, run: Any) -> Any:
        return run(replace(failed, guess=replace(guess, pinned=not guess.pinned)))

    with pytest.raises(OptimisationFailed, match="only by leaps to other"):
        with_retries(attempt, work, [again])
    assert len(work.attempts) == 1


def more_via_points_is_refused(attempt: Attempt, failure: OptimisationFailed) -> bool:
    astray = OptimisationFailed("astray", constraint="tool deviation", violation=3.0)
    for each in (failure, astray):
        with pytest.raises(OptimisationFailed) as caught:
            more_via_points(attempt, each, Failing(each))
        assert caught.value is each
    return True


def test_a_trajectory_that_nearly_meets_the_constraints_is_left_to_the_certificate(
    monkeypatch: pytest.MonkeyPatch, short_plan: Plan
) -> None:
    """The optimiser keeps its constraints inside what they stand for: to miss them by less is no failure."""
    trajectory = short_plan.job.strokes[0].trajectory
    failed = replace(
        Optimised(trajectory=trajectory, via_points=trajectory.q, passes=()), complete=False, failure=FAILURE
    )
    monkeypatch.setattr(planner, "optimise", lambda *_: failed)
    found = plan(short_plan.scene)
    assert found.certificate.holds
    assert any("the best motion so far" in sentence for sentence in found.fallbacks)
    beyond = replace(failed, trajectory=replace(trajectory, a=1.5 * trajectory.a))
    monkeypatch.setattr(planner, "optimise", lambda *_: beyond)
    with pytest.raises(OptimisationFailed, match="jerk of joint_3"):
        plan(short_plan.scene)


def test_first_the_best_start_is_tried_that_self_motion_leads_to() -> None:
    attempt, work = attempt_at(rough_scene("free"), gap_target=0.0), Failing(UNREACHED)
    found, done = with_retries(attempt, work)
    assert done == 2
    assert not found.guess.pinned
    context, chart = attempt.context, attempt.guess.search.first_chart.q
    allowed = reachable(context, chart)
    assert 0 < allowed.sum() < len(chart)
    assert np.abs(chart[allowed] - context.posture).max(axis=1).min() < 1e-9
    first = found.guess.problem.parametrization.via_points[0]
    assert np.abs(chart[allowed] - first).max(axis=1).min() < 1e-9
    (sentence,) = found.fallbacks
    assert "No approach leads to the best start (no approach)" in sentence


@pytest.mark.parametrize(("value", "helps"), [(1.00008e-3, True), (1.2e-3, False)])
def test_where_a_bound_is_missed_by_a_hair_there_are_more_samples(
    rough: Attempt, value: float, helps: bool
) -> None:
    missed = LimitViolation("tool deviation", time=1.0, value=value, bound=1e-3, unit="m")
    work = Failing(missed)
    if not helps:
        with pytest.raises(LimitViolation):
            with_retries(rough, work, [finer_samples])
        return
    found, _ = with_retries(rough, work)
    samples = rough.context.options.samples_per_segment
    assert found.context.options.samples_per_segment == 2 * samples
    assert found.guess.problem.samples_per_segment == 2 * samples
    (sentence,) = found.fallbacks
    assert "missed narrowly" in sentence


def short_of(margin: float, *missing: float) -> list[LimitViolation]:
    each = (margin - mm * 1e-3 for mm in missing)
    return [
        LimitViolation("clearance of a from b", time=1.0, value=value, bound=margin, unit="m")
        for value in each
    ]


@pytest.mark.parametrize(
    ("missing", "spare"), [([0.3], [0.45]), ([0.9, 0.2], [1.05, 1.4]), ([1.1], None), ([0.9, 0.9, 0.9], None)]
)
def test_where_a_clearance_is_missed_by_less_than_a_millimetre_there_is_some_to_spare(
    rough: Attempt, missing: list[float], spare: list[float] | None
) -> None:
    margin = rough.context.options.safety_margin_m
    failures = short_of(margin, *missing)
    work = Failing(*failures)
    if spare is None:
        with pytest.raises(LimitViolation) as caught:
            with_retries(rough, work, [spare_clearance])
        assert caught.value is failures[-1]
        return
    found, number = with_retries(rough, work)
    assert number == 1 + len(missing)
    spared = [each.context.spare_clearance for each in work.attempts]
    np.testing.assert_allclose(spared, [0.0, *(1e-3 * each for each in spare)], atol=1e-12)
    # What is certified is the margin that was asked for; what is optimised keeps more.
    assert found.context.options == rough.context.options
    keeps = [
        next(each.margin for each in one.guess.problem.constraints if isinstance(each, ClearanceMargin))
        for one in (found, rough)
    ]
    assert keeps[0] - keeps[1] == pytest.approx(1e-3 * spare[-1])
    assert len(found.fallbacks) == len(missing)
    assert f"missed by {missing[0]:g} mm" in found.fallbacks[0]


def strays(constraint: str, violation: float) -> OptimisationFailed:
    return OptimisationFailed("no", constraint=constraint, violation=violation)


@pytest.mark.parametrize(
    ("constraint", "violation", "numbers"),
    [
        ("tool deviation", 0.1, [15]),
        ("tool rotation", 5.0, [15, 22]),
        ("tool lag", 1e3, [15, 29]),
        ("change of the shift", 1e3, [15, 29]),
        ("jerk of joint_3", 5.0, []),
        ("clearance", 5.0, []),
    ],
)
def test_where_the_tool_strays_there_are_more_via_points(
    constraint: str, violation: float, numbers: list[int]
) -> None:
    attempt, failure = attempt_at(short_scene()), strays(constraint, violation)
    work = Failing(*9 * [failure])
    assert raised_by(attempt, work, [more_via_points]) is failure
    assert [len(each.context.times) for each in work.attempts] == [8, *numbers]
    for each in work.attempts[1:]:
        assert len(each.guess.problem.space.t) == len(each.context.times)
        (sentence,) = each.fallbacks
        assert f"With 8 via-points the tool strays from its path between them (no; {constraint})" in sentence
        assert sentence.endswith(f"planned with tool_path.via_points {len(each.context.times)} instead.")


@pytest.mark.parametrize(
    ("constraint", "numbers"),
    [
        ("jerk of joint_3", [11, 9]),
        ("velocity, acceleration or jerk of joint_3", [11, 9]),
        ("velocity of joint_3", []),
        ("tool deviation", []),
    ],
)
def test_where_joints_move_too_suddenly_there_are_fewer_via_points(
    constraint: str, numbers: list[int]
) -> None:
    attempt, failure = attempt_at(short_scene(tool_path={"via_points": 16})), strays(constraint, 1.0)
    work = Failing(*9 * [failure])
    assert raised_by(attempt, work, [fewer_via_points]) is failure
    assert [len(each.context.times) for each in work.attempts] == [16, *numbers]
    for each in work.attempts[1:]:
        assert len(each.guess.problem.space.t) == len(each.context.times)
        (sentence,) = each.fallbacks
        assert sentence.startswith(f"With 16 via-points no trajectory was found (no; {constraint})")
    few = attempt_at(short_scene(tool_path={"via_points": 5}))
    assert raised_by(few, Failing(*9 * [failure]), [fewer_via_points]) is failure


@pytest.mark.parametrize(("knots", "seconds"), [("fixed", 2.8), ("sliding", 3.1)])
def test_a_speed_profile_whose_jerk_splines_cannot_follow_closely(knots: str, seconds: float) -> None:
    """They leave it between fewer via-points, as far as the bounds on deviation and lag allow.

    With sliding via-points 2.8 s are so near what is possible at all that rounding decides.
    """
    hurried = {"legs": [{"by": [0, -0.2, 0], "seconds": seconds}], "via_points": 16}
    made = plan(short_scene(tool_path=hurried, planner={"knots": knots}))
    assert made.certificate.holds
    assert made.scene.strokes[0].via_points == 11
    assert "With 16 via-points no trajectory was found" in made.fallbacks[0]


def test_where_no_trajectory_keeps_clear_the_guess_keeps_more(
    monkeypatch: pytest.MonkeyPatch, rough: Attempt
) -> None:
    """Its lower bound stays that of all postures that keep the margin; none is sought."""
    search, margins = rough.guess.search, list[float]()
    monkeypatch.setattr(global_search, "find_lower_bound", None)

    def run(attempt: Attempt) -> tuple[Attempt, float]:
        q = attempt.guess.problem.parametrization.via_points
        margins.append(float(attempt.context.clearances.smallest(q).distance.min()))
        assert attempt.context is rough.context
        assert attempt.guess.lower_bound == search.lower_bound
        assert attempt.guess.search.halved().lower_bound == search.lower_bound
        if len(margins) == 1:
            raise OptimisationFailed("no", constraint="clearance of a from b", violation=1e-4)
        return attempt, 1.0

    failure = OptimisationFailed("no", constraint="clearance of link_5 from rail", violation=1e-4)
    attempt, _ = clearer_guess(rough, failure, run)
    least = rough.context.options.safety_margin_m
    assert margins[0] >= 1.02 * least
    assert margins[1] >= 1.1 * least
    assert "planned from such that keep 10 % more" in attempt.fallbacks[-1]
    with pytest.raises(OptimisationFailed, match="jerk of joint_3"):
        clearer_guess(rough, FAILURE, run)


def test_a_plan_has_the_via_points_that_it_was_made_with(monkeypatch: pytest.MonkeyPatch) -> None:
    real, asked = planner.optimise, list[int]()

    def optimise_once_more(problem: Any, *rest: Any) -> Any:
        asked.append(len(problem.space.t))
        if len(asked) == 1:
            raise strays("tool deviation", 1.0)
        return real(problem, *rest)

    monkeypatch.setattr(planner, "optimise", optimise_once_more)
    made = plan(short_scene())
    assert asked == [8, 15]
    assert made.scene.strokes[0].via_points == 15 == len(made.trajectory.t)
    assert made.certificate.holds
    assert "planned with tool_path.via_points 15 instead" in made.fallbacks[0]


@pytest.mark.parametrize("automatic", [True, False])
def test_slsqp_is_tried_where_the_sparse_solver_of_auto_is_undecided(rough: Attempt, automatic: bool) -> None:
    undecided = OptimisationFailed("gave up", constraint="none", violation=1.0, undecided=True)
    first = replace(rough, automatic=automatic, context=context_of(rough_scene(), solver="sqp"))

    def work(attempt: Attempt) -> None:
        if attempt.context.options.solver == "sqp":
            raise undecided

    if not automatic:
        with pytest.raises(OptimisationFailed) as caught:
            with_retries(first, work)
        assert caught.value is undecided
        return
    found, _ = with_retries(first, work)
    assert found.context.options.solver == "slsqp"
    assert found.fallbacks == ("The solver sqp gave up (gave up): planned with slsqp instead.",)


def test_a_plan_says_that_its_steps_are_shorter(tmp_path: Path) -> None:
    made = plan(turned_wrist(tmp_path, solver="sqp"))
    assert made.certificate.holds
    assert made.options.step_share < made.scene.planner.step_share
    (sentence,) = made.fallbacks
    assert "With planner.step_share 0.6 no trajectory was found" in sentence
    assert f"planned with {made.options.step_share:.3g} instead" in sentence
    assert sentence in list(remarks(made))
    # What it was planned with leads to the same plan at once.
    again = plan(made.scene, options=made.options)
    assert again.fallbacks == ()
    np.testing.assert_allclose(again.trajectory.q, made.trajectory.q, rtol=0, atol=1e-9)


def test_what_no_trajectory_can_keep_is_named() -> None:
    """A tool deviation that via-points so far apart cannot hold."""
    legs = [{"by": [0, -0.6, 0], "seconds": 4}]
    scene = short_scene(
        tool_path={"legs": legs, "via_points": 6}, planner={"max_tool_deviation_m": 1e-6, "solver": "sqp"}
    )
    with pytest.raises(OptimisationFailed) as caught:
        optimise(problem_of(scene))
    assert caught.value.constraint == "tool deviation"
    assert caught.value.violation > 1


def test_a_long_path_with_few_via_points_does_not_creep(tmp_path: Path) -> None:
    """The tool's deviation bends away from nearly every step; uncorrected this took hundreds of them.

    With a third leg, back to the start, it still does, from some guesses and on some processors.
    """
    legs = [{"by": [0, 0.1, 0], "seconds": 3}, {"by": [0, 0, -0.1], "seconds": 3}]
    scene = panda_scene(tmp_path, legs=legs, via_points=8)
    problem = problem_of(scene, samples_per_segment=15, solver="sqp")
    found = optimise(problem)
    assert sum(report.iterations for report in found.passes) <= 80
    assert found.passes[-1].worst.value <= scene.planner.constraint_tolerance
    assert found.passes[-1].peak_torque < problem.scale


@pytest.mark.parametrize("undecided", [True, False])
def test_where_it_gives_up_auto_tries_slsqp_and_the_plan_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, undecided: bool
) -> None:
    def gives_up(*_: Any, **__: Any) -> Any:
        raise OptimisationFailed(
            "the steps became too small", constraint="none", violation=1.0, undecided=undecided
        )

    monkeypatch.setattr(exchange, "solve_sqp", gives_up)
    told: list[str] = []
    scene = short_scene(planner={"solver": "auto"})
    if undecided:
        planned = plan(scene, progress=lambda progress: told.append(progress.step))
        assert planned.options.solver == "slsqp"
        assert any("slsqp" in step for step in told)
        said = "The solver sqp gave up (the steps became too small): planned with slsqp instead."
        assert planned.fallbacks == (said,)
        assert said in list(remarks(planned))
        assert load_plan(save(planned, tmp_path / "plan")).fallbacks == (said,)
    else:
        with pytest.raises(OptimisationFailed):
            plan(scene)
    with pytest.raises(OptimisationFailed):
        plan(short_scene(planner={"solver": "sqp"}))


def test_the_plan_says_which_solver_made_it(short_plan: Plan, tmp_path: Path) -> None:
    """And, where nothing failed, nothing else."""
    assert plan(short_scene(planner={"solver": "auto"})).options.solver == "sqp"
    assert plan(short_scene(planner={"solver": "slsqp"})).options.solver == "slsqp"
    assert short_plan.fallbacks == () == load_plan(save(short_plan, tmp_path / "plan")).fallbacks
    assert not any("instead" in remark or "as a whole" in remark for remark in remarks(short_plan))


def test_without_piqp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "piqp", None)
    assert solver_of(PlannerOptions(solver="auto")) == "slsqp"
    assert solver_of(PlannerOptions(solver="slsqp")) == "slsqp"
    with pytest.raises(MissingExtra, match=r"piqp is not installed; run: pip install .*\[fast\]"):
        plan(short_scene(planner={"solver": "sqp"}))


def test_the_doctor_knows_piqp() -> None:
    found = {symptom.name: symptom for symptom in examine()}
    assert found["piqp"].healthy
