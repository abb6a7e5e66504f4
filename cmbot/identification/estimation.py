"""From measurements to stiffness: the maximum a posteriori estimate and its covariance.

Deflections are not linear in the compliances (1 to 2.5 % of the sag), so the estimate is nonlinear least
squares of what was measured and of the prior together; its covariance is that of the linearised problem. The
weight is estimated with the stiffness, as it may be a little wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.optimize import least_squares, linear_sum_assignment
from scipy.stats import chi2

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.common.validation import validated
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import frequency_slopes
from cmbot.elastic.stiffness_parameters import (
    StiffnessParameters,
    entries_of,
    exponential_slopes,
    symmetric,
)
from cmbot.identification.measurements import Measurements
from cmbot.identification.model import (
    DeflectionModel,
    SagAlong,
    measured_arm,
    prior_deviations,
    sag_along,
)
from cmbot.planning import modelled_stiffness
from cmbot.scene import IdentifiedStiffness

__all__ = ["Identification", "estimate", "whitener"]

# Residual where the arm is too soft to carry itself: such a step is not taken.
_TOO_SOFT = 1e6
# Modes that a measured frequency may be of; the largest difference of its logarithm from theirs, and that of
# two modes that a record may not tell apart.
_MODES, _NEAR, _CLOSE = 16, 0.3, 0.08
_TOLERANCE, _EVALUATIONS = 1e-7, 100


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """The stiffness that measurements tell.

    Attributes
    ----------
    measurements : Measurements
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
    weight_kg, weight_sd_kg : float
        Estimate of the weight.
    misfit, misfit_share : float
        Sum of squared residuals in units of their standard deviations, and the probability of a larger one.
    stiffness : IdentifiedStiffness
        For scenes: its covariance is about what was identified.
    before, after : SagAlong or None
        The sag along the job as modelled and as identified; None where no job is named.
    """

    measurements: Measurements
    arm: ElasticArm
    modelled: ElasticArm
    parameters: StiffnessParameters
    mean: FloatArray
    covariance: FloatArray
    prior: FloatArray
    weight_kg: float
    weight_sd_kg: float
    misfit: float
    misfit_share: float
    stiffness: IdentifiedStiffness
    before: SagAlong | None
    after: SagAlong | None


def estimate(measurements: Measurements, modelled: ElasticArm | None = None) -> Identification:
    """Estimate the stiffness of links, joints and base.

    Parameters
    ----------
    measurements : Measurements
    modelled : ElasticArm, optional
        From `measured_arm`; without it the robot is loaded.

    Raises
    ------
    InputError
        When the arm that was measured is too soft to carry itself, or nothing of it bends.
    """
    modelled = measured_arm(measurements.scene) if modelled is None else modelled
    try:
        return _estimate(measurements, modelled)
    except InputError as error:
        if error.source != "Sag.at":
            raise
        expected = f"those of an arm that carries itself and {measurements.setup.weight_kg:g} kg"
        raise InputError(measurements.source, "measurements", error.got, expected) from error


def _estimate(measurements: Measurements, modelled: ElasticArm) -> Identification:
    problem = _Problem(measurements, modelled)
    # Frequencies alone end in wrong minima: first the deflections.
    x = np.zeros(problem.count)
    if problem.deflects:
        x = problem.solved(x, with_frequencies=False)
    if problem.has_frequencies:
        problem.match(x)
        x = problem.solved(x, with_frequencies=True)
    residual, J = problem.evaluate(x, with_frequencies=True)
    scaled = np.linalg.inv(J.T @ J)
    p, scale = len(problem.prior), problem.scale
    covariance = scaled[:p, :p] * np.outer(problem.prior, problem.prior)
    mean = problem.prior * x[:p]
    parameters = problem.model.parameters
    arm = replace(modelled, stiffness=parameters.stiffness(mean))
    moved = _about_identified(parameters, arm, mean)
    own = moved @ covariance @ moved.T
    misfit, number = float(residual @ residual), len(residual) - len(x)
    job, setup = measurements.job, measurements.setup
    return Identification(
        measurements=measurements,
        arm=arm,
        modelled=modelled,
        parameters=parameters,
        mean=mean,
        covariance=covariance,
        prior=problem.prior,
        weight_kg=setup.weight_kg + scale * x[p] if scale else setup.weight_kg,
        weight_sd_kg=scale * float(np.sqrt(scaled[p, p])) if scale else 0.0,
        misfit=misfit,
        misfit_share=float(chi2.sf(misfit, max(number, 1))),
        stiffness=_stiffness(measurements, modelled, arm, mean, own),
        before=None if job is None else sag_along(modelled, np.diag(problem.prior**2), job),
        after=None if job is None else sag_along(arm, own, job),
    )


class _Matched(NamedTuple):
    """Measured frequencies: of which modes (k,), their logarithms (k,) and standard deviations (k,)."""

    modes: IntArray
    log: FloatArray
    share: FloatArray


def _matched(log: FloatArray, own: FloatArray, model: FloatArray, share: float) -> _Matched:
    """Match measured frequencies with the nearest ones of the model, one to one; far ones are left out.

    Of two modes near each other of which one was measured it may be either, or both in one.
    """
    measured, modes = linear_sum_assignment(np.abs(log[:, None] - model))
    near = np.abs(log[measured] - model[modes]) < _NEAR
    measured, modes = measured[near], modes[near]
    others = np.setdiff1d(np.arange(len(model)), modes)
    gap = np.abs(model[modes][:, None] - model[others]).min(axis=1, initial=np.inf)
    either = np.where(gap < _CLOSE, 0.5 * gap, 0.0)
    return _Matched(modes, log[measured], np.sqrt(share**2 + own[measured] ** 2 + either**2))


class _Problem:
    """Least squares of what was measured and of the prior, all in units of standard deviations.

    Unknown are the parameters (p,) and, last, the error of the weight.
    """

    def __init__(self, measurements: Measurements, modelled: ElasticArm) -> None:
        given, setup = measurements, measurements.setup
        self._given = given
        self.model = DeflectionModel(modelled, setup, given.q)
        self.prior = prior_deviations(self.model.parameters, setup.prior)
        self.scale = setup.weight_sd_kg
        self.count = len(self.prior) + (1 if self.scale else 0)
        self._white = [
            whitener(noise, ~np.isnan(d)) for noise, d in zip(self.model.noise, given.deflection, strict=True)
        ]
        self.deflects = bool(np.isfinite(given.deflection).any())
        self.has_frequencies = any(len(f) for f in given.frequencies)
        nothing = _Matched(np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros(0))
        self._matched = [nothing] * len(given.q)

    def match(self, x: FloatArray) -> None:
        """Find out which mode each measured frequency is of, as the arm is known so far."""
        shares = self._given.frequency_shares or tuple(map(np.zeros_like, self._given.frequencies))
        at = self.prior * x[: len(self.prior)]
        for k, (f, own) in enumerate(zip(self._given.frequencies, shares, strict=True)):
            if len(f):
                model, parameters = self.model.arm, self.model.parameters
                log, _ = frequency_slopes(model, parameters, at, self._given.q[k], _MODES)
                self._matched[k] = _matched(np.log(f), own, log, self._given.setup.frequency_sd_share)

    def solved(self, start: FloatArray, *, with_frequencies: bool) -> FloatArray:
        known: dict[bytes, tuple[FloatArray, FloatArray]] = {}

        def at(x: FloatArray) -> tuple[FloatArray, FloatArray]:
            key = x.tobytes()
            if key not in known:
                known.clear()
                known[key] = self.evaluate(x, with_frequencies=with_frequencies)
            return known[key]

        size = len(at(start)[0])

        def residual(x: FloatArray) -> FloatArray:
            try:
                return at(x)[0]
            except InputError:
                self.model.forget()
                return np.full(size, _TOO_SOFT)

        found = least_squares(
            residual,
            start,
            jac=lambda x: at(x)[1],
            xtol=_TOLERANCE,
            ftol=_TOLERANCE,
            gtol=_TOLERANCE,
            max_nfev=_EVALUATIONS,
        )
        return np.asarray(found.x)

    def evaluate(self, x: FloatArray, *, with_frequencies: bool) -> tuple[FloatArray, FloatArray]:
        """Residuals and their derivatives by the unknowns."""
        given, setup, p = self._given, self._given.setup, len(self.prior)
        at = self.prior * x[:p]
        deflection, slope = self.model.at(at)
        values, rows = [], []
        for k, W in enumerate(self._white):
            row = np.zeros((len(W), self.count))
            row[:, :p] = W @ (slope[k] * self.prior)
            d = deflection[k]
            if self.scale:
                # A deflection is nearly proportional to its weight, whose error is small.
                by_weight = d * (self.scale / setup.weight_kg)
                row[:, p:] = (W @ by_weight)[:, None]
                d = d + by_weight * x[p]
            values.append(W @ (d - np.nan_to_num(given.deflection[k])))
            rows.append(row)
            found = self._matched[k]
            if with_frequencies and len(found.modes):
                row = np.zeros((len(found.modes), self.count))
                count = int(found.modes.max()) + 1
                log, d_log = frequency_slopes(self.model.arm, self.model.parameters, at, given.q[k], count)
                row[:, :p] = d_log[found.modes] * self.prior / found.share[:, None]
                values.append((log[found.modes] - found.log) / found.share)
                rows.append(row)
        return np.concatenate([*values, x]), np.concatenate([*rows, np.eye(self.count)])


def whitener(noise: FloatArray, seen: BoolArray) -> FloatArray:
    """Return what takes a deflection (3,) to independent numbers (k,) of unit variance, of the seen axes."""
    own = np.eye(3)[np.flatnonzero(seen)]
    if not len(own):
        return own
    return np.asarray(np.linalg.solve(np.linalg.cholesky(own @ noise @ own.T), own))


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


def _stiffness(
    measurements: Measurements,
    modelled: ElasticArm,
    arm: ElasticArm,
    mean: FloatArray,
    covariance: FloatArray,
) -> IdentifiedStiffness:
    of, springs = modelled_stiffness(modelled.robot), StiffnessParameters(modelled).springs
    each = [
        (kind, {"name": name, "modelled": of[kind, name], "factor": float(np.exp(-mean[k]))})
        for k, (kind, name) in enumerate(springs)
    ]
    data: dict[str, Any] = {
        "links": [one for kind, one in each if kind == "link"],
        "joints": [one for kind, one in each if kind == "joint"],
        "covariance": ((covariance + covariance.T) / 2).tolist(),
    }
    if modelled.base is not None:
        K, mass = arm.stiffness[:6, :6], modelled.base.mass
        base = {"footholds": measurements.scene.guardrail.footholds, "stiffness": K.tolist()}
        data["base"] = base | ({"mass": mass.tolist()} if mass.any() else {})
    return validated(IdentifiedStiffness, data, measurements.source, InputError)
