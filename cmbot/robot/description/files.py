"""The files of a robot: of the shipped one, of a URDF, or of a robot of example-robot-data by its name."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from cmbot.common.errors import MissingExtra, ModelError
from cmbot.common.installation import model_folder
from cmbot.common.reading.input_files import is_file, read_input
from cmbot.common.reading.validation import given_path, hint
from cmbot.common.reading.yaml_reader import LARGEST_FILE
from cmbot.common.representation import ShortRepr
from cmbot.common.robot_library import LIBRARY, LIBRARY_EXTRA, is_robot_name, library_robots
from cmbot.robot.description.completion import AttachedTool
from cmbot.robot.description.limits_file import read_joint_limits
from cmbot.robot.description.xacro import ROBOT_NAME
from cmbot.robot.description.xml_file import read_urdf

_SHIPPED_ROBOT = "cmbot"
# A file of joint limits of ours that lacks its format is known by its keys.
_CMBOT_LIMITS = re.compile(
    r"""^\ufeff?(?:\{\s*)?["']?format["']?\s*:\s*["']?cmbot-"""
    r"""|\b(?:velocity_deg|acceleration_deg|jerk_deg|\w+_m_s[23]?|masses_kg|holding_torque)\b""",
    re.M,
)
# Where ROS packages have files of joint limits, from the URDF's folder, and SRDFs.
_LIMITS_PLACES, _SRDF_PLACES = (".", "../config", "config"), (".", "../srdf", "../config", "config")


@dataclass(frozen=True, kw_only=True)
class RobotFiles(ShortRepr):
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
    left_alone : tuple of pathlib.Path and str, or None
        A ``joint_limits.yaml`` near the URDF that is of another kind than cmbot's and MoveIt's, and why.
    xacro : mapping of str to str
        Arguments of xacro.
    total_mass : float or None
        Mass of the whole robot, kg, that is spread over the links without one.
    tool : AttachedTool or None
        That is fixed to the tool frame.
    """

    urdf: Path
    srdf: Path | None
    limits: Path | None
    elasticity: Path | None
    package_dirs: tuple[Path, ...]
    base_frame: str | None = None
    tool_frame: str | None = None
    left_alone: tuple[Path, str] | None = None
    xacro: Mapping[str, str] = field(default_factory=dict)
    total_mass: float | None = None
    tool: AttachedTool | None = None

    def read(self) -> tuple[bytes, ElementTree.Element]:
        """Return the content of the URDF, xacro expanded, and its tree as it stands there.

        Raises
        ------
        ModelError, MissingExtra
            As `read_urdf`.
        """
        return read_urdf(self.urdf, package_dirs=self.package_dirs, arguments=self.xacro)


def robot_files(
    model: str | Path,
    *,
    srdf: str | Path | None = None,
    limits: str | Path | None = None,
    elasticity: str | Path | None = None,
    package_dirs: Sequence[str | Path] = (),
    xacro: Mapping[str, str] | None = None,
    total_mass: float | None = None,
    tool: AttachedTool | None = None,
) -> RobotFiles:
    """Return the files of a robot; those that are not given are sought where ROS packages have them.

    That is, beside the URDF, in ``../config`` and ``config``, and SRDFs in ``../srdf``: joint limits as
    ``joint_limits.yaml``, an SRDF by its name, which is the URDF's or what that begins with, or else the only
    one of a robot of the URDF's name.

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
    if str(model) == _SHIPPED_ROBOT:
        urdf = model_folder() / "urdf" / "cmbot.urdf"
        frames = {"base_frame": "arm_base", "tool_frame": "tool0"}
    else:
        urdf = given_path(model, "load_robot", "model", "cmbot, a robot's name, or the path of a URDF")
        # A folder of that name may be the robot's plan.
        if is_robot_name(str(model)) and not is_file(urdf):
            urdf = _in_library(str(model))
    places = (_near(urdf, place) / "joint_limits.yaml" for place in _LIMITS_PLACES)
    beside = None if limits is not None else next((place for place in places if place.exists()), None)
    foreign = None if beside is None else _why_foreign(beside)
    return RobotFiles(
        urdf=urdf,
        srdf=_given("srdf", srdf) or _srdf_near(urdf),
        limits=_given("limits", limits) or (None if foreign else beside),
        elasticity=_given("elasticity", elasticity) or _existing(urdf.with_suffix(".elasticity.yaml")),
        package_dirs=tuple(
            given_path(place, "load_robot", "package_dirs", "the paths of folders").resolve()
            for place in package_dirs
        ),
        left_alone=(beside, foreign) if beside and foreign else None,
        xacro=dict(xacro or {}),
        total_mass=total_mass,
        tool=tool,
        **frames,
    )


def _in_library(name: str) -> Path:
    robots = library_robots()
    names = (_SHIPPED_ROBOT, *(() if robots is None else robots))
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


def _near(urdf: Path, place: str) -> Path:
    """A folder by its path from the URDF's, without detours."""
    return Path(os.path.normpath(urdf.parent / place))


def _srdf_near(urdf: Path) -> Path | None:
    """The SRDF of a URDF, where a ROS package has it; None without one, or where it is not clear which."""
    beside = urdf.with_suffix(".srdf")
    if beside.exists():
        return beside
    stem, files = urdf.name.partition(".")[0], dict[Path, None]()
    for place in _SRDF_PLACES:
        # A folder that may not be read has none.
        with suppress(OSError):
            files |= dict.fromkeys(sorted(_near(urdf, place).glob("*.srdf")))
    named = [
        file for file in files if stem == file.stem or stem.startswith((f"{file.stem}_", f"{file.stem}-"))
    ]
    if named:
        return max(named, key=lambda file: len(file.stem))
    name = _robot_name(urdf) if files else None
    of_name = [file for file in files if name is not None and _robot_name(file) == name]
    return of_name[0] if len(of_name) == 1 else None


def _robot_name(file: Path) -> bytes | None:
    """The name that a URDF or an SRDF gives its robot."""
    with suppress(ModelError):  # who reads the file says what is wrong with it
        if found := ROBOT_NAME.search(read_input(file, ModelError)):
            return found[1]
    return None


def _why_foreign(limits: Path) -> str:
    """Why a file of joint limits is not used; empty for one of ours, or of MoveIt's that can be read."""
    text = read_input(limits, ModelError, largest=LARGEST_FILE).decode("utf-8", "replace")
    if not text.strip() or _CMBOT_LIMITS.search(text) is not None:
        return ""
    try:
        read_joint_limits(limits)
    except ModelError as error:
        return f"{error.key}: got {error.got}" if error.key else str(error.got)
    return ""
