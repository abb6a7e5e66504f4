"""Joints that are locked between where a robot holds and the base of its arm: what their brakes hold."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.robot.joint_kinds import prismatic_joints, turn_axis


@dataclass(frozen=True, kw_only=True, eq=False)
class HoldingJoint:
    """A locked joint between the root of a robot and the base of its arm.

    Attributes
    ----------
    name : str
    point, axis : (3,), m
        Of the joint, in W.
    mass : float, kg
        Of what does not move beyond it.
    centre : (3,), m
        Centre of that mass, in W.
    limit : float, Nm
        What it holds while it is locked; infinite where nothing says it.
    """

    name: str
    point: FloatArray
    axis: FloatArray
    mass: float
    centre: FloatArray
    limit: float

    def moved(self, X: Any) -> HoldingJoint:
        """Return it with the robot's root at a pose, a `pinocchio.SE3`."""
        point, centre = X.act(self.point), X.act(self.centre)
        return replace(self, point=point, axis=X.rotation @ self.axis, centre=centre)

    def torque(self, wrench: FloatArray, foot_point: FloatArray, gravity: FloatArray) -> FloatArray:
        """Return the torques (N,), Nm, that it holds.

        Parameters
        ----------
        wrench : (N, 6), N and Nm
            Of the moving arm on the base, about `foot_point` in W.
        foot_point, gravity : (3,), m and m/s2
        """
        moment = wrench[:, 3:] - np.cross(self.point - foot_point, wrench[:, :3])
        still = np.cross(self.centre - self.point, self.mass * gravity)
        return np.asarray((moment + still) @ self.axis)


def holding_joints(
    model: Any, moving: Collection[int], stance: FloatArray, base_frame: str
) -> tuple[HoldingJoint, ...]:
    """Return the locked joints between the root and the arm's base, root first; they hold their efforts.

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
    slides, found = prismatic_joints(model), list[HoldingJoint]()
    for k in list(model.supports[base])[1:]:
        if slides[k - 1]:
            continue
        beyond = [j for j in model.subtrees[k] if j not in moving]
        masses = np.array([model.inertias[j].mass for j in beyond])
        centres = np.array([data.oMi[j].act(model.inertias[j].lever) for j in beyond])
        effort = float(model.effortLimit[model.joints[k].idx_v])
        found.append(
            HoldingJoint(
                name=model.names[k],
                point=np.array(data.oMi[k].translation),
                axis=np.asarray(data.oMi[k].rotation @ turn_axis(model.joints[k])),
                mass=float(masses.sum()),
                centre=masses @ centres / max(float(masses.sum()), 1e-12),
                limit=effort if effort > 0 else np.inf,
            )
        )
    return tuple(found)
