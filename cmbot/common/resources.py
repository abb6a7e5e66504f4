"""Where the shipped models and scenes lie: beside the package in a checkout, inside it in a wheel."""

from __future__ import annotations

from pathlib import Path

__all__ = ["assumptions_file", "data_folder", "model_folder", "scene_folder"]

_PACKAGE = Path(__file__).resolve().parent.parent


def data_folder() -> Path:
    """Return the folder that holds ``models/`` and ``scenes/``."""
    inside_wheel = _PACKAGE / "_data"
    return inside_wheel if inside_wheel.is_dir() else _PACKAGE.parent


def model_folder() -> Path:
    """Return the folder with ``urdf/`` and ``meshes/``."""
    return data_folder() / "models"


def scene_folder() -> Path:
    """Return the folder with the shipped scene files."""
    return data_folder() / "scenes"


def assumptions_file() -> Path:
    """Return the page that lists every assumption, ``docs/assumptions.md``."""
    return data_folder() / "docs" / "assumptions.md"
