"""The families of C3 splines in local unknowns: every derivative is sparse.

Unknowns x are steps from the spline that the family was built around, each about 1 when it goes as far as a
step sensibly may: multiples of the local basis splines, knot by knot and joint by joint, then, where
via-points slide, their slides along the self-motion.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import sparse

from cmbot.arrays import FloatArray, IntArray
from cmbot.planning.local_splines import LocalRows, LocalSplines
from cmbot.planning.slides import LONGEST_SLIDE, TaskAtViaPoints
from cmbot.planning.spline_space import SplineSpace

__all__ = ["LocalKnots"]

# Step of the central differences that tell how via-points leave the tangents, rad.
_DIFFERENCE = 1e-4


class LocalKnots:
    """Splines around given ones, through via-points that stay or slide.

    Parameters
    ----------
    splines : LocalSplines
    via_points : (n, d), rad
    numbers : (n - 4, d)
        Multiples of the basis splines.
    weight : float
        Of the smoothing term.
    task : TaskAtViaPoints, optional
        What sliding via-points keep; without it they stay.
    pinned, held : bool
        The first via-point stays anyway, or the last.
    directions : (k, a, d), optional
        In which the k via-points slide that may; those that are taken lie as near to them as they can.
    """

    def __init__(
        self,
        splines: LocalSplines,
        via_points: FloatArray,
        numbers: FloatArray,
        weight: float,
        *,
        task: TaskAtViaPoints | None = None,
        pinned: bool = False,
        held: bool = False,
        directions: FloatArray | None = None,
    ) -> None:
        self.splines = splines
        self.via_points = via_points
        self.weight = weight
        self._numbers = numbers
        self._task, self._pinned, self._held = task, pinned, held
        self.sliding = task is not None
        self._free = np.arange(1 if pinned else 0, len(via_points) - held if self.sliding else 0)
        if task is not None:
            self._null = task.null_spaces(via_points)[self._free]
            if directions is not None:
                self._null = _turned(self._null, directions)
        else:
            self._null = np.empty((0, 0, via_points.shape[1]))

    @property
    def slides(self) -> int:
        """Number of unknowns, the last ones, that slide via-points."""
        return int(self._null.shape[0] * self._null.shape[1])

    @property
    def dimension(self) -> int:
        """Number of unknowns."""
        return int(self._numbers.size) + self.slides

    @property
    def start(self) -> FloatArray:
        """Unknowns (dimension,) of the spline that the family was built around: no step."""
        return np.zeros(self.dimension)

    def via_points_at(self, x: FloatArray) -> FloatArray:
        """Via-points (n, d)."""
        return self._moved(x)[0]

    def numbers(self, x: FloatArray) -> FloatArray:
        """Multiples (n - 4, d) of the basis splines."""
        return self._moved(x)[1]

    def knots(self, x: FloatArray) -> FloatArray:
        """Knot vectors (3n, d)."""
        via_points, numbers = self._moved(x)
        return np.asarray(self.splines.columns @ np.vstack([numbers, via_points]))

    def _moved(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Via-points (n, d) and multiples (n - 4, d) of the basis splines.

        What bends via-points away from the tangents is taken up by splines of least jerk: between via-points
        near each other the arm then stays near the tool task too, and long steps remain possible.
        """
        if not x.any():
            return self.via_points, self._numbers
        size = self._numbers.size
        numbers = self._numbers + x[:size].reshape(self._numbers.shape) * self.splines.unit
        if self._task is None or not x[size:].any():
            return self.via_points, numbers
        u = LONGEST_SLIDE * x[size:].reshape(self._null.shape[:2])
        slid, _ = self._task.slid(self.via_points, self._null, u, self._free)
        tangential = self.via_points[self._free] + np.einsum("ka,kai->ki", u, self._null)
        q, bend = self.via_points.copy(), np.zeros_like(self.via_points)
        q[self._free], bend[self._free] = slid, slid - tangential
        return q, numbers + self.splines.least_jerk(bend)

    @property
    def space(self) -> SplineSpace:
        """Where the splines live."""
        return self.splines.space

    def rebuilt(self, x: FloatArray, weight: float) -> LocalKnots:
        """Build the family anew around `x`, with another weight of the smoothing term.

        Raises
        ------
        OptimisationFailed
            When a via-point cannot be put back onto the tool task.
        """
        via_points, numbers = self._moved(x)
        return LocalKnots(
            self.splines,
            via_points,
            numbers,
            weight,
            task=self._task,
            pinned=self._pinned,
            held=self._held,
            directions=self._null,
        )

    def stretch(self, first: int, last: int) -> LocalKnots:
        """Return the splines of least jerk between two via-points, at rest there; inner ones of them stay."""
        some = slice(first, last + 1)
        splines = LocalSplines(SplineSpace(self.space.t[some]), self.splines.limits)
        via_points = self.via_points[some]
        return LocalKnots(
            splines,
            via_points,
            splines.least_jerk(via_points),
            self.weight,
            task=None if self._task is None else replace(self._task, points=self._task.points[some]),
            pinned=self._pinned or (first > 0 and self.sliding),
            held=self._held or (last < len(self.via_points) - 1 and self.sliding),
        )

    def rows(self, times: FloatArray) -> LocalRows:
        """Splines at `times`, for `chain`."""
        return self.splines.rows(times)

    def stacked(self, jacobians: list[sparse.csr_array]) -> sparse.csr_array:
        """Put derivatives (., size of u) one below the other."""
        empty = sparse.csr_array((0, self.map.shape[0]))
        return sparse.csr_array(sparse.vstack([empty, *jacobians], format="csr"))

    def chain(
        self, x: FloatArray, rows: LocalRows, d_q: FloatArray, d_v: FloatArray, d_a: FloatArray
    ) -> sparse.csr_array:
        """Take derivatives (N, d) by the states to those (N, size of u) by u; `map` leads on."""
        del x
        weight = rows.weight[:, :, None]
        data = weight[0] * d_q[rows.row] + weight[1] * d_v[rows.row] + weight[2] * d_a[rows.row]
        joints = self.via_points.shape[1]
        column = joints * rows.column[:, None] + np.arange(joints)
        return self._sparse(data, np.broadcast_to(rows.row[:, None], column.shape), column, rows.size)

    def chain_one(
        self, x: FloatArray, rows: LocalRows, order: int, joint: IntArray, factor: FloatArray
    ) -> sparse.csr_array:
        """Derivatives (N, size of u) of ``factor`` times derivative `order` of one `joint` each."""
        del x
        column = self.via_points.shape[1] * rows.column + joint[rows.row]
        return self._sparse(rows.weight[order] * factor[rows.row], rows.row, column, rows.size)

    def states(self, rows: LocalRows) -> sparse.csr_array:
        """Derivatives (N 3d, size of u) of position, velocity and acceleration of all joints."""
        joints = self.via_points.shape[1]
        part = np.arange(3)[:, None, None]
        joint = np.arange(joints)
        row = (3 * rows.row[:, None] + part) * joints + joint
        column = np.broadcast_to(joints * rows.column[:, None] + joint, row.shape)
        data = np.broadcast_to(rows.weight[:3, :, None], row.shape)
        return self._sparse(data, row, column, 3 * joints * rows.size)

    def smoothing(self) -> tuple[float, FloatArray]:
        """Value of the smoothing term, and its gradient (size of u,) by u."""
        u = np.vstack([self._numbers, self.via_points])
        pull = (self.splines.gram @ u) * self._jerk_weights
        return 0.5 * float(np.sum(u * pull)), np.asarray(pull.ravel())

    @cached_property
    def smoothing_curvature(self) -> sparse.csr_array:
        """Hessian (dimension, dimension) of the smoothing term along the tangents."""
        G = sparse.kron(self.splines.gram, sparse.diags_array(self._jerk_weights), format="csr")
        return sparse.csr_array(self.map.T @ G @ self.map)

    def bend_curvature(self, gradient: FloatArray) -> sparse.csr_array:
        """Hessian (dimension, dimension) of a function with `gradient` by u, as far as it is due to bends.

        Via-points do not slide straight; a second-order model has to know how far they leave the tangents.
        """
        blocks = np.zeros((len(self._free), *2 * (self._null.shape[1],)))
        if self._task is not None and self.slides:
            g = gradient.reshape(-1, self.via_points.shape[1])
            count = self.splines.count
            by_bend = (g[count:] + self.splines.least_jerk_adjoint(g[:count]))[self._free]
            step = _DIFFERENCE * np.eye(self._null.shape[1])
            for along, u in enumerate(step):
                u = np.broadcast_to(u, self._null.shape[:2])
                ahead, behind = (
                    self._task.slid(self.via_points, self._null, side * u, self._free)[1] for side in (1, -1)
                )
                bend = (ahead - behind) / (2 * _DIFFERENCE)
                blocks[:, along] = LONGEST_SLIDE**2 * np.einsum("kai,ki->ka", bend, by_bend)
            blocks = 0.5 * (blocks + blocks.transpose(0, 2, 1))
        index = self._numbers.size + np.arange(self.slides).reshape(self._null.shape[:2])
        row = np.broadcast_to(index[:, :, None], blocks.shape)
        column = np.broadcast_to(index[:, None, :], blocks.shape)
        return sparse.csr_array(
            (blocks.ravel(), (row.ravel(), column.ravel())), shape=(self.dimension, self.dimension)
        )

    @cached_property
    def blocks(self) -> IntArray:
        """Numbers (dimension,) that order the unknowns along the path; what is coupled is 3 apart at most."""
        n, d = self.via_points.shape
        numbers = np.repeat(np.arange(n - 4), d)
        slides = np.repeat(np.clip(self._free - 2, 0, n - 5), self._null.shape[1])
        return np.concatenate([numbers, slides])

    @property
    def along(self) -> IntArray:
        """Unknowns (dimension,) in the order of the path."""
        return np.argsort(self.blocks, kind="stable")

    @cached_property
    def map(self) -> sparse.csr_array:
        """Derivatives (size of u, dimension) of u by the unknowns."""
        n, d = self.via_points.shape
        size = self._numbers.size
        own = np.arange(size)
        row = size + d * self._free[:, None, None] + np.arange(d)
        column = size + np.arange(self.slides).reshape(*self._null.shape[:2], 1)
        row, column = np.broadcast_to(row, self._null.shape), np.broadcast_to(column, self._null.shape)
        return sparse.csr_array(
            (
                np.concatenate([self.splines.unit.ravel(), LONGEST_SLIDE * self._null.ravel()]),
                (np.concatenate([own, row.ravel()]), np.concatenate([own, column.ravel()])),
            ),
            shape=(size + n * d, self.dimension),
        )

    @property
    def _jerk_weights(self) -> FloatArray:
        limits = self.splines.limits
        return np.asarray(self.weight / len(limits.jerk) / limits.jerk**2)

    def _sparse(self, data: FloatArray, row: IntArray, column: IntArray, rows: int) -> sparse.csr_array:
        size = self._numbers.size + self.via_points.size
        return sparse.csr_array((data.ravel(), (row.ravel(), column.ravel())), shape=(rows, size))


def _turned(null: FloatArray, directions: FloatArray) -> FloatArray:
    """Orthonormal bases (k, a, d) of the same spaces as `null`, as near as they can be to `directions`."""
    U, _, Vt = np.linalg.svd(directions @ null.transpose(0, 2, 1))
    return np.asarray(U @ Vt @ null)
