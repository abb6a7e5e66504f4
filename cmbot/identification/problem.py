"""Least squares of what was measured and of the prior together, in units of standard deviations.

Several sheets may have been filled in. A weight may be a little wrong, so its error is estimated with the
stiffness; the same weight has the same error in all sheets.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import OptimizeResult, least_squares, linear_sum_assignment

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import InputError
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import MIXED_MODES_LOG, arm_modes, frequency_slopes
from cmbot.identification.measurements import Measurements
from cmbot.identification.model import DeflectionModel, prior_deviations
from cmbot.identification.records import RingDown

# Residual where the arm is too soft to carry itself: such a step is not taken.
_UNSTABLE_RESIDUAL = 1e6
# Modes that a measured frequency may be of; the largest difference of its logarithm from theirs; the standard
# deviation of the direction in which a mode moves the tool; and the least probability of a mode that counts.
_MAX_CANDIDATE_MODES, _MAX_MODE_DIFFERENCE_LOG, _DIRECTION_SD, _LEAST_PROBABILITY = 16, 0.3, 0.25, 0.01
# The square of a distance in standard deviations that no match has.
_UNMATCHED = 1e6
# Probability from which a mode is told apart from others, and the cosine of shapes that are one.
_TOLD_APART, _SAME_SHAPE = 0.9, 0.95
# Modes mix whose frequencies differ by less than so many standard deviations of that; the share of the
# squares of their ways that keeps combinations small; the standard deviation of a mode's share in one.
_MIXED_SIGMAS, _RIDGE, _MIX_SD = 2.0, 0.01, 0.1
_FIT_TOLERANCE, _EVALUATIONS = 1e-7, 100
# A fit ends where so many steps leave this share of its cost, and residuals so many standard deviations large
# in the mean: no stiffness makes up for what is wrong then.
_HOPELESS_STEPS, _HOPELESS_SHARE, _HOPELESS_SIGMAS = 10, 0.8, 20.0
# Residual beyond which the robust loss is linear.
_HUBER_SIGMAS = 2.0

Kind = Literal["deflection_mm", "frequencies_hz", "prior"]


class Label(NamedTuple):
    """Which residuals: of one kind, of one row of one sheet; -1 where there is none."""

    kind: Kind
    sheet: int = -1
    row: int = -1


class Block(NamedTuple):
    """Residuals (k,) in units of their stated standard deviations, and derivatives (k, p + w)."""

    label: Label
    residual: FloatArray
    slope: FloatArray


class MatchedFrequency(NamedTuple):
    """A measured frequency: its row, Hz, damping ratio and standard deviation, and the modes it may be of.

    These, the likeliest first, are counted from 1, the slowest; with their probabilities, and their
    frequencies, Hz, as predicted without it. Empty: none is near. `told_apart` says whether it is plain which
    one it is, or, where several mix, which mixture.
    """

    label: Label
    frequency: float
    damping: float
    damping_deviation: float
    modes: tuple[int, ...]
    probabilities: tuple[float, ...]
    predicted: tuple[float, ...]
    told_apart: bool


class Problem:
    """Unknown are the parameters (p,) and the errors of w weights, in units of their prior deviations.

    Attributes
    ----------
    prior : (p,)
        Standard deviations of the parameters before.
    weights : tuple of (float, float)
        The weights whose errors are unknown, kg, and their standard deviations.
    scale : dict of Kind to float
        By which standard deviations are taken to be larger than stated.
    left_out : set of Label
        What does not count.
    """

    def __init__(self, sheets: Sequence[Measurements], modelled: ElasticArm) -> None:
        pairs = [
            (each.setup.weight_kg, each.setup.weight_sd_kg * bool(np.isfinite(each.deflection).any()))
            for each in sheets
        ]
        self.weights = tuple(dict.fromkeys(pair for pair in pairs if pair[1]))
        columns = [self.weights.index(pair) if pair[1] else None for pair in pairs]
        models = [DeflectionModel(modelled, each.setup, each.q) for each in sheets]
        self.parameters = models[0].parameters
        self.prior = prior_deviations(self.parameters, sheets[0].setup.prior)
        self.count = len(self.prior) + len(self.weights)
        self.scale: dict[Kind, float] = {"deflection_mm": 1.0, "frequencies_hz": 1.0, "prior": 1.0}
        self.left_out = set[Label]()
        self._sheets = [
            _Sheet(number, *each) for number, each in enumerate(zip(sheets, models, columns, strict=True))
        ]

    def first(self, *, robust: bool = False) -> FloatArray:
        """Estimate the unknowns: frequencies alone end in wrong minima, so first from the deflections.

        With `robust`, residuals count linearly beyond some standard deviations: wrong ones pull less.
        """
        x = np.zeros(self.count)
        if any(sheet.deflects for sheet in self._sheets):
            x = self.solved(x, with_frequencies=False, robust=robust)
        if any(sheet.vibrates for sheet in self._sheets):
            p = len(self.prior)
            spread = self.covariance(self.blocks(x, with_frequencies=False))[:p, :p]
            for sheet in self._sheets:
                sheet.match(self.prior * x[:p], spread * np.outer(self.prior, self.prior))
            x = self.solved(x, robust=robust)
        return x

    def solved(self, start: FloatArray, *, with_frequencies: bool = True, robust: bool = False) -> FloatArray:
        """Estimate the unknowns from `start`."""
        known: dict[bytes, tuple[FloatArray, FloatArray]] = {}

        def at(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            key = x.tobytes()
            if key not in known:
                known.clear()
                known[key] = self.stacked(self.blocks(x, with_frequencies=with_frequencies))
            return known[key]

        size, costs = len(at(start)[0]), list[float]()

        def end_if_hopeless(intermediate_result: OptimizeResult) -> None:
            costs.append(intermediate_result.cost)
            least = max(_HOPELESS_SHARE * costs[-1 - _HOPELESS_STEPS :][0], 0.5 * size * _HOPELESS_SIGMAS**2)
            if len(costs) > _HOPELESS_STEPS and costs[-1] > least:
                raise StopIteration

        def residual(x: FloatArray) -> FloatArray:
            try:
                return at(x)[0]
            except InputError:
                return np.full(size, _UNSTABLE_RESIDUAL)

        found = least_squares(
            residual,
            start,
            jac=lambda x: at(x)[1],
            loss="soft_l1" if robust else "linear",
            f_scale=_HUBER_SIGMAS,
            xtol=_FIT_TOLERANCE,
            ftol=_FIT_TOLERANCE,
            gtol=_FIT_TOLERANCE,
            max_nfev=_EVALUATIONS,
            callback=end_if_hopeless,
        )
        return np.asarray(found.x)

    def blocks(self, x: FloatArray, *, with_frequencies: bool = True) -> list[Block]:
        """Return all residuals as stated, also those left out, the prior's last."""
        p = len(self.prior)
        each = [
            block
            for sheet in self._sheets
            for block in sheet.blocks(self.prior, self.prior * x[:p], x[p:])
            if with_frequencies or block.label.kind != "frequencies_hz"
        ]
        return [*each, Block(Label("prior"), x, np.eye(self.count))]

    def stacked(self, blocks: Sequence[Block]) -> tuple[FloatArray, FloatArray]:
        """Return the residuals that count (m,), in units of the scaled deviations, and derivatives."""
        kept = [(each, 1 / self.scale[each.label.kind]) for each in blocks if each.label not in self.left_out]
        residual = np.concatenate([by * block.residual for block, by in kept])
        return residual, np.concatenate([by * block.slope for block, by in kept])

    def covariance(self, blocks: Sequence[Block]) -> FloatArray:
        """Return that of the unknowns (p + w, p + w)."""
        _, J = self.stacked(blocks)
        return np.asarray(np.linalg.inv(J.T @ J))

    @property
    def matched(self) -> tuple[MatchedFrequency, ...]:
        """All measured frequencies, with the modes that they were given to."""
        return tuple(each for sheet in self._sheets for each in sheet.matches)

    def predicted(self, block: Block) -> FloatArray:
        """Return what a block should have been to have no residual: deflections, m, or frequencies, Hz."""
        return self._sheets[block.label.sheet].without_residual(block)


class _Matched(NamedTuple):
    """Measured frequencies: their logarithms (k,) and standard deviations (k,), and what they are of.

    Shapes (f, c) of modes, and the probability (k, c) of each.
    """

    log: FloatArray
    share: FloatArray
    shapes: FloatArray
    weight: FloatArray


class _Sheet:
    """The residuals of one file of measurements."""

    def __init__(self, number: int, given: Measurements, model: DeflectionModel, weight: int | None) -> None:
        self._number, self._given, self._weight = number, given, weight
        self.model = model
        self._white = [
            whitener(noise, ~np.isnan(d)) for noise, d in zip(model.noise, given.deflection, strict=True)
        ]
        self.deflects = bool(np.isfinite(given.deflection).any())
        self._modes = given.modes or (RingDown.at(()),) * len(given.q)
        self.vibrates = any(len(each.frequencies) for each in self._modes)
        nothing = np.zeros(0)
        self._matched = [_Matched(nothing, nothing, nothing, nothing)] * len(given.q)
        self.matches: list[MatchedFrequency] = []

    def match(self, at: FloatArray, covariance: FloatArray) -> None:
        """Find out which modes each measured frequency is of, at parameters (p,) of a covariance (p, p).

        That is told by frequencies and, where it is known along which axes a record is, by the direction in
        which a mode moves the tool. Where both may be of either, what is known is their mean.
        """
        self.matches = []
        for row, seen in enumerate(self._modes):
            if len(seen.frequencies):
                self._match(row, seen, at, covariance)

    def _match(self, row: int, seen: RingDown, at: FloatArray, covariance: FloatArray) -> None:
        f, own_variance = np.log(seen.frequencies), self._given.setup.frequency_sd_share**2 + seen.shares**2
        each = list(self._candidates(row, seen, at, covariance))
        cost = np.array(
            [
                np.where(
                    np.abs(log - known.log) < _MAX_MODE_DIFFERENCE_LOG,
                    (log - known.log) ** 2 / (np.diag(known.spread) + variance)
                    + known.turned / _DIRECTION_SD**2,
                    _UNMATCHED,
                )
                for log, variance, known in zip(f, own_variance, each, strict=True)
            ]
        )
        weight = _probabilities(cost)
        near = weight.any(axis=1)
        variance = own_variance + [known.variance(own) for known, own in zip(each, weight, strict=True)]
        for i, (known, own) in enumerate(zip(each, weight, strict=True)):
            likely = [k for k in np.argsort(-own).tolist() if own[k] > 0]
            self.matches.append(
                MatchedFrequency(
                    label=Label("frequencies_hz", self._number, row),
                    frequency=float(seen.frequencies[i]),
                    damping=float(seen.damping[i]),
                    damping_deviation=float(seen.damping_deviations[i]),
                    modes=tuple(k + 1 for k in likely),
                    probabilities=tuple(own[likely].tolist()),
                    predicted=tuple(np.exp(known.log[likely]).tolist()),
                    told_apart=known.told_apart(own),
                )
            )
        self._matched[row] = _Matched(
            f[near],
            np.sqrt(variance[near]),
            np.hstack([known.shapes for known in each]),
            block_diag(*weight)[near],
        )

    def _candidates(
        self, row: int, seen: RingDown, at: FloatArray, covariance: FloatArray
    ) -> Iterator[_Candidates]:
        """Of each measured frequency the slowest modes.

        Modes that may mix, as stiffness is not known better, are combined to what moves the tool as the
        record says.
        """
        arm = replace(self.model.arm, stiffness=self.model.parameters.stiffness(at))
        modes, axes = arm_modes(arm, self._given.q[row]), self._given.setup.record_axes
        shapes = modes.shapes[:, :_MAX_CANDIDATE_MODES]
        log, slope = self._frequencies(at, row, shapes)
        spread, nothing = slope @ covariance @ slope.T, np.zeros(len(log))
        gap, variance = log - log[:, None], np.diag(spread)
        apart = variance + variance[:, None] - 2 * spread
        mix = gap**2 < np.maximum(_MIXED_SIGMAS**2 * apart, MIXED_MODES_LOG**2)
        mix &= np.abs(gap) < _MAX_MODE_DIFFERENCE_LOG
        q = arm.configuration(self._given.q[row], modes.u)
        X_WT, J = arm.tool_jacobian(q, arm.model.createData())
        moves = (X_WT.rotation.T if axes == "tool" else np.eye(3)) @ J[:3, arm.elastic] @ shapes
        for direction in seen.directions:
            along = ~np.isnan(direction)
            if axes is None or along.sum() < 2:
                yield _Candidates(shapes, nothing, log, spread, nothing)
                continue
            mixed = np.column_stack([_towards(direction[along], moves[along], near) for near in mix])
            way = moves[along] @ mixed
            cosine = direction[along] @ way / np.maximum(np.linalg.norm(way, axis=0), 1e-300)
            own_log, own_slope = self._frequencies(at, row, shapes @ mixed)
            unsure = _MIX_SD * np.sqrt(np.einsum("jk,jk->k", mixed**2, gap**2))
            yield _Candidates(
                shapes @ mixed, 1 - cosine**2, own_log, own_slope @ covariance @ own_slope.T, unsure
            )

    def blocks(self, prior: FloatArray, at: FloatArray, by_weights: FloatArray) -> Iterator[Block]:
        given, setup, p = self._given, self._given.setup, len(prior)
        deflection, slope = self.model.at(at)
        for k, W in enumerate(self._white):
            d = deflection[k]
            row = np.zeros((len(W), p + len(by_weights)))
            row[:, :p] = W @ (slope[k] * prior)
            if self._weight is not None:
                # A deflection is nearly proportional to its weight, whose error is small.
                by_weight = d * (setup.weight_sd_kg / setup.weight_kg)
                row[:, p + self._weight] = W @ by_weight
                d = d + by_weight * by_weights[self._weight]
            if len(W):
                residual = W @ (d - np.nan_to_num(given.deflection[k]))
                yield Block(Label("deflection_mm", self._number, k), residual, row)
            found = self._matched[k]
            if len(found.log):
                log, d_log = self._frequencies(at, k, found.shapes)
                row = np.zeros((len(found.log), p + len(by_weights)))
                row[:, :p] = found.weight @ d_log * prior / found.share[:, None]
                residual = (found.weight @ log - found.log) / found.share
                yield Block(Label("frequencies_hz", self._number, k), residual, row)

    def without_residual(self, block: Block) -> FloatArray:
        k = block.label.row
        if block.label.kind == "frequencies_hz":
            found = self._matched[k]
            return np.asarray(np.exp(found.log + block.residual * found.share))
        measured = self._given.deflection[k]
        seen = ~np.isnan(measured)
        off = np.linalg.solve(self._white[k][:, seen], block.residual)
        return np.asarray(measured[seen] + off)

    def _frequencies(self, at: FloatArray, row: int, shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
        # What moves the tool as a record says stays the combination that it is.
        mixed = MIXED_MODES_LOG if self._given.setup.record_axes is None else _MAX_MODE_DIFFERENCE_LOG
        model = self.model
        return frequency_slopes(model.arm, model.parameters, at, self._given.q[row], shapes, mixed)


class _Candidates(NamedTuple):
    """Modes that a frequency may be of.

    Shapes (f, c), squared sines (c,) of the angles by which they move the tool elsewhere than it did, and
    logarithms (c,) of their frequencies with the covariance (c, c) and the deviations (c,) by what is mixed.
    """

    shapes: FloatArray
    turned: FloatArray
    log: FloatArray
    spread: FloatArray
    unsure: FloatArray

    def variance(self, weight: FloatArray) -> float:
        """That of the logarithm of one of them, by probabilities (c,), about the mean of all."""
        apart = np.eye(len(weight)) - weight
        own = (apart @ self.log) ** 2 + np.einsum("ij,jk,ik->i", apart, self.spread, apart)
        return float(weight @ (own + self.unsure**2))

    def told_apart(self, weight: FloatArray) -> bool:
        """Whether those of the likeliest one's shape have most of the probability (c,)."""
        units = self.shapes / np.linalg.norm(self.shapes, axis=0)
        same = np.abs(units.T @ units[:, weight.argmax()]) > _SAME_SHAPE
        return bool(weight[same].sum() >= _TOLD_APART)


def _towards(direction: FloatArray, moves: FloatArray, near: BoolArray) -> FloatArray:
    """The combination (c,) of some modes, of unit length, that moves the tool most nearly in a direction."""
    P, found = moves[:, near], np.where(near, 1.0, 0.0)
    G = P.T @ P
    # Modes that do not move it stay a mixture of all.
    if (towards := P.T @ direction).any():
        found[near] = np.linalg.solve(G + _RIDGE * np.trace(G) * np.eye(len(G)), towards)
    return np.asarray(found / np.linalg.norm(found))


def _probabilities(cost: FloatArray) -> FloatArray:
    """Of modes (k, c) that k frequencies are of, each of another, by twice the negative logarithm of each.

    To first order: beside each pair the others are matched best.
    """
    total = np.full(cost.shape, np.inf)
    for i, j in np.argwhere(cost < _UNMATCHED):
        others = np.delete(np.delete(cost, i, axis=0), j, axis=1)
        total[i, j] = cost[i, j] + others[linear_sum_assignment(others)].sum()
    least = total.min(axis=1, keepdims=True)
    weight = np.exp(-(total - np.where(np.isfinite(least), least, 0.0)) / 2)
    weight[weight < _LEAST_PROBABILITY] = 0.0
    return np.asarray(weight / np.maximum(weight.sum(axis=1, keepdims=True), _LEAST_PROBABILITY))


def whitener(noise: FloatArray, seen: BoolArray) -> FloatArray:
    """Return what takes a deflection (3,) to independent numbers (k,) of unit variance, of the seen axes."""
    own = np.eye(3)[np.flatnonzero(seen)]
    if not len(own):
        return own
    return np.asarray(np.linalg.solve(np.linalg.cholesky(own @ noise @ own.T), own))
