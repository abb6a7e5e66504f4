"""C3 splines through via-points that may move on a manifold, as functions of a vector x of unknowns.

Unknowns are steps from the splines that a parametrization was built around, each about 1 when it goes as far
as a step sensibly may: coefficients of the local basis splines, joint by joint, and displacements of
via-points along tangents of the manifold. They are sorted along the path, so what is coupled lies side by
side and every derivative is banded.
"""

from __future__ import annotations

from functools import cached_property
from typing import Protocol, Self

import numpy as np
from scipy import sparse

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.trajectory.local_basis import LocalRows, SparseSplines
from cmbot.trajectory.quintic import QuinticTrajectory
from cmbot.trajectory.spline_space import SplineSpace

# Unit of a displacement, rad: a via-point moves at most about so far before tangents are taken anew.
_DISPLACEMENT_UNIT = 0.3
# Step of the central differences that tell how via-points leave the tangents, rad.
_DIFFERENCE_STEP = 1e-4


class Retraction(Protocol):
    """The manifolds on which n via-points move, one each (Absil et al. 2008, Section 4.1)."""

    def tangents(self, q: FloatArray) -> FloatArray:
        """Orthonormal tangents (n, a, d) at via-points (n, d)."""

    def retract(
        self, q: FloatArray, tangents: FloatArray, u: FloatArray, which: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Move k via-points by `u` (k, a) along `tangents` (k, a, d) and back onto the manifold.

        Returns the via-points (k, d) and their derivatives (k, a, d) by u.

        Raises
        ------
        OptimisationFailed
            When one cannot be put back.
        """

    def part(self, first: int, last: int) -> Self:
        """Return the manifolds of the via-points `first` to `last`."""


class Parametrization:
    """Splines around given ones, through via-points that stay or move.

    Parameters
    ----------
    splines : SparseSplines
    via_points : (n, d), rad
    coefficients : (n - 4, d)
        Of the basis splines.
    retraction : Retraction, optional
        Where via-points move; without it all stay.
    movable : (k,), optional
        Which of them do; left out, all.
    directions : (k, a, d), optional
        Tangents are turned as near to these as they can be.
    """

    def __init__(
        self,
        splines: SparseSplines,
        via_points: FloatArray,
        coefficients: FloatArray,
        *,
        retraction: Retraction | None = None,
        movable: IntArray | None = None,
        directions: FloatArray | None = None,
    ) -> None:
        self.splines = splines
        self.via_points = via_points
        self.coefficients = coefficients
        self.retraction = retraction
        n, d = via_points.shape
        if retraction is None:
            self.movable, self._tangents = np.empty(0, dtype=np.intp), np.empty((0, 0, d))
            return
        self.movable = np.arange(n) if movable is None else movable
        self._tangents = retraction.tangents(via_points)[self.movable]
        if directions is not None:
            U, _, Vt = np.linalg.svd(directions @ self._tangents.transpose(0, 2, 1))
            self._tangents = U @ Vt @ self._tangents

    @property
    def space(self) -> SplineSpace:
        """The splines' space."""
        return self.splines.space

    @property
    def displacements(self) -> int:
        """Number of unknowns that move via-points."""
        return int(self._tangents.shape[0] * self._tangents.shape[1])

    @property
    def dimension(self) -> int:
        """Number of unknowns."""
        return int(self.coefficients.size) + self.displacements

    @cached_property
    def trajectory(self) -> QuinticTrajectory:
        """The splines that it was built around."""
        return self.space.trajectory(self.splines.columns @ np.vstack([self.coefficients, self.via_points]))

    def step(self, x: FloatArray) -> Parametrization:
        """Return the parametrization around the splines at `x` (dimension,).

        What bends via-points away from the tangents is taken up by splines of least jerk: between via-points
        near each other the joints then stay near the manifold, too, and long steps remain possible.

        Raises
        ------
        OptimisationFailed
            When a via-point cannot be put back onto its manifold.
        """
        if not x.any():
            return self
        coefficients = self.coefficients + x[self.coefficient_index] * self.splines.unit
        via_points, u = self.via_points, _DISPLACEMENT_UNIT * x[self.displacement_index]
        if self.retraction is not None and u.any():
            moved, _ = self.retraction.retract(via_points, self._tangents, u, self.movable)
            straight = via_points[self.movable] + np.einsum("ka,kai->ki", u, self._tangents)
            via_points, bend = via_points.copy(), np.zeros_like(via_points)
            via_points[self.movable], bend[self.movable] = moved, moved - straight
            coefficients = coefficients + self.splines.least_jerk(bend)
        return Parametrization(
            self.splines,
            via_points,
            coefficients,
            retraction=self.retraction,
            movable=self.movable,
            directions=self._tangents,
        )

    def step_jacobian(self, x: FloatArray) -> FloatArray:
        """Derivatives (size of u, dimension) by x of what `step` makes of u = (coefficients, via-points)."""
        M: FloatArray = self.map.toarray()
        u = _DISPLACEMENT_UNIT * x[self.displacement_index]
        if self.retraction is None or not u.any():
            return M
        n, d = self.via_points.shape
        slope = self.retraction.retract(self.via_points, self._tangents, u, self.movable)[1]
        bend = _DISPLACEMENT_UNIT * (slope - self._tangents)
        follow = self.splines.least_jerk(np.eye(n))[:, self.movable]
        columns = self.displacement_index
        by_coefficient = np.einsum("ck,kai->cika", follow, bend).reshape(self.coefficients.size, -1)
        M[: self.coefficients.size, columns.ravel()] += by_coefficient
        rows = self.coefficients.size + d * self.movable[:, None, None] + np.arange(d)
        M[rows, columns[:, :, None]] += bend
        return M

    def segment(self, first: int, last: int) -> Parametrization:
        """Return the splines of least jerk between two via-points, at rest there; inner ones of them stay."""
        some = slice(first, last + 1)
        splines = SparseSplines(SplineSpace(self.space.t[some]), self.splines.bounds)
        via_points = self.via_points[some]
        ends = [k for k in (first, last) if 0 < k < len(self.via_points) - 1]
        movable = self.movable[(self.movable >= first) & (self.movable <= last)]
        return Parametrization(
            splines,
            via_points,
            splines.least_jerk(via_points),
            retraction=None if self.retraction is None else self.retraction.part(first, last),
            movable=movable[~np.isin(movable, ends)] - first,
        )

    def jacobian(self, rows: LocalRows, derivative: FloatArray) -> sparse.csr_array:
        """Take derivatives (k, N, d) by the states to those (N, dimension) by the unknowns."""
        product: sparse.csr_array = self.splines.jacobian(rows, derivative) @ self.map
        return product

    def hessian(self, rows: LocalRows, curvature: FloatArray) -> sparse.csr_array:
        """Sum the curvatures (N, 3 d, 3 d) of functions by the states, as functions of the unknowns."""
        return sparse.csr_array(self._transposed_map @ self.splines.hessian(rows, curvature) @ self.map)

    def pullback(self, rows: LocalRows, derivative: FloatArray) -> FloatArray:
        """Gradient (size of u,) by u of a sum of functions, from derivatives (k, N, d) by the states."""
        support, by_spline = self.splines.support[rows.segment], rows.by_spline(derivative)
        gradient = np.zeros((self.splines.columns.shape[1], self.via_points.shape[1]))
        np.add.at(gradient, support[support >= 0], by_spline[support >= 0])
        return gradient.ravel()

    def smoothing(self) -> tuple[float, FloatArray]:
        """Half the mean of (jerk/bound)^2 + (velocity/bound)^2, and its gradient (size of u,) by u."""
        u = np.vstack([self.coefficients, self.via_points]).ravel()
        gradient = self.splines.smoothing_curvature @ u
        return 0.5 * float(u @ gradient), np.asarray(gradient)

    @cached_property
    def smoothing_hessian(self) -> sparse.csr_array:
        """Hessian (dimension, dimension) of `smoothing` along the tangents."""
        return sparse.csr_array(self._transposed_map @ self.splines.smoothing_curvature @ self.map)

    def bend_hessian(self, gradient: FloatArray) -> sparse.csr_array:
        """Hessian (dimension, dimension) of a function with `gradient` by u, as far as it is due to bends.

        Via-points do not move straight; a second-order model has to know how far they leave the tangents.
        """
        blocks = np.zeros((len(self.movable), *2 * (self._tangents.shape[1],)))
        if self.retraction is not None and self.displacements:
            g = gradient.reshape(-1, self.via_points.shape[1])
            count = self.splines.count
            by_bend = (g[count:] + self.splines.least_jerk_adjoint(g[:count]))[self.movable]
            for along, u in enumerate(_DIFFERENCE_STEP * np.eye(self._tangents.shape[1])):
                u = np.broadcast_to(u, self._tangents.shape[:2])
                ahead, behind = (
                    self.retraction.retract(self.via_points, self._tangents, side * u, self.movable)[1]
                    for side in (1, -1)
                )
                bend = (ahead - behind) / (2 * _DIFFERENCE_STEP)
                blocks[:, along] = _DISPLACEMENT_UNIT**2 * np.einsum("kai,ki->ka", bend, by_bend)
            blocks = 0.5 * (blocks + blocks.transpose(0, 2, 1))
        row = np.broadcast_to(self.displacement_index[:, :, None], blocks.shape)
        column = np.broadcast_to(self.displacement_index[:, None, :], blocks.shape)
        return sparse.csr_array(
            (blocks.ravel(), (row.ravel(), column.ravel())), shape=(self.dimension, self.dimension)
        )

    @cached_property
    def block_ends(self) -> IntArray:
        """Where blocks of unknowns end, (n - 4,); those more than three blocks apart are not coupled."""
        return np.asarray(np.cumsum(np.bincount(self._blocks, minlength=len(self.coefficients))))

    @cached_property
    def coefficient_index(self) -> IntArray:
        """Which unknowns change the coefficients, (n - 4, d)."""
        return self._place[: self.coefficients.size].reshape(self.coefficients.shape)

    @cached_property
    def displacement_index(self) -> IntArray:
        """Which unknowns move via-points, (k, a)."""
        return self._place[self.coefficients.size :].reshape(self._tangents.shape[:2])

    @cached_property
    def _blocks(self) -> IntArray:
        """Block (dimension,) of each coefficient, then of each displacement."""
        n, d = self.via_points.shape
        coefficients = np.repeat(np.arange(n - 4), d)
        displacements = np.repeat(np.clip(self.movable - 2, 0, n - 5), self._tangents.shape[1])
        return np.concatenate([coefficients, displacements])

    @cached_property
    def _place(self) -> IntArray:
        """Where each of them is among the unknowns, (dimension,)."""
        place = np.empty(self.dimension, dtype=np.intp)
        place[np.argsort(self._blocks, kind="stable")] = np.arange(self.dimension)
        return place

    @cached_property
    def _transposed_map(self) -> sparse.csr_array:
        return sparse.csr_array(self.map.T)

    @cached_property
    def map(self) -> sparse.csr_array:
        """Derivatives (size of u, dimension) of u by the unknowns at zero."""
        n, d = self.via_points.shape
        size = self.coefficients.size
        row = np.broadcast_to(size + d * self.movable[:, None, None] + np.arange(d), self._tangents.shape)
        column = np.broadcast_to(self.displacement_index[:, :, None], self._tangents.shape)
        values = np.concatenate([self.splines.unit.ravel(), _DISPLACEMENT_UNIT * self._tangents.ravel()])
        rows = np.concatenate([np.arange(size), row.ravel()])
        columns = np.concatenate([self.coefficient_index.ravel(), column.ravel()])
        return sparse.csr_array((values, (rows, columns)), shape=(size + n * d, self.dimension))
