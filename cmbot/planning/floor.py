"""The floor: at one via-point no admissible posture has a smaller objective at rest.

Branch and bound over the self-motion: cells around the postures of a chart are halved wherever something
below the best admissible posture may lie. What may lie in a cell is told by differences of samples in it, so
the bound is an estimate, which gets sharp as the cells get small; it needs nothing of the objective but
values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.chart_nodes import ChartNodes
from cmbot.planning.dynamic_programming import blocked
from cmbot.planning.self_motion import null_spaces, project
from cmbot.planning.setting import Setting
from cmbot.robot import Postures

__all__ = ["Floor", "find_floor"]

# The floor is known well enough to this share of it; cells are halved at most so many times.
_ACCURACY, _MOST_HALVINGS = 2e-6, 24
# Via-points that are looked at together, and cells that are kept at most at each of them, the most promising
# first: where the self-motion is wide the error says what that cost.
_TOGETHER, _MOST_CELLS = 4, 400
# Halves are taken so much larger than they are, for the curvature of the self-motion.
_WIDER = 1.1
# Joint torques and clearances beyond what a cell can hold are told from samples with this much doubt.
_DOUBT = 1.5


@dataclass(frozen=True, kw_only=True)
class Floor:
    """What no admissible plan can go below.

    Attributes
    ----------
    value : float
        The largest, over the via-points, of the smallest value at rest of any admissible posture there.
    error : float
        The true value lies at most so far below it, by an estimate from samples, and as far as the charts are
        complete.
    via_point : int
        Index of the via-point that sets it.
    each : (n,)
        The smallest value found at every via-point; only those that may set the floor are looked at closely.
    """

    value: float
    error: float
    via_point: int
    each: FloatArray


def find_floor(setting: Setting, nodes: list[ChartNodes], spacing: float) -> Floor:
    """Find the floor from charts of the self-motion at all via-points.

    Parameters
    ----------
    setting : Setting
    nodes : list of ChartNodes
    spacing : float
        Of the charts, rad.

    Raises
    ------
    PathNotFound
        When no posture of a chart is admissible.
    """
    each = np.array([node.least() for node in nodes])
    for k, least in enumerate(each):
        if not np.isfinite(least):
            raise blocked(setting, nodes, k)
    search = _Search(setting, nodes, spacing)
    bound = np.full(len(each), -np.inf)
    order = np.argsort(-each)
    # From the largest down, until those looked at exceed all that are left: what is left only gets smaller.
    for first in range(0, len(order), _TOGETHER):
        some = order[first : first + _TOGETHER]
        if first and each[some[0]] <= each[order[:first]].max():
            break
        each[some], bound[some] = search.least(some, each[some])
    looked = np.flatnonzero(np.isfinite(bound))
    where = int(looked[each[looked].argmax()])
    return Floor(value=float(each[where]), error=float(each[where] - bound.max()), via_point=where, each=each)


@dataclass(frozen=True)
class _Cells:
    """Boxes on the self-motion: centre, directions of the edges, half their length, index of via-point."""

    q: FloatArray
    edges: FloatArray
    half: FloatArray
    of: IntArray

    def __getitem__(self, index: BoolArray | IntArray) -> _Cells:
        return _Cells(self.q[index], self.edges[index], self.half[index], self.of[index])


class _Search:
    """Branch and bound at several via-points at a time."""

    def __init__(self, setting: Setting, nodes: list[ChartNodes], spacing: float) -> None:
        self._setting = setting
        self._nodes = nodes
        self._spacing = spacing
        self._postures = Postures(setting.robot)
        self._points = setting.task.path.position(setting.times)

    def least(self, some: IntArray, best: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Smallest admissible values at the via-points `some`, and what they cannot go below.

        Parameters
        ----------
        some : (s,)
        best : (s,)
            Values that are known to be admissible there.
        """
        best = best.copy()
        left_out = np.full(len(some), np.inf)
        cells = self._first(some)
        for _ in range(_MOST_HALVINGS):
            lowest, possible, value = self._bounds(cells)
            worth = possible & (lowest < best[cells.of] * (1 - _ACCURACY))
            cells, lowest, value = cells[worth], lowest[worth], value[worth]
            best, possible = self._looked(cells, value, best)
            worth = possible & (lowest < best[cells.of] * (1 - _ACCURACY))
            keep = _most_promising(cells.of, np.where(worth, lowest, np.inf))
            dropped = worth & ~keep
            np.minimum.at(left_out, cells.of[dropped], lowest[dropped])
            cells, lowest = cells[keep], lowest[keep]
            if len(cells.q) == 0:
                break
            cells = self._halved(cells)
        else:
            np.minimum.at(left_out, cells.of, np.repeat(lowest, len(cells.q) // len(lowest)))
        return best, np.minimum(left_out, best * (1 - _ACCURACY))

    def _first(self, some: IntArray) -> _Cells:
        """Cells around the postures of the charts."""
        q = np.concatenate([self._nodes[k].chart.q for k in some])
        of = np.repeat(np.arange(len(some)), [len(self._nodes[k].chart.q) for k in some])
        self._point_of = self._points[some]
        return _Cells(q, self._tangents(q), np.full(len(q), self._spacing), of)

    def _tangents(self, q: FloatArray) -> FloatArray:
        task, at = self._setting.task, self._postures.at(q)
        return null_spaces(task.jacobians(at.tool_rotation, at.jacobian))

    def _bounds(self, cells: _Cells) -> tuple[FloatArray, BoolArray, FloatArray]:
        """What the objective may fall to in each cell, whether that may be admissible; its value."""
        N, d, n = cells.edges.shape
        limits = self._setting.robot.limits
        extent = np.abs(cells.edges).sum(axis=1) * cells.half[:, None]
        possible = ((cells.q + extent >= limits.lower) & (cells.q - extent <= limits.upper)).all(axis=1)
        shifts = 0.5 * cells.half[:, None, None] * cells.edges
        around = np.stack([cells.q[:, None] + shifts, cells.q[:, None] - shifts], axis=2).reshape(-1, n)
        points = np.repeat(self._point_of[cells.of], 2 * d, axis=0)
        placed, reached = project(self._postures, self._setting.task, around, points)
        value, use = self._measured(np.concatenate([cells.q, placed]))
        centre, centre_use = value[:N], use[:N]
        # Where a sample leaves the workspace, its cell counts as if it were as the centre there.
        beside = np.where(reached, value[N:], np.repeat(centre, 2 * d)).reshape(N, d, 2)
        beside_use = np.where(reached, use[N:], np.repeat(centre_use, 2 * d)).reshape(N, d, 2)
        slope = np.abs(beside[:, :, 0] - beside[:, :, 1]).sum(axis=1)
        bend = 4 * np.abs(beside.sum(axis=2) - 2 * centre[:, None])
        fall = slope + 0.5 * np.sqrt(bend).sum(axis=1) ** 2
        change = 2 * np.abs(beside_use - centre_use[:, None, None]).max(axis=2).sum(axis=1)
        possible &= centre_use - _DOUBT * change <= 1.0
        return centre - fall, possible, centre

    def _measured(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Objective at rest and largest share of a joint torque's bound, (N,) each."""
        at = self._postures.at(q)
        use = (np.abs(at.joint_torque) / self._setting.robot.limits.torque).max(axis=1)
        return self._setting.objective.at_rest(at), use

    def _looked(self, cells: _Cells, value: FloatArray, best: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Look at the clearances of cells: the best values then, and which cells may be clear somewhere."""
        setting = self._setting
        distance = setting.clearances.smallest(cells.q).distance
        margin, limits = setting.options.safety_margin_m, setting.robot.limits
        use = self._measured(cells.q)[1] if len(cells.q) else np.empty(0)
        within = ((cells.q >= limits.lower) & (cells.q <= limits.upper)).all(axis=1)
        admissible = within & (use <= 1.0) & (distance >= margin)
        best = best.copy()
        np.minimum.at(best, cells.of[admissible], value[admissible])
        reach = np.abs(cells.edges).sum(axis=1) @ setting.clearances.reach * cells.half
        return best, distance + reach >= margin

    def _halved(self, cells: _Cells) -> _Cells:
        """Divide every cell along each of its edges."""
        _, d, n = cells.edges.shape
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * d, indexing="ij"), axis=-1).reshape(-1, d)
        shifts = 0.5 * cells.half[:, None, None] * np.einsum("sd,kdn->ksn", signs, cells.edges)
        parts = len(signs)
        of = np.repeat(cells.of, parts)
        q, reached = project(
            self._postures,
            self._setting.task,
            (cells.q[:, None] + shifts).reshape(-1, n),
            self._point_of[of],
        )
        parent = np.repeat(cells.edges, parts, axis=0)
        null = self._tangents(q)
        # The parent's edges, turned the least way into the self-motion here.
        U, _, V = np.linalg.svd(parent @ null.transpose(0, 2, 1))
        made = _Cells(q, U @ V @ null, np.repeat(0.5 * _WIDER * cells.half, parts), of)
        return made[reached]


def _most_promising(of: IntArray, lowest: FloatArray) -> BoolArray:
    """Which cells have one of the smallest finite `lowest` values at their via-point."""
    keep = np.zeros(len(of), dtype=np.bool_)
    for k in np.unique(of):
        mine = np.flatnonzero((of == k) & np.isfinite(lowest))
        keep[mine[np.argsort(lowest[mine])[:_MOST_CELLS]]] = True
    return keep
