"""The report's plots as data: which curves, between which bounds. The page draws them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning import Plan, Samples
from cmbot.simulation import MotionTracking, Tracking
from cmbot.views.frames import pack
from cmbot.views.thinning import thinned

__all__ = ["Chart", "Curve", "charts", "joint_charts"]

MOST_POINTS = 1000
"""Of a curve in a large plot."""
MOST_SMALL_POINTS = 400
"""Of a curve in a small one."""
ROOM = 1.06
"""Of the axis beyond what has to be seen."""

_EXPECTED = "Of the planned motion: where the tool is expected with its predicted sag."
_ERROR = "The bent tool from where the same joint angles put the rigid one. Dashed: the sag at rest."
_COMPENSATED = (
    "The bent tool from where it is expected: where the joint angles put the rigid one and, for the planned "
    "motion, its predicted sag from there. Dashed: the same at rest; at zero, the sag is as predicted."
)
_NOT_SIMULATED = "not simulated"

Motion = Literal["planned", "baseline"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """A quantity of one motion over time.

    Attributes
    ----------
    motion : str
    t : (N,), s
        The work starts at 0.
    y : (N,)
        In the chart's unit.
    thin : bool
        Of less weight: what belongs to another curve.
    """

    motion: Motion
    t: FloatArray
    y: FloatArray
    thin: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """One plot.

    Attributes
    ----------
    key : str
        Where it belongs on the page.
    title, unit : str
    digits : int
        Behind the point, where a value is shown.
    curves : tuple of Curve
    axis : two floats
        What the axis shows at least.
    bounds : two floats or None
        What is beyond them is not allowed.
    marks : tuple of (float, str)
        Levels with their names.
    note : str
        What has to be known to read it.
    approach : str
        Why the approach has no curve.
    """

    key: str
    title: str
    unit: str
    digits: int
    curves: tuple[Curve, ...]
    axis: tuple[float, float]
    bounds: tuple[float | None, float | None] = (None, None)
    marks: tuple[tuple[float, str], ...] = ()
    note: str = ""
    approach: str = ""

    def data(self, most: int = MOST_POINTS) -> dict[str, Any]:
        """Return it as JSON can hold it; arrays are little-endian float32 in base64."""
        curves = []
        for curve in self.curves:
            t, y = thinned(curve.t, curve.y, most)
            curves.append({"motion": curve.motion, "thin": curve.thin, "t": pack(t), "y": pack(y)})
        plain = ("key", "title", "unit", "digits", "axis", "bounds", "marks", "note", "approach")
        return {**{name: getattr(self, name) for name in plain}, "curves": curves}


def charts(plan: Plan, tracking: Tracking | None) -> Iterator[Chart]:
    """Yield the large plots, in the order of the page."""
    yield _torque(plan)
    yield _clearance(plan)
    yield _tool_deviation(plan)
    if tracking is not None:
        yield from _tracking(tracking, _ERROR if plan.compensation is None else _COMPENSATED)
        yield _off_path(tracking)


def joint_charts(plan: Plan) -> Iterator[Chart]:
    """Yield the small plots, quantity by quantity, each with one chart a joint; angles in deg."""
    limits = plan.robot.limits
    symmetric = (
        ("velocity", "v", limits.velocity, "deg/s", np.rad2deg(1.0)),
        ("acceleration", "a", limits.acceleration, "deg/s²", np.rad2deg(1.0)),
        ("jerk", "j", limits.jerk, "deg/s³", np.rad2deg(1.0)),
        ("torque", "joint_torque", limits.torque, "Nm", 1.0),
    )
    yield from _quantity(plan, "angle", "q", (limits.lower, limits.upper), "deg", np.rad2deg(1.0))
    for title, name, bound, unit, factor in symmetric:
        yield from _quantity(plan, title, name, (-bound, bound), unit, factor)


def _torque(plan: Plan) -> Chart:
    curves = _curves(plan, lambda samples: np.linalg.norm(samples.guardrail_torque, axis=1))
    floor = plan.torque_floor
    return Chart(
        key="torque",
        title="Torque on the guardrail",
        unit="Nm",
        digits=1,
        curves=curves,
        axis=(0.0, ROOM * _highest(curves)),
        marks=() if floor is None else ((floor, f"floor {floor:.1f} Nm"),),
        note="" if floor is None else "At one via-point no admissible posture rests below the floor.",
    )


def _clearance(plan: Plan) -> Chart:
    margin = 1e3 * plan.options.safety_margin_m
    curves = tuple(
        curve
        for curve in _curves(plan, lambda samples: 1e3 * samples.clearance)
        if np.isfinite(curve.y).all()  # infinite where nothing is there
    )
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
        note="The smallest distance of the arm to obstacles and to itself.",
    )


def _tool_deviation(plan: Plan) -> Chart:
    bound = 1e3 * plan.options.max_tool_deviation_m
    curves = _curves(plan, lambda samples: 1e3 * samples.tool_deviation, approach=False)
    return Chart(
        key="deviation",
        title="Tool's distance from its path",
        unit="mm",
        digits=3,
        curves=curves,
        axis=(0.0, 1.15 * bound),
        bounds=(None, bound),
        marks=((bound, f"bound {bound:g} mm"),),
        note=_EXPECTED if plan.samples.expected_tool_point is not None else "",
        approach="no tool path",
    )


def _tracking(tracking: Tracking, note: str) -> Iterator[Chart]:
    """Yield the tracking error along each axis, all to one scale."""
    motions = _motions(tracking)
    shown = np.vstack([each for _, motion in motions for each in (motion.error, motion.static)])
    middles = 0.5e3 * (shown.min(axis=0) + shown.max(axis=0))
    half = 0.5e3 * ROOM * float(np.ptp(shown, axis=0).max())
    for number, axis in enumerate("xyz"):
        middle = float(middles[number])
        curves = tuple(
            Curve(motion=name, t=motion.t, y=1e3 * values[:, number], thin=thin)
            for thin in (True, False)
            for name, motion in motions
            for values in [motion.static if thin else motion.error]
        )
        yield Chart(
            key="tracking",
            title=f"Tracking error along {axis}",
            unit="mm",
            digits=2,
            curves=curves,
            axis=(middle - half, middle + half),
            note="" if number else note,
            approach=_NOT_SIMULATED,
        )


def _off_path(tracking: Tracking) -> Chart:
    curves = tuple(
        Curve(motion=name, t=motion.t, y=1e3 * np.linalg.norm(motion.path_error, axis=1))
        for name, motion in _motions(tracking)
    )
    return Chart(
        key="tracking",
        title="Bent tool's distance from its path",
        unit="mm",
        digits=2,
        curves=curves,
        axis=(0.0, ROOM * _highest(curves)),
        note="Bending and the joint motion together; from the nearest point of the path.",
        approach=_NOT_SIMULATED,
    )


def _motions(tracking: Tracking) -> tuple[tuple[Motion, MotionTracking], ...]:
    return ("baseline", tracking.baseline), ("planned", tracking.planned)


def _quantity(
    plan: Plan, title: str, name: str, bounds: tuple[FloatArray, FloatArray], unit: str, factor: float
) -> Iterator[Chart]:
    for joint in range(plan.robot.dof):
        curves = _curves(plan, _of_joint(name, joint, factor))
        low, high = (factor * float(side[joint]) for side in bounds)
        finite = bool(np.isfinite([low, high]).all())
        if finite:
            room = 0.5 * (ROOM - 1) * (high - low)
            axis = (low - room, high + room)
        else:
            axis = (min(float(c.y.min()) for c in curves), max(float(c.y.max()) for c in curves))
        yield Chart(
            key="joint",
            title=title,
            unit=unit,
            digits=1,
            curves=curves,
            axis=axis,
            bounds=(low, high) if finite else (None, None),
        )


def _of_joint(name: str, joint: int, factor: float) -> Callable[[Samples], FloatArray]:
    return lambda samples: np.asarray(factor * getattr(samples, name)[:, joint])


def _curves(
    plan: Plan, quantity: Callable[[Samples], FloatArray], *, approach: bool = True
) -> tuple[Curve, ...]:
    """Return a quantity of both motions, the approach before the planned one."""
    planned = plan.samples
    t, y = planned.t, quantity(planned)
    before = plan.approach_samples
    if approach and before is not None:
        t = np.concatenate([before.t - before.t[-1], t])
        y = np.concatenate([quantity(before), y])
    return (
        Curve(motion="baseline", t=plan.baseline.t, y=quantity(plan.baseline)),
        Curve(motion="planned", t=t, y=y),
    )


def _highest(curves: tuple[Curve, ...]) -> float:
    return max((float(curve.y.max()) for curve in curves), default=0.0)
