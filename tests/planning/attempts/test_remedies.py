"""Remedies: what each of them proposes for which failure, and plans that take one.

And which solver makes a plan at first.
"""

import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_scenes import problem_of, request_of, short_scene
from urdf_arms import panda_scene, path_of, six_joint_scene

from cmbot.archive import load_plan, save
from cmbot.cli.inspection import examine
from cmbot.common.errors import LimitViolation, MissingExtra, OptimisationFailed, PathNotFound
from cmbot.common.limit import Limit
from cmbot.planning import Plan, plan, planner, remarks
from cmbot.planning.attempts import motion
from cmbot.planning.attempts.agenda import Agenda, Remedy, Solved, Trial
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.attempts.failure import (
    Broken,
    Failure,
    JointRate,
    NearObstacle,
    NoTrajectory,
    NoWay,
    OtherLimit,
    OutOfTime,
    ToolOff,
    Uncertified,
)
from cmbot.planning.attempts.remedies import (
    ANOTHER_START,
    CLEARER_GUESS,
    FEWER_VIA_POINTS,
    FINER_SAMPLES,
    MORE_VIA_POINTS,
    NEARER_TOOL,
    REMEDIES,
    SCENE_START,
    SHORTER_STEPS,
    SPARE_CLEARANCE,
)
from cmbot.planning.budget import RUNS, Budget, Deadline
from cmbot.planning.free_motion.approach import reachable
from cmbot.planning.initial_guess import initial_guess, leap, roughness, sliding_guess
from cmbot.planning.precheck import solver_of
from cmbot.planning.selfmotion import global_search
from cmbot.planning.torque.constraints import ClearanceMargin, ToolDeviation, ToolLag
from cmbot.planning.torque.decomposition import Optimised, optimise
from cmbot.scene import PlannerOptions, Scene

POSTURE = [41, 119, -70, 85, 48, -67]
TURNED = path_of("pose", 25, ([-0.086, 0.027, 0.101], 4.3), ([-0.081, 0.096, 0.037], 3.6))
UNREACHED = NoWay(error=PathNotFound("no approach", time=0.0, progress=0.0, smallest_singular_value=1.0))


def unfollowed(broken: Broken, words: str = "jerk of joint_3", **own: Any) -> NoTrajectory:
    error = OptimisationFailed("no", **{"constraint": words, "violation": 1.0} | own)
    return NoTrajectory(error=error, broken=broken)


SUDDEN = unfollowed(JointRate(order=3, ratio=2.0))


def missed(broken: Broken, value: float, bound: float) -> Uncertified:
    error = LimitViolation("it", time=1.0, value=value, bound=bound, unit="m")
    return Uncertified(error=error, broken=broken)


def nearer(missing: float, margin: float) -> Uncertified:
    return missed(NearObstacle(distance=margin - missing, margin=margin), margin - missing, margin)


def rough_scene(start: str = "pinned", **tool_path: Any) -> Scene:
    """Its charts are so coarse that the sequence of least torque jumps to and fro."""
    planner = {"knots": "sliding", "start": start, "chart_spacing": 0.4}
    return short_scene(tool_path=tool_path, planner=planner)


@pytest.fixture(scope="module")
def rough() -> Attempt:
    return attempt_at(rough_scene())


@pytest.fixture(scope="module")
def elsewhere() -> Attempt:
    attempt = attempt_at(rough_scene("free"), min_gain=0.0)
    assert not attempt.is_pinned
    return attempt


def attempt_at(scene: Scene, **options: Any) -> Attempt:
    asked = request_of(scene, **options)
    guess = sliding_guess(asked) if asked.cell.options.knots == "sliding" else initial_guess(asked)
    return Attempt(request=asked, guess=guess)


def turned_wrist(folder: Path, **planner: object) -> Scene:
    """A UR3: of its two ways to hold the tool's pose the one with less torque turns a wrist too fast."""
    return six_joint_scene(folder, "ur3", POSTURE, TURNED, **planner)


def tried(remedy: Remedy[Attempt, Any], attempt: Attempt, failure: Failure) -> list[tuple[Attempt, str]]:
    """What a remedy proposes, and what it tells of that."""
    before: Trial[Attempt, Any] = Trial(attempt=attempt, outcome=failure)
    return [
        (other, remedy.tell(before, Trial(attempt=other, outcome=failure, remedy=remedy, parent=before)))
        for other in remedy.propose(before)
    ]


def via_points(attempt: Attempt) -> Any:
    return attempt.guess.problem.parametrization.via_points


ALL_FAILURES = (
    UNREACHED,
    SUDDEN,
    unfollowed(NearObstacle(distance=0.0, margin=0.02)),
    unfollowed(ToolOff(what=Limit.TOOL_LAG, ratio=9.0)),
    unfollowed(OtherLimit(what=Limit.OTHER)),
    nearer(3e-4, 0.02),
    missed(OtherLimit(what=Limit.OTHER), 1.005, 1.0),
    OutOfTime(during=SUDDEN),
)
# By their numbers; of all others nothing comes from the scene's posture.
REMEDIED = {
    SHORTER_STEPS: {1, 2, 3, 4},
    CLEARER_GUESS: {2},
    MORE_VIA_POINTS: {3},
    FEWER_VIA_POINTS: {1},
    ANOTHER_START: {1, 2, 3, 4},
    SPARE_CLEARANCE: {5},
    FINER_SAMPLES: {6},
}


def test_failures_have_the_remedies_that_are_theirs() -> None:
    attempt = attempt_at(rough_scene(via_points=16), solver="sqp")
    for remedy in REMEDIES:
        kinds = {k for k, failure in enumerate(ALL_FAILURES) if tried(remedy, attempt, failure)}
        assert kinds <= REMEDIED.get(remedy, set())
        if remedy not in (SHORTER_STEPS, ANOTHER_START):
            # Whether these find a smoother guess depends on the scene.
            assert kinds == REMEDIED.get(remedy, set())


def test_remedies_are_tried_alone_before_two_of_them() -> None:
    """Near misses are mended at once, all else costs more than any of these."""
    mends = [SPARE_CLEARANCE, NEARER_TOOL, FINER_SAMPLES]
    others = [remedy for remedy in REMEDIES if remedy not in mends]
    assert sum(remedy.most * remedy.cost for remedy in mends) < min(remedy.cost for remedy in others)
    assert 2 * min(remedy.cost for remedy in others) > max(remedy.cost for remedy in others)


def search(attempt: Attempt, *failures: Failure, runs: int = 12) -> tuple[Trial[Attempt, int], list[Attempt]]:
    """Search with all remedies, where the first attempts fail so and later ones succeed."""
    left, run = list(failures), list[Attempt]()

    def work(attempt: Attempt) -> Solved[int] | Failure:
        run.append(attempt)
        return left.pop(0) if left else Solved(result=len(run))

    agenda = Agenda(
        work=work,
        key=lambda attempt: attempt.key,
        refused=lambda attempt: attempt.refused,
        remedies=REMEDIES,
        budget=Budget(runs=runs),
        deadline=attempt.request.deadline,
    )
    return agenda.search(attempt), run


def test_where_nothing_helps_the_first_failure_is_told_within_the_budget(rough: Attempt) -> None:
    other = unfollowed(JointRate(order=1, ratio=3.0))
    found, run = search(rough, SUDDEN, *99 * [other], runs=7)
    assert found.failure is SUDDEN
    assert 1 < len(run) <= 7
    assert len({attempt.key for attempt in run}) == len(run)
    # Another start is among them.
    assert np.ptp([via_points(attempt)[0] for attempt in run], axis=0).max() > 0.01


def test_what_tells_attempts_apart(rough: Attempt) -> None:
    """Remedies of remedies lead to the same guess."""
    guess, asked = rough.guess, rough.request
    same = [replace(rough, kept=1.1, is_first=False), replace(rough, guess=sliding_guess(asked))]
    other = [
        replace(rough, request=asked.with_options(min_gain=0.0)),
        replace(rough, request=replace(asked, spare_clearance=1e-3)),
        replace(rough, guess=replace(guess, pinned=not guess.pinned)),
        replace(rough, guess=replace(guess, way=np.zeros((2, 7)))),
        replace(rough, guess=sliding_guess(asked, search=guess.search.halved(0.1))),
    ]
    assert {attempt.key for attempt in same} == {rough.key}
    assert len({rough.key, *(attempt.key for attempt in other)}) == 1 + len(other)


def test_when_the_time_is_over_nothing_else_is_tried(rough: Attempt) -> None:
    over = Deadline(-1.0, lambda: 2.0)
    late = replace(rough, request=replace(rough.request, deadline=over))
    found, run = search(late, SUDDEN)
    assert found.failure is SUDDEN
    assert run == [late]
    assert not tried(SHORTER_STEPS, late, SUDDEN)
    assert over.mark == "time"


def test_guesses_in_shorter_steps_are_few_and_each_is_smoother(rough: Attempt) -> None:
    found = tried(SHORTER_STEPS, rough, SUDDEN)
    assert 1 <= len(found) <= 2
    attempts = [rough, *(attempt for attempt, _ in found)]
    for before, after in pairwise(attempts):
        assert roughness(after.guess.problem) <= 0.9 * roughness(before.guess.problem)
        assert after.search.step_share < before.search.step_share
        assert after.is_pinned
    for attempt, sentence in found:
        assert "jerk of joint_3" in sentence
        assert f"planned with {attempt.search.step_share:.3g} instead" in sentence
    assert not tried(SHORTER_STEPS, attempt_at(short_scene()), SUDDEN)


def test_a_guess_that_leaps_is_optimised_once(tmp_path: Path) -> None:
    """Hardly any trajectory follows it, whatever the optimiser and the number of its via-points."""
    leg = ([0.0, 0.0, -0.15], 300.0)
    asked = request_of(six_joint_scene(tmp_path, "ur3", POSTURE, path_of("axis", 9, leg)))
    leaps = Attempt(request=asked, guess=sliding_guess(asked))
    assert leaps.refused is None
    again = replace(leaps, is_first=False).refused
    assert again.error.reason.startswith("only by leaps to other")
    assert again.error.violation > 0.1
    assert replace(leaps, guess=initial_guess(asked), is_first=False).refused is None
    astray = unfollowed(ToolOff(what=Limit.TOOL_DEVIATION, ratio=4.0))
    assert not tried(MORE_VIA_POINTS, leaps, astray)


def test_where_no_approach_leads_to_a_better_start_the_best_is_tried_that_self_motion_leads_to(
    elsewhere: Attempt,
) -> None:
    found, run = search(elsewhere, UNREACHED)
    assert len(run) == 2
    assert not found.attempt.is_pinned
    asked, chart = elsewhere.request, elsewhere.search.first_chart.q
    allowed = reachable(asked, chart)
    assert 0 < allowed.sum() < len(chart)
    assert np.abs(chart[allowed] - asked.state.posture).max(axis=1).min() < 1e-9
    assert np.abs(chart[allowed] - via_points(found.attempt)[0]).max(axis=1).min() < 1e-9
    (sentence,) = found.told
    assert "No approach leads to the best start (no approach)" in sentence


def test_else_the_scenes_posture_is(elsewhere: Attempt) -> None:
    found, run = search(elsewhere, UNREACHED, UNREACHED)
    assert len(run) == 3
    assert found.attempt.is_pinned
    assert [str(failure) for failure in found.attempt.guess.failures] == [str(UNREACHED.error)]
    np.testing.assert_allclose(
        via_points(found.attempt)[0], elsewhere.request.state.posture, rtol=0, atol=1e-12
    )
    # The better start was the planner's own choice: what fails from the scene's posture is told.
    again = unfollowed(JointRate(order=1, ratio=2.0))
    assert search(elsewhere, UNREACHED, UNREACHED, *99 * [again])[0].failure is again


def test_where_no_trajectory_leads_on_from_a_better_start_the_scenes_is_taken(elsewhere: Attempt) -> None:
    ((found, sentence),) = tried(SCENE_START, elsewhere, SUDDEN)
    assert found.is_pinned
    np.testing.assert_allclose(via_points(found)[0], elsewhere.request.state.posture, rtol=0, atol=1e-12)
    assert "From a better start no trajectory was found (no; jerk of joint_3)" in sentence


def test_where_a_clearance_is_missed_by_less_than_a_millimetre_there_is_some_to_spare(
    rough: Attempt,
) -> None:
    margin = rough.request.cell.options.safety_margin_m
    found, run = search(rough, nearer(9e-4, margin), nearer(2e-4, margin))
    np.testing.assert_allclose(
        [attempt.request.spare_clearance for attempt in run], [0.0, 1.05e-3, 1.4e-3], atol=1e-12
    )
    # What is certified is the margin that was asked for; what is optimised keeps more.
    assert found.attempt.request.cell.options == rough.request.cell.options
    keeps = [
        next(part.margin for part in attempt.guess.problem.constraints if isinstance(part, ClearanceMargin))
        for attempt in (found.attempt, rough)
    ]
    assert keeps[0] - keeps[1] == pytest.approx(1.4e-3)
    assert "missed by 0.9 mm" in found.told[0]
    assert len(found.told) == 2
    for missing in (-1e-4, 1.1e-3):
        assert not tried(SPARE_CLEARANCE, rough, nearer(missing, margin))


@pytest.mark.parametrize(("ratio", "helps"), [(0.9, False), (1.03, True), (1.8, True), (2.1, False)])
def test_where_the_certificate_finds_the_tool_off_it_is_planned_nearer(
    rough: Attempt, ratio: float, helps: bool
) -> None:
    strays = missed(ToolOff(what=Limit.TOOL_DEVIATION, ratio=ratio), ratio * 1e-3, 1e-3)
    found = tried(NEARER_TOOL, rough, strays)
    assert bool(found) == helps
    bounds = {part.name: part for part in rough.guess.problem.constraints}
    for attempt, sentence in found:
        assert attempt.key != rough.key
        # What is promised stays.
        assert attempt.request.cell.options == rough.request.cell.options
        for part in attempt.guess.problem.constraints:
            if isinstance(part, (ToolDeviation, ToolLag)):
                before = bounds[part.name]
                assert part.bound < before.bound / ratio
        assert "was missed" in sentence


def test_planning_nearer_goes_on_where_what_was_not_certified_ended(rough: Attempt) -> None:
    form = rough.guess.problem.parametrization
    last = form.step(np.full(form.dimension, 1e-3)).trajectory
    assert np.abs(last.q - form.via_points).max() > 1e-6
    strays = replace(missed(ToolOff(what=Limit.TOOL_DEVIATION, ratio=1.1), 1.1e-3, 1e-3), trajectory=last)
    ((attempt, _),) = tried(NEARER_TOOL, rough, strays)
    begun = attempt.guess.problem.parametrization.trajectory
    for order in range(3):
        np.testing.assert_allclose(
            begun.evaluate(last.t, order), last.evaluate(last.t, order), rtol=0, atol=1e-7
        )


@pytest.mark.parametrize(("value", "helps"), [(1.00008e-3, True), (1.2e-3, False)])
def test_where_a_bound_is_missed_narrowly_there_are_more_samples(
    rough: Attempt, value: float, helps: bool
) -> None:
    strays = missed(ToolOff(what=Limit.TOOL_DEVIATION, ratio=value / 1e-3), value, 1e-3)
    found = tried(FINER_SAMPLES, rough, strays)
    assert bool(found) == helps
    samples = rough.request.cell.options.samples_per_segment
    for attempt, sentence in found:
        assert attempt.request.cell.options.samples_per_segment == 2 * samples
        assert attempt.guess.problem.samples_per_segment == 2 * samples
        assert "missed narrowly" in sentence


@pytest.mark.parametrize(
    ("broken", "numbers"),
    [
        (ToolOff(what=Limit.TOOL_DEVIATION, ratio=1.1), [15]),
        (ToolOff(what=Limit.TOOL_ROTATION, ratio=6.0), [15, 22]),
        (ToolOff(what=Limit.TOOL_LAG, ratio=1e3), [15, 29]),
        (ToolOff(what=Limit.SHIFT, ratio=1e3), [15, 29]),
        (JointRate(order=3, ratio=6.0), []),
        (NearObstacle(distance=0.0, margin=0.02), []),
    ],
)
def test_where_the_tool_strays_there_are_more_via_points(broken: Broken, numbers: list[int]) -> None:
    found = tried(MORE_VIA_POINTS, attempt_at(short_scene()), unfollowed(broken, "tool lag"))
    assert [len(attempt.request.times) for attempt, _ in found] == numbers
    for attempt, sentence in found:
        number = len(attempt.guess.problem.space.t)
        assert number == len(attempt.request.times)
        assert "With 8 via-points the tool strays from its path between them (no; tool lag)" in sentence
        assert sentence.endswith(f"planned with tool_path.via_points {number} instead.")


@pytest.mark.parametrize(("distance", "numbers"), [(-0.002, [15]), (0.0, []), (0.019, [])])
def test_where_the_arm_collides_between_via_points_there_are_twice_as_many(
    distance: float, numbers: list[int]
) -> None:
    near = unfollowed(NearObstacle(distance=distance, margin=0.02), "clearance")
    found = tried(MORE_VIA_POINTS, attempt_at(short_scene()), near)
    assert [len(attempt.guess.problem.space.t) for attempt, _ in found] == numbers
    for _, sentence in found:
        assert sentence.startswith("With 8 via-points no trajectory was found (no; clearance")
        assert sentence.endswith("planned with tool_path.via_points 15 instead.")


@pytest.mark.parametrize(("order", "numbers"), [(3, [11, 9]), (0, [11, 9]), (1, [])])
def test_where_joints_move_too_suddenly_there_are_fewer_via_points(order: int, numbers: list[int]) -> None:
    sudden = unfollowed(JointRate(order=order, ratio=2.0))
    found = tried(FEWER_VIA_POINTS, attempt_at(short_scene(tool_path={"via_points": 16})), sudden)
    assert [len(attempt.request.times) for attempt, _ in found] == numbers
    for attempt, sentence in found:
        assert len(attempt.guess.problem.space.t) == len(attempt.request.times)
        assert sentence.startswith("With 16 via-points no trajectory was found (no; jerk of joint_3)")
    assert not tried(FEWER_VIA_POINTS, attempt_at(short_scene(tool_path={"via_points": 5})), sudden)


def test_where_no_trajectory_keeps_clear_the_guess_keeps_more(
    monkeypatch: pytest.MonkeyPatch, rough: Attempt
) -> None:
    """Its lower bound stays that of all postures that keep the margin; none is sought."""
    monkeypatch.setattr(global_search, "find_lower_bound", None)
    near = unfollowed(NearObstacle(distance=0.019, margin=0.02))
    margins = list[float]()
    for attempt, sentence in tried(CLEARER_GUESS, rough, near):
        margins.append(float(attempt.request.cell.clearances.query(via_points(attempt)).distance.min()))
        assert attempt.request is rough.request
        assert attempt.guess.lower_bound == rough.search.lower_bound
        assert attempt.search.halved().lower_bound == rough.search.lower_bound
        assert f"planned from such that keep {100 * (attempt.kept - 1):.0f} % more" in sentence
    least = rough.request.cell.options.safety_margin_m
    assert margins[0] >= 1.02 * least
    assert margins[1] >= 1.1 * least


def test_a_plan_has_the_via_points_that_it_was_made_with(monkeypatch: pytest.MonkeyPatch) -> None:
    real, asked = motion.optimise, list[int]()

    def optimise_once_more(problem: Any, *rest: Any, **more: Any) -> Any:
        asked.append(len(problem.space.t))
        if len(asked) == 1:
            raise OptimisationFailed(
                "no", constraint="tool deviation", violation=1.0, limit=Limit.TOOL_DEVIATION
            )
        return real(problem, *rest, **more)

    monkeypatch.setattr(motion, "optimise", optimise_once_more)
    made = plan(short_scene())
    assert asked == [8, 15]
    assert made.scene.strokes[0].via_points == 15 == len(made.trajectory.t)
    assert made.certificate.holds
    assert made.runs == 2
    assert "planned with tool_path.via_points 15 instead" in made.fallbacks[0]


def test_a_trajectory_that_nearly_meets_the_constraints_is_left_to_the_certificate(
    monkeypatch: pytest.MonkeyPatch, short_plan: Plan
) -> None:
    """The optimiser keeps its constraints inside what they stand for: to miss them by less is no failure."""
    trajectory = short_plan.job.strokes[0].trajectory
    failure = OptimisationFailed("no", constraint="jerk of joint_3", violation=1.0, limit=Limit.JERK)
    failed = replace(
        Optimised(trajectory=trajectory, via_points=trajectory.q, passes=()), complete=False, failure=failure
    )
    monkeypatch.setattr(motion, "optimise", lambda *_, **__: failed)
    found = plan(short_plan.scene)
    assert found.certificate.holds
    assert any("the best motion so far" in sentence for sentence in found.fallbacks)
    # A motion that is complete may be one of fewer that were tried.
    monkeypatch.setattr(Deadline, "mark", "time")
    monkeypatch.setattr(motion, "optimise", lambda *_, **__: replace(failed, complete=True))
    *_, said = plan(short_plan.scene).fallbacks
    assert said.startswith("The time, ") and "was over before all was tried: " in said
    monkeypatch.undo()
    beyond = replace(failed, trajectory=replace(trajectory, a=1.5 * trajectory.a))
    monkeypatch.setattr(motion, "optimise", lambda *_, **__: beyond)
    with pytest.raises(OptimisationFailed, match="jerk of joint_3"):
        plan(short_plan.scene)


@pytest.mark.parametrize("knots", ["sliding", "fixed"])
def test_a_time_limit_that_is_over_at_once(knots: str, tmp_path: Path) -> None:
    """Charts are a must; on a path that is known the first trajectory may already meet the constraints."""
    scene = short_scene(planner={"knots": knots, "time_limit_s": 1e-3})
    if knots == "sliding":
        with pytest.raises(
            PathNotFound, match=r"the time, 0\.001 s \(raise planner\.time_limit_s for more\), was over when"
        ):
            plan(scene)
    else:
        made = plan(scene)
        assert made.certificate.holds
        assert len(made.passes) == 1
        assert made.runs == 1
        # About z there is a lower peak to find: the best motion so far is planned, if there is one.
        scene = scene.with_options(axis_weights=(0.05, 0.05, 1.0))
        stopped = plan(scene)
        assert any("the best motion so far" in sentence for sentence in stopped.fallbacks)
        assert (stopped.stopped, load_plan(save(stopped, tmp_path / "plan")).stopped) == ("time", "time")
        scene = scene.with_options(max_tool_deviation_m=1e-6)
        over = r"the time, 0\.001 s \(raise planner.*\), was over after \S+ s, before the optim"
        with pytest.raises(OptimisationFailed, match=over):
            plan(scene)


def test_half_the_steps_from_the_same_charts(rough: Attempt) -> None:
    search = rough.guess.search
    assert search.step_share == rough.request.cell.options.step_share
    half = search.halved()
    assert half.step_share == 0.5 * search.step_share
    assert half.lower_bound is search.lower_bound
    # Shorter steps are some of the longer ones, and what was known before stays as it was.
    assert half.solve(pinned=True).peak >= search.solve(pinned=True).peak
    again = sliding_guess(rough.request).problem.parametrization.via_points
    np.testing.assert_array_equal(again, rough.guess.problem.parametrization.via_points)


def test_roughness_is_the_largest_share_of_any_bound(rough: Attempt) -> None:
    start, limits = rough.guess.problem.parametrization.trajectory, rough.request.cell.robot.limits
    t = np.linspace(start.t[0], start.t[-1], 20001)
    shares = [
        np.abs(start.evaluate(t, order)).max(axis=0) / bound
        for order, bound in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk))
    ]
    assert roughness(rough.guess.problem) == pytest.approx(np.max(shares), rel=1e-3)


def test_a_first_guess_is_smooth_where_that_costs_next_to_no_torque(rough: Attempt) -> None:
    guess = initial_guess(rough.request)
    assert roughness(guess.problem) <= 0.9 * roughness(rough.guess.problem)
    assert guess.problem.at_via_points.max() <= 1.001 * rough.guess.problem.at_via_points.max()
    assert guess.search.step_share < rough.guess.search.step_share
    assert guess.choice == rough.guess.choice


@pytest.mark.parametrize(("seconds", "leaps"), [(3.0, False), (300.0, True)])
def test_a_guess_that_leaps_between_branches_is_made_in_shorter_steps(
    tmp_path: Path, seconds: float, leaps: bool
) -> None:
    """In much time joints could go anywhere between via-points; the tool would leave its path there."""
    leg = ([0.0, 0.0, -0.15], seconds)
    asked = request_of(six_joint_scene(tmp_path, "ur3", POSTURE, path_of("axis", 9, leg)))
    rough, smooth = sliding_guess(asked), initial_guess(asked)
    via_points = [each.problem.parametrization.via_points for each in (rough, smooth)]
    assert [leap(asked, q) > 0 for q in via_points] == [leaps, False]
    assert (smooth.search.step_share < rough.search.step_share) == leaps


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


def test_a_slow_machine_plans_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock only stops: here it goes ten thousand times as fast, and a remedy is taken."""
    hurried = {"legs": [{"by": [0, -0.2, 0], "seconds": 2.8}], "via_points": 16}
    made = list[Plan]()
    for speed in (1.0, 1e4):

        def clock(speed: float = speed) -> float:
            return speed * time.perf_counter()

        monkeypatch.setattr(planner, "Deadline", lambda limit, clock=clock: Deadline(1e9, clock))
        made.append(plan(short_scene(tool_path=hurried), progress=False))
    quick, slow = made
    np.testing.assert_array_equal(quick.trajectory.q, slow.trajectory.q)
    assert (quick.fallbacks, quick.runs, quick.stopped) == (slow.fallbacks, slow.runs, slow.stopped)
    assert 1 < quick.runs <= RUNS
    assert quick.stopped is None


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


def test_where_nothing_leads_elsewhere_other_via_points_start_in_the_posture_too(elsewhere: Attempt) -> None:
    (stays, _), *_ = tried(SCENE_START, elsewhere, UNREACHED)
    assert stays.is_pinned
    fewer = [other for other, _ in tried(FEWER_VIA_POINTS, stays, SUDDEN)]
    assert fewer and all(other.is_pinned for other in fewer)
    # And what is told of the other start is told still.
    assert all(other.guess.failures == stays.guess.failures for other in fewer)


def test_what_succeeded_is_not_charted_for_remedies(rough: Attempt) -> None:
    attempt = replace(rough)
    trial: Trial[Attempt, Any] = Trial(attempt=attempt, outcome=Solved(result=None))
    assert not [other for remedy in REMEDIES for other in remedy.propose(trial)]
    assert "search" not in vars(attempt)
