"""The text of a new scene, with comments, and of the joint-limits file beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence

from cmbot.common.arrays import FloatArray

__all__ = ["limits_text", "scene_text"]

_SCENE = """\
# yaml-language-server: $schema={schema}
# Metres, seconds, degrees. W is the world frame{world}.
format: cmbot-scene/2
name: {name}

robot:
{robot}
# Found by inverse kinematics; puts the tool point at {point}.
posture_deg: {posture}

tool_path:
  keep: {keep}  # of the tool: pose, axis or position
  # Each leg is a displacement of the tool point in W. Put your own here.
  legs:
    - {{by: {by}, seconds: {seconds}}}
  speed_profile: {{kind: jerk_limited, ramp: 0.25}}
  via_points: 12

# Boxes, cylinders, capsules, spheres and meshes, such as
#   - {{name: table, box: [1.0, 1.0, 0.05], xyz: [0.5, 0, -0.2]}}
obstacles: []

guardrail: {guardrail}
planner: {planner}
"""
_LIMITS = """\
# Joint limits that a URDF does not have, deg/s2 and deg/s3. These are assumed: an acceleration of 2 /s times
# the velocity limit, a jerk of 10 /s times the acceleration. Put those of your robot's data sheet here.
format: cmbot-joint-limits/1
joints:
{joints}"""


def scene_text(
    *,
    name: str,
    schema: str,
    robot: Mapping[str, tuple[object, str]],
    on_guardrail: bool,
    posture_deg: Sequence[float],
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
    posture_deg : sequence of float
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
        posture=_flow([round(angle, 4) for angle in posture_deg]),
        point="({:.4f}, {:.4f}, {:.4f})".format(*tool_point),
        keep=keep,
        by=_flow(list(by)),
        seconds=f"{seconds:g}",
        guardrail="{}  # the default one" if on_guardrail else "{bays: 0}  # none: a rigid base",
        planner=planner,
    )


def limits_text(joints: Sequence[str], acceleration_deg: FloatArray, jerk_deg: FloatArray) -> str:
    """Return the text of a joint-limits file; limits (n,), deg/s2 and deg/s3."""
    entries = (
        f"  {_flow(name)}: {{acceleration_deg: {acceleration:.6g}, jerk_deg: {jerk:.6g}}}\n"
        for name, acceleration, jerk in zip(joints, acceleration_deg, jerk_deg, strict=True)
    )
    return _LIMITS.format(joints="".join(entries))


def _flow(value: object) -> str:
    """A value as YAML on one line: JSON, without the quotes of plain words."""
    text = json.dumps(value, ensure_ascii=False)
    plain = isinstance(value, str) and _PLAIN.fullmatch(value) and value.lower() not in _WORDS
    return str(value) if plain else text


_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./\-]*")
# Words that YAML may take for something else.
_WORDS = ("null", "true", "false", "yes", "no", "on", "off", "y", "n", "inf", "nan")
