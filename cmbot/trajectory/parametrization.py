"""The families of C3 splines in local unknowns: every derivative is sparse.

Unknowns x are steps from the spline that the family was built around, each about 1 when it goes as far as a
step sensibly may: multiples of the local basis splines, joint by joint, and, where via-points slide, their
slides along the self-motion. They are sorted along the path, so what is coupled lies side by side.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import sparse

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.planning.torque.null_space import LONGEST_SLIDE, TaskAtViaPoints
from cmbot.trajectory.assembly import Assembly
from cmbot.trajectory.local_basis import LocalRows, SparseSplines
from cmbot.trajectory.spline_space import SplineSpace

__all__ = ["Parametrization"]

# Step of the central differences that tell how via-points leave the tangents, rad.
_DIFFERENCE = 1e-4


class Parametrization:
    """Splines around given ones, through via-points that stay or slide.

    Parameters
    ----------
    splines : SparseSplines
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
        splines: SparseSplines,
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
        """Number of unknowns that slide via-points."""
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
        numbers = self._numbers + x[self.number_index] * self.splines.unit
        u = LONGEST_SLIDE * x[self.slide_index]
        if self._task is None or not u.any():
            return self.via_points, numbers
        slid, _ = self._task.slid(self.via_points, self._null, u, self._free)
        tangential = self.via_points[self._free] + np.einsum("ka,kai->ki", u, self._null)
        q, bend = self.via_points.copy(), np.zeros_like(self.via_points)
        q[self._free], bend[self._free] = slid, slid - tangential
        return q, numbers + self.splines.least_jerk(bend)

    @property
    def space(self) -> SplineSpace:
        """Where the splines live."""
        return self.splines.space

    def rebuilt(self, x: FloatArray, weight: float) -> Parametrization:
        """Build the family anew around `x`, with another weight of the smoothing term.

        Raises
        ------
        OptimisationFailed
            When a via-point cannot be put back onto the tool task.
        """
        via_points, numbers = self._moved(x)
        return Parametrization(
            self.splines,
            via_points,
            numbers,
            weight,
            task=self._task,
            pinned=self._pinned,
            held=self._held,
            directions=self._null,
        )

    def stretch(self, first: int, last: int) -> Parametrization:
        """Return the splines of least jerk between two via-points, at rest there; inner ones of them stay."""
        some = slice(first, last + 1)
        splines = SparseSplines(SplineSpace(self.space.t[some]), self.splines.limits)
        via_points = self.via_points[some]
        return Parametrization(
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

    @cached_property
    def assembly(self) -> Assembly:
        """How the unknowns move the splines on every segment."""
        splines, living = self.splines, self.splines.living
        joints, a = self.via_points.shape[1], self._null.shape[1]
        basis = ((living >= 0) & (living < splines.count))[:, :, None]
        # Those that do not slide, and what is no via-point's, find the last entries: none.
        nth = np.full(len(self.via_points) + 1, -1)
        nth[self._free] = np.arange(len(self._free))
        of = nth[np.where(living < splines.count, -1, living - splines.count)]
        slide_index = np.vstack([self.slide_index, np.full((1, a), -1)])
        tangent = np.concatenate([LONGEST_SLIDE * self._null, np.zeros((1, a, joints))])
        return Assembly(
            size=self.dimension,
            number=np.where(basis, self.number_index[np.where(basis[:, :, 0], living, 0)], -1),
            unit=np.where(basis, splines.unit[np.where(basis[:, :, 0], living, 0)], 0.0),
            slide=slide_index[of],
            tangent=tangent[of],
        )

    def pulled(self, rows: LocalRows, derivative: FloatArray) -> FloatArray:
        """Gradient (size of u,) by u of a sum of functions, from derivatives (k, N, d) by the states."""
        living, by_spline = self.splines.living[rows.segment], rows.by_spline(derivative)
        pull = np.zeros((self.splines.columns.shape[1], self.via_points.shape[1]))
        np.add.at(pull, living[living >= 0], by_spline[living >= 0])
        return pull.ravel()

    def smoothing(self) -> tuple[float, FloatArray]:
        """Value of the smoothing term, and its gradient (size of u,) by u."""
        u = np.vstack([self._numbers, self.via_points]).ravel()
        pull = self.weight * (self.splines.jerk_curvature @ u)
        return 0.5 * float(u @ pull), np.asarray(pull)

    @cached_property
    def smoothing_curvature(self) -> sparse.csr_array:
        """Hessian (dimension, dimension) of the smoothing term along the tangents."""
        return sparse.csr_array(self.weight * (self.map.T @ self.splines.jerk_curvature @ self.map))

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
        row = np.broadcast_to(self.slide_index[:, :, None], blocks.shape)
        column = np.broadcast_to(self.slide_index[:, None, :], blocks.shape)
        return sparse.csr_array(
            (blocks.ravel(), (row.ravel(), column.ravel())), shape=(self.dimension, self.dimension)
        )

    @cached_property
    def block_ends(self) -> IntArray:
        """Where blocks of unknowns end, (n - 4,); those more than three blocks apart are not coupled."""
        return np.asarray(np.cumsum(np.bincount(self._blocks, minlength=len(self._numbers))))

    @cached_property
    def number_index(self) -> IntArray:
        """Which unknowns are multiples of the basis splines, (n - 4, d)."""
        return self._place[: self._numbers.size].reshape(self._numbers.shape)

    @cached_property
    def slide_index(self) -> IntArray:
        """Which unknowns slide via-points, (k, a)."""
        return self._place[self._numbers.size :].reshape(self._null.shape[:2])

    @cached_property
    def _blocks(self) -> IntArray:
        """Block (dimension,) of each multiple of a basis spline, then of each slide."""
        n, d = self.via_points.shape
        numbers = np.repeat(np.arange(n - 4), d)
        slides = np.repeat(np.clip(self._free - 2, 0, n - 5), self._null.shape[1])
        return np.concatenate([numbers, slides])

    @cached_property
    def _place(self) -> IntArray:
        """Where each of them is among the unknowns, (dimension,)."""
        place = np.empty(self.dimension, dtype=np.intp)
        place[np.argsort(self._blocks, kind="stable")] = np.arange(self.dimension)
        return place

    @cached_property
    def map(self) -> sparse.csr_array:
        """Derivatives (size of u, dimension) of u by the unknowns."""
        n, d = self.via_points.shape
        size = self._numbers.size
        row = size + d * self._free[:, None, None] + np.arange(d)
        row = np.broadcast_to(row, self._null.shape)
        column = np.broadcast_to(self.slide_index[:, :, None], self._null.shape)
        return sparse.csr_array(
            (
                np.concatenate([self.splines.unit.ravel(), LONGEST_SLIDE * self._null.ravel()]),
                (
                    np.concatenate([np.arange(size), row.ravel()]),
                    np.concatenate([self.number_index.ravel(), column.ravel()]),
                ),
            ),
            shape=(size + n * d, self.dimension),
        )


def _turned(null: FloatArray, directions: FloatArray) -> FloatArray:
    """Orthonormal bases (k, a, d) of the same spaces as `null`, as near as they can be to `directions`."""
    U, _, Vt = np.linalg.svd(directions @ null.transpose(0, 2, 1))
    return np.asarray(U @ Vt @ null)
