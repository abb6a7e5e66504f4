"""Many postures at once: put onto the tool task, and the directions that leave it alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.arrays import BoolArray, FloatArray
from cmbot.planning.task import ToolTask
from cmbot.robot import Postures

__all__ = ["Leaning", "null_spaces", "project"]

_ON_TASK = 1e-10
# Newton steps onto the task, enough for postures near it.
_FEW_STEPS = 6
# Postures far from the task take steps of at most this length a joint, rad.
_LONGEST_STEP = 0.6


def project(
    postures: Postures, task: ToolTask, q: FloatArray, point: FloatArray, steps: int = _FEW_STEPS
) -> tuple[FloatArray, BoolArray]:
    """Move postures `q` (N, n) the least way onto the task at `point` (3,), or at one (N, 3) each.

    Returns
    -------
    q : (N, n), rad
    reached : (N,)
        Which of them lie on the task now.
    """
    q, points = q.copy(), np.broadcast_to(point, (len(q), 3))
    reached = np.zeros(len(q), dtype=np.bool_)
    active = np.arange(len(q))
    for _ in range(steps):
        at = postures.at(q[active])
        error = task.errors(at.tool_point, at.tool_rotation, points[active])
        done = np.abs(error).max(axis=1) < _ON_TASK
        reached[active[done]] = True
        active, error = active[~done], error[~done]
        if len(active) == 0:
            break
        J = task.jacobians(at.tool_rotation, at.jacobian)[~done]
        step = J.transpose(0, 2, 1) @ np.linalg.solve(_gram(J), error[..., None])
        q[active] += _shortened(step[..., 0])
    return q, reached


@dataclass(frozen=True)
class Leaning:
    """Postures on the task, and where they lean when the tool is to move.

    Attributes
    ----------
    q : (N, n), rad
    point : (3,), m
        Where they hold the tool.
    slope : (N, n, 3), rad/m
        The least way that they move as the tool does.
    """

    q: FloatArray
    point: FloatArray
    slope: FloatArray

    @staticmethod
    def of(postures: Postures, task: ToolTask, q: FloatArray, point: FloatArray) -> Leaning:
        """Return how postures `q` (N, n) lean, which hold the tool at `point` (3,)."""
        at = postures.at(q)
        J = task.jacobians(at.tool_rotation, at.jacobian)
        along = np.broadcast_to(np.eye(J.shape[1])[:, :3], (len(J), J.shape[1], 3))
        return Leaning(q, point, J.transpose(0, 2, 1) @ np.linalg.solve(_gram(J), along))

    def towards(self, point: FloatArray) -> FloatArray:
        """Postures (N, n) that hold the tool at `point` (3,) to first order: what `project` does first."""
        return self.q + _shortened(self.slope @ (point - self.point))


def _gram(J: FloatArray) -> FloatArray:
    """Matrices (N, m, m) ``J J^T``, regular where Jacobians `J` (N, m, n) are singular, too."""
    return np.asarray(J @ J.transpose(0, 2, 1) + 1e-12 * np.eye(J.shape[1]))


def _shortened(step: FloatArray) -> FloatArray:
    """Steps (N, n), none of them longer than the longest that a joint may take."""
    longest = np.abs(step).max(axis=1, keepdims=True)
    return np.asarray(step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-30)))


def null_spaces(J: FloatArray) -> FloatArray:
    """Orthonormal bases (N, n - m, n) of what Jacobians `J` (N, m, n) take to nothing."""
    # The last columns of Q are what the rows of J leave out; four times as quick as a singular value
    # decomposition.
    Q = np.linalg.qr(J.transpose(0, 2, 1), mode="complete")[0]
    return np.asarray(Q[:, :, J.shape[1] :].transpose(0, 2, 1))
