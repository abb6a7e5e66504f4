"""Robots whose files no test changes, loaded once in a process of tests."""

from pathlib import Path
from typing import Any

import numpy as np
from kept import Kept

from cmbot.common.robot_library import is_robot_name
from cmbot.robot import Robot, load_robot

# What `load_robot` reads files for.
_FILES = ("limits", "srdf", "elasticity", "package_dirs", "xacro", "tool")
# A search for stances asks for some hundred.
_ROBOTS = Kept[Robot](400)


def loaded(model: str | Path = "cmbot", **given: Any) -> Robot:
    """What `load_robot` returns, in its place: a robot, which nothing changes, for all who ask for it."""
    own_files = [name for name in _FILES if given.get(name)]
    if own_files or not is_robot_name(str(model)) or Path(model).exists():
        return load_robot(model, **given)
    exactly = {name: np.asarray(value).tolist() for name, value in sorted(given.items())}
    asked = repr([str(model), exactly])
    return _ROBOTS(asked, lambda: load_robot(model, **given))
