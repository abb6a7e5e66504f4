"""The report's cards: what was gained, and what is broken."""

from dataclasses import replace

import numpy as np
import pytest

from cmbot.planning import Certificate, Plan
from cmbot.simulation import Tracking
from cmbot.views import report_page
from cmbot.views.headlines import bound_use, headlines


def test_headlines_say_what_was_gained(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    peak, floor, certified, clearance, deviation, error = headlines(triangle_plan, triangle_tracking)
    before, after = triangle_plan.baseline_figures, triangle_plan.figures
    assert peak.before == f"{before.peak_guardrail_torque:.1f}"
    assert peak.value == f"{after.peak_guardrail_torque:.1f} Nm"
    assert "Nm on the approach" in peak.detail
    assert triangle_plan.gap_to_floor is not None
    assert floor.value == f"{100 * triangle_plan.gap_to_floor:+.3f} %"
    assert f"lower bound {triangle_plan.torque_floor:.1f} Nm: " in floor.detail
    assert triangle_plan.approach is not None
    work, approach = (len(of.certificate.checks) for of in (triangle_plan, triangle_plan.approach))
    assert certified.value == f"{work} of {work} hold"
    assert certified.detail.endswith(f"; approach: {approach} of {approach}")
    assert clearance.value == f"{1e3 * after.min_clearance:.1f} mm"
    assert deviation.value == f"{1e3 * after.max_tool_deviation:.2f} mm"
    assert "rigid arm" in deviation.detail and "rigid arm" in clearance.detail
    # Sag takes the bent tool off its path by more than the bound: no verdict to be green about.
    assert error.state == "plain" and "mm off its path; bound 1 mm" in error.detail
    assert error.value == f"{1e3 * triangle_tracking.planned.metrics.total.rms[3]:.1f} mm"
    assert {card.state for card in (peak, certified, clearance, deviation)} == {"good"}


def broken(certificate: Certificate) -> Certificate:
    """The certificate with a first check at twice its bound, and too small a clearance."""
    first, *others = certificate.checks
    figures = replace(certificate.figures, min_clearance=0.01)
    return replace(certificate, checks=(replace(first, value=2 * first.bound), *others), figures=figures)


def test_a_broken_bound_is_shown(triangle_plan: Plan) -> None:
    plan = replace(triangle_plan, certificate=broken(triangle_plan.certificate))
    _, _, certified, clearance, *_ = headlines(plan, None)
    checks = plan.certificate.checks
    assert (certified.value, certified.state) == (f"{len(checks) - 1} of {len(checks)} hold", "bad")
    assert checks[0].quantity in certified.detail
    assert clearance.state == "bad"
    assert ">NO</td>" in report_page(plan)


def test_a_broken_bound_of_the_approach_is_shown(triangle_plan: Plan) -> None:
    approach = triangle_plan.approach
    assert approach is not None
    plan = replace(triangle_plan, approach=replace(approach, certificate=broken(approach.certificate)))
    certified, number = list(headlines(plan, None))[2], len(approach.certificate.checks)
    assert certified.state == "bad"
    assert certified.detail.endswith(f"approach: {number - 1} of {number}")


def test_without_an_approach_none_is_named(short_plan: Plan) -> None:
    assert "approach" not in list(headlines(short_plan, None))[2].detail


def test_fixed_knots_have_no_floor(short_plan: Plan) -> None:
    floor = list(headlines(short_plan, None))[1]
    assert (floor.value, floor.detail) == ("–", "not computed for fixed knots")


@pytest.mark.parametrize(
    ("value", "bound", "at_least", "use"),
    [(0.5, 1.0, False, 0.5), (0.04, 0.02, True, 0.5), (0.0, 0.02, True, np.inf), (2.0, 1.0, False, 2.0)],
)
def test_use_of_a_bound(triangle_plan: Plan, value: float, bound: float, at_least: bool, use: float) -> None:
    check = triangle_plan.certificate.checks[0]
    assert bound_use(replace(check, value=value, bound=bound, at_least=at_least)) == use
