"""All quintic splines through given via-points that are C3 and start and end at rest.

A joint's spline is the vector z of its knots' position, velocity and acceleration,
``z = (q_1, v_1, a_1, ..., q_n, v_n, a_n)``. Those that are C3 and at rest at both ends form an affine space
of n - 4 dimensions: 2 (n - 2) knot velocities and accelerations (the paper's variables, Chang 2021,
Eq. (30)) less n jerk conditions, Eqs. (34) and (37). `SplineSpace` holds a basis of it, so that no equality
is left for a solver::

    z = P q + B x          P q is the least-jerk spline through the via-points q

Each column of B is a spline that vanishes at every knot and lives on four neighbouring segments.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import splu

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.trajectory.polynomials import derivative
from cmbot.trajectory.quintic import QuinticTrajectory, hermite_coefficients

SUPPORT = 4
"""A basis spline lives on this many segments: the fewest on which a C3 quintic spline that vanishes at the
knots between them, and joins zero with C3 on both sides, exists; it is then unique up to its scale.
"""


@dataclass(frozen=True, eq=False)
class SplineSpace:
    """C3 quintic splines on fixed knot times, at rest at both ends (Chang 2021, Eqs. (34)-(37)).

    Attributes
    ----------
    t : (n,), s
        Knot times, n >= 5.

    Raises
    ------
    InputError
        When there are fewer than five knots or times do not increase.
    """

    t: FloatArray

    def __post_init__(self) -> None:
        if self.t.ndim != 1 or len(self.t) <= SUPPORT or not np.all(np.diff(self.t) > 0):
            raise InputError(
                "SplineSpace", "t", f"shape {self.t.shape}", f"{SUPPORT + 1} or more increasing times"
            )

    @property
    def dimension(self) -> int:
        """Free numbers a joint: n - 4."""
        return len(self.t) - SUPPORT

    @cached_property
    def basis(self) -> sparse.csr_array:
        """B: the basis splines' knot vectors, (3n, n - 4), banded, largest entry of each column 1.

        Entries of velocity rows are in 1/s, of acceleration rows in 1/s2, up to a common factor a column.
        """
        free, conditions, _, unit = self._windows
        largest = np.abs(conditions).max(axis=(1, 2), keepdims=True)
        y = np.linalg.svd(conditions / largest)[2][:, -1] / unit
        y /= np.take_along_axis(y, np.abs(y).argmax(axis=1)[:, None], axis=1)
        where = np.broadcast_to(np.arange(self.dimension)[:, None], free.shape)
        shape = (3 * len(self.t), self.dimension)
        return sparse.csr_array((y.ravel(), (free.ravel(), where.ravel())), shape=shape)

    @cached_property
    def cardinal(self) -> sparse.csr_array:
        """Knot vectors (3n, n) of splines that are 1 at one knot, 0 at the others, on four segments each."""
        free, conditions, jumps, unit = self._windows
        knots = np.arange(len(self.t))
        window = np.clip(knots - SUPPORT // 2, 0, self.dimension - 1)
        rhs = -np.take_along_axis(jumps[window], (knots - window)[:, None, None], axis=2)
        inverse = np.linalg.pinv(conditions[window])
        y = inverse @ rhs
        # What it leaves of jumps would be far beyond the last digits of positions.
        y = (y + inverse @ (rhs - conditions[window] @ y))[..., 0] / unit[window]
        where = np.broadcast_to(knots[:, None], y.shape)
        values = np.concatenate([y.ravel(), np.ones(len(knots))])
        rows = np.concatenate([free[window].ravel(), 3 * knots])
        columns = np.concatenate([where.ravel(), knots])
        return sparse.csr_array((values, (rows, columns)), shape=(3 * len(self.t), len(knots)))

    @cached_property
    def jerk_gram(self) -> sparse.csr_array:
        """Gram matrix of the basis under the time mean of the product of jerks, (n - 4, n - 4), banded."""
        return self.jerk_products(self.basis)

    def jerk_products(self, columns: sparse.csr_array) -> sparse.csr_array:
        """Time means of the products of the jerks of all pairs of sparse knot vectors `columns` (3n, a)."""
        return sparse.csr_array(columns.T @ self._jerk_energy @ columns)

    def jerk_projection(self, z: FloatArray) -> FloatArray:
        """Time means (n - 4, d) of the products of the basis splines' jerks with those of `z` (3n, d)."""
        return np.asarray(self.basis.T @ (self._jerk_energy @ z))

    def least_jerk(self, q: FloatArray) -> FloatArray:
        """Knot vectors P q of the splines through `q` with the least mean squared jerk.

        Parameters
        ----------
        q : (n, d), rad
            Via-points of d joints.

        Returns
        -------
        (3n, d)
        """
        pull = self.basis.T @ (self._jerk_energy @ (self.cardinal @ q))
        return np.asarray(self.cardinal @ q - self.basis @ splu(self.jerk_gram.tocsc()).solve(pull))

    def trajectory(self, z: FloatArray) -> QuinticTrajectory:
        """Return the trajectory with knot vectors `z` (3n, d)."""
        return QuinticTrajectory(t=self.t, q=z[0::3], v=z[1::3], a=z[2::3])

    def design(self, times: ArrayLike, order: int) -> sparse.csr_array:
        """Matrix (N, 3n) that takes knot vectors to derivative `order` at `times` (N,)."""
        segment, weights = self.hermite_weights(np.asarray(times, dtype=float), order + 1)
        columns = 3 * segment[:, None] + np.arange(6)
        return sparse.csr_array(
            (weights[order].ravel(), (np.repeat(np.arange(len(segment)), 6), columns.ravel())),
            shape=(len(segment), 3 * len(self.t)),
        )

    def hermite_weights(self, times: FloatArray, orders: int) -> tuple[IntArray, FloatArray]:
        """Segments (N,) of `times` (N,), and weights (orders, N, 6) of the knot values at their two ends."""
        segment = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 2)
        h = np.diff(self.t)[segment]
        u = (times - self.t[segment]) / h
        weights = np.empty((orders, len(times), 6))
        for order in range(orders):
            c = derivative(self._hermite, order)[segment]
            powers = u[:, None] ** np.arange(c.shape[-1])
            weights[order] = np.einsum("smk,sk->sm", c, powers) / h[:, None] ** order
        return segment, weights

    @cached_property
    def _hermite(self) -> FloatArray:
        """Coefficients of the six Hermite quintics of each segment, (m, 6, 6): function, power."""
        m = len(self.t) - 1
        ends = np.broadcast_to(np.eye(6), (m, 6, 6))
        start, end = ends[:, :3].transpose(1, 0, 2), ends[:, 3:].transpose(1, 0, 2)
        return hermite_coefficients(np.diff(self.t), tuple(start), tuple(end))

    @cached_property
    def unit(self) -> FloatArray:
        """Factors (3n,) that bring position, velocity and acceleration to one size: 1, T/m, (T/m)^2."""
        step = (self.t[-1] - self.t[0]) / (len(self.t) - 1)
        return np.tile([1.0, step, step**2], len(self.t))

    @cached_property
    def _windows(self) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """For each four neighbouring segments: what is free of the knots inside, and what keeps them C3.

        Indices (n - 4, 6) in a knot vector; the jerks' jumps by those, unit-free, (n - 4, 5, 6); the same by
        the positions of the five knots, (n - 4, 5, 5); and the units (n - 4, 6) of the first.
        """
        first = np.arange(self.dimension)[:, None]
        free = np.stack([_velocity_and_acceleration(k + np.arange(1, SUPPORT)) for k in first])
        knots = first + np.arange(SUPPORT + 1)
        scaled = (self._jerk_jumps @ sparse.diags_array(1 / self.unit)).tocsr()

        def blocks(columns: IntArray) -> FloatArray:
            rows, columns = np.broadcast_arrays(knots[:, :, None], columns[:, None, :])
            return np.asarray(scaled[rows.ravel(), columns.ravel()]).reshape(rows.shape)

        # Their steps beside the mean of all, as powers of two: in units of the mean short ones lose digits.
        finer = (self.t[SUPPORT:] - self.t[:-SUPPORT]) / SUPPORT / self.unit[1]
        finer = np.exp2(np.round(np.log2(finer)))[:, None] ** np.tile([1, 2], SUPPORT - 1)
        return free, blocks(free) / finer[:, None], blocks(3 * knots), self.unit[free] * finer

    @cached_property
    def _jerk_jumps(self) -> sparse.csr_array:
        """Matrix (n, 3n): jerk after less jerk before each knot; zero is taken to lie outside the ends."""
        n, h = len(self.t), np.diff(self.t)
        c = derivative(self._hermite, 3) / h[:, None, None] ** 3
        segment = np.arange(n - 1)
        columns = (3 * segment[:, None] + np.arange(6)).ravel()
        after = (c[..., 0].ravel(), (np.repeat(segment, 6), columns))
        before = (-c.sum(axis=-1).ravel(), (np.repeat(segment + 1, 6), columns))
        shape = (n, 3 * n)
        return sparse.csr_array(sparse.csr_array(after, shape=shape) + sparse.csr_array(before, shape=shape))

    @cached_property
    def _jerk_energy(self) -> sparse.csr_array:
        return self._energy(3)

    def speed_products(self, columns: sparse.csr_array) -> sparse.csr_array:
        """Time means of the products of the velocities of all pairs of knot vectors `columns` (3n, a)."""
        return sparse.csr_array(columns.T @ self._energy(1) @ columns)

    def _energy(self, order: int) -> sparse.csr_array:
        """Matrix (3n, 3n) of the time mean of a squared derivative as a quadratic form of the knot vector."""
        n, h = len(self.t), np.diff(self.t)
        c = derivative(self._hermite, order)
        powers = np.arange(c.shape[-1])
        moments = 1.0 / (powers[:, None] + powers + 1)
        local = np.einsum("mai,ij,mbj->mab", c, moments, c) / (
            h[:, None, None] ** (2 * order - 1) * (self.t[-1] - self.t[0])
        )
        index = 3 * np.arange(n - 1)[:, None] + np.arange(6)
        rows, columns = np.repeat(index, 6, axis=1).ravel(), np.tile(index, 6).ravel()
        return sparse.csr_array((local.ravel(), (rows, columns)), shape=(3 * n, 3 * n))


def _velocity_and_acceleration(knots: IntArray) -> IntArray:
    """Indices of the velocities and accelerations of `knots` in a knot vector, ascending."""
    return np.asarray((3 * knots[:, None] + np.array([1, 2])).ravel())
