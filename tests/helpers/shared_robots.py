"""Robots whose files no test changes, loaded once by each process that runs tests."""

from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.common.robot_library import is_robot_name
from cmbot.robot import Robot, load_robot

# Those asked for last are kept; a search for stances asks for some hundred.
_MOST = 400
_KEPT: OrderedDict[str, Robot] = OrderedDict()
# What `load_robot` reads files for.
_FILES = ("limits", "srdf", "elasticity", "package_dirs", "xacro", "tool")


def loaded(model: str | Path = "cmbot", **given: Any) -> Robot:
    """What `load_robot` returns, in its place: a robot, which nothing changes, for all who ask for it."""
    own_files = [name for name in _FILES if given.get(name)]
    if own_files or not is_robot_name(str(model)) or Path(model).exists():
        return load_robot(model, **given)
    asked = repr([str(model), [(name, _exactly(value)) for name, value in sorted(given.items())]])
    if asked not in _KEPT:
        _KEPT[asked] = load_robot(model, **given)
        if len(_KEPT) > _MOST:
            _KEPT.popitem(last=False)
    _KEPT.move_to_end(asked)
    return _KEPT[asked]


def _exactly(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
