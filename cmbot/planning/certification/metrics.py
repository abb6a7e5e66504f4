"""The figures by which motions are compared, the same for the baseline and for a planned trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.reading.file_types import ModerateOrInfinite, NonNegative
from cmbot.common.representation import ShortRepr
from cmbot.elastic.sag import Sag
from cmbot.hold import AdhesionPeak
from cmbot.planning.task import ToolTask
from cmbot.robot import Dynamics, Efforts, Kinematics, Postures, Robot


@dataclass(frozen=True, kw_only=True)
class LimitUse:
    """Largest share of each bound that is used, over all joints and times; 1 is at the bound."""

    velocity: NonNegative
    acceleration: NonNegative
    jerk: NonNegative
    torque: NonNegative


@dataclass(frozen=True, kw_only=True)
class MotionMetrics(ShortRepr):
    """What a motion asks of the guardrail and how it keeps to its task.

    Attributes
    ----------
    peak_guardrail_torque, mean_guardrail_torque : float, Nm
        Largest value and time mean of the norm of the torque on the guardrail.
    rms_guardrail_torque : float, Nm
        Root of its mean square over time.
    peak_static_guardrail_torque : float, Nm
        Largest norm at rest in the motion's postures: the part that gravity asks.
    min_clearance : float, m
        Smallest distance to obstacles and of the arm to itself.
    max_tool_deviation : float, m
        Largest distance of the tool point from the leg of its time.
    max_tool_rotation : float, rad
        Largest angle by which the tool misses the prescribed orientation or axis; the one in the middle of a
        cone.
    max_tool_lag : float, m
        Largest distance of the tool point from its timed place, along the leg.
    limit_use : LimitUse
    adhesion_needed : AdhesionPeak or None
        Largest adhesion that a foot needs; None where no foot holds by it, such as clamps.
    duration : float, s
    guardrail_torque_integral : float, Nm s
        Of the torque's norm over that time.
    """

    peak_guardrail_torque: NonNegative
    mean_guardrail_torque: NonNegative
    rms_guardrail_torque: NonNegative
    peak_static_guardrail_torque: NonNegative
    min_clearance: ModerateOrInfinite
    max_tool_deviation: NonNegative
    max_tool_rotation: NonNegative
    max_tool_lag: NonNegative
    limit_use: LimitUse
    adhesion_needed: AdhesionPeak | None = None
    duration: NonNegative
    guardrail_torque_integral: NonNegative


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples(ShortRepr):
    """A motion at N times, with everything that is plotted or written of it.

    Attributes
    ----------
    t : (N,), s
    q, v, a, j : (N, n), rad, rad/s, rad/s2, rad/s3
    joint_torque : (N, n), Nm
    guardrail_force, guardrail_torque : (N, 3), N and Nm
        Wrench on the guardrail from the moving arm, at O0, in W.
    tool_point : (N, 3), m
        Where the joints put the tool; that is what is commanded.
    expected_tool_point : (N, 3), m, or None
        Where it is expected with its predicted sag; None where sag is not compensated.
    tool_deviation : (N,), m
        Distance of the tool point, the expected one if there is one, from the leg of its time.
    tool_lag : (N,), m
        Distance along that leg from its timed place.
    tool_rotation : (N,), rad
    clearance : (N,), m
    adhesion_needed : (N, k), N, or None
        That each foot with a flat contact needs; None without one.
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    a: FloatArray
    j: FloatArray
    joint_torque: FloatArray
    guardrail_force: FloatArray
    guardrail_torque: FloatArray
    tool_point: FloatArray
    expected_tool_point: FloatArray | None
    tool_deviation: FloatArray
    tool_lag: FloatArray
    tool_rotation: FloatArray
    clearance: FloatArray
    adhesion_needed: FloatArray | None = None


def measure(
    robot: Robot,
    task: ToolTask,
    clearances: Clearances,
    t: FloatArray,
    motion: Sequence[FloatArray],
    sag: Sag | None = None,
    *,
    clearance: FloatArray | None = None,
    share: FloatArray | None = None,
) -> Samples:
    """Measure a motion at its samples.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
    clearances : Clearances
    t : (N,), s
    motion : four arrays (N, n)
        Position, velocity, acceleration and jerk.
    sag : Sag, optional
        Where it is compensated: the tool's predicted displacement.
    clearance : (N,), m, optional
        Where it is known already.
    share : (N,), optional
        Of the robot's process force that acts; left out: all of it.
    """
    q, v, a, j = motion
    acts = share is None or bool(share.any())
    efforts = Dynamics(robot if acts else robot.tool_off).efforts(q, v, a)
    if acts and share is not None and robot.pushed:
        # Efforts are linear in the force.
        off, on = (vars(each) for each in (Dynamics(robot.tool_off).efforts(q, v, a), efforts))
        efforts = Efforts(**{name: off[name] + share[:, None] * (on[name] - off[name]) for name in off})
    p_WT, R_WT = Kinematics(robot).tool_poses(q)
    expected = None if sag is None else p_WT + sag.along(t, q)
    point = p_WT if expected is None else expected
    holding = robot.holding
    return Samples(
        t=t,
        q=q,
        v=v,
        a=a,
        j=j,
        joint_torque=efforts.joint_torque,
        guardrail_force=efforts.guardrail_force,
        guardrail_torque=efforts.guardrail_torque,
        tool_point=p_WT,
        expected_tool_point=expected,
        tool_deviation=np.asarray(np.linalg.norm(task.path.leg_offset(t, point), axis=1)),
        tool_lag=tool_lag(task, t, point),
        tool_rotation=task.rotation(R_WT, task.path.poses(t)),
        clearance=clearances.query(q).distance if clearance is None else clearance,
        adhesion_needed=holding.each(efforts.guardrail_wrench) if holding and holding.flat else None,
    )


def tool_lag(task: ToolTask, t: FloatArray, p_WT: FloatArray) -> FloatArray:
    """Return how far tool points (N, 3) are from their timed places along the legs, (N,), m."""
    path = task.path
    return np.asarray(np.abs(np.einsum("ki,ki->k", p_WT - path.position(t), path.leg_directions(t))))


def figures(robot: Robot, samples: Samples) -> MotionMetrics:
    """Reduce samples to figures.

    Parameters
    ----------
    robot : Robot
    samples : Samples
    """
    limits = robot.limits

    def use(x: FloatArray, bound: FloatArray) -> float:
        return float((np.abs(x) / bound).max())

    torque = np.linalg.norm(samples.guardrail_torque, axis=1)
    static = Postures(robot).at(samples.q).guardrail_torque
    duration = float(samples.t[-1] - samples.t[0])
    integral = float(np.trapezoid(torque, samples.t))
    return MotionMetrics(
        peak_guardrail_torque=float(torque.max()),
        mean_guardrail_torque=integral / duration,
        rms_guardrail_torque=float(np.sqrt(np.trapezoid(torque**2, samples.t) / duration)),
        peak_static_guardrail_torque=float(np.linalg.norm(static, axis=1).max()),
        min_clearance=float(samples.clearance.min()),
        max_tool_deviation=float(samples.tool_deviation.max()),
        max_tool_rotation=float(samples.tool_rotation.max()),
        max_tool_lag=float(samples.tool_lag.max()),
        limit_use=LimitUse(
            velocity=use(samples.v, limits.velocity),
            acceleration=use(samples.a, limits.acceleration),
            jerk=use(samples.j, limits.jerk),
            torque=use(samples.joint_torque, limits.torque),
        ),
        adhesion_needed=_worst_adhesion(robot, samples),
        duration=duration,
        guardrail_torque_integral=integral,
    )


def _worst_adhesion(robot: Robot, samples: Samples) -> AdhesionPeak | None:
    if robot.holding is None or not robot.holding.adhesive:
        return None
    wrench = np.hstack([samples.guardrail_force, samples.guardrail_torque])
    return robot.holding.worst(wrench, samples.t, samples.adhesion_needed)
