"""Tool paths that others published, planned as they stand: those of TORM and CppFlow.

    python benchmarks/tool_paths.py FOLDER                # all problems of FOLDER/problems
    python benchmarks/tool_paths.py FOLDER square circle  # those with these words in their names
    python benchmarks/tool_paths.py FOLDER iklink         # IKLink's path, in as few parts as can be
    python benchmarks/tool_paths.py FILE sheet 0.04       # rows over a mesh in a file, in units of 0.04 m

FOLDER has paths as CSV files, problems as YAML files, and the URDF of the Fetch arm, as its README says. Each
problem is planned with 0.1 mm and 0.1 deg at the poses, at rest in corners and turns in place. What was
planned is judged by a forward kinematics of this file: at the poses given, and on the lines between them.

No arm follows the path of IKLink whole. Its parts are counted beside those of a search in a graph of many
postures at each pose, which knows joint ranges alone and is greedy, as nothing better is needed.

A sheet is rastered by a Panda in front of it, and is its obstacle. The tool's distance is that of the nearest
of all triangles.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

import cmbot
from cmbot.common.errors import CmbotError
from cmbot.common.robot_library import library_robots
from cmbot.planning import find_start, robot_of

FloatArray = NDArray[np.float64]

# At the poses, m and rad; what the plan may be off between via-points, so that with a quarter of it, by which
# dense poses are approximated, these are kept.
POSITION, TURN = 1e-4, np.radians(0.1)
_DEVIATION, _ROTATION_DEG = 7e-5, 0.07
# On sharp bends a tool that lags is off its path.
_LAG = 1e-4
# Where the Fetch's torso is in the frame of its base, m.
_TORSO = np.array([-0.086875, 0.0, 0.37743])
_ROBOTS = {"fetch_arm": ("base_link", "gripper_link"), "panda": ("panda_link0", "panda_hand")}
# Of the tool from a sheet, m.
_STAND_OFF = 0.05
# Of the search for parts: postures at a pose, steps to a pose, and how far a joint moves between poses, rad.
_POSTURES, _STEPS, _LARGEST_STEP = 200, 12, 0.3
# Times at which a motion is judged, a second; the headings of tables.
_RATE = 500.0
HEADINGS = ("problem", "poses", "time s", "path rad", "step deg", "at mm", "at deg", "between mm", "user s")


@dataclass(frozen=True)
class Problem:
    """A path in the frame of a robot's base, and what is around it."""

    name: str
    robot: str
    points: FloatArray
    rotations: FloatArray
    boxes: tuple[dict[str, Any], ...]


def read_problem(file: Path, folder: Path) -> Problem:
    """Read a problem; its lists of obstacles are written as ``[x: 0.75, y: 0, ...]``."""
    text = re.sub(r"#.*", "", file.read_text(encoding="utf-8"))
    robot, name = (re.search(rf'{key}:\s*"(\w+)"', text)[1] for key in ("robot", "path_name"))  # type: ignore[index]
    own = folder / f"{robot}_{name}.csv"
    table = np.genfromtxt(own if own.exists() else folder / f"{name}.csv", delimiter=",", names=True)
    points = np.stack([table[axis] for axis in "xyz"], axis=1)
    quaternions = np.stack([table[part] for part in ("qx", "qy", "qz", "qw")], axis=1)
    if not own.exists():
        offset = re.search(r"path_xyz_offset:\s*\[([^\]]*)\]", text)[1]  # type: ignore[index]
        points = points + _TORSO + np.array([float(x) for x in offset.split(",")])
    shift = re.search(r"obstacle_xyz_offset:\s*\[([^\]]*)\]", text)
    moved = np.zeros(3) if shift is None else np.array([float(x) for x in shift[1].split(",")])
    boxes = []
    for number, entry in enumerate(re.findall(r"\[\s*((?:\w+: *[-\d.]+,?\s*)+)\]", text)):
        values = {key: float(value) for key, value in re.findall(r"(\w+): *([-\d.]+)", entry)}
        angles = np.degrees([values[key] for key in ("roll", "pitch", "yaw")])
        boxes.append(
            {
                "name": f"box_{number}",
                "box": [values[f"size_{axis}"] for axis in "xyz"],
                "xyz": (moved + [values[axis] for axis in "xyz"]).tolist(),
                "rpy_deg": angles.tolist(),
            }
        )
    return Problem(name, robot, points, Rotation.from_quat(quaternions).as_matrix(), tuple(boxes))


def scene_of(problem: Problem, folder: Path) -> cmbot.Scene:
    """The scene of a problem, its arm in a posture that holds the tool at the first pose."""
    base, tool = _ROBOTS[problem.robot]
    robot = {"model": str(urdf_of(problem.robot, folder)), "base_frame": base, "tool_frame": tool}
    quaternions = Rotation.from_matrix(problem.rotations).as_quat(scalar_first=True)
    data = {
        "format": "cmbot-scene/2",
        "name": problem.name.replace("1", "one_").replace("2", "two_"),
        "robot": robot,
        "guardrail": {"bays": 0},
        "start": {"posture": [0.0] * 7},
        "tool_path": {
            "waypoints": np.hstack([problem.points, quaternions]).tolist(),
            "seconds": "auto",
            "via_points": "auto",
        },
        "obstacles": list(problem.boxes),
        "planner": {
            "max_tool_deviation_m": _DEVIATION,
            "max_tool_rotation_deg": _ROTATION_DEG,
            "max_tool_lag_m": _LAG,
            # Nothing of these bases bends.
            "objective": "travel",
            "safety_margin_m": 0.002,
            "time_limit_s": 600,
        },
    }
    scene = cmbot.load_scene(data)
    arm = robot_of(scene)
    start = find_start(arm, scene.all_obstacles, problem.points[0], problem.rotations[0])
    return cmbot.load_scene({**data, "start": {"posture": start.posture.tolist()}})


def urdf_of(robot: str, folder: Path) -> Path:
    """Where a robot's URDF is."""
    if robot == "fetch_arm":
        return folder / "fetch" / "fetch_arm.urdf"
    return (library_robots() or {})[robot]


def tool_poses(urdf: Path, base: str, tool: str, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) and orientations (N, 3, 3) of a tool, from the joints of a URDF one after the other."""
    return _along(_chain(urdf, base, tool), q)[:2]


def _chain(urdf: Path, base: str, tool: str) -> list[ElementTree.Element]:
    """The joints from a base to a tool."""
    joints = {
        each.find("child").get("link"): each for each in ElementTree.parse(urdf).getroot().iter("joint")
    }  # type: ignore[union-attr]
    chain, link = list[ElementTree.Element](), tool
    while link != base:
        chain.insert(0, joints[link])
        link = str(joints[link].find("parent").get("link"))  # type: ignore[union-attr]
    return chain


def _along(
    chain: Sequence[ElementTree.Element], q: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Points (N, 3) and turns (N, 3, 3) at the end of a chain; places and axes (N, n, 3) of its joints."""
    p, R, number = np.zeros((len(q), 3)), np.broadcast_to(np.eye(3), (len(q), 3, 3)), 0
    places, axes = list[FloatArray](), list[FloatArray]()
    for joint in chain:
        origin = joint.find("origin")
        xyz, rpy = ([float(x) for x in origin.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))  # type: ignore[union-attr]
        p = p + R @ np.array(xyz)
        R = R @ Rotation.from_euler("xyz", rpy).as_matrix()
        if joint.get("type") in ("revolute", "continuous"):
            axis = np.array([float(x) for x in joint.find("axis").get("xyz").split()])  # type: ignore[union-attr]
            places.append(p)
            axes.append(R @ axis)
            R = R @ Rotation.from_rotvec(q[:, number, None] * axis).as_matrix()
            number += 1
    return p, R, np.stack(places, axis=1), np.stack(axes, axis=1)


def least_parts(problem: Problem, urdf: Path, base: str, tool: str, seed: int = 1) -> int:
    """Return in how many parts postures follow the poses of a problem, within the joint ranges alone."""
    chain, rng = _chain(urdf, base, tool), np.random.default_rng(seed)
    ranges = [joint.find("limit") for joint in chain if joint.get("type") == "revolute"]
    lower, upper = (np.array([float(each.get(key)) for each in ranges]) for key in ("lower", "upper"))  # type: ignore[union-attr, arg-type]
    parts, q = 1, np.empty((0, len(lower)))
    for k, (place, R) in enumerate(zip(problem.points, problem.rotations, strict=True)):
        # The self-motion is explored by copies that are scattered.
        copies = q[rng.integers(len(q), size=_POSTURES)] if len(q) else q
        near, ok = _placed(chain, np.vstack([q, copies + rng.normal(0, 0.15, copies.shape)]), place, R)
        moved = np.abs(near - np.vstack([q, copies])).max(axis=1, initial=0.0)
        near = near[ok & (moved < _LARGEST_STEP) & ((near >= lower) & (near <= upper)).all(axis=1)]
        if not len(near):
            drawn, ok = _placed(chain, rng.uniform(lower, upper, (20 * _POSTURES, len(lower))), place, R)
            near = drawn[ok & ((drawn >= lower) & (drawn <= upper)).all(axis=1)]
            parts += k > 0
        q = near[rng.permutation(len(near))[: 2 * _POSTURES]]
    return parts


def _placed(
    chain: Sequence[ElementTree.Element], q: FloatArray, place: FloatArray, R: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Postures (N, n) moved to a pose by damped least squares, and which of them are there."""
    size = np.full(len(q), np.inf)
    for _ in range(_STEPS if len(q) else 0):
        p, own, places, axes = _along(chain, q)
        turn = Rotation.from_matrix(R @ np.swapaxes(own, 1, 2)).as_rotvec()
        off = np.hstack([place - p, turn])
        J = np.concatenate([np.cross(axes, p[:, None] - places), axes], axis=2)
        size = np.linalg.norm(off, axis=1)
        weight = J.swapaxes(1, 2) @ J + 1e-6 * np.eye(6)
        step = (J @ np.linalg.solve(weight, off[:, :, None]))[:, :, 0]
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
    return q, size < 1e-4


def errors(
    problem: Problem, points: FloatArray, rotations: FloatArray
) -> tuple[float, float, float, list[int]]:
    """Largest distance, m, and turn, rad, of a motion (N) from the poses; distance from lines between them.

    With them the samples at which the poses are passed, one after the other: each is sought behind the last.
    """
    at, turn, reached = 0.0, 0.0, list[int]()
    for k, (place, R) in enumerate(zip(problem.points, problem.rotations, strict=True)):
        begin = reached[-1] if reached else 0
        # As far as the way to the next poses leads.
        step = np.linalg.norm(np.diff(points[begin:], axis=0), axis=1)
        turns = _angles(rotations[begin:-1], rotations[begin + 1 :])
        way = np.cumsum(step + 0.1 * turns)
        ahead = (
            np.linalg.norm(place - problem.points[k - 1])
            + 0.1 * float(_angles(R[None], problem.rotations[k - 1][None])[0])
            if k
            else 0.0
        )
        end = begin + 2 + int(np.searchsorted(way, 1.5 * ahead + 1e-3))
        away = _off_lines(points[begin:end], place)
        turned = np.minimum(*(_angles(rotations[begin:end][side], R[None]) for side in _BOTH_ENDS))
        best = int((away / POSITION + turned / TURN).argmin())
        reached.append(begin + best)
        at, turn = max(at, float(away[best])), max(turn, float(turned[best]))
    between = 0.0
    for k in range(len(reached) - 1):
        part = points[reached[k] : reached[k + 1] + 1]
        # A pose is passed between two samples, so the first and the last may be on the lines beside this one.
        beside = range(max(k - 1, 0), min(k + 2, len(reached) - 1))
        away = [_off_line(part, *problem.points[j : j + 2]) for j in beside]
        between = max(between, float(np.min(away, axis=0).max(initial=0.0)))
    return at, turn, between, reached


# Of the pieces between samples.
_BOTH_ENDS = (slice(None, -1), slice(1, None))


def _off_line(points: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Distances (N,) of points (N, 3) from the line between two places."""
    edge = end - begin
    share = np.clip((points - begin) @ edge / max(float(edge @ edge), 1e-18), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - begin - share[:, None] * edge, axis=1))


def _off_lines(points: FloatArray, place: FloatArray) -> FloatArray:
    """Distances (N - 1,) of a place from the lines between points (N, 3)."""
    edge, away = np.diff(points, axis=0), place - points[:-1]
    size = np.maximum((edge**2).sum(axis=1), 1e-24)
    share = np.clip((away * edge).sum(axis=1) / size, 0.0, 1.0)
    return np.asarray(np.linalg.norm(away - share[:, None] * edge, axis=1))


def _angles(R: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_matrix(np.swapaxes(R, 1, 2) @ other).magnitude())


def row(problem: Problem, folder: Path) -> tuple[str, ...]:
    """Plan a problem, and return its row of the table."""
    started = time.process_time()
    label = f"{problem.robot}: {problem.name}"
    try:
        plan = cmbot.plan(scene_of(problem, folder), progress=False)
    except CmbotError as error:
        used = f"{time.process_time() - started:.1f}"
        return label, str(len(problem.points)), *["-"] * 6, f"{used}: {error}"
    used = time.process_time() - started
    motion = plan.trajectory
    q = motion.evaluate(np.linspace(0.0, motion.duration, int(_RATE * motion.duration)))
    poses = tool_poses(urdf_of(problem.robot, folder), *_ROBOTS[problem.robot], q)
    at, turn, between, reached = errors(problem, *poses)
    travelled = float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
    step = float(np.abs(np.diff(q[reached], axis=0)).max())
    return (
        label,
        str(len(problem.points)),
        f"{motion.duration:.2f}",
        f"{travelled:.2f}",
        f"{np.degrees(step):.2f}",
        f"{1e3 * at:.3f}",
        f"{np.degrees(turn):.3f}",
        f"{1e3 * between:.3f}",
        f"{used:.1f}",
    )


def iklink(folder: Path) -> str:
    """Plan IKLink's path, and say in how many parts."""
    table = np.genfromtxt(folder / "iklink_panda.csv", delimiter=",", names=True)
    points, (x, y, z, w) = (
        np.stack([table[f"targetPOS_{axis}"] for axis in "XYZ"], axis=1),
        (table[f"targetROT_{axis}"] for axis in "XYZW"),
    )
    turns = Rotation.from_quat(np.stack([x, y, z, w], axis=1)).as_matrix()
    problem, started = Problem("iklink", "panda", points, turns, ()), time.process_time()
    plan = cmbot.plan(scene_of(problem, folder), progress=False)
    used = time.process_time() - started
    fewest = least_parts(problem, urdf_of("panda", folder), *_ROBOTS["panda"])
    return (
        f"IKLink's path of {len(points)} poses: {len(plan.strokes)} parts in {used:.1f} s, "
        f"{plan.job.duration:.1f} s long, certified: {plan.certificate.holds}; "
        f"the graph search finds {fewest}, published are 3."
    )


def sheet(file: Path, unit: float) -> str:
    """Plan rows over all of a mesh, and say how far the tool is from it."""
    base, tool = "panda_link0", "panda_hand_tcp"
    corner = np.array([0.35, -0.21, 0.25])
    data = {
        "format": "cmbot-scene/2",
        "name": "sheet",
        "robot": {"model": "panda", "base_frame": base, "tool_frame": tool},
        "guardrail": {"bays": 0},
        "start": {"posture": [0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.78]},
        "tool_path": {
            "keep": "axis",
            "raster": {"mesh": "sheet", "spacing_m": 0.05, "stand_off_m": _STAND_OFF},
            "speed_m_s": 0.05,
            "via_points": "auto",
        },
        "obstacles": [
            {"name": "sheet", "mesh": str(file), "scale": unit, "xyz": corner.tolist(), "workpiece": True}
        ],
        "planner": {"objective": "travel", "time_limit_s": 600},
    }
    started = time.process_time()
    plan = cmbot.plan(cmbot.load_scene(data), progress=False)
    used, away, rows = time.process_time() - started, list[FloatArray](), 0
    mesh = trimesh.load_mesh(file)
    corners = unit * np.asarray(mesh.triangles) + corner
    for part in plan.job.strokes:
        times = part.task.path.leg_times
        # Between two rows the tool goes straight.
        for begin, end in zip(times[:-1:2], times[1::2], strict=True):
            q = part.trajectory.evaluate(np.arange(begin, end, 0.05))
            points = tool_poses(urdf_of("panda", file), base, tool, q)[0]
            away += [_from_triangles(point, corners) for point in points]
            rows += 1
    parts = len(plan.job.strokes)
    return (
        f"{file.name}: {rows} rows in {parts} parts, {plan.job.duration:.1f} s long, certified: "
        f"{plan.certificate.holds}, planned in {used:.1f} s; the tool is {1e3 * min(away):.1f} to "
        f"{1e3 * max(away):.1f} mm from the triangles, asked were {1e3 * _STAND_OFF:g}."
    )


def _from_triangles(point: FloatArray, corners: FloatArray) -> float:
    """Distance of a point (3,) from triangles (N, 3, 3)."""
    nearest = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
    return float(np.linalg.norm(nearest - point, axis=1).min())


def main(words: Sequence[str]) -> int:
    """Plan the problems of a folder, print the table, and return 0 where all are planned exactly enough."""
    if not words:
        print(__doc__)
        return 2
    folder, console = Path(words[0]), Console(width=170)
    if words[1:2] == ["sheet"]:
        console.print(sheet(folder, float(words[2])))
        return 0
    if words[1:] == ["iklink"]:
        console.print(iklink(folder))
        return 0
    table, good = Table(*HEADINGS), True
    for file in sorted((folder / "problems").glob("*.yaml")):
        if words[1:] and not any(word in file.stem for word in words[1:]):
            continue
        cells = row(read_problem(file, folder), folder)
        console.print(" ".join(cells))
        table.add_row(*cells)
        good &= cells[5] != "-" and float(cells[5]) <= 1e3 * POSITION and float(cells[6]) <= np.degrees(TURN)
    console.print(table)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
