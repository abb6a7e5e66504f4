"""The predicted sway of laws along a leg, against the integrator of the accuracy budget."""

from collections.abc import Callable

import numpy as np
import pytest
from small_scenes import SHORT

from cmbot import Plan, load_scene, plan
from cmbot.accuracy import sway_along
from cmbot.accuracy.sway import Sway
from cmbot.common.arrays import FloatArray
from cmbot.elastic.modes import linearised
from cmbot.planning import bending_arm
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.flexibility.leg_response import LegResponse
from cmbot.planning.initial_guess import InitialGuess
from cmbot.planning.timing.timing import Timing
from cmbot.robot import load_robot
from cmbot.scene import Scene
from cmbot.toolpath import LegLaw, SpeedProfile, TimeLaw, extra_insensitive

SECONDS = 3.0


def by_share(law: TimeLaw) -> Callable[[FloatArray, int], FloatArray]:
    return lambda u, order: law.share(u) if order == 0 else law.rate(u, order)


@pytest.mark.parametrize("kind", ["trapezoidal", "jerk_limited", "quiet"])
def test_the_sway_of_a_law_is_that_of_the_whole_model(kind: str) -> None:
    scene = load_scene("triangle")
    robot = load_robot("cmbot")
    arm = bending_arm(scene, robot)
    assert arm is not None
    begin = np.array(scene.posture)
    way = np.array([0.3, -0.2, 0.2, 0.1, 0.3, -0.1, 0.2])

    def q(share: FloatArray, order: int) -> FloatArray:
        return begin + share[:, None] * way if order == 0 else np.tile((order == 1) * way, (len(share), 1))

    law = SpeedProfile(kind=kind, ramp=0.3).law

    def motion(t: FloatArray, order: int) -> FloatArray:
        u = np.minimum(t / SECONDS, 1.0)
        if order == 0:
            return q(law.share(u), 0)
        rate = law.rate(u, order) / SECONDS**order * (t < SECONDS)
        return rate[:, None] * way

    factors = [0.7, 1.0, 1.3]
    whole = sway_along(arm, motion, SECONDS, 0.01, factors)
    found = LegResponse(arm, q).of([by_share(law)], SECONDS, factors)
    np.testing.assert_allclose(found.sway[0], np.linalg.norm(whole.tool, axis=2).max(axis=1), rtol=0.1)


def test_what_accelerations_bend_slowly_is_the_sway_of_the_whole_model() -> None:
    """Of a small motion over many periods, hardly damped: damping resists the rate of the sag, too."""
    arm = bending_arm(load_scene("triangle"), load_robot("cmbot"))
    assert arm is not None
    begin, way = np.array(load_scene("triangle").posture), 1e-3 * np.array([3, -2, 2, 1, 3, -1, 2])
    law, seconds = SpeedProfile(kind="quiet", ramp=0.5).law, 40.0

    def motion(t: FloatArray, order: int) -> FloatArray:
        if order == 0:
            return begin + law.share(t / seconds)[:, None] * way
        return (law.rate(t / seconds, order) / seconds**order)[:, None] * way

    sway = sway_along(arm, motion, seconds, 1e-4)
    rows = linearised(arm, motion(sway.t, 0)).yielding
    slow = np.einsum("kij,kj->ki", rows, motion(sway.t, 2))
    assert np.abs(slow).max() > 1e-8
    np.testing.assert_allclose(sway.tool[0], slow, atol=0.02 * np.abs(slow).max())


def test_the_sway_of_each_leg_is_its_largest() -> None:
    t = np.linspace(0.0, 4.0, 81)
    tool = np.zeros((2, 81, 3))
    tool[0, t.searchsorted(0.5), 1], tool[1, t.searchsorted(1.5), 0] = -3.0, 2.0
    tool[1, t.searchsorted(3.9)] = 2.0, 1.0, -2.0
    # The last leg ends before the tool rests.
    np.testing.assert_allclose(Sway(t=t, tool=tool).of_legs(np.array([0.0, 1.0, 2.0, 3.0])), [3.0, 2.0, 3.0])


def test_a_shaper_lessens_the_swing_that_is_predicted() -> None:
    scene, robot = load_scene("triangle"), load_robot("cmbot")
    arm = bending_arm(scene, robot)
    assert arm is not None
    begin, way = np.array(scene.posture), np.full(7, 0.2)
    response = LegResponse(
        arm, lambda s, k: begin + s[:, None] * way if k == 0 else np.tile((k == 1) * way, (len(s), 1))
    )
    plain = TimeLaw.ramped("trapezoidal", 0.2, 0.6, 0.2)
    shaped = TimeLaw.ramped("quiet", 0.3, 0.4, 0.3).shaped(extra_insensitive(response.omega[0], 0.01), 5.0)
    found = response.of([by_share(plain), by_share(shaped)], 5.0, [0.7, 1.0, 1.3])
    assert (found.swing[1] < 0.2 * found.swing[0]).all()
    assert (found.sway[1] < found.sway[0]).all()


def quiet_short() -> Scene:
    data = {**SHORT, "tool_path": {**SHORT["tool_path"], "speed_profile": {"kind": "quiet", "ramp": 0.3}}}
    return load_scene(data)


@pytest.fixture(scope="module")
def quiet_plan() -> Plan:
    return plan(quiet_short())


def test_a_quiet_plan_sways_no_more_than_by_its_profile_alone(quiet_plan: Plan) -> None:
    sway = quiet_plan.sway
    assert sway is not None
    assert sway.unshaped_sway_mm is not None
    assert sway.sway_mm <= 1.02 * sway.unshaped_sway_mm


def test_laws_of_a_quiet_plan_take_the_seconds_of_the_scene(quiet_plan: Plan) -> None:
    (stroke,) = quiet_plan.scene.strokes
    assert stroke.time_laws
    for law in stroke.time_laws:
        assert law.duration == pytest.approx(stroke.legs[law.leg].given_seconds, rel=1e-9)
        assert (law.law.continuity == 3).all()


def test_laws_by_which_the_optimised_motion_sways_more_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """As an xArm7's are, whose jerks allow fewer via-points: the laws are then those of another path."""
    tried = list[LegLaw]()

    def hasty(attempt: Attempt) -> Attempt:
        assert isinstance(attempt.guess, InitialGuess)
        if attempt.plain:
            return attempt
        tried.append(LegLaw.of(0, TimeLaw.ramped("quiet", 0.15, 0.7, 0.15), 4.0))
        path = attempt.guess.problem.parametrization.trajectory
        timed = attempt.in_timing(Timing.along(attempt.request, path, (), tuple(tried)))
        assert isinstance(timed, Attempt)
        return timed

    monkeypatch.setattr(Attempt, "quiet", lambda attempt: attempt)
    plain = plan(quiet_short())
    monkeypatch.setattr(Attempt, "quiet", hasty)
    made = plan(quiet_short())
    assert len(tried) == 1
    # By the law of its profile alone.
    assert not made.scene.strokes[0].time_laws
    assert made.sway is not None and made.sway.unshaped_sway_mm is None
    np.testing.assert_array_equal(made.trajectory.q, plain.trajectory.q)
    assert made.runs == plain.runs + 1
