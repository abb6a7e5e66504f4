"""What a bug report needs: versions, where things were loaded from, what is missing."""

from __future__ import annotations

import platform
import shutil
from dataclasses import dataclass
from importlib import metadata, util
from pathlib import Path

from cmbot.common.installation import install_command, model_folder, scene_folder
from cmbot.version import __version__

__all__ = ["Symptom", "examine"]

# The module of each required package.
_REQUIRED = {
    "pin": "pinocchio",
    "coal": "coal",
    "numpy": "numpy",
    "scipy": "scipy",
    "pydantic": "pydantic",
    "ruamel.yaml": "ruamel.yaml",
    "meshcat": "meshcat",
    "u-msgpack-python": "umsgpack",
    "yourdfpy": "yourdfpy",
    "trimesh": "trimesh",
    "threadpoolctl": "threadpoolctl",
    "typer": "typer",
    "rich": "rich",
}
_OPTIONAL = (("piqp", "fast"), ("matplotlib", "plots"), ("mujoco", "test"), ("hypothesis", "test"))


@dataclass(frozen=True, kw_only=True)
class Symptom:
    """One line of the examination.

    Attributes
    ----------
    name, found : str
    healthy : bool
        False when cmbot does not work without it and it is not there.
    """

    name: str
    found: str
    healthy: bool = True


def examine() -> list[Symptom]:
    """Look at the installation."""
    symptoms = [
        Symptom(name="cmbot", found=f"{__version__} from {Path(__file__).parent.parent}"),
        Symptom(name="python", found=f"{platform.python_version()} on {platform.platform()}"),
    ]
    symptoms += [_package(name, module) for name, module in _REQUIRED.items()]
    for name, extra in _OPTIONAL:
        version = _version(name)
        missing = f"not installed (optional: {install_command(extra)})"
        symptoms.append(Symptom(name=name, found=version or missing))
    for name, path in (
        ("model", model_folder() / "urdf" / "cmbot.urdf"),
        ("meshes", model_folder() / "meshes"),
        ("scenes", scene_folder() / "triangle.yaml"),
    ):
        found = str(path) if path.exists() else f"missing: {path}"
        symptoms.append(Symptom(name=name, found=found, healthy=path.exists()))
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    symptoms.append(Symptom(name="browser", found=browser or "none found (any browser opens the pages)"))
    return symptoms


def _package(name: str, module: str) -> Symptom:
    version, folder = _version(name), _folder(module)
    if version is None or folder is None:
        return Symptom(name=name, found=f"not installed (run: pip install {name})", healthy=False)
    return Symptom(name=name, found=f"{version} from {folder}")


def _folder(module: str) -> Path | None:
    try:
        spec = util.find_spec(module)
    except ModuleNotFoundError:  # not even the package around it is there
        return None
    return None if spec is None else Path(spec.origin or "").parent


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
