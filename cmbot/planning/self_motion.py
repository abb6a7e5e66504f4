"""Charts of self-motion: the postures that hold the tool task at one point of the path.

A chart is grown by numerical continuation along the null space of the task, all postures at a time, from the
postures it is given and from random ones, so that it reaches every branch (shoulder, elbow and wrist flips).
It grows through postures beyond the joint ranges too: what the ranges cut into pieces hangs together there.
Any two of its postures keep a distance, and every posture of the self-motion has one within its spacing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from cmbot.arrays import BoolArray, FloatArray
from cmbot.planning.task import ToolTask
from cmbot.robot import JointLimits, Postures

__all__ = ["Chart", "ChartMaker", "project"]

_ON_TASK = 1e-10
# Newton steps onto the task: of neighbours, and of random postures.
_FEW_STEPS, _MANY_STEPS = 6, 40
# Random postures far from the task take steps of at most this length a joint, rad.
_LONGEST_STEP = 0.6
# Accepted postures keep this share of the spacing from each other.
_APART = 0.7
# A chart has at most so many postures: where the self-motion has two dimensions or more, its spacing grows.
_MOST_POSTURES, _COARSER = 600, 1.6
# A continuous joint is charted within one turn either way, rad.
_ONE_TURN = 2 * np.pi


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Postures that hold the tool task at one point.

    Attributes
    ----------
    q : (M, n), rad
    torque : (M,), Nm
        Norm of the static torque on the guardrail.
    joint_use : (M,)
        Largest static joint torque as a share of its bound.
    within : (M,)
        Which postures lie within the joint ranges; the others only hold the chart together.
    """

    q: FloatArray
    torque: FloatArray
    joint_use: FloatArray
    within: BoolArray


def project(
    postures: Postures, task: ToolTask, q: FloatArray, point: FloatArray, steps: int = _FEW_STEPS
) -> tuple[FloatArray, BoolArray]:
    """Move postures `q` (N, n) the least way onto the task at `point` (3,).

    Returns
    -------
    q : (N, n), rad
    reached : (N,)
        Which of them lie on the task now.
    """
    q = q.copy()
    reached = np.zeros(len(q), dtype=np.bool_)
    active = np.arange(len(q))
    for _ in range(steps):
        at = postures.at(q[active])
        error = task.errors(at.tool_point, at.tool_rotation, point)
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


class ChartMaker:
    """Makes charts along one tool path.

    Parameters
    ----------
    postures : Postures
    task : ToolTask
    limits : JointLimits
    spacing : float
        Length of the steps of continuation, rad; the attribute of that name says what it has become.
    seeds : int
        Random postures from which the first chart is grown; later ones get a tenth of them.
    """

    def __init__(
        self, postures: Postures, task: ToolTask, limits: JointLimits, *, spacing: float, seeds: int
    ) -> None:
        self._postures = postures
        self._task = task
        self._limits = limits
        # A joint that cannot pass half a turn is charted on the circle, others within their ranges.
        self._round = (limits.lower >= -np.pi) & (limits.upper <= np.pi)
        self._lower = np.where(self._round, -np.pi, np.maximum(limits.lower, -_ONE_TURN))
        self._upper = np.where(self._round, np.pi, np.minimum(limits.upper, _ONE_TURN))
        self._circle = np.where(self._round, 2 * np.pi, 0.0)
        self.spacing = spacing
        self._seeds = seeds

    def first(self, point: FloatArray, known: FloatArray) -> Chart:
        """Chart the self-motion at `point` (3,) from the postures `known` (k, n) and from random ones."""
        rng = np.random.default_rng(0)
        random = rng.uniform(self._lower, self._upper, (self._seeds, len(self._lower)))
        placed, reached = project(self._postures, self._task, random, point, _MANY_STEPS)
        seeds = np.vstack([known, placed[reached]])
        q = self._grown(seeds, point)
        while len(q) > _MOST_POSTURES:
            self.spacing *= _COARSER
            q = self._grown(seeds, point)
        return self._chart(q)

    def next(self, chart: Chart, point: FloatArray) -> Chart:
        """Chart the self-motion at a `point` (3,) near that of `chart`."""
        placed, reached = project(self._postures, self._task, chart.q, point)
        return self._chart(self._grown(placed[reached], point))

    def _chart(self, q: FloatArray) -> Chart:
        at = self._postures.at(q)
        return Chart(
            q=q,
            torque=np.asarray(np.linalg.norm(at.guardrail_torque, axis=1)),
            joint_use=(np.abs(at.joint_torque) / self._limits.torque).max(axis=1),
            within=np.all((q >= self._limits.lower) & (q <= self._limits.upper), axis=1),
        )

    def _grown(self, seeds: FloatArray, point: FloatArray) -> FloatArray:
        """Grow a chart from postures on the task until it has nowhere to grow."""
        accepted = np.empty((0, len(self._lower)))
        frontier = self._new(accepted, seeds)
        while len(frontier) and len(accepted) <= _MOST_POSTURES:
            accepted = np.vstack([accepted, frontier])
            steps = self.spacing * self._tangents(frontier)
            neighbours = np.concatenate([frontier[:, None] + steps, frontier[:, None] - steps])
            placed, reached = project(
                self._postures, self._task, neighbours.reshape(-1, frontier.shape[1]), point
            )
            frontier = self._new(accepted, placed[reached])
        return accepted

    def _new(self, accepted: FloatArray, q: FloatArray) -> FloatArray:
        """Those of `q` that are apart from `accepted` and from each other."""
        q = np.where(self._round, (q + np.pi) % (2 * np.pi) - np.pi, q)
        q = q[((q >= self._lower) & (q <= self._upper)).all(axis=1)]
        apart = _APART * self.spacing
        if len(accepted) and len(q):
            q = q[self._tree(accepted).query(self._on_circle(q), distance_upper_bound=apart)[0] >= apart]
        if len(q) < 2:
            return q
        keep = np.ones(len(q), dtype=np.bool_)
        for first, second in sorted(self._tree(q).query_pairs(apart)):
            if keep[first]:
                keep[second] = False
        return q[keep]

    def _tree(self, q: FloatArray) -> cKDTree:
        """Tree of postures in which angles beyond half a turn are near those on the other side."""
        return cKDTree(self._on_circle(q), boxsize=self._circle)

    def _on_circle(self, q: FloatArray) -> FloatArray:
        # The tree wants angles from 0 to below a whole turn; a tiny negative one would round up to it.
        turned = np.where(self._round, q % (2 * np.pi), q)
        return np.where(self._round & (turned >= 2 * np.pi), 0.0, turned)

    def _tangents(self, q: FloatArray) -> FloatArray:
        """Orthonormal directions (N, d, n) that leave the task alone."""
        at = self._postures.at(q)
        J = self._task.jacobians(at.tool_rotation, at.jacobian)
        return np.linalg.svd(J)[2][:, J.shape[1] :]
