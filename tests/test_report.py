"""The report without a browser: what stands in it, and how plots are made light."""

import base64
import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenes import short_scene

import cmbot
from cmbot.errors import InputError
from cmbot.planning import Plan, plan, remarks
from cmbot.simulation import SimulationOptions, Tracking, simulate, tracking_rows
from cmbot.views import pages, report_page
from cmbot.views.charts import MOST_POINTS, charts, joint_charts
from cmbot.views.headlines import headlines, use_of
from cmbot.views.replay_data import replay_data
from cmbot.views.thinning import thinned

EVIL = "</script></title><img src=x onerror=alert(1)><!--\u2028"


@pytest.fixture(scope="module")
def tracking(triangle_plan: Plan) -> Tracking:
    return simulate(triangle_plan)


@pytest.fixture(scope="module")
def text(triangle_plan: Plan, tracking: Tracking) -> str:
    return report_page(triangle_plan, tracking)


@pytest.fixture(scope="module")
def compensated() -> tuple[Plan, Tracking]:
    made = plan(short_scene(planner={"compensate": True}))
    return made, simulate(made, SimulationOptions(settle_s=0.5))


def floats(packed: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed), "<f4").astype(float).reshape(-1, *shape)


def data_of(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="replay-data">(.*?)</script>', text, re.DOTALL)
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data


# The page ---------------------------------------------------------------------------------------------------


def test_the_page_is_light_and_the_same_again(text: str, triangle_plan: Plan, tracking: Tracking) -> None:
    assert len(text.encode()) < 6_000_000
    assert report_page(triangle_plan, tracking) == text


def test_every_figure_check_and_remark_is_in_it(text: str, triangle_plan: Plan, tracking: Tracking) -> None:
    cells = set(re.findall(r"<t[dh][^>]*>([^<]*)</t[dh]>", text))
    for row in (*triangle_plan.rows(), *tracking_rows(tracking)):
        assert set(row) <= cells
    for check in triangle_plan.certificate.checks:
        assert check.quantity.replace("'", "&#x27;") in cells
    for remark in remarks(triangle_plan):
        assert f"<li>{remark}</li>".replace("'", "&#x27;") in text
    for name in dataclasses.asdict(triangle_plan.options):
        assert name in cells
    assert cmbot.__version__ in cells
    assert "NO" not in cells


def test_names_are_text(triangle_plan: Plan) -> None:
    scene = triangle_plan.scene
    obstacles = tuple(dataclasses.replace(o, name=f"{EVIL}{k}") for k, o in enumerate(scene.obstacles))
    evil = dataclasses.replace(scene, name=EVIL, obstacles=obstacles)
    page = report_page(dataclasses.replace(triangle_plan, scene=evil))
    assert "<img src" not in page
    assert page.count("</script>") == report_page(triangle_plan).count("</script>")
    assert data_of(page)["title"] == EVIL


def test_both_pages_of_a_directory(triangle_plan: Plan, tracking: Tracking, text: str) -> None:
    made = pages(triangle_plan, tracking)
    assert list(made) == ["replay.html", "report.html"]
    assert made["report.html"].decode() == text


def test_it_is_written_whole_or_not_at_all(triangle_plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    cmbot.report(triangle_plan, path)
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    with pytest.raises(InputError, match="cannot be written"):
        cmbot.report(triangle_plan, tmp_path / "missing" / "report.html")
    assert list(tmp_path.iterdir()) == [path]


def test_the_tracking_of_another_plan_is_refused(short_plan: Plan, tracking: Tracking) -> None:
    with pytest.raises(InputError, match=r"tracking: planned\.stop: got 20 s, expected 4 s"):
        report_page(short_plan, tracking)


# What is in the plots ---------------------------------------------------------------------------------------


def test_peaks_survive_the_thinning(triangle_plan: Plan, tracking: Tracking) -> None:
    approach = triangle_plan.approach
    assert approach is not None
    torque = next(charts(triangle_plan, tracking))
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


def test_tracking_errors_share_one_scale(triangle_plan: Plan, tracking: Tracking) -> None:
    along = [chart for chart in charts(triangle_plan, tracking) if chart.title.startswith("Tracking error")]
    assert len(along) == 3
    spans = [chart.axis[1] - chart.axis[0] for chart in along]
    assert spans == pytest.approx([spans[0]] * 3)
    for chart in along:
        for curve in chart.curves:
            assert chart.axis[0] <= curve.y.min() <= curve.y.max() <= chart.axis[1]


def test_it_is_said_where_an_error_is_measured_from(
    triangle_plan: Plan, tracking: Tracking, compensated: tuple[Plan, Tracking]
) -> None:
    for made, words in (((triangle_plan, tracking), "put the rigid one. "), (compensated, "predicted sag")):
        notes = [chart.note for chart in charts(*made) if chart.title.startswith("Tracking error")]
        assert words in notes[0]
        assert notes[1:] == ["", ""]
        assert ("is expected" in notes[0]) == (made is compensated)


def test_plots_without_the_approach_say_why(triangle_plan: Plan, tracking: Tracking) -> None:
    for chart in charts(triangle_plan, tracking):
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


# Headlines --------------------------------------------------------------------------------------------------


def test_headlines_say_what_was_gained(triangle_plan: Plan, tracking: Tracking) -> None:
    peak, floor, certified, clearance, deviation, error = headlines(triangle_plan, tracking)
    before, after = triangle_plan.baseline_figures, triangle_plan.figures
    assert (peak.before, peak.value) == (
        f"{before.peak_guardrail_torque:.1f}",
        f"{after.peak_guardrail_torque:.1f} Nm",
    )
    assert "Nm on the approach" in peak.detail
    assert triangle_plan.gap_to_floor is not None
    assert floor.value == f"{100 * triangle_plan.gap_to_floor:+.3f} %"
    assert triangle_plan.approach is not None
    work, approach = (len(of.certificate.checks) for of in (triangle_plan, triangle_plan.approach))
    assert certified.value == f"{work} of {work} hold"
    assert certified.detail.endswith(f"; approach: {approach} of {approach}")
    assert clearance.value == f"{1e3 * after.min_clearance:.1f} mm"
    assert deviation.value == f"{1e3 * after.max_tool_deviation:.2f} mm"
    assert error.value == f"{1e3 * tracking.planned.figures.total.rms[3]:.1f} mm"
    assert {card.state for card in (peak, certified, clearance, deviation)} == {"good"}


def test_what_is_broken_is_said(triangle_plan: Plan) -> None:
    certificate = triangle_plan.certificate
    broken = dataclasses.replace(certificate.checks[0], value=2 * certificate.checks[0].bound)
    figures = dataclasses.replace(certificate.figures, min_clearance=0.01)
    certificate = dataclasses.replace(certificate, checks=(broken, *certificate.checks[1:]), figures=figures)
    plan = dataclasses.replace(triangle_plan, certificate=certificate)
    _, _, certified, clearance, *_ = headlines(plan, None)
    number = len(certificate.checks)
    assert (certified.value, certified.state) == (f"{number - 1} of {number} hold", "bad")
    assert broken.quantity in certified.detail
    assert clearance.state == "bad"
    assert ">NO</td>" in report_page(plan)


def test_a_promise_broken_on_the_approach_is_said(triangle_plan: Plan) -> None:
    approach = triangle_plan.approach
    assert approach is not None
    first, *others = approach.certificate.checks
    checks = (dataclasses.replace(first, value=2 * first.bound), *others)
    certificate = dataclasses.replace(approach.certificate, checks=checks)
    broken = dataclasses.replace(approach, certificate=certificate)
    certified = list(headlines(dataclasses.replace(triangle_plan, approach=broken), None))[2]
    assert certified.state == "bad"
    assert certified.detail.endswith(f"approach: {len(others)} of {len(checks)}")


def test_without_an_approach_none_is_named(short_plan: Plan) -> None:
    assert "approach" not in list(headlines(short_plan, None))[2].detail


def test_fixed_knots_have_no_floor(short_plan: Plan) -> None:
    floor = list(headlines(short_plan, None))[1]
    assert (floor.value, floor.detail) == ("–", "fixed knots have none")


def test_nothing_to_hit_and_no_range(short_plan: Plan) -> None:
    """An infinite clearance and a continuous joint, which JSON has no numbers for."""
    figures = dataclasses.replace(short_plan.figures, min_clearance=np.inf)
    checks = tuple(
        dataclasses.replace(check, value=np.inf) if check.at_least else check
        for check in short_plan.certificate.checks
    )
    certificate = dataclasses.replace(
        short_plan.certificate, checks=checks, figures=figures, clearance_bound=np.inf
    )
    scene = dataclasses.replace(short_plan.scene, obstacles=())
    limits = short_plan.robot.limits
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[1], upper[1] = -np.inf, np.inf
    limits = dataclasses.replace(limits, lower=lower, upper=upper)
    alone = short_plan.robot.collision_model.copy()
    alone.removeAllCollisionPairs()
    robot = dataclasses.replace(short_plan.robot, limits=limits, collision_model=alone)
    baseline = dataclasses.replace(
        short_plan.baseline, clearance=np.full_like(short_plan.baseline.clearance, np.inf)
    )
    parts = {"certificate": certificate, "scene": scene, "robot": robot, "baseline": baseline}
    page = report_page(dataclasses.replace(short_plan, **parts))
    data = data_of(page)
    assert data["planned"]["minClearance"] is None
    assert data["charts"][1]["curves"] == []
    assert (floats(data["planned"]["pair"]) == -1).all()
    assert data["jointCharts"][1]["bounds"] == [None, None]
    assert "nothing is there to be hit" in page
    assert ">unbounded</td>" in page


@pytest.mark.parametrize(
    ("value", "bound", "at_least", "use"),
    [(0.5, 1.0, False, 0.5), (0.04, 0.02, True, 0.5), (0.0, 0.02, True, np.inf), (2.0, 1.0, False, 2.0)],
)
def test_use_of_a_bound(triangle_plan: Plan, value: float, bound: float, at_least: bool, use: float) -> None:
    check = triangle_plan.certificate.checks[0]
    assert use_of(dataclasses.replace(check, value=value, bound=bound, at_least=at_least)) == use


# Sag and vibration ------------------------------------------------------------------------------------------


def test_what_was_done_about_the_sag_is_in_a_table(
    compensated: tuple[Plan, Tracking], short_plan: Plan
) -> None:
    made, tracking = compensated
    done = made.compensation
    assert done is not None
    page = report_page(made, tracking)
    rows = {"sag compensated, rounds": str(done.rounds)}
    rows["largest shift of the tool from its path for it, mm"] = f"{1e3 * done.largest_shift:.3f}"
    assert done.largest_shift > 1e-3
    for name, value in rows.items():
        assert f'{name}</th><td class="number">{value}</td>' in page
        assert name not in report_page(short_plan)


def test_what_was_done_about_the_vibration_is_in_a_table(text: str, triangle_plan: Plan) -> None:
    quiet = triangle_plan.quieting
    assert quiet is not None
    for name, value in (
        ("elastic modes brought to rest", f"{quiet.modes}"),
        ("share of the change for it that was made", f"{100 * quiet.share:g} %"),
        ("amplitude that they leave at the tool without it, mm", f"{1e3 * quiet.before:.4f}"),
        ("with it, mm", f"{1e3 * quiet.after:.4f}"),
    ):
        assert f'{name}</th><td class="number">{value}</td>' in text


# What the view shows besides the arms -----------------------------------------------------------------------


def test_nearest_points_are_as_far_apart_as_the_clearance(triangle_plan: Plan, tracking: Tracking) -> None:
    data = replay_data(triangle_plan, tracking)
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


def test_the_error_is_that_of_the_simulation(triangle_plan: Plan, tracking: Tracking) -> None:
    data = replay_data(triangle_plan, tracking)
    assert data["end"] == pytest.approx(tracking.planned.t[-1])
    times = np.linspace(0, data["duration"], len(floats(data["planned"]["clearance"])))
    for name, motion in (("planned", tracking.planned), ("baseline", tracking.baseline)):
        expected = np.stack([np.interp(times, motion.t, e) for e in motion.error.T], axis=1)
        np.testing.assert_allclose(floats(data[name]["error"], 3), expected, atol=1e-8)
        rest = data["rest"][name]
        assert np.ptp(floats(rest["tool"], 3), axis=0).max() == 0
        assert np.ptp(floats(rest["error"], 3), axis=0).max() > 0
    assert data["approach"]["planned"]["error"] is None
    assert replay_data(triangle_plan)["rest"] is None


def test_the_error_starts_where_the_tool_is_expected(compensated: tuple[Plan, Tracking]) -> None:
    made, tracking = compensated
    expected = made.samples.expected_tool_point
    assert expected is not None
    shown = floats(replay_data(made, tracking)["planned"]["tool"], 3)
    np.testing.assert_allclose(shown[[0, -1]], expected[[0, -1]], atol=1e-6)
    assert np.linalg.norm(shown[0] - made.samples.tool_point[0]) > 1e-3
