"""The shortest time law along a joint path: third order, by sequential linear programs.

A law is the share of a leg that is covered over the share of its duration T. Its third derivative is linear
between equally spaced nodes and zero at the ends, so a joint path q(s) in C3 makes a motion in C3 from rest
to rest. Along the path, with primes for derivatives by the share and dots for those of the law,

    |q' s.| <= V T,    |q'' s.^2 + q' s..| <= A T^2,    |q''' s.^3 + 3 q'' s. s.. + q' s...| <= J T^3,
    |g + (m s.. + c s.^2) / T^2| <= torque,

where g, m and c are functions of s alone. For a given law the least T is the largest root of these rows. It
is minimised over the nodes: a linear program in the nodes and log T around the law before, in a box that
shrinks where T does not fall. In time there is no singularity where the tool rests, as there is in s. The
optimum is a vertex, as bang-bang laws are, and there such programs converge quadratically.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PPoly
from scipy.optimize import linprog

from cmbot.common.arrays import FloatArray
from cmbot.toolpath import TimeLaw

# Points per phase at which rows are kept, and at which the duration is taken in the end.
_POINTS_PER_PHASE, _FINAL_POINTS = 4, 12
# Programs at most, least gain of one, and the box at first and at last, as a share of the largest node.
_MAX_PROGRAMS, _LEAST_GAIN, _BOX, _SMALLEST_BOX = 60, 1e-4, 0.5, 1e-3
# A law of so many phases is sought from one of half of them.
_MIN_REFINED_PHASES = 24
# Points of any other law.
_LAW_POINTS = 721
# Shares of a smooth law that are mixed in until a law leads forward everywhere.
_SMOOTH_LAW_SHARES = (0.0, 0.01, 0.1, 0.5, 1.0)
# Rows below this share of their bounds are left to the next program; few get beyond them in one step.
_ACTIVE_ROW_SHARE = 0.7


@dataclass(frozen=True, kw_only=True, eq=False)
class Bounded:
    """Functions of a motion along a path that are bounded: of order k, by powers of the law's derivatives.

    Attributes
    ----------
    order : int
        k, by which they fall with the duration.
    terms : tuple of callable
        Splines, called with shares and the order of the derivative: their factors by the share, (m,) each,
        of ``s.`` for k = 1; of ``s..`` and ``s.^2`` for k = 2; of
        ``s...``, ``s. s..`` and ``s.^3`` for k = 3.
    bound : (m,)
        Of their absolute values.
    offset : callable or None
        What they are at rest, (m,).
    norm : bool
        The bound, one, is that of their norm.
    """

    order: int
    terms: tuple[Callable[..., FloatArray], ...]
    bound: FloatArray
    offset: Callable[..., FloatArray] | None = None
    norm: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rows:
    """Rows ``at_rest + moving / T^order <= bound``, R of them, with derivatives by the nodes."""

    order: int
    at_rest: FloatArray
    moving: FloatArray
    bound: FloatArray
    d_rest: FloatArray  # (R, K + 1)
    d_moving: FloatArray  # (R, K + 1)


class _Nodes:
    """Laws with K phases: the values and derivatives at some points, linear in the K - 1 inner nodes."""

    def __init__(self, phases: int) -> None:
        self.phases = phases
        breaks = np.linspace(0.0, 1.0, phases + 1)
        h = 1.0 / phases
        # Of the hat at each node: slopes (phases, nodes) and values at the beginning of each phase.
        begin, end = np.eye(phases + 1)[:-1], np.eye(phases + 1)[1:]
        jerk = PPoly(np.stack([(end - begin) / h, begin]), breaks)
        self._orders = [jerk.antiderivative(3), jerk.antiderivative(2), jerk.antiderivative(1), jerk]
        ends = np.array([self._orders[k](1.0) for k in range(3)])
        # From rest to rest, and no jerk at either end.
        free = slice(1, phases)
        self.matrix, self.target = ends[:, free], np.array([1.0, 0.0, 0.0])

    def at(self, points: FloatArray) -> list[FloatArray]:
        """Matrices (N, K - 1) from the inner nodes to the law and its first three derivatives."""
        return [each(points)[:, 1:-1] for each in self._orders]

    def smooth(self) -> FloatArray:
        """Inner nodes (K - 1,) of least square: a law in the middle of all."""
        return self.near(np.zeros(self.phases - 1))

    def near(self, nodes: FloatArray) -> FloatArray:
        """The inner nodes (K - 1,) of a law from rest to rest that are nearest to some."""
        return np.asarray(nodes + np.linalg.lstsq(self.matrix, self.missing(nodes), rcond=None)[0])

    def missing(self, nodes: FloatArray) -> FloatArray:
        """What nodes miss of a law from rest to rest, (3,)."""
        return self.target - self.matrix @ nodes

    def law(self, nodes: FloatArray) -> TimeLaw:
        """The law of inner nodes."""
        coefficients = np.einsum("dkn,n->kd", self._orders[0].c[::-1, :, 1:-1], nodes)
        return TimeLaw(
            breaks=self._orders[0].x,
            coefficients=coefficients,
            continuity=np.full(self.phases + 1, 3),
        )


def shortest_law(
    bounded: Sequence[Bounded], phases: int, known: FloatArray | None = None
) -> tuple[TimeLaw, FloatArray, float]:
    """Return the shortest law, its jerk (K + 1,) at the nodes by shares of time, and its duration, s.

    Parameters
    ----------
    bounded : sequence of Bounded
    phases : int
        K, at least 6.
    known : (K + 1,), optional
        Jerk at the nodes of a law that is known. The search begins there, too, with the smoothest law, and
        with one of half the phases: programs find the optimum nearest to where they begin.

    Returns
    -------
    TimeLaw, (K + 1,), float
        The duration is infinite where a bound is exceeded at rest.
    """
    space = _Nodes(phases)
    coarse = _Points(space, phases * _POINTS_PER_PHASE, bounded)
    starts = [space.smooth(), *([] if known is None else [known[1:-1]])]
    if phases >= _MIN_REFINED_PHASES:
        # From few nodes programs get further.
        coarser = phases // 2
        jerk = shortest_law(bounded, coarser)[1]
        starts.append(
            space.near(np.interp(np.arange(1, phases) / phases, np.arange(coarser + 1) / coarser, jerk))
        )
    nodes, seconds = min((_descended(coarse, start) for start in starts), key=lambda law: law[1])
    fine, smooth = _Points(space, phases * _FINAL_POINTS, bounded), space.smooth()
    # Between the coarse points a law may lead back a little: the smooth one does not.
    for share in _SMOOTH_LAW_SHARES if np.isfinite(seconds) else _SMOOTH_LAW_SHARES[:1]:
        law = nodes + share * (smooth - nodes)
        seconds = fine.seconds(law)
        if np.isfinite(seconds):
            break
    return space.law(law), np.concatenate([[0.0], law, [0.0]]), seconds


def least_seconds(bounded: Sequence[Bounded], law: TimeLaw) -> float:
    """Return the least duration of a law within bounds, s; infinite where one is exceeded at rest."""
    u = np.linspace(0.0, 1.0, _LAW_POINTS)
    d = [law.share(u), *(law.rate(u, order) for order in (1, 2, 3))]
    return _Points(_Nodes(1), 1, bounded).least(d)


def _descended(points: _Points, nodes: FloatArray) -> tuple[FloatArray, float]:
    """The optimum (K - 1,) that programs find from nodes on, and its duration, s."""
    seconds, box = points.seconds(nodes), _BOX
    for _ in range(_MAX_PROGRAMS if np.isfinite(seconds) else 0):
        step = points.step(nodes, seconds, box * np.abs(nodes).max())
        trial = np.inf if step is None else points.seconds(nodes + step)
        if step is not None and trial < seconds:
            gain = 1 - trial / seconds
            nodes, seconds = nodes + step, trial
            if gain < _LEAST_GAIN:
                break
            box = min(2 * box, _BOX)
            continue
        box /= 4
        if box < _SMALLEST_BOX:
            break
    return nodes, seconds


class _Points:
    """Rows at equally spaced points of a law's time."""

    def __init__(self, space: _Nodes, count: int, bounded: Sequence[Bounded]) -> None:
        self._space, self._bounded = space, bounded
        self._matrices = space.at(np.linspace(0.0, 1.0, count + 1))

    def seconds(self, nodes: FloatArray) -> float:
        """The least duration of a law, s."""
        s, rate = (matrix @ nodes for matrix in self._matrices[:2])
        if rate.min() < -1e-9 or s.max() > 1 + 1e-9:
            return float(np.inf)
        return self.least([matrix @ nodes for matrix in self._matrices])

    def least(self, d: list[FloatArray]) -> float:
        """The least duration, s, of a law that is `d`, with its derivatives, at some points."""
        inverse = np.inf  # of the duration
        for rows in self._rows(d, derivatives=False):
            if (rows.at_rest >= rows.bound).any():
                return float(np.inf)
            with np.errstate(divide="ignore", invalid="ignore"):
                room = np.where(rows.moving > 0, (rows.bound - rows.at_rest) / rows.moving, np.inf)
            inverse = min(inverse, float(room.min(initial=np.inf) ** (1 / rows.order)))
        return float(1.0 / inverse)

    def step(self, nodes: FloatArray, seconds: float, box: float) -> FloatArray | None:
        """The step of the nodes that a linear program finds in a box."""
        matrix, bound = [], []
        for rows in self._rows([matrix @ nodes for matrix in self._matrices], derivatives=True):
            moving = rows.moving / seconds**rows.order
            value = rows.at_rest + moving
            near = value >= _ACTIVE_ROW_SHARE * rows.bound
            by_nodes = rows.d_rest + rows.d_moving / seconds**rows.order
            scale = rows.bound[near]
            matrix.append(np.column_stack([by_nodes[near], -rows.order * moving[near]]) / scale[:, None])
            bound.append(1 - value[near] / scale)
        # It goes forward all the way.
        matrix.append(np.column_stack([-self._matrices[1], np.zeros(len(self._matrices[1]))]))
        bound.append(self._matrices[1] @ nodes)
        return _step_within(
            np.vstack(matrix), np.concatenate(bound), self._space.matrix, self._space.missing(nodes), box
        )

    def _rows(self, d: list[FloatArray], *, derivatives: bool) -> Iterator[_Rows]:
        """The rows of a law, with or without derivatives by the nodes."""
        s = np.clip(d[0], 0.0, 1.0)
        for one in self._bounded:
            powers, by_law = _powers(one.order, d)
            factors = [term(s) for term in one.terms]
            moving = _combined(factors, powers)
            rest = np.zeros_like(moving) if one.offset is None else one.offset(s)
            d_moving = d_rest = np.zeros((*moving.shape, 0))
            if derivatives:
                slopes = [term(s, 1) for term in one.terms]
                by_s = _combined(slopes, powers)
                d_moving = by_s[..., None] * self._matrices[0][:, None]
                for factor, parts in zip(factors, by_law, strict=True):
                    for order, part in parts.items():
                        by_order = (factor * part[:, None])[..., None]
                        d_moving = d_moving + by_order * self._matrices[order][:, None]
                d_rest = np.zeros_like(d_moving)
                if one.offset is not None:
                    d_rest = one.offset(s, 1)[..., None] * self._matrices[0][:, None]
            if one.norm:
                yield from self._norms(one, rest, moving, d_rest, d_moving)
                continue
            for sign in (1.0, -1.0):
                yield _Rows(
                    order=one.order,
                    at_rest=(sign * rest).ravel(),
                    moving=(sign * moving).ravel(),
                    bound=np.broadcast_to(one.bound, moving.shape).ravel(),
                    d_rest=(sign * d_rest).reshape(moving.size, -1),
                    d_moving=(sign * d_moving).reshape(moving.size, -1),
                )

    @staticmethod
    def _norms(
        one: Bounded, rest: FloatArray, moving: FloatArray, d_rest: FloatArray, d_moving: FloatArray
    ) -> Iterator[_Rows]:
        """Norms of vectors, by the direction that they have where they reach their bound."""
        square, mixed = (moving**2).sum(axis=1), (rest * moving).sum(axis=1)
        room = one.bound[0] ** 2 - (rest**2).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (-mixed + np.sqrt(np.maximum(mixed**2 + square * room, 0.0))) / square
        share = np.where(np.isfinite(share) & (room > 0), share, 0.0)
        there = rest + share[:, None] * moving
        u = there / np.maximum(np.linalg.norm(there, axis=1, keepdims=True), 1e-300)
        yield _Rows(
            order=one.order,
            at_rest=(u * rest).sum(axis=1),
            moving=(u * moving).sum(axis=1),
            bound=np.full(len(u), one.bound[0]),
            d_rest=np.einsum("nk,nkj->nj", u, d_rest),
            d_moving=np.einsum("nk,nkj->nj", u, d_moving),
        )


def _step_within(
    rows: FloatArray, bound: FloatArray, ends: FloatArray, missing: FloatArray, box: float
) -> FloatArray | None:
    """Return the step (n - 1,) of the nodes that lowers log T most, ``rows @ (step, log T) <= bound``.

    The dual program is solved: it has as many rows as there are nodes, the program itself many times more.
    """
    count = rows.shape[1]
    sides = np.eye(count)
    low, high = np.full(count, box), np.full(count, box)
    low[-1], high[-1] = 1.0, 0.0
    free = np.zeros((len(missing), 1))
    solved = linprog(
        np.concatenate([bound, missing, low, high]),
        A_eq=np.vstack([rows, np.hstack([ends, free]), -sides, sides]).T,
        b_eq=-sides[-1],
        bounds=[*[(0.0, None)] * len(rows), *[(None, None)] * len(missing), *[(0.0, None)] * (2 * count)],
        method="highs-ds",
        options={"presolve": False},
    )
    return np.asarray(solved.eqlin.marginals[:-1]) if solved.status == 0 else None


def _combined(factors: list[FloatArray], powers: list[FloatArray]) -> FloatArray:
    """Sums (N, m) of factors (N, m), each by its power (N,)."""
    each = [factor * power[:, None] for factor, power in zip(factors, powers, strict=True)]
    return np.asarray(np.sum(each, axis=0))


def _powers(order: int, d: list[FloatArray]) -> tuple[list[FloatArray], list[dict[int, FloatArray]]]:
    """What factors of an order stand beside, and its derivatives by those of the law."""
    one = np.ones_like(d[1])
    if order == 1:
        return [d[1]], [{1: one}]
    if order == 2:
        return [d[2], d[1] ** 2], [{2: one}, {1: 2 * d[1]}]
    powers = [d[3], d[1] * d[2], d[1] ** 3]
    return powers, [{3: one}, {1: d[2], 2: d[1]}, {1: 3 * d[1] ** 2}]
