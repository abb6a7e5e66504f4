"""Try a release: install wheel and sdist into new environments, run the README's commands in an empty folder.

Run ``python tools/try_release.py dist`` with each Python that is supported, after
``python -m hatchling build``. It installs what cmbot depends on, plans and simulates for a minute, and says
which files it tried with which Python.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

# What README says, with a scene that takes little time.
_COMMANDS = (
    ("cmbot", "--version"),
    ("cmbot", "doctor"),
    ("cmbot", "scenes"),
    ("cmbot", "plan", "triangle", "--set", "time_limit_s=600"),
    ("cmbot", "simulate", "out/triangle"),
    ("cmbot", "replay", "out/triangle", "--html", "triangle.html"),
)
_PROGRAM = """
import cmbot
from importlib.resources import files
plan = cmbot.load_plan("out/triangle", verify=True)
print(cmbot.__version__, plan.summary().splitlines()[1])
assert (files("cmbot") / "py.typed").is_file()
"""


def attempt(file: Path) -> None:
    """Install a wheel or an sdist into an environment of its own, and use it in an empty folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run(sys.executable, "-m", "venv", str(folder / "venv"), where=folder)
        programs, empty = folder / "venv" / "bin", folder / "empty"
        empty.mkdir()
        run(str(programs / "pip"), "install", "--quiet", f"{file.resolve()}[fast]", where=empty)
        for command, *words in _COMMANDS:
            run(str(programs / command), *words, where=empty)
        run(str(programs / "python"), "-c", _PROGRAM, where=empty)


def run(*words: str, where: Path) -> None:
    """Run a command; one that fails ends the attempt with what it printed."""
    done = subprocess.run(words, cwd=where, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(words)}: status {done.returncode}\n{done.stdout}{done.stderr}")


def main() -> None:
    """Read the command line, try every wheel and sdist."""
    parser = argparse.ArgumentParser(description="Try the wheel and the sdist of a release.")
    parser.add_argument("folder", type=Path, help="with the wheel and the sdist, such as dist")
    files = sorted(
        path for path in parser.parse_args().folder.iterdir() if path.name.endswith((".whl", ".tar.gz"))
    )
    if not files:
        sys.exit("no wheel and no sdist")
    for file in files:
        attempt(file)
        print(f"{file.name} with Python {sys.version.split()[0]}: works")


if __name__ == "__main__":
    main()
