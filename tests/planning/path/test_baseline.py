"""The baseline, the motion without optimisation: its derivatives, and its rest at both ends."""

import numpy as np
import pytest

from cmbot.planning import Plan
from cmbot.robot import Dynamics


def test_it_rests_before_and_after(triangle_plan: Plan) -> None:
    """The same motion with a second of rest on either side has the same differences, but for its rest."""
    baseline = triangle_plan.baseline
    np.testing.assert_allclose(np.diff(baseline.t), 0.01, rtol=1e-9)
    rates = np.vstack([np.zeros((100, 7)), baseline.v, np.zeros((100, 7))])
    a = np.gradient(rates, 0.01, axis=0)
    np.testing.assert_allclose(baseline.a[1:-1], a[101:-101], rtol=0, atol=1e-10)
    np.testing.assert_allclose(baseline.j, np.gradient(a, 0.01, axis=0)[100:-100], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(baseline.a[[0, -1]], 0.0)


def test_its_torque_at_either_end_is_that_of_rest_and_in_the_figures(triangle_plan: Plan) -> None:
    """On the triangle the weight in the scene's posture asks the most of the whole motion."""
    baseline, figures = triangle_plan.baseline, triangle_plan.baseline_figures
    dynamics = Dynamics(triangle_plan.robot)
    static = dynamics.static_efforts(baseline.q[[0, -1]]).guardrail_torque
    np.testing.assert_allclose(baseline.guardrail_torque[[0, -1]], static, rtol=0, atol=1e-4)
    start = dynamics.static_efforts(triangle_plan.scene.posture[None]).guardrail_torque
    assert figures.peak_guardrail_torque == pytest.approx(np.linalg.norm(start), rel=1e-6)
    assert figures.peak_guardrail_torque == pytest.approx(figures.peak_static_guardrail_torque, rel=1e-6)
