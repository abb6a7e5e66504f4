"""Gains are stated only against a motion that keeps the limits, wherever they are stated."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from page_data import data_of
from plan_folders import with_baseline

from cmbot.campaigns.overview import overview_page
from cmbot.planning import Plan, baseline_faults, remarks, verdict
from cmbot.simulation import Tracking
from cmbot.views import report_page
from cmbot.views.charts import charts, joint_charts
from cmbot.views.report import headlines

# What a gain looks like: a share less or more than the baseline's, or a signed one.
GAIN = re.compile(r"[-+]\d+\.\d+ %|% (less|more) than the baseline|Nm less|hardly anything is gained", re.I)


def beside(of: Plan, **figures: float) -> Plan:
    """The plan beside a baseline with other figures."""
    segments = [
        replace(segment, figures=replace(segment.figures, **figures)) for segment in of.baseline.segments
    ]
    return with_baseline(of, figures=replace(of.baseline.figures, **figures), segments=tuple(segments))


def turned(of: Plan) -> Plan:
    """The plan beside a baseline that breaks the limits of a velocity, as near a singular posture."""
    use = replace(of.baseline.figures.limit_use, velocity=31.0)
    return beside(of, limit_use=use, peak_guardrail_torque=1500.0)


BROKEN: dict[str, Callable[[Plan], Plan]] = {
    "collides": lambda of: beside(of, min_clearance=-0.047),
    "breaks the safety margin": lambda of: beside(of, min_clearance=0.0),
    "breaks joint limits": turned,
    "leaves its path by 3.0 mm": lambda of: beside(of, max_tool_deviation=3e-3),
    "leaves its path by 119 mm": lambda of: with_baseline(of, drift=0.119),
    "turns the tool away": lambda of: beside(of, max_tool_rotation=1.0),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_no_gain_is_stated_against_a_motion_that_breaks_a_limit(
    triangle_plan: Plan, triangle_tracking: Tracking, fault: str
) -> None:
    plan = BROKEN[fault](triangle_plan)
    assert baseline_faults(plan) == baseline_faults(plan, work=True) == fault
    bound = ("Lower bound", "Sequences")  # that is no gain on a motion
    assert not [row for row in plan.rows() if row[0].startswith("most below the baseline")]
    said = [each for each in (verdict(plan), *remarks(plan)) if not each.startswith(bound)]
    assert not [each for each in said if GAIN.search(each)]
    # It is said why.
    assert (
        f"no gain is stated, as the baseline ({plan.baseline.job_figures.peak_guardrail_torque:.1f}"
        in said[0]
    )
    assert f"The baseline {fault}: it is shown for comparison and is no plan, and no gain is stated." in said
    cards = [*headlines(plan, triangle_tracking)]
    assert not [card for card in cards if card.before or "→" in card.detail]
    assert not [card for card in cards if card.state == "worse"]
    assert [card.title for card in cards if card.state == "good"] == ["Certified checks, whole job"]
    # The first cards are those of the tool and of what holds.
    assert cards[2].detail.startswith(
        f"at work {plan.figures.peak_guardrail_torque:.1f} Nm; no gain is stated, as the baseline {fault}"
    )
    assert "<s>" not in report_page(plan)


def test_a_gain_is_stated_against_a_motion_that_keeps_them(triangle_plan: Plan) -> None:
    """Else the test above could not fail."""
    assert baseline_faults(triangle_plan) == ""
    assert [row for row in triangle_plan.rows() if row[0].startswith("most below the baseline")]
    _, _, peak, *_ = headlines(triangle_plan, None)
    assert peak.before and GAIN.search(peak.detail)


def test_the_line_of_the_paper_is_no_measure(line_plan: Plan) -> None:
    """Its baseline collides: docs/results.md compares with the paper all the same, and says so."""
    assert baseline_faults(line_plan, work=True).startswith("collides")
    assert "% less" not in verdict(line_plan)


def test_another_objective_names_what_its_baseline_breaks(triangle_plan: Plan) -> None:
    objective = replace(triangle_plan.objective, name="sag", unit="m", axis_weights=None, moment_about=None)
    for plan, which in ((triangle_plan, ""), (BROKEN["collides"](triangle_plan), ", which collides,")):
        (said,) = (s for s in remarks(replace(plan, objective=objective)) if s.startswith("Minimised"))
        assert f" in the baseline{which} to " in said


def test_plots_are_scaled_to_the_planned_motion(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    *others, stroke = triangle_plan.baseline.segments
    wild = replace(
        stroke.samples,
        guardrail_torque=20 * stroke.samples.guardrail_torque,
        clearance=stroke.samples.clearance - 5.0,
        tool_deviation=stroke.samples.tool_deviation + 0.2,
    )
    plan = with_baseline(triangle_plan, segments=(*others, replace(stroke, samples=wild)))
    for before, chart in zip(charts(triangle_plan, None), charts(plan, None), strict=True):
        (planned,) = (curve for curve in chart.curves if curve.motion == "planned" and not curve.thin)
        drawn = [curve for curve in chart.curves if curve.motion == "baseline"]
        assert chart.axis[0] <= planned.y.min() and planned.y.max() <= chart.axis[1]
        assert chart.axis[1] - chart.axis[0] <= 4 * max(planned.y.max(), 1.15)
        assert "beyond this plot" not in before.note
        if chart.key == "deviation":
            # That of a rigid arm, beside one whose sag is counted.
            assert not drawn
            assert "The baseline's, bent at rest: up to 13.2 mm." in chart.note
            continue
        (baseline,) = drawn
        far = baseline.y.max() if chart.key != "clearance" else baseline.y.min()
        to = "down to" if chart.key == "clearance" else "up to"
        assert f"The baseline goes {to} {far:.{chart.digits}f} {chart.unit}, beyond this plot." in chart.note
    # A baseline that keeps limits and is not far beyond is shown whole.
    torque = next(charts(triangle_plan, triangle_tracking))
    assert max(curve.y.max() for curve in torque.curves) <= torque.axis[1]


def test_a_joint_without_range_is_scaled_to_the_planned_motion(triangle_plan: Plan) -> None:
    plan, limits = replace(triangle_plan), triangle_plan.robot.limits
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[0], upper[0] = -np.inf, np.inf
    plan = replace(plan, robot=replace(plan.robot, limits=replace(limits, lower=lower, upper=upper)))
    *others, stroke = triangle_plan.baseline.segments
    q = stroke.samples.q + 100.0 * np.linspace(0, 1, len(stroke.samples.t))[:, None]
    plan = with_baseline(plan, segments=(*others, replace(stroke, samples=replace(stroke.samples, q=q))))
    chart = next(joint_charts(plan))
    (planned,) = (curve for curve in chart.curves if curve.motion == "planned")
    assert chart.axis[0] <= planned.y.min() < planned.y.max() <= chart.axis[1]
    assert chart.axis[1] - chart.axis[0] <= 3 * np.ptp(planned.y) + 1e-9


def test_the_overview_of_a_campaign_has_what_the_baselines_break(tmp_path: object) -> None:
    peaks = {f"{name}.peak_guardrail_torque": 400.0 for name in ("baseline_job", "planned_job")}
    row = {"name": "a", "at_m": None, "ended": "planned", "reason": "", "seconds": 1.0, "plan": None, **peaks}
    faults = {"baseline_job_faults": "collides", "baseline_work_faults": ""}
    data = data_of(overview_page("two", [row | faults, row], tmp_path))  # type: ignore[arg-type]
    assert data["faults"] == ["collides", ""]
    assert data["workFaults"] == ["", ""]
