"""The text of a new scene, with comments, and of the joint-limits file beside it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.poses import rpy_deg
from cmbot.scene.robot_entry import AttachedToolFile

if TYPE_CHECKING:
    from cmbot.robot import JointLimits, Robot, RobotFiles

_SHIPPED_ROBOT = "cmbot"


@dataclass(frozen=True, kw_only=True)
class NewRobot:
    """The robot that a new scene is to have.

    Attributes
    ----------
    source : str
        ``cmbot``, a URDF, or the name of a robot.
    base_frame, tool_frame : str or None
    package_dirs : tuple of pathlib.Path
    xacro : mapping of str to str
        Arguments of xacro.
    locked : mapping of str to float
        Positions, rad or m, of joints that are not the arm's.
    total_mass : float or None, kg
    tool : AttachedToolFile or None
        That is fixed to the tool frame; paths of its meshes are absolute.
    """

    source: str
    base_frame: str | None = None
    tool_frame: str | None = None
    package_dirs: tuple[Path, ...] = ()
    xacro: Mapping[str, str]
    locked: Mapping[str, float]
    total_mass: float | None = None
    tool: AttachedToolFile | None = None

    def files(self, srdf: Path | None = None) -> RobotFiles:
        """Return its files.

        Raises
        ------
        ModelError
            As `cmbot.robot.robot_files`.
        """
        from cmbot.robot import robot_files

        return robot_files(self.source, srdf=srdf, package_dirs=self.package_dirs, xacro=self.xacro)

    def load(self, srdf: Path | None = None) -> Robot:
        """Load it, with another SRDF where one is given.

        Raises
        ------
        ModelError
            As `cmbot.robot.load_robot`.
        """
        from cmbot.robot import load_robot

        return load_robot(
            self.source,
            base_frame=self.base_frame,
            tool_frame=self.tool_frame,
            package_dirs=self.package_dirs,
            srdf=srdf,
            xacro=self.xacro,
            locked=self.locked,
            total_mass=self.total_mass,
            tool=None if self.tool is None else self.tool.tool,
        )

    def entry(
        self, robot: Robot, path: Path, assumed: Path | None, srdf: Path | None
    ) -> dict[str, tuple[object, str]]:
        """Return the ``robot`` block of a scene at `path`, each value with its comment.

        `robot` is what was loaded, `assumed` the file of assumed limits, `srdf` the one that was written.
        """
        folder = path.resolve().parent

        def from_scene(place: str | Path) -> str:
            return os.path.relpath(Path(place).resolve(), folder)

        if self.source == _SHIPPED_ROBOT:
            return {"model": (self.source, ""), "payload_kg": (0.0, "point mass at the tool")}
        model = from_scene(self.source) if Path(self.source).exists() else self.source
        entry: dict[str, tuple[object, str]] = {"model": (model, "")}
        if self.xacro:
            entry["xacro"] = (dict(self.xacro), "")
        if self.locked:
            entry["locked"] = (dict(self.locked), "rad or m")
        entry["base_frame"] = (robot.base_frame, "")
        flange = robot.tool_frame if self.tool is None else robot.flange
        entry["tool_frame"] = (
            flange,
            "the frame that follows the tool path" if self.tool is None else "the flange",
        )
        if self.tool is not None:
            data: dict[str, Any] = self.tool.model_dump(mode="json", exclude_defaults=True)
            for part in (data, *data.get("shapes", ())):
                if "mesh" in part:
                    part["mesh"] = from_scene(part["mesh"])
            entry["tool"] = (data, "the tool point and what is on the way to it, in the flange's frame")
        if self.total_mass is not None:
            entry["total_mass_kg"] = (
                self.total_mass,
                "spread over the links' volumes: torques are estimates",
            )
        if assumed is not None:
            entry["limits"] = (assumed.name, "accelerations and jerks, assumed: put your robot's there")
        if srdf is not None:
            comment = "by sampling: which of its links need not be checked against each other"
            entry["srdf"] = (srdf.name, comment)
        if self.package_dirs:
            entry["package_dirs"] = ([from_scene(place) for place in self.package_dirs], "")
        return entry | {"payload_kg": (0.0, "point mass at the tool")}


_SCENE_TEMPLATE = """\
# yaml-language-server: $schema={schema}
# Metres, seconds, degrees. W is the world frame{world}.
format: cmbot-scene/2
name: {name}

robot:
{robot}
# Found by inverse kinematics; puts the tool point at {point}.
start:
  {start}

tool_path:
  keep: {keep}  # of the tool: pose, axis, position or {{axis_within_deg: 10}}
  # Each leg is a displacement of the tool point in W. Put your own here.
  legs:
    - {{by: {by}, seconds: {seconds}}}
  speed_profile: {{kind: quiet, ramp: 0.3}}  # the law by which the tool sways least
  via_points: auto  # by the length of the legs, or a number

# Boxes, cylinders, capsules, spheres and meshes, such as
#   - {{name: table, box: [1.0, 1.0, 0.05], xyz: [0.5, 0, -0.2]}}
obstacles: []

guardrail: {guardrail}
planner: {planner}
"""
_LIMITS_TEMPLATE = """\
# Joint limits that a URDF does not have, {units}.
# An acceleration of 2 /s times the velocity limit,
# a jerk of 10 /s times the acceleration.{what}
# Put those of your robot's data sheet here.
format: cmbot-joint-limits/1
assumed: true  # plans say so; take this line away when the numbers are your robot's
joints:
{joints}"""


def scene_text(
    *,
    name: str,
    schema: str,
    robot: Mapping[str, tuple[object, str]],
    on_guardrail: bool,
    posture: FloatArray,
    arm: Robot,
    tool_point: FloatArray,
    keep: str,
    by: Sequence[float],
    seconds: float,
    safety_margin_m: float | None,
) -> str:
    """Return the text of a scene file.

    Parameters
    ----------
    name : str
    schema : str
        Where the JSON Schema lies, for editors.
    robot : mapping
        Keys of the robot's block, each with its value and a comment, which may be empty.
    on_guardrail : bool
        Whether the robot holds the default guardrail; else there is none.
    posture : (n,), rad and m
    arm : Robot
        Where any joint slides, the posture is written in rad and m, else in degrees.
    tool_point : (3,), m
        Where that posture holds the tool.
    keep, by, seconds
        Of the tool path and its only leg.
    safety_margin_m : float, optional
        Where it is not the default.
    """
    lines = (
        f"  {key}: {_flow(value)}{f'  # {comment}' if comment else ''}\n"
        for key, (value, comment) in robot.items()
    )
    planner = "{}  # every option at its default: cmbot plan --options"
    if safety_margin_m is not None:
        planner = (
            f"{{safety_margin_m: {safety_margin_m:g}}}  # less than the default: as convex hulls, the arm's "
            "own links are always near"
        )
    return _SCENE_TEMPLATE.format(
        schema=schema,
        world="" if on_guardrail else ": that of the robot's root link, or as robot.mount says",
        name=name,
        robot="".join(lines),
        start=start_entry(posture, arm.limits),
        point="({:z.4f}, {:z.4f}, {:z.4f})".format(*tool_point),
        keep=keep,
        by=_flow(list(by)),
        seconds=f"{seconds:g}",
        guardrail="{}  # the default one" if on_guardrail else _rigid_base(arm),
        planner=planner,
    )


_RIGID_BASE = """\
{bays: 0}  # none: a rigid base, unless there is base.tube, or a stiffness at the origin of W:
# guardrail: {bays: 0, stiffness: [4.0e+5, 4.0e+5, 2.0e+6, 2.5e+5, 2.5e+5, 1.4e+5]}
# Along x, y, z in N/m, then about them in Nm/rad; or 6 rows, the inverse of the matrix of compliances.
# Or an aluminium mast, clamped at start_m; it holds the arm at end_m, the origin of W if left out:
# base: {name: mast, tube: {start_m: [0, 0, -2.5], outer_diameter_m: 0.1, wall_m: 0.004, young_pa: 70.0e+9,
#   shear_pa: 26.0e+9, density_kg_m3: 2700}}"""


def _rigid_base(arm: Robot) -> str:
    """What is under ``guardrail`` of an arm whose base is rigid, and how it bends where it is away from W."""
    text, name = _RIGID_BASE, _flow(arm.base_frame)
    if arm.base_place:
        text += f"\n# For one measured at {name}, now at {arm.base_place}, put into robot, with W there:"
        text += f"\n#   {mount_entry(arm.base_pose)}"
    if arm.lift is not None:
        text += f"\n# And where what is below {_flow(arm.lift.joint)} stands on the floor:"
        text += f"\n#   carried_from: {_flow(arm.lift.link)}"
    return text


def mount_entry(X_WB: Any) -> str:
    """Return the line under ``robot`` by which W is where its base frame is, at a `pinocchio.SE3`."""
    turned = ", ".join(f"{angle:z.6g}" for angle in np.round(rpy_deg(X_WB.rotation), 6))
    return f"mount: {{xyz: [0, 0, 0], rpy_deg: [{turned}]}}"


def start_entry(q: FloatArray, limits: JointLimits) -> str:
    """Return the line under ``start`` of a scene file that has a posture (n,), rad or m, in its ranges."""
    prismatic = limits.prismatic
    # Also as rounded.
    step = np.where(prismatic, 1e-5, np.radians(1e-4))
    q = np.clip(q, limits.lower + step, limits.upper - step)
    if not prismatic.any():
        return f"posture_deg: {_flow([round(angle, 4) for angle in np.rad2deg(q).tolist()])}"
    # In rad and, of joints that slide, m.
    return f"posture: {_flow([round(value, 5) for value in q.tolist()])}"


def limits_text(joints: Sequence[str], limits: JointLimits) -> str:
    """Return the text of a joint-limits file of an arm with those `limits`.

    It has accelerations and jerks, and the velocities and efforts that are assumed.
    """
    from cmbot.robot import ASSUMPTIONS, RATE_KEYS

    entries, prismatic = [], limits.prismatic
    for i, name in enumerate(joints):
        rates = limits.velocity[i], limits.acceleration[i], limits.jerk[i]
        factor = limits.units(i, shown=True).factor
        every = zip(RATE_KEYS[bool(prismatic[i])], rates, strict=True)
        listed = [f"{key}: {factor * rate:.6g}" for key, rate in every][not limits.assumed_velocity[i] :]
        if limits.assumed_torque[i]:
            listed.append(f"effort: {limits.torque[i]:.6g}")
        entries.append(f"  {_flow(name)}: {{{', '.join(listed)}}}\n")
    powers = [f"{unit}/s2 and {unit}/s3" for unit in _units(prismatic)]
    what = ""
    if limits.assumed_velocity.any():
        units = " or ".join(f"{unit}/s" for unit in _units(prismatic))
        what += f"\n# Velocities, {units}: {ASSUMPTIONS['velocity'][1]}."
    if limits.assumed_torque.any():
        what += f"\n# Efforts, Nm or N: {ASSUMPTIONS['torque'][1]}."
    return _LIMITS_TEMPLATE.format(units=", or ".join(powers), joints="".join(entries), what=what)


def _units(prismatic: BoolArray) -> list[str]:
    """Of positions of the joints that there are."""
    return [unit for unit, there in (("deg", not prismatic.all()), ("m", bool(prismatic.any()))) if there]


def _flow(value: object) -> str:
    """A value as YAML on one line: JSON, without the quotes of plain words."""
    text = json.dumps(value, ensure_ascii=False)
    plain = isinstance(value, str) and _UNQUOTED_TEXT.fullmatch(value) and value.lower() not in _YAML_WORDS
    return str(value) if plain else text


_UNQUOTED_TEXT = re.compile(r"[A-Za-z][A-Za-z0-9_./\-]*")
# Words that YAML may take for something else.
_YAML_WORDS = ("null", "true", "false", "yes", "no", "on", "off", "y", "n", "inf", "nan")
