"""The text of a new scene, with comments, and of the joint-limits file beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray

__all__ = ["limits_text", "scene_text"]

_SCENE = """\
# yaml-language-server: $schema={schema}
# Metres, seconds, degrees. W is the world frame{world}.
format: cmbot-scene/2
name: {name}

robot:
{robot}
# Found by inverse kinematics; puts the tool point at {point}.
{posture}

tool_path:
  keep: {keep}  # of the tool: pose, axis, position or {{axis_within_deg: 10}}
  # Each leg is a displacement of the tool point in W. Put your own here.
  legs:
    - {{by: {by}, seconds: {seconds}}}
  speed_profile: {{kind: jerk_limited, ramp: 0.25}}
  via_points: auto  # by the length of the legs, or a number

# Boxes, cylinders, capsules, spheres and meshes, such as
#   - {{name: table, box: [1.0, 1.0, 0.05], xyz: [0.5, 0, -0.2]}}
obstacles: []

guardrail: {guardrail}
planner: {planner}
"""
_LIMITS = """\
# Joint limits that a URDF does not have, {units}.
# An acceleration of 2 /s times the velocity limit,
# a jerk of 10 /s times the acceleration. Put those of your robot's data sheet here.
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
    prismatic: BoolArray,
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
    prismatic : (n,)
        Which joints slide: with any the posture is written in rad and m, else in degrees.
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
    return _SCENE.format(
        schema=schema,
        world="" if on_guardrail else ": that of the robot's root link",
        name=name,
        robot="".join(lines),
        posture=_posture(posture, prismatic),
        point="({:z.4f}, {:z.4f}, {:z.4f})".format(*tool_point),
        keep=keep,
        by=_flow(list(by)),
        seconds=f"{seconds:g}",
        guardrail="{}  # the default one" if on_guardrail else _RIGID,
        planner=planner,
    )


_RIGID = "{bays: 0}  # none: a rigid base; {bays: 0, stiffness: [3 in N/m, 3 in Nm/rad]} bends"


def _posture(q: FloatArray, prismatic: BoolArray) -> str:
    """The entry of a posture (n,)."""
    if not prismatic.any():
        return f"start:\n  posture_deg: {_flow([round(angle, 4) for angle in np.rad2deg(q).tolist()])}"
    numbers = _flow([round(value, 5) for value in q.tolist()])
    return f"start:\n  posture: {numbers}  # rad and, of joints that slide, m"


def limits_text(
    joints: Sequence[str], acceleration: FloatArray, jerk: FloatArray, prismatic: BoolArray
) -> str:
    """Return the text of a joint-limits file from limits (n,), SI; joints turn or are `prismatic` (n,)."""
    entries = []
    for name, slides, rates in zip(joints, prismatic, zip(acceleration, jerk, strict=True), strict=True):
        keys = ("acceleration_m_s2", "jerk_m_s3") if slides else ("acceleration_deg", "jerk_deg")
        values = rates if slides else np.rad2deg(rates)
        limits = ", ".join(f"{key}: {value:.6g}" for key, value in zip(keys, values, strict=True))
        entries.append(f"  {_flow(name)}: {{{limits}}}\n")
    units = ["deg/s2 and deg/s3"] if not prismatic.all() else []
    units += ["m/s2 and m/s3"] if prismatic.any() else []
    return _LIMITS.format(units=", or ".join(units), joints="".join(entries))


def _flow(value: object) -> str:
    """A value as YAML on one line: JSON, without the quotes of plain words."""
    text = json.dumps(value, ensure_ascii=False)
    plain = isinstance(value, str) and _PLAIN.fullmatch(value) and value.lower() not in _WORDS
    return str(value) if plain else text


_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./\-]*")
# Words that YAML may take for something else.
_WORDS = ("null", "true", "false", "yes", "no", "on", "off", "y", "n", "inf", "nan")
