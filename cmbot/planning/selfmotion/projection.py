"""Many postures at once: put onto the tool task, and the directions that leave it alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning.path.task import ToolTask
from cmbot.planning.selfmotion.batched_linalg import gram, null_directions, solved
from cmbot.robot import Postures, ToolBatch

__all__ = ["TangentPredictor", "null_spaces", "project"]

_ON_TASK = 1e-10
# Newton steps onto the task, enough for postures near it.
_FEW_STEPS = 6
# Postures far from the task take steps of at most this length a joint, rad.
_LONGEST_STEP = 0.6
# Added to what is singular where Jacobians are.
_REGULAR = 1e-12


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
    # Components lead and postures trail here, so that operations run along postures.
    x, points = q.T.copy(), np.broadcast_to(point, (len(q), 3))
    reached = np.zeros(len(q), dtype=np.bool_)
    active, sure = np.arange(len(q)), reached
    for _ in range(steps):
        reached[active[sure]] = True
        active = active[~sure]
        at = postures.tool_at(x[:, active].T)
        error = task.errors(at.tool_point, at.tool_rotation, points[active]).T
        J = _leading(task, at)
        done = np.abs(error).max(axis=0, initial=0.0) < _ON_TASK
        if done.any():
            reached[active[done]] = True
            active, error, J = active[~done], error[:, ~done], J[:, :, ~done]
        if len(active) == 0:
            break
        y = solved(gram(J, _REGULAR), error[:, None])[:, 0]
        step = _shortened(np.einsum("ikn,in->kn", J, y))
        x[:, active] += step
        # What a short step leaves need not be looked at: it is no more than curvature times its square.
        left = _REGULAR * np.abs(y).max(axis=0) + postures.bend * np.abs(step).sum(axis=0) ** 2
        sure = left < _ON_TASK
    return np.ascontiguousarray(x.T), reached


@dataclass(frozen=True)
class TangentPredictor:
    """Postures on the task, and where they lean when the tool is to move.

    Attributes
    ----------
    q : (N, n), rad
    point : (3,), m
        Where they hold the tool.
    slope : (n, 3, N), rad/m
        The least way that they move as the tool does.
    """

    q: FloatArray
    point: FloatArray
    slope: FloatArray

    @staticmethod
    def of(postures: Postures, task: ToolTask, q: FloatArray, point: FloatArray) -> TangentPredictor:
        """Return how postures `q` (N, n) lean, which hold the tool at `point` (3,)."""
        J = _leading(task, postures.tool_at(q))
        along = np.broadcast_to(np.eye(len(J))[:, :3, None], (len(J), 3, len(q)))
        return TangentPredictor(q, point, np.einsum("ikn,ijn->kjn", J, solved(gram(J, _REGULAR), along)))

    def towards(self, point: FloatArray) -> FloatArray:
        """Postures (N, n) that hold the tool at `point` (3,) to first order: what `project` does first."""
        step = np.einsum("kjn,j->kn", self.slope, point - self.point)
        return np.asarray(self.q + _shortened(step).T)


def _leading(task: ToolTask, at: ToolBatch) -> FloatArray:
    """Task Jacobians (m, n, N)."""
    J = task.jacobians(at.tool_rotation, at.leading_jacobian.transpose(2, 0, 1))
    return np.ascontiguousarray(J.transpose(1, 2, 0))


def _shortened(step: FloatArray) -> FloatArray:
    """Steps (n, N), none of them longer than the longest that a joint may take."""
    return np.asarray(step * np.minimum(1.0, _LONGEST_STEP / np.maximum(np.abs(step).max(axis=0), 1e-30)))


def null_spaces(postures: Postures, task: ToolTask, q: FloatArray) -> FloatArray:
    """Orthonormal bases (N, n - m, n) of the moves from postures `q` (N, n) that leave the task alone."""
    return null_directions(_leading(task, postures.tool_at(q))).transpose(2, 0, 1)
