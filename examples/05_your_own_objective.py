"""Minimise another objective: any function of the wrench on the guardrail.

Run it with ``python examples/05_your_own_objective.py``.

Here it is the bending stress where the post is clamped, 1.05 m below the foot, for a post that resists
bending about y three times as well as about x. The tool may turn as it likes: that leaves the arm enough
freedom to choose between the two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import cmbot

FloatArray = NDArray[np.float64]
CLAMP = -1.05  # m, height in W
SECTION_MODULI = np.array([1.0e-5, 3.0e-5])  # m3, about x and y

# The wrench is force then moment about O0; about the clamp the moment is n_0 - p x f, with p = (0, 0, CLAMP).
MOMENT_AT_CLAMP = np.array([[0.0, CLAMP, 0.0, 1.0, 0.0, 0.0], [-CLAMP, 0.0, 0.0, 0.0, 1.0, 0.0]])
STRESSES = MOMENT_AT_CLAMP / SECTION_MODULI[:, None] / 1e6  # MPa


def stress(wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the stress (N,), MPa, of wrenches (N, 6), and its gradient (N, 6)."""
    both = wrench @ STRESSES.T
    value = np.linalg.norm(both, axis=1)
    return value, both / np.maximum(value, 1e-12)[:, None] @ STRESSES


scene = cmbot.load_scene(
    {
        "format": "cmbot-scene/2",
        "name": "stroke",
        "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
        "tool_path": {"keep": "position", "legs": [{"by": [0, -0.1, 0], "seconds": 2}], "via_points": 5},
        "planner": {"chart_spacing": 0.5},  # rad, coarse: a self-motion of four dimensions is wide
    }
)
usual = cmbot.plan(scene)  # minimises the torque on the guardrail
own = cmbot.plan(scene, objective=stress)  # a wrong gradient would be refused before anything is planned

for name, plan in (("minimised: torque", usual), (f"minimised: {own.objective.name}", own)):
    samples = plan.samples
    peak, _ = stress(np.hstack([samples.guardrail_force, samples.guardrail_torque]))
    print(f"{name:<20} stress {peak.max():6.2f} MPa, torque {plan.figures.peak_guardrail_torque:6.2f} Nm")
if own.lower_bound is not None:
    # Of functions other than a moment it is an estimate.
    print(
        f"no plan within the limits was found with a static stress below {own.lower_bound.value:.2f} MPa "
        f"({own.lower_bound.kind})"
    )
