"""What a simulation found, in rows and in sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.simulation.options import SimulationOptions
from cmbot.simulation.tracking import MotionTracking, Tracking

__all__ = ["tracking_remarks", "tracking_rows"]

_QUANTITIES = (
    ("mean", "mean"),
    ("standard deviation", "standard_deviation"),
    ("RMS", "rms"),
    ("peak to peak", "peak_to_peak"),
)
_PARTS = (
    ("error", "total"),
    ("static part", "static"),
    ("dynamic part", "dynamic"),
    ("off the path", "path"),
)


def tracking_rows(tracking: Tracking) -> Iterator[tuple[str, ...]]:
    """Yield the figures in mm, each as its name, the motion's, and the numbers for x, y, z and the norm.

    The norm after the stop is the largest distance between two places of the tool.
    """
    for part, attribute in _PARTS:
        for quantity, field in _QUANTITIES:
            for name, motion in _named(tracking):
                statistics = getattr(motion.figures, attribute)
                yield f"{part}, {quantity}", name, *_numbers(getattr(statistics, field))
    for name, motion in _named(tracking):
        rest = motion.figures.residual
        if rest is not None:
            numbers = _numbers(np.append(rest.peak_to_peak, rest.diameter))
            yield "after the stop, peak to peak", name, *numbers


def tracking_remarks(tracking: Tracking) -> Iterator[str]:
    """Yield what should be known of a simulation besides its table, a sentence or two each."""
    yield (
        "Error: the bent tool from where the same joint angles put the rigid one and, with compensation, its "
        "predicted sag; static: at rest; mm in W."
    )
    yield "Off the path: the bent tool from the nearest point of its leg."
    yield from (_command(name, motion) for name, motion in _named(tracking))
    yield from (_vibration(name, motion) for name, motion in _named(tracking))
    yield from (_decay(name, motion) for name, motion in _named(tracking) if motion.figures.residual)
    yield _setting(tracking.options)
    simulated = tracking.baseline.t[-1] + tracking.planned.t[-1]
    yield f"Time: {tracking.seconds:.2f} s for {simulated:.0f} s of motion."


def _named(tracking: Tracking) -> tuple[tuple[str, MotionTracking], ...]:
    return ("baseline", tracking.baseline), ("planned", tracking.planned)


def _command(name: str, motion: MotionTracking) -> str:
    largest = 1e3 * np.linalg.norm(motion.command, axis=1).max()
    where = f"up to {largest:.3f} mm from its timed path"
    return f"{name.capitalize()}: apart from bending, the joints put the tool {where}."


def _vibration(name: str, motion: MotionTracking) -> str:
    figures = motion.figures
    pairs = zip(figures.mode_frequencies, 1e3 * np.sqrt(figures.mode_power), strict=True)
    listed = ", ".join(f"{size:.4f} near {frequency:.2f} Hz" for frequency, size in pairs)
    what = "RMS of the dynamic part at the first modes, mm"
    return f"{name.capitalize()}: {what}: {listed or 'none can be seen'}."


def _decay(name: str, motion: MotionTracking) -> str:
    residual = motion.figures.residual
    if residual is None or residual.decay is None:
        return f"{name.capitalize()}: nothing moves after the stop."
    return (
        f"{name.capitalize()}: of the vibration after the stop {100 * residual.decay:.0f} % is left "
        f"{0.75 * residual.seconds:.1f} s later."
    )


def _setting(options: SimulationOptions) -> str:
    start = "hanging in equilibrium" if options.initial == "equilibrium" else "undeformed, and let go"
    stiffness = (
        f"stiffness times {options.guardrail_factor:g} (guardrail) and {options.link_factor:g} (links), "
        if (options.guardrail_factor, options.link_factor) != (1.0, 1.0)
        else ""
    )
    segments = "1 segment" if options.segments == 1 else f"{options.segments} segments"
    return (
        f"Starts {start}; damping {100 * options.damping:g} % of critical for every mode in the first "
        f"posture, {stiffness}{segments} a link, steps of {1e3 * options.step_s:g} ms."
    )


def _numbers(values: FloatArray) -> tuple[str, ...]:
    # Adding zero turns -0.0 into 0.0.
    return tuple(f"{round(1e3 * value, 3) + 0.0:.3f}" for value in values)
