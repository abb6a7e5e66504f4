"""What the locked climbing joints bear in the paper's two baselines, one foot on the post.

    python tools/holding_torque.py

The paper's robot did both motions, so its brakes hold that. The largest of these torques, rounded up to
10 Nm, is `holding_torque` in models/urdf/joint_limits.yaml.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from cmbot import load_scene
from cmbot.planning import plan

SCENES = Path(__file__).parents[1] / "studies" / "chang2021" / "scenes"


def main() -> None:
    """Print the largest torque of each joint in both baselines, and in what is planned."""
    largest = 0.0
    for name in ("chang2021_triangle", "chang2021_line"):
        made = plan(load_scene(SCENES / f"{name}.yaml"))
        planned = list(made.segment_samples.values())
        for what, samples in (
            ("baseline", [segment.samples for segment in made.baseline.segments]),
            ("planned", planned),
        ):
            wrench = np.vstack([np.hstack([each.guardrail_force, each.guardrail_torque]) for each in samples])
            torque = np.abs(made.robot.holding_torque(wrench)).max(axis=0)
            largest = max(largest, float(torque.max())) if what == "baseline" else largest
            each = zip(made.robot.holding_joints, torque, strict=True)
            print(f"{name}, {what}: " + ", ".join(f"{joint.name} {value:.1f} Nm" for joint, value in each))
    print(
        f"largest of the baselines {largest:.1f} Nm, rounded up to 10 Nm: {10 * math.ceil(largest / 10)} Nm"
    )


if __name__ == "__main__":
    main()
