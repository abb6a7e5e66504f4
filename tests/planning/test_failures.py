"""Failures: what is in the way is named, and how slow legs would have to be."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from small_scenes import SHORT, context_of, problem_of, short_scene

from cmbot.common.errors import LimitViolation, OptimisationFailed, PathNotFound, PlanningError
from cmbot.planning import plan
from cmbot.planning.context import PlanningContext
from cmbot.planning.failures import constraints_named, eased, in_keys, slower, slower_legs
from cmbot.planning.progress import ProgressReporter
from cmbot.robot import Kinematics
from cmbot.scene import Scene, load_scene
from cmbot.trajectory import QuinticTrajectory

LEGS = [{"by": [0, -0.1, 0], "seconds": seconds} for seconds in (4, 2, 4)]


@pytest.fixture(scope="module")
def context() -> PlanningContext:
    return context_of(short_scene(tool_path={"legs": LEGS, "via_points": 16}))


@pytest.fixture(scope="module")
def trajectory() -> QuinticTrajectory:
    return problem_of(short_scene(tool_path={"legs": LEGS, "via_points": 16})).parametrization.trajectory


def failed(constraint: str, trajectory: QuinticTrajectory | None) -> OptimisationFailed:
    return OptimisationFailed("no", constraint=constraint, violation=1.0, trajectory=trajectory)


def violation(quantity: str, value: float) -> LimitViolation:
    return LimitViolation(quantity, time=5.0, value=value, bound=1.0, unit="")


@pytest.mark.parametrize(
    ("failure", "factor"),
    [
        (violation("velocity of joint_1", 8.0), 8.0),
        (violation("acceleration of joint_1", 4.0), 2.0),
        (violation("jerk of joint_1", 8.0), 2.0),
        (violation("velocity of joint_1", 80.0), None),
        (violation("jump of a joint's position, velocity, acceleration or jerk", 8.0), None),
        (violation("tool deviation", 8.0), None),
        (PathNotFound("slow", time=5.0, progress=0.5, smallest_singular_value=1.0, pace=1.5), 1.5),
        (PathNotFound("blocked", time=5.0, progress=0.5, smallest_singular_value=1.0), None),
        (failed("clearance", None), None),
        (failed("jerk of joint_1", None), None),
    ],
)
def test_the_leg_of_a_failure_is_slowed_down_by_the_root_of_the_ratio(
    context: PlanningContext, failure: PlanningError, factor: float | None
) -> None:
    factors = slower_legs(context, failure)
    if factor is None:
        assert factors is None
        return
    np.testing.assert_allclose(factors, [1, 1.05 * factor, 1], rtol=1e-12)


def test_a_trajectory_slowed_down_so_keeps_the_limits(
    context: PlanningContext, trajectory: QuinticTrajectory
) -> None:
    fast = QuinticTrajectory(t=0.2 * trajectory.t, q=trajectory.q, v=5 * trajectory.v, a=25 * trajectory.a)
    path = replace(context.task.path, seconds=0.2 * context.task.path.seconds)
    hasty = replace(context, task=replace(context.task, path=path), times=path.via_times(16))
    # A tool that such joints leave far behind needs the time, not more via-points.
    astray = OptimisationFailed("no", constraint="tool deviation", violation=99.0, trajectory=fast)
    np.testing.assert_allclose(slower_legs(hasty, astray), 2.1)
    assert slower_legs(hasty, failed("tool deviation", fast)) is None
    factors = slower_legs(hasty, failed("jerk of joint_1", fast))
    # All legs by the largest factor: derivative k falls by its power k.
    slow, limits = factors.max() / 1.05, context.robot.limits
    for order, bound in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        assert (fast.extrema(order).largest()[0] <= bound * slow**order * (1 + 1e-9)).all()
    after = slower(hasty, factors)
    assert (after.task.path.seconds >= factors * path.seconds * (1 - 1e-12)).all()
    assert after.task.path.leg_times[-1] == pytest.approx(after.times[-1])
    first = f"tool_path.legs[0].seconds {after.task.path.seconds[0]:g} instead of 0.8"
    assert in_keys(hasty, after).startswith(first)


def test_seconds_are_round_and_many_legs_are_one(context: PlanningContext) -> None:
    after = slower(context, np.array([1.0, 1.611, 1.0]))
    assert in_keys(context, after) == "tool_path.legs[1].seconds 3.3 instead of 2"
    hardly = replace(context.task.path, seconds=context.task.path.seconds * [1.0, 1.00001, 1.0])
    after = replace(context, task=replace(context.task, path=hardly))
    assert in_keys(context, after) == "tool_path.legs[1].seconds 2.00002 instead of 2"
    many = context_of(short_scene(tool_path={"legs": 2 * LEGS, "via_points": 16}))
    after = slower(many, np.array([1.0, 1.1, 1.2, 1.3, 1.5, 1.0]))
    np.testing.assert_allclose(after.task.path.seconds, 1.5 * many.task.path.seconds)
    assert in_keys(many, after) == "every leg of tool_path.legs in 1.5 times its seconds"


def test_pairs_and_joints_of_constraints_are_named(
    context: PlanningContext, trajectory: QuinticTrajectory
) -> None:
    smallest = context.clearances.smallest(trajectory.evaluate(np.linspace(0, 10, 2001)))
    pair = context.clearances.pairs[int(smallest.pair[smallest.distance.argmin()])]
    for constraint, expected in (
        ("clearance", f"clearance of {pair.link} from {pair.other}"),
        ("joint torque", r"torque of joint_\d"),
        ("tool lag", "tool lag"),
    ):
        with (
            pytest.raises(
                OptimisationFailed, match=f"worst constraint: {expected}, 100.00% beyond"
            ) as caught,
            constraints_named(context),
        ):
            raise failed(constraint, trajectory)
        assert caught.value.trajectory is trajectory


def test_a_time_that_was_over_is_told_with_the_limit_and_what_was_used(context: PlanningContext) -> None:
    now = [0.0]
    reporter = ProgressReporter(clock=lambda: now[0], limit=60.0)
    late = OptimisationFailed("the time was over before that", constraint="peak", violation=0.2803)
    said = []
    for left, used in ((1, 61.25), (3, 21.0)):
        now[0] = 0.0
        reporter.begin_stroke("edge", left)
        now[0] = used
        timed = replace(context, reporter=reporter)
        with pytest.raises(OptimisationFailed) as caught, constraints_named(timed):
            raise late
        said.append(str(caught.value))
    peak = (
        "before that; worst constraint: the peak, which exceeds the bound that was tried for it by 28.03% of "
        "the initial guess's peak"
    )
    work = context.stroke.name
    assert said == [
        f"the time, 60 s (planner.time_limit_s), was over after 61.2 s, {peak}",
        f"the time, 60 s (planner.time_limit_s), of which {work} had 20 s, was over after 21 s, {peak}",
    ]


def test_bounds_are_eased_by_what_failed(context: PlanningContext) -> None:
    options = context.options

    def changed(failure: PlanningError) -> tuple[str, dict[str, Any]] | None:
        found = eased(context, failure)
        if found is None:
            return None
        before, after = asdict(options), asdict(found[1].options)
        return found[0], {name: value for name, value in after.items() if value != before[name]}

    strays = OptimisationFailed("no", constraint="tool deviation", violation=0.5)
    words, values = changed(strays)
    assert words == "planner.max_tool_deviation_m 0.0016 instead of 0.001"
    assert values == {"max_tool_deviation_m": 0.0016}
    lagging = LimitViolation(
        "tool lag", time=1.0, value=1.5 * options.max_tool_lag_m, bound=options.max_tool_lag_m, unit="m"
    )
    assert set(changed(lagging)[1]) == {"max_tool_lag_m"}
    near = LimitViolation("clearance of a from b", time=1.0, value=0.0151, bound=0.02, unit="m")
    assert changed(near) == ("planner.safety_margin_m 0.014 instead of 0.02", {"safety_margin_m": 0.014})
    # Another bound, one that would be another job, and what collides.
    for failure in (
        OptimisationFailed("no", constraint="jerk of joint_1", violation=0.5),
        OptimisationFailed("no", constraint="tool deviation", violation=5.0),
        LimitViolation("clearance of a from b", time=1.0, value=-0.001, bound=0.02, unit="m"),
        PathNotFound("blocked", time=1.0, progress=0.5, smallest_singular_value=1.0, pair=("a", "b")),
    ):
        assert eased(context, failure) is None


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


def near_start(distance: float) -> Scene:
    """Scene with a ball so far behind the first link that moves away from nothing else, m."""
    scene = short_scene()
    context = context_of(scene)
    point = Kinematics(context.robot).tool_pose(scene.posture).translation
    ball = {"name": "ball", "sphere": 0.05, "xyz": point.tolist()}
    low, high = 0.0, 1.0
    for _ in range(60):
        away = 0.5 * (low + high)
        ball["xyz"] = (point + away * np.array([0.0, 1.0, 0.0])).tolist()
        other = context_of(short_scene(obstacles=[ball])).clearances.smallest(scene.posture[None])
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
    before = context_of(scene)
    before = before.at_stroke(1, scene, before.posture, 0.0, 0.0)
    key = "tool_path.strokes[1]"
    # Its rows have no durations of their own.
    after = slower(before, np.array([1.0, 1.0, 1.5, 1.0, 1.0]))
    np.testing.assert_allclose(after.task.path.seconds / before.task.path.seconds, 1.5, rtol=0.02)
    assert in_keys(before, after) == changed.format(key=key)
