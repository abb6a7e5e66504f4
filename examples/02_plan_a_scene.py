"""Plan a shipped scene, read the figures, see where a gain comes from and where it cannot come from.

Run it with ``python examples/02_plan_a_scene.py``, and the name of a scene or a scene file if you like.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

import cmbot
from cmbot.planning import remarks
from cmbot.robot import Dynamics

scene = cmbot.load_scene(sys.argv[1] if len(sys.argv) > 1 else "triangle")
plan = cmbot.plan(scene)  # raises a cmbot.PlanningError when there is no plan; never returns None
print(plan.summary())
print(*remarks(plan), sep="\n")

# The trajectory is piecewise quintics: evaluate it, or a derivative of it, at any time.
t = np.linspace(0.0, plan.trajectory.duration, 5)
print("\njoint angles every quarter of the time, deg:")
print(np.round(np.rad2deg(plan.trajectory.evaluate(t)), 1))

print("\nthe certificate, check by check:")
for check in plan.certificate.checks:
    sign = ">=" if check.at_least else "<="
    where = f"{check.value:.3g} {sign} {check.bound:.3g} {check.unit} at t = {check.time:.2f} s"
    print(f"  {check.quantity}: {where}")

# With fixed knots the splines pass through every via-point whatever the optimiser does, and gravity's torque
# there depends on the posture alone: what the paper's Eq. (30) varies cannot lower its peak. As in the paper,
# and as in the baseline, the sag is left as it is.
fixed = cmbot.plan(scene, options=replace(scene.planner, knots="fixed", compensate=False))
at_via_points = Dynamics(fixed.robot).static_efforts(fixed.trajectory.q).guardrail_torque
print("\ngravity's peak torque on the guardrail, Nm:")
print(f"  baseline, from the scene's posture:  {plan.baseline.figures.peak_static_guardrail_torque:.2f}")
print(f"  fixed knots, at the via-points:      {np.linalg.norm(at_via_points, axis=1).max():.2f}")
print(f"  fixed knots, all along:              {fixed.figures.peak_static_guardrail_torque:.2f}")
print(f"  as the scene has it, all along:      {plan.figures.peak_static_guardrail_torque:.2f}")
if plan.torque_floor is not None:
    print(f"  lower bound, at one of these:        {plan.torque_floor:.2f} ({plan.torque_floor_kind})")
