"""Random jobs: strokes in a random order with free moves between them, from another posture and back to it.

The legs of a random scene are strokes of their own, each from its pose in the world.
"""

from __future__ import annotations

import json
import resource
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot import load_scene, plan
from cmbot.common.errors import InputError, PlanningError
from suite import judge
from suite.arms import ARMS
from suite.oracle import Oracle
from suite.scenes import make_scene, start_posture
from suite.task import TimedPath, read_scene, rigid, world_of
from suite.world import FloatArray, World

__all__ = ["CPU_LIMIT", "connected", "find_way", "job_name", "make_job", "plan_job"]

CPU_LIMIT = 120
"""Processor time after which planning a job counts as too slow, s."""

_NAMES = ("cmbot", "panda", "xarm7", "baxter", "ur5")
_NUMBERS = [next(k for k, arm in enumerate(ARMS) if arm.name == name) for name in _NAMES]
_TRIES = 50
_AT_START, _WIDTHS = 200, (60, 240)
# Of the oracle's trees: nodes at most, the longest edge, rad, and the step at which it is checked.
_NODES, _EDGE, _STEP = 2000, 0.5, 0.05


def job_name(seed: int, number: int) -> str:
    """Name of a job, and of its folder."""
    return f"j{seed}-{number:03d}-{_NAMES[number % len(_NAMES)]}"


def make_job(seed: int, number: int, folder: str) -> dict[str, Any]:
    """Write the job of a number into a folder: job.yaml beside the files of a scene."""
    arm = _NUMBERS[number % len(_NUMBERS)]
    made = make_scene(seed, arm + len(ARMS) * (number // len(_NUMBERS)), folder)
    _, world, path, R = read_scene(folder)
    data = json.loads(Path(folder, "scene.yaml").read_text(encoding="utf-8").split("\n", 1)[1])
    rng, tool_path = np.random.default_rng([seed, number, 1]), data.pop("tool_path")
    start = next((q for _ in range(_TRIES) if (q := start_posture(world, rng)) is not None), None)
    if start is not None:
        data["start"]["posture_deg"] = np.degrees(start).round(1).tolist()
    legs, strokes = tool_path["legs"], []
    rpy_deg = Rotation.from_matrix(R).as_euler("xyz", degrees=True).tolist()
    for k in rng.permutation(len(legs)):
        begin = {"frame": "world", "xyz": path.corners[k].tolist(), "rpy_deg": rpy_deg}
        strokes.append(
            {
                "name": f"leg_{k + 1}",
                "keep": tool_path["keep"],
                "from": begin,
                "legs": [legs[k]],
                "speed_profile": tool_path["speed_profile"],
                "via_points": max(10, tool_path["via_points"] // len(legs)),
            }
        )
    data |= {
        "name": job_name(seed, number),
        "return": "start",
        "tool_path": {"strokes": strokes},
    }
    Path(folder, "job.yaml").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    return {"arm": made["arm"], "keep": made["keep"], "strokes": len(strokes), "obstacles": made["obstacles"]}


def _strokes(folder: str) -> tuple[Any, World, list[TimedPath], FloatArray]:
    """The job of a folder as scene, world, the timed path of each stroke, and the tool's orientation."""
    scene = rigid(load_scene(Path(folder, "job.yaml")))
    _, _, _, R = read_scene(folder)
    paths = []
    for stroke in scene.strokes:
        (leg,), profile = stroke.legs, stroke.speed_profile
        begin, is_smooth = np.array(stroke.start_pose.xyz), profile.kind == "jerk_limited"
        paths.append(
            TimedPath(begin, [(np.array(leg.by), leg.seconds)], profile.ramp, jerk_limited=is_smooth)
        )
    return scene, world_of(scene), paths, R


def find_way(folder: str) -> dict[str, Any]:
    """Whether paths lead along every stroke, and free moves to each, from one to the next, and back."""
    scene, world, paths, R = _strokes(folder)
    q = home = np.array(scene.posture)
    if not world.admissible(home):
        return {"way": False, "why": "the start is not admissible"}
    rng = np.random.default_rng(0)
    for stroke, path in zip(scene.strokes, paths, strict=True):
        oracle = Oracle(world, path, R, stroke.keep)
        starts, postures = oracle.anywhere(path.corners[0], _AT_START), None
        for width in _WIDTHS:
            if postures is None and starts:
                _, postures = oracle.search(starts, max(width, len(starts)))
        if postures is None:
            return {"way": False, "why": f"no path along {stroke.name}"}
        if not connected(world, q, postures[0], rng):
            return {"way": False, "why": f"no free move to {stroke.name}"}
        q = postures[-1]
    if not connected(world, q, home, rng):
        return {"way": False, "why": "no free move back"}
    return {"way": True}


def connected(
    world: World, start: FloatArray, end: FloatArray, rng: np.random.Generator, nodes: int = _NODES
) -> bool:
    """Return whether two trees of straight edges, grown from both postures in turn, meet."""
    trees = [[start], [end]]

    def grown(tree: list[FloatArray], target: FloatArray) -> FloatArray:
        """Grow a tree towards a posture as far as an edge leads; its new end, or the nearest."""
        near = min(tree, key=lambda q: float(np.abs(q - target).max()))
        step = target - near
        step *= min(1.0, _EDGE / max(float(np.abs(step).max()), 1e-12))
        number = max(int(np.ceil(np.abs(step).max() / _STEP)), 1)
        if all(world.admissible(near + step * k / number) for k in range(1, number + 1)):
            tree.append(near + step)
            return tree[-1]
        return near

    for _ in range(nodes):
        one, other = trees
        # Straight first: the other's last node; then a random posture.
        for target in (other[-1], world.random(rng)):
            before = len(one)
            new = grown(one, target)
            while len(one) > before:
                before = len(one)
                if np.abs(new - target).max() < 1e-9:
                    break
                new = grown(one, target)
            if np.abs(new - other[-1]).max() < 1e-9:
                return True
        trees.reverse()
    return False


def plan_job(folder: str) -> dict[str, Any]:
    """Plan a job and judge every segment of it by the oracle's world."""
    scene, world, paths, R = _strokes(folder)
    begin = time.process_time()
    resource.setrlimit(resource.RLIMIT_CPU, (int(begin) + CPU_LIMIT, resource.RLIM_INFINITY))
    try:
        # On a busy machine the wall clock runs on, so processor time ends it.
        made = plan(scene, options=replace(scene.planner, time_limit_s=10 * CPU_LIMIT))
    except InputError as error:
        return {"status": "refused", "reason": str(error), "cpu_seconds": time.process_time() - begin}
    except PlanningError as error:
        return {"status": "no plan", "reason": str(error), "cpu_seconds": time.process_time() - begin}
    seconds = time.process_time() - begin
    resource.setrlimit(resource.RLIMIT_CPU, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    found, last, along = (
        list[str](),
        np.array(scene.posture),
        iter(zip(scene.strokes, paths, strict=True)),
    )
    for segment in made.job.segments:
        keep, path = "", None
        if segment.kind == "stroke":
            stroke, path = next(along)
            keep = str(stroke.keep)
        own = SimpleNamespace(
            trajectory=segment.trajectory,
            figures=segment.figures,
            options=made.options,
            robot=made.robot,
            scene=SimpleNamespace(keep=keep, robot=scene.robot),
        )
        found += [f"{segment.name}: {what}" for what in judge.violations(own, world, path, R)]
        if np.abs(segment.trajectory.q[0] - last).max() > 1e-6:
            found.append(f"{segment.name} does not begin where the arm is")
        last = segment.trajectory.q[-1]
    if np.abs(last - np.array(scene.posture)).max() > 1e-6:
        found.append("the arm does not come back")
    return {
        "status": "planned",
        "cpu_seconds": seconds,
        "peak": made.job.figures.peak_guardrail_torque,
        "fallbacks": list(made.fallbacks),
        "violations": found,
    }
