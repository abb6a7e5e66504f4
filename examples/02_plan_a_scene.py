"""Plan a shipped scene, read the figures, see where a gain comes from and where it cannot come from.

Run it with ``python examples/02_plan_a_scene.py``, and the name of a scene or a scene file if you like.
"""

from __future__ import annotations

import sys

import numpy as np

import cmbot
from cmbot.robot import Dynamics

scene = cmbot.load_scene(sys.argv[1] if len(sys.argv) > 1 else "triangle")
plan = cmbot.plan(scene)  # raises a cmbot.PlanningError when there is no plan; never returns None
print(plan.summary())
print(*plan.remarks(), sep="\n")

# The trajectory is piecewise quintics: evaluate it, or a derivative of it, at any time.
t = np.linspace(0.0, plan.trajectory.duration, 5)
print("\njoint angles every quarter of the time, deg:")
print(np.round(np.rad2deg(plan.trajectory.evaluate(t)), 1))

print("\nthe certificate, check by check:")
for check in plan.certificate.checks:
    sign = ">=" if check.at_least else "<="
    where = f"{check.value:.3g} {sign} {check.bound:.3g} {check.unit} at t = {check.time:.2f} s"
    print(f"  {check.quantity}: {where}")

# Gravity at a via-point depends on the posture alone. The splines pass through every via-point whatever the
# optimiser does, so the largest of these torques is what gravity asks of any of them.
at_via_points = Dynamics(plan.robot).static_efforts(plan.trajectory.q).guardrail_torque
print("\ngravity's peak torque on the guardrail, Nm:")
print(f"  baseline, from the scene's posture:  {plan.baseline_figures.peak_static_guardrail_torque:.2f}")
print(f"  planned, at its via-points:          {np.linalg.norm(at_via_points, axis=1).max():.2f}")
print(f"  planned, all along:                  {plan.figures.peak_static_guardrail_torque:.2f}")
