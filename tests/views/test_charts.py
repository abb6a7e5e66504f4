"""The report's plots: what they show, between which bounds, and how they are made light."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from page_data import floats

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views.charts import MOST_POINTS, charts, joint_charts, thinned


def test_peaks_survive_the_thinning(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    approach = triangle_plan.approach
    assert approach is not None
    torque = next(charts(triangle_plan, triangle_tracking))
    baseline, planned = (floats(curve["y"]) for curve in torque.data()["curves"])
    norms = np.linalg.norm(triangle_plan.baseline.guardrail_torque, axis=1)
    assert baseline.max() == pytest.approx(norms.max(), rel=1e-6)
    assert planned.max() == pytest.approx(approach.certificate.figures.peak_guardrail_torque, rel=1e-3)
    assert len(planned) <= MOST_POINTS
    for chart in joint_charts(triangle_plan):
        for curve, entry in zip(chart.curves, chart.data(50)["curves"], strict=True):
            y = floats(entry["y"])
            assert [y.min(), y.max()] == pytest.approx([curve.y.min(), curve.y.max()], rel=1e-6, abs=1e-6)


def test_joint_plots_reach_from_bound_to_bound(triangle_plan: Plan) -> None:
    limits, n = triangle_plan.robot.limits, triangle_plan.robot.dof
    made = list(joint_charts(triangle_plan))
    assert [chart.title for chart in made[::n]] == ["angle", "velocity", "acceleration", "jerk", "torque"]
    np.testing.assert_allclose(
        [chart.bounds for chart in made[:n]], np.rad2deg([limits.lower, limits.upper]).T
    )
    np.testing.assert_allclose([chart.bounds[1] for chart in made[4 * n :]], limits.torque)
    for chart in made:
        assert chart.bounds[0] is not None
        assert chart.bounds[1] is not None
        assert chart.axis[0] < chart.bounds[0] < chart.bounds[1] < chart.axis[1]


def test_tracking_errors_share_one_scale(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    along = [
        chart
        for chart in charts(triangle_plan, triangle_tracking)
        if chart.title.startswith("Tracking error")
    ]
    assert len(along) == 3
    spans = [chart.axis[1] - chart.axis[0] for chart in along]
    assert spans == pytest.approx([spans[0]] * 3)
    for chart in along:
        for curve in chart.curves:
            assert chart.axis[0] < curve.y.min() <= curve.y.max() < chart.axis[1]


def test_tracking_errors_that_lie_apart_stay_inside_their_frames(
    triangle_plan: Plan, triangle_tracking: Tracking
) -> None:
    planned = triangle_tracking.planned
    aside = np.array([0.0, 0.03, 0.0])
    apart = replace(planned, error=planned.error + aside, static=planned.static + aside)
    along = list(charts(triangle_plan, replace(triangle_tracking, planned=apart)))
    for chart in (chart for chart in along if chart.title.startswith("Tracking error")):
        for curve in chart.curves:
            assert chart.axis[0] < curve.y.min() <= curve.y.max() < chart.axis[1]


def test_it_is_said_where_an_error_is_measured_from(
    triangle_plan: Plan, triangle_tracking: Tracking, compensated_short: tuple[Plan, Tracking]
) -> None:
    for made, words in (
        ((triangle_plan, triangle_tracking), "minus the rigid arm's at the same joint angles. "),
        (compensated_short, "predicted sag"),
    ):
        notes = [chart.note for chart in charts(*made) if chart.title.startswith("Tracking error")]
        assert words in notes[0]
        assert notes[1:] == ["", ""]
        assert ("expected position" in notes[0]) == (made is compensated_short)


def test_plots_without_the_approach_say_why(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    for chart in charts(triangle_plan, triangle_tracking):
        assert (min(curve.t[0] for curve in chart.curves) < 0) == (chart.approach == "")


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=300), st.integers(4, 60))
def test_thinning_keeps_ends_and_extremes(values: list[float], most: int) -> None:
    y = np.array(values)
    t = np.arange(len(y), dtype=float)
    kept_t, kept_y = thinned(t, y, most)
    assert len(kept_t) <= max(most, len(y) if len(y) <= most else 0)
    assert (np.diff(kept_t) > 0).all()
    np.testing.assert_array_equal(y[kept_t.astype(int)], kept_y)
    assert {kept_t[0], kept_t[-1]} == {t[0], t[-1]}
    assert (kept_y.min(), kept_y.max()) == (y.min(), y.max())
