"""Load the shipped robot and ask it where its tool is and what it weighs on the guardrail.

Run it with ``python examples/01_load_robot.py``.
"""

from __future__ import annotations

import numpy as np

import cmbot
from cmbot.robot import Dynamics, Kinematics

robot = cmbot.load_robot("cmbot", tool_length=0.30)
print(f"{robot.name}: {robot.dof} joints, {robot.mass:.2f} kg, {robot.arm_mass:.2f} kg of it moving")
for name, low, high, torque in zip(
    robot.joints, robot.limits.lower, robot.limits.upper, robot.limits.torque, strict=True
):
    print(f"  {name}: {np.rad2deg(low):5.0f} to {np.rad2deg(high):4.0f} deg, {torque:.0f} Nm")

# The paper's initial posture of the triangle, Chang 2021, Section 5. Inside everything is in radians.
q = robot.posture(np.deg2rad([-10, -90, 90, 0, 10, 50, 0]))

X_WT = Kinematics(robot).tool_pose(q)
print("tool point in W, m:      ", np.round(X_WT.translation, 4))
print("tool axis in W:          ", np.round(X_WT.rotation[:, 2], 4))

# Time is the leading axis everywhere, so one posture is an array of shape (1, 7).
rest = Dynamics(robot).static_efforts(q[None])
print("force on guardrail, N:   ", np.round(rest.guardrail_force[0], 2))
print("torque on guardrail, Nm: ", np.round(rest.guardrail_torque[0], 2))
print(f"its norm:                 {np.linalg.norm(rest.guardrail_torque[0]):.2f} Nm")
print("beside it, the climber's:", np.round(robot.carrier_torque, 2))
print("joint torques, Nm:       ", np.round(rest.joint_torque[0], 1))
