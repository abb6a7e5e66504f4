"""Random scenes: an arm, a posture, a tool path, obstacles; each a folder that ``cmbot plan`` takes.

A scene's number and seed determine it. Ends of legs can be reached somehow, so that what a scene asks is not
plainly impossible; whether a path leads there is left to the oracle.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from suite.arms import ARMS, Arm
from suite.world import FloatArray, World, limits_in

__all__ = ["make_scene", "scene_name", "start_posture"]

_MARGIN = 0.02
# Pairs of links that are nearer than the margin in this share of random postures may touch each other.
_ALWAYS_NEAR, _SAMPLES = 0.9, 300
# Starts: share of the joint torques' bounds at most, distance from the ends of the ranges, rad.
_LARGEST_LOAD, _FROM_ENDS = 0.8, 0.05
# Of the joint rates' bounds, as far as the limits files use them.
_FASTEST = 3.0
_TRIES = 200
_KEEPS = ("pose", "pose", "pose", "axis", "axis", "position")
_FASTEST_TOOL = 0.25  # m/s
# Times of legs: share of the joints' bounds that following the leg nearly straight asks at most, steps in
# which it is followed, shortest and longest time, s.
_USE, _STEPS, _SHORTEST, _LONGEST = 0.5, 8, 1.0, 20.0


def scene_name(seed: int, number: int) -> str:
    """Name of a scene, and of its folder."""
    arm = ARMS[number % len(ARMS)]
    return f"s{seed}-{number:03d}-{arm.name}"


def make_scene(seed: int, number: int, folder: str) -> dict[str, Any]:
    """Write the scene of a number into a folder: scene.yaml, for foreign arms robot.srdf and limits.yaml."""
    arm, rng = ARMS[number % len(ARMS)], np.random.default_rng([seed, number])
    own = arm is ARMS[0]
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    mount = None if own else _mount(rng)
    srdf = arm.urdf.with_suffix(".srdf") if own else place / "robot.srdf"
    if not own:
        _write_srdf(srdf, _near_pairs(arm))
    world = World(arm, None if mount is None else _se3(*mount), srdf, _MARGIN)
    guardrail = _guardrail() if own else []
    world.place([_placed(obstacle) for obstacle in guardrail])
    keep = "position" if arm.joints < 5 else str(rng.choice(_KEEPS[3:] if arm.joints < 6 else _KEEPS))
    limits = arm.urdf.with_name("joint_limits.yaml") if own else place / "limits.yaml"
    if not own:
        _write_limits(limits, world)
    rates = [np.minimum(world.velocity, _FASTEST), *limits_in(limits, world.joints)]
    profile = {
        "kind": str(rng.choice(["trapezoidal", "jerk_limited"])),
        "ramp": round(float(rng.uniform(0.2, 0.4)), 2),
    }
    for _ in range(_TRIES):
        q = start_posture(world, rng)
        legs = None if q is None else _legs(world, q, keep, profile, rates, rng)
        if q is not None and legs is not None:
            break
    else:
        raise RuntimeError(f"{arm.name}: no start with a tool path was found")
    obstacles = _obstacles(world, q, legs, guardrail, rng)
    data = _scene_data(scene_name(seed, number), arm, mount, q, keep, legs, profile, obstacles)
    # JSON is YAML, and is read as quickly.
    text = f"# Scene {number} of seed {seed}: benchmarks/suite/scenes.py\n{json.dumps(data, indent=1)}\n"
    (place / "scene.yaml").write_text(text, encoding="utf-8")
    return {
        "arm": arm.name,
        "keep": keep,
        "legs": len(legs),
        "via_points": data["tool_path"]["via_points"],
        "obstacles": len(obstacles),
        "joints": arm.joints,
    }


def _mount(rng: np.random.Generator) -> tuple[list[float], list[float]]:
    """Position, m, and roll, pitch, yaw, deg: standing, hanging or on a wall."""
    roll = float(rng.choice([0.0, 0.0, 180.0, 90.0]))
    xyz = rng.uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 0.6]).round(3)
    return xyz.tolist(), [roll, 0.0, float(rng.integers(-180, 180))]


def _se3(xyz: list[float], rpy_deg: list[float]) -> Any:
    return pin.SE3(pin.rpy.rpyToMatrix(np.radians(rpy_deg)), np.array(xyz))


def _near_pairs(arm: Arm) -> set[frozenset[str]]:
    """Pairs of links that are neighbours, or nearly always near: they may touch each other."""
    world, rng = World(arm, margin=_MARGIN), np.random.default_rng(0)
    parents, carriers, links = list(world.model.parents), world.carriers, world.links
    carrying = {0, *carriers}

    def above(joint: int) -> int:
        """The nearest joint towards the base that carries shapes."""
        joint = parents[joint]
        while joint not in carrying:
            joint = parents[joint]
        return joint

    pairs = [(pair.first, pair.second) for pair in world.geometry.collisionPairs]
    near = np.zeros(len(pairs))
    for request in world.geometry_data.distanceRequests:
        request.enable_signed_distance = False
    for _ in range(_SAMPLES):
        pin.computeDistances(world.model, world.data, world.geometry, world.geometry_data, world.random(rng))
        near += [result.min_distance < _MARGIN for result in world.geometry_data.distanceResults]
    found = set()
    for (first, second), share in zip(pairs, near / _SAMPLES, strict=True):
        one, other = carriers[first], carriers[second]
        neighbours = (one > 0 and above(one) == other) or (other > 0 and above(other) == one)
        if neighbours or share >= _ALWAYS_NEAR:
            found.add(frozenset((links[first], links[second])))
    return found


def _write_srdf(path: Path, disabled: set[frozenset[str]]) -> None:
    rows = sorted(tuple(sorted(pair)) * (2 // len(pair)) for pair in disabled)
    pairs = "\n".join(f'  <disable_collisions link1="{a}" link2="{b}" reason="Near"/>' for a, b in rows)
    path.write_text(f'<robot name="suite">\n{pairs}\n</robot>\n', encoding="utf-8")


def _write_limits(path: Path, world: World) -> None:
    """Accelerations of 4 times the velocity a second, jerks of 10 times the acceleration a second."""
    rows = []
    for name, velocity in zip(world.joints, world.velocity, strict=True):
        acceleration = float(np.degrees(4 * min(velocity, _FASTEST)).round(1))
        rows.append(f"  {name}: {{acceleration_deg: {acceleration}, jerk_deg: {10 * acceleration:.0f}}}\n")
    path.write_text(f"format: cmbot-joint-limits/1\njoints:\n{''.join(rows)}", encoding="utf-8")


def start_posture(world: World, rng: np.random.Generator) -> FloatArray | None:
    """Return a posture well within the limits, of whole tenths of a degree, and clear."""
    for _ in range(_TRIES):
        q = np.radians(np.degrees(world.random(rng)).round(1))
        inside = ((q > world.lower + _FROM_ENDS) & (q < world.upper - _FROM_ENDS)).all()
        load = np.abs(pin.computeGeneralizedGravity(world.model, world.data, q)) / world.torque
        if inside and load.max() <= _LARGEST_LOAD and world.clear(q):
            return np.asarray(q)
    return None


def _legs(
    world: World,
    q: FloatArray,
    keep: str,
    profile: dict[str, Any],
    rates: list[FloatArray],
    rng: np.random.Generator,
) -> list[tuple[FloatArray, float]] | None:
    """One to four legs, whose ends some clear posture reaches, with seconds that fit the arm."""
    p, R = world.pose(q)
    reach, legs = _reach(world), []
    for _ in range(int(rng.integers(1, 5))):
        for _ in range(10):
            direction = rng.normal(size=3)
            by = (rng.uniform(0.06, 0.3) * reach * direction / np.linalg.norm(direction)).round(3)
            seconds, end = _seconds(world, q, p, by, R, keep, profile, rates)
            seconds = round(seconds * float(rng.uniform(1.0, 2.5)), 1)
            if seconds <= _LONGEST and _reached(world, q, p + by, R, keep, rng):
                break
        else:
            return None
        legs.append((by, seconds))
        p, q = p + by, end
    return legs


def _seconds(
    world: World,
    q: FloatArray,
    p: FloatArray,
    by: FloatArray,
    R: FloatArray,
    keep: str,
    profile: dict[str, Any],
    rates: list[FloatArray],
) -> tuple[float, FloatArray]:
    """The shortest time, s, in which the joints follow a leg with room, and the posture at its end.

    Where the arm cannot be led on from `q`, what was needed up to there counts.
    """
    length, ramp = float(np.linalg.norm(by)), profile["ramp"]
    # Joint moves per metre.
    _, J = world.task(q, p, R, keep)
    turn = np.abs(np.linalg.pinv(J, rcond=1e-3)[:, :3] @ (world.pose(q)[1].T @ by)) / length
    for k in range(1, _STEPS + 1):
        after = world.solve(q, p + by * k / _STEPS, R, keep)
        if after is None or np.abs(after - q).max() > 1.0:
            break
        turn = np.maximum(turn, np.abs(after - q) * _STEPS / length)
        q = after
    velocity, acceleration, jerk = (_USE * rate for rate in rates)
    # Peaks of the profile over one second and a metre; corners of a trapezoid are rounded within the ramp.
    peak = 1 / (1 - ramp)
    rise = (2 if profile["kind"] == "jerk_limited" else 1) * peak / ramp
    seconds = [
        np.max(turn * length * peak / velocity),
        np.sqrt(np.max(turn * length * rise / acceleration)),
        np.cbrt(np.max(turn * length * 4 * peak / ramp**2 / jerk)),
        peak * length / _FASTEST_TOOL,
        _SHORTEST,
    ]
    return float(max(seconds)), q


def _reach(world: World) -> float:
    """Length of the arm from its first joint to its tool, m."""
    steps = [world.model.jointPlacements[k].translation for k in range(2, world.model.njoints)]
    steps.append(world.model.frames[world.tool].placement.translation)
    return float(np.linalg.norm(steps, axis=1).sum())


def _reached(
    world: World, q: FloatArray, p: FloatArray, R: FloatArray, keep: str, rng: np.random.Generator
) -> bool:
    for start in [q, *(world.random(rng) for _ in range(15))]:
        found = world.solve(start, p, R, keep)
        found = None if found is None else world.wrapped(found)
        if found is not None and world.admissible(found):
            return True
    return False


def _obstacles(
    world: World,
    q: FloatArray,
    legs: list[tuple[FloatArray, float]],
    guardrail: list[dict[str, Any]],
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Up to five shapes that touch neither the start nor the tool point's path."""
    p, _ = world.pose(q)
    reach, centre = _reach(world), world.data.oMi[1].translation.copy()
    corners = p + np.concatenate([np.zeros((1, 3)), np.cumsum([by for by, _ in legs], axis=0)])
    points = np.concatenate([np.linspace(a, b, 8) for a, b in pairwise(corners)])
    chosen: list[dict[str, Any]] = []
    number = int(rng.integers(0, 6))
    for _ in range(_TRIES):
        if len(chosen) == number:
            break
        one = _obstacle(f"thing_{len(chosen) + 1}", centre, reach, rng)
        away = min(_away(one, x) for x in points)
        world.place([_placed(other) for other in [*guardrail, *chosen, one]])
        if away > _MARGIN + 0.04 * reach and world.clear(q):
            chosen.append(one)
    return chosen


def _obstacle(name: str, centre: FloatArray, reach: float, rng: np.random.Generator) -> dict[str, Any]:
    xyz = (centre + reach * rng.uniform(-0.9, 0.9, 3)).round(3)
    size = (reach * rng.uniform(0.05, 0.3, 3)).round(3)
    entry: dict[str, Any] = {"name": name, "xyz": xyz.tolist()}
    kind = rng.choice(["box", "cylinder", "sphere"])
    if kind == "box":
        entry["box"] = size.tolist()
    elif kind == "cylinder":
        entry["cylinder"] = [float(size[0] / 2), float(2 * size[1])]
    else:
        entry["sphere"] = float(size[0] / 2)
    if kind != "sphere":
        entry["rpy_deg"] = rng.integers(-90, 90, 3).tolist()
    return entry


def _placed(entry: dict[str, Any]) -> tuple[Any, Any]:
    """An obstacle's coal shape and its pose."""
    X = _se3(entry["xyz"], entry.get("rpy_deg", [0.0, 0.0, 0.0]))
    if "box" in entry:
        return coal.Box(*entry["box"]), X
    if "cylinder" in entry:
        return coal.Cylinder(*entry["cylinder"]), X
    return coal.Sphere(entry["sphere"]), X


def _away(entry: dict[str, Any], point: FloatArray) -> float:
    """Distance of a point from an obstacle, m."""
    shape, X = _placed(entry)
    place, at = coal.Transform3s(X.rotation, X.translation), coal.Transform3s(np.eye(3), point)
    ball = coal.Sphere(1e-3)
    return float(coal.distance(shape, place, ball, at, coal.DistanceRequest(), coal.DistanceResult()))


def _guardrail() -> list[dict[str, Any]]:
    """Boxes of the guardrail that cmbot's scenes have."""
    rails = (("rail_1", 0.06, 0.0), ("rail_2", 0.04, -0.45), ("rail_3", 0.04, -0.8))
    boxes = [{"name": name, "box": [7.0, size, size], "xyz": [0.0, 0.0, z]} for name, size, z in rails]
    for k in range(5):
        x = 1.75 * (k - 2)
        boxes.append({"name": f"post_{k}", "box": [0.075, 0.075, 1.15], "xyz": [x, 0.0, -0.525]})
    return boxes


def _scene_data(
    name: str,
    arm: Arm,
    mount: tuple[list[float], list[float]] | None,
    q: FloatArray,
    keep: str,
    legs: list[tuple[FloatArray, float]],
    profile: dict[str, Any],
    obstacles: list[dict[str, Any]],
) -> dict[str, Any]:
    robot: dict[str, Any] = {"model": "cmbot", "joints": "rigid"}
    if mount is not None:
        robot = {
            "model": str(arm.urdf),
            "base_frame": arm.base,
            "tool_frame": arm.tool,
            "limits": "limits.yaml",
            "srdf": "robot.srdf",
            "mount": {"xyz": mount[0], "rpy_deg": mount[1]},
        }
    length = sum(float(np.linalg.norm(by)) for by, _ in legs)
    return {
        "format": "cmbot-scene/2",
        "name": name,
        "robot": robot,
        "start": {"posture_deg": np.degrees(q).round(1).tolist()},
        "tool_path": {
            "keep": keep,
            "legs": [{"by": by.tolist(), "seconds": seconds} for by, seconds in legs],
            "speed_profile": profile,
            "via_points": int(np.clip(4 * len(legs) + length / 0.04, 10, 50)),
        },
        "obstacles": obstacles,
        "guardrail": {} if mount is None else {"bays": 0},
    }
