"""The robots of the optional package example-robot-data, by name."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path

LIBRARY, LIBRARY_EXTRA = "example-robot-data", "robots"
_LIBRARY_FOLDER = Path("share", "example-robot-data", "robots")
_LIBRARY_ROBOT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_\-]{0,99}")
# That package's own short names, where its URDF files are named otherwise.
_FILE_OF_SHORT_NAME = {
    "anymal_b": "anymal",
    "g1": "g1_29dof_rev_1_0",
    "hyq": "hyq_no_sensors",
    "talos": "talos_reduced",
    "talos_arm": "talos_left_arm",
    "talos_full": "talos_full_v2",
    "ur10": "ur10_robot",
    "ur3": "ur3_robot",
    "ur5": "ur5_robot",
}


def is_robot_name(text: str) -> bool:
    """Whether `text` could name a robot of the library: letters, digits, - and _ alone."""
    return _LIBRARY_ROBOT_NAME.fullmatch(text) is not None


def library_robots() -> dict[str, Path] | None:
    """Return the URDFs of example-robot-data by their names; None where it is not installed.

    A name is that of the URDF's file, or the package's short name for it.
    """
    folder = _folder()
    if folder is None:
        return None
    return dict(_robots_in(folder))


@cache
def _robots_in(folder: Path) -> Mapping[str, Path]:
    robots: dict[str, Path] = {}
    for path in sorted(folder.glob("*/*/*.urdf")):
        robots.setdefault(path.stem, path)
    return robots | {name: robots[stem] for name, stem in _FILE_OF_SHORT_NAME.items() if stem in robots}


def library_package() -> Path | None:
    """Return the folder of the ROS package that the library is; None where it is not installed."""
    folder = _folder()
    return None if folder is None else folder.parent


def _folder() -> Path | None:
    places = [Path(sys.prefix) / _LIBRARY_FOLDER]
    try:
        package = metadata.distribution(LIBRARY)
    except metadata.PackageNotFoundError:
        pass
    else:
        places.insert(0, Path(str(package.locate_file("cmeel.prefix"))) / _LIBRARY_FOLDER)
    return next((place for place in places if place.is_dir()), None)
