"""The baseline, the motion without optimisation: its derivatives, and its rest at both ends."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from small_scenes import short_scene

from cmbot.planning import Plan, plan
from cmbot.robot import Dynamics
from cmbot.trajectory import quintic, sample_step


def test_it_rests_before_and_after(triangle_plan: Plan) -> None:
    """The same motion with a second of rest on either side has the same differences, but for its rest."""
    baseline = triangle_plan.baseline.samples
    np.testing.assert_allclose(np.diff(baseline.t), 0.01, rtol=1e-9)
    rates = np.vstack([np.zeros((100, 7)), baseline.v, np.zeros((100, 7))])
    a = np.gradient(rates, 0.01, axis=0)
    np.testing.assert_allclose(baseline.a[1:-1], a[101:-101], rtol=0, atol=1e-10)
    np.testing.assert_allclose(baseline.j, np.gradient(a, 0.01, axis=0)[100:-100], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(baseline.a[[0, -1]], 0.0)


def test_its_torque_at_either_end_is_that_of_rest_and_in_the_figures(triangle_plan: Plan) -> None:
    """On the triangle the weight in the scene's posture asks the most of the whole motion."""
    baseline, figures = triangle_plan.baseline.samples, triangle_plan.baseline.figures
    dynamics = Dynamics(triangle_plan.robot)
    static = dynamics.static_efforts(baseline.q[[0, -1]]).guardrail_torque
    np.testing.assert_allclose(baseline.guardrail_torque[[0, -1]], static, rtol=0, atol=1e-4)
    start = dynamics.static_efforts(triangle_plan.scene.posture[None]).guardrail_torque
    assert figures.peak_guardrail_torque == pytest.approx(np.linalg.norm(start), rel=1e-6)
    assert figures.peak_guardrail_torque == pytest.approx(figures.peak_static_guardrail_torque, rel=1e-6)


def test_the_papers_baseline_keeps_its_trapezoid(triangle_plan: Plan) -> None:
    """A leg of 1 m in 10 s with ramps of 2 s: the tool goes at 0.125 m/s in between."""
    assert triangle_plan.scene.strokes[0].speed_profile.kind == "quiet"
    samples = triangle_plan.baseline.samples
    speed = np.linalg.norm(np.gradient(samples.tool_point, samples.t, axis=0), axis=1)
    between = (samples.t > 2.2) & (samples.t < 7.8)
    np.testing.assert_allclose(speed[between], 0.125, rtol=5e-3)
    assert triangle_plan.baseline.drift < 1e-4


@given(duration=st.floats(0.01, 1e5), step=st.sampled_from([1e-4, 0.01, 0.1]))
def test_the_number_of_steps_is_bounded(duration: float, step: float) -> None:
    taken = sample_step(duration, step)
    assert duration / taken <= 40_000 * (1 + 1e-12)
    # No longer than need be, and round.
    assert taken == step or duration / taken > 40_000 / 2.5 * (1 - 1e-12)
    assert round(taken / step) == pytest.approx(taken / step) and str(round(taken / step))[0] in "125"


def test_what_a_long_leg_costs_does_not_grow_with_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Euler's steps may be longer than the feedback's time constant; the tool stays on its path."""
    monkeypatch.setattr(quintic, "_MAX_MOTION_STEPS", 400)
    legs = [{"by": [0, -0.3, 0], "seconds": 4000}]
    scene = short_scene(tool_path={"legs": legs, "via_points": 12}, planner={"knots": "sliding"})
    made = plan(scene)
    assert len(made.baseline.samples.t) == 401
    assert made.baseline.samples.t[1] == pytest.approx(10.0)
    assert made.baseline.drift < 1e-4
    assert len(made.job_samples[0].t) <= 403
    assert np.abs(np.diff(made.baseline.samples.q, axis=0)).max() < 0.05
    assert made.sway is not None and made.sway.swing_mm < 1e-6
