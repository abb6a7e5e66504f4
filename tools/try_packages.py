"""Try what others install: the conda recipe, wheels for macOS, the Dockerfile.

``make packages`` runs it. The recipe has to ask for what pyproject.toml does.
For macOS pip resolves the dependencies to wheels, and installs none. The image is built where a Docker daemon
answers; elsewhere its RUN lines are run in a new environment.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from rattler_build import Stage0Recipe

ROOT = Path(__file__).resolve().parent.parent
PACKAGING = ROOT / "packaging"
# Names of conda-forge that differ from those of Python's index.
CONDA_NAMES = {"pin": "pinocchio", "meshcat": "meshcat-python"}
MACS = ("macosx_14_0_arm64", "macosx_13_0_x86_64")


def try_recipe() -> None:
    """Render the recipe; its version and its dependencies are those of the project."""
    text = (PACKAGING / "recipe.yaml").read_text(encoding="utf-8")
    rendered = Stage0Recipe.from_yaml(text).render()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = {_conda_name(each) for each in project["dependencies"]} | {f"python {project['requires-python']}"}
    recipe = rendered[0].recipe
    told = {str(each) for each in recipe.requirements.run}
    if asked != told:
        sys.exit(f"recipe.yaml and pyproject.toml differ: {sorted(asked ^ told)}")
    source = (ROOT / "cmbot" / "version.py").read_text(encoding="utf-8")
    version = re.search(r'__version__ = "(.+)"', source)
    if version is None or str(recipe.package.version) != version[1]:
        sys.exit(f"recipe.yaml has version {recipe.package.version}")
    print(f"recipe.yaml: {recipe.package.name} {recipe.package.version}, {len(told)} dependencies as asked")


def _conda_name(requirement: str) -> str:
    name, bounds = re.match(r"([\w.-]+?)(?=[<>=])(.*)", requirement).groups()  # type: ignore[union-attr]
    return f"{CONDA_NAMES.get(name, name)} {bounds}"


def try_macs() -> None:
    """Resolve what cmbot and its extra `fast` depend on to wheels for macOS."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["fast"]]
    for platform in MACS:
        words = ["install", "--dry-run", "--ignore-installed", "--target", "unused", "--only-binary=:all:"]
        words += ["--platform", platform, "--python-version", "3.12", "--report", "-", "--quiet", *asked]
        pip = [sys.executable, "-m", "pip", *words]
        report = subprocess.run(pip, check=True, stdout=subprocess.PIPE, text=True).stdout
        print(f"{platform}, Python 3.12: {len(json.loads(report)['install'])} wheels")


def try_image() -> None:
    """Build the image, or run its steps."""
    file = PACKAGING / "Dockerfile"
    if subprocess.run(["docker", "info"], capture_output=True, check=False).returncode == 0:
        subprocess.run(["docker", "build", "-q", "-f", str(file), "-t", "cmbot", str(ROOT)], check=True)
        print("Dockerfile: built")
        return
    steps = re.findall(r"^RUN (.+)$", file.read_text(encoding="utf-8"), re.MULTILINE)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        environment["PATH"] = f"{folder}/bin:{environment['PATH']}"
        for step in steps:
            command = step.replace("/src", str(ROOT))
            subprocess.run(command, shell=True, check=True, cwd=folder, env=environment)
    print(f"Dockerfile: no daemon answers; its {len(steps)} steps ran in a new environment")


if __name__ == "__main__":
    try_recipe()
    try_macs()
    try_image()
