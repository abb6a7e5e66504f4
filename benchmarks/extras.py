"""Packages that only some benchmarks need."""

from __future__ import annotations

import importlib
from typing import Any

from cmbot.common.errors import MissingExtra

__all__ = ["required"]


def required(package: str) -> Any:
    """Import a package of the extra ``bench``.

    Raises
    ------
    MissingExtra
        When it is not installed.
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise MissingExtra(package, "bench") from error
