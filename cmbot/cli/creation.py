"""The command that writes a new scene: `cmbot new`."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import cmbot
from cmbot.cli.command import Writing, option, require_new
from cmbot.cli.console import out, print_lines
from cmbot.common.errors import InputError, ModelError, one_line
from cmbot.common.installation import scene_folder

if TYPE_CHECKING:
    from cmbot.collision import Obstacle
    from cmbot.planning import StartPosture
    from cmbot.robot import Robot
    from cmbot.scene import NewRobot

_SHIPPED_ROBOT = "cmbot"
_NOT_IN_SLUG = re.compile(r"[^A-Za-z0-9_\-]+")
# Numbers of the command line are bounded as those of a scene file.
_LARGEST, _LARGEST_ANGLE, _LEAST_MASS_KG, _MOST_MASS_KG = 1e4, 360.0, 1e-3, 1e5
# Options that mend an error of a robot's files, by its key.
_REMEDY_OPTIONS = {
    **{"base_frame": "--base", "tool_frame": "--tool"},
    **{"total_mass_kg": "--total-mass", "locked": "--locked"},
}
PACKAGE_DIR_HELP = "Where package:// is sought first; repeatable."

Numbers = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class NewCommand(Writing):
    """Write a scene for a robot: a start posture that holds the tool, a first leg, joint limits to fill in.

    Example: cmbot new --from panda --tool-at 0.5 0 0.4 -o panda.yaml, then cmbot plan panda.yaml
    """

    reads = False

    source: str | None = option(
        None, "A URDF, or the name of a robot such as panda.", "--from", metavar="URDF"
    )
    tool_at: Numbers | None = option(
        None,
        "With --from: tool point at the start, m, in the frame of the URDF's root link.",
        metavar="X Y Z",
        least=-_LARGEST,
        most=_LARGEST,
    )
    rpy_deg: Numbers | None = option(
        None,
        "Roll, pitch, yaw of the tool there; left out: any.",
        metavar="R P Y",
        least=-_LARGEST_ANGLE,
        most=_LARGEST_ANGLE,
    )
    base: str | None = option(None, "Base frame; left out: the only choice.", metavar="FRAME")
    tool: str | None = option(
        None,
        "Tool frame, left out: the only choice; or a tool on it, as robot.tool in a scene, such as "
        "'{xyz: [0, 0, 0.2], mass_kg: 1.5}'.",
        metavar="FRAME",
    )
    flange: str | None = option(None, "With a tool: the frame that it is fixed to.", metavar="FRAME")
    package_dir: tuple[Path, ...] = option((), PACKAGE_DIR_HELP, metavar="DIR")
    xacro: tuple[str, ...] = option((), "An argument of the xacro file; repeatable.", metavar="NAME=VALUE")
    locked: tuple[str, ...] = option(
        (),
        "Where a joint before the arm is, rad or m, such as lift_joint=0.3; repeatable.",
        metavar="NAME=VALUE",
    )
    total_mass: float | None = option(
        None,
        "Of a robot without masses: of all of it, which is spread over its shapes.",
        metavar="KG",
        least=_LEAST_MASS_KG,
        most=_MOST_MASS_KG,
    )
    near: tuple[str, ...] = option(
        (),
        "About where a joint is at the start, rad or m, such as elbow_joint=-1.5; repeatable.",
        metavar="NAME=VALUE",
    )
    output: Path | None = option(None, "Scene file to write; NAME.yaml if left out.", "--output", "-o")

    def __call__(self) -> None:
        source, tool_at = self.source, self.tool_at
        if source is None or tool_at is None:
            missing = "--from" if source is None else "--tool-at"
            raise InputError(missing, "", "nothing", "--from URDF and --tool-at X Y Z")
        path = self.output or Path(f"{_slug(Path(source).name.partition('.')[0])}.yaml")
        self._require_applicable(source)
        asked = self._asked(source)
        robot = _loaded(asked)
        require_new(path, self.force)
        made = _composed(robot, asked, partial(self._start, tool_at), path)

        # The scene last: it names the others.
        *others, scene_file = sorted(made.files, key=lambda file: file == path)
        for file in others:
            require_new(file, self.force)
        for file in (*others, scene_file):
            cmbot.archive.write_file(file, made.files[file].encode())
        written = [scene_file, *others]
        remarks = [*self._mistaken(), *made.robot.remarks, *made.remarks]
        self.answer(
            lambda: {"files": [str(file) for file in written], "remarks": remarks},
            lambda: _print_new(made, remarks, written, shipped=source == _SHIPPED_ROBOT),
        )

    def _start(self, tool_at: Numbers, robot: Robot) -> StartPosture:
        """The start posture of a robot, its tool at a point, that the options describe."""
        import numpy as np

        from cmbot.common.poses import pose

        rpy, near = self.rpy_deg, _positions(self.near, "--near", "elbow_joint=-1.5")
        if unknown := near.keys() - set(robot.joints):
            raise InputError("--near", "", ", ".join(sorted(unknown)), f"of {', '.join(robot.joints)}")
        turned = None if rpy is None else np.array(pose((0, 0, 0), np.radians(rpy)))[:3, :3]
        obstacles = _obstacles(str(self.source))
        return cmbot.planning.find_start(robot, obstacles, np.array(tool_at), turned, near)

    def _mistaken(self) -> Iterator[str]:
        """Yield a warning of angles that look as if they were radians."""
        import numpy as np

        if self.rpy_deg is not None and cmbot.planning.in_radians(np.abs(self.rpy_deg)):
            yield "warning: --rpy-deg: got numbers that look like radians, expected degrees"

    def _require_applicable(self, source: str) -> None:
        """Refuse options that the shipped robot does not need, and folders that are not there."""
        foreign: dict[str, object] = {"--base": self.base, "--tool": self.tool}
        foreign["--package-dir"] = self.package_dir
        foreign |= {"--xacro": self.xacro, "--locked": self.locked, "--total-mass": self.total_mass}
        if source == _SHIPPED_ROBOT and (given := [flag for flag, value in foreign.items() if value]):
            raise InputError(", ".join(given), "", "an option", "none with --from cmbot, which is known")
        require_folders(self.package_dir)

    def _asked(self, source: str) -> NewRobot:
        """The robot that the options describe; ``--tool`` is a frame, or a tool as the scene file has it."""
        from cmbot.common.reading.validation import shown, validated
        from cmbot.common.reading.yaml_reader import yaml_value

        tool, tool_frame = None, self.tool
        if self.tool is not None and self.tool.lstrip().startswith("{"):
            value = yaml_value(self.tool, "--tool", InputError)
            # Its files are named as from here.
            here, kind = {cmbot.scene.FOLDER: Path.cwd()}, cmbot.scene.AttachedToolFile
            tool = validated(kind, value, "--tool", InputError, here)
            tool_frame = self.flange
        elif self.flange is not None:
            raise InputError("--flange", "", shown(self.flange), "a tool on it: --tool '{xyz: [0, 0, 0.2]}'")
        return cmbot.scene.NewRobot(
            source=source,
            base_frame=self.base,
            tool_frame=tool_frame,
            package_dirs=self.package_dir,
            xacro=named_values(self.xacro),
            locked=_positions(self.locked, "--locked", "lift_joint=0.3"),
            total_mass=self.total_mass,
            tool=tool,
        )


def _print_new(made: _Made, remarks: Sequence[str], written: Sequence[Path], *, shipped: bool) -> None:
    """Print what was written of a scene: the file and those beside it."""
    robot, start = made.robot, made.start
    joints = f"{robot.dof} joints from {robot.base_frame} to {robot.tool_frame}"
    out.print(one_line(f"{robot.name}: {joints}"))
    by = ", ".join(f"{x:g}" for x in start.by)
    out.print(f"A first leg takes the tool by ({by}) m in {start.seconds:g} s: put your own into tool_path.")
    if not shipped:
        out.print(
            "The base is rigid: base.tube or guardrail.stiffness says how it bends, base.name what it is."
        )
    sheets = [limits for limits in written[1:] if limits.suffix == ".yaml"]
    yours = "put those of your robot's data sheet there"
    print_lines([*remarks, *(f"The assumed limits are in {limits}: {yours}." for limits in sheets)])
    out.print(one_line(f"Written: {', '.join(map(str, written))}. Plan it: cmbot plan {written[0]}"))


@dataclass(frozen=True)
class _Made:
    """A robot, its start posture, what is to be said of both, and the texts of the files to write."""

    robot: Robot
    start: StartPosture
    remarks: tuple[str, ...]
    files: Mapping[Path, str]


def _composed(robot: Robot, asked: NewRobot, start_of: Callable[[Robot], StartPosture], path: Path) -> _Made:
    """What is written: the scene, joint limits where the robot has none, an SRDF where its own blocks it."""
    import numpy as np

    shipped = asked.source == _SHIPPED_ROBOT

    def usual(start: StartPosture) -> bool:
        return start.safety_margin == cmbot.PlannerOptions().safety_margin_m

    start, srdf, files = start_of(robot), path.with_suffix(".srdf"), dict[Path, str]()
    remarks: tuple[str, ...] = ()
    if not shipped and not usual(start):
        text, said = _always_near(asked, srdf)
        with tempfile.TemporaryDirectory() as folder:
            draft = Path(folder, srdf.name)
            draft.write_text(text, encoding="utf-8")
            freed = _loaded(asked, draft)
        if usual(better := start_of(freed)):
            robot, start, files, remarks = freed, better, {srdf: text}, (said,)
    limits = path.with_name(f"{path.stem}.limits.yaml")
    assumed = None if shipped or asked.files().limits is not None else limits
    files[path] = cmbot.scene.scene_text(
        name=_slug(path.stem),
        schema=_schema(path),
        robot=asked.entry(robot, path, assumed, srdf if srdf in files else None),
        on_guardrail=shipped,
        posture=start.posture,
        arm=robot,
        tool_point=np.array(cmbot.robot.Kinematics(robot).tool_pose(start.posture).translation),
        keep=start.keep,
        by=start.by,
        seconds=start.seconds,
        safety_margin_m=None if usual(start) else start.safety_margin,
    )
    if assumed is not None:
        files[assumed] = cmbot.scene.limits_text(robot.joints, robot.limits)
    return _Made(robot=robot, start=start, remarks=remarks, files=files)


def _always_near(asked: NewRobot, path: Path) -> tuple[str, str]:
    """The text of an SRDF that leaves out links which no motion can part, and a remark with their names."""
    from xml.etree import ElementTree

    text = cmbot.robot.srdf_text(asked.files())
    pairs = [pair for pair in ElementTree.fromstring(text) if pair.get("reason") == "Always"]
    names = ", ".join(f"{pair.get('link1')} and {pair.get('link2')}" for pair in pairs)
    return (
        text,
        f"Nearly always nearer to each other than the safety margin: {names}; {path} leaves them out.",
    )


def _loaded(asked: NewRobot, srdf: Path | None = None) -> Robot:
    """The robot; where an option mends an error, it is named."""
    try:
        return asked.load(srdf)
    except ModelError as error:
        raise _named_as_option(error) from error


def require_folders(places: Sequence[Path]) -> None:
    """Refuse a folder of ``--package-dir`` that is not there."""
    for place in places:
        if not place.is_dir():
            raise InputError("--package-dir", "", str(place), "a folder that exists")


def named_values(given: Sequence[str], option: str = "--xacro", example: str = "name=ur5e") -> dict[str, str]:
    """Return the arguments of xacro, or another option's values, by their names; each is ``NAME=VALUE``."""
    from cmbot.common.reading.validation import shown

    arguments: dict[str, str] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not (name.strip() and equals):
            raise InputError(option, "", shown(text), f"NAME=VALUE, such as {example}")
        arguments[name.strip()] = value
    return arguments


def _positions(given: Sequence[str], option: str, example: str) -> dict[str, float]:
    named = named_values(given, option, example)
    try:
        return {name: float(value) for name, value in named.items()}
    except ValueError as error:
        raise InputError(option, "", " ".join(given), "NAME=NUMBER, in rad or m") from error


def _named_as_option(error: ModelError) -> InputError:
    """Return an error of a robot's files that an option mends with that option as its source."""
    argument = error.key.partition("xacro.")[2]
    option = f"--xacro {argument}=VALUE" if argument else _REMEDY_OPTIONS.get(error.key.partition(".")[0])
    expected = error.expected.replace("base_frame: ", "--base ")
    return error if option is None else InputError(option, "", error.got, expected, error.choices)


def _obstacles(source: str) -> tuple[Obstacle, ...]:
    """What a scene without obstacles of its own has: the default guardrail, for the robot that holds it."""
    if source != _SHIPPED_ROBOT:
        return ()
    guardrail = cmbot.scene.elastic_guardrail(cmbot.scene.GuardrailFile())
    return cmbot.scene.guardrail_obstacles(guardrail)


def _schema(path: Path) -> str:
    """How a scene names its JSON Schema: beside it, from it in a checkout, else where cmbot is installed."""
    schema, folder = scene_folder().resolve() / "scene.schema.json", path.resolve().parent
    if (folder / schema.name).is_file():
        return schema.name
    return os.path.relpath(schema, folder) if folder.is_relative_to(schema.parents[1]) else str(schema)


def _slug(text: str) -> str:
    return _NOT_IN_SLUG.sub("_", text).strip("_-")[:100] or "scene"
