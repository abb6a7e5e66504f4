"""What measurements should be: deflections and natural frequencies as functions of the stiffness."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.sag import Sag, TooSoftError
from cmbot.elastic.stiffness_parameters import StiffnessParameters
from cmbot.identification.measurements import MeasuringSetup, Prior
from cmbot.planning import held_guardrail, robot_of
from cmbot.robot import Kinematics, Robot
from cmbot.scene import Scene

_ARC_MINUTE = np.pi / (180 * 60)
# Draws of the error along a job, and the share of them of which the bound is told.
_SAG_DRAWS, _CONFIDENCE = 4000, 0.95
# Below this length, m, a sag has no direction.
_ZERO_SAG_M = 1e-12


def measured_arm(scene: Scene, load: float = 0.0) -> ElasticArm:
    """Return a scene's elastic arm with its tool off, and `load` kg more at its tool.

    Its joints give way as the elasticity file says, also in a scene whose joints are rigid: what is measured
    does.

    Raises
    ------
    SceneError
        When nothing bends, or the scene's stiffness was identified already.
    """
    if scene.identified is not None:
        more = "more postures: cmbot identify SHEET... --propose N"
        expected = f"a scene without, as measurements are of the model's stiffness ({more})"
        raise SceneError(scene.source, "identified", "an identified stiffness", expected)
    loaded = scene.with_joints("elastic").with_payload(scene.robot.payload_kg + load)
    # A gauge is in W, also where the tool is fixed.
    robot: Robot = replace(robot_of(loaded).tool_off, fixed_tool=None)
    arm = elastic_arm(robot, elastic_base(held_guardrail(scene, robot)))
    if not len(arm.elastic):
        expected = "something that bends: guardrail.bays, base.tube, guardrail.stiffness or robot.elasticity"
        raise SceneError(scene.source, "guardrail", "nothing that bends", expected)
    return arm


def prior_deviations(parameters: StiffnessParameters, prior: Prior) -> FloatArray:
    """Return the standard deviations (p,) of parameters before anything is measured."""
    each = [prior.links if kind == "link" else prior.joints for kind, _ in parameters.springs]
    if parameters.has_base:
        row, column = np.triu_indices(6)
        each += np.where(row == column, prior.base, prior.base_coupling).tolist()
    return np.array(each)


class DeflectionModel:
    """The tool's deflections by a weight in N postures `q` (N, n), and how exact a gauge sees them."""

    def __init__(self, arm: ElasticArm, setup: MeasuringSetup, q: FloatArray) -> None:
        self.arm = arm
        self._loaded = arm.softened(1.0, setup.weight_kg)
        self.parameters = StiffnessParameters(self.arm)
        self.q = q
        self._start: list[FloatArray | None] = [None, None]
        J = np.stack([Kinematics(self.arm.robot).tool_jacobian(each)[1][:3] for each in q])
        windup = setup.windup_sd_arcmin * _ARC_MINUTE * ~self.arm.robot.limits.prismatic
        gauge = 1e-3 * setup.gauge_sd_mm
        self.noise = gauge**2 * np.eye(3) + np.einsum("kij,j,klj->kil", J, windup**2, J)
        """Covariances (N, 3, 3), m2, of measured deflections."""

    def at(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return deflections (N, 3), m, and their derivatives (N, 3, p), at parameters (p,).

        Raises
        ------
        InputError
            When the arm is too soft to carry itself.
        """
        K, each = self.parameters.stiffness(parameters), []
        for number, arm in enumerate((self.arm, self._loaded)):
            sag = Sag(replace(arm, stiffness=K))
            try:
                tool, u, lever = sag.loaded(self.q, self._start[number])
            except TooSoftError:
                # From the last equilibrium this one may be out of reach.
                tool, u, lever = sag.loaded(self.q)
            each.append((tool, lever @ self.parameters.relaxation(u, parameters)))
            self._start[number] = u
        (rest, d_rest), (bent, d_bent) = each
        return bent - rest, d_bent - d_rest


@dataclass(frozen=True, kw_only=True, eq=False)
class SagAlong:
    """The predicted sag of the tool in the postures of a job, and how exact it is.

    Attributes
    ----------
    tool : (M, 3), m
    deviation : (M,), m
        Standard deviation of its distance from the true one.
    rms : float, m
    share, share_95 : float
        RMS error, as a vector, as a share of `rms`: its own root mean square, and what 95 % of cases stay
        below.
    length_95 : float
        The same of its length alone.
    weight : (p, p)
        W: the squared share is ``x' W x`` of an error x of the parameters.
    """

    tool: FloatArray
    deviation: FloatArray
    rms: float
    share: float
    share_95: float
    length_95: float
    weight: FloatArray


def sag_along(arm: ElasticArm, covariance: FloatArray, q: FloatArray) -> SagAlong:
    """Predict the sag in postures `q` (M, n) of an arm whose parameters have a covariance (p, p)."""
    tool, u, lever = Sag(arm).loaded(q)
    slope = lever @ StiffnessParameters(arm).relaxation(u)
    square = float((tool**2).sum(axis=1).mean())
    weight = np.einsum("kip,kir->pr", slope, slope) / len(q) / square
    unit = tool / np.maximum(np.linalg.norm(tool, axis=1), _ZERO_SAG_M)[:, None]
    longer = np.einsum("ki,kip->kp", unit, slope)
    deviation = np.sqrt(np.einsum("kip,pr,kir->k", slope, covariance, slope))
    values, V = np.linalg.eigh(covariance)
    root = V * np.sqrt(np.maximum(values, 0.0))
    share, share_95 = _quantile(root.T @ weight @ root)
    _, length_95 = _quantile(root.T @ (longer.T @ longer / len(q) / square) @ root)
    return SagAlong(
        tool=tool,
        deviation=deviation,
        rms=float(np.sqrt(square)),
        share=share,
        share_95=share_95,
        length_95=length_95,
        weight=weight,
    )


@cache
def _squares(count: int) -> FloatArray:
    """Squares of independent normal numbers (draws, count)."""
    return np.random.default_rng(0).standard_normal((_SAG_DRAWS, count)) ** 2


def _quantile(form: FloatArray) -> tuple[float, float]:
    """Root mean square of a quadratic form's root over independent normal numbers, and its 95 % quantile."""
    parts = np.maximum(np.linalg.eigvalsh(form), 0.0)
    draws = _squares(len(parts)) @ parts
    return float(np.sqrt(parts.sum())), float(np.sqrt(np.quantile(draws, _CONFIDENCE)))
