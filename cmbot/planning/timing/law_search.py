"""The shortest time law along a joint path: third order, by sequential linear programs.

A law is the share of a leg that is covered over the share of its duration T. Its third derivative is linear
between equally spaced nodes and zero at the ends, so a joint path q(s) in C3 makes a motion in C3 from rest
to rest. Along the path, with primes for derivatives by the share and dots for those of the law,

    |q' s.| <= V T,    |q'' s.^2 + q' s..| <= A T^2,    |q''' s.^3 + 3 q'' s. s.. + q' s...| <= J T^3,
    |g + (m s.. + c s.^2) / T^2| <= torque,

where g, m and c are functions of s alone. For a given law the least T is the largest root of these rows. It
is minimised over the nodes: a linear program in the nodes and log T around the law before, in a box that
shrinks where T does not fall as it promises. Of each function a program has a row where it is worst in each
short stretch: so no peak between coarse points is overlooked. In time there is no singularity where the tool
rests, as there is in s. The optimum is a vertex, as bang-bang laws are, and there such programs converge
quadratically.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, compress

import numpy as np
from scipy import sparse
from scipy.interpolate import PPoly
from scipy.optimize import linprog

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.toolpath import TimeLaw

# Points per phase at which the duration is taken, and stretches of each whose worst point a program has.
_POINTS_PER_PHASE, _ROWS_PER_PHASE = 12, 4
# Programs at most, and from each start before the best goes on; least gain of one; the box at first and last,
# as a share of the largest node.
_MAX_PROGRAMS, _FIRST_PROGRAMS, _LEAST_GAIN, _BOX, _SMALLEST_BOX = 60, 8, 5e-4, 0.5, 1e-3
# The box shrinks where less than this share of what a program promises is gained, and grows above the other.
_SHRINK, _EXPAND = 0.1, 0.6
# A law of so many phases is sought from one of half of them.
_MIN_REFINED_PHASES = 24
# Points of any other law.
_LAW_POINTS = 721
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
    """Rows ``at_rest + moving / T^k <= bound`` of one bounded function, R of them at each of N points.

    Each is a sum of the function's m components by `weights`.
    """

    at_rest: FloatArray  # (N, R)
    moving: FloatArray  # (N, R)
    bound: FloatArray  # (R,)
    weights: FloatArray  # (R, m), or (N, 1, m) for a norm


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

    def like(self, jerk: FloatArray) -> FloatArray:
        """The inner nodes (K - 1,) of a law from rest to rest that is nearest to one with some jerk (k,).

        Nearest to none, the smoothest law is in the middle of all.
        """
        shares = np.linspace(0.0, 1.0, self.phases + 1)[1:-1]
        nodes = np.interp(shares, np.linspace(0.0, 1.0, len(jerk)), jerk)
        return np.asarray(nodes + np.linalg.lstsq(self.matrix, self.missing(nodes), rcond=None)[0])

    def missing(self, nodes: FloatArray) -> FloatArray:
        """What nodes miss of a law from rest to rest, (3,)."""
        return self.target - self.matrix @ nodes


@dataclass(frozen=True, kw_only=True, eq=False)
class LawSearch:
    """What the shortest law is sought for.

    Attributes
    ----------
    bounded : sequence of Bounded
    phases : int
        K, at least 6.
    known : sequence of (k,)
        Jerk at the nodes of laws in which the search begins. Without them it begins with the smoothest law
        and with one of half the phases: programs find the optimum nearest to where they begin.
    """

    bounded: Sequence[Bounded]
    phases: int
    known: Sequence[FloatArray] = ()


def shortest_laws(searches: Sequence[LawSearch]) -> list[tuple[FloatArray, float]]:
    """Return of each search the jerk (K + 1,) at the nodes, by shares of time, and the duration, s.

    The duration is infinite where a bound is exceeded at rest. All are sought at once: a few large linear
    programs take less time than many small ones.
    """
    # From few nodes programs get further.
    refined = [not each.known and each.phases >= _MIN_REFINED_PHASES for each in searches]
    coarse = [replace(each, phases=each.phases // 2) for each in compress(searches, refined)]
    halved = iter(shortest_laws(coarse) if coarse else ())
    descents = list[list[_Descent]]()
    for each, is_refined in zip(searches, refined, strict=True):
        laws = each.known or [np.zeros(2), *([next(halved)[0]] if is_refined else [])]
        points = _Points(each.phases, each.bounded)
        descents.append([_Descent(points, jerk) for jerk in laws])
    _descend(list(chain(*descents)), _FIRST_PROGRAMS)
    best = [min(some, key=lambda descent: descent.seconds) for some in descents]
    _descend(best, _MAX_PROGRAMS)
    return [(np.concatenate([[0.0], each.nodes, [0.0]]), each.seconds) for each in best]


def least_seconds(bounded: Sequence[Bounded], law: TimeLaw) -> float:
    """Return the least duration of a law within bounds, s; infinite where one is exceeded at rest."""
    u = np.linspace(0.0, 1.0, _LAW_POINTS)
    d = [law.share(u), *(law.rate(u, order) for order in (1, 2, 3))]
    return _Points(1, bounded).least(d)


class _Descent:
    """What linear programs, one after the other, find from a law of some jerk (k,) on."""

    def __init__(self, points: _Points, jerk: FloatArray) -> None:
        self._points, self._box = points, _BOX
        self.nodes = points.space.like(jerk)
        self.seconds = points.seconds(self.nodes)
        self.ended = not np.isfinite(self.seconds)

    def program(self) -> tuple[FloatArray, FloatArray]:
        """The next program, as of `_Points`."""
        return self._points.program(self.nodes, self.seconds, self._box * np.abs(self.nodes).max())

    def take(self, step: FloatArray, promised: float) -> None:
        """Take a step of the nodes that promises so much of log T, if the duration falls."""
        trial = self._points.seconds(self.nodes + step)
        gained = 1 - trial / self.seconds
        if gained < _SHRINK * promised:
            self._box /= 4
        elif gained > _EXPAND * promised:
            self._box = min(2 * self._box, _BOX)
        if gained > 0:
            self.nodes, self.seconds = self.nodes + step, trial
        self.ended = promised < _LEAST_GAIN or self._box < _SMALLEST_BOX or 0 < gained < _LEAST_GAIN


def _descend(descents: Sequence[_Descent], programs: int) -> None:
    """Solve so many programs of each, or fewer where nothing more is gained."""
    for _ in range(programs):
        if not (going := [each for each in descents if not each.ended]):
            return
        for each, found in zip(going, _solved([each.program() for each in going]), strict=True):
            each.take(*found)


class _Points:
    """Rows at equally spaced points of a law's time."""

    def __init__(self, phases: int, bounded: Sequence[Bounded]) -> None:
        self.space, self._bounded = _Nodes(phases), bounded
        self._matrices = self.space.at(np.linspace(0.0, 1.0, phases * _POINTS_PER_PHASE + 1))

    def seconds(self, nodes: FloatArray) -> float:
        """The least duration of a law, s."""
        s, rate = (matrix @ nodes for matrix in self._matrices[:2])
        if rate.min() < -1e-9 or s.max() > 1 + 1e-9:
            return float(np.inf)
        return self.least([matrix @ nodes for matrix in self._matrices])

    def least(self, d: list[FloatArray]) -> float:
        """The least duration, s, of a law that is `d`, with its derivatives, at some points."""
        inverse = np.inf  # of the duration
        for one in self._bounded:
            rows = _rows_of(one, d)
            if (rows.at_rest >= rows.bound).any():
                return float(np.inf)
            with np.errstate(divide="ignore", invalid="ignore"):
                room = np.where(rows.moving > 0, (rows.bound - rows.at_rest) / rows.moving, np.inf)
            inverse = min(inverse, float(room.min(initial=np.inf) ** (1 / one.order)))
        return float(1.0 / inverse)

    def program(self, nodes: FloatArray, seconds: float, box: float) -> tuple[FloatArray, FloatArray]:
        """Costs (k,) and matrix (n, k) of the program dual to that of a step which lowers log T most.

        That is over the step (n - 1,) of the nodes, in a box, and the change of log T; the law goes from rest
        to rest. The dual has as many rows as there are nodes, the program itself many times more.
        """
        d = [matrix @ nodes for matrix in self._matrices]
        # It goes forward all the way.
        back, _ = self._worst(-d[1][:, None], -np.inf)
        matrix = [np.column_stack([-self._matrices[1][back], np.zeros(len(back))])]
        bound = [d[1][back]]
        for one in self._bounded:
            rows = _rows_of(one, d)
            moving = rows.moving / seconds**one.order
            use = (rows.at_rest + moving) / rows.bound
            at, row = self._worst(use, _ACTIVE_ROW_SHARE)
            scale = rows.bound[row]
            weights = rows.weights[at, 0] if one.norm else rows.weights[row]
            by_nodes = self._slopes(one, d, at, weights, seconds)
            matrix.append(np.column_stack([by_nodes, -one.order * moving[at, row]]) / scale[:, None])
            bound.append(1 - use[at, row])
        ends = np.pad(self.space.matrix, ((0, 0), (0, 1)))
        missing, sides = self.space.missing(nodes), np.eye(len(nodes) + 1)
        low, high = np.append(np.full(len(nodes), box), 1.0), np.append(np.full(len(nodes), box), 0.0)
        costs = np.concatenate([*bound, missing, -missing, low, high])
        return costs, np.vstack([*matrix, ends, -ends, -sides, sides]).T

    def _worst(self, use: FloatArray, least: float) -> tuple[IntArray, IntArray]:
        """Points and rows at which `use` (N, R) is largest for a while, where that is at least so much."""
        apart = _POINTS_PER_PHASE // _ROWS_PER_PHASE
        stretches = use[:-1].reshape(-1, apart, use.shape[1])
        at = stretches.argmax(axis=1) + apart * np.arange(len(stretches))[:, None]
        near, row = np.nonzero(np.take_along_axis(use, at, axis=0) >= least)
        return at[near, row], row

    def _slopes(
        self, one: Bounded, d: list[FloatArray], at: IntArray, weights: FloatArray, seconds: float
    ) -> FloatArray:
        """Derivatives (R, K - 1) by the nodes of a bounded function's sums by weights (R, m), at R points."""
        s = np.clip(d[0][at], 0.0, 1.0)
        powers, by_law = _powers(one.order, [each[at] for each in d])

        def summed(term: Callable[..., FloatArray], order: int = 0) -> FloatArray:
            return np.asarray((weights * term(s, order)).sum(axis=1))

        parts = np.zeros((4, len(at)))
        for term, power, by_order in zip(one.terms, powers, by_law, strict=True):
            parts[0] += summed(term, 1) * power
            factor = summed(term)
            for order, part in by_order.items():
                parts[order] += factor * part
        parts /= seconds**one.order
        if one.offset is not None:
            parts[0] += summed(one.offset, 1)
        each = [part[:, None] * matrix[at] for part, matrix in zip(parts, self._matrices, strict=True)]
        return np.asarray(np.sum(each, axis=0))


def _rows_of(one: Bounded, d: list[FloatArray]) -> _Rows:
    """The rows of a bounded function along a law that is `d`, with its derivatives, at some points."""
    s = np.clip(d[0], 0.0, 1.0)
    powers, _ = _powers(one.order, d)
    moving = np.sum([term(s) * power[:, None] for term, power in zip(one.terms, powers, strict=True)], axis=0)
    rest = np.zeros_like(moving) if one.offset is None else one.offset(s)
    if not one.norm:
        signs = np.eye(moving.shape[1])
        return _Rows(
            at_rest=np.hstack([rest, -rest]),
            moving=np.hstack([moving, -moving]),
            bound=np.tile(one.bound, 2),
            weights=np.vstack([signs, -signs]),
        )
    # By the direction that it has where it reaches its bound.
    square, mixed = (moving**2).sum(axis=1), (rest * moving).sum(axis=1)
    room = one.bound[0] ** 2 - (rest**2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (-mixed + np.sqrt(np.maximum(mixed**2 + square * room, 0.0))) / square
    share = np.where(np.isfinite(share) & (room > 0), share, 0.0)
    there = rest + share[:, None] * moving
    u = (there / np.maximum(np.linalg.norm(there, axis=1, keepdims=True), 1e-300))[:, None]
    return _Rows(
        at_rest=(u * rest[:, None]).sum(axis=2),
        moving=(u * moving[:, None]).sum(axis=2),
        bound=one.bound,
        weights=u,
    )


def _solved(duals: Sequence[tuple[FloatArray, FloatArray]]) -> list[tuple[FloatArray, float]]:
    """Return of each program the step (n - 1,) of the nodes, and by how much it lowers log T."""
    sizes = [len(matrix) for _, matrix in duals]
    solved = linprog(
        np.concatenate([cost for cost, _ in duals]),
        A_eq=sparse.block_diag([matrix for _, matrix in duals], format="csc"),
        b_eq=np.concatenate([-np.eye(size)[-1] for size in sizes]),
        method="highs-ds",
        options={"presolve": False},
    )
    if solved.status == 0:
        worth = np.split(solved.eqlin.marginals, np.cumsum(sizes)[:-1])
        return [(each[:-1], -each[-1]) for each in worth]
    if len(duals) == 1:
        return [(np.zeros(sizes[0] - 1), 0.0)]
    # One that is not solved is no matter of the others.
    half = len(duals) // 2
    return [*_solved(duals[:half]), *_solved(duals[half:])]


def _powers(order: int, d: list[FloatArray]) -> tuple[list[FloatArray], list[dict[int, FloatArray]]]:
    """What factors of an order stand beside, and its derivatives by those of the law."""
    one = np.ones_like(d[1])
    if order == 1:
        return [d[1]], [{1: one}]
    if order == 2:
        return [d[2], d[1] ** 2], [{2: one}, {1: 2 * d[1]}]
    powers = [d[3], d[1] * d[2], d[1] ** 3]
    return powers, [{3: one}, {1: d[2], 2: d[1]}, {1: 3 * d[1] ** 2}]
