"""Failures as data, and advice: how slow legs would have to be, and which bounds may be eased."""

import re
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from small_scenes import SHORT, problem_of, request_of, short_scene

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import LimitViolation, OptimisationFailed, PathNotFound, PlanningError
from cmbot.common.limit import Limit
from cmbot.planning import Plan, plan
from cmbot.planning.attempts import stroke
from cmbot.planning.attempts.advice import LESS_KEPT, changed_in_words, eased, in_keys, slower, slower_legs
from cmbot.planning.attempts.agenda import Trial
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.attempts.failure import OutOfTime, error_of, failure_of
from cmbot.planning.budget import Deadline
from cmbot.planning.request import StrokeRequest
from cmbot.robot import Kinematics
from cmbot.scene import Scene, load_scene
from cmbot.trajectory import QuinticTrajectory

LEGS = [{"by": [0, -0.1, 0], "seconds": seconds} for seconds in (4, 2, 4)]


@pytest.fixture(scope="module")
def asked() -> StrokeRequest:
    return request_of(short_scene(tool_path={"legs": LEGS, "via_points": 16}))


@pytest.fixture(scope="module")
def trajectory() -> QuinticTrajectory:
    return problem_of(short_scene(tool_path={"legs": LEGS, "via_points": 16})).parametrization.trajectory


def failed(limit: Limit, trajectory: QuinticTrajectory | None, violation: float = 1.0) -> OptimisationFailed:
    return OptimisationFailed(
        "no", constraint=limit.value, violation=violation, trajectory=trajectory, limit=limit
    )


def violation(limit: Limit, value: float) -> LimitViolation:
    return LimitViolation("it", time=5.0, value=value, bound=1.0, unit="", limit=limit)


@pytest.mark.parametrize(
    ("failure", "factor"),
    [
        (violation(Limit.VELOCITY, 8.0), 8.0),
        (violation(Limit.ACCELERATION, 4.0), 2.0),
        (violation(Limit.JERK, 8.0), 2.0),
        (violation(Limit.VELOCITY, 80.0), None),
        (violation(Limit.OTHER, 8.0), None),
        (violation(Limit.TOOL_DEVIATION, 8.0), None),
        (PathNotFound("slow", time=5.0, progress=0.5, smallest_singular_value=1.0, pace=1.5), 1.5),
        (PathNotFound("blocked", time=5.0, progress=0.5, smallest_singular_value=1.0), None),
        (failed(Limit.CLEARANCE, None), None),
        (failed(Limit.JERK, None), None),
    ],
)
def test_the_leg_of_a_failure_is_slowed_down_by_the_root_of_the_ratio(
    asked: StrokeRequest, failure: PlanningError, factor: float | None
) -> None:
    factors = slower_legs(asked, failure_of(asked, failure))
    if factor is None:
        assert factors is None
        return
    np.testing.assert_allclose(factors, [1, 1.05 * factor, 1], rtol=1e-12)


def test_a_trajectory_slowed_down_so_keeps_the_limits(
    asked: StrokeRequest, trajectory: QuinticTrajectory
) -> None:
    fast = QuinticTrajectory(t=0.2 * trajectory.t, q=trajectory.q, v=5 * trajectory.v, a=25 * trajectory.a)
    path = asked.task.path.in_seconds(0.2 * asked.task.path.seconds)
    hasty = replace(asked, task=replace(asked.task, path=path), times=path.via_times(16))
    # A tool that such joints leave far behind needs the time, not more via-points.
    astray = failed(Limit.TOOL_DEVIATION, fast, 99.0)
    np.testing.assert_allclose(slower_legs(hasty, failure_of(hasty, astray)), 2.1)
    assert slower_legs(hasty, failure_of(hasty, failed(Limit.TOOL_DEVIATION, fast))) is None
    factors = slower_legs(hasty, failure_of(hasty, failed(Limit.JERK, fast)))
    # All legs by the largest factor: derivative k falls by its power k.
    slow, limits = factors.max() / 1.05, asked.cell.robot.limits
    for order, bound in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        assert (fast.extrema(order).largest()[0] <= bound * slow**order * (1 + 1e-9)).all()
    after = slower(hasty, factors)
    assert (after.task.path.seconds >= factors * path.seconds * (1 - 1e-12)).all()
    assert after.task.path.leg_times[-1] == pytest.approx(after.times[-1])
    first = f"tool_path.legs[0].seconds {after.task.path.seconds[0]:g} instead of 0.8"
    assert in_keys(hasty, after).startswith(first)


def test_seconds_are_round_and_many_legs_are_one(asked: StrokeRequest) -> None:
    after = slower(asked, np.array([1.0, 1.611, 1.0]))
    assert in_keys(asked, after) == "tool_path.legs[1].seconds 3.3 instead of 2"
    hardly = asked.task.path.in_seconds(asked.task.path.seconds * [1.0, 1.00001, 1.0])
    after = replace(asked, task=replace(asked.task, path=hardly))
    assert in_keys(asked, after) == "tool_path.legs[1].seconds 2.00002 instead of 2"
    many = request_of(short_scene(tool_path={"legs": 2 * LEGS, "via_points": 16}))
    after = slower(many, np.array([1.0, 1.1, 1.2, 1.3, 1.5, 1.0]))
    np.testing.assert_allclose(after.task.path.seconds, 1.5 * many.task.path.seconds)
    assert in_keys(many, after) == "every leg of tool_path.legs in 1.5 times its seconds"


def test_all_that_was_changed_is_told(asked: StrokeRequest) -> None:
    assert changed_in_words(asked, asked) == ""
    after = slower(asked.with_options(safety_margin_m=0.01), np.array([1.0, 1.611, 1.0]))
    after = replace(after, task=replace(after.task, keep="position"))
    assert changed_in_words(asked, after) == (
        "planner.safety_margin_m 0.01 instead of 0.02 and tool_path.keep position instead of pose "
        "and tool_path.legs[1].seconds 3.3 instead of 2"
    )


def test_pairs_and_joints_of_constraints_are_named(
    asked: StrokeRequest, trajectory: QuinticTrajectory
) -> None:
    smallest = asked.cell.clearances.query(trajectory.evaluate(np.linspace(0, 10, 2001)))
    pair = asked.cell.clearances.pairs[int(smallest.pair[smallest.distance.argmin()])]
    for limit, expected in (
        (Limit.CLEARANCE, f"clearance of {pair.link} from {pair.other}"),
        (Limit.JOINT_TORQUE, r"torque of joint_\d"),
        (Limit.TOOL_LAG, "tool lag"),
    ):
        error = error_of(failure_of(asked, failed(limit, trajectory)))
        assert re.search(f"worst constraint: {expected}, 100.00% beyond", str(error))
        assert error.trajectory is trajectory


ERRORS = (
    PathNotFound("blocked", time=1.0, progress=0.5, smallest_singular_value=0.01, pair=("a", "b"), pace=2.0),
    OptimisationFailed("no", constraint="tool lag", violation=0.5, limit=Limit.TOOL_LAG, time=1.5),
    LimitViolation("jerk of joint_1", time=1.0, value=2.0, bound=1.0, unit="rad/s3", limit=Limit.JERK),
)


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_error_is_made_of_its_failure_again(asked: StrokeRequest, error: PlanningError) -> None:
    again = error_of(failure_of(asked, error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)


def test_hints_of_an_error_are_kept(asked: StrokeRequest) -> None:
    error = PathNotFound("blocked", time=1.0, progress=0.5, smallest_singular_value=1.0)
    error.add_hint("with return: none the job is planned")
    again = error_of(failure_of(asked, error))
    assert str(again) == str(error)
    assert str(again).endswith("; with return: none the job is planned")


def test_every_limit_is_broken_in_some_way(asked: StrokeRequest) -> None:
    """What a joint cannot do asks for time, what the tool does between via-points for more of them."""
    kinds = {limit: type(failure_of(asked, violation(limit, 2.0)).broken).__name__ for limit in Limit}
    assert {kinds[limit] for limit in (Limit.VELOCITY, Limit.ACCELERATION, Limit.JERK)} == {"JointRate"}
    assert kinds[Limit.CLEARANCE] == "NearObstacle"
    assert all(kinds[limit] == "ToolOff" for limit in Limit if limit.name.startswith("TOOL"))
    assert kinds[Limit.HOLD] == kinds[Limit.OTHER] == "OtherLimit"


def test_a_time_that_was_over_is_told_with_the_limit_and_what_was_used(asked: StrokeRequest) -> None:
    now = [0.0]
    said = []
    for left, used in ((1, 61.25), (3, 21.0)):
        now[0] = 0.0
        deadline = Deadline(60.0, lambda: now[0])
        timed = replace(asked, deadline=deadline if left == 1 else deadline.part(left, asked.stroke.name))
        now[0] = used
        said.append(timed.deadline.over_in_words)
    work = asked.stroke.name
    assert said == [
        "the time, 60 s (raise planner.time_limit_s for more), was over after 61.2 s,",
        f"the time, 60 s (raise planner.time_limit_s for more), of which {work} had 20 s, "
        "was over after 21 s,",
    ]


def test_what_was_stopped_has_no_remedy(asked: StrokeRequest) -> None:
    late = OptimisationFailed(
        "late", constraint="clearance", violation=0.1, limit=Limit.CLEARANCE, stopped=True
    )
    failure = failure_of(asked, late)
    assert isinstance(failure, OutOfTime)
    assert slower_legs(asked, failure) is None
    assert eased(asked, failure) is None
    assert str(error_of(failure)) == str(late)


def test_bounds_are_eased_by_what_failed(asked: StrokeRequest) -> None:
    options = asked.cell.options

    def changed(error: PlanningError) -> tuple[str, dict[str, Any]] | None:
        found = eased(asked, failure_of(asked, error))
        if found is None:
            return None
        before, after = asdict(options), asdict(found.cell.options)
        values = {name: value for name, value in after.items() if value != before[name]}
        return changed_in_words(asked, found), values

    words, values = changed(failed(Limit.TOOL_DEVIATION, None, 0.5))
    assert words == "planner.max_tool_deviation_m 0.00032 instead of 0.0002"
    assert values == {"max_tool_deviation_m": 0.00032}
    lagging = violation(Limit.TOOL_LAG, 1.5)
    assert set(changed(lagging)[1]) == {"max_tool_lag_m"}
    near = LimitViolation("it", time=1.0, value=0.0151, bound=0.02, unit="m", limit=Limit.CLEARANCE)
    assert changed(near) == ("planner.safety_margin_m 0.014 instead of 0.02", {"safety_margin_m": 0.014})
    # Another bound, one that would be another job, and what collides.
    for failure in (
        failed(Limit.JERK, None, 0.5),
        failed(Limit.TOOL_DEVIATION, None, 5.0),
        LimitViolation("it", time=1.0, value=-0.001, bound=0.02, unit="m", limit=Limit.CLEARANCE),
        PathNotFound("blocked", time=1.0, progress=0.5, smallest_singular_value=1.0, pair=("a", "b")),
    ):
        assert changed(failure) is None


def test_a_margin_that_would_do_for_the_start_is_tried_and_told() -> None:
    """An obstacle 15 mm from the start: of the safety margins of round numbers one below is tried."""
    scene = near_start(0.015)
    with pytest.raises(
        PathNotFound,
        match=r"within 0\.0150 m of ball, .*; planner.safety_margin_m 0\.014 instead of 0\.02 would do$",
    ):
        plan(scene, progress=False)
    assert plan(
        scene, options=replace(scene.planner, safety_margin_m=0.014), progress=False
    ).certificate.holds
    # In an obstacle none does.
    with pytest.raises(PathNotFound, match=r"reaches 0\.0050 m into ball") as caught:
        plan(near_start(-0.005), progress=False)
    assert "would do" not in str(caught.value)
    assert str(caught.value).startswith("start.posture_deg: no path: ")
    assert str(caught.value).endswith("; expected a start that is clear by planner.safety_margin_m")


def test_less_is_kept_where_nothing_leads_on(asked: StrokeRequest) -> None:
    """What a certificate misses, and a start that is too near, have to do with other things than the pose."""
    at = {"smallest_singular_value": 1.0, "pair": ("a", "b")}
    for error, kept in (
        (PathNotFound("blocked", time=5.0, progress=0.5, **at), ["axis", "position"]),
        (failed(Limit.POSITION, None), ["axis", "position"]),
        (PathNotFound("blocked", time=0.0, progress=0.0, **at), []),
        (violation(Limit.JERK, 8.0), []),
    ):
        outcome = failure_of(asked, error)
        trial = Trial(attempt=Attempt(request=asked, guess=outcome), outcome=outcome)
        assert [attempt.request.task.keep for attempt in LESS_KEPT.propose(trial)] == kept


def test_what_fails_otherwise_is_told_where_nothing_does(
    asked: StrokeRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = PathNotFound("no approach (a is near)", time=0.0, progress=0.0, smallest_singular_value=1.0)
    monkeypatch.setattr(stroke, "certified_motion", lambda attempt: failure_of(attempt.request, blocked))
    failure = failure_of(asked, violation(Limit.JERK, 8.0))
    refused = Trial(attempt=Attempt(request=asked, guess=failure), outcome=failure)
    assert stroke.advice(refused) == "in 1.22 times the time: no approach"


def test_a_margin_that_would_do_for_a_place_on_the_way_is_tried_and_told(short_plan: Plan) -> None:
    """An obstacle 15 mm from the tool where the path ends: no posture there is further away."""
    scene = near(short_plan.trajectory.q[-1], 0.015, -1.0)
    with pytest.raises(PathNotFound, match=r"blocked at .* 0\.0150 m of ball, .*; planner") as caught:
        plan(scene, progress=False)
    assert str(caught.value).endswith("; planner.safety_margin_m 0.014 instead of 0.02 would do")
    smaller = replace(scene.planner, safety_margin_m=0.014)
    assert plan(scene, options=smaller, progress=False).certificate.holds


def near_start(distance: float) -> Scene:
    """Scene with a ball so far behind the first link that moves away from nothing else, m."""
    return near(short_scene().posture, distance, 1.0)


def near(posture: FloatArray, distance: float, along_y: float) -> Scene:
    """Scene with a ball so far from the arm in a posture, m, in a direction from its tool."""
    point = Kinematics(request_of(short_scene()).cell.robot).tool_pose(posture).translation
    ball = {"name": "ball", "sphere": 0.05, "xyz": point.tolist()}
    low, high = 0.0, 1.0
    for _ in range(25):  # to less than a tenth of a micrometre
        away = 0.5 * (low + high)
        ball["xyz"] = (point + away * np.array([0.0, along_y, 0.0])).tolist()
        other = request_of(short_scene(obstacles=[ball])).cell.clearances.query(posture[None])
        low, high = (away, high) if other.distance[0] < distance else (low, away)
    return short_scene(obstacles=[ball])


RASTER = {
    "origin": [1.8, 0.7, -1.9],
    "u": [0, -0.1, 0],
    "v": [0, 0, -0.2],
    "spacing_m": 0.1,
    "stand_off_m": 0.1,
}


@pytest.mark.parametrize(
    ("time", "changed"),
    [
        ({"speed_m_s": 0.1}, "{key}.speed_m_s 0.066 instead of 0.1"),
        ({"seconds": 4}, "{key}.seconds 6 instead of 4"),
    ],
)
def test_slower_legs_are_named_by_the_keys_of_the_stroke(time: dict[str, float], changed: str) -> None:
    strokes = [{"name": name, "raster": RASTER, "via_points": 20, **time} for name in ("one", "two")]
    scene = load_scene({**SHORT, "tool_path": {"strokes": strokes}})
    before = request_of(scene)
    before = before.at_stroke(1)
    key = "tool_path.strokes[1]"
    # Its rows have no durations of their own.
    after = slower(before, np.array([1.0, 1.0, 1.5, 1.0, 1.0]))
    np.testing.assert_allclose(after.task.path.seconds / before.task.path.seconds, 1.5, rtol=0.02)
    assert in_keys(before, after) == changed.format(key=key)


def test_a_tool_too_near_to_its_workpiece_is_told_what_lets_it_touch(
    asked: StrokeRequest, trajectory: QuinticTrajectory
) -> None:
    place = Kinematics(asked.cell.robot).tool_pose(asked.state.posture).translation
    for workpiece in (True, False):
        box = {"name": "plate", "box": [0.02] * 3, "xyz": place.tolist(), "workpiece": workpiece}
        data = {"tool_path": {"legs": LEGS, "via_points": 16}, "obstacles": [box]}
        near = request_of(short_scene(**data))
        said = str(error_of(failure_of(near, failed(Limit.CLEARANCE, trajectory, 0.01))))
        advice = " (tool.contact_mm lets the tip touch it)" * workpiece
        assert f"worst constraint: clearance of tool from plate{advice}, 1.00% beyond" in said
