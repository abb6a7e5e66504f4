"""The files that mutants are made from: a small arm, scenes, plans, measurements, a campaign."""

from __future__ import annotations

import io
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

import cmbot
from cmbot.archive import json_bytes
from cmbot.common.errors import InputError
from cmbot.common.installation import scene_folder
from cmbot.common.reading.yaml_reader import read_yaml
from cmbot.identification import stiffness_text
from cmbot.scene import Scene, shipped_scenes
from cmbot.stances.walking import Step, Walk, stance_of, walk_data
from cmbot.stances.walking.steps import plan_step

__all__ = ["Corpus", "as_yaml", "make_corpus"]

Files = dict[str, bytes]

# Axis, range (rad; 0: endless), length (m) and mass (kg) of the arm's links.
_LINKS = (
    ("0 0 1", 0.0, 0.13, 1.4),
    ("0 1 0", 2.2, 0.21, 1.2),
    ("0 0 1", 3.0, 0.21, 1.2),
    ("0 1 0", 2.5, 0.21, 0.9),
    ("0 0 1", 0.0, 0.11, 0.7),
    ("0 1 0", 2.1, 0.11, 0.7),
    ("0 0 1", 3.0, 0.06, 0.4),
)
# Options that take a better start, and little time.
_QUICK = {
    "moment_about": "base",
    "chart_seeds": 30,
    "peak_tolerance": 0.05,
    "samples_per_segment": 10,
    "min_gain": 0.0,
}


@dataclass(frozen=True)
class Corpus:
    """Base files by their names, as the content of folders."""

    robot: Files
    """The arm, the files beside it, and ``scene.yaml`` with it."""
    scenes: tuple[tuple[str, Any], ...]
    """Scenes for the folder of `robot`: name and content; and the shipped ones, their content as text and,
    those of several strokes, faces and curves, as data."""
    measured: Files
    """Of that arm: measurements with a record, their scene, and a scene with the stiffness they tell."""
    campaign: Files
    """A campaign of variants of `robot`'s scene, with a table."""
    walk: bytes
    """A walk of one step of the shipped robot."""
    plans: tuple[Files, ...]
    """Plan directories, one with tracking errors and one with approach and return."""


def make_corpus(folder: Path) -> Corpus:
    """Write the arm into `folder`, and return all base files; this plans two scenes."""
    folder.mkdir(parents=True, exist_ok=True)
    robot = _robot_files() | {"row.csv": (scene_folder() / "panda_sanding" / "row_1.csv").read_bytes()}
    for name, content in robot.items():
        (folder / name).write_bytes(content)
    paths = {name: scene_folder() / f"{name}.yaml" for name in shipped_scenes()}
    shipped: list[tuple[str, Any]] = [(name, path.read_text("utf-8")) for name, path in paths.items()]
    # The Panda is not installed everywhere, and the rows of its scene lie beside it.
    shipped += [
        (name, read_yaml(path, InputError))
        for name, path in sorted(paths.items())
        if name not in ("panda_sanding", "mast_inspection")
    ]
    plans = []
    away = {"return": "start"}
    for name, changes in (
        ("fixed", {"planner": {"knots": "fixed"}}),
        ("sliding", {"planner": _QUICK} | away),
    ):
        path = folder / f"{name}.yaml"
        path.write_bytes(as_yaml(small_scene(**changes)))
        planned = cmbot.plan(cmbot.load_scene(path))
        target = cmbot.save(planned, folder / name, force=True)
        if name == "fixed":
            options = cmbot.SimulationOptions(settle_s=0.1, step_s=0.02)
            cmbot.save_tracking(cmbot.simulate(planned, options), target)
        plans.append({file.name: file.read_bytes() for file in sorted(target.iterdir())})
    rows = {"tool_path": {"waypoints": "row.csv", "speed_m_s": 0.1, "via_points": 12}}
    scenes = (
        ("small", small_scene()),
        ("full", full_scene()),
        ("rows", small_scene(**rows)),
    )
    return Corpus(
        robot=robot,
        scenes=(*scenes, *shipped),
        plans=tuple(plans),
        measured=_measured_files(folder),
        campaign=_campaign_files(),
        walk=_walk_file(),
    )


def small_scene(**changes: Any) -> dict[str, Any]:
    """A scene in which the arm follows a short leg, planned in a moment."""
    return {
        "format": "cmbot-scene/2",
        "name": "small",
        "robot": {
            "model": "arm.urdf",
            "base_frame": "base",
            "tool_frame": "tool",
            "limits": "joint_limits.yaml",
            "mount": {"xyz": [0.0, 0.3, 0.4], "rpy_deg": [0, 0, 90]},
        },
        "start": {"posture_deg": [10, 40, 20, 80, -15, 60, 0]},
        "tool_path": {"legs": [{"by": [0.0, 0.1, 0.05], "seconds": 4}], "via_points": 8},
        "guardrail": {"bays": 0},
        "planner": {"knots": "fixed", "path_step_s": 0.02},
        **changes,
    }


def full_scene() -> dict[str, Any]:
    """A scene that gives a value to nearly every key."""
    small = small_scene()
    return small | {
        "format": "cmbot-scene/2",
        "name": "full",
        "base": {"name": "rail"},
        "return": "start",
        "tool": {"process_force_n": [0, 1, -2], "max_speed_m_s": 0.15},
        "robot": small["robot"]
        | {
            "srdf": "arm.srdf",
            "elasticity": "arm.elasticity.yaml",
            "tool_length_m": 0.1,
            "payload_kg": 0.5,
        },
        "tool_path": {
            "keep": "axis",
            "legs": [{"by": [0, 0.1, 0.05], "seconds": 4}, {"by": [0.05, 0, 0], "seconds": 2.5}],
            "speed_profile": {"kind": "jerk_limited", "ramp": 0.25},
            "via_points": 12,
        },
        "obstacles": [
            {"name": "box", "box": [0.1, 0.2, 0.3], "xyz": [2, 2, 2], "rpy_deg": [10, 20, 30]},
            {"name": "cylinder", "cylinder": [0.1, 0.2], "xyz": [2, -2, 2]},
            {"name": "capsule", "capsule": [0.1, 0.2], "xyz": [-2, 2, 2], "workpiece": True},
            {"name": "sphere", "sphere": 0.1, "xyz": [-2, -2, 2]},
            {"name": "mesh", "mesh": "block.obj", "xyz": [2, 2, -2]},
        ],
        "guardrail": {
            "bays": 2,
            "post_spacing_m": 1.5,
            "post": {
                "section": {"angle": [0.075, 0.008]},
                "roll_deg": 0,
                "bottom_m": -1.1,
                "clamp_m": -1.05,
                "top_m": 0.05,
                "box_m": [0.075, 0.075],
            },
            "rails": [
                {
                    "name": "top_rail",
                    "section": {"angle": [0.063, 0.006]},
                    "roll_deg": -90,
                    "height_m": 0.0,
                    "box_m": [0.06, 0.06],
                },
                {"name": "bar", "section": {"bar": 0.02}, "height_m": -0.45, "box_m": [0.04, 0.04]},
            ],
            "foot": {"post": 2, "offset_m": 0.1},
            "material": {"young_pa": 206.0e9, "shear_pa": 79.0e9, "density_kg_m3": 7850.0},
        },
        "planner": {
            "knots": "sliding",
            "start": "pinned",
            "objective": "torque",
            "moment_about": "base",
            "axis_weights": [1, 1, 0.5],
            "compensate": False,
            "safety_margin_m": 0.02,
            "max_tool_deviation_m": 0.001,
            "other_starts": 4,
            "chart_seeds": 30,
            "samples_per_segment": 20,
        },
    }


def _measured_files(folder: Path) -> Files:
    """Measurements of the arm in `folder`, and the scene with what they tell."""
    robot = small_scene()["robot"] | {"elasticity": "arm.elasticity.yaml"}
    scene = small_scene(robot=robot, guardrail={"bays": 1})
    t = 0.005 * np.arange(400)
    tap = np.exp(-0.6 * t) * np.sin(2 * np.pi * 10.4 * t) + 0.3 * np.exp(-1.1 * t) * np.sin(
        2 * np.pi * 15.4 * t
    )
    table = np.column_stack([t, tap, 0.5 * tap, -0.2 * tap])
    measurements = {
        "format": "cmbot-measurements/1",
        "scene": "measured.yaml",
        "weight_kg": 5.0,
        "weight_sd_kg": 0.01,
        "gauge_sd_mm": 0.1,
        "windup_sd_arcmin": 0.0,
        "frequency_sd_share": 0.01,
        "prior": {"links": 0.3, "joints": 0.5, "base": 0.3, "base_coupling": 0.15},
        "measurements": [
            {"posture_deg": [26, 70, -47, 49, 55, 1, 54], "deflection_mm": [0.16, 0.6, -1.8]},
            {
                "posture": [0.42, 1.23, -0.97, 0.81, 0.86, 0.0, 0.81],
                "deflection_mm": [None, None, -1.86],
                "frequencies_hz": [10.7, 15.6],
            },
            {"posture_deg": [29, 63, -48, 42, 52, -14, 45], "record": "tap.csv"},
        ],
        "job": [[0.17, 0.7, 0.35, 1.4, -0.26, 1.05, 0.0], [0.19, 0.88, 0.34, 0.86, -0.27, 1.39, -0.12]],
    }
    files = {
        "measured.yaml": as_yaml(scene),
        "measurements.yaml": as_yaml(measurements),
        "tap.csv": ("t,ax,ay,az\n" + "\n".join(",".join(f"{x:.6g}" for x in row) for row in table)).encode(),
    }
    for name, content in files.items():
        (folder / name).write_bytes(content)
    found = cmbot.identify(folder / "measurements.yaml")
    return files | {
        "stiffness.yaml": stiffness_text(found.stiffness, "measurements.yaml").encode(),
        "identified.yaml": as_yaml(scene | {"identified": "stiffness.yaml"}),
    }


def _walk_file() -> bytes:
    """A step of 50 mm of foot 1 along the top rail."""
    arm = [3.1, -93.2, 148.1, 133.6, 54.8, 78.7, 5.7]

    def standing(first: float) -> Scene:
        ends = {"foot_1": first, "foot_2": 4.44}
        feet = {foot: {"member": "top_rail", "along_m": x, "turn_deg": 180} for foot, x in ends.items()}
        hold = {"kind": "clamp", "force_n": [2e4] * 3, "moment_nm": [2e3] * 3}
        scene = {
            "format": "cmbot-scene/2",
            "name": "walk",
            "robot": {"model": "cmbot"},
            "start": {"posture_deg": arm},
            "tool_path": {"legs": [{"by": [0.0, 0.1, 0.0], "seconds": 4}], "via_points": 8},
            "guardrail": {"hold": hold, "stance": feet},
        }
        return cmbot.load_scene(scene)

    scene = standing(4.04)
    before, after = stance_of(scene), stance_of(standing(4.09))
    moves = plan_step(scene, before, after, 1, np.radians(arm), 0.03, straight=True)
    step = Step(foot=1, before=before, after=after, moves=moves)
    return json_bytes(
        walk_data(Walk(scene=scene, goal=after, steps=(step,), last=None, failures=(), speed=0.03))
    )


def _campaign_files() -> Files:
    campaign = {
        "format": "cmbot-campaign/1",
        "name": "along",
        "scene": "scene.yaml",
        "set": {"robot.payload_kg": 1.0},
        "jobs": [
            {"name": "one", "at_m": 0.5, "set": {"tool_path.legs[0].by": [0.0, 0.1, 0.0]}},
            {"name": "two", "scene": "triangle"},
        ],
        "table": "jobs.csv",
        "time_limit_s": 60.0,
        "memory_limit_mb": 2000,
    }
    table = "name,at_m,robot.payload_kg,tool_path.legs[0].seconds\nthree,1.0,2,4\nfour,2.5,,6\n"
    return {"campaign.yaml": as_yaml(campaign), "jobs.csv": table.encode()}


def as_yaml(data: Any) -> bytes:
    """Return plain data as YAML in block style; text may hold lone surrogates."""
    lines: list[str] = []
    _block(data, 0, lines)
    return ("\n".join(lines) + "\n").encode("utf-8", "surrogatepass")


def _block(data: Any, depth: int, lines: list[str]) -> None:
    indent = "  " * depth
    if depth < 40 and isinstance(data, dict) and data:
        for key, value in data.items():
            _entry(f"{indent}{_scalar(key)}:", value, depth, lines)
    elif depth < 40 and isinstance(data, list) and data:
        for value in data:
            _entry(f"{indent}-", value, depth, lines)
    else:
        lines.append(f"{indent}{_flow(data)}")


def _entry(head: str, value: Any, depth: int, lines: list[str]) -> None:
    short = not isinstance(value, dict | list) or not value
    if short or (isinstance(value, list) and not any(isinstance(item, dict | list) for item in value)):
        lines.append(f"{head} {_flow(value)}")
    else:
        lines.append(head)
        _block(value, depth + 1, lines)


def _flow(data: Any) -> str:
    if isinstance(data, dict):
        return "{" + ", ".join(f"{_scalar(key)}: {_flow(value)}" for key, value in data.items()) + "}"
    if isinstance(data, list):
        return "[" + ", ".join(map(_flow, data)) + "]"
    return _scalar(data)


def _scalar(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and not np.isfinite(value):
        return ".nan" if np.isnan(value) else ".inf" if value > 0 else "-.inf"
    if isinstance(value, int | float):
        return repr(value)
    if value and value.isascii() and value.replace("_", "a").replace(".", "a").isalpha():
        return str(value)
    marks = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\0": "\\0", "\x1b": "\\e", "\t": "\\t"}
    return '"' + "".join(marks.get(letter, letter) for letter in value) + '"'


def _robot_files() -> Files:
    block = trimesh.creation.box((0.04, 0.04, 0.04))
    stl = io.BytesIO()
    block.export(stl, file_type="stl")
    joints = "".join(
        f"  joint_{i}: {{acceleration_deg: 200, jerk_deg: 1000}}\n" for i in range(1, len(_LINKS) + 1)
    )
    chain = ("base", *(f"link_{i}" for i in range(1, 8)), "finger")
    near = (*pairwise(chain), *zip(chain, chain[2:], strict=False))
    pairs = "".join(
        f'  <disable_collisions link1="{one}" link2="{other}" reason="Never"/>\n' for one, other in near
    )
    state = (
        '  <group_state name="rest" group="arm">\n    <joint name="gripper" value="0.1"/>\n  </group_state>\n'
    )
    tube = (
        "{start_m: [0, 0, 0], end_m: [0, 0, 0.21], outer_diameter_m: 0.06, wall_m: 0.003, "
        "young_pa: 70.0e+9, shear_pa: 26.0e+9}"
    )
    files = {
        "arm.urdf": _urdf(),
        "arm.srdf": f'<robot name="arm">\n{state}{pairs}</robot>\n',
        "joint_limits.yaml": f"format: cmbot-joint-limits/1\njoints:\n{joints}",
        "arm.elasticity.yaml": f"format: cmbot-elasticity/2\nlinks:\n  link_2: {tube}\n  link_3: {tube}\n"
        "joints: {joint_2: {stiffness_nm_rad: 5.0e+4, damping_nms_rad: 1.0, tilting_nm_rad: 1.0e+5}}\n",
        "block.obj": block.export(file_type="obj"),
    }
    return {name: text.encode() for name, text in files.items()} | {
        "block.stl": stl.getvalue(),
        "scene.yaml": as_yaml(small_scene(guardrail={"bays": 1})),
    }


def _urdf() -> str:
    parts = ['<robot name="arm">', _link("base", 0.1, 2.0, '<box size="0.1 0.1 0.1"/>')]
    parent, height = "base", 0.15
    for number, (axis, bound, length, mass) in enumerate(_LINKS, start=1):
        kind = "revolute" if bound else "continuous"
        limit = f'lower="{-bound}" upper="{bound}" ' if bound else ""
        shape = f'<cylinder radius="0.02" length="{length}"/>'
        if number == 4:
            shape = '<mesh filename="block.stl" scale="1 1 1"/>'
        parts.append(_link(f"link_{number}", length, mass, shape))
        parts.append(
            f'<joint name="joint_{number}" type="{kind}">\n  <parent link="{parent}"/>\n'
            f'  <child link="link_{number}"/>\n  <origin xyz="0 0 {height}" rpy="0 0 0"/>\n'
            f'  <axis xyz="{axis}"/>\n  <limit {limit}velocity="1.2" effort="60"/>\n</joint>'
        )
        parent, height = f"link_{number}", length
    parts.append(
        f'<link name="tool"/>\n<joint name="flange" type="fixed">\n  <parent link="{parent}"/>\n'
        f'  <child link="tool"/>\n  <origin xyz="0 0 {height}"/>\n</joint>'
    )
    parts.append(_link("finger", 0.05, 0.1, '<sphere radius="0.02"/>'))
    parts.append(
        '<joint name="gripper" type="prismatic">\n  <parent link="tool"/>\n  <child link="finger"/>\n'
        '  <origin xyz="0 0.05 0"/>\n  <limit lower="0" upper="0.1" velocity="1" effort="1"/>\n</joint>\n'
        "</robot>"
    )
    return "\n".join(parts)


def _link(name: str, length: float, mass: float, shape: str) -> str:
    across = mass * (3 * 0.04**2 + length**2) / 12
    return (
        f'<link name="{name}">\n  <inertial>\n    <origin xyz="0 0 {length / 2}" rpy="0 0 0"/>\n'
        f'    <mass value="{mass}"/>\n'
        f'    <inertia ixx="{across}" iyy="{across}" izz="{mass * 0.04**2 / 2}" ixy="0" ixz="0" iyz="0"/>\n'
        f'  </inertial>\n  <collision>\n    <origin xyz="0 0 {length / 2}"/>\n'
        f"    <geometry>{shape}</geometry>\n  </collision>\n</link>"
    )
