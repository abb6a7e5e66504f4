"""Write the figures in README.md anew, between their markers, from real runs.

Run it with ``python tools/document_figures.py`` after a change that moves them; ``--sensitivity`` also writes
the table of docs/assumptions.md, which takes minutes. tests/house/test_documents.py holds the README to it.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cmbot

ROOT = Path(__file__).resolve().parent.parent


def write_between(path: Path, marker: str, text: str) -> None:
    """Put `text` between ``<!-- marker -->`` and ``<!-- end of marker -->``."""
    start, end = f"<!-- {marker} -->", f"<!-- end of {marker} -->"
    old = path.read_text(encoding="utf-8")
    pattern = re.compile(f"{re.escape(start)}\n.*?{re.escape(end)}", re.DOTALL)
    new, count = pattern.subn(lambda _: f"{start}\n{text.strip()}\n{end}", old)
    if count != 1:
        sys.exit(f"{path}: {count} places marked {marker}, expected one")
    path.write_text(new, encoding="utf-8")


def output_of_plan() -> str:
    """Return what ``cmbot plan triangle`` prints on standard output."""
    with tempfile.TemporaryDirectory() as folder:
        command = [str(Path(sys.executable).with_name("cmbot")), "plan", "triangle"]
        done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    # Its first line is the table's header, which begins with blanks.
    return f"```text\n{done.stdout.rstrip()}\n```"


def table_of_figures() -> str:
    """Return the figures of both shipped scenes, as the plans print them."""
    lines = ["| | triangle, baseline | triangle, planned | line, baseline | line, planned |"]
    lines.append("|---|---|---|---|---|")
    plans = (cmbot.plan(cmbot.load_scene(name)) for name in ("triangle", "line"))
    for triangle, line in zip(*(plan.rows() for plan in plans), strict=True):
        lines.append(f"| {' | '.join((*triangle, *line[1:]))} |")
    return "\n".join(lines)


def table_of_tracking() -> str:
    """Return what bends under the triangle's motions: RMS of the tracking error, what is left of it."""
    scene = cmbot.load_scene("triangle")
    compensate = replace(scene.planner, compensate=True)
    plain, compensated = (
        cmbot.simulate(cmbot.plan(scene, options=options)) for options in (scene.planner, compensate)
    )
    figures = [motion.figures for motion in (plain.baseline, plain.planned, compensated.planned)]
    rows = {
        name: [getattr(each, part).rms[3] for each in figures]
        for name, part in (
            ("error, RMS", "total"),
            ("its dynamic part, RMS", "dynamic"),
            ("off the path, RMS", "path"),
        )
    }
    rows["after the stop, largest swing"] = [each.residual.diameter for each in figures]
    lines = ["| mm | baseline | planned | planned, compensated |", "|---|---|---|---|"]
    lines += [f"| {name} | {' | '.join(f'{1e3 * x:.3f}' for x in row)} |" for name, row in rows.items()]
    return "\n".join(lines)


def sensitivity(scene: str) -> str:
    """Return what ``tools/sensitivity.py`` prints of a scene."""
    command = [sys.executable, str(ROOT / "tools" / "sensitivity.py"), scene]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def main() -> None:
    """Write what was asked for."""
    parser = argparse.ArgumentParser(description="Write the documents' figures from real runs.")
    parser.add_argument("--sensitivity", action="store_true", help="the table of docs/assumptions.md too")
    arguments = parser.parse_args()
    write_between(ROOT / "README.md", "output of cmbot plan triangle", output_of_plan())
    write_between(ROOT / "README.md", "figures", table_of_figures())
    write_between(ROOT / "README.md", "tracking of the triangle", table_of_tracking())
    if arguments.sensitivity:
        write_between(ROOT / "docs" / "assumptions.md", "sensitivity of triangle", sensitivity("triangle"))


if __name__ == "__main__":
    main()
