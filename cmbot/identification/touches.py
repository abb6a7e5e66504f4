"""What the tool touched: places on known features of the workpiece, in a file that names them.

A file of touches::

    format: cmbot-touches/1
    scene: bracket_faces               # robot and base, by name or relative to this file
    locates: bracket                   # a frame of the scene; left out: its only one, or W
    touches:                           # features in the coordinates of that frame, m
      - {posture_deg: [...], point: [0.1, 0.2, 0.0]}
      - {posture_deg: [...], plane: {point: [0, 0, 0], normal: [0, 0, 1]}}
      - {place: [1.82, 0.31, -2.05], edge: {point: [0, 0, 0], direction: [1, 0, 0]}}    # a tracker's, in W

The same as CSV, a row a touch: columns ``x,y,z`` or ``q1_deg,q2_deg,...``, then ``px,py,pz`` of a point on
the feature, and of planes ``nx,ny,nz``, of edges ``ex,ey,ez``, of cylinders these and ``radius``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import ConfigDict, Field

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, SceneError
from cmbot.common.reading.fields import Posture, Site, Text, Vector, given_of
from cmbot.common.reading.text_table import read_table
from cmbot.common.reading.validation import FileModel, given_path, refusal, shown, validated
from cmbot.common.reading.yaml_reader import lines_named, read_yaml
from cmbot.common.representation import ShortRepr
from cmbot.elastic.sag import Sag
from cmbot.identification.measurements import posture_of, scene_named
from cmbot.planning import bending_arm, robot_of
from cmbot.robot import Kinematics
from cmbot.scene import Placement, Scene, load_scene

_MAX_TOUCHES, _LARGEST_CSV = 1000, 1_000_000
_Shape = Literal["point", "plane", "edge", "cylinder"]
_TOUCH_SHAPES = get_args(_Shape)
_TOUCH_KEY = re.compile(r"touches\[(\d+)\](.*)")
_PLACE_KEYS = ("posture_deg", "posture", "place")


class PlaneFile(FileModel):
    """A plane; the tool touches it from where its normal points."""

    point: Site
    normal: Vector


class EdgeFile(FileModel):
    """A straight edge."""

    point: Site
    direction: Vector


class CylinderFile(EdgeFile):
    """A cylinder, touched from outside."""

    radius_m: Annotated[float, Field(gt=0, le=100)]


class TouchSetup(FileModel):
    """How exact touches are, and the place before."""

    touch_sd_mm: Annotated[float, Field(gt=0, le=100)] = 0.3
    """Standard deviation of a touched place along each axis: reading, calibration of the arm, operator."""
    tip_radius_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """Of the ball that touches planes and cylinders; the tool point is its centre."""
    prior: Placement = Placement(mm=20.0, deg=2.0)
    """How exactly the place was known before."""


class TouchFile(FileModel):
    """One touch: where the tool was, and what it touched."""

    posture_deg: Posture | None = None
    posture: Posture | None = None
    """In rad and, of joints that slide, m."""
    place: Site | None = None
    """Of the tool point in W, m, as a tracker gives it."""
    point: Site | None = None
    plane: PlaneFile | None = None
    edge: EdgeFile | None = None
    cylinder: CylinderFile | None = None

    def _check(self) -> None:
        for names in (_PLACE_KEYS, _TOUCH_SHAPES):
            given = given_of(self, names)
            if len(given) != 1:
                raise refusal(f"exactly one of {', '.join(names)}", got=" and ".join(given) or "none")


class TouchesFile(TouchSetup):
    """All touches of one workpiece."""

    model_config = ConfigDict(title="cmbot-touches/1")

    format: Literal["cmbot-touches/1"]
    scene: Text
    """A scene file, or the name of a shipped scene: robot, base, and where the frame was thought to be."""
    locates: Text | None = None
    """The frame of the scene that is to be located; left out: its only one, or W."""
    touches: Annotated[tuple[TouchFile, ...], Field(min_length=1, max_length=_MAX_TOUCHES)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Feature:
    """A point, or a line through it along `axis`, or the plane across that.

    Attributes
    ----------
    kind : str
        ``point``, ``plane``, ``edge`` or ``cylinder``.
    point, axis : (3,)
        In the located frame, m; of a point the axis counts for nothing.
    radius : float, m
        Of a cylinder.
    """

    kind: _Shape
    point: FloatArray
    axis: FloatArray
    radius: float = 0.0

    def residual(self, place: FloatArray, tip: float) -> FloatArray:
        """How far touched places (..., 3) are from it, m: (..., 3) of a point, (..., 2) of an edge, or 1."""
        away = place - self.point
        if self.kind == "point":
            return away
        along = (away @ self.axis)[..., None]
        if self.kind == "plane":
            return np.asarray(along - tip)
        if self.kind == "cylinder":
            across = np.linalg.norm(away - along * self.axis, axis=-1, keepdims=True)
            return np.asarray(across - self.radius - tip)
        return np.asarray(away @ np.linalg.svd(self.axis[None])[2][1:].T)


@dataclass(frozen=True, kw_only=True, eq=False)
class Touches(ShortRepr):
    """What was touched, in SI.

    Attributes
    ----------
    source : str
        Where it came from, for messages.
    scene : Scene
    setup : TouchSetup
    frame : str
        Name of the located frame; ``world`` where the scene has none.
    X_WF : (4, 4)
        Where it was thought to be.
    places : (N, 3), m
        Of the tool point in W: of postures that of the bent arm.
    features : tuple of Feature
    rows : tuple of str
        What each is called in messages; empty: ``touches[k]``.
    """

    source: str
    scene: Scene
    setup: TouchSetup
    frame: str
    X_WF: FloatArray
    places: FloatArray
    features: tuple[Feature, ...]
    rows: tuple[str, ...] = ()

    def key(self, number: int) -> str:
        """Return what a touch is called in messages."""
        return self.rows[number] if self.rows else f"touches[{number}]"


def read_touches(source: str | Path | Mapping[str, Any], scene: Scene | str | Path | None = None) -> Touches:
    """Read and check touches.

    Parameters
    ----------
    source : str, Path or mapping
        Path of the file, YAML or CSV, or its content, in which relative paths start at the current folder.
    scene : Scene, str or Path, optional
        In place of the file's; of a CSV file, which names none, it is needed.

    Raises
    ------
    InputError
        When a key or value is wrong; or as `cmbot.load_scene`.
    """
    if isinstance(source, Mapping):
        name = "touches"
        file = validated(TouchesFile, dict(source), name, InputError)
        return _touches(file, Path.cwd(), name, scene)
    path = given_path(source, "cmbot.locate", "source", "the path of a file of touches, or its content")
    if path.suffix.lower() == ".csv":
        if scene is None:
            expected = "--scene SCENE (in Python scene=…), as a CSV file of touches names none"
            raise InputError(str(path), "", "no scene", expected)
        return _from_csv(path, scene)
    with lines_named(path):
        data = read_yaml(path, InputError, "a file of touches")
        file = validated(TouchesFile, data, str(path), InputError)
        return _touches(file, path.parent, str(path), scene)


def _from_csv(path: Path, scene: Scene | str | Path) -> Touches:
    """The touches of a CSV file, whose columns are known by their names; errors name its lines."""
    table = read_table(path, InputError, kind="a CSV file of touches", largest=_LARGEST_CSV)
    joints = [k for k, name in enumerate(table.names) if name.startswith("q")]
    place = table.columns("xyz")
    point, normal, edge = (table.columns(f"{letter}{axis}" for axis in "xyz") for letter in "pne")
    if not (place or joints) or not point:
        expected = "the columns x,y,z or q1_deg,q2_deg,..., then px,py,pz, and nx,ny,nz or ex,ey,ez"
        raise InputError(str(path), "line 1", shown(",".join(table.names)), expected)

    def given(numbers: FloatArray) -> list[Any]:
        """The numbers of each row that has all of them; of the others nothing."""
        return [row.tolist() if len(row) and np.isfinite(row).all() else None for row in numbers]

    def lengths(columns: Sequence[int]) -> list[Any]:
        return given(table.lengths(columns, "m", gaps=True))

    key, places = "place", lengths(place)
    if not place:
        key = "posture_deg" if table.names[joints[0]].endswith("_deg") else "posture"
        places = given(table.numbers(joints, gaps=True))
    axes = (given(table.numbers(columns, gaps=True)) for columns in (normal, edge))
    each = zip(places, lengths(point), *axes, lengths(table.columns(["radius"])), strict=True)
    touches = list[dict[str, Any]]()
    for at, p, n, e, radius in each:
        shape: dict[str, Any] = {"point": p}
        if n:
            shape = {"plane": {"point": p, "normal": n}}
        elif e and radius:
            shape = {"cylinder": {"point": p, "direction": e, "radius_m": radius[0]}}
        elif e:
            shape = {"edge": {"point": p, "direction": e}}
        touches.append({key: at, **shape})
    data = {"format": "cmbot-touches/1", "scene": "given", "touches": touches}
    rows = tuple(f"line {line}" for line in table.lines)
    try:
        file = validated(TouchesFile, data, str(path), InputError)
        return replace(_touches(file, path.parent, str(path), scene), rows=rows)
    except InputError as error:
        at = _TOUCH_KEY.match(error.key)
        if at is None or error.source != str(path):
            raise
        key = rows[int(at[1])] + at[2].replace(".", ", ")
        raise InputError(error.source, key, error.got, error.expected, error.choices) from error


def _touches(file: TouchesFile, folder: Path, source: str, given: Scene | str | Path | None) -> Touches:
    if isinstance(given, Scene):
        scene = given
    elif given is not None:
        scene = load_scene(given)
    else:
        scene = scene_named(file.scene, folder, source)
    if scene.tool.fixed is not None:
        expected = "a tool that the arm holds: what it touches says where that work is"
        raise SceneError(scene.source, "tool.fixed", "a fixed tool", expected)
    name, frames = file.locates or frame_of(scene)[0], scene.frame_poses
    if name not in {"world", *frames}:
        raise InputError(source, "locates", name, "a frame of the scene, or world", tuple(frames))
    return Touches(
        source=source,
        scene=scene,
        setup=file,
        frame=name,
        X_WF=np.eye(4) if name == "world" else frames[name],
        places=_places(file, scene, source),
        features=tuple(_feature(touch, source, k) for k, touch in enumerate(file.touches)),
    )


def frame_of(scene: Scene) -> tuple[str, FloatArray]:
    """Return the frame that is located where none is named: the scene's only one, or W, and its pose."""
    frames = scene.frame_poses
    return next(iter(frames.items())) if len(frames) == 1 else ("world", np.eye(4))


def _places(file: TouchesFile, scene: Scene, source: str) -> FloatArray:
    """Places (N, 3) of the tool point in W; in postures that of the bent arm."""
    robot = robot_of(scene).tool_off
    places, at, postures = np.empty((len(file.touches), 3)), list[int](), list[FloatArray]()
    for k, touch in enumerate(file.touches):
        if touch.place is not None:
            places[k] = touch.place
            continue
        at.append(k)
        key = f"touches[{k}].posture"
        postures.append(posture_of(touch.posture_deg, touch.posture, robot, source, key))
    if at:
        q, arm = np.array(postures), bending_arm(scene, robot)
        sag = np.zeros((len(q), 3)) if arm is None else Sag(arm).at(q).tool
        places[at] = Kinematics(robot).tool_poses(q)[0] + sag
    return places


def _feature(touch: TouchFile, source: str, number: int) -> Feature:
    """What was touched, with the axis that it is about."""
    if touch.point is not None:
        return Feature(kind="point", point=np.array(touch.point), axis=np.zeros(3))
    shapes: dict[_Shape, PlaneFile | EdgeFile | None] = {"plane": touch.plane, "edge": touch.edge}
    shapes["cylinder"] = touch.cylinder
    for kind, entry in shapes.items():
        if entry is not None:
            name = "normal" if isinstance(entry, PlaneFile) else "direction"
            axis = _unit(getattr(entry, name), source, f"touches[{number}].{kind}.{name}")
            radius = entry.radius_m if isinstance(entry, CylinderFile) else 0.0
            return Feature(kind=kind, point=np.array(entry.point), axis=axis, radius=radius)
    raise InputError(source, f"touches[{number}]", "no feature", "one", _TOUCH_SHAPES)


def _unit(direction: Vector, source: str, key: str) -> FloatArray:
    length = float(np.linalg.norm(direction))
    if length == 0:
        raise InputError(source, key, "a vector of length 0", "another direction")
    return np.array(direction) / length
