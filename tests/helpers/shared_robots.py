"""Robots whose files no test changes, and what their feet need, found once in a process of tests."""

from pathlib import Path
from typing import Any

import numpy as np
from kept import Kept

from cmbot.common.arrays import FloatArray
from cmbot.common.robot_library import is_robot_name
from cmbot.hold.contact import Contact
from cmbot.robot import Robot, load_robot

# What `load_robot` reads files for.
_FILES = ("limits", "srdf", "elasticity", "package_dirs", "xacro", "tool")
# A search for stances asks for some hundred; a plan for the loads of tens of motions.
_ROBOTS = Kept[Robot](400)
_SLIPS = Kept[tuple[FloatArray, FloatArray]](300)
_slip = Contact.slip


def loaded(model: str | Path = "cmbot", **given: Any) -> Robot:
    """What `load_robot` returns, in its place: a robot, which nothing changes, for all who ask for it."""
    own_files = [name for name in _FILES if given.get(name)]
    if own_files or not is_robot_name(str(model)) or Path(model).exists():
        return load_robot(model, **given)
    exactly = {name: np.asarray(value).tolist() for name, value in sorted(given.items())}
    asked = repr([str(model), exactly])
    return _ROBOTS(asked, lambda: load_robot(model, **given))


def slips(contact: Contact, load: FloatArray, *given: Any, **named: Any) -> tuple[FloatArray, FloatArray]:
    """What `Contact.slip` returns, in its place, as a plan, its certificate and its table ask the same."""
    others = [np.asarray(value) for value in (load, *given, *named.values())]
    asked = (contact.outline, *named, *((each.shape, each.tobytes()) for each in others))
    value, slope = _SLIPS(asked, lambda: _slip(contact, load, *given, **named))
    return value.copy(), slope.copy()
