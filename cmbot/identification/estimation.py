"""From measurements to stiffness: the maximum a posteriori estimate and its covariance.

Deflections are not linear in the compliances (1 to 2.5 % of the sag), so the estimate is nonlinear least
squares of what was measured and of the prior together; its covariance is that of the linearised problem, with
errors that are larger than stated where the measurements show it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, expm

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
from cmbot.identification.misfit import Part, Slip, parts, rescaled, slips
from cmbot.identification.model import SagAlong, measured_arm, sag_along
from cmbot.identification.problem import MatchedFrequency, Problem
from cmbot.planning import modelled_stiffness
from cmbot.scene import IdentifiedStiffness


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
        expected = f"weight_kg in kg, not g, of an arm that carries itself and {heaviest:g} kg"
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
