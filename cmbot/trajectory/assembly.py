"""Sparse derivatives by the unknowns of a parametrization, assembled from derivatives by the states.

The support of every spline is known beforehand, so every row of a Jacobian is a small dense product and
its columns are looked up: no sparse matrices are multiplied.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.trajectory.local_basis import LocalRows

__all__ = ["Assembly"]

AnyNumber = TypeVar("AnyNumber", np.float64, np.intp)


@dataclass(frozen=True, kw_only=True)
class Assembly:
    """What the unknowns x move on each of m segments, in the support of at most w splines of d joints.

    Attributes
    ----------
    size : int
        Number of unknowns.
    coefficient : (m, w, d)
        Unknown that is each spline's coefficient; -1 for splines of via-points, and where there is none.
    unit : (m, w, d)
        Of those coefficients.
    displacement : (m, w, a)
        Unknowns that move the via-point whose spline it is; -1 for basis splines and via-points that stay.
    tangent : (m, w, a, d)
        Directions of these displacements.
    """

    size: int
    coefficient: IntArray
    unit: FloatArray
    displacement: IntArray
    tangent: FloatArray

    def jacobian(self, rows: LocalRows, derivative: FloatArray) -> sparse.csr_array:
        """Take derivatives by the states to those by the unknowns.

        Parameters
        ----------
        rows : LocalRows
            Splines at N times.
        derivative : (k, N, d)
            By position, velocity, acceleration and jerk of the joints, or by the first k of them.

        Returns
        -------
        (N, size)
        """
        at, by_spline = rows.segment, rows.by_spline(derivative)
        by_displacement = np.einsum("nwd,nwad->nwa", by_spline, self.tangent[at])
        N, column = len(at), self._columns[at]
        data = np.hstack([_flat(by_spline * self.unit[at], 1), _flat(by_displacement, 1)])
        there = (column >= 0) & (data != 0.0)
        ends = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
        return sparse.csr_array((data[there], column[there], ends), shape=(N, self.size))

    def hessian(self, rows: LocalRows, curvature: FloatArray) -> sparse.csr_array:
        """Sum the curvatures of N functions of the states, as functions of the unknowns.

        Parameters
        ----------
        rows : LocalRows
            Splines at N times.
        curvature : (N, 3 d, 3 d)
            By position, velocity and acceleration of the joints.

        Returns
        -------
        (size, size)
        """
        at, d = rows.segment, self.unit.shape[2]
        N, w = len(at), self.unit.shape[1]
        column = self._columns[at]
        weight = rows.weight[:, :3]
        by_coefficient = np.zeros((N, 3, d, w, d))
        joint = np.arange(d)
        by_coefficient[:, :, joint, :, joint] = weight * self.unit[at].transpose(2, 0, 1)[:, :, None, :]
        by_displacement = np.einsum("now,nwad->nodwa", weight, self.tangent[at])
        B = np.concatenate([_flat(by_coefficient, 3), _flat(by_displacement, 3)], axis=3)
        B = B.reshape(N, 3 * d, column.shape[1])
        data = B.transpose(0, 2, 1) @ curvature @ B
        row, column = np.broadcast_arrays(column[:, :, None], column[:, None, :])
        there = (row >= 0) & (column >= 0)
        entries = (data[there], (row[there], column[there]))
        return sparse.csr_array(entries, shape=(self.size, self.size))

    @cached_property
    def _columns(self) -> IntArray:
        """Unknowns of what a row of a segment has entries for, (m, w (d + a)); -1 where there is none."""
        return np.hstack([_flat(self.coefficient, 1), _flat(self.displacement, 1)])


def _flat(array: NDArray[AnyNumber], axes: int) -> NDArray[AnyNumber]:
    """Put all axes but the first ones behind one another."""
    shape = array.shape
    return array.reshape(*shape[:axes], prod(shape[axes:]))
