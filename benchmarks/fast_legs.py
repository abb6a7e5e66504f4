"""How many legs are planned in little more than a time that is proven to suffice.

    python benchmarks/fast_legs.py --seed 7 [--count 40]

Straight legs of eight arms. That a time suffices is proven apart from the planner: the posture is led along
the leg from the start by Newton steps, and one C3 law from rest to rest keeps velocities, accelerations,
jerks, torques and ranges along that branch, clear of the arm's own links. The shipped arm's weight has a
torque about its foot that the locked climbing joints hold. The seconds asked for are 5 to 20 %
more.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from rich.console import Console
from scipy.interpolate import make_interp_spline
from suite.arms import ARMS
from suite.scenes import make_scene, start_posture
from suite.world import FloatArray, World, limits_in

from cmbot import PlanningError, load_scene, plan
from cmbot.toolpath import SpeedProfile

__all__ = ["fast_scene", "proven_seconds"]

_ARMS = 8
_LENGTHS, _LONGER = (0.15, 0.5), (1.05, 1.2)
_STATIONS, _TIMES, _TRIES, _MARGIN = 121, 801, 1000, 0.02
# Change of a joint from one station to the next at most, rad, and what the locked climbing joints hold of the
# weight about the foot, with room, Nm.
_LARGEST_STEP, _HELD = 0.1, 380.0
# The law has two ramps without a cruise; it may use this share of every bound.
_RAMP, _USE = 0.5, 0.99


def proven_seconds(
    world: World, q: FloatArray, rates: list[FloatArray], by: FloatArray, held: float = np.inf
) -> float | None:
    """Return the least time, s, of a leg `by` (3,), m, along the branch of a posture (n,); None without one.

    `rates` are the bounds (n,) of velocity, acceleration and jerk; `held` is the torque, Nm, of the weight
    about the foot at most.
    """
    p, R = world.pose(q)
    postures = [q]
    for share in np.linspace(0.0, 1.0, _STATIONS)[1:]:
        after = world.solve(postures[-1], p + share * by, R, "pose")
        if after is None or not world.admissible(after) or np.abs(after - postures[-1]).max() > _LARGEST_STEP:
            return None
        if world.gravity_torque(after) > held:
            return None
        postures.append(after)
    along = make_interp_spline(np.linspace(0.0, 1.0, _STATIONS), np.array(postures), k=5)
    law, u = SpeedProfile(kind="quiet", ramp=_RAMP).law, np.linspace(0.0, 1.0, _TIMES)
    s, (d, dd, ddd) = law.share(u), (law.rate(u, k)[:, None] for k in (1, 2, 3))
    q1, q2, q3 = (along(s, k) for k in (1, 2, 3))
    moving = (q1 * d, q2 * d**2 + q1 * dd, q3 * d**3 + 3 * q2 * d * dd + q1 * ddd)
    asked = [
        float((np.abs(part) / (_USE * rate)).max()) ** (1 / order)
        for order, (part, rate) in enumerate(zip(moving, rates, strict=True), start=1)
    ]
    seconds = max(asked)
    data = world.model.createData()
    for _ in range(40):
        tau = [
            pin.rnea(world.model, data, *each)
            for each in zip(along(s), moving[0] / seconds, moving[1] / seconds**2, strict=True)
        ]
        if (np.abs(tau) <= _USE * world.torque).all():
            return seconds
        seconds *= 1.05
    return None


def fast_scene(seed: int, number: int, folder: Path) -> tuple[Path, float]:
    """Write a scene with one leg in little more than its proven time; its file, and how much more."""
    rng, arm = np.random.default_rng([seed, number]), ARMS[number % _ARMS]
    make_scene(seed, number % _ARMS + len(ARMS) * number, str(folder))
    file = folder / "scene.yaml"
    data: dict[str, Any] = yaml.safe_load(file.read_text(encoding="utf-8")) | {"obstacles": []}
    file.write_text(json.dumps(data), encoding="utf-8")
    own, mount = arm is ARMS[0], None
    if not own:
        at = data["robot"]["mount"]
        mount = pin.SE3(pin.rpy.rpyToMatrix(np.radians(at["rpy_deg"])), np.array(at["xyz"]))
    world = World(arm, mount, arm.urdf.with_suffix(".srdf") if own else folder / "robot.srdf", _MARGIN)
    world.place_scene(load_scene(file))
    limits = arm.urdf.with_name("joint_limits.yaml") if own else folder / "limits.yaml"
    rates = [world.velocity, *limits_in(limits, world.joints)]
    for _ in range(_TRIES):
        q, direction = start_posture(world, rng), rng.normal(size=3)
        by = (rng.uniform(*_LENGTHS) * direction / np.linalg.norm(direction)).round(3)
        proven = None if q is None else proven_seconds(world, q, rates, by, _HELD if own else np.inf)
        if q is not None and proven is not None:
            break
    else:
        raise RuntimeError(f"{arm.name}: no leg was proven")
    longer = float(rng.uniform(*_LONGER))
    leg = {"by": by.tolist(), "seconds": round(longer * proven, 4)}
    data["start"] = {"posture_deg": np.degrees(q).round(1).tolist()}
    data["tool_path"] = {"keep": "pose", "legs": [leg], "via_points": "auto"}
    data["planner"] = {"time_limit_s": 600.0}
    file.write_text(json.dumps(data), encoding="utf-8")
    return file, longer


def main() -> int:
    """Prove, plan, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    console, planned = Console(soft_wrap=True), 0
    for number in range(options.first, options.first + options.count):
        with tempfile.TemporaryDirectory() as folder:
            file, longer = fast_scene(options.seed, number, Path(folder))
            scene = load_scene(file)
            name = (
                f"{number} {ARMS[number % _ARMS].name}, {scene.strokes[0].legs[0].seconds} s, x {longer:.2f}"
            )
            try:
                plan(scene, progress=False)
            except PlanningError as error:
                console.print(f"{name}: no plan: {error}")
                continue
        planned += 1
        console.print(f"{name}: planned")
    console.print(f"{planned} of {options.count} planned (seed {options.seed})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
