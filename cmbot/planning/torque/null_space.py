"""Via-points that slide along the self-motion, the tool task kept exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import OptimisationFailed
from cmbot.planning.path.projection import null_space, project_onto_task
from cmbot.planning.path.task import ToolTask
from cmbot.robot import Postures

__all__ = ["LONGEST_SLIDE", "TaskAtViaPoints"]

LONGEST_SLIDE = 0.3
"""A via-point slides at most so far, rad, before tangents are taken anew."""

# Newton steps that project slid via-points onto the tool task, and the error that they leave.
_NEWTON_STEPS = 13
_ON_TASK = 1e-11


@dataclass(frozen=True, kw_only=True)
class TaskAtViaPoints:
    """The tool task at n via-points.

    Attributes
    ----------
    postures : Postures
    task : ToolTask
    points : (n, 3), m
        Tool points.
    """

    postures: Postures
    task: ToolTask
    points: FloatArray

    def null_spaces(self, q: FloatArray) -> FloatArray:
        """Orthonormal directions (n, a, d) of the self-motion at postures `q` (n, d)."""
        return null_space(self.postures, self.task, q)

    def slid(
        self, q: FloatArray, null: FloatArray, u: FloatArray, which: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Slide via-points by `u` (k, a), rad: ``task(q) = 0, N^T (q - q_start) = u``.

        Parameters
        ----------
        q : (n, d), rad
            Where all via-points start.
        null : (k, a, d)
            Directions N of those that slide.
        u : (k, a), rad
        which : (k,)
            Which of them slide.

        Returns
        -------
        q : (k, d), rad
        tangent : (k, a, d)
            Derivative of q by u.

        Raises
        ------
        OptimisationFailed
            When the tool task cannot be held there.
        """
        q, reached = project_onto_task(
            self.postures,
            self.task,
            q[which] + np.einsum("ka,kai->ki", u, null),
            self.points[which],
            steps=_NEWTON_STEPS,
            tolerance=_ON_TASK,
            held=null,
        )
        at = self.postures.tool_at(q)
        if not reached.all():
            error = self.task.errors(at.tool_point, at.tool_rotation, self.points[which])
            raise OptimisationFailed(
                "a via-point slid to where the tool task cannot be held",
                constraint="tool task at a via-point",
                violation=float(np.abs(error).max()),
            )
        A = np.concatenate([self.task.jacobian(at.tool_rotation, at.jacobian), null], axis=1)
        rhs = np.zeros((len(q), A.shape[1], u.shape[1]))
        rhs[:, A.shape[1] - u.shape[1] :] = np.eye(u.shape[1])
        return q, np.linalg.solve(A, rhs).transpose(0, 2, 1)
