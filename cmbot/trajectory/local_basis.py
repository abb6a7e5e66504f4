"""C3 splines through movable via-points in a basis of local support: what makes sparse optimisation possible.

The knot vectors of `SplineSpace` are ``z = K u``, where u holds, for each joint, n - 4 multiples of the
basis splines, which vanish at every knot, and the n via-points. Each via-point has a spline of its own that
is 1 there, 0 at every other knot, and lives on four segments too. Every u gives a C3 spline at rest at both
ends, and every such spline has one u.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from cmbot.common.arrays import Batch, FloatArray, IntArray
from cmbot.trajectory.quintic import QuinticTrajectory
from cmbot.trajectory.spline_space import SplineSpace

_DERIVATIVE_COUNT = 4
# A unit of a basis spline moves a joint by no more than this, rad.
_MAX_UNIT_MOVE = 0.02


@dataclass(frozen=True, eq=False)
class LocalRows(Batch):
    """Local splines and their first three derivatives at N times, as far as they live there.

    Attributes
    ----------
    segment : (N,)
        Of each time; what lives on it is in `SparseSplines.support`.
    weight : (N, 4, w)
        Position, velocity, acceleration and jerk of the splines that live there.
    """

    segment: IntArray
    weight: FloatArray

    def by_spline(self, derivative: FloatArray) -> FloatArray:
        """Take derivatives (k, N, d) by position and the next orders to those (N, w, d) by the splines."""
        weight = self.weight[:, : len(derivative)]
        return np.asarray(weight.transpose(0, 2, 1) @ derivative.transpose(1, 0, 2))


class SparseSplines:
    """The local basis of a `SplineSpace`.

    Parameters
    ----------
    space : SplineSpace
    bounds : (3, d)
        Magnitudes that velocity, acceleration and jerk of each joint may have: their units.
    """

    def __init__(self, space: SplineSpace, bounds: FloatArray) -> None:
        self.space = space
        self.bounds = bounds
        self.columns = sparse.csr_array(sparse.hstack([space.basis, space.cardinal]))
        self.gram = space.jerk_products(self.columns)

    @property
    def count(self) -> int:
        """Number of basis splines a joint: n - 4."""
        return self.space.dimension

    @cached_property
    def unit(self) -> FloatArray:
        """Multiples (n - 4, d) at which a basis spline uses up a bound, or goes far from the via-points."""
        t = self.space.t
        largest = np.zeros((_DERIVATIVE_COUNT, self.count))
        for share in np.linspace(0.0, 1.0, 5):
            rows = self.rows(t[:-1] + share * np.diff(t))
            column = self.support[rows.segment]
            inside = (column >= 0) & (column < self.count)
            for order in range(_DERIVATIVE_COUNT):
                np.maximum.at(largest[order], column[inside], np.abs(rows.weight[:, order][inside]))
        bounds = np.vstack([np.full(self.bounds.shape[1], _MAX_UNIT_MOVE), self.bounds])
        return np.asarray((bounds[:, None, :] / largest[:, :, None]).min(axis=0))

    @cached_property
    def smoothing_curvature(self) -> sparse.csr_array:
        """Hessian (size of u, size of u) of half the time mean of squared jerk and velocity, in their bounds.

        The velocity keeps joints from travelling where nothing else counts.
        """
        speed, _, jerk = self.bounds
        parts = (self.space.speed_products(self.columns), speed), (self.gram, jerk)
        each = (sparse.kron(gram, sparse.diags_array(1.0 / (len(x) * x**2))) for gram, x in parts)
        return sparse.csr_array(sum(each))

    def least_jerk(self, q: FloatArray) -> FloatArray:
        """Multiples (n - 4, d) of the basis splines in the splines of least jerk through `q` (n, d)."""
        return np.asarray(self._basis_gram.solve(-(self.gram[: self.count, self.count :] @ q)))

    def coefficients(self, trajectory: QuinticTrajectory) -> FloatArray:
        """Multiples (n - 4, d) of the basis splines in a C3 spline of this space.

        Of another quintic spline with these knots, those of the one whose jerk is nearest to its own.
        """
        z = np.stack([trajectory.q, trajectory.v, trajectory.a], axis=1).reshape(-1, trajectory.q.shape[1])
        own = self.space.jerk_projection(z)
        return np.asarray(self._basis_gram.solve(own - self.gram[: self.count, self.count :] @ trajectory.q))

    def least_jerk_adjoint(self, g: FloatArray) -> FloatArray:
        """Gradient (n, d) by the via-points from that (n - 4, d) by the multiples that follow them."""
        return np.asarray(-(self.gram[self.count :, : self.count] @ self._basis_gram.solve(g)))

    @cached_property
    def _basis_gram(self) -> SuperLU:
        return splu(self.gram[: self.count, : self.count].tocsc())

    def rows(self, times: FloatArray) -> LocalRows:
        """Evaluate at `times` (N,)."""
        segment, hermite = self.space.hermite_weights(times, _DERIVATIVE_COUNT)
        return LocalRows(segment, hermite.transpose(1, 0, 2) @ self._segments[1][segment])

    def jacobian(self, rows: LocalRows, derivative: FloatArray) -> sparse.csr_array:
        """Take derivatives (k, N, d) by the states to those (N, size of u) by u."""
        by_spline = rows.by_spline(derivative)
        N, w, d = by_spline.shape
        data, column = by_spline.reshape(N, w * d), self._columns[rows.segment]
        there = (column >= 0) & (data != 0.0)
        ends = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
        return sparse.csr_array((data[there], column[there], ends), shape=(N, d * self.columns.shape[1]))

    def hessian(self, rows: LocalRows, curvature: FloatArray) -> sparse.csr_array:
        """Sum the curvatures (N, 3 d, 3 d) of N functions by the states, as functions of u."""
        N, d = len(rows.segment), self.bounds.shape[1]
        weight, M = rows.weight[:, :3], curvature.reshape(N, 3, d, 3, d)
        half = np.einsum("now,nodpe->nwdpe", weight, M, optimize=True)
        data = np.einsum("nwdpe,npv->nwdve", half, weight, optimize=True)
        column = self._columns[rows.segment]
        row, column = np.broadcast_arrays(column[:, :, None], column[:, None, :])
        there = (row >= 0) & (column >= 0)
        entries = (data.reshape(row.shape)[there], (row[there], column[there]))
        return sparse.csr_array(entries, shape=2 * (d * self.columns.shape[1],))

    @cached_property
    def _columns(self) -> IntArray:
        """Entries of u that move the joints on each segment, (m, w d); negative where there is none."""
        d = self.bounds.shape[1]
        columns = np.where(self.support[:, :, None] < 0, -1, d * self.support[:, :, None] + np.arange(d))
        return np.asarray(columns.reshape(len(columns), -1))

    @property
    def support(self) -> IntArray:
        """Which splines, the basis first, then those of the via-points, are not zero on each segment: (m, w).

        In ascending order; -1 fills up where there are fewer than w.
        """
        return self._segments[0]

    @cached_property
    def _segments(self) -> tuple[IntArray, FloatArray]:
        """What lives on each segment, (m, w), and its values at the knots of both ends, (m, 6, w)."""
        m = len(self.space.t) - 1
        entries = self.columns.tocoo()
        knot, part = np.divmod(entries.coords[0], 3)
        # An entry belongs to the segments on both sides of its knot.
        segment = np.concatenate([knot, knot - 1])
        place = np.concatenate([part, part + 3])
        column, value = np.tile(entries.coords[1], 2), np.tile(entries.data, 2)
        inside = (segment >= 0) & (segment < m)
        segment, place, column, value = (x[inside] for x in (segment, place, column, value))
        keys, index = np.unique(segment * self.columns.shape[1] + column, return_inverse=True)
        of_segment, of_column = np.divmod(keys, self.columns.shape[1])
        slot = np.arange(len(keys)) - np.searchsorted(of_segment, of_segment)
        width = int(slot.max()) + 1
        columns = np.full((m, width), -1, dtype=np.intp)
        local = np.zeros((m, 6, width))
        columns[of_segment, slot] = of_column
        local[segment, place, slot[index]] = value
        return columns, local
