"""Misfit of measurements and model: its probability, the rows that are outliers, and the errors to be taken.

At the estimate the residuals r of a part of the least squares have the covariance ``B = I - H``, in units of
their standard deviations, with the leverage ``H = J A J'`` and the covariance A of the unknowns. So their sum
of squares has the mean ``trace B``, the redundancy, and is about ``c chi2(h)`` with the same mean and
variance (Satterthwaite, 1946). A part that is larger than chance allows has its standard deviations scaled
until it is as large as its redundancy: the estimation of variance components (Helmert, 1907; Foerstner,
1979). The prior is one of the parts, so an arm that is far from its model is told from wrong measurements.

Before that single rows are sought that stand out (data snooping; Baarda, 1968): the one with the largest
studentised residual at a robust estimate is left out, and the next, until the rest fit. The row is
then compared with what these predict of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, f as fisher

from cmbot.common.arrays import FloatArray
from cmbot.identification.problem import Block, Kind, Label, Problem

# Probability of a larger misfit below which a part is doubted.
_DOUBT_LEVEL = 0.01
# That of a row, among all of them, below which it is wrong.
_OUTLIER_LEVEL = 1e-5
# Share of the rows that may be wrong ones.
_MAX_OUTLIER_SHARE = 1 / 3
# Of a prior beside which nothing was measured.
_NO_REDUNDANCY = 1e-9
# Rounds in which scales are found, and by what share a part may still be off.
_MAX_SCALE_ROUNDS, _SCALE_TOLERANCE_SHARE = 20, 0.02


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the sum of squared residuals.

    Attributes
    ----------
    kind : str
        ``deflection_mm``, ``frequencies_hz`` or ``prior``.
    square : float
        In units of the stated standard deviations.
    redundancy : float
        What it is on average.
    probability : float
        Of a larger one.
    scale : float
        By which the standard deviations are taken to be larger than stated.
    """

    kind: Kind
    square: float
    redundancy: float
    probability: float
    scale: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Slip:
    """A row that does not fit the others.

    Attributes
    ----------
    label : Label
    expected : (k,)
        Predicted by the others: of a deflection the components that were measured, m, or frequencies, Hz.
    deviations : float
        How far it is from that, in standard deviations of both, as large as the others scatter.
    probability : float
        That one of as many rows is as far by chance.
    """

    label: Label
    expected: FloatArray
    deviations: float
    probability: float

    @property
    def significant(self) -> bool:
        """Whether it is too improbable to be noise."""
        return self.probability < _OUTLIER_LEVEL


def parts(problem: Problem, x: FloatArray) -> tuple[Part, ...]:
    """Return the parts of the sum of squares at an estimate, in units of the scaled deviations."""
    return _parts(problem, problem.blocks(x))


def _parts(problem: Problem, blocks: Sequence[Block]) -> tuple[Part, ...]:
    A, found = problem.covariance(blocks), list[Part]()
    for kind in problem.scale:
        own = [block for block in blocks if block.label.kind == kind and block.label not in problem.left_out]
        if not own:
            continue
        r, J = problem.stacked(own)
        leverage = A @ J.T @ J
        mean = len(r) - float(np.trace(leverage))
        if mean < _NO_REDUNDANCY:
            continue
        variance = len(r) - 2 * float(np.trace(leverage)) + float(np.trace(leverage @ leverage))
        square = float(r @ r)
        probability = float(chi2.sf(square * mean / variance, mean**2 / variance))
        scale = problem.scale[kind]
        found.append(Part(kind=kind, square=square, redundancy=mean, probability=probability, scale=scale))
    return tuple(found)


def rescaled(problem: Problem, x: FloatArray, *, only_prior: bool = False) -> FloatArray:
    """Scale the parts that are larger than chance allows, the worst first, and return the estimate then.

    With `only_prior` the prior alone, unless what was measured fits worse.
    """
    doubted = set[Kind]()
    for _ in range(_MAX_SCALE_ROUNDS):
        now = parts(problem, x)
        ratio = {part.kind: part.square / part.redundancy for part in now}
        new = [part.kind for part in now if part.kind not in doubted and part.probability < _DOUBT_LEVEL]
        worst = max(new, key=ratio.__getitem__, default=None)
        if worst is not None and not (only_prior and worst != "prior"):
            doubted.add(worst)
        elif all(
            abs(ratio[kind] - 1) < _SCALE_TOLERANCE_SHARE or problem.scale[kind] == 1 > ratio[kind]
            for kind in doubted
        ):
            break
        for kind in doubted:
            problem.scale[kind] = max(1.0, problem.scale[kind] * float(np.sqrt(ratio[kind])))
        x = problem.solved(x)
    return x


def slips(problem: Problem, x: FloatArray) -> tuple[Slip, ...]:
    """Return the rows that do not fit the others, where few do not; of rows that all scatter the farthest."""
    rows = sum(block.label.kind != "prior" for block in problem.blocks(x))
    found, left_out = list[Label](), problem.left_out
    while len(found) <= max(1, int(_MAX_OUTLIER_SHARE * rows)):
        blocks = problem.blocks(x)
        now = _parts(problem, blocks)
        doubted = {part.kind for part in now if part.kind != "prior" and part.probability < _DOUBT_LEVEL}
        if not doubted:
            break
        blocks = problem.blocks(problem.first(robust=True))
        rest = [each for each in blocks if each.label.kind != "prior" and each.label not in problem.left_out]
        if not rest:
            break
        # Frequencies that fit badly may be of no mode of the robust estimate.
        some = [each for each in rest if each.label.kind in doubted] or rest
        found.append(_largest_residual(problem, some, blocks))
        problem.left_out = {*left_out, *found}
        x = problem.first()
    else:
        # All of them scatter: none stands out.
        found = found[:1]
        problem.left_out = {*left_out, *found}
        x = problem.first()
    compared = _compared(problem, x, found, rows)
    problem.left_out = left_out
    return compared


def _largest_residual(problem: Problem, some: Sequence[Block], blocks: Sequence[Block]) -> Label:
    """The row with the largest studentised residual."""
    A = problem.covariance(blocks)

    def log_probability(block: Block) -> float:
        k = len(block.residual)
        own = np.eye(k) - block.slope @ A @ block.slope.T
        return float(chi2.logsf(block.residual @ np.linalg.solve(own, block.residual), k))

    return min(some, key=log_probability).label


def _compared(problem: Problem, x: FloatArray, left: Sequence[Label], rows: int) -> tuple[Slip, ...]:
    """Rows that are left out beside what the others predict of them."""
    blocks = problem.blocks(x)
    A, of = problem.covariance(blocks), {part.kind: part for part in _parts(problem, blocks)}
    found = list[Slip]()
    for block in blocks:
        if block.label not in left:
            continue
        k, rest = len(block.residual), of.get(block.label.kind)
        apart = np.eye(k) + block.slope @ A @ block.slope.T
        square = float(block.residual @ np.linalg.solve(apart, block.residual))
        if rest is None or rest.probability >= _DOUBT_LEVEL:
            probability = chi2.sf(square, k)
        else:
            square *= rest.redundancy / rest.square
            probability = fisher.sf(square / k, k, rest.redundancy)
        found.append(
            Slip(
                label=block.label,
                expected=problem.predicted(block),
                deviations=float(np.sqrt(square)),
                probability=min(1.0, rows * float(probability)),
            )
        )
    return tuple(sorted(found, key=lambda slip: -slip.deviations))
