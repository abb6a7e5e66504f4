"""What the pages' view shows besides the arms: nearest points, and where the bending arm has its tool."""

import numpy as np
import pytest
from page_data import floats

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views.replay_data import replay_data


def test_nearest_points_are_as_far_apart_as_the_clearance(
    triangle_plan: Plan, triangle_tracking: Tracking
) -> None:
    data = replay_data(triangle_plan, triangle_tracking)
    seen = set()
    for motion in (data["planned"], data["baseline"], data["approach"]["planned"], data["rest"]["planned"]):
        near, pair, clearance = (
            floats(motion["near"], 2, 3),
            floats(motion["pair"]),
            floats(motion["clearance"]),
        )
        shown = pair >= 0
        far = np.linalg.norm(near[:, 0] - near[:, 1], axis=1)
        np.testing.assert_allclose(far[shown], clearance[shown], atol=2e-4)
        assert (clearance[~shown] >= triangle_plan.options.avoidance_distance_m - 2e-4).all()
        seen |= {data["pairs"][int(k)] for k in pair[shown]}
    assert "tool – bracket_ab" in seen
    assert seen == set(data["pairs"])


def test_the_error_is_that_of_the_simulation(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    data = replay_data(triangle_plan, triangle_tracking)
    assert data["end"] == pytest.approx(triangle_tracking.planned.t[-1])
    times = np.linspace(0, data["duration"], len(floats(data["planned"]["clearance"])))
    for name, motion in (("planned", triangle_tracking.planned), ("baseline", triangle_tracking.baseline)):
        expected = np.stack([np.interp(times, motion.t, e) for e in motion.error.T], axis=1)
        np.testing.assert_allclose(floats(data[name]["error"], 3), expected, atol=1e-8)
        rest = data["rest"][name]
        assert np.ptp(floats(rest["tool"], 3), axis=0).max() == 0
        assert np.ptp(floats(rest["error"], 3), axis=0).max() > 0
    assert data["approach"]["planned"]["error"] is None
    assert replay_data(triangle_plan)["rest"] is None


def test_the_error_starts_where_the_tool_is_expected(compensated_short: tuple[Plan, Tracking]) -> None:
    made, tracking = compensated_short
    expected = made.samples.expected_tool_point
    assert expected is not None
    shown = floats(replay_data(made, tracking)["planned"]["tool"], 3)
    np.testing.assert_allclose(shown[[0, -1]], expected[[0, -1]], atol=1e-6)
    assert np.linalg.norm(shown[0] - made.samples.tool_point[0]) > 1e-3
