"""From measurements to stiffness: the maximum a posteriori estimate and its covariance.

Deflections are not linear in the compliances (1 to 2.5 % of the sag), so the estimate is nonlinear least
squares of what was measured and of the prior together; its covariance is that of the linearised problem, with
errors that are larger than stated where the measurements show it.

Of the misfit of measurements and model it tells the probability, the rows that are outliers, and the errors
to be taken. At the estimate the residuals r of a part of the least squares have the covariance ``B = I - H``,
in units of their standard deviations, with the leverage ``H = J A J'`` and the covariance A of the unknowns.
So their sum of squares has the mean ``trace B``, the redundancy, and is about ``c chi2(h)`` with the same
mean and variance (Satterthwaite, 1946). A part that is larger than chance allows has its standard deviations
scaled until it is as large as its redundancy: the estimation of variance components (Helmert, 1907;
Foerstner, 1979). The prior is one of the parts, so an arm that is far from its model is told from wrong
measurements.

Before that single rows are sought that stand out (data snooping; Baarda, 1968): the one with the largest
studentised residual at a robust estimate is left out, and the next, until the rest fit. The row is then
compared with what these predict of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, expm
from scipy.stats import chi2, f as fisher

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import validated
from cmbot.common.representation import ShortRepr
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import TooSoftError
from cmbot.elastic.stiffness_parameters import (
    StiffnessParameters,
    entries_of,
    exponential_slopes,
    symmetric,
)
from cmbot.identification.measurements import Measurements, require_alike
from cmbot.identification.model import SagAlong, measured_arm, sag_along
from cmbot.identification.problem import Block, Kind, Label, MatchedFrequency, Problem
from cmbot.planning import modelled_stiffness
from cmbot.scene import IdentifiedStiffness

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


class Weight(NamedTuple):
    """A weight that was hung on: as stated, as estimated and its standard deviation, kg."""

    stated: float
    estimated: float
    deviation: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification(ShortRepr):
    """The stiffness that measurements tell.

    Attributes
    ----------
    measurements : tuple of Measurements
        The sheets.
    arm : ElasticArm
        As identified, its tool off.
    modelled : ElasticArm
        As it was modelled.
    parameters : StiffnessParameters
        Of the modelled arm.
    mean : (p,)
        Estimate of these parameters.
    covariance : (p, p)
        Of their errors.
    prior : (p,)
        Standard deviations before.
    weights : tuple of Weight
        Those whose errors were estimated.
    joint : (p + w, p + w)
        Covariance about what was identified: of the parameters of `arm`, then of the weights, kg.
    parts : tuple of Part
        Whether measurements and prior fit, and by which factor their errors were taken to be larger.
    slips : tuple of Slip
        Rows that do not fit the others, the worst first.
    matched : tuple of MatchedFrequency
        To which modes of the arm the measured frequencies were given.
    stiffness : IdentifiedStiffness
        For scenes: its covariance is about what was identified.
    job : (M, n) or None
        Postures in which the sag is wanted.
    before, after : SagAlong or None
        The sag along the job as modelled and as identified; None where no job is named.
    """

    measurements: tuple[Measurements, ...]
    arm: ElasticArm
    modelled: ElasticArm
    parameters: StiffnessParameters
    mean: FloatArray
    covariance: FloatArray
    prior: FloatArray
    weights: tuple[Weight, ...]
    joint: FloatArray
    parts: tuple[Part, ...]
    slips: tuple[Slip, ...]
    matched: tuple[MatchedFrequency, ...]
    stiffness: IdentifiedStiffness
    job: FloatArray | None
    before: SagAlong | None
    after: SagAlong | None


def estimate(
    measurements: Measurements | Sequence[Measurements], modelled: ElasticArm | None = None
) -> Identification:
    """Estimate the stiffness of links, joints and base.

    Where the measurements do not fit, it is told in `parts` and `slips`; `require_fit` refuses that.

    Parameters
    ----------
    measurements : Measurements or sequence of them
        Sheets of one robot in one place.
    modelled : ElasticArm, optional
        From `measured_arm`; without it the robot is loaded.

    Raises
    ------
    InputError
        When the arm that was measured is too soft to carry itself, nothing of it bends, or sheets differ in
        robot, base or prior.
    """
    sheets = (measurements,) if isinstance(measurements, Measurements) else tuple(measurements)
    require_alike(sheets)
    modelled = measured_arm(sheets[0].scene) if modelled is None else modelled
    try:
        return _estimate(sheets, modelled)
    except TooSoftError as error:
        heaviest = max(sheet.setup.weight_kg for sheet in sheets)
        expected = f"weight_kg in kg, not g or N, of an arm that carries itself and {heaviest:g} kg"
        raise InputError(sheets[0].source, "measurements", error.got, expected) from error


def _estimate(sheets: tuple[Measurements, ...], modelled: ElasticArm) -> Identification:
    problem = Problem(sheets, modelled)
    x = problem.first()
    stated = parts(problem, x)
    # An arm far from its model makes all rows fit a little worse: that is not a slip.
    x = rescaled(problem, x, only_prior=True)
    wrong = slips(problem, x)
    x = rescaled(problem, x)
    scaled, p = problem.covariance(problem.blocks(x)), len(problem.prior)
    sizes = np.concatenate([problem.prior, [deviation for _, deviation in problem.weights]])
    whole = scaled * np.outer(sizes, sizes)
    mean = problem.prior * x[:p]
    arm = replace(modelled, stiffness=problem.parameters.stiffness(mean))
    moved = block_diag(_about_identified(problem.parameters, arm, mean), np.eye(len(problem.weights)))
    joint = moved @ whole @ moved.T
    known = zip(problem.weights, x[p:], np.sqrt(np.diag(whole)[p:]), strict=True)
    job = next((each.job for each in reversed(sheets) if each.job is not None), None)
    before = None if job is None else sag_along(modelled, np.diag(problem.prior**2), job)
    after = None if job is None else sag_along(arm, joint[:p, :p], job)
    measured = _measured(sheets, stated, problem.matched) | {"prior_sd": problem.prior.tolist()}
    if before is not None and after is not None:
        measured["sag_mm"] = [round(1e3 * sag.rms, 4) for sag in (before, after)]
    return Identification(
        measurements=sheets,
        arm=arm,
        modelled=modelled,
        parameters=problem.parameters,
        mean=mean,
        covariance=whole[:p, :p],
        prior=problem.prior,
        weights=tuple(
            Weight(kg, kg + deviation * error, float(now)) for (kg, deviation), error, now in known
        ),
        joint=joint,
        parts=tuple(replace(part, scale=problem.scale[part.kind]) for part in stated),
        slips=wrong,
        matched=problem.matched,
        stiffness=_stiffness(sheets, modelled, arm, mean, joint[:p, :p], measured),
        job=job,
        before=before,
        after=after,
    )


def _about_identified(parameters: StiffnessParameters, arm: ElasticArm, mean: FloatArray) -> FloatArray:
    """Derivatives (p, p) of the parameters of the identified arm by those of the modelled one.

    With ``L exp(X) L' = M exp(Y) M'`` and ``M = L exp(X/2) Q'``, Q orthogonal: ``dY = Q exp(-X/2) d exp(X)
    exp(-X/2) Q'`` at Y = 0.
    """
    moved = np.eye(len(mean))
    if parameters.has_base:
        first = len(parameters.springs)
        X = symmetric(mean[first:])
        half = np.asarray(expm(X / 2))
        Q = np.linalg.solve(StiffnessParameters(arm).factor, parameters.factor @ half)
        back = Q @ np.linalg.inv(half)
        directions = np.stack([symmetric(row) for row in np.eye(21)])
        moved[first:, first:] = entries_of(back @ exponential_slopes(X, directions) @ back.T).T
    return moved


def _damping(sheets: Sequence[Measurements]) -> dict[str, float] | None:
    """The damping of the modes in records; None where there are none."""
    modes = [each.of(np.isfinite(each.damping)) for sheet in sheets for each in sheet.modes]
    ratios = np.concatenate([np.zeros(0), *(each.damping for each in modes)])
    if not len(ratios):
        return None
    own = np.concatenate([each.damping_deviations for each in modes])
    # Of one mode, and from mode to mode.
    deviation = np.hypot(np.median(own), np.std(ratios, ddof=min(1, len(ratios) - 1)))
    return {"ratio": round(float(np.median(ratios)), 6), "sd": round(float(deviation), 6)}


def _measured(
    sheets: Sequence[Measurements], stated: Sequence[Part], matched: Sequence[MatchedFrequency]
) -> dict[str, Any]:
    """What was measured, and how it fits the errors that were stated."""
    residual = {part.kind: round(float(np.sqrt(part.square / part.redundancy)), 6) for part in stated}
    deflected = sum(int(np.isfinite(each.deflection).any(axis=1).sum()) for each in sheets)
    readings = (
        ("deflections", deflected, residual.get("deflection_mm")),
        ("frequencies", len(matched), residual.get("frequencies_hz")),
    )
    modes = [
        {
            "hz": round(each.frequency, 6),
            "hz_sd": round(sheets[each.label.sheet].setup.frequency_sd_share * each.frequency, 6),
            "damping": [round(x, 6) for x in ratio] if np.isfinite(ratio[0]) else None,
        }
        for each in matched
        for ratio in [(each.damping, each.damping_deviation)]
    ]
    kinds = [dict(zip(("kind", "count", "residual"), each, strict=True)) for each in readings if each[1]]
    names = list(dict.fromkeys(Path(each.source).name for each in sheets))
    return {"sheets": names, "readings": kinds, "modes": modes}


def _stiffness(
    sheets: Sequence[Measurements],
    modelled: ElasticArm,
    arm: ElasticArm,
    mean: FloatArray,
    covariance: FloatArray,
    measured: dict[str, Any],
) -> IdentifiedStiffness:
    of, springs = modelled_stiffness(modelled.robot), StiffnessParameters(modelled).springs
    each = [
        (kind, {"name": name, "modelled": of[kind, name], "factor": float(np.exp(-mean[k]))})
        for k, (kind, name) in enumerate(springs)
    ]
    data: dict[str, Any] = {
        "links": [one for kind, one in each if kind == "link"],
        "joints": [one for kind, one in each if kind == "joint"],
        "damping": _damping(sheets),
        "measured": measured,
        "covariance": ((covariance + covariance.T) / 2).tolist(),
    }
    if modelled.base is not None:
        K, mass = arm.stiffness[:6, :6], modelled.base.mass
        base = {"footholds": sheets[0].scene.elastic_guardrail.footholds, "stiffness": K.tolist()}
        data["base"] = base | ({"mass": mass.tolist()} if mass.any() else {})
    return validated(IdentifiedStiffness, data, sheets[0].source, InputError)
