"""From URDF, SRDF, joint-limits and elasticity file to a `Robot`; the shipped robot also as it climbs."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, Self
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ModelError
from cmbot.common.installation import model_folder
from cmbot.common.reading.input_files import read_input
from cmbot.common.reading.validation import hint
from cmbot.robot.arm_model import ArmModel, arm_model, attach_payload, build_model, set_tool_length
from cmbot.robot.description.completion import (
    POINT,
    AttachedTool,
    add_masses,
    add_tool,
    leave_on_floor,
    lift_below,
    loads_beside,
)
from cmbot.robot.description.files import RobotFiles, robot_files
from cmbot.robot.description.frames import arm_frames, moving_links
from cmbot.robot.description.limits_file import JointLimitsFile, read_joint_limits
from cmbot.robot.description.mesh_file import box_about
from cmbot.robot.description.self_collision import PAIR, srdf_of
from cmbot.robot.description.xml_file import parse_urdf
from cmbot.robot.elasticity import Elasticity, read_elasticity
from cmbot.robot.holding_joints import HoldingJoint
from cmbot.robot.inspection import Finding, default_arm, error_of, inspect_inertias, inspect_urdf, warning_of
from cmbot.robot.limits import ASSUMPTIONS, joint_limits
from cmbot.robot.robot import Robot

ARM_JOINTS = tuple(f"joint_{number}" for number in range(1, 8))
"""Of the shipped robot."""
Side = Literal[1, 2]
"""Number of a foot."""

# Fields of `RobotFiles` that are arguments of `load_robot`.
_LOADER_FIELDS = ("srdf", "limits", "elasticity", "package_dirs", "xacro", "base_frame", "tool_frame")
# An arm that weighs less is one without masses, kg.
_MIN_ARM_MASS_KG = 1e-3
# Shapes that extend further, as a multiple of the reach, are in millimetres; of what does not move, meshes
# that also extend further than so many metres. What is smaller than the third, m, is none of these. A link
# that is longer than the last, m, is in millimetres, too.
_LARGEST_SHAPE, _LARGEST_FIXED, _SMALL_M, _LONGEST_LINK_M = 4.0, 20.0, 2.0, 100.0
# One that weighs more than water in a cube as long as its reach has wrong masses, kg/m3: the heaviest
# industrial arms have a sixth of that.
_MAX_DENSITY_KG_M3 = 1000.0


def load_robot(
    model: str | Path = "cmbot",
    *,
    base_frame: str | None = None,
    tool_frame: str | None = None,
    limits: str | Path | None = None,
    srdf: str | Path | None = None,
    elasticity: str | Path | None = None,
    mount: ArrayLike | None = None,
    root: ArrayLike | None = None,
    locked: Mapping[str, float] | None = None,
    tool_length: float | None = None,
    payload: float = 0.0,
    carrier: str | None = None,
    package_dirs: Sequence[str | Path] = (),
    xacro: Mapping[str, str] | None = None,
    total_mass: float | None = None,
    tool: AttachedTool | None = None,
    carried_from: str | None = None,
) -> Robot:
    """Load a robot from its URDF.

    The joints between `base_frame` and `tool_frame` move; every other joint is locked at its value in the
    SRDF's ``group_state``, else at zero. A joint that follows another one of the arm (``mimic``) moves with
    it and is none of a posture's; where that one is locked, so is it. A collision mesh is replaced by its
    convex hull: a clearance with it is never overestimated.

    Parameters
    ----------
    model : str or pathlib.Path
        ``cmbot`` for the shipped robot; a URDF file, or xacro with the extra ``xacro``; or, with the extra
        ``robots``, the name of a robot of example-robot-data, such as ``panda``.
    base_frame, tool_frame : str, optional
        Links that bound the arm; default: where there is one choice, the root link, and the link of the
        SRDF's end effector, the tip of its chain, or the last link of the longest row of joints.
    limits : path, optional
        Joint-limits file, of cmbot's or MoveIt's; default: ``joint_limits.yaml`` beside the URDF, in
        ``../config`` or ``config``, unless it is of another kind. Without one, acceleration limits of 2 /s
        times the velocity limits and jerk limits of 10 /s times these are assumed. Of joints without them in
        the URDF, a velocity limit of 1 rad/s or 0.1 m/s is assumed, and twice the torque that the arm beyond
        asks of the joint at rest, stretched out.
    srdf : path, optional
        Disabled collision pairs and group states, such as ``stow``; default: the file beside the URDF, in
        ``../srdf``, ``../config`` or ``config`` with its name or its robot's.
        Without disabled pairs, neighbouring links and those that are nearly always near are not checked
        against each other.
    elasticity : path, optional
        Which links and joints bend; default: the file beside the URDF with its name and the ending
        ``.elasticity.yaml``, if there, else none does.
    mount : (4, 4), optional
        Pose of `base_frame` in W; default: the URDF's root link is W.
    root : (4, 4), optional
        In place of `mount` the pose of the URDF's root link in W: there is O0, where foot 1 holds.
    locked : mapping of str to float, optional
        Positions, rad or m, of joints that are not the arm's, in place of the SRDF's.
    tool_length : float, optional
        Distance of the tool point from the flange along its z axis, m; default: as in the URDF.
    payload : float
        Point mass at the tool point, kg.
    carrier : str, optional
        Link whose origin is the tool point of `tool_length` and `payload`; default: `tool_frame`.
    package_dirs : sequence of path
        Folders of ROS packages, or the packages, in which ``package://`` paths are sought first; then come
        the folders beside the URDF and above it, and those that ROS's environment variables name.
    xacro : mapping of str to str, optional
        Values of arguments of xacro, such as ``{"name": "ur5e"}``.
    total_mass : float, optional
        Mass of the whole robot, kg: what is not given of it is spread over the links without a mass, by the
        volumes of their shapes.
    tool : AttachedTool, optional
        That is fixed to `tool_frame`; its point is then the tool frame. Not with `tool_length`.
    carried_from : str, optional
        The first link that stands on what bends, such as a lift's carriage: links that it does not lead to
        stand on the floor, so their masses are left out. Default: the root link.

    Raises
    ------
    ModelError
        When a file is missing or unusable, a frame does not exist or has to be chosen, a joint of the arm
        neither turns nor slides or follows no joint that does, the arm has no mass or more than 100 joints,
        or a number is beyond any robot's.
    MissingExtra
        When `model` is xacro or could be a robot's name, and the extra for it is not installed.

    Examples
    --------
    >>> robot = cmbot.load_robot()
    >>> robot.dof, f"{robot.mass:.1f} kg"
    (7, '68.0 kg')
    >>> robot.joints[:2]
    ('joint_1', 'joint_2')
    """
    files = robot_files(
        model,
        srdf=srdf,
        limits=limits,
        elasticity=elasticity,
        package_dirs=package_dirs,
        xacro=xacro,
        total_mass=total_mass,
        tool=tool,
    )
    described = _Description.read(files, base_frame, tool_frame, carried_from)
    placement = _Placement(
        base_frame=described.base_frame,
        X_WB=None if mount is None else _pose(mount),
        X_WR=None if root is None else _pose(root, "root"),
        carrier=carrier or described.tool_frame,
        tool_length=tool_length,
        source=str(files.urdf),
    )
    robot = described.placed(placement, locked or {}, payload)
    _require_size(robot)
    return robot


def _require_size(robot: Robot) -> None:
    """Refuse links, and meshes far larger than the arm, whose numbers are millimetres most likely."""
    for number, X in list(enumerate(robot.model.jointPlacements))[2:]:
        if (length := float(np.linalg.norm(X.translation))) > _LONGEST_LINK_M:
            key, got = (
                f"joint[{robot.model.names[number]}].origin",
                f"{length:.4g} m from the joint before it",
            )
            raise ModelError(str(robot.urdf), key, got, "metres (millimetres?)")
    farthest = max(_LARGEST_SHAPE * robot.reach, _SMALL_M)
    for shape in robot.collision_model.geometryObjects:
        # What stands still, such as a floor, may be large.
        most = farthest if shape.parentJoint else max(farthest, _LARGEST_FIXED)
        hull = isinstance(shape.geometry, coal.ConvexBase)
        if shape.parentJoint == 0 and not hull:
            continue
        if (size := float(np.abs(box_about(shape.geometry)).max())) > most:
            link = robot.model.frames[shape.parentFrame].name
            file = Path(shape.meshPath).name if hull else "a shape"
            got = f"{file} that extends to {size:.4g} m, of an arm that reaches {robot.reach:.4g} m"
            expected = 'metres (millimetres? scale="0.001 0.001 0.001" of a mesh)'
            raise ModelError(str(robot.urdf), f"link[{link}].collision", got, expected)


def _remarks(files: RobotFiles) -> Iterator[str]:
    if files.tool is not None and not files.tool.shapes:
        yield "The tool has no shapes: it is neither drawn nor kept clear of anything."
    if files.left_alone is not None:
        file, why = files.left_alone
        yield f"{file} is left alone: it is no joint-limits file of cmbot's or MoveIt's ({why})."


@dataclass(frozen=True, kw_only=True, eq=False)
class _Description:
    """A robot's files as they were read, with the arm's frames, and masses and a tool added to the URDF."""

    files: RobotFiles
    content: bytes
    root: ElementTree.Element
    semantics: ElementTree.Element | None
    base_frame: str
    flange: str
    tool_frame: str
    estimated: tuple[str, ...]
    completed: str
    loads: Mapping[str, float]

    @classmethod
    def read(
        cls, files: RobotFiles, base_frame: str | None, tool_frame: str | None, carried_from: str | None
    ) -> Self:
        """Read the files; refuse what is wrong in them."""
        content, root = _read(files)
        semantics = None if files.srdf is None else parse_urdf(files.srdf, "an SRDF", files.package_dirs)
        # Frames can be sought only in a tree, and which links move is known only with the frames.
        _refuse_errors(files.urdf, inspect_urdf(root, moving=()))
        base_frame, flange = arm_frames(
            root,
            semantics,
            files.base_frame if base_frame is None else base_frame,
            files.tool_frame if tool_frame is None else tool_frame,
            str(files.urdf),
        )
        _refuse_errors(files.urdf, inspect_inertias(root, moving_links(root, base_frame)))
        estimated = tuple(add_masses(root, files))
        tool_frame = flange if files.tool is None else add_tool(root, files, flange)
        # Pinocchio's model of the arm changes the tree, too.
        completed = ElementTree.tostring(root, encoding="unicode") if estimated or files.tool else ""
        if carried_from is not None:
            leave_on_floor(root, carried_from, base_frame, str(files.urdf))
        return cls(
            files=files,
            content=content,
            root=root,
            semantics=semantics,
            base_frame=base_frame,
            flange=flange,
            tool_frame=tool_frame,
            estimated=estimated,
            completed=completed,
            loads=loads_beside(root, base_frame) if carried_from is None else {},
        )

    @property
    def _hash(self) -> str:
        """SHA-256 of all that was read, and of what was added to the URDF."""
        files = self.files
        beside = (file for file in (files.srdf, files.limits, files.elasticity) if file)
        contents = [self.content, *(read_input(file, ModelError) for file in beside)]
        if self.completed:
            contents.append(self.completed.encode())
        return hashlib.sha256(b"\0".join(contents)).hexdigest()

    def _arm(self, locked: Mapping[str, float]) -> ArmModel:
        return arm_model(
            self.files.urdf,
            self.root,
            self.semantics,
            self.base_frame,
            self.tool_frame,
            srdf=str(self.files.srdf),
            package_dirs=self.files.package_dirs,
            locked=locked,
            tool=self.tool_frame.removesuffix(POINT) if self.files.tool else "",
        )

    def placed(self, placement: _Placement, locked: Mapping[str, float], payload: float) -> Robot:
        """Return the robot in its place, with a payload, kg, and other joints at the positions `locked`."""
        files, made = self.files, self._arm(locked)
        made_at = made.model.frames[made.model.getFrameId(self.base_frame)].placement.copy()
        arm, collision = made.model, placement.applied(made.model, made.collision)
        attach_payload(arm, placement.carrier, payload)
        self._require_mass(arm)
        limited, assumed = joint_limits(arm, made.coupling, files.urdf, files.limits)
        bends = Elasticity({}, {}, {})
        if files.elasticity is not None:
            sliding = self.root.iterfind("joint[@type='prismatic']")
            slides = {joint.get("name", "") for joint in sliding}
            paired = np.array(list(arm.names)[1:])[made.coupling.paired]
            bends = read_elasticity(files.elasticity, arm, slides, set(paired.tolist()))
        held = _held(files)
        return Robot(
            name=self.root.get("name", files.urdf.stem),
            urdf=files.urdf.resolve(),
            description=self.completed,
            model=arm,
            coupling=made.coupling,
            collision_model=collision,
            read_visual_model=partial(placement.drawn, made.read_visual),
            limits=limited,
            group_states=made.group_states,
            elasticity=bends.tubes,
            joint_elasticity=bends.springs,
            base_frame=self.base_frame,
            tool_frame=self.tool_frame,
            flange=self.flange,
            payload=payload,
            content_hash=self._hash,
            foot_point=tuple(placement.foot_point.tolist()),
            locked_joints=tuple(
                replace(
                    placement.placed(joint, made_at),
                    limit=held.get(joint.name, joint.limit),
                    spring=bends.locked.get(joint.name),
                )
                for joint in made.locked_joints
            ),
            unplaced=made.unplaced,
            loads_beside=self.loads,
            lift=lift_below(self.root, self.base_frame),
            remarks=(*_remarks(files), *self.estimated, *assumed, *made.remarks),
        )

    def _require_mass(self, arm: Any) -> None:
        if not (mass := sum(inertia.mass for inertia in list(arm.inertias)[1:])) >= _MIN_ARM_MASS_KG:
            got = f"{mass:g} kg from {self.base_frame!r} to {self.tool_frame!r}"
            expected = "the mass of all of the robot, which is spread over its shapes; or masses of its links"
            raise ModelError(str(self.files.urdf), "total_mass_kg", got, expected)


@dataclass(frozen=True, kw_only=True)
class _Placement:
    """Where the arm is mounted, and where its tool ends: applied to any of its models.

    Attributes
    ----------
    base_frame : str
    X_WB, X_WR : pinocchio.SE3 or None
        Poses of the base frame and of the URDF's root link; None: as the URDF has them.
    carrier : str
        The link of the tool point.
    tool_length : float or None, m
    source : str
        The URDF, for messages.
    """

    base_frame: str
    X_WB: Any
    X_WR: Any
    carrier: str
    tool_length: float | None
    source: str

    @property
    def foot_point(self) -> FloatArray:
        """O0 in W (3,), m: the origin of the URDF's root link."""
        return np.zeros(3) if self.X_WR is None else np.array(self.X_WR.translation)

    def placed(self, joint: HoldingJoint, X_UB: Any) -> HoldingJoint:
        """Return a locked joint of the URDF, whose base frame is at `X_UB` there, in W."""
        if self.X_WB is not None:
            joint = joint.moved(self.X_WB * X_UB.inverse())
        return joint if self.X_WR is None else joint.moved(self.X_WR)

    def applied(self, model: Any, shapes: Any) -> Any:
        """Shapes on the mount and with the tool's length; the model is changed, too."""
        if self.X_WB is not None:
            X_UB = model.frames[model.getFrameId(self.base_frame)].placement
            _move_root(model, shapes, self.X_WB * X_UB.inverse())
        if self.X_WR is not None:
            _move_root(model, shapes, self.X_WR)
        if self.tool_length is not None:
            set_tool_length(model, shapes, self.carrier, self.tool_length, source=self.source)
        return shapes

    def drawn(self, read: Callable[[], tuple[Any, Any]]) -> Any:
        """What is drawn of the arm, by what reads it with its model."""
        return self.applied(*read())


def _held(files: RobotFiles) -> dict[str, float]:
    """What joints hold while they are locked, Nm, by their names, where the limits file says it."""
    listed = None if files.limits is None else read_joint_limits(files.limits)
    entries = listed.joints if isinstance(listed, JointLimitsFile) else {}
    given = {name: entry.holding_torque for name, entry in entries.items()}
    return {name: torque for name, torque in given.items() if torque is not None}


def other_foot(foot: Side) -> Side:
    """Return the number of the other foot."""
    return 2 if foot == 1 else 1


def load_climbing_robot(
    foot: Side, root: FloatArray, arm: FloatArray, *, tool_length: float | None = None, payload: float = 0.0
) -> Robot:
    """Load the shipped robot on one foot, with its five climbing joints as the joints that move.

    Parameters
    ----------
    foot : int
        The foot that holds. On foot 2 the joints are in the other order, ``climb_5`` first.
    root : (4, 4)
        Pose of that foot in W.
    arm : (7,), rad
        Posture in which the arm is locked.
    tool_length, payload : float, optional
        As in `load_robot`; both are the arm's. The tool of this robot is the other foot.
    """
    folder = model_folder() / "urdf"
    urdf, swings = ("cmbot.urdf", "foot_2") if foot == 1 else ("cmbot_on_foot_2.urdf", "foot_1_place")
    return load_robot(
        folder / urdf,
        base_frame=f"foot_{foot}",
        tool_frame=swings,
        limits=folder / "joint_limits.yaml",
        srdf=folder / "climbing.srdf",
        elasticity=folder / "climbing.elasticity.yaml",
        root=root,
        locked=dict(zip(ARM_JOINTS, arm.tolist(), strict=True)),
        tool_length=tool_length,
        payload=payload,
        carrier="tool0",
    )


def inspect_loaded(files: RobotFiles) -> list[Finding]:
    """Load a robot's default arm, or where frames have to be chosen its meshes alone; list what that finds.

    Parameters
    ----------
    files : RobotFiles
        Without errors in `inspect_robot`.
    """
    try:
        _, root = files.read()
        arm = default_arm(files, root)
        built = build_model(files.urdf, root, files.package_dirs)
        drawn = "a mesh file: a box is drawn in its place"
        found = [warning_of(key, got, drawn) for key, got in built.unusable]
        thick = "a mesh with a volume: it counts as 1 mm thick"
        found += [warning_of(f"link[{name}].collision", "a flat mesh", thick) for name in built.flat]
        if arm is None:
            return found
        given = {name: getattr(files, name) for name in _LOADER_FIELDS}
        robot = load_robot(files.urdf, **given)
        return [*found, *_assumed_limits(robot), *_questionable_masses(robot)]
    except ModelError as error:
        key = error.key if error.source == str(files.urdf) else f"{error.source}: {error.key}"
        return [error_of(key, error.got, error.expected)]


def _assumed_limits(robot: Robot) -> Iterator[Finding]:
    """Warn of joints whose velocity or effort no file gives."""
    limits = robot.limits
    for rate, assumed in (("velocity", limits.assumed_velocity), ("torque", limits.assumed_torque)):
        name, by = ASSUMPTIONS[rate]
        expected = f"a positive bound, here or in a joint-limits file; assumed is {by}"
        for joint in np.array(robot.joints)[assumed]:
            yield warning_of(f"joint[{joint}].limit.{name.lower()}", "nothing", expected)


def _questionable_masses(robot: Robot) -> Iterator[Finding]:
    """Warn of links that joints move without mass, and of an arm too heavy for its size."""
    for number, inertia in enumerate(list(robot.model.inertias)[1:], start=1):
        if inertia.mass < _MIN_ARM_MASS_KG:
            body = next(
                frame.name
                for frame in robot.model.frames
                if frame.parentJoint == number and frame.type == pin.FrameType.BODY
            )
            got = f"{inertia.mass:g} kg, with what is fixed to it"
            yield warning_of(f"link[{body}].inertial.mass", got, "<inertial>, as a joint moves it")
    if robot.arm_mass > (most := _MAX_DENSITY_KG_M3 * robot.reach**3):
        got = f"{robot.arm_mass:.4g} kg that move, with a reach of {robot.reach:.3f} m"
        expected = f"less than {most:.0f} kg, as water in a cube of that length; masses are in kg"
        yield warning_of("link.inertial.mass", got, expected)


def srdf_text(files: RobotFiles) -> str:
    """Return an SRDF that says which links of a robot need not be checked against each other, and why.

    All movable joints are sampled: Adjacent are links that a joint joins, Always those that are nearly always
    near, Never those that are near in none of 10,000 random postures. What else is in the SRDF of the robot,
    such as its group states, is kept.

    Parameters
    ----------
    files : RobotFiles

    Raises
    ------
    ModelError
        When the URDF is missing or unusable.
    """
    _, root = _read(files)
    _refuse_errors(files.urdf, inspect_urdf(root, moving=()))
    name = root.get("name", files.urdf.stem)
    model, collision, *_ = build_model(files.urdf, root, files.package_dirs)
    semantics = () if files.srdf is None else parse_urdf(files.srdf, "an SRDF", files.package_dirs)
    return srdf_of(model, collision, name, [each for each in semantics if each.tag != PAIR])


def _refuse_errors(urdf: Path, findings: Sequence[Finding]) -> None:
    for finding in findings:
        if finding.severity == "error":
            raise ModelError(str(urdf), finding.key, finding.got, finding.expected)


def _read(files: RobotFiles) -> tuple[bytes, ElementTree.Element]:
    try:
        return files.read()
    except ModelError as error:
        if not files.urdf.exists() and (meant := hint(files.urdf.name, ("cmbot",))):
            raise ModelError(error.source, "", error.got, f"{error.expected}{meant}") from error
        raise


def _move_root(model: Any, shapes: Any, X_WU: Any) -> None:
    """Move everything that is fixed to the universe by `X_WU`."""
    for i in range(1, model.njoints):
        if model.parents[i] == 0:
            model.jointPlacements[i] = X_WU * model.jointPlacements[i]
    for frame in model.frames:
        if frame.parentJoint == 0 and frame.name != "universe":
            frame.placement = X_WU * frame.placement
    model.inertias[0] = X_WU.act(model.inertias[0])
    for shape in shapes.geometryObjects:
        if shape.parentJoint == 0:
            shape.placement = X_WU * shape.placement


def _pose(mount: ArrayLike, key: str = "mount") -> Any:
    expected = "a pose: a 4 x 4 matrix of a rotation, a position and the last row 0 0 0 1"
    try:
        X = np.array(mount, dtype=float)
    except (TypeError, ValueError) as error:
        raise ModelError("load_robot", key, repr(mount), expected) from error
    if X.shape == (4, 4) and np.isfinite(X).all() and (X[3] == [0, 0, 0, 1]).all():
        R = X[:3, :3]
        if np.abs(R @ R.T - np.eye(3)).max() <= 1e-9 and np.linalg.det(R) > 0:
            return pin.SE3(X)
    raise ModelError("load_robot", key, X.tolist(), expected)
