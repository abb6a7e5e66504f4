"""Figures of a tracking error: its size, what is left of it after the stop, its power at the modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from cmbot.common.arrays import FloatArray

__all__ = [
    "ErrorFigures",
    "Residual",
    "Statistics",
    "error_figures",
    "mode_power",
    "power_density",
    "residual",
    "statistics",
]

# A mode's band reaches at most this share of its frequency to either side: it moves with the posture.
_BAND = 0.2
_MODES = 4
# Samples of a segment of Welch's method: at 5 ms a resolution of 0.1 Hz.
_SEGMENT = 2048


@dataclass(frozen=True, kw_only=True, eq=False)
class Statistics:
    """What a vector's components are over time, and its norm.

    Attributes
    ----------
    mean, standard_deviation, rms, peak_to_peak : (4,), m
        Of x, y, z in W, then of the norm. Means are over time; the deviation is that of the whole motion, not
        an estimate from a sample. The norm's are those of ``|e(t)|``, not norms of the others.
    """

    mean: FloatArray
    standard_deviation: FloatArray
    rms: FloatArray
    peak_to_peak: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """What the tool does after the joints have stopped.

    Attributes
    ----------
    seconds : float, s
        How long it is watched.
    peak_to_peak : (3,), m
        Along x, y, z.
    diameter : float, m
        Largest distance between two of the tool's places.
    decay : float or None
        RMS of the dynamic error in the last quarter of that time, as a share of that in the first; None where
        nothing moves.
    """

    seconds: float
    peak_to_peak: FloatArray
    diameter: float
    decay: float | None


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorFigures:
    """The figures of a motion's tracking error.

    Attributes
    ----------
    total, static, dynamic : Statistics
        Of the error, of the sag of its postures, of the rest, while the joints move.
    path : Statistics
        Of the bent tool's way from the nearest point of the tool path's leg, while the joints move: what is
        left where the sag was compensated.
    residual : Residual or None
        None where the arm was not watched after the stop.
    mode_frequencies : (k,), Hz
        Of the first four modes in the motion's first posture; fewer where the samples are too far apart to
        show them.
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


def error_figures(
    t: FloatArray,
    error: FloatArray,
    static: FloatArray,
    path_error: FloatArray,
    moving: int,
    frequencies: FloatArray,
) -> ErrorFigures:
    """Reduce a tracking error to figures.

    Parameters
    ----------
    t : (N,), s
        Equal steps.
    error, static, path_error : (N, 3), m
    moving : int
        Number of samples until the stop.
    frequencies : (f,), Hz
        Of the modes, ascending.
    """
    dynamic, step = error - static, float(t[1] - t[0])
    shown = frequencies[:_MODES]
    shown = shown[(1 + _BAND) * shown < 0.5 / step]
    rest = slice(moving - 1, None)
    return ErrorFigures(
        total=statistics(t[:moving], error[:moving]),
        static=statistics(t[:moving], static[:moving]),
        dynamic=statistics(t[:moving], dynamic[:moving]),
        path=statistics(t[:moving], path_error[:moving]),
        residual=residual(t[rest], dynamic[rest]) if moving < len(t) else None,
        mode_frequencies=shown,
        mode_power=mode_power(step, dynamic[:moving], shown),
    )


def statistics(t: FloatArray, error: FloatArray) -> Statistics:
    """Reduce an error (N, 3) at times (N,) to figures."""
    values = np.column_stack([error, np.linalg.norm(error, axis=1)])
    # Weights of the trapezoidal rule: the last step may be shorter.
    weight = np.gradient(t)
    weight[[0, -1]] *= 0.5
    weight /= weight.sum()
    mean = weight @ values
    return Statistics(
        mean=mean,
        standard_deviation=np.sqrt(weight @ (values - mean) ** 2),
        rms=np.sqrt(weight @ values**2),
        peak_to_peak=np.ptp(values, axis=0),
    )


def residual(t: FloatArray, dynamic: FloatArray) -> Residual:
    """Reduce the dynamic error (N, 3) at times (N,) after the stop to figures."""
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
    """Return the mean square of an error near each of some frequencies.

    By Welch's method, summed over the axes. A mode's band ends half-way to its neighbours, and no further
    than a fifth of its frequency away.

    Parameters
    ----------
    step : float, s
        Between the samples.
    dynamic : (N, 3), m
    frequencies : (k,), Hz
        Ascending, below half the sampling rate.

    Returns
    -------
    (k,), m2
    """
    at, total = power_density(step, dynamic, min(_SEGMENT, len(dynamic)))
    middles = 0.5 * (frequencies[1:] + frequencies[:-1])
    low = np.maximum(np.concatenate([[0.0], middles]), (1 - _BAND) * frequencies)
    high = np.minimum(np.concatenate([middles, [np.inf]]), (1 + _BAND) * frequencies)
    bands = zip(low, high, strict=True)
    shares = [total[(at >= a) & (at < b)].sum() for a, b in bands]
    return np.asarray(np.array(shares) * (at[1] - at[0]))


def power_density(step: float, dynamic: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Return the power density of an error, summed over the axes.

    By Welch's method (1967), in segments that overlap by half, each less its mean and under Hann's window.
    `scipy.signal.welch` does the same; to import it takes longer than the rest of a report.

    Parameters
    ----------
    step : float, s
        Between the samples.
    dynamic : (N, 3), m
    size : int
        Of the segments, 2 to N samples.

    Returns
    -------
    frequencies, density : (size // 2 + 1,), Hz and m2/Hz
    """
    hop = size - size // 2
    starts = np.arange(0, len(dynamic) - size + 1, hop)
    segments = dynamic[starts[:, None] + np.arange(size)]
    segments -= segments.mean(axis=1, keepdims=True)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)
    waves = np.fft.rfft(segments * window[:, None], axis=1)
    density: FloatArray = (np.abs(waves) ** 2).mean(axis=0).sum(axis=1) * step / np.square(window).sum()
    # One side stands for both, but for the mean and, where there is one, half the sampling rate.
    density[1 : (size + 1) // 2] *= 2
    return np.asarray(np.fft.rfftfreq(size, step)), density
