"""Charts of self-motion: the postures that hold the tool task at one point of the path.

A chart is grown by numerical continuation along the null space of the task, all postures at a time, from the
postures it is given and from random ones, so that it reaches every branch (shoulder, elbow and wrist flips).
It grows through postures beyond the joint ranges too: what the ranges cut into pieces hangs together there.
Any two of its postures keep a distance, and every posture of the self-motion has one within its spacing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from cmbot.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.objectives import Objective
from cmbot.planning.task import ToolTask
from cmbot.robot import JointLimits, Postures

__all__ = ["Chart", "ChartMaker", "null_spaces", "project", "without_neighbours"]

_ON_TASK = 1e-10
# Newton steps onto the task: of neighbours, and of random postures.
_FEW_STEPS, _MANY_STEPS = 6, 40
# Random postures far from the task take steps of at most this length a joint, rad.
_LONGEST_STEP = 0.6
# Accepted postures keep this share of the spacing from each other.
_APART = 0.7
# A chart has at most so many postures: where the self-motion has two dimensions or more, its spacing grows.
_MOST_POSTURES, _COARSER = 600, 1.6
# Charts are carried to every so-manieth point first.
_STRIDE = 6
# A continuous joint is charted within one turn either way, rad.
_ONE_TURN = 2 * np.pi


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Postures that hold the tool task at one point.

    Attributes
    ----------
    q : (M, n), rad
    value : (M,)
        The objective at rest.
    joint_use : (M,)
        Largest static joint torque as a share of its bound.
    within : (M,)
        Which postures lie within the joint ranges; the others only hold the chart together.
    """

    q: FloatArray
    value: FloatArray
    joint_use: FloatArray
    within: BoolArray


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


class ChartMaker:
    """Makes charts along one tool path.

    Parameters
    ----------
    postures : Postures
    task : ToolTask
    limits : JointLimits
    objective : Objective
    spacing : float
        Length of the steps of continuation, rad; the attribute of that name says what it has become.
    seeds : int
        Random postures from which the first chart is grown.
    """

    def __init__(
        self,
        postures: Postures,
        task: ToolTask,
        limits: JointLimits,
        objective: Objective,
        *,
        spacing: float,
        seeds: int,
    ) -> None:
        self._postures = postures
        self._task = task
        self._limits = limits
        self._objective = objective
        # A joint that cannot pass half a turn is charted on the circle, others within their ranges.
        self._round = (limits.lower >= -np.pi) & (limits.upper <= np.pi)
        self._lower = np.where(self._round, -np.pi, np.maximum(limits.lower, -_ONE_TURN))
        self._upper = np.where(self._round, np.pi, np.minimum(limits.upper, _ONE_TURN))
        self._circle = np.append(np.where(self._round, 2 * np.pi, 0.0), 0.0)
        self.spacing = spacing
        self._seeds = seeds

    def first(self, point: FloatArray, known: FloatArray) -> Chart:
        """Chart the self-motion at `point` (3,) from the postures `known` (k, n) and from random ones."""
        rng = np.random.default_rng(0)
        random = rng.uniform(self._lower, self._upper, (self._seeds, len(self._lower)))
        placed, reached = project(self._postures, self._task, random, point, _MANY_STEPS)
        seeds = np.vstack([known, placed[reached]])
        some = _Postures.of_each([seeds])
        q = self._grown([some], point[None])[0]
        while len(q) > _MOST_POSTURES:
            self.spacing *= _COARSER
            q = self._grown([some], point[None])[0]
        return self._charts([q])[0]

    def along(self, points: FloatArray, known: FloatArray) -> list[Chart]:
        """Chart the self-motion at every one of `points` (k, 3), each near the one before.

        Parameters
        ----------
        points : (k, 3), m
        known : (s, n), rad
            Postures at the first of them.
        """
        charts: dict[int, FloatArray] = {0: self.first(points[0], known).q}
        last = len(points) - 1
        # To every so-manieth point one after the other, then to those between from both sides at once.
        stations = [*range(0, last, _STRIDE), last]
        for before, here in pairwise(stations):
            charts[here] = self._carried([here], [[charts[before]]], points)[0]
        between = [k for k in range(last) if k not in charts]
        sides = [[charts[side] for side in _sides(k, last)] for k in between]
        charts.update(zip(between, self._carried(between, sides, points), strict=True))
        return self._charts([charts[k] for k in range(len(points))])

    def _carried(
        self, to: Sequence[int], known: Sequence[Sequence[FloatArray]], points: FloatArray
    ) -> list[FloatArray]:
        """Grow charts at the points numbered `to` from postures at others."""
        if not to:
            return []
        here = points[list(to)]
        seeds = []
        for charts in zip(*known, strict=True):
            some = _Postures.of_each(charts)
            placed, reached = project(self._postures, self._task, some.q, here[some.of])
            seeds.append(_Postures(placed, some.of)[reached])
        return self._grown(seeds, here)

    def _charts(self, each: Sequence[FloatArray]) -> list[Chart]:
        q = np.vstack(each)
        at = self._postures.at(q)
        value = self._objective.at_rest(at)
        use = (np.abs(at.joint_torque) / self._limits.torque).max(axis=1)
        within = np.all((q >= self._limits.lower) & (q <= self._limits.upper), axis=1)
        ends = np.cumsum([0, *(len(part) for part in each)])
        return [
            Chart(q=q[a:b], value=value[a:b], joint_use=use[a:b], within=within[a:b])
            for a, b in pairwise(ends)
        ]

    def _grown(self, seeds: Sequence[_Postures], points: FloatArray) -> list[FloatArray]:
        """Grow charts at `points` (k, 3) from postures on the task until they have nowhere to grow."""
        accepted = _Postures.of_each([np.empty((0, len(self._lower)))])
        for some in seeds:
            tree = self._tree(accepted)
            accepted = accepted.and_those(self._apart(tree, some.q, some.of))
        frontier = accepted
        while len(frontier.q):
            tree = self._tree(accepted)
            growing = np.bincount(accepted.of, minlength=len(points)) <= _MOST_POSTURES
            frontier = frontier[growing[frontier.of]]
            steps = self.spacing * self._tangents(frontier.q)
            ahead = np.concatenate([frontier.q[:, None] + steps, frontier.q[:, None] - steps], axis=1)
            of = np.repeat(frontier.of, ahead.shape[1])
            q = ahead.reshape(-1, frontier.q.shape[1])
            # Where there is a posture already nothing has to be placed.
            new = self._far(tree, q, of)
            placed, reached = project(self._postures, self._task, q[new], points[of[new]])
            frontier = self._apart(tree, placed[reached], of[new][reached])
            accepted = accepted.and_those(frontier)
        order = np.argsort(accepted.of, kind="stable")
        ends = np.searchsorted(accepted.of[order], np.arange(len(points) + 1))
        return [accepted.q[order[a:b]] for a, b in pairwise(ends)]

    def _apart(self, tree: cKDTree, q: FloatArray, of: IntArray) -> _Postures:
        """Those of `q` that are apart from those in a tree and from each other."""
        q = np.where(self._round, (q + np.pi) % (2 * np.pi) - np.pi, q)
        inside = ((q >= self._lower) & (q <= self._upper)).all(axis=1)
        some = _Postures(q[inside], of[inside])
        some = some[self._far(tree, some.q, some.of)]
        if len(some.q) < 2:
            return some
        pairs = self._tree(some).query_pairs(_APART * self.spacing, output_type="ndarray")
        return some[without_neighbours(len(some.q), pairs)]

    def _far(self, tree: cKDTree, q: FloatArray, of: IntArray) -> BoolArray:
        """Which of `q` are apart from those in a tree."""
        apart = _APART * self.spacing
        return np.asarray(tree.query(self._on_circle(q, of), distance_upper_bound=apart)[0] >= apart)

    def _tree(self, some: _Postures) -> cKDTree:
        """Tree of postures in which angles beyond half a turn are near those on the other side."""
        return cKDTree(self._on_circle(some.q, some.of), boxsize=self._circle)

    def _on_circle(self, q: FloatArray, of: IntArray) -> FloatArray:
        # The tree wants angles from 0 to below a whole turn; a tiny negative one would round up to it. Charts
        # of different points are far from each other.
        turned = np.where(self._round, q % (2 * np.pi), q)
        turned = np.where(self._round & (turned >= 2 * np.pi), 0.0, turned)
        return np.column_stack([turned, 2.0 * self.spacing * of])

    def _tangents(self, q: FloatArray) -> FloatArray:
        """Orthonormal directions (N, d, n) that leave the task alone."""
        at = self._postures.at(q)
        return null_spaces(self._task.jacobians(at.tool_rotation, at.jacobian))


def _sides(k: int, last: int) -> list[int]:
    """The stations on both sides of via-point `k`, the nearer one first."""
    before = k - k % _STRIDE
    return sorted((before, min(before + _STRIDE, last)), key=lambda station: abs(station - k))


def without_neighbours(number: int, pairs: IntArray) -> BoolArray:
    """Which of so many things remain when each removes its later neighbours, the first one first."""
    keep, open_ = np.ones(number, dtype=np.bool_), np.ones(number, dtype=np.bool_)
    while len(pairs):
        # What has no earlier neighbour left stays, and those beside it go.
        waiting = np.zeros(number, dtype=np.bool_)
        waiting[pairs[:, 1]] = True
        settled = open_ & ~waiting
        keep[pairs[settled[pairs[:, 0]], 1]] = False
        open_ = keep & waiting
        pairs = pairs[open_[pairs].all(axis=1)]
    return keep


@dataclass(frozen=True)
class _Postures:
    """Postures (N, n), and to which of several charts each belongs (N,)."""

    q: FloatArray
    of: IntArray

    @staticmethod
    def of_each(charts: Sequence[FloatArray]) -> _Postures:
        """Put together the postures of charts."""
        return _Postures(np.vstack(charts), np.repeat(np.arange(len(charts)), [len(q) for q in charts]))

    def and_those(self, others: _Postures) -> _Postures:
        return _Postures(np.vstack([self.q, others.q]), np.append(self.of, others.of))

    def __getitem__(self, index: BoolArray) -> _Postures:
        return _Postures(self.q[index], self.of[index])
