"""Write the robot description from the tables of the paper.

Writes ``urdf/cmbot.urdf``, ``urdf/cmbot.srdf``, ``urdf/joint_limits.yaml``, ``urdf/cmbot.elasticity.yaml``,
the same robot as it climbs (``urdf/cmbot_on_foot_2.urdf``, ``urdf/climbing.*``) and ``meshes/*.stl``. The
output is the same to the byte on every run, so the files that are checked in can be compared with it.

    python tools/build_models.py            write models/
    python tools/build_models.py --check    compare models/ with it; exit status 1 on a difference
"""

from __future__ import annotations

import argparse
import math
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import cmbot_tables as tables
import numpy as np
from cmbot_meshes import MATERIALS, VISUALS, build_meshes
from cmbot_parts import stl_bytes
from scipy.spatial.transform import Rotation

GENERATED = " Written by tools/build_models.py: change the tables in tools/, not this file. "
SOURCES = """
  Arm: Chang 2021, Tables 1 to 3 (modified Denavit-Hartenberg; joint frame i is the paper's frame i).
  Assumptions of ours: centres of mass, joint ranges, tool length, collision radii, the inertias of link_3 and
  link_4 (Table 2's are no possible rigid bodies; these are the nearest ones), and all of the climbing
  mechanism but its five joints and its 30.38 kg. Its ranges and its limits of velocity and effort (0.2 rad/s,
  200 Nm) are assumptions too: it is locked while the arm works. In the working stance (cmbot.srdf) it has its
  centre of mass at (0, 0.25, 0) in foot_1 and 0.6 kg m2 about each axis through it.
  foot_1 is the world frame: origin at the contact of guardrail and magnet foot, x along the guardrail,
  y outward, z up. O0 lies on the centre line of the post; the foot's plate begins at its face, y = 0.0375.
  A cylinder named in collision_checking is a capsule; its length is the distance between its caps' centres.
"""
NOTHING_BENDS = "# While it climbs nothing bends.\nformat: cmbot-elasticity/2\nlinks: {}\n"
AXIS_RPY = {"x": (0, 90, 0), "y": (-90, 0, 0), "z": (0, 0, 0)}  # turns z onto the axis

ON_FOOT_2 = """
  The robot of cmbot.urdf as it holds on to foot 2 while it climbs: the climbing joints in the other order,
  with the same angles. A link's frame is where the next joint is; foot_1_place is where foot_1 holds.
"""
ADJACENT = "Adjacent"
PARALLEL = "Never: they move in parallel planes and pass each other 10 mm apart"
LOCKED = "Never: both belong to the climbing mechanism, which is locked while the arm works"
SWEEP = "Never, in any stance: the arm's base is fixed to leg_1, and link_1 turns 50 mm beside it"
# link_4 has no shape of its own: link_3 and link_5 meet at the axis of joint_4.
ADJACENT_PAIRS = [
    ("arm_base", "link_1"),
    ("link_1", "link_2"),
    ("link_2", "link_3"),
    ("link_3", "link_5"),
    ("link_5", "tool"),
]


def text(values: Sequence[float]) -> str:
    """Return numbers with every digit they need, and no more."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def radians(degrees: Sequence[float]) -> str:
    """Return angles of degrees as text in radians."""
    return text([math.radians(value) for value in degrees])


def add_origin(parent: ET.Element, xyz: Sequence[float], rpy_deg: Sequence[float] = (0, 0, 0)) -> None:
    """Append an origin."""
    ET.SubElement(parent, "origin", xyz=text(xyz), rpy=radians(rpy_deg))


def matrix(xyz: Sequence[float], rpy_deg: Sequence[float] = (0, 0, 0)) -> np.ndarray:
    """Return the pose of an origin, exact for quarter turns."""
    roll, pitch, yaw = rpy_deg
    X = np.eye(4)
    X[:3, :3] = (
        tables.rotation(tables.Z, yaw) @ tables.rotation(tables.Y, pitch) @ tables.rotation((1, 0, 0), roll)
    )
    X[:3, 3] = xyz
    return X


def move_origins(parent: ET.Element, X: np.ndarray) -> None:
    """Put poses, in place, before the origins of what is fixed to a link or of a joint."""
    for origin in parent.iter("origin"):
        xyz, rpy = ([float(x) for x in origin.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
        moved = X @ matrix(xyz, np.degrees(rpy))
        turn = Rotation.from_matrix(moved[:3, :3]).as_euler("xyz", suppress_warnings=True)
        origin.set("xyz", text(np.round(moved[:3, 3], 12)))
        origin.set("rpy", text(np.round(turn, 12)))


def add_body(link: ET.Element, body: tables.Body) -> None:
    """Append the inertial element."""
    inertial = ET.SubElement(link, "inertial")
    add_origin(inertial, body.com)
    ET.SubElement(inertial, "mass", value=text([body.mass]))
    moments = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), body.inertia, strict=True)
    ET.SubElement(inertial, "inertia", {key: text([value]) for key, value in moments})


def add_shape(link: ET.Element, shape: tables.Shape) -> None:
    """Append a collision element."""
    collision = ET.SubElement(link, "collision", name=shape.name)
    add_origin(collision, shape.xyz, AXIS_RPY[shape.axis])
    geometry = ET.SubElement(collision, "geometry")
    if shape.kind == "box":
        ET.SubElement(geometry, "box", size=text(shape.size))
    else:
        radius, length = shape.size
        ET.SubElement(geometry, "cylinder", radius=text([radius]), length=text([length]))


def add_link(robot: ET.Element, name: str, body: tables.Body | None) -> None:
    """Append a link with its inertia, its looks and its collision shapes."""
    link = ET.SubElement(robot, "link", name=name)
    if body is not None:
        add_body(link, body)
    for visual in VISUALS.get(name, []):
        element = ET.SubElement(link, "visual", name=f"{name}_{visual.mesh}")
        add_origin(element, visual.xyz, visual.rpy_deg)
        # Relative: yourdfpy finds it, MuJoCo by its meshdir, pinocchio with the URDF's folder as package.
        ET.SubElement(ET.SubElement(element, "geometry"), "mesh", filename=f"../meshes/{visual.mesh}.stl")
        ET.SubElement(element, "material", name=visual.material)
    shapes = tables.COLLISIONS.get(name, [])
    for shape in shapes:
        add_shape(link, shape)
    capsules = [shape.name for shape in shapes if shape.kind == "capsule"]
    if capsules:
        checking = ET.SubElement(link, "collision_checking")
        for capsule in capsules:
            ET.SubElement(checking, "capsule", name=capsule)


def add_joint(robot: ET.Element, joint: tables.Joint) -> None:
    """Append a joint."""
    if joint.note:
        robot.append(ET.Comment(f" {joint.name}: {joint.note} "))
    kind = "fixed" if joint.axis is None else "revolute"
    element = ET.SubElement(robot, "joint", name=joint.name, type=kind)
    add_origin(element, joint.xyz, joint.rpy_deg)
    ET.SubElement(element, "parent", link=joint.parent)
    ET.SubElement(element, "child", link=joint.child)
    if joint.axis is not None:
        ET.SubElement(element, "axis", xyz=text(joint.axis))
        ET.SubElement(
            element, "limit", lower=radians([-joint.range_deg]), upper=radians([joint.range_deg]),
            velocity=text([joint.velocity]), effort=text([joint.effort]),
        )  # fmt: skip


def urdf() -> str:
    """Return the URDF."""
    robot = ET.Element("robot", name="cmbot")
    robot.append(ET.Comment(GENERATED))
    robot.append(ET.Comment(SOURCES))
    # For MuJoCo alone: keep every link and its looks, and take the inertias as they are.
    compiler = {"meshdir": "../meshes", "strippath": "true"}
    compiler |= dict.fromkeys(("discardvisual", "fusestatic", "balanceinertia", "inertiafromgeom"), "false")
    ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler", compiler)
    for name, rgba in MATERIALS.items():
        ET.SubElement(ET.SubElement(robot, "material", name=name), "color", rgba=text(rgba))
    bodies = tables.bodies()
    for name in tables.LINKS:
        add_link(robot, name, bodies.get(name))
    for joint in tables.JOINTS:
        add_joint(robot, joint)
    return document(robot)


def urdf_on_foot_2() -> str:
    """Return the URDF of the robot that holds on to foot 2: the climbing joints the other way round."""
    robot = ET.fromstring(urdf())
    for comment in (ON_FOOT_2, GENERATED):
        robot.insert(0, ET.Comment(comment))
    joints = {joint.name: joint for joint in tables.JOINTS}
    chain = [joints[f"climb_{number}"] for number in range(1, 6)]
    # A link's frame is where the joint is that leads on to foot 1.
    away = {joint.parent: np.linalg.inv(matrix(joint.xyz, joint.rpy_deg)) for joint in chain}
    for link in robot.findall("link"):
        move_origins(link, away.get(link.get("name"), np.eye(4)))
    for element in robot.findall("joint"):
        joint = joints[element.get("name")]
        if joint not in chain:
            move_origins(element, away.get(joint.parent, np.eye(4)))
            continue
        (origin,) = element.findall("origin")
        origin.set("xyz", text((0, 0, 0)))
        origin.set("rpy", text((0, 0, 0)))
        move_origins(element, away.get(joint.child, np.eye(4)))
        element.find("parent").set("link", joint.child)
        element.find("child").set("link", joint.parent)
        element.find("axis").set("xyz", text([-x for x in joint.axis]))
    ET.SubElement(robot, "link", name="foot_1_place")
    place = ET.SubElement(robot, "joint", name="foot_1_place_joint", type="fixed")
    add_origin(place, (0, 0, 0))
    move_origins(place, away["foot_1"])
    ET.SubElement(place, "parent", link="foot_1")
    ET.SubElement(place, "child", link="foot_1_place")
    return document(robot)


def climbing_srdf() -> str:
    """Return the SRDF of the robot as it climbs, its arm locked: the pairs that need no check."""
    robot = ET.Element("robot", name="cmbot")
    robot.append(ET.Comment(GENERATED))
    neighbours = [(joint.parent, joint.child) for joint in tables.JOINTS if joint.name.startswith("climb")]
    ET.SubElement(robot, "disable_collisions", link1="arm_base", link2="leg_2", reason=PARALLEL)
    for one, other in neighbours:
        ET.SubElement(robot, "disable_collisions", link1=one, link2=other, reason=ADJACENT)
    return document(robot)


def document(root: ET.Element) -> str:
    """Return the XML file's text."""
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def disabled_pairs() -> list[tuple[str, str, str]]:
    """Return the pairs of links that need no collision check, each with the reason."""
    locked = [(one, other, LOCKED) for one, other in combinations(tables.CLIMBER, 2)]
    adjacent = [(one, other, ADJACENT) for one, other in ADJACENT_PAIRS]
    return [*adjacent, ("leg_1", "link_1", SWEEP), *locked]


def srdf() -> str:
    """Return the SRDF: groups, the working stance, the stow posture, and the pairs that need no check."""
    robot = ET.Element("robot", name="cmbot")
    robot.append(ET.Comment(GENERATED))
    arm = ET.SubElement(robot, "group", name="arm")
    ET.SubElement(arm, "chain", base_link="arm_base", tip_link="tool0")
    climber = ET.SubElement(robot, "group", name="climber")
    stance = ET.SubElement(robot, "group_state", name="working_stance", group="climber")
    for name, angle in tables.STANCE_DEG.items():
        ET.SubElement(climber, "joint", name=name)
        ET.SubElement(stance, "joint", name=name, value=radians([angle]))
    stow = ET.SubElement(robot, "group_state", name="stow", group="arm")
    for name, angle in tables.STOW_DEG.items():
        ET.SubElement(stow, "joint", name=name, value=radians([angle]))
    for one, other, reason in disabled_pairs():
        ET.SubElement(robot, "disable_collisions", link1=one, link2=other, reason=reason)
    return document(robot)


def joint_limits() -> str:
    """Return the limits that URDF has no words for, as YAML."""
    lines = [
        f"# {GENERATED.strip()}",
        "# Chang 2021, Table 3, in degrees/s2 and degrees/s3. Position, velocity, effort: see the URDF.",
        "format: cmbot-joint-limits/1",
        "joints:",
    ]
    limits = zip(tables.ACCELERATION_DEG, tables.JERK_DEG, strict=True)
    for number, (acceleration, jerk) in enumerate(limits, start=1):
        lines.append(f"  joint_{number}: {{acceleration_deg: {acceleration}, jerk_deg: {jerk}}}")
    # Locked, they bear what the paper's baselines load them with: docs/assumptions.md.
    lines += [f"  {name}: {{holding_torque: {tables.CLIMB_HOLDING}}}" for name in tables.STANCE_DEG]
    return "\n".join(lines) + "\n"


def elasticity() -> str:
    """Return which links bend like which tubes, and how stiff the joints are, as YAML."""
    lines = [
        f"# {GENERATED.strip()}",
        "# Assumptions of ours: aluminium tubes from joint to joint, and drives as stiff as harmonic drives.",
        "# The paper's joints are rigid: `robot: {joints: rigid}` in a scene. The rest of the arm is rigid.",
        "# The tube between joint 4 and the wrist is on link_5, which turns about the tube's own axis.",
        "format: cmbot-elasticity/2",
        "links:",
    ]
    for name, tube in tables.TUBES.items():
        lines += [
            f"  {name}:",
            f"    start_m: [{', '.join(text([value]) for value in tube.start)}]",
            f"    end_m: [{', '.join(text([value]) for value in tube.end)}]",
            f"    outer_diameter_m: {tube.outer_diameter}",
            f"    wall_m: {tube.wall}",
            f"    young_pa: {tables.YOUNG_PA}",
            f"    shear_pa: {tables.SHEAR_PA}",
        ]
    lines.append("joints:")
    for number, stiffness in enumerate(tables.JOINT_STIFFNESS, start=1):
        lines.append(f"  joint_{number}: {{stiffness_nm_rad: {stiffness}}}")
    lines += [f"  {name}: {{stiffness_nm_rad: {tables.CLIMB_STIFFNESS}}}" for name in tables.STANCE_DEG]
    return "\n".join(lines) + "\n"


def files() -> dict[str, bytes]:
    """Return every generated file: path inside the models folder, and content."""
    meshes = {f"meshes/{name}.stl": stl_bytes(mesh) for name, mesh in sorted(build_meshes().items())}
    described = {
        "cmbot.urdf": urdf(),
        "cmbot.srdf": srdf(),
        "joint_limits.yaml": joint_limits(),
        "cmbot.elasticity.yaml": elasticity(),
        "cmbot_on_foot_2.urdf": urdf_on_foot_2(),
        "climbing.srdf": climbing_srdf(),
        "climbing.elasticity.yaml": f"# {GENERATED.strip()}\n{NOTHING_BENDS}",
    }
    return {**{f"urdf/{name}": content.encode() for name, content in described.items()}, **meshes}


def differences(folder: Path, wanted: dict[str, bytes]) -> list[str]:
    """Return what is missing, different or left over in `folder`."""
    paths = [*folder.glob("urdf/*"), *folder.glob("meshes/*")]
    found = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths if path.is_file()}
    return sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))


def main() -> int:
    """Write the files, or compare them."""
    parser = argparse.ArgumentParser(description="Write the robot description from the tables of the paper.")
    parser.add_argument("--check", action="store_true", help="compare only; exit status 1 on a difference")
    default = Path(__file__).resolve().parents[1] / "models"
    parser.add_argument("--output", type=Path, default=default, help="the folder to write (default: models/)")
    arguments = parser.parse_args()
    wanted = files()
    if arguments.check:
        differing = differences(arguments.output, wanted)
        for name in differing:
            print(f"out of date: {name}", file=sys.stderr)
        return 1 if differing else 0
    for name, content in wanted.items():
        path = arguments.output / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    for name in differences(arguments.output, wanted):
        print(f"left over, not ours any more: {name}", file=sys.stderr)
    print(f"wrote {len(wanted)} files, {sum(map(len, wanted.values()))} bytes, to {arguments.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
