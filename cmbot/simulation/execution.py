"""How a controller executes a motion: set-points at a rate, held or joined by lines, a delay, a servo.

Every joint follows the command as a Butterworth filter of second order follows its input,

    q'' + sqrt(2) w q' + w^2 q = w^2 c(t - delay),

whose bandwidth is w. Between set-points c is constant or linear, and the filter is solved exactly for that.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.simulation.options import SimulationOptions
from cmbot.simulation.prescribed_work import PrescribedWork

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

# Longest step of the solution, s, and in units of the quickest servo's time; between steps a cubic of its
# positions and rates.
_MAX_TIME_STEP_S, _RESOLVED = 1e-3, 0.25


@dataclass(frozen=True, eq=False)
class ExecutedMotion:
    """What the joints do, from `begin` to `end`, s, on the clock of the work.

    Its accelerations are means over `step`, s, that of the integrator: set-points excite what is quicker.
    """

    curve: CubicHermiteSpline
    begin: float
    end: float
    step: float

    @property
    def duration(self) -> float:
        """How long it moves, s."""
        return self.end - self.begin

    def states(self, times: FloatArray, /) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration at `times` (N,) from 0 to `duration`, each (N, n)."""
        t = self.begin + np.asarray(times)
        low, high = np.maximum(t - 0.5 * self.step, 0.0), t + 0.5 * self.step
        mean = (self.curve(high, 1) - self.curve(low, 1)) / (high - low)[:, None]
        return self.curve(t), self.curve(t, 1), mean


def is_executed(options: SimulationOptions) -> bool:
    """Whether joints do not follow their motion exactly."""
    return options.servo_bandwidth_hz is not None or options.delay_s > 0


def executed(
    work: PrescribedWork, options: SimulationOptions
) -> tuple[CubicHermiteSpline, tuple[ExecutedMotion, ...]]:
    """Return what the joints do under the command of a work, and its parts: those of the work, and the rest.

    Raises
    ------
    InputError
        When there are other bandwidths than joints.
    """
    from scipy.interpolate import CubicHermiteSpline

    total = work.duration + options.settle_s
    quickest = max(options.servo_bandwidth_hz or (1.0,))
    longest = min(_MAX_TIME_STEP_S, _RESOLVED / (2 * np.pi * quickest))
    period = longest if options.set_point_rate_hz is None else 1 / options.set_point_rate_hz
    within = max(int(np.ceil(period / longest * (1 - 1e-9))), 1)
    count = int(np.ceil((total + options.step_s) / period))
    points = work.postures(period * np.arange(count + 1, dtype=np.float64))
    step, n = period / within, points.shape[1]
    held = options.set_points == "held" and options.set_point_rate_hz is not None
    share = np.zeros(within) if held else np.arange(within) / within
    between = points[:-1, None] + share[:, None] * (points[1:] - points[:-1])[:, None]
    command = np.concatenate([between.reshape(-1, n), points[-1:]])
    if options.servo_bandwidth_hz is None:
        q, v = command, work.states(step * np.arange(len(command), dtype=np.float64))[1]
    else:
        q, v = _followed(command, step, _bandwidths(options, n), held=held)
    t = step * np.arange(len(q)) + options.delay_s
    if options.delay_s:
        t = np.concatenate([[0.0], t])
        q, v = np.concatenate([q[:1], q]), np.concatenate([np.zeros((1, n)), v])
    curve = CubicHermiteSpline(t, q, v)
    edges = [part.begin for part in work.parts] + [work.duration] + [total] * (options.settle_s > 0)
    return curve, tuple(ExecutedMotion(curve, begin, end, options.step_s) for begin, end in pairwise(edges))


def _bandwidths(options: SimulationOptions, n: int) -> FloatArray:
    given = np.array(options.servo_bandwidth_hz, dtype=np.float64)
    if len(given) not in (1, n):
        expected = f"one number, or {n}, one for each joint"
        raise InputError("SimulationOptions", "servo_bandwidth_hz", f"{len(given)} numbers", expected)
    return np.broadcast_to(given, n)


def _followed(
    command: FloatArray, step: float, bandwidths: FloatArray, *, held: bool
) -> tuple[FloatArray, FloatArray]:
    """Positions and rates (N, n) of joints that follow a command (N, n), at rest at first."""
    from scipy.signal import cont2discrete, lfilter

    away, found = command - command[0], np.empty((2, *command.shape))
    for j, bandwidth in enumerate(bandwidths):
        w = 2 * np.pi * bandwidth
        denominator = [1.0, np.sqrt(2) * w, w**2]
        # What multiplies the input of the position, and of its rate.
        for k, numerator in enumerate(([w**2], [w**2, 0.0])):
            method = "zoh" if held else "foh"
            b, a, _ = cont2discrete((numerator, denominator), step, method=method)
            found[k, :, j] = lfilter(b.ravel(), a, away[:, j])
    return found[0] + command[0], found[1]
