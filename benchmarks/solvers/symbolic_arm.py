"""Rigid-body dynamics in casadi's symbols, from a pinocchio model: derivatives of any order are then exact.

Recursions in the joints' own frames (Featherstone 2008, Table 5.1); spatial vectors linear then angular.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from measure import required

from cmbot.robot import Dynamics, Kinematics, Robot

__all__ = ["SymbolicArm", "verified"]

_AGREE, _STATES = 1e-10, 20
_AXES = {"JointModelRX": (1, 0, 0), "JointModelRY": (0, 1, 0), "JointModelRZ": (0, 0, 1)}


@dataclass(frozen=True)
class _Turn:
    """Where a joint's frame is in that of its parent: rotation (3, 3) and position (3,), symbolic."""

    R: Any
    p: Any

    def motion(self, m: Any) -> Any:
        """Motion vector (6,) of the parent's frame, in the joint's."""
        ca = required("casadi")
        angular = self.R.T @ m[3:]
        return ca.vertcat(self.R.T @ (m[:3] - ca.cross(self.p, m[3:])), angular)

    def force(self, f: Any) -> Any:
        """Force vector (6,) of the joint's frame, in the parent's."""
        ca = required("casadi")
        force = self.R @ f[:3]
        return ca.vertcat(force, self.R @ f[3:] + ca.cross(self.p, force))


class SymbolicArm:
    """A serial arm of revolute joints.

    Parameters
    ----------
    robot : Robot

    Attributes
    ----------
    q, v, a : casadi SX
        Symbols (n,), rad, rad/s, rad/s2.
    guardrail_torque : casadi SX
        (3,), Nm, as `cmbot.robot.Efforts` has it.
    joint_torque : casadi SX
        (n,), Nm.
    tool_point, tool_rotation : casadi SX
        (3,), m, and (3, 3), in W.

    Raises
    ------
    MissingExtra
        When casadi is not installed.
    """

    def __init__(self, robot: Robot) -> None:
        ca = required("casadi")
        self._model = robot.model
        n = robot.dof
        self.q, self.v, self.a = (ca.SX.sym(name, n) for name in "qva")
        turns = [self._turn(i) for i in range(1, n + 1)]
        self.guardrail_torque, self.joint_torque = self._efforts(turns)
        R, p = ca.SX.eye(3), ca.SX.zeros(3)
        for turn in turns:
            R, p = R @ turn.R, p + R @ turn.p
        tool = self._model.frames[robot.tool_frame_id]
        if tool.parentJoint != n:
            raise SystemExit("the tool is not on the last joint: this benchmark has no such arm")
        self.tool_point = p + R @ ca.DM(tool.placement.translation)
        self.tool_rotation = R @ ca.DM(tool.placement.rotation)

    def _axis(self, i: int) -> Any:
        joint = self._model.joints[i]
        if joint.shortname() not in _AXES or self._model.parents[i] != i - 1:
            raise SystemExit(f"{joint.shortname()}: this benchmark knows serial arms with RX, RY, RZ only")
        return np.array(_AXES[joint.shortname()], dtype=float)

    def _turn(self, i: int) -> _Turn:
        ca = required("casadi")
        axis, angle = self._axis(i), self.q[i - 1]
        X = self._model.jointPlacements[i]
        K = ca.DM(np.cross(np.eye(3), axis))
        # Rodrigues' formula.
        R = ca.DM.eye(3) + ca.sin(angle) * K + (1 - ca.cos(angle)) * (K @ K)
        return _Turn(ca.DM(X.rotation) @ R, ca.DM(X.translation))

    def _efforts(self, turns: list[_Turn]) -> tuple[Any, Any]:
        ca = required("casadi")
        n = len(turns)
        motion, acceleration = ca.SX.zeros(6), ca.SX(-self._model.gravity.vector)
        forces = []
        for i, turn in enumerate(turns, start=1):
            S = ca.vertcat(ca.DM.zeros(3), ca.DM(self._axis(i)))
            rate = S * self.v[i - 1]
            motion = turn.motion(motion) + rate
            acceleration = turn.motion(acceleration) + S * self.a[i - 1] + _crossed(ca, motion, rate)
            inertia = ca.DM(self._model.inertias[i].matrix())
            forces.append(inertia @ acceleration + _crossed_force(ca, motion, inertia @ motion))
        torques = [ca.SX(0)] * n
        force = ca.SX.zeros(6)
        for i in range(n, 0, -1):
            force = force + forces[i - 1]
            torques[i - 1] = ca.dot(ca.DM(self._axis(i)), force[3:])
            force = turns[i - 1].force(force)
        return -force[3:], ca.vertcat(*torques)


def _crossed(ca: Any, m: Any, other: Any) -> Any:
    """Spatial cross product of motions, ``m x other``."""
    return ca.vertcat(
        ca.cross(m[3:], other[:3]) + ca.cross(m[:3], other[3:]),
        ca.cross(m[3:], other[3:]),
    )


def _crossed_force(ca: Any, m: Any, f: Any) -> Any:
    """Spatial cross product of a motion and a force, ``m x* f``."""
    return ca.vertcat(ca.cross(m[3:], f[:3]), ca.cross(m[3:], f[3:]) + ca.cross(m[:3], f[:3]))


def verified(robot: Robot) -> SymbolicArm:
    """Return the symbolic arm when pinocchio agrees with it, to 1e-10 of the largest value, at random states.

    Raises
    ------
    MissingExtra
        When casadi is not installed.
    SystemExit
        When it does not.
    """
    ca = required("casadi")
    arm = SymbolicArm(robot)
    outputs = [arm.guardrail_torque, arm.joint_torque, arm.tool_point, arm.tool_rotation]
    function = ca.Function("arm", [arm.q, arm.v, arm.a], outputs)
    q, v, a = np.random.default_rng(0).normal(size=(3, _STATES, robot.dof))
    efforts, (p, R) = Dynamics(robot).efforts(q, v, a), Kinematics(robot).tool_poses(q)
    for k in range(_STATES):
        expected = (efforts.guardrail_torque[k], efforts.joint_torque[k], p[k], R[k])
        for got, there in zip(function(q[k], v[k], a[k]), expected, strict=True):
            off = np.abs(np.array(got).reshape(there.shape) - there).max()
            if not off <= _AGREE * max(1.0, np.abs(there).max()):
                raise SystemExit(f"casadi's dynamics miss pinocchio's by {off:.1e}")
    return arm
