"""Whether every figure that is said of a plan is the worst of its job, as certificate and figures have it."""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from cmbot.planning import Check, MotionMetrics, Plan, baseline_faults, notes, sentence
from cmbot.views.report import headlines

# What has figures of its own: postures, areas, the bent arm, the baseline's ways.
OF_THEIR_OWN = ("unreached", "off_path", "travel", "jerk", "seconds", "baseline")
OF_THEIR_OWN += (
    "other_start",
    "sagging_start",
    "path_start",
    "better_start",
    "robot",
    "fallback",
    "stiffness",
)
# A stop is another motion.
STOP = re.compile(r"an emergency stop (needs )?[\d.]+ kN")
NUMBER = re.compile(r"(?<![\w.])[-+]?(\d+(?:\.(\d+))?) (Nm|kN|mm|deg/s3|deg/s2|deg/s|deg|%)(?![\w/])")
# Of what is shown in other units: factor and unit.
SHOWN = {"m": (1e3, "mm"), "N": (1e-3, "kN")}
SHOWN |= {f"rad{per}": (float(np.rad2deg(1.0)), f"deg{per}") for per in ("", "/s", "/s2", "/s3")}

Known = Iterator[tuple[float, str]]


def of_figures(*figures: MotionMetrics) -> Known:
    """The worst figures of motions with their units, as they are shown."""
    for name in ("peak_guardrail_torque", "peak_static_guardrail_torque"):
        yield max(getattr(each, name) for each in figures), "Nm"
    yield 1e3 * min(each.min_clearance for each in figures), "mm"
    yield 1e3 * max(each.max_tool_deviation for each in figures), "mm"
    if needed := [each.adhesion_needed.peak for each in figures if each.adhesion_needed is not None]:
        yield max(needed) / 1e3, "kN"
        yield max(each.adhesion_needed.closed for each in figures if each.adhesion_needed) / 1e3, "kN"


def worst_checks(plan: Plan) -> dict[str, Check]:
    """Of each quantity the worst check of all segments; bounds of a quantity differ where options do."""
    found: dict[str, Check] = {}
    for segment in plan.job.segments:
        for check in segment.certificate.checks:
            best = found.get(check.quantity)
            if best is None or use(check) > use(best):
                found[check.quantity] = check
    return found


def use(check: Check) -> float:
    """The share of its bound that a check uses."""
    if check.at_least:
        return check.bound / check.value if check.value > 0 else np.inf
    return check.value / check.bound


def of_checks(plan: Plan, text: str) -> Known:
    """Of the checks that a text names the worst values, bounds and what is left between them."""
    for quantity, check in worst_checks(plan).items():
        joint = re.fullmatch("distance of (.*) from the middle of its range", quantity)
        if quantity in text or (joint and f"{joint[1]} stays within its range" in text):
            factor, unit = SHOWN.get(check.unit, (1.0, check.unit))
            if unit == "of its bounds":
                factor, unit = 100.0, "%"
            yield from ((factor * value, unit) for value in (check.value, check.bound))
            yield factor * abs(check.bound - check.value), unit
            yield 100 * use(check), "%"


def of_plan(plan: Plan) -> Known:
    """What is known of the job and of the work as a whole, and of the baseline's."""
    for kinds in (("stroke",), ("stroke", "free")):
        # Not as the package adds them up. The tool has a place to be at only along strokes.
        ours, theirs = (
            [
                each.figures if each.kind == "stroke" else replace(each.figures, max_tool_deviation=0.0)
                for each in motion
                if each.kind in kinds
            ]
            for motion in (plan.job.segments, () if plan.baseline is None else plan.baseline.segments)
        )
        yield from of_figures(*ours)
        if not theirs:
            continue
        yield from of_figures(*theirs)
        for name in ("peak_guardrail_torque", "peak_static_guardrail_torque"):
            peak, before = (max(getattr(each, name) for each in motion) for motion in (ours, theirs))
            yield 100 * (peak / before - 1), "%"
        means = [
            np.average([each.mean_guardrail_torque for each in motion], weights=[x.duration for x in motion])
            for motion in (ours, theirs)
        ]
        yield 100 * (means[0] / means[1] - 1), "%"
    if plan.baseline is not None:
        yield 1e3 * plan.baseline.drift, "mm"
    still = plan.robot.model.inertias[0]
    lever = np.hypot(*(still.lever - plan.robot.foot_point)[:2])
    yield 9.81 * still.mass * float(lever), "Nm"
    yield 1e3 * plan.options.safety_margin_m, "mm"
    yield 1e3 * plan.options.max_tool_deviation_m, "mm"
    objective, whole = plan.objective, plan.job.certificate
    yield objective.planned_peak, objective.unit
    if objective.baseline_peak is not None:
        yield objective.baseline_peak, objective.unit
        yield 100 * (objective.planned_peak / objective.baseline_peak - 1), "%"
    if plan.lower_bound is not None and plan.choice is not None:
        bound, choice = plan.lower_bound, plan.choice
        each = (objective.floor, bound.value, bound.error, choice.free, choice.pinned)
        yield from ((value, objective.unit) for value in each if value is not None)
        yield from ((100 * (objective.planned_peak / value - 1), "%") for value in each if value)
        # Of an estimate, with how much confidence.
        yield from ((value, "%") for value in (95.0, 100 * (bound.missed or 0.0)))
    if (accuracy := plan.accuracy) is not None:
        yield 100 * accuracy.probability, "%"
        yield from ((100 * share, "%") for share in accuracy.shares)
        for placed in (plan.scene.uncertainty.foot, plan.scene.uncertainty.workpiece):
            yield from ((placed.mm, "mm"), (placed.deg, "deg"))
        yield from (
            (value, "mm") for value in (accuracy.within_mm, *(r.within_mm for r in accuracy.remedies))
        )
    # At all times, rounded away from what was found.
    yield np.floor(1e4 * min(each.certificate.clearance_bound for each in plan.job.segments)) / 10, "mm"
    yield (
        np.ceil(100 * max(each.certificate.guardrail_torque_bound for each in plan.job.segments)) / 100,
        "Nm",
    )
    if np.isfinite(whole.adhesion_bound):
        yield np.ceil(max(each.certificate.adhesion_bound for each in plan.job.segments) / 10) / 100, "kN"


def of_named(plan: Plan, text: str) -> Known:
    """The figures of the free moves that a text names; of those between strokes the worst."""
    moves = [segment for segment in plan.job.segments if segment.kind == "free"]
    for segment in moves:
        if segment.in_words in text or text.lower().startswith(f"{segment.name}:"):
            yield from of_figures(segment.figures)
    for foot in plan.robot.feet if text.startswith("Hold:") else ():
        yield 20.0, "%"  # with so much less adhesion
        yield from ((share * (foot.adhesion or 0.0) / 1e3, "kN") for share in (1.0, 0.8))
        needed = (each.figures.adhesion_needed for each in plan.job.segments)
        yield foot.safety * max((each.peak for each in needed if each is not None), default=0.0) / 1e3, "kN"
        yield from ((foot.ceiling / 1e3, "kN"), (1e3 * (foot.steel or 0.0), "mm"))


def texts(plan: Plan) -> Iterator[str]:
    """All that is said of a plan but what has figures of its own."""
    for note in notes(plan):
        if note.key not in OF_THEIR_OWN:
            yield STOP.sub("", sentence(note))
    for card in headlines(plan, None):
        unit: Any = card.value.rpartition(" ")[2]
        yield f"{card.title}: {f'{card.before} {unit}, ' if card.before else ''}{card.value}; {card.detail}"


def not_found(plan: Plan) -> list[str]:
    """Figures in what is said of a plan that neither its certificates nor its figures have."""
    missing, always = list[str](), [*of_plan(plan)]
    for text in texts(plan):
        known = [*always, *of_checks(plan, text), *of_named(plan, text)]
        for found in NUMBER.finditer(text):
            value, digits, unit = float(found[1]), len(found[2] or ""), found[3]
            half = 0.5 * 10.0**-digits * (1 + 1e-6) + 1e-9
            if not any(unit == other and abs(abs(each) - value) <= half for each, other in known):
                missing.append(f"{found[0]} in {text}")
    return missing


def require_told(plan: Plan) -> None:
    """Require every figure that is said to be in certificates and figures, and gains to be gains."""
    assert not_found(plan) == []
    if baseline_faults(plan, work=True):
        said = " ".join(texts(plan))
        assert "% less than the baseline" not in said
        assert "→" not in said
    if plan.robot.holding is None or not plan.robot.holding.adhesive:
        assert "adhesion" not in " ".join(texts(plan)).lower()
