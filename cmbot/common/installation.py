"""Where the shipped models and scenes lie, and the command that installs optional packages."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

# The import name and the command are cmbot; that name is another project's on the package index.
DISTRIBUTION = "cmbot-planner"
_PACKAGE = Path(__file__).resolve().parent.parent
_CHECKOUT = _PACKAGE.parent


def data_folder() -> Path:
    """Return the folder with ``models/`` and ``scenes/``: inside the package in a wheel, else beside it."""
    inside_wheel = _PACKAGE / "_data"
    return inside_wheel if inside_wheel.is_dir() else _CHECKOUT


def model_folder() -> Path:
    """Return the folder with ``urdf/`` and ``meshes/``."""
    return data_folder() / "models"


def scene_folder() -> Path:
    """Return the folder with the shipped scene files."""
    return data_folder() / "scenes"


def shipped_scenes() -> tuple[str, ...]:
    """Return the names of the shipped scenes, in alphabetical order."""
    return tuple(sorted(path.stem for path in scene_folder().glob("*.yaml")))


def picture_folder() -> Path:
    """Return the folder with a picture of each shipped scene, ``NAME.png``."""
    return data_folder() / "docs" / "gallery"


def assumptions_file() -> Path:
    """Return the page that lists every assumption, ``docs/assumptions.md``."""
    return data_folder() / "docs" / "assumptions.md"


def install_command(extra: str) -> str:
    """Return the command that installs an extra such as ``fast``, from where cmbot was installed."""
    if (_CHECKOUT / "pyproject.toml").is_file():
        return f"pip install -e {quote(f'{_CHECKOUT}[{extra}]')}"
    return f"pip install {quote(f'{_installed_from()}[{extra}]')}"


def _installed_from() -> str:
    """The folder or wheel on this machine that pip installed (PEP 610); otherwise the distribution's name."""
    # Only where something is missing: they take a while to load.
    import json
    from importlib import metadata
    from urllib.parse import unquote, urlsplit

    try:
        recorded = metadata.distribution(DISTRIBUTION).read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        recorded = None
    url = urlsplit(json.loads(recorded)["url"] if recorded else "")
    path = unquote(url.path)
    return path if url.scheme == "file" and Path(path).exists() else DISTRIBUTION
