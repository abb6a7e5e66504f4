"""The report without a browser: what stands in it, and in its cards."""

import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from clamped import CLAMP, MAGNET, clamped_scene
from page_data import data_of, floats, without_shapes
from plan_folders import changed, with_baseline, without_approach
from shared_plans import planned

import cmbot
from cmbot.common.errors import InputError
from cmbot.common.limit import Limit
from cmbot.elastic import elastic_base
from cmbot.planning import Certificate, Choice, Plan, bound_use, remarks, verdict
from cmbot.simulation import Tracking, tracking_rows, tracking_verdict
from cmbot.toolpath import Coverage
from cmbot.views import compare_page, pages, report_page
from cmbot.views.charts import charts
from cmbot.views.report import headlines


@pytest.fixture(scope="module")
def text(triangle_plan: Plan, triangle_tracking: Tracking) -> str:
    return report_page(triangle_plan, triangle_tracking)


def test_pages_are_light_and_the_same(text: str, triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    assert len(text.encode()) < 6_000_000
    made = pages(triangle_plan, triangle_tracking)
    assert list(made) == ["replay.html", "report.html"]
    assert made["report.html"].decode() == text


def test_every_figure_check_and_remark_is_in_it(
    text: str, triangle_plan: Plan, triangle_tracking: Tracking
) -> None:
    cells = set(re.findall(r"<t[dh][^>]*>([^<]*)</t[dh]>", text))
    for row in (*triangle_plan.rows(), *tracking_rows(triangle_tracking)):
        assert {cell.replace("'", "&#x27;") for cell in row} <= cells
    for check in triangle_plan.certificate.checks:
        assert check.quantity.replace("'", "&#x27;") in cells
    said, *others = remarks(triangle_plan)
    assert f"</b></summary>{said}</details>" in text
    for remark in others:
        assert f"<li>{remark}</li>".replace("'", "&#x27;") in text
    for name in asdict(triangle_plan.options):
        assert name in cells
    assert cmbot.__version__ in cells
    assert "NO" not in cells


def test_a_measured_base_is_told_beside_that_of_the_scene(short_plan: Plan, text: str) -> None:
    """A base twice as stiff as the scene's, whose 21 numbers are independent and known within 0.1."""
    assert "<h2>Measured</h2>" not in text
    plan, name = without_shapes(short_plan), "link_1"
    springs = [
        {"name": name, "modelled": tube.young * tube.second_moment, "factor": 1.0}
        for name, tube in plan.robot.elasticity.items()
    ]
    base = elastic_base(plan.scene.elastic_guardrail)
    assert base is not None
    feet = plan.scene.elastic_guardrail.footholds
    modes = [{"hz": 2.5, "hz_sd": 0.02, "damping": [0.012, 0.001]}, {"hz": 3.0, "hz_sd": 0.03}]
    readings = [{"kind": "deflections", "count": 8, "residual": 1.1}, {"kind": "frequencies", "count": 2}]
    identified = {
        "links": springs,
        "base": {"footholds": feet, "stiffness": (2 * base.stiffness).tolist()},
        "covariance": (0.01 * np.eye(len(springs) + 21)).tolist(),
        # Of X_11 nothing was told beside what was known before, of the others nearly all.
        "measured": {
            "sheets": ["<tap>.yaml"],
            "readings": readings,
            "modes": modes,
            "sag_mm": [1.531, 1.874],
            "prior_sd": [0.3] * len(springs) + [0.1] + [0.3] * 20,
        },
    }
    page = report_page(replace(plan, scene=plan.scene.changed(identified=identified)))
    part = page.partition("<h2>Measured</h2>")[2].partition("</section>")[0]
    cells = [re.findall(r"<t[dh][^>]*>([^<]*)</t[dh]>", row) for row in part.split("</tr>")]
    told = {row[0]: row[1:] for row in cells if row}
    # The first entry of C is L_11 exp(X_11) L_11: its logarithm is X_11, of deviation 0.1.
    before = 1 / np.linalg.inv(base.stiffness)[0, 0]
    was, now, within = told["base along x, N/m"]
    assert (float(was), float(now)) == pytest.approx((before, 2 * before), rel=1e-3)
    assert "The sag along the job measured for is 1.87 mm RMS, with the scene&#x27;s stiffness 1.53." in part
    unseen = [row[0] for row in cells if row and row[-1].endswith(", not seen")]
    assert unseen == ["base along x, N/m"]
    within = within.removesuffix(", not seen")
    ends = [2 * before * np.exp(side * 1.96 * 0.1) for side in (-1, 1)]
    assert [float(end) for end in within.split(" to ")] == pytest.approx(ends, rel=1e-3)
    assert told[f"{name} E I, N m2"][0] == told[f"{name} E I, N m2"][1]
    assert (told["2.5 ± 0.02"], told["3 ± 0.03"]) == (["1.20 ± 0.1"], ["-"])
    assert (
        "From &lt;tap&gt;.yaml: 8 deflections (residual 1.1 times what stated errors leave), 2 freq" in part
    )


def test_the_banner_is_green_only_where_the_bent_tool_keeps_its_margin_too(
    text: str, triangle_plan: Plan, triangle_tracking: Tracking, compensated_short: tuple[Plan, Tracking]
) -> None:
    kept = "<b>Every promise is kept: 26 checks hold at all times."
    off = f"up to {1e3 * triangle_tracking.planned.largest_off_path:.2f} mm off its path"
    said = f"Simulated, the bent tool is {off}, beyond the margin of 0.2 mm."
    assert tracking_verdict(triangle_plan, triangle_tracking).startswith("Not within the margin")
    assert f'<details class="verdict worse" open><summary>{kept} {said}</b>' in text
    assert tracking_verdict(*compensated_short).startswith("Within the margin")
    # Nor where no magnet holds the feet, of which nothing is promised.
    plan, tracking = compensated_short
    assert "beyond any magnet" in verdict(plan)
    assert f'<details class="verdict worse" open><summary>{kept}</b>' in report_page(plan, tracking)
    footless = replace(plan, robot=replace(plan.robot, feet=()))
    assert '<details class="verdict good" open>' in report_page(footless, tracking)


def test_the_banner_tells_what_of_a_raster_is_not_reached(triangle_plan: Plan) -> None:
    plan = replace(triangle_plan)
    # A cached property: set as it would be computed.
    plan.__dict__["coverage"] = {"work": Coverage(area=0.08, left_out=0.02, unreached=0.02)}
    kept = "<b>Every promise is kept: 26 checks hold at all times."
    said = "Of the surface 0.02 of 0.08 m2 are not reached."
    page = report_page(plan)
    assert f'<details class="verdict worse" open><summary>{kept} {said}</b>' in page
    banner = page.partition('<details class="verdict')[2].partition("</details>")[0]
    assert banner.count("not reached") == 1


def test_the_banner_is_no_longer_green_where_a_tolerance_is_not_kept(triangle_plan: Plan) -> None:
    plan = replace(triangle_plan)
    plan.__dict__["accuracy"] = replace(triangle_plan.accuracy, tolerance_kept=False, tolerance_share=0.7)
    told = (
        r'<details class="verdict worse" open><summary>'
        r"<b>Every promise is kept: \d+ checks hold at all times. The tolerance of"
    )
    assert re.search(told, report_page(plan))


def test_it_is_written_whole_or_not_at_all(
    triangle_plan: Plan, short_plan: Plan, triangle_tracking: Tracking, tmp_path: Path
) -> None:
    path = tmp_path / "report.html"
    cmbot.report(triangle_plan, path)
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    with pytest.raises(InputError, match="cannot be written"):
        cmbot.report(triangle_plan, tmp_path / "missing" / "report.html")
    assert list(tmp_path.iterdir()) == [path]
    # Neither with the tracking of another plan.
    with pytest.raises(InputError, match=r"tracking: planned\.stop: got 20 s, expected 4 s"):
        report_page(short_plan, triangle_tracking)


def test_several_strokes_are_simulated(strokes_plan: Plan, strokes_tracking: Tracking) -> None:
    text = report_page(strokes_plan, strokes_tracking)
    assert tracking_verdict(strokes_plan, strokes_tracking) in text
    assert ">nan<" not in text


def test_nothing_to_hit_and_no_range(short_plan: Plan) -> None:
    """An infinite clearance and a continuous joint, which JSON has no numbers for."""
    certificate, limits = short_plan.certificate, short_plan.robot.limits
    checks = tuple(replace(c, value=np.inf) if c.at_least else c for c in certificate.checks)
    figures = replace(short_plan.figures, min_clearance=np.inf)
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[1], upper[1] = -np.inf, np.inf
    alone = short_plan.robot.collision_model.copy()
    alone.removeAllCollisionPairs()
    limits = replace(limits, lower=lower, upper=upper)
    free = replace(certificate, checks=checks, figures=figures, clearance_bound=np.inf)
    plan = replace(
        changed(short_plan, "work", certificate=free),
        scene=short_plan.scene.changed(obstacles=(), guardrail={"bays": 0}),
        robot=replace(short_plan.robot, limits=limits, collision_model=alone),
    )
    samples = short_plan.baseline.samples
    samples = replace(samples, clearance=np.full_like(samples.clearance, np.inf))
    stroke = replace(short_plan.baseline.segments[0], samples=samples)
    plan = with_baseline(plan, samples=samples, segments=(stroke,))
    page = report_page(plan)
    data = data_of(page)
    assert data["planned"]["minClearance"] is None
    assert data["charts"][1]["curves"] == []
    assert (floats(data["planned"]["pair"]) == -1).all()
    assert data["jointCharts"][1]["bounds"] == [None, None]
    assert "no pair of shapes can collide" in page
    assert ">unbounded</td>" in page


def test_sag_compensation_is_in_a_table(compensated_short: tuple[Plan, Tracking], short_plan: Plan) -> None:
    done = compensated_short[0].compensation
    assert done.largest_shift > 1e-3
    name, value = "largest shift of the tool from its path, mm", f"{1e3 * done.largest_shift:.3f}"
    assert f'{name}</th><td class="number">{value}</td>' in report_page(*compensated_short)
    assert name not in report_page(short_plan)


def test_headlines_say_what_was_gained(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    tool, holds, peak, floor, certified, clearance, error = headlines(triangle_plan, triangle_tracking)
    # Welded, nothing says what the feet bear.
    assert (holds.value, holds.state) == ("–", "plain")
    accuracy = triangle_plan.accuracy
    assert tool.value == f"{accuracy.within_mm:.3g} mm"
    assert accuracy.parts[0].name in tool.detail
    before, after = triangle_plan.baseline.figures, triangle_plan.figures
    job = triangle_plan.job.figures
    assert peak.before == f"{before.peak_guardrail_torque:.1f}"
    assert peak.value == f"{job.peak_guardrail_torque:.1f} Nm"
    change = 100 * (after.peak_guardrail_torque / before.peak_guardrail_torque - 1)
    reached = f"{after.peak_guardrail_torque:.1f} Nm, {change:+.1f} %"
    assert peak.detail.startswith(f"at work {peak.before} → {reached}")
    assert peak.detail.endswith("486.4 Nm on the approach")
    assert floor.value == f"{100 * triangle_plan.gap_to_floor:+.3g} %"
    assert floor.detail == f"lower bound {triangle_plan.torque_floor:.1f} Nm, explained at the torque's plot"
    objective = replace(triangle_plan.objective, planned_peak=172.0, floor=100.0)
    loose = replace(triangle_plan, objective=objective, choice=Choice(free=171.0, pinned=None))
    floor = next(card for card in headlines(loose, None) if card.title == "Above the lower bound")
    assert (floor.value, "; +0.6 % above the least of sequences" in floor.detail) == ("+72 %", True)

    def explained(plan: Plan) -> str:
        return next(chart.note for chart in charts(plan, None) if chart.key == "torque")

    said = explained(triangle_plan)
    assert said.endswith("no posture within the limits has a smaller static torque (proven).")
    # Of the static torque: inertia may take a peak below it, which is no contradiction.
    static = replace(triangle_plan.objective, floor=triangle_plan.objective.planned_peak + 1.0)
    _, _, _, floor, *_ = headlines(replace(triangle_plan, objective=static), None)
    assert "lower bound at rest" in floor.detail
    less = "(proven); with the sag compensated the arm has less."
    assert explained(replace(triangle_plan, objective=static)).endswith(less)
    bound = replace(triangle_plan.lower_bound, kind="estimated", missed=0.5)
    estimated = replace(triangle_plan, lower_bound=bound)
    _, _, _, floor, *_ = headlines(estimated, None)
    assert floor.detail.startswith("lower bound (estimate) ")
    assert (
        "was found to have a smaller static torque (estimate; at most 50.00 % of the postures"
        in explained(estimated)
    )
    work, approach = (len(of.certificate.checks) for of in (triangle_plan, triangle_plan.approach))
    assert certified.value == f"{work + approach} of {work + approach} hold"
    assert certified.detail.endswith(f"; work {work} of {work}, approach {approach} of {approach}")
    assert clearance.value == f"{1e3 * job.min_clearance:.1f} mm"
    off = 1e3 * after.max_tool_deviation
    assert tool.detail.endswith(f"with the predicted sag, as planned, {off:.2f} of 0.2 mm")
    segment, nearest = min(
        ((each, check) for each, check in triangle_plan.job.checks() if check.limit is Limit.CLEARANCE),
        key=lambda each: each[1].value,
    )
    when = {"work": "at work", "approach": "on the approach"}[segment.name]
    between = nearest.quantity.removeprefix("clearance of ")
    assert clearance.detail.startswith(f"{between} {when}, at {nearest.time:.1f} s; rigid arm; ")
    # The sag is compensated; the vibration comes on top of what the plan allows.
    planned, baseline = triangle_tracking.planned, triangle_tracking.baseline
    assert planned.metrics.path.rms[3] < 0.1 * baseline.metrics.path.rms[3]
    allowed = triangle_plan.options.max_tool_deviation_m
    assert (error.state == "bad") is (planned.largest_off_path > allowed)
    assert error.value == f"{1e3 * planned.metrics.path.rms[3]:.2f} mm"
    assert [card.state for card in (tool, certified, clearance)] == ["plain", "good", "good"]
    # The posture in which the arm begins asks that: no gain over the whole job.
    assert peak.state == "plain"
    _, _, gained, *_ = headlines(without_approach(triangle_plan), None)
    assert gained.state == "good"


def broken(certificate: Certificate) -> Certificate:
    """The certificate with a first check at twice its bound, and too small a clearance."""
    first, *others = certificate.checks
    figures = replace(certificate.figures, min_clearance=0.01)
    return replace(certificate, checks=(replace(first, value=2 * first.bound), *others), figures=figures)


def test_a_broken_bound_of_the_work_or_the_approach_is_shown(triangle_plan: Plan) -> None:
    plan = changed(triangle_plan, "work", certificate=broken(triangle_plan.certificate))
    _, _, _, _, certified, clearance, *_ = headlines(plan, None)
    checks = plan.certificate.checks
    assert (certified.value, certified.state) == ("25 of 26 hold", "bad")
    assert f"work {len(checks) - 1} of {len(checks)}" in certified.detail
    assert checks[0].quantity in certified.detail
    assert clearance.state == "bad"
    text = report_page(plan)
    assert ">NO</td>" in text
    each = len(list(plan.job.checks()))
    first = f"<b>NOT SAFE: 1 of {each} promises is broken.</b>"
    assert f'<details class="verdict bad" open><summary>{first}</summary>' in text
    approach = triangle_plan.approach
    plan = changed(triangle_plan, "approach", certificate=broken(approach.certificate))
    certified, number = list(headlines(plan, None))[4], len(approach.certificate.checks)
    assert certified.state == "bad"
    assert certified.detail.endswith(f"approach {number - 1} of {number}")


def with_use(plan: Plan, share: float) -> Plan:
    """The plan as if its feet used that share of what their safety allows."""
    for segment in plan.job.segments:
        checks = tuple(
            replace(check, value=share * check.bound) if check.limit is Limit.HOLD else check
            for check in segment.certificate.checks
        )
        plan = changed(plan, segment.name, certificate=replace(segment.certificate, checks=checks))
    return plan


@pytest.mark.parametrize(("hold", "shown"), [(MAGNET, " none may), at all times"), (CLAMP, ", at all times")])
def test_what_the_feet_bear_is_a_share_of_what_their_safety_allows(
    hold: dict[str, object], shown: str
) -> None:
    plan = planned(clamped_scene(hold))
    (holds,) = (card for card in headlines(plan, None) if card.title == "Holds")
    check = next(check for check in plan.certificate.checks if check.limit is Limit.HOLD)
    use = max(each.value / each.bound for _, each in plan.job.checks() if each.limit is Limit.HOLD)
    assert holds.value == f"{100 * use:.0f} %"
    assert check.quantity in holds.detail
    assert shown in holds.detail
    assert holds.detail.endswith("of the job")
    stance = {"foot_1": {"member": "post_3", "along_m": 1.1}}
    there = replace(plan, scene=plan.scene.changed(guardrail={"stance": stance}))
    (holds,) = (card for card in headlines(there, None) if card.title == "Holds")
    assert holds.detail.endswith("of the job, on post_3 at 1.10 m (outer)")
    # Hardly anything is left of what safety allows: amber, beyond it red.
    for share, state in ((0.94, "good"), (0.96, "worse"), (1.01, "bad")):
        (holds,) = (card for card in headlines(with_use(plan, share), None) if card.title == "Holds")
        assert (holds.value, holds.state) == (f"{100 * share:.0f} %", state)
    page, within = compare_page({"one": plan, "two": plan}), plan.accuracy.within_mm
    for title, value in (("Feet use of what safety allows", 100 * use), ("Tool within", within)):
        assert f'<h2>{title}</h2><p><span class="planned" title="one">{value:.1f}<' in page
    page = report_page(plan)
    assert "Loads on the base and the joints" in page
    # The locked climber's, as docs/conventions.md has it.
    still = "the 30.4 kg that do not add 298 N downwards and (-74.5, 0.0, 0.0) Nm at all times."
    assert f"What moves is counted, 37.6 kg; {still}" in page


def test_fixed_knots_have_neither_floor_nor_approach(short_plan: Plan) -> None:
    _, _, _, floor, certified, *_ = headlines(short_plan, None)
    assert (floor.value, floor.detail) == ("–", "not computed for fixed knots")
    assert "approach" not in certified.detail


@pytest.mark.parametrize(
    ("value", "bound", "at_least", "use"),
    [(0.5, 1.0, False, 0.5), (0.04, 0.02, True, 0.5), (0.0, 0.02, True, np.inf), (2.0, 1.0, False, 2.0)],
)
def test_use_of_a_bound(triangle_plan: Plan, value: float, bound: float, at_least: bool, use: float) -> None:
    check = triangle_plan.certificate.checks[0]
    assert bound_use(replace(check, value=value, bound=bound, at_least=at_least)) == use
