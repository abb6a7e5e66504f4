"""Forward kinematics and Jacobians of the tool and the centre of mass (Chang 2021, Eqs. (1)-(3), (15))."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.robot.postures import Postures
from cmbot.robot.robot import Robot

__all__ = ["Kinematics"]

# From this number of postures on a batch is quicker than one call each: benchmarks/kernels.py.
_MANY = 64


class Kinematics:
    """Forward kinematics and Jacobians of a robot's tool and centre of mass, in W.

    It owns pinocchio's working memory, so it is cheap to call and not to be shared between threads.

    Parameters
    ----------
    robot : Robot
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._data = robot.model.createData()
        self._tool = robot.tool_frame_id

    @cached_property
    def _postures(self) -> Postures:
        return Postures(self.robot)

    def tool_pose(self, q: FloatArray) -> Any:
        """Pose X_WT of the tool frame, a `pinocchio.SE3`, at posture `q` (n,)."""
        pin.forwardKinematics(self.robot.model, self._data, q)
        return pin.updateFramePlacement(self.robot.model, self._data, self._tool).copy()

    def tool_poses(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tool points p_WT (N, 3), m, and orientations R_WT (N, 3, 3) at postures `q` (N, n)."""
        if len(q) >= _MANY:
            at = self._postures.tool_at(q)
            return at.tool_point, at.tool_rotation
        p, R = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
        model, data = self.robot.model, self._data
        for k, q_k in enumerate(q):
            pin.forwardKinematics(model, data, q_k)
            X_WT = pin.updateFramePlacement(model, data, self._tool)
            p[k], R[k] = X_WT.translation, X_WT.rotation
        return p, R

    def tool_jacobian(self, q: FloatArray) -> tuple[Any, FloatArray]:
        """Pose X_WT and Jacobian (6, n) of the tool at `q` (n,).

        The Jacobian's rows are the velocity of the tool point, m/rad, then the angular velocity, both in W
        (Chang 2021, Eq. (15)).
        """
        model, data = self.robot.model, self._data
        J = pin.computeFrameJacobian(model, data, q, self._tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        return pin.updateFramePlacement(model, data, self._tool).copy(), J

    def tool_point_jacobians(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tool points p_WT (N, 3), m, and their Jacobians (N, 3, n), m/rad, at postures `q` (N, n)."""
        if len(q) >= _MANY:
            at = self._postures.tool_at(q)
            return at.tool_point, at.jacobian[:, :3]
        p, J = np.empty((len(q), 3)), np.empty((len(q), 3, q.shape[1]))
        for k, q_k in enumerate(q):
            X_WT, J_k = self.tool_jacobian(q_k)
            p[k], J[k] = X_WT.translation, J_k[:3]
        return p, J

    def centre_of_mass(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centre of mass (3,) of the moving arm, m, in W, and its Jacobian (3, n) at `q` (n,)."""
        model, data = self.robot.model, self._data
        # pinocchio leaves the universe's inertia out: this is the arm's centre of mass alone.
        J = pin.jacobianCenterOfMass(model, data, q)
        return data.com[0].copy(), J.copy()
