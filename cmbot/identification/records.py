"""Natural frequencies and damping from what an accelerometer on the tool records after a tap.

The free decay is a sum of damped oscillations: the eigensystem realisation algorithm (Juang and Pappa, 1985)
finds them from the Hankel matrix of the record. It is done for models of many orders; an oscillation that
most of them have is a mode, one that few have is noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.input_files import read_csv

_LARGEST = 20_000_000
_COLUMNS = (("t", "ax"), ("t", "ay"), ("t", "az"), ("t", "ax", "ay", "az"))
# How Klipper calls them.
_KLIPPER = {"#time": "t", "accel_x": "ax", "accel_y": "ay", "accel_z": "az"}
# Frequencies above this, Hz, are left out; samples a period of it that are kept.
_HIGHEST, _SAMPLES = 40.0, 6
# Of the decay: what is left out after the tap, and its longest part that is used, s.
_AFTER_TAP, _LONGEST = 0.03, 4.0
# Orders of the models, the share of them that have a mode, and by what share its frequencies may differ.
_ORDERS, _AGREE, _SAME = range(4, 31, 2), 0.5, 0.01
# Largest damping ratio of a mode, and the least share of the largest amplitude that it has.
_DAMPED, _SEEN = 0.15, 0.03
_FEWEST = 64
# Samples of a window of the Hankel matrix: more than a period of the slowest mode.
_ROWS = 100
_MODES = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class RingDown:
    """The modes of a free decay, the slowest first.

    Attributes
    ----------
    frequencies : (k,), Hz
        Undamped.
    shares : (k,)
        Their standard deviations among models of several orders, as shares.
    damping : (k,)
        Ratios.
    """

    frequencies: FloatArray
    shares: FloatArray
    damping: FloatArray


def read_record(path: Path) -> RingDown:
    """Read a CSV file with the columns ``t``, s, and one or all of ``ax``, ``ay``, ``az``, in any unit.

    They may also be called as Klipper does: ``#time,accel_x,accel_y,accel_z``.

    Raises
    ------
    InputError
        When it is no such file, its times are no equal steps, or no mode is seen in it.
    """
    rows = read_csv(path, InputError, kind="a CSV file of an accelerometer's record", largest=_LARGEST)
    heading = tuple(name.strip() for name in rows[0]) if rows else ()
    if tuple(_KLIPPER.get(name, name) for name in heading) not in _COLUMNS:
        expected = "the columns t,ax,ay,az, or t and one of them, or Klipper's #time,accel_x,accel_y,accel_z"
        # Sheets name such files: what is in one that is no record is not told.
        raise InputError(str(path), "line 1", f"other columns, {len(heading)} of them", expected)
    try:
        table = np.array(rows[1:], dtype=float)
    except ValueError as error:
        raise InputError(str(path), "", "no table of numbers", "a number in each cell") from error
    if len(table) < _FEWEST or not np.isfinite(table).all():
        raise InputError(str(path), "", f"{len(table)} rows", f"{_FEWEST} or more rows of finite numbers")
    steps = np.diff(table[:, 0])
    if not (steps > 0).all() or np.ptp(steps) > 0.01 * steps.mean():
        raise InputError(str(path), "t", "other times", "times in equal steps")
    found = ring_down(float(steps.mean()), table[:, 1:])
    if not len(found.frequencies):
        expected = f"the free decay after a tap, with modes below {_HIGHEST:g} Hz"
        raise InputError(str(path), "", "a record in which no mode is seen", expected)
    return found


def ring_down(step: float, a: FloatArray) -> RingDown:
    """Find the modes in accelerations (N, m), `step`, s, apart, that begin before a tap or with one."""
    from scipy.signal import decimate

    a = a - a.mean(axis=0)
    tap = int(np.abs(a).max(axis=1).argmax())
    y = a[tap + int(np.ceil(_AFTER_TAP / step)) :]
    y = y[: int(_LONGEST / step)]
    coarser = int(1 / (step * _HIGHEST * _SAMPLES))
    if coarser > 1 and len(y) > 60 * coarser:
        y, step = decimate(y, coarser, ftype="fir", axis=0), coarser * step
    if len(y) < _FEWEST:
        return _none()
    rows = min(len(y) // 2, _ROWS)
    windows = np.lib.stride_tricks.sliding_window_view(y, rows, axis=0)  # (N - rows + 1, m, rows)
    H = windows.transpose(2, 1, 0).reshape(rows * y.shape[1], -1)
    with threadpool_limits(limits=1, user_api="blas"):
        U, s, V = np.linalg.svd(H[:, :-1], full_matrices=False)
        known = [_poles(U, s, V, H[:, 1:], order, step, y.shape[1]) for order in _ORDERS if order <= len(s)]
    return _stable(known) if known else _none()


def _none() -> RingDown:
    nothing = np.zeros(0)
    return RingDown(frequencies=nothing, shares=nothing, damping=nothing)


def _poles(
    U: FloatArray, s: FloatArray, V: FloatArray, shifted: FloatArray, order: int, step: float, m: int
) -> FloatArray:
    """Frequency, Hz, damping ratio and amplitude (k, 3) of the oscillations of a model."""
    root = np.sqrt(s[:order])
    A = (U[:, :order] / root).T @ shifted @ (V[:order] / root[:, None]).T
    values, vectors = np.linalg.eig(A)
    # A zero among them decays at once.
    log = np.log(np.where(values == 0, np.finfo(float).tiny, values).astype(complex)) / step
    f, ratio = np.abs(log) / (2 * np.pi), -log.real / np.maximum(np.abs(log), 1e-12)
    C, start = U[:m, :order] * root, root * V[:order, 0]
    amplitude = np.linalg.norm(C @ vectors, axis=0) * np.abs(np.linalg.solve(vectors, start))
    kept = (log.imag > 0) & (ratio > 0) & (ratio < _DAMPED) & (f < _HIGHEST)
    return np.asarray(np.column_stack([f, ratio, amplitude])[kept])


def _stable(known: list[FloatArray]) -> RingDown:
    """The oscillations that most models have."""
    every = np.concatenate(known)
    if not len(every):
        return _none()
    largest, found = every[:, 2].max(), list[tuple[float, float, float]]()
    for order in np.argsort(every[:, 0]):
        f = every[order, 0]
        if found and f < found[-1][0] * (1 + 2 * _SAME):
            continue
        near = [each[np.abs(each[:, 0] / f - 1) < 2 * _SAME] for each in known]
        have = [each[each[:, 2].argmax()] for each in near if len(each)]
        middle = np.median(have, axis=0)
        agree = [each for each in have if abs(each[0] / middle[0] - 1) < _SAME]
        if len(agree) >= _AGREE * len(known) and middle[2] > _SEEN * largest:
            share = float(np.std([each[0] for each in agree]) / middle[0])
            found.append((float(middle[0]), share, float(middle[1])))
    table = np.array(found[:_MODES]).reshape(-1, 3)
    return RingDown(frequencies=table[:, 0], shares=table[:, 1], damping=table[:, 2])
