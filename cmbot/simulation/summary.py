"""The results of a simulation in words: a short summary, a verdict, all metrics in rows, remarks."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.limit import Limit
from cmbot.common.reading.validation import counted
from cmbot.planning import APPROACH, RETURN, Plan, held_point
from cmbot.simulation.execution import is_executed
from cmbot.simulation.metrics import Statistics, statistics
from cmbot.simulation.options import SimulationOptions
from cmbot.simulation.tracking import MotionTracking, Tracking

_QUANTITY_NAMES = (
    ("mean", "mean"),
    ("standard deviation", "standard_deviation"),
    ("RMS", "rms"),
    ("peak to peak", "peak_to_peak"),
)
_PART_NAMES = (
    ("error", "total"),
    ("static part", "static"),
    ("dynamic part", "dynamic"),
    ("off the path", "path"),
)


# A tool sways more than another's beyond this factor, and is still below the second number, m.
_MORE_SWAY_FACTOR, _STILL = 1.05, 1e-5


def interval_headings(tracking: Tracking) -> tuple[str, ...]:
    """Return what the columns of `interval_rows` are called."""
    return "stiffness times", "mm", *(name for name, _ in tracking.motions)


def tracking_summary(tracking: Tracking, *, compensated: bool) -> Iterator[tuple[str, ...]]:
    """Yield the main results in mm, each as its name and the value of each motion, the planned one last.

    Parameters
    ----------
    tracking : Tracking
    compensated : bool
        The plan compensates the predicted sag.
    """
    each = [motion for _, motion in tracking.motions]
    sag = "tool sags beyond what was foreseen, mean" if compensated else "tool sags, mean"
    rows = {sag: [motion.metrics.static.mean[3] for motion in each]}
    parts, driven = _parts_in_time(tracking), all(motion.execution is not None for motion in each)
    for when, some in parts.items():
        rows[f"tool sways beside its sag{when}, at most"] = [one.largest(one.dynamic) for one in some]
        if driven:
            rows[f"tool off by how joints are driven{when}, at most"] = [*map(_largest_execution, some)]
    rows["tool off its path as simulated, at most"] = [motion.largest_off_path for motion in each]
    swings = [motion.metrics.residual.diameter for motion in each if motion.metrics.residual is not None]
    if len(swings) == len(each):
        rows[f"tool swings after the work{', free moves included' * (len(parts) > 1)}"] = swings
    for name, values in rows.items():
        yield name, *(f"{1e3 * value:.3f}" for value in values)


def _parts_in_time(tracking: Tracking) -> dict[str, list[MotionTracking]]:
    """The motions at work, and on free moves where there are any, by how that is said."""
    each = [motion for _, motion in tracking.motions]
    free = [motion.on_free_moves for motion in each if motion.on_free_moves is not None]
    return {" at work": [motion.at_work for motion in each], " on free moves": free} if free else {"": each}


def tracking_verdict(plan: Plan, tracking: Tracking) -> str:
    """Return whether the bent tool stays within the plan's margin, whether it sways more than the baseline's.

    Parameters
    ----------
    plan : Plan
    tracking : Tracking
        Of that plan.
    """
    return f"{_margin(plan, tracking)}{_swaying(plan, tracking)}"


def base_movement(plan: Plan, tracking: Tracking) -> str:
    """Return in words how far the base moves and turns, and what it bears; empty where it is rigid.

    Parameters
    ----------
    plan : Plan
    tracking : Tracking
        Of that plan.
    """
    if any(motion.base is None for _, motion in tracking.motions):
        return ""
    points = held_point(plan.scene, plan.robot), plan.robot.foot_point
    held, about = (f"({', '.join(f'{x:.3g}' for x in point)}) m" for point in points)
    told = list[str]()
    for when, motions in _parts_in_time(tracking).items():
        *other, (way, turn, torque) = [
            (
                f"{1e3 * motion.largest_base_displacement:.3g} mm",
                f"{np.rad2deg(motion.largest_base_rotation):.3g} deg",
                f"{motion.largest_base_torque:.2f} Nm",
            )
            for motion in motions
        ]
        beside = f" (baseline {', '.join(other[0])})" if other else ""
        told.append(f"moves{when} by up to {way} and turns by up to {turn}; with vibration it bears up to ")
        told[-1] += f"{torque} about {about}{beside}"
    unseen = " and ".join(each.name for each in plan.job.segments if each.name in (APPROACH, RETURN))
    return (
        f"Where it holds the arm, at {held}, the {plan.scene.base_name} {'; it '.join(told)}."
        f"{f' Not simulated: {unseen}.' if unseen else ''}"
    )


def beyond_margin(plan: Plan, tracking: Tracking) -> str:
    """Return in a sentence how far the bent tool leaves its path; empty where it stays within the margin.

    Parameters
    ----------
    plan : Plan
    tracking : Tracking
        Of that plan.
    """
    allowed, off = plan.options.max_tool_deviation_m, tracking.planned.largest_off_path
    if off <= allowed:
        return ""
    return (
        f"Simulated, the bent tool is up to {1e3 * off:.2f} mm off its path, beyond the margin of "
        f"{1e3 * allowed:g} mm."
    )


def _swaying(plan: Plan, tracking: Tracking) -> str:
    *others, after = (motion.at_work.largest(motion.at_work.dynamic) for _, motion in tracking.motions)
    before = max(others, default=np.inf)
    if after <= max(_MORE_SWAY_FACTOR * before, _STILL):
        return ""
    return (
        " The planned motion SWAYS MORE than the baseline: beside its sag the tool moves by up to "
        f"{1e3 * after:.3f} mm, the baseline's by {1e3 * before:.3f} mm."
    )


def _margin(plan: Plan, tracking: Tracking) -> str:
    allowed = plan.options.max_tool_deviation_m
    bound = f"{1e3 * allowed:g} mm (max_tool_deviation_m)"
    if not beyond_margin(plan, tracking):
        return (
            f"Within the margin: bent as it is, the tool stays within {bound} of its path.{_certified(plan)}"
        )
    text = f"Not within the margin: bent as it is, the tool leaves its path by more than {bound}"
    planned = tracking.planned.at_work
    if (driven := 1e3 * _largest_execution(planned)) > 1e3 * allowed:
        return f"{text}. How the joints are driven puts it up to {driven:.2f} mm from where it should be."
    if plan.options.compensate is True:
        sags = planned.largest(planned.static) > allowed
        why = "what bends here is not what was planned with" if sags else "beside it, it sways"
        return f"{text}, though the foreseen sag is compensated: {why}.{_certified(plan)}"
    if planned.largest(planned.dynamic) <= allowed:
        return f"{text}. That is sag, which can be foreseen: with compensate: true the plan makes up for it."
    return f"{text}. With compensate: true the plan makes up for the sag, not for the swaying."


def _certified(plan: Plan) -> str:
    """What the plan's own figure includes, where it compensates the sag."""
    if plan.options.compensate is not True:
        return ""
    value = max(check.value for _, check in plan.job.checks() if check.limit is Limit.TOOL_DEVIATION)
    sigmas = plan.options.deviation_sigmas
    spread = f" and {sigmas:g} of the standard deviations of its stiffness" if sigmas else ""
    return (
        f" What the plan certifies, {1e3 * value:.2f} mm, is the arm at rest in every posture{spread}; the "
        "simulation has this one stiffness, and the swaying in it."
    )


def interval_rows(tracking: Tracking) -> Iterator[tuple[str, ...]]:
    """Yield what the stiffness decides, in mm, a row as `interval_headings` calls its columns.

    Nothing where the stated stiffness alone was simulated.
    """
    for case in sorted(tracking.interval, key=lambda case: case.stiffness):
        at = f"{case.stiffness:g}"
        yield at, "tool off its path as simulated, at most", *(f"{1e3 * off:.3f}" for off in case.off_path)
        if case.swing is not None:
            yield at, "tool swings after the work", *(f"{1e3 * swing:.3f}" for swing in case.swing)


def tracking_rows(tracking: Tracking) -> Iterator[tuple[str, ...]]:
    """Yield all metrics in mm, each as its name, the motion's, and the numbers for x, y, z and the norm.

    The norm after the stop is the largest distance between two places of the tool.
    """
    parts = {name: dict(_parts(motion)) for name, motion in tracking.motions}
    for part, (quantity, field) in product(parts["planned"], _QUANTITY_NAMES):
        for name, found in parts.items():
            if part in found:
                yield f"{part}, {quantity}", name, *_numbers(getattr(found[part], field))
    for name, motion in tracking.motions:
        rest = motion.metrics.residual
        if rest is not None:
            numbers = _numbers(np.append(rest.peak_to_peak, rest.diameter))
            yield "after the stop, peak to peak", name, *numbers


def _parts(motion: MotionTracking) -> Iterator[tuple[str, Statistics]]:
    """Yield the parts of a motion's error by their names; the last is of how its joints are driven."""
    for part, attribute in _PART_NAMES:
        yield part, getattr(motion.metrics, attribute)
    if motion.execution is not None:
        moving = motion.t <= motion.stop * (1 + 1e-12)
        yield "by how joints are driven", statistics(motion.t[moving], motion.execution[moving])


def tracking_remarks(tracking: Tracking, *, compensated: bool = False) -> Iterator[str]:
    """Yield remarks on a simulation, a sentence or two each: definitions, vibration, options, wall time.

    `compensated`: the plan compensates the predicted sag.
    """
    rigid = "the bent tool from where the same joint angles put the rigid one"
    if compensated:
        if tracking.baseline is None:
            rigid += ", with the sag that was foreseen"
        else:
            rigid = (
                f"of the baseline {rigid}, of the planned motion from there with the sag that was foreseen"
            )
    yield f"Error: {rigid}; static: at rest; mm in W."
    yield "Off the path: along strokes, the bent tool from the nearest point of its leg."
    for name, motion in tracking.motions:
        apart = (
            "with the sag that was foreseen" if compensated and name == "planned" else "apart from bending"
        )
        largest = 1e3 * np.nanmax(np.linalg.norm(motion.command, axis=1))
        away = f"{largest:.3f} mm from its timed path"
        yield f"{name.capitalize()}: {apart}, the joints put the tool up to {away}."
    for remark in (_vibration, _decay):
        for name, motion in tracking.motions:
            if text := remark(motion):
                yield f"{name.capitalize()}: {text}."
    yield _setting(tracking.options)
    simulated = sum(float(motion.t[-1]) for _, motion in tracking.motions)
    yield f"Time: {tracking.seconds:.2f} s for {simulated:.0f} s of motion."


def _largest_execution(motion: MotionTracking) -> float:
    return 0.0 if motion.execution is None else motion.largest(motion.execution)


def _vibration(motion: MotionTracking) -> str:
    metrics = motion.metrics
    pairs = zip(metrics.mode_frequencies, 1e3 * np.sqrt(metrics.mode_power), strict=True)
    listed = ", ".join(f"{size:.4f} near {frequency:.2f} Hz" for frequency, size in pairs)
    return f"RMS of the dynamic part at the first modes, mm: {listed or 'none can be seen'}"


def _decay(motion: MotionTracking) -> str:
    residual = motion.metrics.residual
    if residual is None:
        return ""
    if residual.decay is None:
        return "nothing moves after the stop"
    later = f"{0.75 * residual.seconds:.1f} s later"
    return f"of the vibration after the stop {100 * residual.decay:.0f} % is left {later}"


def _setting(options: SimulationOptions) -> str:
    start = "hanging in equilibrium" if options.initial == "equilibrium" else "undeformed, and let go"
    guardrail, links, joints = options.guardrail_factor, options.link_factor, options.joint_factor
    stiffness = ""
    if (guardrail, links, joints) != (1.0, 1.0, 1.0):
        stiffness = f"stiffness times {guardrail:g} (base), {links:g} (links) and {joints:g} (joints), "
    driven = f", {_driven(options)}" if is_executed(options) else ""
    ratio = 100 * (options.damping or 0.0)
    return (
        f"Starts {start}; damping {ratio:g} % of critical for every mode in the first "
        f"posture, {stiffness}{counted(options.segments, 'segment')} a link, "
        f"steps of {1e3 * options.step_s:g} ms{driven}."
    )


def _driven(options: SimulationOptions) -> str:
    """How a controller drives the joints, in words."""
    parts = list[str]()
    if options.set_point_rate_hz is not None:
        parts.append(f"set-points at {options.set_point_rate_hz:g} Hz, {options.set_points}")
    if options.servo_bandwidth_hz is not None:
        each = ", ".join(f"{bandwidth:g}" for bandwidth in options.servo_bandwidth_hz)
        parts.append(f"servos of {each} Hz")
    if options.delay_s:
        parts.append(f"a delay of {1e3 * options.delay_s:g} ms")
    return f"joints driven with {', '.join(parts)}"


def _numbers(values: FloatArray) -> tuple[str, ...]:
    return tuple(f"{1e3 * value:z.3f}" for value in values)
