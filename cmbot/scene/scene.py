"""The scene: the planning problem and its surroundings, as data and as a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from cmbot.common.arrays import FloatArray
from cmbot.common.representation import card
from cmbot.common.validation import (
    FileModel,
    check_fields,
    counted,
    refusal,
    require_type,
    shown,
)
from cmbot.elastic import Guardrail
from cmbot.hold import Foot
from cmbot.scene.base.guardrail import GuardrailFile, feet_of
from cmbot.scene.base.identified import IdentifiedStiffness
from cmbot.scene.excitation import DamperFile, ExcitationFile
from cmbot.scene.fields import (
    Posture,
    Slug,
)
from cmbot.scene.obstacles import Obstacle, ObstacleFile, pose
from cmbot.scene.options import PlannerOptions
from cmbot.scene.path.legs import Goal, Leg
from cmbot.scene.path.path_file import MOST_ORDERED, AxisCone, Keep, PathFile, StrokeFile, ToolPathFile
from cmbot.scene.path.path_source import PathSource, surface_of
from cmbot.scene.path.raster_parts import raster_parts, require_apart
from cmbot.scene.path.stroke import Stroke, timed_stroke
from cmbot.scene.path.time_law import LegLaw, SpeedProfile
from cmbot.scene.raster.pieces import RowPiece
from cmbot.scene.raster.raster import Raster
from cmbot.scene.robot_entry import BaseFile, Joints, MountFile, PostureFile, RobotFile, RobotSource
from cmbot.scene.tool import Tool
from cmbot.scene.uncertainty import Uncertainty

__all__ = [
    "FORMAT",
    "WORK",
    "BaseFile",
    "MountFile",
    "PostureFile",
    "RobotFile",
    "RobotSource",
    "Scene",
    "SceneFile",
]

Cells = Sequence[Sequence[RowPiece]]
"""Pieces of rows that follow on each other, of several strokes."""
FORMAT = "cmbot-scene/2"
WORK = "work"
"""Name of the stroke of a tool path without names."""


def _released(value: object) -> object:
    """Say of scenes of development versions how they become scenes of this one."""
    if value == "cmbot-scene/1":
        raise refusal(
            f"{FORMAT}: a development version wrote this file; tools/scene_2.py rewrites it", got=shown(value)
        )
    return value


class SceneFile(FileModel):
    """The robot, its start posture, the tool path and the surroundings; in m, s, kg and degrees."""

    model_config = ConfigDict(serialize_by_alias=True)

    format: Annotated[Literal["cmbot-scene/2"], BeforeValidator(_released)]
    name: Slug
    """Also the name of the folder that a plan is written to."""
    robot: RobotFile = RobotFile()
    base: BaseFile | None = None
    """What the robot stands on."""
    start: PostureFile | None = None
    """Where the arm is at the start; left out: stowed."""
    return_: Annotated[Literal["stow", "start", "none"] | None, Field(alias="return")] = None
    """Where the arm goes after the work; left out: nowhere. An arm whose SRDF has no group state ``stow`` is
    put away where it started."""
    tool: Tool | None = None
    """The process force and the largest speed while the tool is on."""
    uncertainty: Uncertainty | Literal["none"] | None = None
    """What is not known of arm, base and work, for the accuracy budget; ``none``: all is as modelled; left
    out: the defaults, which are assumptions."""
    frames: Annotated[dict[Slug, MountFile] | None, Field(max_length=100)] = None
    """Frames of workpieces by their names, in W."""
    tool_path: ToolPathFile
    obstacles: Annotated[tuple[ObstacleFile, ...], Field(max_length=1000)] = ()
    guardrail: GuardrailFile = GuardrailFile()
    identified: IdentifiedStiffness | None = None
    """The stiffness that ``cmbot identify`` found, or the path of its file; left out: as modelled. Stiffness
    and mass of its base take the place of the guardrail's."""
    excitation: ExcitationFile | None = None
    """What shakes the arm; ``cmbot excite`` says by how much."""
    damper: DamperFile | Literal["auto"] | None = None
    """A tuned damper against it; ``auto``: the best of 1 kg at the tool."""
    planner: PlannerOptions = PlannerOptions()

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in self.frames or ():
            if name in ("world", "tool"):
                raise refusal("a name that no frame has", got=name, key=("frames",))
        if self.guardrail.stance is not None and self.robot.model != "cmbot":
            expected = "no such key with a URDF of one's own, whose mount says where it stands"
            raise refusal(expected, got="stance", key=("guardrail", "stance"))
        if self.identified is not None:
            self._check_identified(self.identified)
        if self.base is not None and self.base.modes is not None:
            self._check_modes()
        measured = self.identified is not None and self.identified.base is not None
        if self.guardrail.mass is not None and self.guardrail.stiffness is None and not measured:
            expected = "no mass where no stiffness is given"
            raise refusal(expected, got="a mass alone", key=("guardrail", "mass"))
        taken = set(self.guardrail.member_names)
        for index, obstacle in enumerate(self.obstacles):
            if obstacle.name in taken:
                expected = "a name that no other obstacle or guardrail member has"
                raise refusal(expected, got=shown(obstacle.name), key=("obstacles", index, "name"))
            taken.add(obstacle.name)
        return self

    def _check_identified(self, identified: IdentifiedStiffness) -> None:
        if self.guardrail.stiffness is not None and identified.base is None:
            expected = "no such key beside identified, which has no base: it was measured on a rigid one"
            raise refusal(expected, got="stiffness", key=("guardrail", "stiffness"))
        if identified.joints and self.robot.joints == "rigid":
            raise refusal("elastic, as joints were identified", got="rigid", key=("robot", "joints"))

    def _check_modes(self) -> None:
        measured = self.identified is not None and self.identified.base is not None
        if self.guardrail.stiffness is not None or self.guardrail.mass is not None or measured:
            expected = "no such key beside a stiffness: one of them says how the base bends"
            raise refusal(expected, got="modes", key=("base", "modes"))

    def as_data(self) -> dict[str, Any]:
        """Return the file's content, every default filled in, as `cmbot.load_scene` takes it back."""
        return self.model_dump(mode="json", exclude_none=True, by_alias=True)

    @property
    def joints(self) -> Joints:
        """Whether the robot's joints give way."""
        return self.robot.joints or "elastic"

    @property
    def posture_key(self) -> str:
        """The key that has the posture, such as ``start.posture_deg``."""
        if self.start is None:
            return "start"
        (given,) = self.start.model_dump(exclude_none=True)
        return f"start.{given}"

    @property
    def posture(self) -> FloatArray | None:
        """The posture (n,) in SI, as if every joint turned where it is in degrees; None: stowed."""
        if self.start is None:
            return None
        if self.start.posture_deg is not None:
            return np.radians(self.start.posture_deg)
        return None if self.start.posture is None else np.array(self.start.posture, dtype=float)

    def with_posture(self, q: FloatArray, known: FloatArray) -> dict[str, Any]:
        """Return the entries with a posture `q` (n,), SI, in the units of the file's; its own if `known`."""
        if np.array_equal(known, q):
            return self.model_dump(mode="json", include={"start"}, exclude_none=True)
        if self.posture_key == "start.posture_deg":
            return {"start": {"posture_deg": np.degrees(q).tolist()}}
        return {"start": {"posture": q.tolist()}}


class _SceneFields(ToolPathFile):
    """The bounds of a `Scene`'s fields that hold text and numbers: those of the scene file."""

    model_config = ConfigDict(validate_by_name=True)

    posture: Posture
    return_to: Literal["stow", "start", "none"]
    planner: PlannerOptions


_TYPES: dict[str, tuple[type | tuple[type, ...], str]] = {
    "name": (str, "text"),
    "source": (str, "text"),
    "robot": (RobotSource, "a RobotSource"),
    "posture": (np.ndarray, "an array (n,), rad and m"),
    "tool": (Tool, "a Tool"),
    "keep": ((str, AxisCone), "pose, axis, position or an AxisCone"),
    "speed_profile": (SpeedProfile, "a SpeedProfile"),
    "guardrail": (Guardrail, "a Guardrail"),
    "planner": (PlannerOptions, "PlannerOptions"),
    "file": (SceneFile, "a SceneFile"),
    "content_hash": (str, "text"),
}
_ITEM_TYPES: dict[str, tuple[type, str]] = {"legs": (Leg, "a Leg"), "obstacles": (Obstacle, "an Obstacle")}


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A planning problem and its surroundings. Equal `content_hash` means the same scene.

    Attributes
    ----------
    name : str
        Usable as a folder's name.
    source : str
        Where it came from, for messages.
    robot : RobotSource
    posture : array
        (n,), joint positions at the start, rad, of joints that slide m; read-only.
    return_to : str
        Where the arm goes after the work: ``stow``, ``start`` or ``none``, nowhere.
    tool : Tool
        The process force and the largest speed while the tool is on.
    keep : str or AxisCone
        What the tool path prescribes of the tool: its ``pose``, ``axis`` or ``position``, or a cone.
    start_pose : Goal or None
        Where the tool path begins; None: at the pose of the tool in `posture`.
    legs : tuple of Leg
        From there.
    waypoints : tuple or None
        In place of legs points, m, and unit quaternions (w, x, y, z) of the tool in W, (K, 7).
    raster : Raster or None
        In place of legs rows over a surface.
    seconds : float, "auto" or None
        Duration of the path through waypoints or of the raster, s.
    speed_m_s : float or None
        Or the speed, m/s.
    max_base_torque_nm : float or None
        With ``auto``: the largest torque on the base, Nm.
    time_laws : tuple of LegLaw or None
        What planning found with ``auto``.
    speed_tolerance : float or None
        By what share the tool's speed may miss the process speed between the leads.
    lead_in_m, lead_out_m : float or None
        Lengths of the straight ways before and behind the path on which the tool speeds up and slows down.
    blend_radius_m : float or None
        By which the corners between straight legs are rounded.
    speed_profile : SpeedProfile
    passes : int or None
        How often the path is followed, to and fro.
    via_points : int or "auto"
        In all, with the ends of the legs.
    strokes : tuple of StrokeFile or None
        In place of all from `keep` to here: several paths with the tool on.
    order : str or None
        Of the strokes: ``given`` or None, or ``best``.
    obstacles : tuple of Obstacle
        The scene's own, then the members of the guardrail.
    guardrail : Guardrail
    planner : PlannerOptions
    file : SceneFile
        The file's content as it was read, with every default filled in; paths as written there. What Python
        changes in the other fields is in the file that `cmbot.save` writes.
    content_hash : str
        SHA-256 (hexadecimal) of that content and of the mesh files' bytes.

    Raises
    ------
    InputError
        When a field is of another type or out of the bounds of the scene file, as in
        ``dataclasses.replace(scene, via_points=30.5)``.
    """

    name: str
    source: str
    robot: RobotSource
    posture: FloatArray
    return_to: Literal["stow", "start", "none"]
    tool: Tool
    keep: Keep = "pose"
    start_pose: Goal | None = None
    legs: tuple[Leg, ...] = ()
    waypoints: tuple[tuple[float, ...], ...] | None = None
    raster: Raster | None = None
    seconds: float | Literal["auto"] | None = None
    speed_m_s: float | None = None
    max_base_torque_nm: float | None = None
    time_laws: tuple[LegLaw, ...] | None = None
    speed_tolerance: float | None = None
    lead_in_m: float | None = None
    lead_out_m: float | None = None
    blend_radius_m: float | None = None
    speed_profile: SpeedProfile = field(default_factory=SpeedProfile)
    passes: int | None = None
    via_points: int | Literal["auto"] = 50
    strokes: tuple[StrokeFile, ...] | None = None
    order: Literal["given", "best"] | None = None
    obstacles: tuple[Obstacle, ...]
    guardrail: Guardrail
    planner: PlannerOptions
    file: SceneFile
    content_hash: str

    def __repr__(self) -> str:
        return f"<Scene {self.name}: {self._in_words}>"

    def _repr_html_(self) -> str:
        """Card in a notebook."""
        rows = [(f"stroke {stroke.name}", f"keeps the tool's {stroke.keep}") for stroke in self.each_stroke]
        rows.append(("stands on", self.base_name))
        rows.append(("obstacles", ", ".join(obstacle.name for obstacle in self.obstacles) or "none"))
        back = "stays" if self.return_to == "none" else f"returns to {self.return_to}"
        rows.append(("after the work", back))
        return card(f"Scene {self.name}", self._in_words, rows)

    @property
    def _in_words(self) -> str:
        strokes, obstacles = len(self.each_stroke), len(self.obstacles)
        return f"{self.robot.model}, {counted(strokes, 'stroke')}, {counted(obstacles, 'obstacle')}"

    @property
    def each_stroke(self) -> tuple[StrokeFile, ...]:
        """What describes each stroke: one without a name of its own is the ``work``."""
        if self.strokes is not None:
            return self.strokes
        own = {name: getattr(self, name) for name in PathFile.model_fields}
        return (StrokeFile.model_construct(name=WORK, **own),)

    @property
    def begins_elsewhere(self) -> bool:
        """Whether the first stroke begins at a pose of its own, not at that of the tool in `posture`."""
        return self.each_stroke[0].has_start

    @property
    def pinned_posture(self) -> str:
        """What ``start: pinned`` starts in, in words."""
        return "posture nearest to the scene's" if self.begins_elsewhere else "scene's posture"

    def timed_strokes(self, X_WT: FloatArray) -> tuple[Stroke, ...]:
        """Return the strokes, from the pose (4, 4) of the tool in `posture`.

        Raises
        ------
        SceneError
            When one of their paths is none.
        """
        strokes = list[Stroke]()
        for k, file in enumerate(self.each_stroke):
            strokes.append(self._timed(k, file, X_WT))
            X_WT = strokes[-1].path.end_pose
        return tuple(strokes)

    def in_cells(self, X_WT: FloatArray) -> Self:
        """Return the scene with a stroke for each cell of the rows of a raster: see `with_cells`.

        Parameters
        ----------
        X_WT : (4, 4)
            Pose of the tool in `posture`.

        Raises
        ------
        SceneError
            When one of their paths is none.
        """
        cells, whole = dict[int, Cells](), dict[int, Sequence[RowPiece]]()
        for k, file in enumerate(self.each_stroke):
            surface = surface_of(file, self._path_source(k), X_WT)
            last = file
            if surface is not None and file.raster is not None and file.raster.pieces is None:
                own = surface.cells
                if len(own) > 1:
                    cells[k], whole[k] = own, surface.pieces
                    last = raster_parts(file, own, surface.pieces)[-1]
            if k + 1 < len(self.each_stroke):
                X_WT = self._timed(k, last, X_WT).path.end_pose
        return self.with_cells(cells, whole)

    def with_cells(self, cells: Mapping[int, Cells], whole: Mapping[int, Sequence[RowPiece]]) -> Self:
        """Return the scene with a stroke for each of some cells of rasters.

        Parameters
        ----------
        cells : mapping of int to sequence of sequences of RowPiece
            By the numbers of strokes.
        whole : mapping of int to sequence of RowPiece
            All rows of these strokes.

        Raises
        ------
        SceneError
            When such a raster is in the frame of the tool, or the stroke behind it begins where it ends.
        """
        if not cells:
            return self
        files, strokes = self.each_stroke, list[StrokeFile]()
        for k, file in enumerate(files):
            if k in cells:
                require_apart(files, k, self.source, self._stroke_key)
                taken = {str(each.name) for each in files}
                strokes += raster_parts(file, cells[k], whole[k], taken)
            else:
                strokes.append(file)
        if self.strokes is None and len(strokes) == 1:
            own = {name: getattr(strokes[0], name) for name in PathFile.model_fields}
            return replace(self, **own)
        return self.with_strokes(tuple(strokes))

    def with_strokes(self, strokes: tuple[StrokeFile, ...]) -> Self:
        """Return the scene with other strokes in place of its own, too many to be ordered as they are."""
        plain = {name: field.get_default() for name, field in PathFile.model_fields.items()}
        order = self.order if len(strokes) <= MOST_ORDERED else None
        return replace(self, **plain, strokes=strokes, order=order)

    def _stroke_key(self, number: int) -> str:
        """The key in the file of a stroke: strokes that are parts of one raster have its key."""
        if self.strokes is None:
            return "tool_path"
        stroke, path = self.strokes[number], self.file.tool_path
        in_file = {each.name: k for k, each in enumerate(path.strokes or ())}
        if not in_file and stroke.part_of == WORK:
            return "tool_path"
        own = stroke.name if stroke.name in in_file else stroke.part_of
        return f"tool_path.strokes[{in_file.get(own, number)}]"

    def _path_source(self, number: int) -> PathSource:
        return PathSource(
            source=self.source,
            key=self._stroke_key(number),
            frames=self.frames,
            obstacles=self.obstacles,
            max_speed=self.tool.max_speed_m_s,
        )

    def _timed(self, number: int, file: StrokeFile, X_WT: FloatArray) -> Stroke:
        """A stroke, from the pose (4, 4) of the tool before."""
        return timed_stroke(
            file,
            self._path_source(number),
            X_WT,
            begins_elsewhere=file.has_start or number > 0,
            deviation=self.planner.max_tool_deviation_m,
        )

    @cached_property
    def frames(self) -> dict[str, FloatArray]:
        """Poses (4, 4) in W of the frames that its file names."""
        each = self.file.frames or {}
        return {name: pose(frame.xyz, np.radians(frame.rpy_deg)) for name, frame in each.items()}

    @property
    def excitation(self) -> ExcitationFile | None:
        """What shakes the arm."""
        return self.file.excitation

    @property
    def damper(self) -> DamperFile | None:
        """The tuned damper against it."""
        return DamperFile() if self.file.damper == "auto" else self.file.damper

    @property
    def uncertainty(self) -> Uncertainty:
        """What is not known of arm, base and work."""
        given = self.file.uncertainty
        return Uncertainty.none() if given == "none" else given or Uncertainty()

    @property
    def base_name(self) -> str:
        """What messages and pages call that on which the robot stands."""
        if self.file.base is not None:
            return self.file.base.name
        return "guardrail" if self.on_guardrail else "base"

    @cached_property
    def feet(self) -> tuple[Foot, ...]:
        """The feet that hold the guardrail; none of a robot that stands on something else."""
        holds = self.on_guardrail or self.file.guardrail.hold is not None
        return feet_of(self.file.guardrail) if holds else ()

    @property
    def on_guardrail(self) -> bool:
        """Whether its robot is the shipped one, which holds a guardrail."""
        return self.robot.model == "cmbot"

    def __post_init__(self) -> None:
        for name, (kind, expected) in _TYPES.items():
            require_type(getattr(self, name), kind, "Scene", name, expected)
        for name, (kind, expected) in _ITEM_TYPES.items():
            require_type(getattr(self, name), (tuple, list), "Scene", name, f"a tuple, {expected} each")
            for k, item in enumerate(getattr(self, name)):
                require_type(item, kind, "Scene", f"{name}[{k}]", expected)
        check_fields(self, _SceneFields)
