"""How many via-points a tool path asks for: ``via_points: auto``."""

from __future__ import annotations

import math

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.scene.path.tool_path import ToolPath

__all__ = ["automatic_via_points"]

# What splines follow between two via-points to a millimetre: way of the tool, m, turn of the tool and of the
# path, rad, and seconds; and how many segments a ramp has.
_WAY, _TURN, _BEND, _SECONDS, _PER_RAMP = 0.05, np.radians(15), np.radians(36), 1.0, 3
# Splines miss a smooth path by the fourth power of their segments' length; a speed is missed by the second.
_DEVIATION, _SPEED = 1e-3, 0.2
# Segments of a leg at least and at most, and of one whose shortest time is sought at least.
_FEWEST, _MOST, _FEWEST_OPEN = 4, 400, 30
_ALL = 12


def automatic_via_points(path: ToolPath, deviation: float, speed_tolerance: float | None) -> int:
    """Return the number of via-points of a path.

    Parameters
    ----------
    path : ToolPath
    deviation : float
        Of the tool from the path at most, m.
    speed_tolerance : float or None
        By what share the tool's speed may miss that of the process.

    Notes
    -----
    Each leg asks for a segment for every 50 mm, 15 degrees of the tool's turn, 36 degrees of the path's bend
    where it is sharpest, and second; for three a ramp; and where its shortest time is sought for thirty. The
    way and the angles shrink with the fourth root of the deviation, from 1 mm on, and with the square root of
    the speed's tolerance below 20 %. A leg has 4 to 400 segments, a path 12 at least.
    """
    finer = min((deviation / _DEVIATION) ** 0.25, 1.0)
    if speed_tolerance is not None:
        finer *= min(math.sqrt(speed_tolerance / _SPEED), 1.0)
    ramp = path.profile.ramp
    count = 0
    for leg, seconds in enumerate(path.seconds):
        length, bend = float(path.lengths[leg]), 0.0
        if leg in path.curves:
            bend = path.curves[leg].curvature * length
        asked = [length / (_WAY * finer), _turned(path, leg) / (_TURN * finer), bend / (_BEND * finer)]
        moves = max(asked) > 0
        if moves and leg in path.open_legs | path.laws.keys():
            asked.append(_FEWEST_OPEN)
        elif moves:
            asked += [seconds / _SECONDS, _PER_RAMP / ramp]
        count += int(np.clip(math.ceil(max(asked)), _FEWEST if moves else 1, _MOST))
    return max(count, _ALL, len(path.section_times) - 1) + 1


def _turned(path: ToolPath, leg: int) -> float:
    """Angle by which the tool turns along a leg, rad."""
    if not path.turns:
        return 0.0
    begin, end = path.leg_times[leg : leg + 2]
    R = path.rotation(np.linspace(begin, end, 41))
    steps: FloatArray = np.linalg.norm(np.diff(R, axis=0), axis=(1, 2)) / math.sqrt(8)
    return float(2 * np.arcsin(np.minimum(steps, 1.0)).sum())
