"""Projection onto the tool task and null spaces of its Jacobian, for thousands of postures at once.

Inside, components lead and postures trail, so that every operation runs along postures. For systems of a few
unknowns that is several times as quick as LAPACK, called for one posture after the other. Lengths and norms
are those of `PostureMetric`: joints that slide have coordinates in rad, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.task import ToolTask
from cmbot.robot import PostureMetric, Postures, ToolBatch
from cmbot.toolpath import ToolPoses

# Postures far from the task take steps of at most this length a joint, rad.
_MAX_NEWTON_STEP = 0.6
# Added to the diagonal of Gram matrices, for singular Jacobians.
_REGULARIZATION = 1e-12
# In place of a length of zero as a divisor.
_MIN_DIVISOR = 1e-300


def project_onto_task(
    postures: Postures,
    task: ToolTask,
    q: FloatArray,
    goals: ToolPoses,
    *,
    steps: int = 6,
    tolerance: float = 1e-10,
    held: FloatArray | None = None,
    tool_of: Callable[[FloatArray, IntArray], ToolBatch] | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Project postures `q` (N, n) onto the tool task by Newton steps of least norm.

    `goals` are poses of the tool, one for each posture or one for all. The default of `steps`, which it takes
    at most, suffices for postures near the task. `tolerance`, m or rad, is the largest error
    of a task coordinate of a posture on the task. Along the directions `held` (N, a, n), such as its null
    space, each posture keeps its place. `tool_of` says where the tool is in some postures (k, n), with their
    numbers (k,), where that is not the rigid arm's.

    Returns the postures and which of them lie on the task now, (N,).
    """
    metric = postures.metric
    start = metric.coordinates(q).T
    x = start.copy()
    fixed = None if held is None else metric.coordinates(held).transpose(1, 2, 0)
    reached = np.zeros(len(q), dtype=np.bool_)
    active, sure = np.arange(len(q)), reached
    for _ in range(steps):
        reached[active[sure]] = True
        active = active[~sure]
        here = metric.positions(x[:, active].T)
        at = postures.tool_at(here) if tool_of is None else tool_of(here, active)
        error = task.errors(at.tool_point, at.tool_rotation, goals if len(goals) == 1 else goals[active]).T
        J = task_jacobian(task, at, metric)
        if fixed is not None:
            rows, left = fixed[..., active], start[:, active] - x[:, active]
            error = np.concatenate([error, np.einsum("akn,kn->an", rows, left)])
            J = np.concatenate([J, rows])
        done = np.abs(error).max(axis=0, initial=0.0) < tolerance
        if done.any():
            reached[active[done]] = True
            active, error, J = active[~done], error[:, ~done], J[:, :, ~done]
        if len(active) == 0:
            break
        step, y = least_norm_step(J, error)
        step = _shortened(step)
        x[:, active] += step
        # The error after a short step is at most curvature times its square: it needs no evaluation.
        left = _REGULARIZATION * np.abs(y).max(axis=0) + postures.bend * np.abs(step).sum(axis=0) ** 2
        sure = left < tolerance
    return np.ascontiguousarray(metric.positions(x.T)), reached


def null_space(postures: Postures, task: ToolTask, q: FloatArray, at: ToolBatch | None = None) -> FloatArray:
    """Return bases (N, n - m, n) of the null spaces of the task at postures `q` (N, n).

    They are moves, orthonormal by the metric of the postures. `at` is the tool where that is not the rigid
    arm's.
    """
    metric = postures.metric
    at = postures.tool_at(q) if at is None else at
    null = null_directions(task_jacobian(task, at, metric)).transpose(2, 0, 1)
    return metric.positions(null)


@dataclass(frozen=True, eq=False)
class TangentPredictor:
    """Postures `q` (N, n) that hold the tool at `goals`, and their derivatives of least norm by the task.

    Goals are those of each posture, or one of all. `slope` is (n, c, N), rad/m, of their coordinates in the
    metric of `postures`: by the tool point alone (c = 3), or where the tool turns by all task coordinates.
    """

    postures: Postures
    task: ToolTask
    q: FloatArray
    at: ToolBatch
    goals: ToolPoses
    slope: FloatArray

    @staticmethod
    def of(postures: Postures, task: ToolTask, q: FloatArray, goals: ToolPoses) -> TangentPredictor:
        """Return the predictor of postures `q` (N, n), which hold the tool at `goals`."""
        at = postures.tool_at(q)
        J = task_jacobian(task, at, postures.metric)
        turns = task.path.turns and task.keep != "position"
        columns = len(J) if turns else 3
        along = np.broadcast_to(np.eye(len(J))[:, :columns, None], (len(J), columns, len(q)))
        slope = np.einsum("ikn,ijn->kjn", J, solve_batch(gram(J, _REGULARIZATION), along))
        return TangentPredictor(postures, task, q, at, goals, slope)

    def towards(self, goals: ToolPoses) -> FloatArray:
        """Postures (N, n) that hold the tool at other goals to first order: Newton's first step."""
        if self.slope.shape[1] == 3:
            way = np.broadcast_to(goals.point - self.goals.point, (len(self.q), 3))
        else:
            way = self.task.errors(self.at.tool_point, self.at.tool_rotation, goals)
        step = np.einsum("kjn,nj->kn", self.slope, way)
        return np.asarray(self.q + self.postures.metric.positions(_shortened(step).T))


def least_norm_step(J: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Newton steps (n, N) of least norm that undo errors (m, N), and their multipliers (m, N).

    `J` (m, n, N) are the Jacobians.
    """
    y = solve_batch(gram(J, _REGULARIZATION), error[:, None])[:, 0]
    return np.einsum("ikn,in->kn", J, y), y


def gram(A: FloatArray, more: float = 0.0) -> FloatArray:
    """Return the matrices (m, m, N) ``A A^T + more I`` of `A` (m, n, N)."""
    G = np.einsum("ikn,jkn->ijn", A, A)
    G[np.diag_indices(len(A))] += more
    return np.asarray(G)


def solve_batch(G: FloatArray, b: FloatArray) -> FloatArray:
    """Solve ``G x = b`` for x (m, k, N), with `G` (m, m, N) symmetric, positive definite, `b` (m, k, N)."""
    G, x = G.copy(), b.copy()
    # Gauss's elimination, which needs no pivots here (Golub and Van Loan, Matrix Computations, Section 4.1).
    for i in range(len(G)):
        share = G[i + 1 :, i] / G[i, i]
        G[i + 1 :, i + 1 :] -= share[:, None] * G[i, i + 1 :]
        x[i + 1 :] -= share[:, None] * x[i]
    for i in reversed(range(len(G))):
        x[i] /= G[i, i]
        x[:i] -= G[:i, i, None] * x[i]
    return x


def null_directions(A: FloatArray) -> FloatArray:
    """Return orthonormal bases (n - m, n, N) of the null spaces of matrices `A` (m, n, N).

    They are the last columns of the orthogonal factor of ``A^T``, a product of Householder's reflections
    (Golub and Van Loan, Section 5.2).
    """
    A = A.copy()
    m, n, number = A.shape
    reflections = []
    for i in range(min(m, n)):
        v = A[i, i:]
        norm = np.sqrt((v * v).sum(axis=0))
        share = 1.0 / np.maximum(norm * (norm + np.abs(v[0])), _MIN_DIVISOR)
        v[0] += np.copysign(norm, v[0])
        _reflect(A[i + 1 :, i:], v, share)
        reflections.append((v, share))
    N = np.zeros((max(n - m, 0), n, number))
    for k, direction in enumerate(N):
        direction[m + k] = 1.0
    for i in reversed(range(len(reflections))):
        _reflect(N[:, i:], *reflections[i])
    return N


def task_jacobian(task: ToolTask, at: ToolBatch, metric: PostureMetric) -> FloatArray:
    """Return task Jacobians (m, n, N) by the coordinates of a metric."""
    J = metric.positions(task.jacobian(at.tool_rotation, at.leading_jacobian.transpose(2, 0, 1)))
    return np.ascontiguousarray(J.transpose(1, 2, 0))


def _shortened(step: FloatArray) -> FloatArray:
    """Steps (n, N), none of them longer than the longest that a joint may take."""
    return np.asarray(step * np.minimum(1.0, _MAX_NEWTON_STEP / np.maximum(np.abs(step).max(axis=0), 1e-30)))


def _reflect(vectors: FloatArray, v: FloatArray, share: FloatArray) -> None:
    """Take ``share v v^T`` off `vectors` (k, n, N), in place; `v` is (n, N), `share` (N,)."""
    vectors -= (share * np.einsum("kjn,jn->kn", vectors, v))[:, None] * v
