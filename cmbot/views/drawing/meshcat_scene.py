"""A plan's static picture as commands to meshcat's viewer: the robot, the bridge, the tool path.

The commands follow meshcat's Readme. meshcat's Python package is not imported: it imports its server, its
geometries have neither normals nor 16-bit arrays, and its identifiers contain the computer's network address.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import umsgpack
from numpy.typing import NDArray

from cmbot.collision import Obstacle
from cmbot.common.arrays import FloatArray
from cmbot.planning import Plan
from cmbot.robot import Robot
from cmbot.scene import Scene
from cmbot.views.drawing.support import pole_of, supports
from cmbot.views.drawing.surfaces import (
    Surface,
    creased,
    merged,
    obstacle_surface,
    simplified,
    sliced,
    tube,
    visual_surface,
)

MOST_ROBOT_FACES = 24_000
MOST_OBSTACLE_FACES = 12_000
"""With these, and `MOST_POSES` of `replay_data`, a page stays below 5 MB, but for meshes of loose parts."""

SHORTEST_REACH = 0.05  # m
WAY_SECTIONS = 8  # of the tube along a foot's way, which has many points
RAIL_PIECE = 0.15  # between two cross-sections of a rail, m
CREASE = np.deg2rad(35.0)  # edges with a larger angle are shaded as sharp

CONCRETE, STEEL, WORKPIECE, PATH = 0xC2BDB3, 0x7D8C99, 0x2F9E8F, 0x7B2CBF
PALE, WOOD = 0xB9C3CB, 0xCFC4B2  # what is drawn only
LEFT_OUT = 0xD62828  # rows of rasters that are not reached
SHINE = 0x303030
# The largest luminance of a part of the robot, and the shares of red, green and blue in it (ITU-R BT.709).
_LIGHTEST, _LUMINANCE = 0.78, np.array([0.2126, 0.7152, 0.0722])
DOUBLE_SIDE = 2  # three.js: draw the back faces too

# The viewer's MessagePack codes for typed arrays.
_TYPED_ARRAYS = {
    "float32": ("Float32Array", 0x17),
    "int16": ("Int16Array", 0x13),
    "uint16": ("Uint16Array", 0x14),
    "uint32": ("Uint32Array", 0x16),
}

Command = dict[str, Any]

_PLAIN: list[Command] = [
    {"type": "set_property", "path": f"/{hidden}", "property": "visible", "value": False}
    for hidden in ("Grid", "Axes", "Lights")
]


def scene_commands(plan: Plan) -> list[Command]:
    """Return commands to meshcat's viewer.

    The shapes of joint i (pinocchio's index; 0: the fixed base) are below ``/robot/i``, in the joint's frame;
    ``/rails``, which a pole may be, ``/bridge``, ``/path`` and ``/left_out`` are in W. No name from a file is
    used.
    """
    drawn = (*_robot(_shapes(plan.robot), str(plan.robot.urdf)), *_supports(plan.scene, "/rails"))
    return [*_PLAIN, *drawn, *obstacle_commands(plan.scene), *path_commands(plan)]


def obstacle_commands(scene: Scene) -> list[Command]:
    """Return commands for the obstacles that do not bend with the foot: below ``/bridge``."""
    groups: dict[int, list[Surface]] = {}
    for obstacle, surface in surroundings(scene):
        groups.setdefault(WORKPIECE if obstacle.workpiece else CONCRETE, []).append(surface)
    each = enumerate(groups.items())
    return [_set_mesh(f"/bridge/{k}", group, colour, shininess=10) for k, (colour, group) in each]


def path_commands(plan: Plan, above: str = "") -> list[Command]:
    """Return commands for the tool's paths and rows that are not reached: ``/path``, ``/left_out``."""
    thick = 0.002 * reach(plan.robot)
    drawn = {"path": (plan.outlines, PATH), "left_out": (plan.rows_left_out, LEFT_OUT)}
    return [
        _set_mesh(f"{above}/{name}", [tube(points, thick) for points in lines], colour)
        for name, (lines, colour) in drawn.items()
        if lines
    ]


def carrier_commands(plan: Plan, key: str) -> list[Command]:
    """Return commands for what carries a further plan's arm, in W: below ``/others/key``.

    ``base`` is the fixed part of the robot, ``rails`` what that stands on.
    """
    fixed = [shape for shape in _shapes(plan.robot) if not shape.parentJoint]
    base = list(_robot(fixed, str(plan.robot.urdf)))
    for number, command in enumerate(base):
        command["path"] = f"/others/{key}/base/{number}"
    return [*base, *_supports(plan.scene, f"/others/{key}/rails")]


def bridge_commands(parts: Sequence[Obstacle]) -> list[Command]:
    """Return commands for what is drawn only, by `bridge_of`, paler than obstacles: ``/around``."""
    sleepers = [part for part in parts if part.name.startswith("sleeper")]
    steel = [part for part in parts if part not in sleepers]
    drawn = {"/around/steel": (steel, PALE), "/around/wood": (sleepers, WOOD)}
    return [
        _set_mesh(path, [obstacle_surface(part) for part in each], colour, shininess=10)
        for path, (each, colour) in drawn.items()
        if each
    ]


def moving_robot_commands(
    visual: Any, urdf: str, scene: Scene, ways: Sequence[FloatArray], length: float
) -> list[Command]:
    """Return commands as `scene_commands` does, of a robot none of whose links is fixed.

    Parameters
    ----------
    visual
        Pinocchio's model of its shapes.
    urdf : str
        Its file.
    scene : Scene
        Its surroundings.
    ways : sequence of (N, 3) arrays, m
        Drawn as tubes, in W.
    length : float, m
        To which the tubes' thickness is scaled.
    """
    tubes = [tube(way, 0.002 * length, sections=WAY_SECTIONS) for way in ways]
    drawn = (*_robot(list(visual.geometryObjects), urdf), *_supports(scene, "/rails"))
    return [*_PLAIN, *drawn, *obstacle_commands(scene), _set_mesh("/path", tubes, PATH)]


def encoded(commands: Iterable[Command]) -> list[str]:
    """Return commands for `MeshCat.Viewer.handle_command_bytearray`: packed, in base64."""
    return [base64.b64encode(umsgpack.packb(command)).decode("ascii") for command in commands]


def reach(robot: Robot) -> float:
    """Return the length of the stretched arm, m, to which markers are scaled."""
    return max(robot.reach, SHORTEST_REACH)


def _shapes(robot: Robot) -> list[Any]:
    """The visual shapes; a robot without any is drawn with its collision shapes."""
    return list(robot.visual_model.geometryObjects) or list(robot.collision_model.geometryObjects)


def _robot(shapes: Sequence[Any], urdf: str) -> Iterator[Command]:
    surfaces = simplified([visual_surface(shape, urdf) for shape in shapes], MOST_ROBOT_FACES)
    groups: dict[tuple[int, tuple[float, ...]], list[Surface]] = {}
    for shape, surface in zip(shapes, surfaces, strict=True):
        groups.setdefault((int(shape.parentJoint), tuple(shape.meshColor)), []).append(surface)
    for number, ((joint, rgba), group) in enumerate(groups.items()):
        yield _set_mesh(
            f"/robot/{joint}/{number}", group, _colour(rgba), opacity=float(rgba[3]), shininess=60
        )


def _colour(rgba: Sequence[float]) -> int:
    """A colour of a URDF as 0xRRGGBB. In white and light grey no shade would be seen: they are darkened."""
    value = np.clip(rgba[:3], 0, 1)
    value = value * min(1.0, _LIGHTEST / max(float(value @ _LUMINANCE), _LIGHTEST))
    red, green, blue = (round(255 * float(each)) for each in value)
    return (red << 16) + (green << 8) + blue


@lru_cache(maxsize=2)
def surroundings(scene: Scene) -> tuple[tuple[Obstacle, Surface], ...]:
    """Return the obstacles that do not bend with the foot, as they are drawn: simplified, in W."""
    bending = supports(scene)
    others = [obstacle for obstacle in scene.all_obstacles if not any(obstacle is each for each in bending)]
    surfaces = simplified([obstacle_surface(obstacle) for obstacle in others], MOST_OBSTACLE_FACES)
    return tuple(zip(others, surfaces, strict=True))


def _supports(scene: Scene, path: str) -> Iterator[Command]:
    """What the foot is on. It has vertices along it, to be bent."""
    bars = [obstacle_surface(obstacle, RAIL_PIECE) for obstacle in supports(scene)]
    pole = pole_of(scene)
    if pole is not None and pole.mesh:
        start, end = pole.beams[0]
        along = (end - start) / np.linalg.norm(end - start)
        bars = [sliced(bar, along, RAIL_PIECE) for bar in simplified(bars, MOST_OBSTACLE_FACES)]
    if bars:
        yield _set_mesh(path, bars, STEEL, shininess=10)


def _set_mesh(
    path: str, surfaces: list[Surface], colour: int, *, opacity: float = 1.0, shininess: float = 30.0
) -> Command:
    """Return the command for a three.js object: one geometry, one material, no transform."""
    surface, normals = creased(merged(surfaces), CREASE)
    attributes = {
        "position": _packed(surface.vertices.astype(np.float32), 3),
        "normal": _packed(np.round(32767 * normals).astype(np.int16), 3, normalized=True),
    }
    material = {
        "uuid": f"{path} material",
        "type": "MeshPhongMaterial",
        "color": colour,
        "specular": SHINE,
        "shininess": shininess,
        "side": DOUBLE_SIDE,
        "transparent": opacity < 1,
        "opacity": opacity,
    }
    number = np.uint16 if len(surface.vertices) <= np.iinfo(np.uint16).max else np.uint32
    data = {"attributes": attributes, "index": _packed(surface.faces.astype(number), 1)}
    geometry = {"uuid": f"{path} geometry", "type": "BufferGeometry", "data": data}
    parts = {"geometry": geometry["uuid"], "material": material["uuid"]}
    lowered = {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [geometry],
        "materials": [material],
        "object": {"uuid": f"{path} object", "type": "Mesh", **parts},
    }
    return {"type": "set_object", "path": path, "object": lowered}


def _packed(array: NDArray[Any], item_size: int, *, normalized: bool = False) -> dict[str, Any]:
    name, code = _TYPED_ARRAYS[array.dtype.name]
    packed = umsgpack.Ext(code, array.astype(array.dtype.newbyteorder("<")).tobytes())
    return {"itemSize": item_size, "type": name, "array": packed, "normalized": normalized}
