"""ROS packages: where the one that a ``package://`` path or a ``$(find …)`` names lies, without ROS."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from xml.etree import ElementTree

from cmbot.common.errors import ModelError
from cmbot.common.reading.input_files import read_input
from cmbot.common.robot_library import LIBRARY, library_package

# Lists of folders below which packages are installed, in ``share``.
_PREFIX_VARIABLES = ("AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH", "CMAKE_PREFIX_PATH")


def find_package(name: str, folder: Path, package_dirs: Sequence[Path] = ()) -> Path | None:
    """Return the folder of a package, or None.

    Parameters
    ----------
    name : str
    folder : Path
        Of the file that names it.
    package_dirs : sequence of Path
        Folders of packages, or the packages themselves; they come first. Then come `folder`, those above it,
        and the folders that ROS's environment variables name, last the extra ``robots``. A package's folder
        has its name, or a ``package.xml`` with its name.
    """
    return next((place for place in _candidates(name, folder, package_dirs) if place.is_dir()), None)


def find_copy(inside: Sequence[str], folder: Path, package_dirs: Sequence[Path] = ()) -> Path | None:
    """Return the folder of a copy of a package that has another name, or None.

    It is one of `package_dirs`, `folder` or above it, and has one of the files `inside`.
    """
    places = (*package_dirs, folder, *folder.parents)
    return next((place for place in places if any((place / rest).is_file() for rest in inside)), None)


def find_resource(rest: str, folder: Path, package_dirs: Sequence[Path] = ()) -> Path | None:
    """Return the file ``package://rest``, or None; the other parameters are those of `find_package`.

    Where no package of that name has it, a folder above may: that of a copy that has another name.
    """
    name, _, inside = rest.lstrip("/").partition("/")
    above = (*package_dirs, folder, *folder.parents) if inside else ()
    places = (place / inside for place in chain(_candidates(name, folder, package_dirs), above))
    # Path.exists raises for names that no file can have.
    return next((place for place in places if os.path.exists(place)), None)  # noqa: PTH110


def _candidates(name: str, folder: Path, package_dirs: Sequence[Path]) -> Iterator[Path]:
    for place in (*package_dirs, folder, *folder.parents, *_ros_paths("ROS_PACKAGE_PATH")):
        # What lies below the root of all folders is the system's: etc is no package.
        if place != place.parent or place / name in folder.parents:
            yield place / name
        if name and _declared_name(place) == name:
            yield place
    for place in (place for variable in _PREFIX_VARIABLES for place in _ros_paths(variable)):
        yield place / "share" / name
    if name == LIBRARY and (package := library_package()) is not None:
        yield package


def _ros_paths(variable: str) -> Iterator[Path]:
    for place in os.environ.get(variable, "").split(os.pathsep):
        if place:
            yield Path(place)


def _declared_name(folder: Path) -> str:
    """The name in a folder's ``package.xml``; empty without one."""
    file = folder / "package.xml"
    if not file.is_file():
        return ""
    try:
        return (ElementTree.fromstring(read_input(file, ModelError)).findtext("name") or "").strip()
    except (ModelError, ElementTree.ParseError, ValueError, LookupError):
        return ""
