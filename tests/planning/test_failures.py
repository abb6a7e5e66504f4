"""Failures: what is in the way is named, and how slow legs would have to be."""

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import context_of, problem_of, short_scene

from cmbot.common.errors import LimitViolation, OptimisationFailed, PathNotFound, PlanningError
from cmbot.planning.context import PlanningContext
from cmbot.planning.failures import constraints_named, in_keys, slower, slower_legs
from cmbot.planning.progress import ProgressReporter
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
        "the initial guess's peak: a larger planner.time_limit_s may help"
    )
    work = context.stroke.name
    assert said == [
        f"the time, 60 s (planner.time_limit_s), was over after 61.2 s, {peak}",
        f"the time, 60 s (planner.time_limit_s), of which {work} had 20 s, was over after 21 s, {peak}",
    ]


def test_a_tool_far_away_needs_time_where_joints_are_hasty_and_via_points_where_not(
    context: PlanningContext, trajectory: QuinticTrajectory
) -> None:
    for slower_by, remedy in ((0.2, "more seconds in tool_path.legs"), (100, "more tool_path.via_points")):
        timed = QuinticTrajectory(
            t=slower_by * trajectory.t,
            q=trajectory.q,
            v=trajectory.v / slower_by,
            a=trajectory.a / slower_by**2,
        )
        astray = OptimisationFailed("no", constraint="tool deviation", violation=99.0, trajectory=timed)
        path = replace(context.task.path, seconds=slower_by * context.task.path.seconds)
        with (
            pytest.raises(OptimisationFailed) as caught,
            constraints_named(replace(context, task=replace(context.task, path=path))),
        ):
            raise astray
        assert str(caught.value).endswith(f"far beyond its bound: {remedy} may help")


RASTER = {
    "origin": [1.8, 0.7, -1.9],
    "u": [0, -0.1, 0],
    "v": [0, 0, -0.2],
    "spacing_m": 0.1,
    "stand_off_m": 0.1,
}


@pytest.mark.parametrize(
    ("time", "more", "changed"),
    [
        ({"speed_m_s": 0.1}, "a lower {key}.speed_m_s", "{key}.speed_m_s 0.066 instead of 0.1"),
        ({"seconds": 4}, "more {key}.seconds", "{key}.seconds 6 instead of 4"),
    ],
)
def test_remedies_name_the_keys_of_the_stroke(time: dict[str, float], more: str, changed: str) -> None:
    strokes = [{"name": name, "raster": RASTER, "via_points": 20, **time} for name in ("one", "two")]
    scene = short_scene(tool_path={"strokes": strokes, "legs": (), "via_points": 50})
    before = context_of(scene)
    before = before.at_stroke(1, scene, before.posture, 0.0, 0.0)
    key = "tool_path.strokes[1]"
    with pytest.raises(OptimisationFailed) as caught, constraints_named(before):
        raise failed("jerk of joint_1", None)
    # Its speed profile is smooth already.
    assert str(caught.value).endswith(f": {more.format(key=key)} may help")
    with (
        pytest.raises(OptimisationFailed, match=r"more tool_path.strokes\[1\].via_points or"),
        constraints_named(before),
    ):
        raise failed("tool deviation", None)
    # Its rows have no durations of their own.
    after = slower(before, np.array([1.0, 1.0, 1.5, 1.0, 1.0]))
    np.testing.assert_allclose(after.task.path.seconds / before.task.path.seconds, 1.5, rtol=0.02)
    assert in_keys(before, after) == changed.format(key=key)
