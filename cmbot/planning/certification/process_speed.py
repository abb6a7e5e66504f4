"""How far the tool's speed is from that of its process, enclosed at all times."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.toolpath import ToolPath
from cmbot.trajectory import Peak, Pieces, highest

# How far the bound may lie above what was found, as a share of the process speed.
_SPEED_RESOLUTION = 1e-6


def speed_deviation(path: ToolPath, pieces: Pieces, velocity: FloatArray, remainder: FloatArray) -> Peak:
    """Enclose the share by which the tool's speed misses that of the process.

    Parameters
    ----------
    path : ToolPath
    pieces : Pieces
        K of them, none of which has a break of the path inside.
    velocity : (K (d + 1), 3), m/s
        Of the tool point, at the points of interpolation.
    remainder : (K,), m/s
        What interpolation may miss of it.

    Notes
    -----
    A speed is not below the velocity's component in any direction. In that of the mean of the control points
    of a piece, which shrinks, the bound from below is as tight as is asked.
    """
    asked = path.process_speed(pieces.middle)
    on = asked > 0
    if not on.any():
        return Peak(time=float(pieces.trajectory.t[0]), value=0.0, bound=0.0)
    speed = asked[on]

    def missed(control: FloatArray, piece: IntArray) -> FloatArray:
        mean = control.mean(axis=2)
        along = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), np.finfo(float).tiny)
        above = np.linalg.norm(control, axis=1) / speed[piece, None] - 1
        below = 1 - np.einsum("kdn,kd->kn", control, along) / speed[piece, None]
        return np.asarray(np.maximum(above, below))

    def exact(control: FloatArray, piece: IntArray) -> FloatArray:
        return np.asarray(np.abs(np.linalg.norm(control, axis=1) / speed[piece, None] - 1))

    between = Pieces(trajectory=pieces.trajectory, start=pieces.start[on], end=pieces.end[on])
    control = pieces.control_points(velocity)[on]
    return highest(between, control, missed, remainder[on] / speed, _SPEED_RESOLUTION, exact)
