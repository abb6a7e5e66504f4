"""Least squares of what was measured and of the prior together, in units of standard deviations.

Several sheets may have been filled in. A weight may be a little wrong, so its error is estimated with the
stiffness; the same weight has the same error in all sheets.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import least_squares, linear_sum_assignment

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import frequency_slopes
from cmbot.identification.measurements import Measurements
from cmbot.identification.model import DeflectionModel, prior_deviations

# Residual where the arm is too soft to carry itself: such a step is not taken.
_UNSTABLE_RESIDUAL = 1e6
# Modes that a measured frequency may be of; the largest difference of its logarithm from theirs, and that of
# two modes that a record may not tell apart.
_MAX_CANDIDATE_MODES, _MAX_MODE_DIFFERENCE_LOG, _MERGED_MODES_LOG = 16, 0.3, 0.08
_FIT_TOLERANCE, _EVALUATIONS = 1e-7, 100
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
        pairs = [(each.setup.weight_kg, each.setup.weight_sd_kg) for each in sheets]
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
            for sheet in self._sheets:
                sheet.match(self.prior * x[: len(self.prior)])
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

        size = len(at(start)[0])

        def residual(x: FloatArray) -> FloatArray:
            try:
                return at(x)[0]
            except InputError:
                for sheet in self._sheets:
                    sheet.model.forget()
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
    def unmatched(self) -> tuple[tuple[Label, float], ...]:
        """Frequencies, Hz, that are left out, as no mode of the arm is near."""
        return tuple(each for sheet in self._sheets for each in sheet.unmatched)

    def predicted(self, block: Block) -> FloatArray:
        """Return what a block should have been to have no residual: deflections, m, or frequencies, Hz."""
        return self._sheets[block.label.sheet].without_residual(block)


class _Matched(NamedTuple):
    """Measured frequencies: of which modes (k,), their logarithms (k,) and standard deviations (k,)."""

    modes: IntArray
    log: FloatArray
    share: FloatArray


class _Sheet:
    """The residuals of one file of measurements."""

    def __init__(self, number: int, given: Measurements, model: DeflectionModel, weight: int | None) -> None:
        self._number, self._given, self._weight = number, given, weight
        self.model = model
        self._white = [
            whitener(noise, ~np.isnan(d)) for noise, d in zip(model.noise, given.deflection, strict=True)
        ]
        self.deflects = bool(np.isfinite(given.deflection).any())
        self.vibrates = any(len(f) for f in given.frequencies)
        nothing = _Matched(np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros(0))
        self._matched = [nothing] * len(given.q)
        self.unmatched: list[tuple[Label, float]] = []

    def match(self, at: FloatArray) -> None:
        """Find out which mode each measured frequency is of, at parameters (p,)."""
        self.unmatched = []
        shares = self._given.frequency_shares or tuple(map(np.zeros_like, self._given.frequencies))
        for k, (f, own) in enumerate(zip(self._given.frequencies, shares, strict=True)):
            if len(f):
                log, _ = self._frequencies(at, k, _MAX_CANDIDATE_MODES)
                found = _matched(np.log(f), own, log, self._given.setup.frequency_sd_share)
                label = Label("frequencies_hz", self._number, k)
                self.unmatched += [(label, hz) for hz in f.tolist() if np.log(hz) not in found.log]
                self._matched[k] = found

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
            if len(found.modes):
                log, d_log = self._frequencies(at, k, int(found.modes.max()) + 1)
                row = np.zeros((len(found.modes), p + len(by_weights)))
                row[:, :p] = d_log[found.modes] * prior / found.share[:, None]
                residual = (log[found.modes] - found.log) / found.share
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

    def _frequencies(self, at: FloatArray, row: int, count: int) -> tuple[FloatArray, FloatArray]:
        return frequency_slopes(self.model.arm, self.model.parameters, at, self._given.q[row], count)


def _matched(log: FloatArray, own: FloatArray, model: FloatArray, share: float) -> _Matched:
    """Match measured frequencies with the nearest ones of the model, one to one; far ones are left out.

    Of two modes near each other of which one was measured it may be either, or both in one.
    """
    measured, modes = linear_sum_assignment(np.abs(log[:, None] - model))
    near = np.abs(log[measured] - model[modes]) < _MAX_MODE_DIFFERENCE_LOG
    measured, modes = measured[near], modes[near]
    others = np.setdiff1d(np.arange(len(model)), modes)
    gap = np.abs(model[modes][:, None] - model[others]).min(axis=1, initial=np.inf)
    either = np.where(gap < _MERGED_MODES_LOG, 0.5 * gap, 0.0)
    return _Matched(modes, log[measured], np.sqrt(share**2 + own[measured] ** 2 + either**2))


def whitener(noise: FloatArray, seen: BoolArray) -> FloatArray:
    """Return what takes a deflection (3,) to independent numbers (k,) of unit variance, of the seen axes."""
    own = np.eye(3)[np.flatnonzero(seen)]
    if not len(own):
        return own
    return np.asarray(np.linalg.solve(np.linalg.cholesky(own @ noise @ own.T), own))
