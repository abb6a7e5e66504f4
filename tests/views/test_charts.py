"""The report's plots: what they show, between which bounds, and how they are made light."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from page_data import floats
from plan_folders import with_baseline

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views.charts import MOST_POINTS, Chart, charts, downsampled, joint_charts


def test_peaks_survive_the_thinning(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    approach = triangle_plan.approach
    torque, *others = charts(triangle_plan, triangle_tracking)
    for chart in (torque, *others):
        # A plot without the approach says why.
        assert (min(curve.t[0] for curve in chart.curves) < approach.duration - 0.01) == (chart.free == "")
    baseline, planned = (floats(curve["y"]) for curve in torque.data()["curves"])
    norms = np.linalg.norm(triangle_plan.baseline.samples.guardrail_torque, axis=1)
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
        assert chart.axis[0] < chart.bounds[0] < chart.bounds[1] < chart.axis[1]


def tracking_charts(plan: Plan, tracking: Tracking) -> list[Chart]:
    return [chart for chart in charts(plan, tracking) if chart.title.startswith("Tracking error")]


def test_tracking_errors_share_one_scale_and_say_where_they_are_measured_from(
    triangle_plan: Plan, triangle_tracking: Tracking, compensated_short: tuple[Plan, Tracking]
) -> None:
    planned = triangle_tracking.planned
    for offset in (0.0, 0.03):
        aside = np.array([0.0, offset, 0.0])
        apart = replace(planned, error=planned.error + aside, static=planned.static + aside)
        along = tracking_charts(triangle_plan, replace(triangle_tracking, planned=apart))
        assert len(along) == 3
        spans = [chart.axis[1] - chart.axis[0] for chart in along]
        assert spans == pytest.approx([spans[0]] * 3)
        for chart in along:
            for curve in chart.curves:
                assert chart.axis[0] < curve.y.min() <= curve.y.max() < chart.axis[1]
    rigid = replace(triangle_plan, compensation=None)
    notes = [chart.note for chart in tracking_charts(rigid, triangle_tracking)]
    assert "minus the rigid arm's at the same joint angles. " in notes[0]
    assert "expected position" not in notes[0]
    compensated = [chart.note for chart in tracking_charts(*compensated_short)]
    assert "predicted sag" in compensated[0] and "expected position" in compensated[0]
    assert notes[1:] == compensated[1:] == ["", ""]


def test_off_the_path_has_no_points_between_strokes(strokes_plan: Plan, strokes_tracking: Tracking) -> None:
    *others, off, torque = charts(strokes_plan, strokes_tracking)
    assert off.title == "Elastic tool's distance from its path"
    free = strokes_plan.work.segments[1], strokes_plan.baseline.segments[1]
    for segment, name in zip(free, ("planned", "baseline"), strict=True):
        (shown,) = (curve for curve in off.curves if curve.motion == name)
        times = shown.t - strokes_plan.job.strokes[0].begin
        before, after = times <= segment.begin + 1e-9, times >= segment.end - 1e-9
        assert before.any() and after.any() and (before | after).all()
        assert shown.starts == (before.sum(),)
    lowest = min(np.linalg.norm(m.base[:, 6:], axis=1).min() for _, m in strokes_tracking.motions)
    assert 0.9 * lowest < torque.axis[0] < lowest
    for chart in (*others, off, torque):
        for curve in chart.curves:
            assert np.isfinite(curve.y).all()


def test_a_curve_is_broken_where_the_faster_arm_waits_to_return(returning_plan: Plan) -> None:
    hurried = [
        replace(each, samples=replace(each.samples, t=0.5 * each.samples.t))
        if each.kind == "stroke"
        else each
        for each in returning_plan.baseline.segments
    ]
    plan = with_baseline(returning_plan, segments=tuple(hurried))
    wait = 0.5 * plan.samples.t[-1]
    for chart in joint_charts(plan):
        for curve, entry in zip(chart.curves, chart.data(50)["curves"], strict=True):
            t = floats(entry["t"])
            gaps = [t[k] - t[k - 1] for k in entry["starts"]]
            assert gaps == pytest.approx([wait] if curve.motion == "baseline" else [], rel=1e-5)
            assert len(t) <= 50


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=300), st.integers(4, 60))
def test_thinning_keeps_ends_and_extremes(values: list[float], most: int) -> None:
    y = np.array(values)
    t = np.arange(len(y), dtype=float)
    kept_t, kept_y = downsampled(t, y, most)
    assert len(kept_t) <= max(most, len(y) if len(y) <= most else 0)
    assert (np.diff(kept_t) > 0).all()
    np.testing.assert_array_equal(y[kept_t.astype(int)], kept_y)
    assert {kept_t[0], kept_t[-1]} == {t[0], t[-1]}
    assert (kept_y.min(), kept_y.max()) == (y.min(), y.max())
