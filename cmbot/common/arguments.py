"""What is handed in from Python: of the right type and within its bounds, or one error that names it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cmbot.common.errors import InputError
from cmbot.common.validation import FileModel, key_path, shown, validated

__all__ = ["checked_options", "given_path", "plain", "require_fields", "require_type"]

T = TypeVar("T")


def require_type(value: object, kind: type | tuple[type, ...], source: str, key: str, expected: str) -> None:
    """Refuse what is of another type.

    Parameters
    ----------
    value : object
    kind : type or tuple of type
    source, key : str
        What it was handed to, and as what.
    expected : str
        What it should be.

    Raises
    ------
    InputError
    """
    if not isinstance(value, kind):
        got = shown(value) if isinstance(value, str | int | float) else type(value).__name__
        raise InputError(source, key, got, expected)


def given_path(value: object, source: str, key: str, expected: str) -> Path:
    """Return a path that was handed in.

    Raises
    ------
    InputError
        When it is neither text nor a path.
    """
    require_type(value, (str, Path), source, key, expected)
    return Path(value)  # type: ignore[arg-type]


def checked_options(model: type[T], options: object, source: str) -> T:
    """Return options when each is of its type and within its bounds.

    Parameters
    ----------
    model : type
        A dataclass with ``__pydantic_config__``.
    options : object
    source : str
        For messages.

    Raises
    ------
    InputError
        Naming the option, what it is and what it may be.
    """
    require_type(options, model, source, "", f"an instance of {model.__name__}")
    return validated(model, plain(options, source, ()), source, InputError)


def require_fields(instance: object, model: type[FileModel], source: str = "") -> None:
    """Check fields of a dataclass by a model of the same names; those that it does not have are left out.

    Parameters
    ----------
    instance : object
    model : type
        A pydantic model.
    source : str
        For messages; the name of its class if left out.

    Raises
    ------
    InputError
        Naming the field, what it is and what it should be.
    """
    source = source or type(instance).__name__
    data = {name: plain(getattr(instance, name), source, (name,)) for name in model.model_fields}
    validated(model, data, source, InputError)


def plain(value: object, source: str, steps: Sequence[str | int] = ()) -> Any:
    """Return a value as a file would hold it: mappings, lists, text, numbers.

    Parameters
    ----------
    value : object
    source : str
        For messages.
    steps : sequence of str or int
        Where in it.

    Raises
    ------
    InputError
        When something in it is none of these.
    """
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist(), source, steps)
    if isinstance(value, tuple | list):
        return [plain(item, source, (*steps, k)) for k, item in enumerate(value)]
    if isinstance(value, Mapping):
        return {str(key): plain(item, source, (*steps, str(key))) for key, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: plain(getattr(value, field.name), source, (*steps, field.name))
            for field in fields(value)
        }
    raise InputError(source, key_path(steps), shown(value), "text, a number or a list of them")
