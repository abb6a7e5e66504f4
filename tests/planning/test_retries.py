"""Where no trajectory follows the way of least torque, one in shorter steps between via-points is planned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from six_joint_arms import ur_scene
from small_scenes import short_scene

from cmbot.common.errors import OptimisationFailed, PathNotFound
from cmbot.planning import plan, remarks
from cmbot.planning.context import PlanningContext, build_context
from cmbot.planning.initial_guess import InitialGuess, fixed_guess, sliding_guess
from cmbot.planning.retries import calmer_ways, followed, roughness
from cmbot.scene import Scene

FAILURE = OptimisationFailed("no", constraint="jerk of joint_3", violation=1.0)
POSTURE = [41, 119, -70, 85, 48, -67]
TURNED = [([-0.086, 0.027, 0.101], 4.3), ([-0.081, 0.096, 0.037], 3.6)]
UNREACHED = PathNotFound("no approach", time=0.0, progress=0.0, smallest_singular_value=1.0)


def rough_scene(start: str = "pinned") -> Scene:
    """Its charts are so coarse that the way of least torque jumps to and fro."""
    return short_scene(planner={"knots": "sliding", "start": start, "chart_spacing": 0.4, "quiet_modes": 0})


@pytest.fixture(scope="module")
def rough() -> tuple[PlanningContext, InitialGuess]:
    scene = rough_scene()
    context = build_context(scene, scene.planner)
    return context, sliding_guess(context)


def turned_wrist(folder: Path, **planner: object) -> Scene:
    """A UR3: of its two ways to hold the tool's pose the one with less torque turns a wrist too fast."""
    legs = [{"by": by, "seconds": seconds} for by, seconds in TURNED]
    return ur_scene(folder, "ur3", POSTURE, {"legs": legs, "via_points": 25}, **planner)


def longest_step(way: InitialGuess) -> float:
    return float(np.abs(np.diff(way.problem.family.via_points, axis=0)).max())


def test_half_the_steps_from_the_same_charts(rough: tuple[PlanningContext, InitialGuess]) -> None:
    context, way = rough
    assert way.stage is not None
    assert way.stage.step_share == context.options.step_share
    half = way.stage.halved()
    assert half.step_share == 0.5 * way.stage.step_share
    assert half.lower_bound is way.stage.lower_bound
    # Shorter steps are some of the longer ones, and what was known before stays as it was.
    assert half.solve(pinned=True).peak >= way.stage.solve(pinned=True).peak
    np.testing.assert_array_equal(
        sliding_guess(context).problem.family.via_points, way.problem.family.via_points
    )


def test_roughness_is_the_largest_share_of_any_bound(rough: tuple[PlanningContext, InitialGuess]) -> None:
    problem = rough[1].problem
    start = problem.trajectory(problem.family, problem.family.start)
    t = np.linspace(start.t[0], start.t[-1], 20001)
    shares = [
        np.abs(start.evaluate(t, order)).max(axis=0) / bound
        for order, bound in (
            (1, problem.robot.limits.velocity),
            (2, problem.robot.limits.acceleration),
            (3, problem.robot.limits.jerk),
        )
    ]
    assert roughness(problem) == pytest.approx(np.max(shares), rel=1e-3)


def test_other_ways_are_few_and_each_is_calmer(rough: tuple[PlanningContext, InitialGuess]) -> None:
    context, way = rough
    found = list(calmer_ways(context, way, FAILURE))
    assert 1 <= len(found) <= 2
    for before, after in zip([way, *found], found, strict=False):
        assert roughness(after.problem) <= 0.9 * roughness(before.problem)
        assert after.stage is not None
        assert before.stage is not None
        assert after.stage.step_share < before.stage.step_share
        assert 0 in after.resting
        assert "jerk of joint_3" in after.instead_of
        assert f"planned with {after.stage.step_share:.3g} instead" in after.instead_of
    assert not way.instead_of


def test_with_fixed_knots_there_is_no_other_way() -> None:
    scene = short_scene()
    context = build_context(scene, scene.planner)
    assert not list(calmer_ways(context, fixed_guess(context), FAILURE))


def test_a_way_that_is_followed_is_kept(rough: tuple[PlanningContext, InitialGuess]) -> None:
    context, way = rough
    assert followed(context, way, longest_step) == (way, longest_step(way))


def test_the_first_calmer_way_that_is_followed_is_taken(rough: tuple[PlanningContext, InitialGuess]) -> None:
    context, way = rough
    tried: list[InitialGuess] = []

    def work(some: InitialGuess) -> int:
        tried.append(some)
        if some is way:
            raise FAILURE
        return len(tried)

    calmer, done = followed(context, way, work)
    assert done == 2
    assert tried == [way, calmer]


def test_where_none_is_followed_the_first_failure_is_told(
    rough: tuple[PlanningContext, InitialGuess],
) -> None:
    context, way = rough
    other = OptimisationFailed("neither", constraint="velocity of joint_1", violation=2.0)
    tried: list[InitialGuess] = []

    def work(some: InitialGuess) -> int:
        tried.append(some)
        raise FAILURE if some is way else other

    with pytest.raises(OptimisationFailed) as caught:
        followed(context, way, work)
    assert caught.value is FAILURE
    assert len(tried) == 1 + len(list(calmer_ways(context, way, FAILURE)))


@pytest.mark.parametrize(("start", "expected"), [("free", UNREACHED), ("pinned", FAILURE)])
def test_an_approach_that_fails_is_told_where_the_start_may_be_given_up(
    monkeypatch: pytest.MonkeyPatch, start: str, expected: Exception
) -> None:
    monkeypatch.setattr("cmbot.planning.retries._CALMER", np.inf)
    scene = rough_scene(start)
    context = build_context(scene, replace(scene.planner, gap_target=0.0))
    way = sliding_guess(context)
    assert [0 in other.resting for other in calmer_ways(context, way, FAILURE)] == 2 * [start == "pinned"]

    def work(some: InitialGuess) -> int:
        raise FAILURE if some is way else UNREACHED

    with pytest.raises(type(expected)) as caught:
        followed(context, way, work)
    assert caught.value is expected


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
