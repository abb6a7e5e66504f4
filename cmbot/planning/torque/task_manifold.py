"""Postures that hold the tool task, as the manifolds on which via-points move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import OptimisationFailed
from cmbot.planning.postures.projection import null_space, project_onto_task
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.bent_tool import BentTool
from cmbot.robot import Postures, ToolBatch
from cmbot.toolpath import ToolPoses

# Newton steps that project moved via-points onto the tool task, and the error that they leave.
_NEWTON_STEPS = 13
_TASK_TOLERANCE = 1e-11


@dataclass(frozen=True)
class TaskManifold:
    """The postures that hold the tool task at n via-points (a retraction of the parametrization)."""

    postures: Postures
    task: ToolTask
    goals: ToolPoses  # of each
    times: FloatArray  # (n,), s
    bent: BentTool | None = None  # None: the rigid arm's tool holds the task

    def tangents(self, q: FloatArray) -> FloatArray:
        """Directions (n, a, d) of the self-motion at postures `q` (n, d), orthonormal by their metric."""
        return null_space(self.postures, self.task, q, self._tool(q, np.arange(len(q))))

    def _tool(self, q: FloatArray, which: IntArray) -> ToolBatch:
        """The tool in postures `q` (k, d) of some via-points."""
        return self.postures.tool_at(q) if self.bent is None else self.bent.at(self.times[which], q)

    def retract(
        self, q: FloatArray, tangents: FloatArray, u: FloatArray, which: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Move via-points by `u` (k, a), rad: ``task(q) = 0, N^T (q - q_start) = u``, with N the tangents.

        The product is that of the metric of the postures.

        Returns and errors are those of `cmbot.trajectory.Retraction`.
        """
        q, reached = project_onto_task(
            self.postures,
            self.task,
            q[which] + np.einsum("ka,kai->ki", u, tangents),
            self.goals[which],
            steps=_NEWTON_STEPS,
            tolerance=_TASK_TOLERANCE,
            held=tangents,
            tool_of=lambda at, some: self._tool(at, which[some]),
        )
        at = self._tool(q, which)
        if not reached.all():
            error = self.task.errors(at.tool_point, at.tool_rotation, self.goals[which])
            raise OptimisationFailed(
                "a via-point moved to where the tool task cannot be held",
                constraint="tool task at a via-point",
                violation=float(np.abs(error).max()),
            )
        metric = self.postures.metric
        rows = metric.coordinates(metric.coordinates(tangents))
        A = np.concatenate([self.task.jacobian(at.tool_rotation, at.jacobian), rows], axis=1)
        rhs = np.zeros((len(q), A.shape[1], u.shape[1]))
        rhs[:, A.shape[1] - u.shape[1] :] = np.eye(u.shape[1])
        return q, np.linalg.solve(A, rhs).transpose(0, 2, 1)

    def part(self, first: int, last: int) -> TaskManifold:
        """Return the task at the via-points `first` to `last`."""
        some = slice(first, last + 1)
        return TaskManifold(self.postures, self.task, self.goals[some], self.times[some], self.bent)
