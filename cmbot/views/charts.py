"""The report's plots as data: curves, bounds and axes. The page draws them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning import RETURN, BaselineSegment, Plan, Samples, Segment, about_point, baseline_faults
from cmbot.simulation import Tracking
from cmbot.views.page import pack

MOST_POINTS = 1000  # of a curve in a large plot
MOST_SMALL_POINTS = 400  # of a curve in a small one
ROOM = 1.06  # an axis reaches this much further than its curves

_EXPECTED_CAPTION = "The tool with its predicted sag."
_ERROR_CAPTION = "Elastic arm's tool minus the rigid arm's at the same joint angles. Dashed: static part."
_COMPENSATED_CAPTION = (
    "Elastic arm's tool minus its expected position: the rigid arm's at the same joint angles and, for the "
    "planned motion, its predicted sag. Dashed: static part; zero where the sag is as predicted."
)
_WITHOUT_VIBRATION = "Without sag and vibration."
# Why free moves have no curves.
_NOT_SIMULATED, _NO_TOOL_PATH = "not simulated", "no tool path"
# What the quantities of joints that slide are called.
_SLIDING_NAMES = {"angle": "position", "torque": "force"}

# Segments further apart in time than this, s, have a gap between them: where an arm waits, or has no path.
_GAP_S = 1e-6
# A baseline that goes this many times as far as the planned motion is clipped.
_CLIPPED_RATIO = 2.0
# What a peak is lower than its bound by rounding, as a share.
_PEAK_ROUNDING = 1e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """A quantity `y` (N,) of one motion, in the chart's unit, at times `t` (N,) on the job's clock, s.

    A `thin` curve is part of another one. At the points `starts` it begins again: between each and the point
    before it there is no motion, or nothing of that quantity.
    """

    motion: str
    t: FloatArray
    y: FloatArray
    thin: bool = False
    starts: tuple[int, ...] = ()

    @classmethod
    def of_some(cls, motion: str, t: FloatArray, y: FloatArray, shown: BoolArray) -> Curve:
        """Return the curve through the points that are `shown` (N,), broken where others lie between."""
        kept = np.flatnonzero(shown)
        starts = np.flatnonzero(np.diff(kept) > 1) + 1
        return cls(motion=motion, t=t[kept], y=y[kept], starts=tuple(starts.tolist()))

    def downsampled(self, most: int = MOST_POINTS) -> Curve:
        """Return it with about `most` points, each of its pieces with a share of them: see `downsampled`."""
        pieces = [
            downsampled(t, y, max(most * len(t) // len(self.t), 4))
            for t, y in zip(np.split(self.t, self.starts), np.split(self.y, self.starts), strict=True)
        ]
        t, y = (np.concatenate(each) for each in zip(*pieces, strict=True))
        starts = np.cumsum([len(piece) for piece, _ in pieces])[:-1]
        return replace(self, t=t, y=y, starts=tuple(starts.tolist()))


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """One plot."""

    key: str  # its place on the page
    title: str
    unit: str
    digits: int  # decimals of a printed value
    curves: tuple[Curve, ...]
    axis: tuple[float, float]  # range that the axis shows at least
    bounds: tuple[float | None, float | None] = (None, None)  # values beyond them are not allowed
    marks: tuple[tuple[float, str], ...] = ()  # levels with their names
    note: str = ""  # explanation below the title
    work: tuple[float, float | None] = (0.0, None)  # when it begins, s, and ends, where what follows is shown
    free: str = ""  # why free moves have no curves, where they have none

    def scaled_to_plan(self, least: float = 0.0) -> Chart:
        """Return it with an axis that the planned motion decides, where the baseline goes far beyond.

        It then shows `_CLIPPED_RATIO` times as much as the planned motion, or `least`, needs.
        """
        own = [curve for curve in self.curves if curve.motion == "planned"]
        most, (low, high) = _CLIPPED_RATIO * ROOM * max(_highest(own), least), self.axis
        lowest = min((float(curve.y.min()) for curve in own), default=0.0)
        if own and most > 0:
            low, high = max(low, min(ROOM * lowest, 0.0) - most / 2), min(high, most)
        return replace(self, axis=(low, high)).with_clipped()

    def with_clipped(self) -> Chart:
        """Return it with a word on how far the baseline goes beyond the axis, where it does."""
        low, high = self.axis
        other = [curve for curve in self.curves if curve.motion == "baseline"]
        lowest = min((float(curve.y.min()) for curve in other), default=low)
        highest = max((float(curve.y.max()) for curve in other), default=high)
        parts = [f"up to {highest:.{self.digits}f}"] if highest > high else []
        parts += [f"down to {lowest:.{self.digits}f}"] if lowest < low else []
        if not parts:
            return self
        said = f"The baseline goes {' and '.join(parts)} {self.unit}, beyond this plot."
        return replace(self, note=f"{self.note} {said}".lstrip())

    def data(self, most: int = MOST_POINTS) -> dict[str, Any]:
        """Return it ready for JSON; arrays are little-endian float32 in base64."""
        curves = []
        for curve in self.curves:
            few = curve.downsampled(most)
            curves.append(vars(few) | {"t": pack(few.t), "y": pack(few.y)})
        return vars(self) | {"curves": curves}


def charts(plan: Plan, tracking: Tracking | None) -> Iterator[Chart]:
    """Yield the large plots, in the order of the page."""
    yield _torque(plan)
    yield _clearance(plan)
    yield _tool_deviation(plan)
    if tracking is not None:
        begin, note = work_begins(plan), _ERROR_CAPTION if plan.compensation is None else _COMPENSATED_CAPTION
        # One that keeps the limits is shown whole: how far it bends is what a plan may make up for.
        broken = bool(baseline_faults(plan, work=True))
        yield from _tracking(tracking, begin, note, clipped=broken)
        off = _off_path(tracking, begin)
        yield off.scaled_to_plan() if broken else off
        if torque := base_torque_curves(tracking, begin):
            chart = replace(torque_chart(plan, torque), key="tracking", free=_NOT_SIMULATED)
            # Near the data, where a vibration is seen.
            near = (2 - ROOM) * min(float(curve.y.min()) for curve in torque), chart.axis[1]
            yield replace(chart, title=f"{chart.title} with sag and vibration", axis=near)


def joint_charts(plan: Plan) -> Iterator[Chart]:
    """Yield the small plots, quantity by quantity, each with one chart a joint; in deg or m."""
    for chart_of, name, joint, factor in joint_axes(plan):
        yield chart_of(_curves(plan, of_joint(name, joint, factor)))


def joint_axes(plan: Plan) -> Iterator[tuple[Callable[[tuple[Curve, ...]], Chart], str, int, float]]:
    """Yield of each small plot what makes it, the attribute of `Samples`, the joint, the unit's factor."""
    kinds = ("position", "velocity", "acceleration", "jerk", "torque")
    for (title, name, lower, upper), kind in zip(joint_quantities(plan), kinds, strict=True):
        for joint in range(plan.robot.dof):
            units = plan.robot.limits.units(joint, shown=True)
            factor = 1.0 if kind == "torque" else units.factor
            make = partial(
                _joint_chart,
                title=_SLIDING_NAMES.get(title, title) if plan.robot.limits.prismatic[joint] else title,
                unit=getattr(units, kind),
                digits=1 if units.position == "deg" else 3,
                low=factor * float(lower[joint]),
                high=factor * float(upper[joint]),
            )
            yield make, name, joint, factor


def _joint_chart(
    curves: tuple[Curve, ...], *, title: str, unit: str, digits: int, low: float, high: float
) -> Chart:
    """Return a small plot whose axis reaches from bound to bound, where there are bounds."""
    bounds: tuple[float | None, float | None] = (low, high)
    room = 0.5 * (ROOM - 1) * (high - low)
    axis = (low - room, high + room)
    if not np.isfinite([low, high]).all():
        own = np.concatenate([c.y for c in curves if c.motion != "baseline"] or [c.y for c in curves])
        every, span = np.concatenate([c.y for c in curves]), float(np.ptp(own))
        axis = (max(float(every.min()), own.min() - span), min(float(every.max()), own.max() + span))
        bounds = (None, None)
    shown: dict[str, Any] = {"title": title, "unit": unit, "digits": digits, "bounds": bounds}
    return Chart(key="joint", curves=curves, axis=(float(axis[0]), float(axis[1])), **shown)


def joint_quantities(plan: Plan) -> tuple[tuple[str, str, FloatArray, FloatArray], ...]:
    """Return each quantity of a joint: title, attribute of `Samples`, lower and upper bounds (n,), SI."""
    limits = plan.robot.limits
    return (
        ("angle", "q", limits.lower, limits.upper),
        ("velocity", "v", -limits.velocity, limits.velocity),
        ("acceleration", "a", -limits.acceleration, limits.acceleration),
        ("jerk", "j", -limits.jerk, limits.jerk),
        ("torque", "joint_torque", -limits.torque, limits.torque),
    )


def downsampled(t: FloatArray, y: FloatArray, most: int = MOST_POINTS) -> tuple[FloatArray, FloatArray]:
    """Return at most `most` (4 or more) points of the curve `y` (N,) over `t` (N,), in the order of time.

    The curve is divided into segments of equally many points; its ends and the extremes of each segment stay.
    """
    if len(t) <= most:
        return t, y
    ends = np.linspace(0, len(t), (most - 2) // 2 + 1).astype(np.intp)
    first, last = ends[:-1], ends[1:]
    # A shorter segment repeats its last point.
    segments = y[np.minimum(first[:, None] + np.arange((last - first).max()), last[:, None] - 1)]
    kept = np.unique([0, *first + segments.argmin(axis=1), *first + segments.argmax(axis=1), len(t) - 1])
    return t[kept], y[kept]


def floor_name(plan: Plan) -> str:
    """Return what a plan's torque floor is called: one at rest where the moving arm has less."""
    name = "lower bound at rest" if _undercuts(plan) else "lower bound"
    return name if plan.torque_floor_kind == "proven" else f"{name} (estimate)"


def _undercuts(plan: Plan) -> bool:
    """Whether inertia takes the peak below the bound of the static torque."""
    return plan.gap_to_floor is not None and plan.gap_to_floor < -_PEAK_ROUNDING


def floor_meaning(plan: Plan) -> str:
    """Return what a plan's torque floor says, and what it rests on; empty without one."""
    bound = plan.lower_bound
    if bound is None:
        return ""
    has = "has" if bound.kind == "proven" else "was found to have"
    meaning = f"at one via-point no posture within the limits {has} a smaller static torque ({bound.basis})"
    return f"{meaning}; {undercut(plan)} less" if _undercuts(plan) else meaning


def undercut(plan: Plan) -> str:
    """Return who has less than the torque floor, with the verb: the bent arm or the moving one."""
    return "the moving arm has" if plan.compensation is None else "with the sag compensated the arm has"


def torque_of(samples: Samples) -> FloatArray:
    """Return the torque on the base, Nm."""
    return np.asarray(np.linalg.norm(samples.guardrail_torque, axis=1))


def clearance_of(samples: Samples) -> FloatArray:
    """Return the clearance, mm."""
    return 1e3 * samples.clearance


def deviation_of(samples: Samples) -> FloatArray:
    """Return the tool's distance from its path, mm."""
    return 1e3 * samples.tool_deviation


def torque_chart(plan: Plan, curves: tuple[Curve, ...]) -> Chart:
    """Return the torque on the base that is a plan's."""
    title, axis = f"Torque on the {plan.scene.base_name}{about_point(plan)}", (0.0, ROOM * _highest(curves))
    return Chart(key="torque", title=title, unit="Nm", digits=1, curves=curves, axis=axis)


def clearance_chart(plan: Plan, curves: tuple[Curve, ...]) -> Chart:
    """Return clearances beside a plan's margin; those that are infinite, as nothing can collide, are none."""
    margin = 1e3 * plan.options.safety_margin_m
    curves = tuple(curve for curve in curves if np.isfinite(curve.y).all())
    lowest = min((float(curve.y.min()) for curve in curves), default=0.0)
    return Chart(
        key="clearance",
        title="Clearance",
        unit="mm",
        digits=1,
        curves=curves,
        axis=(min(ROOM * lowest, 0.0), ROOM * max(_highest(curves), 2 * margin)),
        bounds=(margin, None),
        marks=((margin, f"margin {margin:g} mm"),),
    )


def deviation_chart(plan: Plan, curves: tuple[Curve, ...]) -> Chart:
    """Return distances from the tool path beside a plan's bound."""
    bound = 1e3 * plan.options.max_tool_deviation_m
    return Chart(
        key="deviation",
        title="Tool's distance from its path",
        unit="mm",
        digits=3,
        curves=curves,
        axis=(0.0, 1.15 * bound),
        bounds=(None, bound),
        marks=((bound, f"bound {bound:g} mm"),),
    )


def _torque(plan: Plan) -> Chart:
    bound, chart = plan.torque_floor, replace(torque_chart(plan, _curves(plan, torque_of)), work=_work(plan))
    if bound is None:
        return replace(chart, note=_WITHOUT_VIBRATION).scaled_to_plan()
    marks = ((bound, f"{floor_name(plan)} {bound:.1f} Nm"),)
    note = f"{_WITHOUT_VIBRATION} {floor_name(plan).capitalize()} of the peak: {floor_meaning(plan)}."
    return replace(chart, marks=marks, note=note).scaled_to_plan(bound)


def _clearance(plan: Plan) -> Chart:
    note = "The smallest distance of the arm to obstacles and to itself."
    chart = replace(clearance_chart(plan, _curves(plan, clearance_of)), work=_work(plan), note=note)
    return chart.scaled_to_plan(2e3 * plan.options.safety_margin_m)


def _tool_deviation(plan: Plan) -> Chart:
    thin = (
        Curve(motion="planned", t=t, y=1e3 * largest, thin=True) for t, largest in plan.deviation_with_spread
    )
    # Beside a bent arm's a rigid baseline would look as if it had no sag.
    bent = plan.samples.expected_tool_point is not None
    each = (
        curve for curve in _curves(plan, deviation_of, free=False) if not bent or curve.motion == "planned"
    )
    chart = deviation_chart(plan, (*each, *thin))
    return replace(chart, note=_expected(plan), free=_NO_TOOL_PATH).with_clipped()


def _expected(plan: Plan) -> str:
    if plan.samples.expected_tool_point is None:
        return ""
    spread = f" Thin: with {plan.shown_sigmas:g} standard deviations of the identified stiffness."
    off = plan.bent_offsets[0]
    baseline = "" if off is None else f" The baseline's, bent at rest: up to {1e3 * off:.3g} mm."
    return _EXPECTED_CAPTION + baseline + (spread if plan.deviation_with_spread else "")


def _tracking(tracking: Tracking, begin: float, note: str, *, clipped: bool) -> Iterator[Chart]:
    """Yield the tracking error along each axis, all to one scale; the work begins at `begin`, s.

    `clipped`: the planned motion decides that scale.
    """
    motions = tracking.motions
    shown = np.vstack([each for _, motion in motions for each in (motion.error, motion.static)])
    middles = 0.5e3 * (shown.min(axis=0) + shown.max(axis=0))
    half = 0.5e3 * ROOM * float(np.ptp(shown, axis=0).max())
    own = tracking.planned
    planned = np.vstack([own.error, own.static])
    far = _CLIPPED_RATIO * 0.5e3 * ROOM * float(np.ptp(planned, axis=0).max())
    if clipped and half > far > 0:
        middles, half = 0.5e3 * (planned.min(axis=0) + planned.max(axis=0)), far
    for number, axis in enumerate("xyz"):
        middle = float(middles[number])
        static = (Curve(motion=n, t=begin + m.t, y=1e3 * m.static[:, number], thin=True) for n, m in motions)
        total = (Curve(motion=n, t=begin + m.t, y=1e3 * m.error[:, number]) for n, m in motions)
        yield Chart(
            key="tracking",
            title=f"Tracking error along {axis}",
            unit="mm",
            digits=2,
            curves=(*static, *total),
            axis=(middle - half, middle + half),
            note="" if number else note,
            free=_NOT_SIMULATED,
        ).with_clipped()


def _off_path(tracking: Tracking, begin: float) -> Chart:
    curves = off_path_curves(tracking, begin)
    return Chart(
        key="tracking",
        title="Elastic tool's distance from its path",
        unit="mm",
        digits=2,
        curves=curves,
        axis=(0.0, ROOM * _highest(curves)),
        note="To the nearest point of the leg at that time: elastic deflection and joint motion together.",
        free=_NO_TOOL_PATH,
    )


def off_path_curves(tracking: Tracking, begin: float = 0.0) -> tuple[Curve, ...]:
    """Return how far the bent tool of each motion is off its path, mm; the work begins at `begin`, s."""
    return tuple(
        Curve.of_some(name, begin + motion.t, 1e3 * motion.off_path, np.isfinite(motion.off_path))
        for name, motion in tracking.motions
    )


def base_torque_curves(tracking: Tracking, begin: float = 0.0) -> tuple[Curve, ...]:
    """Return the torque with vibration on the bent base of each motion, Nm; none on a rigid one."""
    return tuple(
        Curve(motion=name, t=begin + motion.t, y=np.linalg.norm(motion.base[:, 6:], axis=1))
        for name, motion in tracking.motions
        if motion.base is not None
    )


def of_joint(name: str, joint: int, factor: float) -> Callable[[Samples], FloatArray]:
    """Return what takes an attribute of samples of a joint, in its unit."""
    return lambda samples: np.asarray(factor * getattr(samples, name)[:, joint])


def _curves(plan: Plan, quantity: Callable[[Samples], FloatArray], *, free: bool = True) -> tuple[Curve, ...]:
    """Return a quantity of the motions on the job's clock, `free` moves too; both begin to work at once."""
    motions = dict[str, list[tuple[Segment | BaselineSegment, Samples]]]()
    if plan.baseline is not None:
        motions["baseline"] = [(segment, segment.samples) for segment in plan.baseline.segments]
    motions["planned"] = [(segment, plan.segment_samples[segment.name]) for segment in plan.job.segments]
    curves = []
    for motion, each in motions.items():
        begin = next(segment.begin for segment, _ in each if segment.kind == "stroke") - work_begins(plan)
        shown = [(segment, samples) for segment, samples in each if free or segment.kind == "stroke"]
        # Both arms return at the same time: the one whose work is done first waits.
        times = [
            (work_ends(plan) if segment.name == RETURN else segment.begin - begin) + samples.t
            for segment, samples in shown
        ]
        gaps = [then[0] > t[-1] + _GAP_S for t, then in pairwise(times)]
        ends = np.cumsum([len(t) for t in times])[:-1][gaps]
        y = np.concatenate([quantity(samples) for _, samples in shown])
        t = np.concatenate(times)
        curves.append(Curve(motion=motion, t=t, y=y, starts=tuple(ends.tolist())))
    return tuple(curves)


def work_begins(plan: Plan) -> float:
    """Return when the work begins on the job's clock, s."""
    return plan.job.strokes[0].begin


def work_ends(plan: Plan) -> float:
    """Return until when the pages show the work: until the slowest motion is done, s."""
    each = [plan.samples, *([] if plan.baseline is None else [plan.baseline.samples])]
    return work_begins(plan) + max(float(samples.t[-1]) for samples in each)


def _work(plan: Plan) -> tuple[float, float | None]:
    return work_begins(plan), work_ends(plan) if plan.job.segment(RETURN) is not None else None


def _highest(curves: Sequence[Curve]) -> float:
    return max((float(curve.y.max()) for curve in curves), default=0.0)
