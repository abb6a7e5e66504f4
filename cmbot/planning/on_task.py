"""Many postures at once: put onto the tool task, and the directions that leave it alone."""

from __future__ import annotations

import numpy as np

from cmbot.arrays import BoolArray, FloatArray
from cmbot.planning.task import ToolTask
from cmbot.robot import Postures

__all__ = ["null_spaces", "project"]

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
        gram = J @ J.transpose(0, 2, 1) + 1e-12 * np.eye(J.shape[1])
        step = (J.transpose(0, 2, 1) @ np.linalg.solve(gram, error[..., None]))[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        q[active] += step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-30))
    return q, reached


def null_spaces(J: FloatArray) -> FloatArray:
    """Orthonormal bases (N, n - m, n) of what Jacobians `J` (N, m, n) take to nothing."""
    # The last columns of Q are what the rows of J leave out; four times as quick as a singular value
    # decomposition.
    Q = np.linalg.qr(J.transpose(0, 2, 1), mode="complete")[0]
    return np.asarray(Q[:, :, J.shape[1] :].transpose(0, 2, 1))
