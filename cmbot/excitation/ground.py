"""Records of the deck's acceleration, and axle loads: the CSV files that a scene names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.reading.text_table import read_table
from cmbot.common.reading.validation import shown
from cmbot.common.representation import ShortRepr
from cmbot.excitation.response import require_place
from cmbot.excitation.trains import Train, train_of
from cmbot.robot import Robot
from cmbot.scene import TRAINS, DamperFile, Scene

_LARGEST_RECORD_BYTES = 50_000_000
# Of a record: more is gravity, or an offset of the sensor.
_LARGEST_MEAN_M_S2 = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Record(ShortRepr):
    """Accelerations of the deck (N, 3), m/s2, in W, at times `t` (N,), s, from 0; linear between."""

    t: FloatArray
    a: FloatArray

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
    rows, lines = _read(path, key, ("t", "ax", "ay", "az"))
    if not np.all(np.diff(rows[:, 0]) > 0):
        row = int(np.argmin(np.diff(rows[:, 0]) > 0)) + 1
        raise SceneError(str(path), f"line {lines[row]}", f"t = {rows[row, 0]:g}", "times that ascend")
    t, a = rows[:, 0] - rows[0, 0], rows[:, 1:]
    mean = np.trapezoid(a, t, axis=0) / t[-1]
    axis = int(np.abs(mean).argmax())
    if abs(mean[axis]) > _LARGEST_MEAN_M_S2:
        got = f"a mean of {mean[axis]:.3g} m/s2 along {'xyz'[axis]}"
        raise SceneError(
            str(path), key, got, "a deck that stays: subtract the mean, gravity, from the column"
        )
    return Record(t=t, a=a)


def axles_of(name: str) -> Train:
    """Return a train by its name, or from a CSV file with the columns ``at_m,load_kn``.

    Raises
    ------
    SceneError
        When that cannot be read, or is no such file.
    """
    if name in TRAINS:
        return train_of(name)
    rows, lines = _read(Path(name), "excitation.deck.trains.axles", ("at_m", "load_kn"))
    if not np.all(rows[:, 1] > 0):
        row = int(np.argmin(rows[:, 1] > 0))
        raise SceneError(name, f"line {lines[row]}", f"load_kn = {rows[row, 1]:g}", "loads above zero, kN")
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return Train(axles=rows[:, 0] - rows[0, 0], loads=1e3 * rows[:, 1])


def _read(path: Path, key: str, columns: Sequence[str]) -> tuple[FloatArray, tuple[int, ...]]:
    """The numbers of a CSV file with a heading, (N, k), two rows or more, and their lines."""
    table = read_table(path, SceneError, kind="a CSV file of numbers", largest=_LARGEST_RECORD_BYTES)
    if table.names != columns or any(table.units):
        got = shown(",".join(table.names))
        raise SceneError(str(path), "line 1", got, f"the columns {','.join(columns)}, without units")
    if len(table.rows) < 2:
        raise SceneError(str(path), key, "1 row", "two rows or more")
    return table.numbers(range(len(columns))), table.lines


def require_inputs(scene: Scene, robot: Robot) -> None:
    """Refuse files that an excitation names, and a damper's place, before anything is planned.

    Parameters
    ----------
    scene : Scene
    robot : Robot
        Its own.

    Raises
    ------
    SceneError
        When a file cannot be read, or is no such file.
    InputError
        When a damper is at no place of the robot.
    """
    deck = None if scene.excitation is None else scene.excitation.deck
    if deck is not None and deck.record is not None:
        read_record(Path(deck.record), "excitation.deck.record")
    if deck is not None and deck.trains is not None:
        axles_of(deck.trains.axles)
    if isinstance(scene.damper, DamperFile):
        require_place(scene.damper.at, robot.joints, scene.source)
