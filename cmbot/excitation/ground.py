"""Records of the deck's acceleration, and axle loads: the CSV files that a scene names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.input_files import read_csv
from cmbot.common.representation import short_repr
from cmbot.common.validation import shown
from cmbot.excitation.trains import Train, train_of
from cmbot.scene import TRAINS

_LARGEST_RECORD_BYTES = 50_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """Accelerations of the deck (N, 3), m/s2, in W, at times `t` (N,), s, from 0; linear between."""

    t: FloatArray
    a: FloatArray

    __repr__ = short_repr

    def at(self, t: FloatArray) -> FloatArray:
        """Return the accelerations (M, 3) at times (M,); zero after the end."""
        return np.stack([np.interp(t, self.t, axis, right=0.0) for axis in self.a.T], axis=1)


def read_record(path: Path, key: str = "") -> Record:
    """Read a CSV file with the columns ``t,ax,ay,az``; its times begin at 0 then.

    Raises
    ------
    SceneError
        When it cannot be read, or is no such file.
    """
    rows = _read(path, key, ("t", "ax", "ay", "az"))
    if not np.all(np.diff(rows[:, 0]) > 0):
        line = int(np.argmin(np.diff(rows[:, 0]) > 0)) + 3
        raise SceneError(str(path), f"line {line}", f"t = {rows[line - 2, 0]:g}", "times that ascend")
    return Record(t=rows[:, 0] - rows[0, 0], a=rows[:, 1:])


def axles_of(name: str) -> Train:
    """Return a train by its name, or from a CSV file with the columns ``at_m,load_kn``.

    Raises
    ------
    SceneError
        When that cannot be read, or is no such file.
    """
    if name in TRAINS:
        return train_of(name)
    rows = _read(Path(name), "excitation.deck.trains.axles", ("at_m", "load_kn"))
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return Train(axles=rows[:, 0] - rows[0, 0], loads=1e3 * rows[:, 1])


def _read(path: Path, key: str, columns: Sequence[str]) -> FloatArray:
    """The numbers of a CSV file with a heading, (N, k), two rows or more."""
    rows = read_csv(path, SceneError, kind="a CSV file", largest=_LARGEST_RECORD_BYTES)
    heading = [name.strip() for name in rows[0]] if rows else []
    if heading != list(columns):
        raise SceneError(str(path), "line 1", shown(",".join(heading)), f"the columns {','.join(columns)}")
    try:
        numbers = np.array(rows[1:], dtype=np.float64)
    except ValueError:
        numbers = np.full((1, 1), np.nan)
    if numbers.ndim != 2 or len(numbers) < 2 or not np.isfinite(numbers).all():
        expected = f"two rows or more of {len(columns)} finite numbers"
        raise SceneError(str(path), key, "other rows", expected)
    return numbers
