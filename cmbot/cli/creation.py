"""The command that writes a new scene: `cmbot new`."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cmbot
from cmbot.cli.command import Writing, option
from cmbot.cli.console import out
from cmbot.cli.views import require_new
from cmbot.common.errors import InputError, ModelError, one_line
from cmbot.common.installation import scene_folder

if TYPE_CHECKING:
    from cmbot.planning import StartPosture
    from cmbot.robot import Robot
    from cmbot.scene import Obstacle

_SHIPPED = "cmbot"
_NO_SLUG = re.compile(r"[^A-Za-z0-9_\-]+")
# Numbers of the command line are bounded as those of a scene file.
_LARGEST, _LARGEST_ANGLE = 1e4, 360.0


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
    tool: str | None = option(None, "Tool frame; left out: the only choice.", metavar="FRAME")
    package_dir: tuple[Path, ...] = option((), "Where package:// is sought first; repeatable.", metavar="DIR")
    output: Path | None = option(None, "Scene file to write; NAME.yaml if left out.", "--output", "-o")

    def __call__(self) -> None:
        source, tool_at = self.source, self.tool_at
        if source is None or tool_at is None:
            missing = "--from" if source is None else "--tool-at"
            raise InputError(missing, "", "nothing", "--from URDF and --tool-at X Y Z")
        path = self.output or Path(f"{_slug(Path(source).name.partition('.')[0])}.yaml")
        _require_applicable(source, self.base, self.tool, self.package_dir)
        robot = _loaded(source, self.base, self.tool, self.package_dir)
        require_new(path, self.force)
        made = _composed(robot, source, tool_at, self.rpy_deg, path, self.package_dir)
        from cmbot.archive import write_file

        # The scene last: it names the others.
        *others, scene_file = sorted(made.files, key=lambda file: file == path)
        for file in others:
            require_new(file, self.force)
        for file in (*others, scene_file):
            write_file(file, made.files[file].encode())
        written = [scene_file, *others]
        remarks = [*made.robot.remarks, *made.remarks]
        self.answer(
            lambda: {"files": [str(file) for file in written], "remarks": remarks},
            lambda: _print_new(made, remarks, written, shipped=source == _SHIPPED),
        )


def _require_applicable(source: str, base: str | None, tool: str | None, packages: tuple[Path, ...]) -> None:
    """Refuse frames and folders that the shipped robot does not need, and folders that are not there."""
    if source == _SHIPPED and (base, tool) != (None, None):
        raise InputError("--base, --tool", "", "frames", "none with --from cmbot: its frames are known")
    if packages and source == _SHIPPED:
        raise InputError("--package-dir", "", "a folder", "none with --from cmbot: its files are known")
    for place in packages:
        if not place.is_dir():
            raise InputError("--package-dir", "", str(place), "a folder that exists")


def _print_new(made: _Made, remarks: Sequence[str], written: Sequence[Path], *, shipped: bool) -> None:
    """Print what was written of a scene: the file and those beside it."""
    robot, start = made.robot, made.start
    joints = f"{robot.dof} joints from {robot.base_frame} to {robot.tool_frame}"
    out.print(one_line(f"{robot.name}: {joints}"))
    by = ", ".join(f"{x:g}" for x in start.by)
    out.print(f"A first leg takes the tool by ({by}) m in {start.seconds:g} s: put your own into tool_path.")
    if not shipped:
        out.print("The base is rigid: guardrail.stiffness says how it bends, base.name what it is.")
    for remark in remarks:
        out.print(one_line(remark))
    for limits in written[1:]:
        if limits.suffix == ".yaml":
            out.print(
                one_line(f"The assumed limits are in {limits}: put those of your robot's data sheet there.")
            )
    out.print(one_line(f"Written: {', '.join(map(str, written))}. Plan it: cmbot plan {written[0]}"))


@dataclass(frozen=True)
class _Made:
    """A robot, its start posture, what is to be said of both, and the texts of the files to write."""

    robot: Robot
    start: StartPosture
    remarks: tuple[str, ...]
    files: Mapping[Path, str]


def _composed(
    robot: Robot,
    source: str,
    tool_at: Numbers,
    rpy_deg: Numbers | None,
    path: Path,
    packages: tuple[Path, ...],
) -> _Made:
    """What is written: the scene, joint limits where the robot has none, an SRDF where its own blocks it."""
    import numpy as np

    from cmbot.planning import find_start
    from cmbot.robot import Kinematics, robot_files
    from cmbot.scene import PlannerOptions, limits_text, pose, scene_text

    def start_of(robot: Robot) -> StartPosture:
        return find_start(robot, _obstacles(source), np.array(tool_at), orientation)

    def usual(start: StartPosture) -> bool:
        return start.safety_margin == PlannerOptions().safety_margin_m

    orientation = None if rpy_deg is None else np.array(pose((0, 0, 0), np.radians(rpy_deg)))[:3, :3]
    start, srdf, files = start_of(robot), path.with_suffix(".srdf"), dict[Path, str]()
    remarks: tuple[str, ...] = ()
    shipped, own_limits = source == _SHIPPED, robot_files(source).limits is not None
    if not shipped and not usual(start):
        text, said = _always_near(source, packages, srdf)
        with tempfile.TemporaryDirectory() as folder:
            draft = Path(folder, srdf.name)
            draft.write_text(text, encoding="utf-8")
            freed = _loaded(source, robot.base_frame, robot.tool_frame, packages, draft)
        if usual(better := start_of(freed)):
            robot, start, files, remarks = freed, better, {srdf: text}, (said,)
    limits = path.with_name(f"{path.stem}.limits.yaml")
    assumed = None if shipped or own_limits else limits
    files[path] = scene_text(
        name=_slug(path.stem),
        schema=_schema(path),
        robot=_robot_entry(robot, source, path, assumed, srdf if srdf in files else None, packages),
        on_guardrail=shipped,
        posture=start.posture,
        prismatic=robot.limits.prismatic,
        tool_point=np.array(Kinematics(robot).tool_pose(start.posture).translation),
        keep=start.keep,
        by=start.by,
        seconds=start.seconds,
        safety_margin_m=None if usual(start) else start.safety_margin,
    )
    if assumed is not None:
        known = robot.limits
        files[assumed] = limits_text(robot.joints, known.acceleration, known.jerk, known.prismatic)
    return _Made(robot=robot, start=start, remarks=remarks, files=files)


def _always_near(source: str, packages: tuple[Path, ...], path: Path) -> tuple[str, str]:
    """The text of an SRDF that leaves out links which no motion can part, and a remark with their names."""
    from xml.etree import ElementTree

    from cmbot.robot import robot_files, srdf_text

    text = srdf_text(robot_files(source, package_dirs=packages))
    pairs = [pair for pair in ElementTree.fromstring(text) if pair.get("reason") == "Always"]
    names = ", ".join(f"{pair.get('link1')} and {pair.get('link2')}" for pair in pairs)
    return (
        text,
        f"Nearly always nearer to each other than the safety margin: {names}; {path} leaves them out.",
    )


def _loaded(
    source: str, base: str | None, tool: str | None, packages: tuple[Path, ...], srdf: Path | None = None
) -> Robot:
    """The robot; where a frame has to be chosen, the error names the option."""
    try:
        return cmbot.load_robot(source, base_frame=base, tool_frame=tool, package_dirs=packages, srdf=srdf)
    except ModelError as error:
        flag = {"base_frame": "--base", "tool_frame": "--tool"}.get(error.key)
        if flag is None:
            raise
        raise InputError(flag, "", error.got, error.expected, error.choices) from error


def _robot_entry(
    robot: Robot,
    source: str,
    path: Path,
    assumed: Path | None,
    srdf: Path | None,
    packages: tuple[Path, ...],
) -> dict[str, tuple[object, str]]:
    """The scene's ``robot:`` block, each value with its comment; `assumed` is the file of assumed limits."""
    entry: dict[str, tuple[object, str]] = {"model": (_model(source, path), "")}
    if source != _SHIPPED:
        entry["base_frame"] = (robot.base_frame, "")
        entry["tool_frame"] = (robot.tool_frame, "the frame that follows the tool path")
    if assumed is not None:
        entry["limits"] = (assumed.name, "accelerations and jerks, assumed: put your robot's there")
    if srdf is not None:
        entry["srdf"] = (srdf.name, "by sampling: which of its links need not be checked against each other")
    if packages:
        folder = path.resolve().parent
        entry["package_dirs"] = ([os.path.relpath(place.resolve(), folder) for place in packages], "")
    return entry | {"payload_kg": (0.0, "point mass at the tool")}


def _obstacles(source: str) -> tuple[Obstacle, ...]:
    """What a scene without obstacles of its own has: the default guardrail, for the robot that holds it."""
    from cmbot.scene import GuardrailFile, elastic_guardrail, guardrail_obstacles

    return guardrail_obstacles(elastic_guardrail(GuardrailFile())) if source == _SHIPPED else ()


def _model(source: str, path: Path) -> str:
    """How the scene file names the robot: a URDF relative to it, or the name as it is."""
    if source == _SHIPPED or not Path(source).exists():
        return source
    return os.path.relpath(Path(source).resolve(), path.resolve().parent)


def _schema(path: Path) -> str:
    """How a scene names its JSON Schema: beside it, from it in a checkout, else where cmbot is installed."""
    schema, folder = scene_folder().resolve() / "scene.schema.json", path.resolve().parent
    if (folder / schema.name).is_file():
        return schema.name
    return os.path.relpath(schema, folder) if folder.is_relative_to(schema.parents[1]) else str(schema)


def _slug(text: str) -> str:
    return _NO_SLUG.sub("_", text).strip("_-")[:100] or "scene"
