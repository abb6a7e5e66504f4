"""Parts of the tool's error: each a bias and linear maps of what is not known, along the postures of a job.

A quantity that is one number all along a job (a placement, a calibration) is drawn once; one that changes
(play, friction) is drawn anew at each posture. Ranges are uniform, what has a standard deviation is normal.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag
from cmbot.robot import Kinematics, Robot
from cmbot.scene import Placement, Scene, Uncertainty

# Of a scene's `uncertainty`, which say how large the parts are of which only that is known.
_KEYS: dict[str, str] = {
    "stiffness": "stiffness_share",
    "placement of the base": "foot",
    "placement of the workpiece": "workpiece",
    "joint calibration": "joints.calibration_deg",
    "backlash": "joints.backlash_arcmin",
    "friction": "joints.friction_share",
    "payload": "payload_kg",
    "temperature": "temperature_k",
}
# By the ends of keys.
_UNITS = {"deg": " deg", "arcmin": " arcmin", "kg": " kg", "k": " K"}

# Expansion of tubes, 1/K: of steel, and of what has less than this modulus of elasticity, Pa, aluminium.
_STEEL, _ALUMINIUM, _STEELS_MODULUS = 12e-6, 23e-6, 1.5e11
_UNIFORM = 1 / np.sqrt(3)  # standard deviation of what is uniform in -1 ... 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """One part of the tool's error at N postures.

    Attributes
    ----------
    name : str
    bias : (N, 3), m
        What is known of it.
    maps : (N, 3, k), m
        By k independent numbers of mean 0 and standard deviation 1.
    is_uniform : bool
        These numbers are uniform; otherwise normal.
    changes : bool
        They are drawn anew at each posture; otherwise once for a job.
    """

    name: str
    bias: FloatArray
    maps: FloatArray
    is_uniform: bool = False
    changes: bool = False

    @classmethod
    def unbiased(cls, name: str, maps: FloatArray, **drawn: bool) -> Part:
        """Return a part of which nothing is known but how large it may be, and how it is `drawn`."""
        return cls(name=name, bias=np.zeros(maps.shape[:2]), maps=maps, **drawn)

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations (N, 3), m, along x, y and z."""
        return np.asarray(np.sqrt((self.maps**2).sum(axis=2)))


def parts_of(
    arm: ElasticArm,
    q: FloatArray,
    uncertainty: Uncertainty,
    *,
    compensated: bool,
    covariance: FloatArray | None = None,
) -> Iterator[Part]:
    """Yield the parts of the error of an arm's tool at postures `q` (N, n).

    Parameters
    ----------
    arm : ElasticArm
    q : (N, n), rad, m
    uncertainty : Uncertainty
    compensated : bool
        Whether the joints aim beside the path by the predicted sag, which then is no error.
    covariance : (p, p), optional
        Of the arm's `StiffnessParameters`, where they were identified, in place of the stated share.

    Raises
    ------
    InputError
        When the arm is too soft to carry itself in a posture.
    """
    sag, robot = Sag(arm), arm.robot
    bent = sag.at(q)
    known = np.zeros_like(bent.tool) if compensated else bent.tool
    yield Part(name="sag", bias=known, maps=np.zeros((len(q), 3, 0)))
    yield _stiffness(sag, q, bent.tool, uncertainty, covariance)
    kinematics = Kinematics(robot)
    poses = [kinematics.tool_jacobian(posture) for posture in q]
    tool = np.array([X_WT.translation for X_WT, _ in poses]) + bent.tool
    J = np.array([jacobian.reshape(6, -1)[:3] for _, jacobian in poses]) + bent.d_tool
    seen, touched = np.tile(np.eye(3), (len(q), 1, 1)), tool
    if (fixed := robot.fixed_tool) is not None:
        # What moves the arm in W moves a fixed tool back, seen from the part.
        seen = np.array([-X_ET.rotation @ fixed.rotation.T for X_ET, _ in poses])
        touched = np.tile(fixed.translation, (len(q), 1))
    placed = seen @ _placed(uncertainty.foot, touched - np.array(robot.foot_point))
    yield Part.unbiased("placement of the base", placed)
    middle = 0.5 * (tool.min(axis=0) + tool.max(axis=0))
    yield Part.unbiased("placement of the workpiece", _placed(uncertainty.workpiece, tool - middle))
    yield from _joints(robot, q, J, uncertainty)
    if uncertainty.payload_kg:
        more = Sag(arm.softened(1.0, uncertainty.payload_kg)).at(q).tool - bent.tool
        # Anything from nothing to all of it.
        half = 0.5 * more
        yield Part(name="payload", bias=half, maps=_UNIFORM * half[:, :, None], is_uniform=True)
    if uncertainty.temperature_k and robot.elasticity:
        maps = seen @ _bowed(robot, q, touched, uncertainty.temperature_k)
        yield Part.unbiased("temperature", maps, is_uniform=True)


def assumed_in_words(part: str, scene: Scene) -> str | None:
    """Return value and key of what makes a part of the error, where it is the default; else None."""
    key = _KEYS.get(part)
    if key is None or (part == "stiffness" and scene.identified is not None):
        return None
    value, default = map(attrgetter(key), (scene.uncertainty, Uncertainty()))
    unit = _UNITS.get(key.rpartition("_")[2], "")
    words = f"{value.mm:g} mm, {value.deg:g} deg" if isinstance(value, Placement) else f"{value:g}{unit}"
    return f"{words}: uncertainty.{key}" if value == default else None


def _stiffness(
    sag: Sag, q: FloatArray, bent: FloatArray, uncertainty: Uncertainty, covariance: FloatArray | None
) -> Part:
    if covariance is None:
        # The sag of a stiffness times 1 + s is to first order 1 - s times as large.
        maps = -_UNIFORM * uncertainty.stiffness_share * bent[:, :, None]
        return Part.unbiased("stiffness", maps, is_uniform=True)
    values, vectors = np.linalg.eigh(covariance)
    return Part.unbiased("stiffness", sag.by_stiffness(q) @ (vectors * np.sqrt(np.maximum(values, 0.0))))


def _placed(placement: Placement, arms: FloatArray) -> FloatArray:
    """Maps (N, 3, 6) of shifts and turns of what `arms` (N, 3) lead from."""
    shifts = np.broadcast_to(1e-3 * placement.mm * np.eye(3), (len(arms), 3, 3))
    turns = np.array([-pin.skew(arm) for arm in arms]) * np.radians(placement.deg)
    return np.concatenate([shifts, turns], axis=2)


def _joints(robot: Robot, q: FloatArray, J: FloatArray, uncertainty: Uncertainty) -> Iterator[Part]:
    """Parts of the joints that turn, by the Jacobians (N, 3, n) of the bent arm's tool."""
    given, turning = uncertainty.joints, ~robot.limits.prismatic
    J = J[:, :, turning]
    yield Part.unbiased("joint calibration", np.radians(given.calibration_deg) * J)
    play = 0.5 * np.radians(given.backlash_arcmin / 60)
    yield Part.unbiased("backlash", _UNIFORM * play * J, is_uniform=True, changes=True)
    names = [name for name, turns in zip(robot.joints, turning, strict=True) if turns]
    springs = [robot.joint_elasticity.get(name) for name in names]
    if any(springs) and given.friction_share:
        data = robot.model.createData()
        every = robot.coupling.positions(q)
        torque = np.array([pin.computeGeneralizedGravity(robot.model, data, each) for each in every])
        torque = robot.coupling.projected(torque)
        give = np.array([0.0 if spring is None else 1 / spring.stiffness for spring in springs])
        windup = given.friction_share * np.abs(torque[:, turning]) * give
        maps = _UNIFORM * J * windup[:, None, :]
        yield Part.unbiased("friction", maps, is_uniform=True, changes=True)


def _bowed(robot: Robot, q: FloatArray, tool: FloatArray, difference: float) -> FloatArray:
    """Maps (N, 3, 2 L) of tubes that are warmer on one side: they bow, of any side.

    A tube of length L and diameter d turns its end by alpha dT L / d, as if it were bent in its middle.
    """
    model, data = robot.model, robot.model.createData()
    maps = np.empty((len(q), 3, 2 * len(robot.elasticity)))
    for k, posture in enumerate(robot.coupling.positions(q)):
        pin.framesForwardKinematics(model, data, posture)
        for number, (link, tube) in enumerate(robot.elasticity.items()):
            X = data.oMf[model.getFrameId(link)]
            start, end = X.act(np.array(tube.start)), X.act(np.array(tube.end))
            alpha = _STEEL if tube.young > _STEELS_MODULUS else _ALUMINIUM
            turn = alpha * difference * tube.length / tube.outer_diameter
            along = (end - start) / np.linalg.norm(end - start)
            across = np.linalg.svd(along[None])[2][1:]
            lever = tool[k] - 0.5 * (start + end)
            maps[k, :, 2 * number : 2 * number + 2] = _UNIFORM * turn * np.cross(across, lever).T
    return maps
