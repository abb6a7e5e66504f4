"""What is wrong with a folder, by the oracles of the tests alone: the package only reads what was asked."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from oracle_arms import body_of, shapes_and_pairs
from oracles.convex_distance import smallest_distances
from oracles.scene_path import ScenePath
from scipy.interpolate import BPoly

from cmbot.common.arrays import FloatArray
from cmbot.planning import bending_arm, robot_of
from cmbot.planning.verification.bent_tool import bent_tool_points
from cmbot.scene import Scene, load_scene

__all__ = ["faults", "tour_faults", "walk_faults"]

# Samples of a segment, and of those at which distances are found; rounding of figures, m, rad, and shares.
SAMPLES, DISTANCES, LENGTH, SHARE = 400, 24, 2e-6, 2e-6


def faults(scene: Path, folder: Path) -> list[str]:
    """Return what a plan directory breaks of what a scene file asks, a sentence each."""
    return [*_faults(load_scene(scene), folder)]


def _faults(scene: Scene, folder: Path) -> Iterator[str]:
    told = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    with np.load(folder / "job.npz") as knots:
        t, q, v, a = (knots[name] for name in "tqva")
    motion = BPoly.from_derivatives(t, np.stack([q, v, a], axis=1))
    body, options = body_of(scene), scene.planner
    posture, foot = np.array(scene.posture), np.array(robot_of(scene).foot_point)
    paths = [
        ScenePath(scene, *(x[0] for x in body.tool_poses(posture[None])), k)
        for k in range(len(scene.strokes))
    ]
    yield from _ends(scene, q, v, told)
    ramp = scene.tool.process_ramp_s
    number, worst = 0, {"peak_guardrail_torque": 0.0, "min_clearance": np.inf, "max_tool_deviation": 0.0}
    strokes = [each for each in told["segments"] if each["kind"] == "stroke"]
    if len(strokes) != len(paths):
        yield f"{len(strokes)} strokes instead of {len(paths)}"
    if abs(told["segments"][-1]["begin"] + told["segments"][-1]["seconds"] - t[-1]) > 1e-6:
        yield "the motion ends at another time than its last segment"
    for segment in told["segments"]:
        times = np.linspace(segment["begin"], min(segment["begin"] + segment["seconds"], t[-1]), SAMPLES)
        x, rates, forces, jerk = (motion(times, order) for order in range(4))
        works = segment["kind"] == "stroke"
        push = scene.tool.process_force_n if works else (0.0, 0.0, 0.0)
        tau, force, torque = body.efforts(x, rates, forces, push)
        torque = torque - np.cross(foot, force)
        bounds = body.bounds
        for name, value, bound in (
            ("range", x - (bounds.upper + bounds.lower) / 2, (bounds.upper - bounds.lower) / 2),
            *(("velocity", rates, bounds.velocity), ("acceleration", forces, bounds.acceleration)),
            *(("jerk", jerk, bounds.jerk), ("torque", tau, bounds.torque)),
        ):
            if (use := float(np.max(np.abs(value) / bound))) > 1 + SHARE:
                yield f"{segment['name']}: {name} {use:.4f} of its bound"
        peak = float(np.linalg.norm(torque, axis=1).max())
        clearance = _clearance(scene, body, x[:: SAMPLES // DISTANCES])
        if clearance < options.safety_margin_m - LENGTH:
            yield f"{segment['name']}: clearance {clearance:.4f} m"
        beside = [segment["name"] != "approach", segment["name"] != "return"]
        for rest, since, stands in zip(x[[0, -1]], (times[0], times[-1] - ramp), beside, strict=True):
            turned = np.abs(motion(since + np.linspace(0, ramp, SAMPLES)) - rest).max()
            if not works and stands and turned > 1e-6:
                yield f"{segment['name']}: {turned:.3g} rad while the force sets in or ends"
        away = 0.0
        if works and number < len(paths):
            away, sentences = _tool(scene, paths[number], scene.strokes[number].keep, body, x, rates, times)
            yield from (f"{segment['name']}: {sentence}" for sentence in sentences)
            number += 1
        if peak > segment["peak_guardrail_torque"] * (1 + 1e-4):
            yield f"{segment['name']}: torque {peak:.3f} Nm, stated {segment['peak_guardrail_torque']:.3f}"
        if works:
            worst["peak_guardrail_torque"] = max(worst["peak_guardrail_torque"], peak)
            worst["min_clearance"] = min(worst["min_clearance"], clearance)
            worst["max_tool_deviation"] = max(worst["max_tool_deviation"], away)
    yield from _claims(told, worst)
    yield from _table(folder / "job.csv", motion, t, body, scene, told)
    for file in folder.glob("*.json"):
        yield from _message(file, motion, t)


def _message(file: Path, motion: BPoly, t: FloatArray) -> Iterator[str]:
    """Where a message for ROS differs from the knots, for a reader that takes the first of equal keys."""
    text = file.read_text(encoding="utf-8")
    told = json.loads(text, object_pairs_hook=lambda pairs: dict(pairs[::-1]))
    if "joint_names" not in told:
        return
    if told["joint_names"] != [f"joint_{k}" for k in range(1, motion.c.shape[2] + 1)]:
        yield "the message has the joints in another order"
    since = [point["time_from_start"] for point in told["points"]]
    times = np.array([time["sec"] + 1e-9 * time["nanosec"] for time in since])
    if np.any(np.diff(times) <= 0) or times[0] > 0 or abs(times[-1] - t[-1]) > 1e-6:
        yield "the message has other times"
        return
    rows = [
        [point[name] for point in told["points"]] for name in ("positions", "velocities", "accelerations")
    ]
    through = BPoly.from_derivatives(times, np.stack(rows, axis=1))
    inside = np.linspace(0, t[-1], SAMPLES)
    if (off := float(np.abs(through(inside) - motion(inside)).max())) > 1e-3:
        yield f"the message is {off:.3g} rad off"


def _ends(scene: Scene, q: FloatArray, v: FloatArray, told: dict[str, Any]) -> Iterator[str]:
    """Where the arm is before and after its job."""
    approach = told["segments"][0]["kind"] == "free"
    if (approach or scene.planner.knots == "fixed") and np.abs(q[0] - scene.posture).max() > 1e-6:
        yield "the job begins elsewhere than the arm stands"
    if not approach and np.abs(q[0] - scene.posture).max() > 1e-6:
        yield "no approach leads to where the work begins"
    if (
        scene.return_to != "none"
        and np.abs(q[-1] - scene.posture).max() > 1e-6
        and scene.return_to == "start"
    ):
        yield "the arm does not return"
    if np.abs(v[[0, -1]]).max() > 1e-9:
        yield "the arm moves at an end of its job"


def _clearance(scene: Scene, body: Any, q: FloatArray) -> float:
    shapes, pairs = shapes_and_pairs(scene, body)
    R, p = body.frames(q)
    poses = [(R[one.joint], p[one.joint], one.X_JS) for one in shapes]
    return float(
        smallest_distances(
            [one.shape for one in shapes],
            np.stack([R_k @ X[:3, :3] for R_k, _, X in poses]),
            np.stack([p_k + R_k @ X[:3, 3] for R_k, p_k, X in poses]),
            pairs,
        ).upper.min()
    )


def _tool(
    scene: Scene, path: ScenePath, keep: str, body: Any, q: FloatArray, v: FloatArray, times: FloatArray
) -> tuple[float, list[str]]:
    """How far the tool is from its way, m, and what it breaks; nothing of it where sag is compensated."""
    options, found = scene.planner, list[str]()
    at, R = body.tool_poses(q)
    own = times - times[0]
    seconds = sum(leg.seconds for leg in path._legs)
    if abs(own[-1] - seconds) > 1e-6:
        return 0.0, [f"takes {own[-1]:.3f} s in place of {seconds:.3f} s"]
    speed = float(np.linalg.norm(body.tool_velocities(q, v), axis=1).max())
    if scene.tool.max_speed_m_s is not None and speed > 1.05 * scene.tool.max_speed_m_s:
        found.append(f"tool speed {speed:.4f} m/s")
    p, R_p = path.poses(own)
    if options.compensate is not False:
        # By the rows of hinges, which the certificate does not know.
        robot, ends = robot_of(scene), [0, len(q) // 2, -1]
        bent = bent_tool_points(robot, bending_arm(scene, robot).base, q[ends])
        off = float(np.linalg.norm(bent - p[ends], axis=1).max())
        sag = float(np.linalg.norm(bent - at[ends], axis=1).max())
        bound = options.max_tool_deviation_m + 0.03 * sag + 1e-4
        return 0.0, [*found, *([f"bent, {off:.4f} m off"] if off > bound else [])]
    way = path.poses(np.linspace(0, seconds, 4000))[0]
    away = float(np.max([np.linalg.norm(way - x, axis=1).min() for x in at]))
    lag = float(np.linalg.norm(at - p, axis=1).max())
    if keep == "pose":
        angle = np.arccos(np.clip((np.einsum("kij,kij->k", R, R_p) - 1) / 2, -1, 1))
    else:
        angle = np.arccos(np.clip(np.einsum("ki,ki->k", R[:, :, 2], R_p[:, :, 2]), -1, 1))
    if away > options.max_tool_deviation_m + 1e-4:
        found.append(f"deviation {away:.4f} m")
    if lag > np.hypot(options.max_tool_lag_m, options.max_tool_deviation_m) + 1e-5:
        found.append(f"{lag:.4f} m from its timed place")
    if keep != "position" and np.degrees(angle.max()) > options.max_tool_rotation_deg + 1e-3:
        found.append(f"turned by {np.degrees(angle.max()):.3f} deg")
    return away, found


def _claims(told: dict[str, Any], worst: dict[str, float]) -> Iterator[str]:
    """Figures that the motion contradicts."""
    figures = told["planned"]
    for key, sign in (("peak_guardrail_torque", 1), ("min_clearance", -1), ("max_tool_deviation", 1)):
        if sign * (worst[key] - figures[key]) > 1e-4 * abs(figures[key]) + 1e-4 and worst[key] > 0:
            yield f"planned.{key}: {figures[key]:.6g}, found {worst[key]:.6g}"
    bounds = told["certificate"]
    for key, sign, name in (
        ("guardrail_torque_bound", 1, "peak_guardrail_torque"),
        ("clearance_bound", -1, "min_clearance"),
    ):
        if sign * (worst[name] - bounds[key]) > 1e-4 * abs(bounds[key]):
            yield f"certificate.{key}: {bounds[key]:.9g}, found {worst[name]:.9g}"
    floor, peak = told.get("torque_floor"), told["objective"]["planned_peak"]
    if floor is not None and floor - (told["torque_floor_error"] or 0.0) > peak * (1 + SHARE):
        yield f"the lower bound {floor} is above the peak {peak}"
    goal = told["objective"]
    plain = (goal["name"], goal["moment_about"], *goal["axis_weights"]) == ("torque", "foot", 1, 1, 1)
    if plain and peak < worst["peak_guardrail_torque"] * (1 - 1e-4):
        yield f"objective.planned_peak: {peak}, found {worst['peak_guardrail_torque']}"
    seconds = sum(each["seconds"] for each in told["segments"])
    if abs(told["planned"]["job"]["duration"] - seconds) > 1e-6:
        yield "the job has another duration"


def _table(
    file: Path, motion: BPoly, t: FloatArray, body: Any, scene: Scene, told: dict[str, Any]
) -> Iterator[str]:
    """Where the table differs from the knots."""
    rows = [*csv.DictReader(file.read_text(encoding="utf-8").splitlines())]
    times = np.array([float(row["t"]) for row in rows])
    if np.any(np.diff(times) <= 0) or abs(times[0]) > 1e-9 or abs(times[-1] - t[-1]) > 1e-6:
        yield "the table has other times"
        return
    if np.diff(times).max() > 0.011 and t[-1] < 400:
        yield "the table leaves rows out"
    columns = [[float(row[f"{x}{i + 1}"]) for i in range(motion.c.shape[2])] for row in rows for x in "qvaj"]
    values = np.array(columns).reshape(len(rows), 4, -1)
    for order, name in enumerate(("positions", "velocities", "accelerations")):
        difference = float(np.abs(values[:, order] - motion(times, order)).max())
        if difference > 1e-5:
            yield f"{name} of the table differ by {difference:.3g}"
    segment = np.clip(
        np.searchsorted([each["begin"] for each in told["segments"]], times, side="right") - 1, 0, None
    )
    names = [each["name"] for each in told["segments"]]
    inner = [
        k for k in range(len(rows)) if min(abs(times[k] - each["begin"]) for each in told["segments"]) > 0.02
    ]
    if any(rows[k]["segment"] != names[segment[k]] for k in inner):
        yield "the table has other segments"
    for kind in ("free", "stroke"):
        here = [k for k in inner if told["segments"][segment[k]]["kind"] == kind]
        if not here:
            continue
        x = [motion(times[here], order) for order in range(3)]
        tau, force, torque = body.efforts(
            *x, scene.tool.process_force_n if kind == "stroke" else (0.0, 0.0, 0.0)
        )
        torque = torque - np.cross(robot_of(scene).foot_point, force)
        parts = {"tau": tau, "tool_": body.tool_poses(x[0])[0], "guardrail_torque_": torque}
        parts["guardrail_force_"] = force
        for name, expected in parts.items():
            keys = (
                [f"tau{i + 1}" for i in range(tau.shape[1])] if name == "tau" else [name + c for c in "xyz"]
            )
            got = np.array([[float(rows[k][key]) for key in keys] for k in here])
            if (off := float(np.abs(got - expected).max() / max(1.0, np.abs(expected).max()))) > 1e-5:
                yield f"{name} of the table differs by {off:.3g}"


def walk_faults(scene: Path, goal: Path, folder: Path) -> list[str]:
    """Return what a walk breaks of what was asked, by its knots and the numbers of the files alone."""
    told = json.loads((folder / "walk.json").read_text(encoding="utf-8"))
    asked, end = load_scene(scene), yaml.safe_load(goal.read_text(encoding="utf-8"))
    found, before = list[str](), dict[str, float]()
    stance = told["steps"][-1]["after"] if told["steps"] else asked.as_data()["guardrail"]["stance"]
    for foot in ("foot_1", "foot_2"):
        if abs(stance[foot]["along_m"] - end[foot]["along_m"]) > 1e-6:
            found.append(f"{foot} ends {stance[foot]['along_m'] - end[foot]['along_m']:.4f} m from its goal")
    clock = 0.0
    for step in told["steps"]:
        kinds = [move["kind"] for move in step["moves"] if move["kind"] != "arm"]
        if kinds != ["lift", "swing", "set"]:
            found.append(f"a step of {kinds}")
        arms = [tuple(move["arm"]) for move in step["moves"] if move["kind"] != "arm"]
        if len(set(arms)) > 1:
            found.append("the arm is elsewhere while a foot is in the air")
        for move in step["moves"]:
            t, q, v, a = (np.array(move["knots"][name]) for name in "tqva")
            x = BPoly.from_derivatives(t, np.stack([q, v, a], axis=1))
            times = np.linspace(t[0], t[-1], SAMPLES)
            rates, limits = np.abs(x(times, 1)).max(axis=0), {"climb": 0.2}
            for name, rate in zip(move["joints"], rates, strict=True):
                if rate > limits.get(name.split("_")[0], np.inf) * (1 + SHARE):
                    found.append(f"{move['kind']}: {name} at {rate:.3f} rad/s")
            if move["kind"] == "lift" and np.abs(q[-1] - q[0]).max() < 0.1:
                found.append("a lift that hardly moves")
            if abs(move["begin"] - clock) > 1e-6:
                found.append("a move begins before the one before it ends")
            clock = move["begin"] + move["seconds"]
            for name, value in zip(move["joints"], q[0], strict=True):
                if name in before and abs(abs(before[name]) - abs(value)) > 1e-6:
                    found.append(f"{name} leaps by {value - before[name]:.4f} rad")
            before |= dict(zip(move["joints"], q[-1], strict=True))
    rows = [*csv.DictReader((folder / "walk.csv").read_text(encoding="utf-8").splitlines())]
    if rows and abs(float(rows[-1]["t"]) - clock) > 1e-3:
        found.append("the table ends at another time")
    for row in (rows[0], rows[-1]):
        for foot in ("1", "2"):
            place = (asked.as_data()["guardrail"]["stance"], end)[row is rows[-1]][f"foot_{foot}"]["along_m"]
            if abs(float(row[f"foot_{foot}_x"]) + 3.5 - place) > 1e-3:
                found.append(f"the table has foot {foot} elsewhere")
    return found


def tour_faults(scene: Path, goal: Path, folder: Path) -> list[str]:
    """Return what a tour of some work and a walk breaks of what was asked."""
    told = json.loads((folder / "tour.json").read_text(encoding="utf-8"))
    names = [entry["name"] for entry in told["parts"]]
    found = [] if names == ["work_1", "walk_1"] else [f"its parts are {', '.join(names)}"]
    found += faults(scene, folder / "work_1") + walk_faults(scene, goal, folder / "walk_1")
    plan, walk = (
        json.loads((folder / name).read_text(encoding="utf-8"))
        for name in ("work_1/plan.json", "walk_1/walk.json")
    )
    figures = plan["planned"]["job"]
    for entry in told["parts"]:
        works = entry["name"] == "work_1"
        if abs(entry["seconds"] - (figures["duration"] if works else walk["seconds"])) > 1e-6:
            found.append(f"{entry['name']} takes another time")
        if works and entry["peak_torque"] < figures["peak_guardrail_torque"] * (1 - SHARE):
            found.append("its work asks more torque")
    stance = load_scene(scene).as_data()["guardrail"]["stance"]
    for foot in ("foot_1", "foot_2"):
        away = abs(walk["scene"]["guardrail"]["stance"][foot]["along_m"] - stance[foot]["along_m"])
        if away > 1e-6:
            found.append(f"{foot} stands {away:.4f} m from where the work left it")
    return found
