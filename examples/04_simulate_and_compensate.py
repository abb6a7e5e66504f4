"""Simulate a plan with an elastic guardrail and elastic links, and compensate the predicted sag.

Run it with ``python examples/04_simulate_and_compensate.py``.
"""

from __future__ import annotations

from dataclasses import replace

import cmbot

# A scene may be a mapping as well as a file: what is left out has its default, the guardrail, too.
scene = cmbot.load_scene(
    {
        "format": "cmbot-scene/2",
        "name": "stroke",
        "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
        "tool_path": {"legs": [{"by": [0, -0.4, 0], "seconds": 4}], "via_points": 8},
        "planner": {"baseline": "paper"},
    }
)
plain = cmbot.plan(scene, options=replace(scene.planner, compensate=False))
compensated = cmbot.plan(scene)  # as by default wherever something bends
if compensated.compensation is not None:
    shift = 1e3 * compensated.compensation.largest_shift
    print(f"the commanded tool points are shifted by up to {shift:.2f} mm")

# Both drive the same elastic arm; so does the baseline, Eq. (22) from the scene's posture.
tracking, after = cmbot.simulate(plain), cmbot.simulate(compensated)
motions = {"baseline": tracking.baseline, "planned": tracking.planned, "compensated": after.planned}

print(f"\n{'RMS while it moves, mm':<28}" + "".join(f"{name:>13}" for name in motions))
for what, part in (
    ("bent from expected tool", "total"),  # a plan without compensation expects no sag
    ("  of that at rest", "static"),
    ("  of that vibration", "dynamic"),
    ("bent tool off its path", "path"),
):
    values = [1e3 * getattr(motion.metrics, part).rms[3] for motion in motions.values()]
    print(f"{what:<28}" + "".join(f"{value:>13.3f}" for value in values))

before = motions["baseline"].metrics.path.rms[3]
for name in ("planned", "compensated"):
    reduction = 1 - motions[name].metrics.path.rms[3] / before
    print(f"\n{name}: off its path {100 * reduction:.1f} % less than the baseline", end="")
print(f"\npeak torque on the guardrail, Nm: {plain.figures.peak_guardrail_torque:.2f}, ", end="")
print(f"compensated {compensated.figures.peak_guardrail_torque:.2f}")
