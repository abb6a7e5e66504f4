"""The report's cards: what was gained, and whether every bound is kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from typing import Literal

from cmbot.planning import Certificate, Check, Plan
from cmbot.simulation import Tracking, off_path

__all__ = ["Headline", "bound_use", "certificates", "headlines"]


@dataclass(frozen=True, kw_only=True)
class Headline:
    """One card: a quantity of the planned motion, the baseline's value before it, a sentence, a verdict."""

    title: str
    value: str
    detail: str
    before: str = ""
    state: Literal["plain", "good", "bad"] = "plain"


def headlines(plan: Plan, tracking: Tracking | None) -> Iterator[Headline]:
    """Yield the cards, the most important first."""
    yield _peak(plan)
    yield _lower_bound(plan)
    yield _certificate(plan)
    yield _clearance(plan)
    yield _deviation(plan)
    if tracking is not None:
        yield _tracking(plan, tracking)


def certificates(plan: Plan) -> dict[str, Certificate]:
    """Return the certificates of a plan by motion: ``work`` and, where there is one, ``approach``."""
    approach = plan.approach
    return {"work": plan.certificate} | ({} if approach is None else {"approach": approach.certificate})


def bound_use(check: Check) -> float:
    """Return the share of its bound that a check's value uses: 1 at the bound, more beyond it."""
    if check.at_least:
        return check.bound / check.value if check.value > 0 else inf
    return check.value / check.bound if check.bound else 0.0


def _peak(plan: Plan) -> Headline:
    before, after = plan.baseline_figures.peak_guardrail_torque, plan.figures.peak_guardrail_torque
    detail = f"{100 * (after / before - 1):+.1f} % at work" if before else ""
    if plan.approach is not None:
        peak = plan.approach.certificate.figures.peak_guardrail_torque
        detail += f"; {peak:.1f} Nm on the approach"
    return Headline(
        title="Peak guardrail torque",
        before=f"{before:.1f}",
        value=f"{after:.1f} Nm",
        detail=detail,
        state="good" if after < before else "plain",
    )


def _lower_bound(plan: Plan) -> Headline:
    bound, gap = plan.torque_floor, plan.gap_to_floor
    if bound is None or gap is None:
        why = (
            "not computed for fixed knots" if plan.lower_bound is None else "another objective was minimised"
        )
        return Headline(title="Above the lower bound", value="–", detail=why)
    return Headline(
        title="Above the lower bound",
        value=f"{100 * gap:+.3f} %",
        detail=f"lower bound {bound:.1f} Nm: at one via-point no admissible posture at rest has a smaller "
        "torque",
    )


def _certificate(plan: Plan) -> Headline:
    held = {
        name: f"{sum(check.holds for check in found.checks)} of {len(found.checks)}"
        for name, found in certificates(plan).items()
    }
    tightest = max(plan.certificate.checks, key=bound_use)
    approach = f"; approach: {held['approach']}" if "approach" in held else ""
    kept = all(check.holds for found in certificates(plan).values() for check in found.checks)
    return Headline(
        title="Certified checks",
        value=f"{held['work']} hold",
        detail=f"tightest: {tightest.quantity}, {100 * bound_use(tightest):.0f} % of its bound{approach}",
        state="good" if kept else "bad",
    )


def _clearance(plan: Plan) -> Headline:
    value, margin = plan.figures.min_clearance, plan.options.safety_margin_m
    if value == inf:
        return Headline(title="Smallest clearance", value="–", detail="no pair of shapes can collide")
    always = plan.certificate.clearance_bound
    return Headline(
        title="Smallest clearance",
        before=f"{1e3 * plan.baseline_figures.min_clearance:.1f}",
        value=f"{1e3 * value:.1f} mm",
        detail=f"rigid arm; margin {1e3 * margin:g} mm; above {1e3 * always:.1f} mm at all times",
        state="good" if value >= margin else "bad",
    )


def _deviation(plan: Plan) -> Headline:
    value, bound = plan.figures.max_tool_deviation, plan.options.max_tool_deviation_m
    arm = "with the predicted sag" if plan.options.compensate else "rigid arm"
    return Headline(
        title="Tool off its path",
        before=f"{1e3 * plan.baseline_figures.max_tool_deviation:.2f}",
        value=f"{1e3 * value:.2f} mm",
        detail=f"{arm}; bound {1e3 * bound:g} mm",
        state="good" if value <= bound else "bad",
    )


def _tracking(plan: Plan, tracking: Tracking) -> Headline:
    compensated, bound = plan.options.compensate, plan.options.max_tool_deviation_m
    # Compensation lowers the distance from the path: the arm bends as much as before.
    motions = (tracking.baseline.metrics, tracking.planned.metrics)
    before, after = (1e3 * (m.path if compensated else m.total).rms[3] for m in motions)
    residuals = [m.residual for m in motions if m.residual is not None]
    off = off_path(tracking.planned)
    detail = f"elastic arm, at most {1e3 * off:.1f} mm off its path; bound {1e3 * bound:g} mm"
    if len(residuals) == 2:
        swings = " → ".join(f"{1e3 * residual.diameter:.2f}" for residual in residuals)
        detail += f"; residual vibration {swings} mm"
    return Headline(
        title="Elastic tool off its path, RMS" if compensated else "Tracking error, RMS",
        before=f"{before:.1f}",
        value=f"{after:.1f} mm",
        detail=detail,
        state="good" if off <= bound else "plain",
    )
