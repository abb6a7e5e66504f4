"""Options of commands that read a robot's files, and what a robot's errors call them."""

from __future__ import annotations

from collections.abc import Sequence

from cmbot.common.errors import InputError, ModelError
from cmbot.common.validation import shown

_OPTIONS = {"base_frame": "--base", "tool_frame": "--tool", "total_mass_kg": "--total-mass"}


def xacro_arguments(given: Sequence[str]) -> dict[str, str]:
    """Return the arguments of xacro by their names; each is ``NAME=VALUE``."""
    arguments: dict[str, str] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not (name.strip() and equals):
            raise InputError("--xacro", "", shown(text), "NAME=VALUE, such as name=ur5e")
        arguments[name.strip()] = value
    return arguments


def named_as_option(error: ModelError) -> InputError:
    """Return an error of a robot's files that an option mends with that option as its source."""
    argument = error.key.partition("xacro.")[2]
    option = f"--xacro {argument}=VALUE" if argument else _OPTIONS.get(error.key)
    return error if option is None else InputError(option, "", error.got, error.expected, error.choices)
