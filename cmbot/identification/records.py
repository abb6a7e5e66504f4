"""Natural frequencies and damping from what an accelerometer on the tool records after a tap.

The free decay is a sum of damped oscillations: the eigensystem realisation algorithm (Juang and Pappa, 1985)
finds them from the Hankel matrix of the record. It is done for models of many orders; an oscillation that
most of them have is a mode, one that few have is noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from cmbot.common.arrays import BoolArray, FloatArray, interpolated
from cmbot.common.errors import InputError
from cmbot.common.reading.text_table import read_table
from cmbot.common.reading.validation import counted

_RECORD_TIME_COLUMNS = ("t", "time", "seconds", "timestamp")
# Longer steps are in ms, s; by what share steps may differ; rows at an extreme value that are clipped.
_NO_STEP_IN_SECONDS, _JITTER, _CLIPPED = 0.5, 0.1, 4
# Frequencies above this, Hz, are left out; samples a period of it that are kept.
_HIGHEST, _SAMPLES_PER_PERIOD = 40.0, 6
# Of the decay: what is left out after the tap, and its longest part that is used, s.
_AFTER_TAP, _MAX_DECAY_S = 0.03, 4.0
# Orders of the models, the share of them that have a mode, and by what share its frequencies may differ.
_ORDERS, _AGREE, _SAME_FREQUENCY_SHARE = range(4, 31, 2), 0.5, 0.01
# Largest damping ratio of a mode, and the least share of the largest amplitude that it has.
_DAMPED, _SEEN = 0.15, 0.03
_MIN_SAMPLES = 64
# Above it modes stand out of noise, which is as an autoregression of so many samples says.
_LEAST_F, _NOISE_ORDER = 10.0, 6
# Modes whose amplitude before the tap, seen for so many periods, is more than this share of that behind it
# are hum, and so are those that decay by less than this exponent while they are seen.
_HUM_SHARE, _HUM_PERIODS, _HUM_DECAY = 0.5, 3.0, 0.02
# Samples of a window of the Hankel matrix: more than a period of the slowest mode.
_HANKEL_SAMPLES = 100
_MAX_MODES = 6


class UnusableRecord(InputError):
    """A record of accelerations that tells no modes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RingDown:
    """The modes of a free decay, the slowest first.

    Attributes
    ----------
    frequencies : (k,), Hz
        Undamped.
    shares : (k,)
        Their standard deviations, as shares.
    damping : (k,)
        Ratios; NaN where unknown.
    damping_deviations : (k,)
        Their standard deviations.
    directions : (k, 3)
        In which each mode moves the sensor, of unit length, along its axes x, y, z; NaN of an axis without a
        record.
    rest : (3,)
        Mean acceleration in the record's unit, which of a sensor that shows gravity is that; NaN of an axis
        without a record.
    source : str
        Name of the record's file; empty: there is none.
    """

    frequencies: FloatArray
    shares: FloatArray
    damping: FloatArray
    damping_deviations: FloatArray
    directions: FloatArray
    rest: FloatArray
    source: str = ""

    @classmethod
    def at(cls, frequencies: ArrayLike) -> RingDown:
        """Return modes of which the frequencies, Hz, are known alone, as well as is stated of them."""
        known = np.asarray(frequencies, dtype=float)
        unknown = np.full((len(known), 3), np.nan)
        return cls(
            frequencies=known,
            shares=np.zeros_like(known),
            damping=unknown[:, 0],
            damping_deviations=unknown[:, 0],
            directions=unknown,
            rest=np.full(3, np.nan),
        )

    def of(self, which: BoolArray) -> RingDown:
        """Return some of them (k,)."""
        kept = {name: own for name, own in vars(self).items() if name not in ("rest", "source")}
        return replace(self, **{name: own[which] for name, own in kept.items()})


def read_record(path: Path) -> RingDown:
    """Read a table with times and one or all of the accelerations along x, y, z, in any unit.

    Columns are found by their names, as Klipper (``#time,accel_x,…``), phyphox (``Time (s)``, ``Acceleration
    x (m/s^2)``) and loggers (``t,ax,…``) call them; times are in s or ms. Steps that differ by up to 10 % are
    made even.

    Raises
    ------
    InputError
        When it is no such file, steps differ by more, it is clipped or sampled too slowly, or no decay stands
        out of its noise.
    """
    table = read_table(path, InputError, kind="a table of an accelerometer's record")
    time = table.index(*_RECORD_TIME_COLUMNS, *(f"{name}_ms" for name in _RECORD_TIME_COLUMNS))
    at = [table.index(*_names(axis)) for axis in "xyz"]
    axes = [axis for axis in at if axis is not None]
    if {"freq", "psd_x"} <= {*table.names}:
        expected = "the raw record of which this is the spectrum, such as time,accel_x,accel_y,accel_z"
        raise UnusableRecord(str(path), "line 1", "freq,psd_x and more", expected)
    if time is None or not axes:
        got = ",".join(table.names) or "no names of columns"
        raise InputError(str(path), "line 1", got, "a column t and one or all of ax, ay, az")
    if len(table.rows) < _MIN_SAMPLES:
        raise InputError(str(path), "", counted(len(table.rows), "row"), f"{_MIN_SAMPLES} or more rows")
    t, a = table.seconds(time), table.numbers(axes)
    steps = np.diff(t)
    in_ms = table.names[time].endswith("_ms")
    if in_ms or (not table.units[time] and np.median(steps) > _NO_STEP_IN_SECONDS):
        t, steps = 1e-3 * t, 1e-3 * steps
    step = float(np.median(steps))
    if not (steps > 0).all() or np.abs(steps / step - 1).max() > _JITTER:
        worst = int(np.abs(steps / step - 1).argmax())
        key, got = f"line {table.lines[worst + 1]}", f"{1e3 * steps[worst]:.3g} ms after the row before"
        raise InputError(str(path), key, got, f"steps of {1e3 * step:.3g} ms, give or take 10 %")
    _require_unclipped(a, [table.names[axis] for axis in axes], str(path))
    if step > 1 / (2 * _HIGHEST):
        got = f"{1 / step:.3g} samples a second, in which fast modes look like slow ones"
        raise UnusableRecord(str(path), "", got, f"at least {2 * _HIGHEST:g}, better 200")
    even = np.linspace(t[0], t[-1], len(t))
    each = interpolated(even, t, a)
    with threadpool_limits(limits=1, user_api="blas"):
        found = ring_down(float((t[-1] - t[0]) / (len(t) - 1)), each)
    if not len(found.frequencies):
        expected = f"a tap, then for some s the free decay of modes below {_HIGHEST:g} Hz, 10 times the noise"
        raise UnusableRecord(str(path), "", "a record with no decay that stands out of its noise", expected)
    # What rings down ends as fast as it began: the mean of its accelerations is that at rest.
    given = np.full((len(found.frequencies) + 1, 3), np.nan)
    given[:, [axis is not None for axis in at]] = np.vstack([found.directions, each.mean(axis=0)])
    return replace(found, directions=given[:-1], rest=given[-1], source=path.name)


def _names(axis: str) -> Iterator[str]:
    """What loggers call an acceleration along an axis."""
    yield from (f"a{axis}", f"accel_{axis}", f"acc_{axis}", f"acceleration {axis}")
    yield from (f"linear acceleration {axis}", f"acceleration_{axis}", f"acc{axis}", axis)


def _require_unclipped(a: FloatArray, names: Sequence[str], source: str) -> None:
    """Refuse accelerations (N, m) that stay at their largest or least value, as beyond a sensor's range."""
    for column, name in zip(a.T, names, strict=True):
        if np.ptp(column) == 0:
            continue
        for extreme in (column.max(), column.min()):
            at = np.flatnonzero(column != extreme)
            longest = np.diff(np.concatenate([[-1], at, [len(column)]])).max() - 1
            if longest >= _CLIPPED:
                got = f"{longest} rows one after the other at {extreme:g}, its largest value"
                raise InputError(source, name, got, "a record within the sensor's range: tap less hard")


def ring_down(step: float, a: FloatArray) -> RingDown:
    """Find the modes in accelerations (N, m), `step`, s, apart, that begin before a tap or with one.

    Directions are those along the m axes.
    """
    from scipy.signal import decimate

    a, given = a - a.mean(axis=0), step
    tap = int(np.abs(a).max(axis=1).argmax())
    y = a[tap + int(np.ceil(_AFTER_TAP / step)) :]
    y = y[: int(_MAX_DECAY_S / step)]
    coarser = int(1 / (step * _HIGHEST * _SAMPLES_PER_PERIOD))
    if coarser > 1 and len(y) > 60 * coarser:
        y, step = decimate(y, coarser, ftype="fir", axis=0), coarser * step
    if len(y) < _MIN_SAMPLES or not y.any():
        return RingDown.at(())
    rows = min(len(y) // 2, _HANKEL_SAMPLES)
    windows = np.lib.stride_tricks.sliding_window_view(y, rows, axis=0)  # (N - rows + 1, m, rows)
    H = windows.transpose(2, 1, 0).reshape(rows * y.shape[1], -1)
    A, C, start = _largest_model(H, y.shape[1])
    found = _stable([_poles(A, C, start, order, step) for order in _ORDERS])
    hum = _is_hum(found, step, y, a[: max(tap - int(_AFTER_TAP / given), 0)], given)
    if hum.any():
        y = _left(_oscillations(found.of(hum), step, len(y), decays=False), y)
    found = found.of(~hum)
    return _fitted(found, step, y) if _stands_out(found, step, y) else RingDown.at(())


def _oscillations(found: RingDown, step: float, number: int, *, decays: bool = True) -> FloatArray:
    """Cosines and sines (number, 2 k) of modes, that decay or are steady."""
    w, t = 2 * np.pi * found.frequencies, step * np.arange(number)
    turn = np.outer(t, w * np.sqrt(1 - found.damping**2))
    decay = np.exp(-np.outer(t, w * found.damping)) if decays else 1.0
    return np.hstack([decay * np.cos(turn), decay * np.sin(turn)])


def _is_hum(found: RingDown, step: float, y: FloatArray, before: FloatArray, given: float) -> BoolArray:
    """Which modes (k,) are no decay: steady, or as large `before` the tap (M, m), `given`, s, apart."""
    hum = np.asarray(2 * np.pi * found.frequencies * found.damping * step * len(y) < _HUM_DECAY)
    after = _amplitudes(_oscillations(found, step, len(y)), y)
    for k in np.flatnonzero(found.frequencies * given * len(before) >= _HUM_PERIODS):
        own = found.of(np.arange(len(hum)) == k)
        steady = _amplitudes(_oscillations(own, given, len(before), decays=False), before)
        hum[k] |= steady[0] > _HUM_SHARE * after[k]
    return hum


def _amplitudes(columns: FloatArray, record: FloatArray) -> FloatArray:
    """Amplitudes (k,) of oscillations (N, 2 k) in a record (N, m)."""
    fitted = np.linalg.lstsq(columns, record, rcond=None)[0]
    return np.asarray(np.sqrt((fitted**2).sum(axis=1).reshape(2, -1).sum(axis=0)))


def _stands_out(found: RingDown, step: float, y: FloatArray) -> bool:
    """Whether modes explain a record (N, m) far better than as many numbers explain noise.

    The F statistic of the regression on their decaying oscillations, below the highest frequency, of the axis
    that shows them best. What the regression leaves is taken as an autoregression, whose filter makes it
    white (Cochrane and Orcutt, 1949), so that noise of any colour is below 8, and a decay from ten times the
    noise 11 to 20,000.
    """
    if not len(found.frequencies):
        return False
    columns = _oscillations(found, step, len(y))
    return any(_statistic(columns, axis, step) > _LEAST_F for axis in y.T if axis.any())


def _statistic(columns: FloatArray, axis: FloatArray, step: float) -> float:
    """F of the regression of an axis (N,) on columns (N, k), both filtered so that what is left is white."""
    white = np.column_stack(_filtered(_noise_filter(columns, axis), columns, axis))
    f = np.fft.rfftfreq(len(white), step)
    z = np.fft.rfft(white, axis=0)[(f > 0) & (f < _HIGHEST)]
    table = np.concatenate([z.real, z.imag])
    shown, record = table[:, :-1], table[:, -1]
    whole, rest = float(record @ record), float((_left(shown, record) ** 2).sum())
    freedom = len(record) - shown.shape[1]
    return float((whole - rest) / shown.shape[1] * freedom / max(rest, 1e-12 * whole))


def _noise_filter(columns: FloatArray, axis: FloatArray) -> FloatArray:
    """The filter that makes white what columns (N, k) leave of an axis (N,)."""
    from scipy.linalg import solve_toeplitz

    left = _left(columns, axis)
    # Without noise nothing is left.
    r = np.array([left[: len(left) - k] @ left[k:] for k in range(_NOISE_ORDER + 1)])
    r[0] += 1e-9 * float(axis @ axis)
    return np.concatenate([[1.0], -solve_toeplitz(r[:-1], r[1:])])


def _filtered(noise: FloatArray, columns: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    from scipy.signal import lfilter

    white = lfilter(noise, [1.0], np.column_stack([columns, axis]), axis=0)[_NOISE_ORDER:]
    return white[:, :-1], white[:, -1]


def _left(columns: FloatArray, record: FloatArray) -> FloatArray:
    """What a regression on columns (N, k) leaves of a record, (N,) or (N, m)."""
    return np.asarray(record - columns @ np.linalg.lstsq(columns, record, rcond=None)[0])


def _fitted(found: RingDown, step: float, y: FloatArray) -> RingDown:
    """Modes that fit a record (N, m) best, how exactly it tells them, and along which axes they are.

    Least squares of frequencies and ratios, the amplitudes projected out (variable projection; Golub and
    Pereyra, 1973), of what is left where the noise of each axis is white. That models of several orders agree
    with each other tells less: they share the noise.
    """
    from scipy.optimize import least_squares

    k, axes = len(found.frequencies), [axis for axis in y.T if axis.any()]
    columns = _oscillations(found, step, len(y))
    filters = [_noise_filter(columns, axis) for axis in axes]
    sizes = [
        max(float(np.std(_left(*_filtered(noise, columns, axis)))), 1e-9 * float(np.std(axis)))
        for noise, axis in zip(filters, axes, strict=True)
    ]

    def at(x: FloatArray) -> RingDown:
        f, ratio = found.frequencies * np.exp(x[:k]), found.damping * np.exp(x[k:])
        return replace(found, frequencies=f, damping=ratio)

    def residual(x: FloatArray) -> FloatArray:
        own = _oscillations(at(x), step, len(y))
        each = zip(filters, axes, sizes, strict=True)
        return np.concatenate([_left(*_filtered(noise, own, axis)) / size for noise, axis, size in each])

    bound = np.repeat([2 * _SAME_FREQUENCY_SHARE, 1.0], k)
    fit = least_squares(residual, np.zeros(2 * k), bounds=(-bound, bound), x_scale=bound)
    freedom = len(fit.fun) - 2 * k * (len(axes) + 1)
    deviation = np.sqrt(np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)) * 2 * fit.cost / freedom)
    best = at(fit.x)
    amplitudes = np.linalg.lstsq(_oscillations(best, step, len(y)), y, rcond=None)[0]
    # Cosine and sine of each mode (k, 2, m): of a real mode both are along one line.
    lines = np.linalg.svd(amplitudes.reshape(2, k, -1).transpose(1, 0, 2))[2][:, 0]
    return replace(
        best, shares=deviation[:k], damping_deviations=best.damping * deviation[k:], directions=lines
    )


def _largest_model(H: FloatArray, m: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The model of the highest order k that a Hankel matrix of m axes gives: A (k, k), C (m, k), start (k,).

    Those of lower orders are its leading blocks. Of the singular values only so many are needed: they are
    the roots of the largest eigenvalues of the Gram matrix.
    """
    from scipy.linalg import eigh

    now = H[:, :-1]
    squares, U = eigh(now @ now.T, subset_by_index=[len(H) - _ORDERS[-1], len(H) - 1])
    squares, U = np.maximum(squares[::-1], np.finfo(float).eps * squares[-1]), U[:, ::-1]
    # The singular values are s = root^2, the right vectors V = U' now / s.
    root, left = squares**0.25, U.T @ now
    return (U / root).T @ (H[:, 1:] @ left.T) / root**3, U[:m] * root, left[:, 0] / root


def _poles(A: FloatArray, C: FloatArray, start: FloatArray, order: int, step: float) -> FloatArray:
    """Frequency, Hz, damping ratio and amplitude (k, 3) of the oscillations of a model of some order."""
    A, C, start = A[:order, :order], C[:, :order], start[:order]
    values, vectors = np.linalg.eig(A)
    # A zero among them decays at once.
    log = np.log(np.where(values == 0, np.finfo(float).tiny, values).astype(complex)) / step
    f, ratio = np.abs(log) / (2 * np.pi), -log.real / np.maximum(np.abs(log), 1e-12)
    amplitude = np.linalg.norm(C @ vectors, axis=0) * np.abs(np.linalg.solve(vectors, start))
    kept = (log.imag > 0) & (ratio > 0) & (ratio < _DAMPED) & (f < _HIGHEST)
    return np.asarray(np.column_stack([f, ratio, amplitude])[kept])


def _stable(known: list[FloatArray]) -> RingDown:
    """The oscillations that most models have."""
    every = np.concatenate(known)
    if not len(every):
        return RingDown.at(())
    # What is slow is hardly seen in accelerations: it is a mode where its way is not small.
    ways = every[:, 2] / every[:, 0] ** 2
    largest, furthest = every[:, 2].max(), ways.max()
    found = list[tuple[float, float]]()
    for order in np.argsort(every[:, 0]):
        f = every[order, 0]
        if found and f < found[-1][0] * (1 + 2 * _SAME_FREQUENCY_SHARE):
            continue
        near = [each[np.abs(each[:, 0] / f - 1) < 2 * _SAME_FREQUENCY_SHARE] for each in known]
        have = [each[each[:, 2].argmax()] for each in near if len(each)]
        middle = np.median(have, axis=0)
        agree = sum(abs(each[0] / middle[0] - 1) < _SAME_FREQUENCY_SHARE for each in have)
        is_seen = middle[2] > _SEEN * largest or middle[2] / middle[0] ** 2 > _SEEN * furthest
        if agree >= _AGREE * len(known) and is_seen:
            found.append((float(middle[0]), float(middle[1])))
    table = np.array(found[:_MAX_MODES]).reshape(-1, 2)
    return replace(RingDown.at(table[:, 0]), damping=table[:, 1])
