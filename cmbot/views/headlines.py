"""What a person wants to know first of a plan: what was gained, and whether it is safe."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from typing import Literal

from cmbot.planning import Certificate, Check, Plan
from cmbot.simulation import Tracking, off_path

__all__ = ["Headline", "certificates", "headlines", "use_of"]


@dataclass(frozen=True, kw_only=True)
class Headline:
    """One card of the report.

    Attributes
    ----------
    title, value, detail : str
    before : str
        The baseline's value, where there is one to compare with.
    state : str
        ``good`` and ``bad`` are verdicts; ``plain`` is none.
    """

    title: str
    value: str
    detail: str
    before: str = ""
    state: Literal["plain", "good", "bad"] = "plain"


def headlines(plan: Plan, tracking: Tracking | None) -> Iterator[Headline]:
    """Yield the cards, what matters most first."""
    yield _peak(plan)
    yield _floor(plan)
    yield _certified(plan)
    yield _clearance(plan)
    yield _deviation(plan)
    if tracking is not None:
        yield _tracking(plan, tracking)


def certificates(plan: Plan) -> dict[str, Certificate]:
    """Return the certificates of a plan by what they are of."""
    approach = plan.approach
    return {"work": plan.certificate} | ({} if approach is None else {"approach": approach.certificate})


def use_of(check: Check) -> float:
    """Share of its bound that a check's value uses; 1 is at the bound, more is beyond."""
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


def _floor(plan: Plan) -> Headline:
    floor, gap = plan.torque_floor, plan.gap_to_floor
    if floor is None or gap is None:
        why = "fixed knots have none" if plan.floor is None else "something else was made small"
        return Headline(title="Above the floor", value="–", detail=why)
    return Headline(
        title="Above the floor",
        value=f"{100 * gap:+.3f} %",
        detail=f"floor: at one via-point no admissible posture at rest asks less than {floor:.1f} Nm; at 0 % "
        "there is nothing left to gain",
    )


def _certified(plan: Plan) -> Headline:
    found = certificates(plan)
    held = {name: _held(certificate) for name, certificate in found.items()}
    tightest = max(plan.certificate.checks, key=use_of)
    approach = f"; approach: {held['approach']}" if "approach" in held else ""
    kept = all(check.holds for certificate in found.values() for check in certificate.checks)
    return Headline(
        title="Certified promises",
        value=f"{held['work']} hold",
        detail=f"tightest: {tightest.quantity}, {100 * use_of(tightest):.0f} % of its bound{approach}",
        state="good" if kept else "bad",
    )


def _held(certificate: Certificate) -> str:
    return f"{sum(check.holds for check in certificate.checks)} of {len(certificate.checks)}"


def _clearance(plan: Plan) -> Headline:
    value, margin = plan.figures.min_clearance, plan.options.safety_margin_m
    if value == inf:
        return Headline(title="Smallest clearance", value="–", detail="nothing is there to be hit")
    before, always = plan.baseline_figures.min_clearance, plan.certificate.clearance_bound
    return Headline(
        title="Smallest clearance",
        before=f"{1e3 * before:.1f}",
        value=f"{1e3 * value:.1f} mm",
        detail=f"of the unbent arm; margin {1e3 * margin:g} mm; above {1e3 * always:.1f} mm at all times",
        state="good" if value >= margin else "bad",
    )


def _deviation(plan: Plan) -> Headline:
    value, bound = plan.figures.max_tool_deviation, plan.options.max_tool_deviation_m
    return Headline(
        title="Tool off its path",
        before=f"{1e3 * plan.baseline_figures.max_tool_deviation:.2f}",
        value=f"{1e3 * value:.2f} mm",
        detail=f"of the unbent arm; bound {1e3 * bound:g} mm"
        if not plan.options.compensate
        else f"bent as predicted; bound {1e3 * bound:g} mm",
        state="good" if value <= bound else "bad",
    )


def _tracking(plan: Plan, tracking: Tracking) -> Headline:
    compensated, allowed = plan.options.compensate, plan.options.max_tool_deviation_m
    # What compensation lowers is the distance from the path: the arm bends as much as before.
    motions = (tracking.baseline.figures, tracking.planned.figures)
    before, after = (1e3 * (m.path if compensated else m.total).rms[3] for m in motions)
    rest = [motion.figures.residual for motion in (tracking.baseline, tracking.planned)]
    swings = [f"{1e3 * residual.diameter:.2f}" for residual in rest if residual is not None]
    off = off_path(tracking.planned)
    detail = f"bent, at most {1e3 * off:.1f} mm off its path; bound {1e3 * allowed:g} mm"
    if len(swings) == 2:
        detail += f"; swings {' → '.join(swings)} mm after the stop"
    return Headline(
        title="Bent tool off its path, RMS" if compensated else "Tracking error, RMS",
        before=f"{before:.1f}",
        value=f"{after:.1f} mm",
        detail=detail,
        state="good" if off <= allowed else "plain",
    )
