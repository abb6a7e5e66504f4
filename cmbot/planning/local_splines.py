"""C3 splines through movable via-points, in a basis that is local: what makes sparse optimisation possible.

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

from cmbot.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.spline_space import SplineSpace
from cmbot.robot import JointLimits

__all__ = ["LocalRows", "LocalSplines"]

_ORDERS = 4
# How far a unit of a basis spline moves a joint at most, rad.
_FAR = 0.02


@dataclass(frozen=True, kw_only=True)
class LocalRows:
    """Local splines and their first three derivatives at N times, where they are not zero.

    Attributes
    ----------
    weight : (4, E)
        Of each entry, for position, velocity, acceleration and jerk.
    row, column : (E,)
        Which time, and which of u.
    size : int
        Number N of times.
    """

    weight: FloatArray
    row: IntArray
    column: IntArray
    size: int


class LocalSplines:
    """The local basis of a `SplineSpace`.

    Parameters
    ----------
    space : SplineSpace
    limits : JointLimits
    """

    def __init__(self, space: SplineSpace, limits: JointLimits) -> None:
        self.space = space
        self.limits = limits
        self.columns = sparse.csr_array(sparse.hstack([space.basis, space.cardinal]))
        self.gram = sparse.csr_array(space.jerk_products(self.columns))

    @property
    def count(self) -> int:
        """Number of basis splines a joint: n - 4."""
        return self.space.dimension

    @cached_property
    def unit(self) -> FloatArray:
        """Multiples (n - 4, d) at which a basis spline uses up a bound, or goes far from the via-points."""
        t = self.space.t
        largest = np.zeros((_ORDERS, self.count))
        for order in range(_ORDERS):
            for share in np.linspace(0.0, 1.0, 5):
                rows = self.rows(t[:-1] + share * np.diff(t))
                inside = rows.column < self.count
                np.maximum.at(largest[order], rows.column[inside], np.abs(rows.weight[order, inside]))
        limits = self.limits
        far = np.full(len(limits.jerk), _FAR)
        bounds = np.stack([far, limits.velocity, limits.acceleration, limits.jerk])
        return np.asarray((bounds[:, None, :] / largest[:, :, None]).min(axis=0))

    def least_jerk(self, q: FloatArray) -> FloatArray:
        """Multiples (n - 4, d) of the basis splines in the splines of least jerk through `q` (n, d)."""
        return np.asarray(self._basis_gram.solve(-(self.gram[: self.count, self.count :] @ q)))

    def least_jerk_adjoint(self, g: FloatArray) -> FloatArray:
        """Gradient (n, d) by the via-points from that (n - 4, d) by the multiples that follow them."""
        return np.asarray(-(self.gram[self.count :, : self.count] @ self._basis_gram.solve(g)))

    @cached_property
    def _basis_gram(self) -> SuperLU:
        return splu(self.gram[: self.count, : self.count].tocsc())

    def rows(self, times: FloatArray) -> LocalRows:
        """Evaluate at `times` (N,)."""
        segment, hermite = self.space.hermite_weights(times, _ORDERS)
        columns, local, there = self._segments
        weight = np.einsum("oth,thw->otw", hermite, local[segment])
        here = there[segment]
        return LocalRows(
            weight=weight[:, here],
            row=np.nonzero(here)[0],
            column=columns[segment][here],
            size=len(times),
        )

    @cached_property
    def _segments(self) -> tuple[IntArray, FloatArray, BoolArray]:
        """What lives on each segment: columns (m, w), knot values (m, 6, w), which are there (m, w)."""
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
        columns = np.zeros((m, width), dtype=np.intp)
        there = np.zeros((m, width), dtype=np.bool_)
        local = np.zeros((m, 6, width))
        columns[of_segment, slot] = of_column
        there[of_segment, slot] = True
        local[segment, place, slot[index]] = value
        return columns, local, there
