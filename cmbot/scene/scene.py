"""The scene: the planning problem and its surroundings, as its file says it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import fields, replace
from hashlib import sha256
from json import dumps
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
)

from cmbot.collision import Obstacle
from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.errors import InputError, SceneError
from cmbot.common.poses import pose
from cmbot.common.reading.fields import FOLDER, Slug, mapping_of
from cmbot.common.reading.validation import FileModel, counted, hint, refusal, require_type, shown, validated
from cmbot.common.representation import card
from cmbot.elastic import Guardrail
from cmbot.hold import Foot
from cmbot.scene.base.guardrail import GuardrailFile, elastic_guardrail, feet_of, guardrail_obstacles
from cmbot.scene.base.hold import HoldFile
from cmbot.scene.base.identified import IdentifiedStiffness
from cmbot.scene.base.mounts import MountsFile
from cmbot.scene.base.stance import FootholdFile, Stance, StanceFile, resolved_stance, swept_foot
from cmbot.scene.changes import changed_content, numbers_in
from cmbot.scene.excitation import DamperFile, ExcitationFile
from cmbot.scene.files import file_hashes, with_paths
from cmbot.scene.obstacles import ObstacleFile, obstacle_from_file
from cmbot.scene.options import PlannerOptions
from cmbot.scene.path.path_file import MOST_ORDERED, WORK, JobStrokes, Order, StrokeFile, ToolPathEntry
from cmbot.scene.path.stroke import Stroke, timed_stroke
from cmbot.scene.path.stroke_parts import path_parts, raster_parts, require_apart
from cmbot.scene.path.surface import surface_of
from cmbot.scene.robot_entry import (
    STOW,
    BaseFile,
    Joints,
    MountFile,
    PostureFile,
    ReturnTo,
    RobotFile,
    named_posture,
)
from cmbot.scene.tool import Tool
from cmbot.scene.uncertainty import Uncertainty, UncertaintyOrNone
from cmbot.toolpath import PathSource, RowPiece

Cells = Sequence[Sequence[RowPiece]]
"""Pieces of rows that follow on each other, of several strokes."""
FORMAT = "cmbot-scene/2"
# Feet hold where they did when the stiffness was measured, m.
_FOOTHOLD_TOLERANCE_M = 0.01
_RESERVED_FRAMES = ("world", "tool")


def _released(value: object) -> object:
    """Say of scenes of development versions how they become scenes of this one."""
    if value == "cmbot-scene/1":
        raise refusal(
            f"{FORMAT}: a development version wrote this file; tools/scene_2.py rewrites it", got=shown(value)
        )
    return value


def _own_names(frames: tuple[tuple[str, MountFile], ...]) -> tuple[tuple[str, MountFile], ...]:
    for name, _ in frames:
        if name in _RESERVED_FRAMES:
            raise refusal("a name that no frame has", got=name)
    return frames


_Frames = Annotated[
    tuple[tuple[str, MountFile], ...], mapping_of(Slug, MountFile), AfterValidator(_own_names)
]


class Scene(FileModel):
    """The robot, its start posture, the tool path and the surroundings; in m, s, kg and degrees.

    Attributes
    ----------
    source : str
        Where it came from, for messages; what it says is the same wherever that is.
    strokes : tuple of StrokeFile
        One or more.
    posture : array
        (n,), joint positions at the start, rad, of joints that slide m; read-only.
    all_obstacles : tuple of Obstacle
        In SI units, the guardrail's members among them.
    content_hash : str
        Equal for scenes that say the same with the same files.

    Notes
    -----
    It holds what its file says; its fields have the keys of the file. `changed`, and what begins with
    ``with_``, returns the scene of the edited file, which is checked as a whole.
    """

    model_config = ConfigDict(serialize_by_alias=True, protected_namespaces=())

    format: Annotated[Literal["cmbot-scene/2"], BeforeValidator(_released)]
    name: Slug
    """Also the name of the folder that a plan is written to."""
    robot: RobotFile = RobotFile()
    mounts: Annotated[tuple[MountsFile, ...], Field(max_length=100)] = ()
    """Of another robot than the shipped one: where its base frame may be held; ``cmbot stand`` chooses."""
    base: BaseFile | None = None
    """What the robot stands on."""
    start: PostureFile | None = None
    """Where the arm is at the start; left out: stowed."""
    return_to: Annotated[ReturnTo, Field(alias="return")] = "none"
    """Where the arm goes after the work, as ``stow`` or ``{state: home}``; left out: nowhere. An arm whose
    SRDF has no group state ``stow`` is put away where it started."""
    tool: Tool = Tool()
    """The process force and the largest speed while the tool is on."""
    uncertainty: UncertaintyOrNone = Uncertainty()
    """What is not known of arm, base and work, for the accuracy budget; ``none``: all is as modelled; left
    out: the defaults, which are assumptions."""
    frames: Annotated[_Frames, Field(json_schema_extra={"default": {}})] = ()
    """Frames of workpieces by their names, in W."""
    tool_path: ToolPathEntry
    obstacles: Annotated[tuple[ObstacleFile, ...], Field(max_length=1000)] = ()
    guardrail: GuardrailFile = GuardrailFile()
    identified: IdentifiedStiffness | None = None
    """The stiffness that ``cmbot identify`` found, or the path of its file; left out: as modelled. Stiffness
    and mass of its base take the place of the guardrail's."""
    excitation: ExcitationFile | None = None
    """What shakes the arm; ``cmbot excite`` says by how much."""
    damper: DamperFile | Literal["auto"] | None = None
    """A tuned damper against it; ``auto``: 1 kg where it is best."""
    planner: PlannerOptions = PlannerOptions()

    # Beside what the file says: where it came from, which strokes it lists, what the files that it names have
    # in them, and how its SRDF stows the arm.
    _source: str = PrivateAttr("Scene")
    _listed: tuple[str, ...] = PrivateAttr(())
    _files: dict[str, str] = PrivateAttr({})
    _stowed: tuple[float, ...] | None = PrivateAttr(None)

    def _check(self) -> None:
        if self.guardrail.stance is not None:
            if not self.on_guardrail:
                expected = "no such key with a URDF of one's own, whose mount says where it stands"
                raise refusal(expected, got="stance", key=("guardrail", "stance"))
            self.stance  # noqa: B018  it is refused here where the climber reaches none
        if self.mounts and self.on_guardrail:
            expected = "no such key with model: cmbot, which stands where its feet hold the guardrail"
            raise refusal(expected, got="mounts", key=("mounts",))
        self._check_identified()
        measured = self.identified is not None and self.identified.base is not None
        bends = [key for key in ("modes", "tube") if getattr(self.base, key, None) is not None]
        if bends and (bends[1:] or self.guardrail.stiffness or self.guardrail.mass):
            expected = "no such key beside another one that says how the base bends"
            raise refusal(expected, got=bends[-1], key=("base", bends[-1]))
        if "tube" in bends and self.guardrail.bays:
            expected = "0 beside base.tube, on which the robot stands"
            raise refusal(expected, got=self.guardrail.bays, key=("guardrail", "bays"))
        if self.base is not None and self.base.hold and (self.on_guardrail or self.guardrail.hold):
            expected = "guardrail.hold: base.hold is for robots that hold no guardrail"
            raise refusal(expected, got="hold", key=("base", "hold"))
        if self.guardrail.mass is not None and self.guardrail.stiffness is None and not measured:
            expected = "no mass where no stiffness is given"
            raise refusal(expected, got="a mass alone", key=("guardrail", "mass"))
        if self.tool.fixed is not None and any(self.tool.process_force_n):
            expected = "no force beside tool.fixed: it is not planned with yet"
            raise refusal(expected, got=shown(self.tool.process_force_n), key=("tool", "process_force_n"))
        if self.tool.process_ramp_s and not any(self.tool.process_force_n):
            expected = "0 without tool.process_force_n, or the force that sets in"
            raise refusal(expected, got=self.tool.process_ramp_s, key=("tool", "process_ramp_s"))
        taken, frames = set(self.guardrail.member_names), [name for name, _ in self.frames]
        for index, obstacle in enumerate(self.obstacles):
            if obstacle.name in taken:
                expected = "a name that no other obstacle or guardrail member has"
                raise refusal(expected, got=shown(obstacle.name), key=("obstacles", index, "name"))
            taken.add(obstacle.name)
            if obstacle.frame is not None and obstacle.frame not in frames:
                expected = f"one of {', '.join(frames)}" if frames else "no such key: the scene has no frames"
                raise refusal(expected, got=shown(obstacle.frame), key=("obstacles", index, "frame"))
        self._listed = tuple(str(stroke.name) for stroke in self.strokes)

    def _check_identified(self) -> None:
        identified = self.identified
        if identified is None:
            return
        if self.guardrail.stiffness is not None and identified.base is None:
            expected = "no such key beside identified, which has no base: it was measured on a rigid one"
            raise refusal(expected, got="stiffness", key=("guardrail", "stiffness"))
        if identified.joints and self.robot.joints == "rigid":
            raise refusal("elastic, as joints were identified", got="rigid", key=("robot", "joints"))
        if identified.base is None:
            return
        now, then = self.elastic_guardrail.footholds, identified.base.footholds
        if not np.allclose(then, now, rtol=0, atol=_FOOTHOLD_TOLERANCE_M):
            at, held = (", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in points) for points in (now, then))
            expected = f"a stiffness measured where the feet hold now, {at}"
            raise refusal(expected, got=held, key=("identified", "base", "footholds"))

    def __eq__(self, other: object) -> bool:
        """Whether both say the same, wherever they came from."""
        return isinstance(other, Scene) and self.__dict__ == other.__dict__

    def __repr__(self) -> str:
        return f"<Scene {self.name}: {self._in_words}>"

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """Card in a notebook."""
        rows = [(f"stroke {stroke.name}", f"keeps the tool's {stroke.keep}") for stroke in self.strokes]
        rows.append(("stands on", self.base_name))
        rows.append(("obstacles", ", ".join(obstacle.name for obstacle in self.all_obstacles) or "none"))
        back = "stays" if self.return_to == "none" else f"returns to {self.return_to}"
        rows.append(("after the work", back))
        return card(f"Scene {self.name}", self._in_words, rows)

    @property
    def _in_words(self) -> str:
        strokes, obstacles = len(self.strokes), len(self.all_obstacles)
        return f"{self.robot.model}, {counted(strokes, 'stroke')}, {counted(obstacles, 'obstacle')}"

    # The file

    @classmethod
    def of(cls, data: Mapping[str, Any], source: str, folder: Path) -> Self:
        """Return the scene of a scene file's content.

        Parameters
        ----------
        data : mapping
            The content; rows of waypoints and an identified stiffness are in it.
        source : str
            Where it came from, for messages.
        folder : Path
            Where relative paths start.

        Raises
        ------
        SceneError, ModelError, MissingExtra
            As `cmbot.load_scene`.
        """
        scene = validated(cls, dict(data), source, SceneError, {FOLDER: folder})
        scene._source = source
        return scene._with_files({})

    def _with_files(self, known: Mapping[str, str]) -> Self:
        """It, with what is in the files that it names; `known` are those that were read before."""
        self._files = file_hashes(self.as_data(), self.source, known)
        self.posture  # noqa: B018  it is refused here where there is none
        return self

    @property
    def source(self) -> str:
        """Where it came from, for messages."""
        return self._source

    def with_source(self, source: str) -> Self:
        """Return it as having come from somewhere else.

        Raises
        ------
        SceneError
            When a file that it names cannot be read.
        """
        scene = copy(self)
        scene._source = source
        return scene._with_files(self._files)

    def as_data(self) -> dict[str, Any]:
        """Return the content of its file, every default filled in, as `cmbot.load_scene` takes it back."""
        return self.model_dump(mode="json", exclude_none=True, by_alias=True)

    @property
    def numbers(self) -> Iterator[tuple[str, FloatArray]]:
        """All numbers of its file by the keys of the numbers, or of the lists of them."""
        return numbers_in(self.as_data())

    @property
    def content_hash(self) -> str:
        """SHA-256 (hexadecimal) of that content, with those of files as they were read for their paths.

        Raises
        ------
        SceneError
            When a file that it names cannot be read.
        """
        data = self.as_data()
        data = with_paths(data, file_hashes(data, self.source, self._files))
        data["robot"].pop("package_dirs", None)
        # The one JSON text that equal scenes share.
        text = dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return sha256(text.encode()).hexdigest()

    # Edits

    def changed(self, **values: object) -> Self:
        """Return the scene with other values of some fields, the whole checked anew.

        It is the scene that would be read from the edited file, whose errors name the same keys.

        Parameters
        ----------
        **values
            By the names of the fields: what the file would have there, with paths relative to the current
            folder, or objects of the fields' types. None takes the default.

        Raises
        ------
        SceneError
        """
        if isinstance(path := values.get("tool_path"), JobStrokes):
            values["tool_path"] = path.as_data()
        same = {"robot", "start"}.isdisjoint(values)
        data, context = self._changed_data(values, self.source), {FOLDER: Path.cwd()}
        scene = validated(type(self), data, self.source, SceneError, context)
        scene._source, scene._listed = self._source, self._listed
        scene._stowed = self._stowed if same else None
        return scene._with_files(self._files)

    def with_values(self, values: Mapping[str, object]) -> Self:
        """Return the scene with other values by their keys: see `changed_content`; errors as above."""
        data = changed_content(self.as_data(), values)
        return self.changed(**{block: data[block] for block in {key.partition(".")[0] for key in values}})

    def with_files_of(self, other: Scene) -> Scene:
        """Return it with the paths of another scene's files for files of the same content, one for each."""
        places = {content: path for path, content in other._files.items()}
        paths = {path: places.get(content, path) for path, content in self._files.items()}
        return (
            self if paths.keys() == {*paths.values()} else self.changed(**with_paths(self.as_data(), paths))
        )

    def with_options(self, options: PlannerOptions | None = None, **changes: Any) -> Self:
        """Return the scene with other options of the planner: all of them, or some by their names."""
        options = self.planner if options is None else options
        require_type(options, PlannerOptions, "Scene", "planner", "PlannerOptions")
        known = tuple(field.name for field in fields(PlannerOptions))
        for name in changes.keys() - set(known):
            expected = f"an option of the planner{hint(name, known)}"
            raise InputError("Scene.with_options", name, "no such option", expected)
        return self.changed(planner=replace(options, **changes))

    def with_strokes(self, strokes: Sequence[StrokeFile], order: Order | None = None) -> Self:
        """Return the scene with other strokes in place of its own; `order` left out: as given."""
        return self.changed(tool_path=JobStrokes(strokes=tuple(strokes), order=order))

    def with_path(self, **changes: object) -> Self:
        """Return the scene with other values of some keys of every stroke."""
        return self.with_strokes([stroke.changed(**changes) for stroke in self.strokes], self.order)

    def with_posture(self, q: Sequence[float] | FloatArray) -> Self:
        """Return the scene with the arm in a posture (n,), rad and m, at the start."""
        return self.changed(start={"posture": np.asarray(q, dtype=float)})

    def with_mount(self, mount: MountFile | None) -> Self:
        """Return the scene with the base frame of its robot, another than the shipped one, held elsewhere."""
        return self.changed(robot=self.robot.changed(mount=mount))

    def with_stance(self, stance: StanceFile | None) -> Self:
        """Return the scene with the feet holding elsewhere; None: at the origin of W."""
        return self.changed(guardrail=self.guardrail.changed(stance=stance))

    def with_payload(self, payload_kg: float) -> Self:
        """Return the scene with another point mass at the tool."""
        return self.changed(robot=self.robot.changed(payload_kg=payload_kg))

    def with_joints(self, joints: Joints) -> Self:
        """Return the scene with joints that bend, or rigid ones."""
        return self.changed(robot=self.robot.changed(joints=joints))

    # The start

    @property
    def posture_key(self) -> str:
        """The key that has the posture, such as ``start.posture_deg``."""
        return "start" if self.start is None else f"start.{self.start.given}"

    @property
    def posture(self) -> FloatArray:
        """The posture (n,) at the start, SI, as if every joint turned where it is in degrees; read-only.

        Raises
        ------
        SceneError
            When the arm is to be in a named state, such as the stow, and its SRDF has none of that name.
        """
        start = self.start or PostureFile(stow=True)
        if start.posture_deg is not None:
            return read_only(np.radians(start.posture_deg))
        if start.posture is not None:
            return read_only(np.array(start.posture, dtype=float))
        if self._stowed is None:
            given = self.start is not None
            self._stowed = tuple(
                named_posture(
                    self.robot, start.state or STOW, self.source, self.posture_key, given=given
                ).tolist()
            )
        return read_only(np.array(self._stowed))

    @property
    def begins_elsewhere(self) -> bool:
        """Whether the first stroke begins at a pose of its own, not at that of the tool in `posture`."""
        return self.strokes[0].has_start

    @property
    def pinned_posture(self) -> str:
        """What ``start: pinned`` starts in, in words."""
        return "posture nearest to the scene's" if self.begins_elsewhere else "scene's posture"

    # What the robot stands on, and what is around it

    @property
    def on_guardrail(self) -> bool:
        """Whether its robot is the shipped one, which holds a guardrail."""
        return self.robot.model == "cmbot"

    @property
    def base_name(self) -> str:
        """What messages and pages call that on which the robot stands."""
        if self.base is not None:
            return self.base.name
        return "guardrail" if self.on_guardrail else "base"

    @property
    def elastic_guardrail(self) -> Guardrail:
        """The guardrail in SI units, with the stiffness that was identified, or that of its modes or tube."""
        measured = self.identified and self.identified.base
        return elastic_guardrail(self.guardrail, measured) if measured else self.modelled_guardrail

    @property
    def modelled_guardrail(self) -> Guardrail:
        """The same as if nothing had been identified."""
        guardrail = elastic_guardrail(self.guardrail)
        if self.base is None:
            return guardrail
        if self.base.tube is not None:
            stiffness, mass = self.base.tube.matrices()
            return replace(guardrail, stiffness=stiffness, mass=mass)
        if self.base.modes is None:
            return guardrail
        stiffness, mass, damping = self.base.modes.matrices()
        return replace(guardrail, stiffness=stiffness, mass=mass, damping=damping)

    @property
    def softest_key(self) -> str:
        """The key of what says how the base bends; without any that of the arm's elasticity."""
        if self.identified is not None:
            return "identified"
        for key in ("modes", "tube"):
            if getattr(self.base, key, None) is not None:
                return f"base.{key}"
        return "guardrail.stiffness" if self.guardrail.stiffness is not None else "guardrail"

    @property
    def is_movable(self) -> bool:
        """Whether there are other places where its robot might stand."""
        return bool(self.mounts or (self.on_guardrail and self.guardrail.bays))

    def hold_of(self, foot: int) -> tuple[str, HoldFile]:
        """Return how a foot holds, from 0, and the key of that."""
        if self.base is not None and self.base.hold:
            return "base.hold", self.base.hold
        several = len(self.guardrail.hold or ()) > 1
        return f"guardrail.hold{f'[{foot}]' * several}", self.guardrail.hold_of(foot)

    @property
    def stance(self) -> Stance | None:
        """Where the shipped robot stands; None: on the post at the origin of W."""
        stance = self.guardrail.stance
        return None if stance is None else resolved_stance(stance, elastic_guardrail(self.guardrail))

    @property
    def feet(self) -> tuple[Foot, ...]:
        """The feet that hold the guardrail; none of a robot that stands on something else."""
        holds = self.on_guardrail or self.guardrail.hold is not None
        return feet_of(self.guardrail) if holds else ()

    @property
    def frame_poses(self) -> dict[str, FloatArray]:
        """Poses (4, 4) in W of the frames of workpieces."""
        return {name: frame.matrix for name, frame in self.frames}

    @property
    def all_obstacles(self) -> tuple[Obstacle, ...]:
        """The scene's own obstacles, then the members of the guardrail; in SI units."""
        frames = dict(self.frames)
        own = (obstacle_from_file(entry, frames.get(entry.frame or "")) for entry in self.obstacles)
        every = (*own, *guardrail_obstacles(self.elastic_guardrail))
        contact = 1e-3 * self.tool.contact_mm
        return tuple(replace(one, contact=contact) if contact and one.workpiece else one for one in every)

    @property
    def touched(self) -> tuple[Obstacle, ...]:
        """What the tool's tip may touch, in the frame of its path: workpieces, or the part it is held to."""
        held = self.robot.tool
        if self.tool.fixed is None:
            return tuple(each for each in self.all_obstacles if each.contact)
        if held is None or not self.tool.contact_mm:
            return ()
        X_EF = np.linalg.inv(pose(held.xyz, np.radians(held.rpy_deg)))
        given = (each.model_dump(exclude_none=True) for each in held.shapes if each.mesh is None)
        files = (obstacle_from_file(ObstacleFile.model_validate({"name": "part", **each})) for each in given)
        contact = 1e-3 * self.tool.contact_mm
        return tuple(replace(each, X_WO=X_EF @ each.X_WO, contact=contact) for each in files)

    def in_the_way(self, place: FootholdFile) -> str | None:
        """Return the name of an obstacle or member that a foot touches there, or on its way there from above.

        Joints of members, such as a post behind a rail, are in the way as lamps are. None where nothing is.
        """
        # Not above: scenes are read without coal.
        from cmbot.collision import touched_by

        others = [obstacle for obstacle in self.all_obstacles if obstacle.name != place.member]
        return touched_by(*swept_foot(self.elastic_guardrail, place), others)

    # The strokes

    @property
    def strokes(self) -> tuple[StrokeFile, ...]:
        """What describes each stroke, one or more; the one of a path without strokes is the ``work``."""
        return self.tool_path.strokes

    @property
    def order(self) -> Order | None:
        """In which order they are taken; None: as given."""
        return self.tool_path.order

    def timed_strokes(self, X_WT: FloatArray) -> tuple[Stroke, ...]:
        """Return the strokes, from the pose (4, 4) of the tool in `posture`.

        Raises
        ------
        SceneError
            When one of their paths is none.
        """
        strokes = list[Stroke]()
        for k, file in enumerate(self.strokes):
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
        for k, file in enumerate(self.strokes):
            surface = surface_of(file.raster, self._path_source(k), self._surfaces, X_WT)
            last = file
            if surface is not None and file.raster is not None and file.raster.pieces is None:
                own = surface.cells
                if len(own) > 1:
                    cells[k], whole[k] = own, surface.pieces
                    last = raster_parts(file, own, surface.pieces)[-1]
            if k + 1 < len(self.strokes):
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
        files, strokes = self.strokes, list[StrokeFile]()
        for k, file in enumerate(files):
            if k in cells:
                require_apart(files, k, self.source, self.stroke_key)
                taken = {str(each.name) for each in files}
                strokes += raster_parts(file, cells[k], whole[k], taken)
            else:
                strokes.append(file)
        # Too many strokes to be ordered are taken as they are.
        return self.with_strokes(strokes, self.order if len(strokes) <= MOST_ORDERED else None)

    def with_cuts(self, ends: Mapping[str, Sequence[float]], X_WT: FloatArray) -> Self:
        """Return the scene with paths cut: see `path_parts`.

        Parameters
        ----------
        ends : mapping of str to sequence of float
            By the names of strokes, where their parts end.
        X_WT : (4, 4)
            Pose of the tool in `posture`.
        """
        if not any(ends.values()):
            return self
        taken, parts = {str(file.name) for file in self.strokes}, list[StrokeFile]()
        for stroke in self.timed_strokes(X_WT):
            own = ends.get(stroke.name)
            parts += path_parts(stroke.file, stroke.path, own, taken) if own else [stroke.file]
        return self.with_strokes(parts, self.order)

    def stroke_key(self, number: int) -> str:
        """Return the key in the file of a stroke: strokes that are parts of one raster have its key."""
        stroke, listed = self.strokes[number], self._listed
        for name in (stroke.name, stroke.part_of):
            if name in listed:
                return "tool_path" if name == WORK else f"tool_path.strokes[{listed.index(name)}]"
        return f"tool_path.strokes[{number}]"

    @property
    def _surfaces(self) -> tuple[Obstacle, ...]:
        """Obstacles whose meshes rasters name: a fixed tool's path is on none of them, which are in W."""
        return self.all_obstacles if self.tool.fixed is None else ()

    def _path_source(self, number: int) -> PathSource:
        return PathSource(
            source=self.source,
            key=self.stroke_key(number),
            frames=self.frame_poses if self.tool.fixed is None else {},
            on_part=self.tool.fixed is not None,
            max_speed=self.tool.max_speed_m_s,
            deviation=self.planner.max_tool_deviation_m,
            rotation=float(np.radians(self.planner.max_tool_rotation_deg)),
        )

    def _timed(self, number: int, file: StrokeFile, X_WT: FloatArray) -> Stroke:
        """A stroke, from the pose (4, 4) of the tool before."""
        place = self._path_source(number)
        surface = surface_of(file.raster, place, self._surfaces, X_WT)
        return timed_stroke(file, place, X_WT, surface, begins_elsewhere=file.has_start or number > 0)
