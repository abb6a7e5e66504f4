"""The wheel holds what the checkout holds, and works away from it."""

import json
import os
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

import cmbot
from cmbot.common.installation import DISTRIBUTION, data_folder, model_folder, scene_folder

ROOT = Path(__file__).resolve().parent.parent.parent
# Where each folder of the checkout lies in the wheel.
PLACES = {
    "cmbot": "cmbot",
    "studies/chang2021": "chang2021",
    "models": "cmbot/_data/models",
    "scenes": "cmbot/_data/scenes",
    "docs/gallery": "cmbot/_data/docs/gallery",
}
ALONE = {"docs/assumptions.md": "cmbot/_data/docs/assumptions.md"}

LOOK = """
import json, pathlib
import cmbot
from cmbot.common.installation import data_folder
scene, robot = cmbot.load_scene("triangle"), cmbot.load_robot()
print(json.dumps({
    "package": str(pathlib.Path(cmbot.__file__).parent),
    "data": str(data_folder()),
    "version": cmbot.__version__,
    "scene": scene.content_hash,
    "robot": robot.content_hash,
    "urdf": str(robot.urdf),
}))
"""


def python(*words: str, cwd: Path, path: str = "") -> str:
    """What ``python WORDS`` prints, with `path` alone on the search path."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "PYTHON"))
    }
    done = subprocess.run(
        [sys.executable, *words],
        cwd=cwd,
        env=environment | ({"PYTHONPATH": path} if path else {}),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    python("-m", "hatchling", "build", "-t", "wheel", "-d", str(folder), cwd=ROOT)
    (wheel,) = folder.iterdir()
    return wheel


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of its own with the wheel in it; what cmbot depends on comes from the environment."""
    target = tmp_path_factory.mktemp("installed")
    quiet = ("--quiet", "--disable-pip-version-check", "--no-compile")
    where = ("--no-deps", "--no-index", "--target", str(target))
    python("-m", "pip", "install", *quiet, *where, str(wheel), cwd=target)
    return target


def expected_files() -> dict[str, Path]:
    """From its name in the wheel, each file of the checkout that belongs there."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", *PLACES]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("only git knows which files belong to the project")
    files = {place: ROOT / name for name, place in ALONE.items()}
    for name in listed.split("\0"):
        top = next((each for each in PLACES if name.startswith(f"{each}/")), "")
        if (ROOT / name).is_file():
            files[PLACES[top] + name.removeprefix(top)] = ROOT / name
    return files


def test_the_wheel_holds_every_file_and_nothing_else_and_says_what_it_is(wheel: Path) -> None:
    expected = expected_files()
    assert {"cmbot/py.typed", "cmbot/views/page/replay.html", "cmbot/_data/scenes/line.yaml"} <= set(expected)
    with zipfile.ZipFile(wheel) as file:
        found = {name: file.read(name) for name in file.namelist() if not name.endswith("/")}
    info = f"cmbot_planner-{cmbot.__version__}.dist-info"
    names = ("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE")
    assert set(found) == set(expected) | {f"{info}/{name}" for name in names}
    for name, path in expected.items():
        assert found[name] == path.read_bytes(), name
    metadata = Parser().parsestr(found[f"{info}/METADATA"].decode())
    assert (metadata["Name"], metadata["Version"]) == (DISTRIBUTION, cmbot.__version__)
    assert metadata["License-Expression"] == "BSD-3-Clause"
    assert metadata["Requires-Python"] == ">=3.11"
    extras = {
        "bench",
        "campaign",
        "docs",
        "fast",
        "plots",
        "robots",
        "ros",
        "surfaces",
        "test",
        "verify",
        "video",
        "xacro",
    }
    assert set(metadata.get_all("Provides-Extra", [])) == extras
    assert "[console_scripts]\ncmbot = cmbot.__main__:main\n" in found[f"{info}/entry_points.txt"].decode()
    assert b"Root-Is-Purelib: true" in found[f"{info}/WHEEL"]


def test_the_wheel_finds_its_own_data(installed: Path, tmp_path: Path, cmbot_robot: cmbot.Robot) -> None:
    package, script = installed.resolve() / "cmbot", str(installed / "bin" / "cmbot")
    assert json.loads(python("-c", LOOK, cwd=tmp_path, path=str(installed))) == {
        "package": str(package),
        "data": str(package / "_data"),
        "urdf": str(package / "_data" / "models" / "urdf" / "cmbot.urdf"),
        "version": cmbot.__version__,
        "scene": cmbot.load_scene("triangle").content_hash,
        "robot": cmbot_robot.content_hash,
    }
    assert python(script, "--version", cwd=tmp_path, path=str(installed)) == f"{cmbot.__version__}\n"
    found = python(script, "doctor", cwd=tmp_path, path=str(installed))
    assert f"from {package}\n" in found
    assert "MISSING" not in found


def test_the_checkout_finds_its_data_beside_the_package() -> None:
    assert Path(cmbot.__file__).parent == ROOT / "cmbot", "this is to be tested in the checkout"
    assert data_folder() == ROOT
    assert (model_folder(), scene_folder()) == (ROOT / "models", ROOT / "scenes")
