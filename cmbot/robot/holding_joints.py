"""Joints that are locked between where a robot holds and the base of its arm: what their brakes hold."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray, cross
from cmbot.robot.elasticity import JointElasticity
from cmbot.robot.joint_kinds import prismatic_joints, turn_axis

FOOT_2 = "foot_2"
"""The link of a robot's second foot; its root is the first one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HoldingJoint:
    """A locked joint between a foot of a robot and the base of its arm.

    Attributes
    ----------
    name : str
    foot : int
        Which foot it leads to, from 0, the root.
    point, axis : (3,), m
        Of the joint, in W.
    mass : float, kg
        Of what does not move on the foot's side of it.
    centre : (3,), m
        Centre of that mass, in W.
    effort : float, Nm
        What it drives; infinite where nothing says it.
    limit : float, Nm
        What it holds while it is locked; infinite where nothing says it.
    spring : JointElasticity or None
        How it gives way; None: it is rigid.
    """

    name: str
    foot: int
    point: FloatArray
    axis: FloatArray
    mass: float
    centre: FloatArray
    effort: float
    limit: float
    spring: JointElasticity | None = None

    def moved(self, X: Any) -> HoldingJoint:
        """Return it with the robot's root at a pose, a `pinocchio.SE3`."""
        point, centre = X.act(self.point), X.act(self.centre)
        return replace(self, point=point, axis=X.rotation @ self.axis, centre=centre)

    def motion(self, about: FloatArray) -> FloatArray:
        """Return how a point (3,) in W moves as the joint turns by 1 rad: (6,), linear, then angular.

        With the wrench on the joint's foot about that point it is also what gives the joint's torque.
        """
        return np.hstack([cross(self.axis, about - self.point), self.axis])

    def compliance(self, about: FloatArray) -> FloatArray:
        """Return how a wrench about a point (3,) in W moves that point: (6, 6), linear, then angular."""
        if self.spring is None:
            return np.zeros((6, 6))
        along = np.outer(self.axis, self.axis)
        give = along / self.spring.stiffness
        if self.spring.tilting is not None:
            give = give + (np.eye(3) - along) / self.spring.tilting
        motion = np.vstack([pin.skew(self.point - about), np.eye(3)])
        return np.asarray(motion @ give @ motion.T)

    def own_torque(self, gravity: FloatArray) -> float:
        """Return the torque, Nm, by the weight on the foot's side of it, which it does not bear."""
        return float(cross(self.centre - self.point, self.mass * gravity) @ self.axis)


def holding_rows(
    joints: Sequence[HoldingJoint],
    shares: Sequence[FloatArray],
    foot_point: FloatArray,
    gravity: FloatArray,
    carrier: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return rows (k, 6) and constants (k,), Nm, that make torques of joints of the moving arm's wrench.

    Parameters
    ----------
    joints : sequence of HoldingJoint
    shares : sequence of (6, 6)
        Of the whole wrench, on each foot.
    foot_point, gravity : (3,), m and m/s2
        O0 in W, which wrenches are about.
    carrier : (6,), N and Nm
        Wrench of what does not move.
    """
    rows = np.array([joint.motion(foot_point) @ shares[joint.foot] for joint in joints]).reshape(-1, 6)
    return rows, rows @ carrier - np.array([joint.own_torque(gravity) for joint in joints])


def leg_compliance(joints: Sequence[HoldingJoint], feet: int, about: FloatArray) -> FloatArray | None:
    """Return the compliance (feet, 6, 6) of the locked joints that lead to each foot; None: they are rigid.

    Parameters
    ----------
    joints : sequence of HoldingJoint
    feet : int
    about : (3,), m
        In W.
    """
    if all(joint.spring is None for joint in joints):
        return None
    each = np.zeros((feet, 6, 6))
    for joint in joints:
        each[joint.foot] += joint.compliance(about)
    return each


def holding_joints(
    model: Any, moving: Collection[int], stance: FloatArray, base_frame: str
) -> tuple[HoldingJoint, ...]:
    """Return the locked joints between the root and the arm's base, root first; they hold their efforts.

    Then those from there to the second foot of a robot that has one.

    Parameters
    ----------
    model : pinocchio.Model
        Of all joints; its root is where the robot holds.
    moving : collection of int
        Those of the arm.
    stance : (nq,)
        Where the others are locked.
    base_frame : str
    """
    data, base = model.createData(), model.frames[model.getFrameId(base_frame)].parentJoint
    pin.forwardKinematics(model, data, stance)
    bodies = {k for k in range(model.njoints) if k not in moving}
    to_root, to_foot = list(model.supports[base])[1:], list[int]()
    if model.existFrame(FOOT_2, pin.FrameType.BODY):
        foot = model.frames[model.getFrameId(FOOT_2)].parentJoint
        to_foot = [k for k in list(model.supports[foot])[1:] if k not in to_root and k in bodies]
    slides, joints = prismatic_joints(model), list[HoldingJoint]()
    for k in (*to_root, *to_foot):
        if slides[k - 1]:
            continue
        beyond = set(model.subtrees[k])
        side = sorted(bodies - beyond if k in to_root else bodies & beyond)
        masses = np.array([model.inertias[j].mass for j in side])
        centres = np.array([data.oMi[j].act(model.inertias[j].lever) for j in side])
        effort = float(model.effortLimit[model.joints[k].idx_v]) or np.inf
        joints.append(
            HoldingJoint(
                name=model.names[k],
                foot=0 if k in to_root else 1,
                point=np.array(data.oMi[k].translation),
                axis=np.asarray(data.oMi[k].rotation @ turn_axis(model.joints[k])),
                mass=float(masses.sum()),
                centre=masses @ centres / max(float(masses.sum()), 1e-12),
                effort=effort,
                limit=effort,
            )
        )
    return tuple(joints)
