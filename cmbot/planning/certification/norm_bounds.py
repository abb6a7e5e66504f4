"""How large torques and tool poses become at complex joint positions: what bounds the error of interpolation.

The recursion of inverse dynamics, written for norms. A rotation by an angle with imaginary part y has the
norm exp |y|, a joint that slides by d lengthens its link by |d|, and no cross product is longer than the
product of both lengths: all hold for complex vectors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.robot import Robot, prismatic_joints
from cmbot.toolpath import ToolPath
from cmbot.trajectory import Ellipses, Pieces


@dataclass(frozen=True, kw_only=True, eq=False)
class NormBounds:
    """What norms do not exceed on Bernstein ellipses, R around each of K pieces.

    Attributes
    ----------
    joint_torque : (K, R, n), Nm, of joints that slide N
    guardrail_force : (K, R), N
    guardrail_torque : (K, R), Nm
    tool_point : (K, R), m
        Of a fixed tool in the part's frame, as the two below.
    tool_velocity : (K, R), m/s
        Of the tool point.
    tool_rotation : (K, R)
        Spectral norm of the rotation matrix.
    """

    joint_torque: FloatArray
    guardrail_force: FloatArray
    guardrail_torque: FloatArray
    tool_point: FloatArray
    tool_velocity: FloatArray
    tool_rotation: FloatArray


def norm_bounds(robot: Robot, on: Ellipses) -> NormBounds:
    """Bound the norms of a robot's torques and tool pose.

    Parameters
    ----------
    robot : Robot
        Its arm is a serial chain of joints that turn or slide, as `load_robot` guarantees.
    on : Ellipses
    """
    model, on, slides = robot.model, _of_all_joints(robot, on), prismatic_joints(robot.model)
    n = len(slides)
    bodies = list(model.inertias)[1:]
    mass = [float(body.mass) for body in bodies]
    lever = [float(np.linalg.norm(body.lever)) for body in bodies]
    inertia = [float(np.linalg.norm(body.inertia, 2)) for body in bodies]
    steps = [np.array(X.translation) for X in model.jointPlacements][1:]
    fixed = [float(np.linalg.norm(step)) for step in steps]
    # The torque is about O0, the point in W.
    to_foot = float(np.linalg.norm(steps[0] - np.array(robot.foot_point)))
    armature = np.broadcast_to(model.armature, n)
    with np.errstate(over="ignore", invalid="ignore"):
        turn = np.exp(np.where(slides, 0.0, on.turn))
        offset = fixed + np.where(slides, on.q, 0.0)
        point, rotation = np.zeros(turn.shape[:2]), np.ones(turn.shape[:2])
        spin, spin_rate = np.zeros_like(point), np.zeros_like(point)
        acceleration = np.full_like(point, float(np.linalg.norm(model.gravity.linear)))
        force, moment, turned = [], [], []
        for i in range(n):
            e, v, a = turn[..., i], on.v[..., i], on.a[..., i]
            point = point + rotation * offset[..., i]
            rotation = rotation * e
            turned.append(rotation)
            acceleration = e * (acceleration + (spin_rate + spin**2) * offset[..., i])
            if slides[i]:
                acceleration = acceleration + 2 * spin * v + a
            else:
                spin_rate = e * spin_rate + a + e * spin * v
                spin = e * spin + v
            force.append(mass[i] * (acceleration + (spin_rate + spin**2) * lever[i]))
            moment.append(inertia[i] * (spin_rate + spin**2))
        joint_torque = np.empty_like(turn)
        tool = float(np.linalg.norm(model.frames[robot.tool_frame_id].placement.translation))
        # In the last joint's frame the force on the tool does not change.
        carried = np.full_like(point, float(np.linalg.norm(robot.tool_force)))
        about = tool * carried
        velocity, beyond = np.zeros_like(point), np.full_like(point, tool)
        for i in reversed(range(n)):
            about = moment[i] + lever[i] * force[i] + about
            carried = force[i] + carried
            joint_torque[..., i] = (carried if slides[i] else about) + armature[i] * on.a[..., i]
            velocity = velocity + turned[i] * on.v[..., i] * (1.0 if slides[i] else beyond)
            # From here on in the frame of the joint before, about its origin.
            beyond = offset[..., i] + turn[..., i] * beyond
            carried = turn[..., i] * carried
            arm = np.asarray(offset[..., i])
            if i == 0:
                arm = to_foot + np.where(slides[0], on.q[..., 0], 0.0)
            about = turn[..., i] * about + arm * carried
        point = point + rotation * tool
        if robot.fixed_tool is not None:
            point, velocity = _fixed_tool_bounds(robot, on, turn, slides)
        return NormBounds(
            joint_torque=robot.coupling.summed(joint_torque),
            guardrail_force=carried,
            guardrail_torque=about,
            tool_point=point,
            tool_velocity=velocity,
            tool_rotation=rotation,
        )


def _of_all_joints(robot: Robot, on: Ellipses) -> Ellipses:
    """How large the state of all m joints is where those of a posture are as large as `on` says."""
    coupling = robot.coupling
    turn, q, v, a = (np.abs(coupling.rates(each)) for each in (on.turn, on.q, on.v, on.a))
    return Ellipses(turn=turn, q=q + np.abs(coupling.offset), v=v, a=a)


def _fixed_tool_bounds(
    robot: Robot, on: Ellipses, turn: FloatArray, slides: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Bounds (K, R), m and m/s, of a fixed tool's point, seen from joint after joint up to the part.

    `turn` (K, R, m) are those of the joints' rotations, `slides` (m,) says which slide.
    """
    model, first = robot.model, float(np.linalg.norm(robot.fixed_tool.translation - robot.base_point))
    placements = [*list(model.jointPlacements)[2:], model.frames[robot.tool_frame_id].placement]
    seen, velocity = np.full(turn.shape[:2], first), np.zeros(turn.shape[:2])
    for i, X in enumerate(placements):
        e, v = turn[..., i], on.v[..., i]
        if slides[i]:
            seen, velocity = seen + on.q[..., i], velocity + v
        else:
            seen, velocity = e * seen, e * (velocity + v * seen)
        seen = seen + float(np.linalg.norm(X.translation))
    return seen, velocity


def timed_pose_bounds(path: ToolPath, pieces: Pieces) -> tuple[FloatArray, FloatArray]:
    """Return what interpolation misses (K,), m, of the timed tool point, and bounds (K, R) of the rotation.

    The bounds are those of the norm of the timed orientation on the ellipses, zero where it is constant.

    Parameters
    ----------
    path : ToolPath
    pieces : Pieces
        None of which has a break of the path inside.

    Notes
    -----
    A point on an arc and a rotation are exponentials of an angle that is a polynomial in time: on an ellipse
    they grow with the exponential of its imaginary part. Where an arc of radius r is rolled on a cylinder of
    curvature k, the angle about that is k r times the sine of the arc's, whose imaginary part is no larger
    than the hyperbolic sine of the arc's.
    """
    times, at = pieces.times.ravel(), np.repeat(pieces.middle, pieces.times.shape[1])
    angle, radius = path.arc_angle(times, at)
    radius, roll = radius.reshape(pieces.times.shape)[:, :1], path.roll(pieces.middle)[:, None]
    rolled = roll > 0
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        imaginary = pieces.imaginary(angle[:, None])[..., 0]
        swing = np.linalg.norm(pieces.imaginary(path.turn(times, at)), axis=2)
        turn = np.exp(swing + np.where(rolled, roll * radius * np.sinh(imaginary), 0.0))
        size = radius * np.exp(imaginary) + np.where(rolled, turn / roll, 0.0)
        point = np.where((radius > 0)[:, 0] | rolled[:, 0], pieces.remainder(size), 0.0)
    # A constant has no remainder: nothing is added where the tool keeps its orientation.
    return point, turn if path.turns else np.zeros_like(turn)
