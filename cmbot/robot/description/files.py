"""The files of a robot: of the shipped one, of a URDF, or of a robot of example-robot-data by its name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cmbot.common.errors import MissingExtra, ModelError
from cmbot.common.input_files import is_file, read_input
from cmbot.common.installation import model_folder
from cmbot.common.representation import short_repr
from cmbot.common.robot_library import LIBRARY, LIBRARY_EXTRA, is_robot_name, library_robots, library_srdf
from cmbot.common.validation import given_path, hint
from cmbot.common.yaml_reader import LARGEST_FILE

__all__ = ["RobotFiles", "robot_files"]

_SHIPPED = "cmbot"
# MoveIt's files of joint limits have the same name. One of ours that lacks its format is known by its keys.
_OUR_LIMITS = re.compile(
    r"""^\ufeff?(?:\{\s*)?["']?format["']?\s*:\s*["']?cmbot-|\b(?:acceleration_deg|jerk_deg|\w+_m_s[23])\b""",
    re.M,
)


@dataclass(frozen=True, kw_only=True)
class RobotFiles:
    """Where a robot is described.

    Attributes
    ----------
    urdf : pathlib.Path
    srdf, limits, elasticity : pathlib.Path or None
        SRDF, joint limits, and which links bend; None where there is none.
    package_dirs : tuple of pathlib.Path
        Where the packages are sought first that the URDF names.
    base_frame, tool_frame : str or None
        Of the shipped robot's arm.
    left_alone : pathlib.Path or None
        A ``joint_limits.yaml`` beside the URDF that is of another kind, such as MoveIt's.
    """

    urdf: Path
    srdf: Path | None
    limits: Path | None
    elasticity: Path | None
    package_dirs: tuple[Path, ...]
    base_frame: str | None = None
    tool_frame: str | None = None
    left_alone: Path | None = None

    __repr__ = short_repr


def robot_files(
    model: str | Path,
    *,
    srdf: str | Path | None = None,
    limits: str | Path | None = None,
    elasticity: str | Path | None = None,
    package_dirs: Sequence[str | Path] = (),
) -> RobotFiles:
    """Return the files of a robot; those that are not given are sought beside the URDF.

    The parameters are those of `load_robot`.

    Raises
    ------
    ModelError
        When there is no such robot, an argument is no path, or a file of joint limits beside the URDF cannot
        be read.
    MissingExtra
        When `model` is no file but could be a robot of example-robot-data, and that is not installed.
    """
    frames: dict[str, str] = {}
    near: Path | None = None
    if str(model) == _SHIPPED:
        urdf = model_folder() / "urdf" / "cmbot.urdf"
        frames = {"base_frame": "arm_base", "tool_frame": "tool0"}
    else:
        urdf = given_path(model, "load_robot", "model", "cmbot, a robot's name, or the path of a URDF")
        # A folder of that name may be the robot's plan.
        if is_robot_name(str(model)) and not is_file(urdf):
            urdf = _in_library(str(model))
            near = library_srdf(urdf)
    beside = None if limits is not None else _existing(urdf.with_name("joint_limits.yaml"))
    foreign = beside is not None and _is_foreign(beside)
    return RobotFiles(
        urdf=urdf,
        srdf=_given("srdf", srdf) or _existing(urdf.with_suffix(".srdf")) or near,
        limits=_given("limits", limits) or (None if foreign else beside),
        elasticity=_given("elasticity", elasticity) or _existing(urdf.with_suffix(".elasticity.yaml")),
        package_dirs=tuple(
            given_path(place, "load_robot", "package_dirs", "the paths of folders").resolve()
            for place in package_dirs
        ),
        left_alone=beside if foreign else None,
        **frames,
    )


def _in_library(name: str) -> Path:
    robots = library_robots()
    names = (_SHIPPED, *(() if robots is None else robots))
    if robots is not None and name in robots:
        return robots[name]
    meant = hint(name, names)
    if robots is None and not meant:
        missing = MissingExtra(LIBRARY, LIBRARY_EXTRA)
        missing.add_hint(f"{name} is no file, and may be a robot of that package")
        raise missing
    raise ModelError(name, "", "no such file", f"a URDF file, or the name of a robot{meant}", names)


def _given(key: str, path: str | Path | None) -> Path | None:
    return None if path is None else given_path(path, "load_robot", key, "the path of a file")


def _existing(path: Path) -> Path | None:
    return path if path.exists() else None


def _is_foreign(limits: Path) -> bool:
    """Whether a file of joint limits has something in it, and nothing that only ours have."""
    text = read_input(limits, ModelError, largest=LARGEST_FILE).decode("utf-8", "replace")
    return bool(text.strip()) and _OUR_LIMITS.search(text) is None
