"""Metrics of a tracking error: its size, the residual vibration after the stop, its power at the modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from cmbot.common.arrays import FloatArray
from cmbot.common.representation import ShortRepr

# Half-width of a mode's band, as a share of its frequency: the frequency changes with the posture.
_MODE_BAND_SHARE = 0.2
_SHOWN_MODES = 4
# Samples of a segment of Welch's method: at 5 ms a resolution of 0.1 Hz.
_WELCH_SAMPLES = 2048


@dataclass(frozen=True, kw_only=True, eq=False)
class Statistics:
    """Statistics over time of a vector's components and of its norm.

    Attributes
    ----------
    mean, standard_deviation, rms, peak_to_peak : (4,), m
        Of x, y, z in W, then of ``|e(t)|``. Means are over time; the deviation is that of the whole motion,
        not an estimate from a sample.
    """

    mean: FloatArray
    standard_deviation: FloatArray
    rms: FloatArray
    peak_to_peak: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """The residual vibration of the tool after the joints have stopped.

    Attributes
    ----------
    seconds : float, s
        Simulated time after the stop.
    peak_to_peak : (3,), m
        Along x, y, z.
    diameter : float, m
        Largest distance between two positions of the tool.
    decay : float or None
        RMS of the dynamic error in the last quarter of that time, as a share of that in the first; None
        without vibration.
    """

    seconds: float
    peak_to_peak: FloatArray
    diameter: float
    decay: float | None


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorMetrics(ShortRepr):
    """The metrics of a motion's tracking error.

    Attributes
    ----------
    total, static, dynamic : Statistics
        Of the error, of its static part, of their difference, while the joints move, on free moves too.
    path : Statistics
        Of the bent tool's offset from the nearest point of the tool path's leg, along the strokes.
    residual : Residual or None
        None where nothing was simulated after the stop.
    mode_frequencies : (k,), Hz
        Of the first four modes in the motion's first posture; fewer where the sampling rate is too low.
    mode_power : (k,), m2
        Mean square of the dynamic error near each of them, while the joints move.
    """

    total: Statistics
    static: Statistics
    dynamic: Statistics
    path: Statistics
    residual: Residual | None
    mode_frequencies: FloatArray
    mode_power: FloatArray


def error_metrics(
    t: FloatArray,
    error: FloatArray,
    static: FloatArray,
    path_error: FloatArray,
    moving: int,
    frequencies: FloatArray,
) -> ErrorMetrics:
    """Return the metrics of a tracking error (N, 3), m, at times `t` (N,), s, in equal steps.

    `moving` is the number of samples until the stop, `frequencies` (f,), Hz, are those of the modes,
    ascending.
    """
    dynamic, step = error - static, float(t[1] - t[0])
    modes = frequencies[:_SHOWN_MODES]
    modes = modes[(1 + _MODE_BAND_SHARE) * modes < 0.5 / step]
    parts = {"total": error, "static": static, "dynamic": dynamic, "path": path_error}
    after = slice(moving - 1, None)
    return ErrorMetrics(
        **{name: statistics(t[:moving], part[:moving]) for name, part in parts.items()},
        residual=residual(t[after], dynamic[after]) if moving < len(t) else None,
        mode_frequencies=modes,
        mode_power=mode_power(step, dynamic[:moving], modes),
    )


def statistics(t: FloatArray, error: FloatArray) -> Statistics:
    """Return the statistics of an error (N, 3) at times (N,); rows of NaN are left out."""
    values = np.column_stack([error, np.linalg.norm(error, axis=1)])
    # Weights of the trapezoidal rule: the last step may be shorter.
    weight = np.gradient(t)
    weight[[0, -1]] *= 0.5
    known = np.isfinite(values[:, 3])
    values, weight = values[known], weight[known]
    weight /= weight.sum()
    mean = weight @ values
    return Statistics(
        mean=mean,
        standard_deviation=np.sqrt(weight @ (values - mean) ** 2),
        rms=np.sqrt(weight @ values**2),
        peak_to_peak=np.ptp(values, axis=0),
    )


def residual(t: FloatArray, dynamic: FloatArray) -> Residual:
    """Return the metrics of the dynamic error (N, 3) at times (N,) after the stop."""
    square = np.einsum("ki,ki->k", dynamic, dynamic)
    quarter = max(len(t) // 4, 1)
    first, last = square[:quarter].mean(), square[-quarter:].mean()
    return Residual(
        seconds=float(t[-1] - t[0]),
        peak_to_peak=np.ptp(dynamic, axis=0),
        diameter=float(pdist(dynamic).max()),
        decay=float(np.sqrt(last / first)) if first > 0 else None,
    )


def mode_power(step: float, dynamic: FloatArray, frequencies: FloatArray) -> FloatArray:
    """Return the mean square (k,), m2, of an error (N, 3), m, near each of `frequencies` (k,), Hz.

    By Welch's method, summed over the axes. A mode's band ends half-way to its neighbours, and at most a
    fifth of its frequency away. The frequencies ascend, below half the sampling rate; samples are `step`, s,
    apart.
    """
    at, total = power_density(step, dynamic, min(_WELCH_SAMPLES, len(dynamic)))
    middles = 0.5 * (frequencies[1:] + frequencies[:-1])
    low = np.maximum(np.concatenate([[0.0], middles]), (1 - _MODE_BAND_SHARE) * frequencies)
    high = np.minimum(np.concatenate([middles, [np.inf]]), (1 + _MODE_BAND_SHARE) * frequencies)
    sums = [total[(at >= a) & (at < b)].sum() for a, b in zip(low, high, strict=True)]
    return np.asarray(np.array(sums) * (at[1] - at[0]))


def power_density(step: float, dynamic: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Return frequencies, Hz, and the power density there, m2/Hz, of an error (N, 3), summed over the axes.

    By Welch's method (1967), in segments of `size` samples, 2 to N, that overlap by half, without their mean,
    under Hann's window; samples are `step`, s, apart. `scipy.signal.welch` does the same; importing it takes
    longer than the rest of a report.
    """
    starts = np.arange(0, len(dynamic) - size + 1, size - size // 2)
    segments = dynamic[starts[:, None] + np.arange(size)]
    segments -= segments.mean(axis=1, keepdims=True)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)
    waves = np.fft.rfft(segments * window[:, None], axis=1)
    density: FloatArray = (np.abs(waves) ** 2).mean(axis=0).sum(axis=1) * step / np.square(window).sum()
    # One-sided: doubled except at zero and, if it is there, at half the sampling rate.
    density[1 : (size + 1) // 2] *= 2
    return np.asarray(np.fft.rfftfreq(size, step)), density
