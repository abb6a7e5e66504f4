"""The report's cards: what was gained, and what is broken."""

import dataclasses

import numpy as np
import pytest

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views import report_page
from cmbot.views.headlines import bound_use, headlines


def test_headlines_say_what_was_gained(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    peak, floor, certified, clearance, deviation, error = headlines(triangle_plan, triangle_tracking)
    before, after = triangle_plan.baseline_figures, triangle_plan.figures
    assert (peak.before, peak.value) == (
        f"{before.peak_guardrail_torque:.1f}",
        f"{after.peak_guardrail_torque:.1f} Nm",
    )
    assert "Nm on the approach" in peak.detail
    assert triangle_plan.gap_to_floor is not None
    assert floor.value == f"{100 * triangle_plan.gap_to_floor:+.3f} %"
    assert f"floor {triangle_plan.torque_floor:.1f} Nm: lower bound" in floor.detail
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
    assert (floor.value, floor.detail) == ("–", "not computed for fixed knots")


@pytest.mark.parametrize(
    ("value", "bound", "at_least", "use"),
    [(0.5, 1.0, False, 0.5), (0.04, 0.02, True, 0.5), (0.0, 0.02, True, np.inf), (2.0, 1.0, False, 2.0)],
)
def test_use_of_a_bound(triangle_plan: Plan, value: float, bound: float, at_least: bool, use: float) -> None:
    check = triangle_plan.certificate.checks[0]
    assert bound_use(dataclasses.replace(check, value=value, bound=bound, at_least=at_least)) == use
