"""A motion as the pages replay it: frames at equal time steps, packed for JSON."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.collision.clearance import Clearances, ShapePair
from cmbot.common.arrays import FloatArray
from cmbot.planning import MotionMetrics, Samples
from cmbot.robot import Kinematics, Robot

__all__ = ["Frames", "frame_times", "pack", "poses_of", "resampled"]


class Frames:
    """Makes frames of motions, and keeps the pairs of shapes that come near each other in any of them.

    Parameters
    ----------
    robot : Robot
    clearances : Clearances
    near : float, m
        Nearest points are kept where the smallest distance is below this.
    """

    def __init__(self, robot: Robot, clearances: Clearances, near: float) -> None:
        self._robot = robot
        self._clearances = clearances
        self._near = near
        self._names: dict[str, int] = {}

    @property
    def pairs(self) -> list[str]:
        """Names of the pairs, as the motions so far count them."""
        return list(self._names)

    def motion(
        self, samples: Samples, figures: MotionMetrics, times: FloatArray, error: FloatArray | None = None
    ) -> dict[str, Any]:
        """Return a motion at `times` (F,), ready for JSON; arrays are little-endian float32 in base64.

        ``poses`` (F, n, 7) are those of the arm's joint frames in W, as position and quaternion x, y, z, w;
        ``near`` (F, 6) the nearest points on the arm and on the other shape, ``pair`` (F,) an index into
        `pairs`, -1 where nothing is near; ``tool`` (F, 3) where the tool point is expected, its predicted sag
        counted where that is compensated, ``error`` (F, 3) how far the bent arm's is from there, null when
        that is not known. All in W and SI units.
        """
        q = resampled(times, samples.t, samples.q)
        near, pair = self._nearest(q)
        expected = samples.expected_tool_point
        tool = Kinematics(self._robot).tool_poses(q)[0]
        return {
            "poses": pack(poses_of(self._robot, q)),
            "torque": pack(resampled(times, samples.t, samples.guardrail_torque)),
            "clearance": pack(np.interp(times, samples.t, samples.clearance)),
            "near": pack(near),
            "pair": pack(pair),
            "tool": pack(tool if expected is None else resampled(times, samples.t, expected)),
            "error": None if error is None else pack(error),
            "peakTorque": figures.peak_guardrail_torque,
            # Infinite where nothing is there to be hit; JSON cannot say so.
            "minClearance": figures.min_clearance if np.isfinite(figures.min_clearance) else None,
        }

    def _nearest(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        points, pairs = np.zeros((len(q), 6)), np.full(len(q), -1.0)
        smallest = self._clearances.smallest(q)
        for k in np.flatnonzero(smallest.distance < self._near):
            number = int(smallest.pair[k])
            found = self._clearances.nearest(q[k], number)
            points[k] = np.concatenate([found.point, found.other_point])
            pairs[k] = self._names.setdefault(_name(self._clearances.pairs[number]), len(self._names))
        return points, pairs


def frame_times(start: float, end: float, step: float) -> FloatArray:
    """Return equally spaced times from `start` to `end`, at most `step` apart."""
    return np.linspace(start, end, max(int(np.ceil((end - start) / step)), 1) + 1)


def resampled(times: FloatArray, t: FloatArray, values: FloatArray) -> FloatArray:
    """Return `values` (N, k) at times `t` (N,) as they are at `times` (F,), linear in between."""
    return np.stack([np.interp(times, t, column) for column in values.T], axis=1)


def poses_of(robot: Robot, q: FloatArray) -> FloatArray:
    """Poses (N, n, 7) of the joint frames in W at postures `q` (N, n)."""
    data = robot.model.createData()
    poses = np.empty((*q.shape, 7))
    for k, q_k in enumerate(q):
        pin.forwardKinematics(robot.model, data, q_k)
        for joint in range(1, robot.model.njoints):
            poses[k, joint - 1] = pin.SE3ToXYZQUAT(data.oMi[joint])
    return poses


def pack(array: FloatArray) -> str:
    """Return an array as little-endian float32 in base64."""
    return base64.b64encode(array.astype("<f4").tobytes()).decode("ascii")


def _name(pair: ShapePair) -> str:
    return f"{pair.link} – {pair.other}"
