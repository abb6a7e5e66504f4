"""What the optimiser varies: families of C3 splines, as functions of a vector x of unknowns.

`FixedKnots` keeps the via-points (Chang 2021, Eq. (30) to the letter) and varies the numbers of
`SplineSpace`; `SlidingKnots` also lets via-points slide along the self-motion, the tool task kept exactly.
Unknowns are scaled so that the smoothing term ``weight/2 * mean over joints of mean_t (jerk/J_C)^2`` has, for
the spline numbers, the identity as its Hessian, which is what SLSQP starts with.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import linalg

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.planning.path.task import ToolTask
from cmbot.planning.torque.null_space import LONGEST_SLIDE, TaskAtViaPoints
from cmbot.robot import JointLimits, Postures
from cmbot.trajectory.spline_space import SplineSpace

__all__ = ["FixedKnots", "SlidingKnots", "WhitenedSplines"]


class WhitenedSplines:
    """The basis of a `SplineSpace`, whitened by its jerk: what no choice of unknowns changes.

    Parameters
    ----------
    space : SplineSpace
    limits : JointLimits
    """

    def __init__(self, space: SplineSpace, limits: JointLimits) -> None:
        self.space = space
        self.limits = limits
        L = np.linalg.cholesky(space.jerk_gram.toarray())
        self.basis = linalg.solve_triangular(L, space.basis.toarray().T, lower=True).T

    @cached_property
    def response(self) -> FloatArray:
        """P: knot vectors (3n, n) of the least-jerk splines through each via-point alone."""
        return np.asarray(self.space.least_jerk(np.eye(len(self.space.t))))

    @cached_property
    def response_gram(self) -> FloatArray:
        """Gram matrix (n, n) of the columns of P under the time mean of the product of jerks."""
        return self.space.jerk_product(self.response, self.response)

    def rows(self, times: FloatArray, *, sliding: bool) -> FloatArray:
        """Splines and their first three derivatives at `times`, (4, N, n - 4) or, sliding, (4, N, 2n - 4)."""
        columns = np.hstack([self.basis, self.response]) if sliding else self.basis
        return np.stack([self.space.design(times, order) @ columns for order in range(4)])


class FixedKnots:
    """Splines through fixed via-points; x holds the whitened spline numbers, joint by joint.

    Parameters
    ----------
    splines : WhitenedSplines
    via_points : (n, d), rad
    numbers : (n - 4, d), rad/s3
        Where to start: multiples of the whitened basis.
    weight : float
        Of the smoothing term.
    """

    sliding = False
    slides = 0
    """Number of unknowns, the first ones, that slide via-points."""

    def __init__(
        self, splines: WhitenedSplines, via_points: FloatArray, numbers: FloatArray, weight: float
    ) -> None:
        self.splines = splines
        self.via_points = via_points
        self._numbers = numbers
        self._joints = via_points.shape[1]
        self._scale = splines.limits.jerk * np.sqrt(self._joints / weight)

    @property
    def dimension(self) -> int:
        """Number of unknowns."""
        return int(self._numbers.size)

    @property
    def space(self) -> SplineSpace:
        """Where the splines live."""
        return self.splines.space

    @property
    def start(self) -> FloatArray:
        """Unknowns (dimension,) of the spline that the family was built around."""
        return np.asarray((self._numbers / self._scale).T.ravel())

    def numbers(self, x: FloatArray) -> FloatArray:
        """Multiples (n - 4, d) of the whitened basis."""
        return np.asarray(x[-self._numbers.size :].reshape(self._joints, -1).T * self._scale)

    def via_points_at(self, x: FloatArray) -> FloatArray:
        """Via-points (n, d)."""
        del x
        return self.via_points

    def knots(self, x: FloatArray) -> FloatArray:
        """Knot vectors (3n, d)."""
        via_points = self.via_points_at(x)
        return np.asarray(self.splines.response @ via_points + self.splines.basis @ self.numbers(x))

    def rows(self, times: FloatArray) -> FloatArray:
        """Splines at `times`, for `chain`."""
        return self.splines.rows(times, sliding=self.sliding)

    def chain(
        self, x: FloatArray, rows: FloatArray, d_q: FloatArray, d_v: FloatArray, d_a: FloatArray
    ) -> FloatArray:
        """Take derivatives (N, d) by the states to derivatives (N, dimension) by the unknowns."""
        del x
        parts = (d[:, :, None] * rows[order][:, None, :] for order, d in enumerate((d_q, d_v, d_a)))
        return self._scaled(sum(parts, np.zeros(1)))

    def chain_one(
        self, x: FloatArray, rows: FloatArray, order: int, joint: IntArray, factor: FloatArray
    ) -> FloatArray:
        """Derivatives (N, dimension) of ``factor`` times derivative `order` of one `joint` each."""
        del x
        return self._scaled(_spread(rows[order], joint, factor, self._joints))

    def smoothing(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient (dimension,) of the smoothing term, but for what fixed via-points add."""
        return 0.5 * float(x @ x), x

    def smoothing_curvature(self) -> FloatArray:
        """Hessian (dimension, dimension) of the smoothing term around `start`."""
        return np.eye(self.dimension)

    def rebuilt(self, x: FloatArray, weight: float) -> FixedKnots:
        """Build the family anew around `x`, with another weight of the smoothing term."""
        return FixedKnots(self.splines, self.via_points, self.numbers(x), weight)

    def _scaled(self, J: FloatArray) -> FloatArray:
        """Derivatives (N, dimension) from those (N, d, n - 4) by the multiples of the basis."""
        return np.asarray((J * self._scale[:, None]).reshape(len(J), -1))


class SlidingKnots(FixedKnots):
    """Splines whose via-points slide along the self-motion; x holds the slides, then the spline numbers.

    A via-point is where the tool task holds and its coordinates along the null space N at the start are u:
    ``task(q) = 0, N^T (q - q_start) = u``.

    Parameters
    ----------
    splines, via_points, numbers, weight
        As for `FixedKnots`.
    postures : Postures
    task : ToolTask
    points : (n, 3), m
        Tool points at the via-points.
    pinned : bool
        The first via-point stays.
    """

    sliding = True

    def __init__(
        self,
        splines: WhitenedSplines,
        via_points: FloatArray,
        numbers: FloatArray,
        weight: float,
        *,
        postures: Postures,
        task: ToolTask,
        points: FloatArray,
        pinned: bool,
    ) -> None:
        super().__init__(splines, via_points, numbers, weight)
        self._task = TaskAtViaPoints(postures=postures, task=task, points=points)
        self._pinned = pinned
        self._null = self._task.null_spaces(via_points)
        if pinned:
            self._null[0] = 0.0
        self.slides = int(self._null.shape[0] * self._null.shape[1])
        self._weights = weight / self._joints / splines.limits.jerk**2
        # Scaling only: where smoothing does not hold it back, a unit slides via-points by the longest slide.
        H = self._slide_curvature(self._null) + np.eye(self.slides) / LONGEST_SLIDE**2
        self._to_slides = linalg.solve_triangular(np.linalg.cholesky(H), np.eye(self.slides), lower=True).T
        self._at: tuple[FloatArray, FloatArray, FloatArray] | None = None

    @property
    def dimension(self) -> int:
        """Number of unknowns."""
        return int(self._numbers.size) + self.slides

    @property
    def start(self) -> FloatArray:
        """Unknowns (dimension,) of the spline that the family was built around: no slide."""
        return np.concatenate([np.zeros(self.slides), super().start])

    def via_points_at(self, x: FloatArray) -> FloatArray:
        """Via-points (n, d) after their slides."""
        return self._placed(x)[0]

    def chain(
        self, x: FloatArray, rows: FloatArray, d_q: FloatArray, d_v: FloatArray, d_a: FloatArray
    ) -> FloatArray:
        """Take derivatives (N, d) by the states to derivatives (N, dimension) by the unknowns."""
        parts = (d[:, :, None] * rows[order][:, None, :] for order, d in enumerate((d_q, d_v, d_a)))
        return self._split(x, sum(parts, np.zeros(1)))

    def chain_one(
        self, x: FloatArray, rows: FloatArray, order: int, joint: IntArray, factor: FloatArray
    ) -> FloatArray:
        """Derivatives (N, dimension) of ``factor`` times derivative `order` of one `joint` each."""
        return self._split(x, _spread(rows[order], joint, factor, self._joints))

    def smoothing(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient (dimension,) of the smoothing term."""
        q, tangent = self._placed(x)
        pull = self.splines.response_gram @ q * self._weights
        y = x[self.slides :]
        value = 0.5 * float(np.sum(q * pull)) + 0.5 * float(y @ y)
        along = np.einsum("ki,kai->ka", pull, tangent).ravel()
        return value, np.concatenate([self._to_slides.T @ along, y])

    def smoothing_curvature(self) -> FloatArray:
        """Hessian (dimension, dimension) of the smoothing term around `start`, along the tangents."""
        slides = self._to_slides.T @ self._slide_curvature(self._null) @ self._to_slides
        return np.asarray(linalg.block_diag(slides, np.eye(self._numbers.size)))

    def rebuilt(self, x: FloatArray, weight: float) -> SlidingKnots:
        """Build the family anew around `x`, with another weight of the smoothing term."""
        return SlidingKnots(
            self.splines,
            self.via_points_at(x),
            self.numbers(x),
            weight,
            postures=self._task.postures,
            task=self._task.task,
            points=self._task.points,
            pinned=self._pinned,
        )

    def _slide_curvature(self, tangent: FloatArray) -> FloatArray:
        """Hessian of the smoothing term by the slides, for tangents (n, a, d)."""
        n, a, _ = tangent.shape
        G = self.splines.response_gram
        H = np.einsum("kai,kl,lbi,i->kalb", tangent, G, tangent, self._weights, optimize=True)
        return np.asarray(H.reshape(n * a, n * a))

    def _split(self, x: FloatArray, J: FloatArray) -> FloatArray:
        """Derivatives by the unknowns from those (N, d, 2n - 4) by basis multiples and via-points."""
        m = self._numbers.shape[0]
        tangent = self._placed(x)[1]
        slides = np.einsum("tik,kai->tka", J[:, :, m:], tangent, optimize=True).reshape(len(J), -1)
        return np.hstack([slides @ self._to_slides, self._scaled(J[:, :, :m])])

    def _placed(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Via-points (n, d) of the slides in `x`, and their derivatives (n, a, d) by the unscaled slides."""
        if self._at is None or not np.array_equal(self._at[0], x[: self.slides]):
            self._at = (x[: self.slides].copy(), *self._place(x[: self.slides]))
        return self._at[1], self._at[2]

    def _place(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        n, a, _ = self._null.shape
        wanted = (self._to_slides @ unknowns).reshape(n, a)
        # A slide longer than the family bears bends back smoothly.
        u = LONGEST_SLIDE * np.tanh(wanted / LONGEST_SLIDE)
        du = 1.0 - np.tanh(wanted / LONGEST_SLIDE) ** 2
        free = np.arange(1, n) if self._pinned else np.arange(n)
        q, tangent = self.via_points.copy(), np.zeros_like(self._null)
        q[free], slope = self._task.slid(self.via_points, self._null[free], u[free], free)
        tangent[free] = slope * du[free][:, :, None]
        return q, tangent


def _spread(rows: FloatArray, joint: IntArray, factor: FloatArray, joints: int) -> FloatArray:
    """Rows (N, k) times `factor` (N,), each at its own joint: (N, d, k)."""
    J = np.zeros((len(rows), joints, rows.shape[1]))
    J[np.arange(len(rows)), joint] = factor[:, None] * rows
    return J
