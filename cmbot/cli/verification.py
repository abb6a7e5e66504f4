"""The command that verifies what others wrote: `cmbot verify`."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cmbot.cli.console import JsonOption, QuietOption, flat, out, print_json, print_table
from cmbot.common.errors import InputError, MissingExtra

if TYPE_CHECKING:
    from cmbot.planning import Check

__all__ = ["verify"]

FolderArgument = Annotated[
    Path, typer.Argument(metavar="DIR", help="The folder of a plan, a walk or a tour.")
]
EngineOption = Annotated[
    str | None,
    typer.Option(
        "--engine",
        help="The second engine that has to be asked: mujoco, of the extra verify. Left out: where it is "
        "installed.",
    ),
]

SceneOption = Annotated[
    str | None,
    typer.Option(
        "--scene",
        metavar="SCENE",
        help="What was asked for: the folder has to be a plan, or a walk, of that scene, and to promise no "
        "less. Left out: what is promised is judged by what the folder says that was asked.",
    ),
]
ToOption = Annotated[
    Path | None,
    typer.Option("--to", metavar="FILE", help="Where the walk was to end: a scene, or a file of a stance."),
]


def verify(
    directory: FolderArgument,
    scene: SceneOption = None,
    to: ToOption = None,
    engine: EngineOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Certify what is in a folder anew, and compute it a second time by other means.

    Exit status 2, and one line that says what is wrong, where a promise is broken, two computations differ, a
    file beside the plan has another motion, or the folder is not what was asked for.

    Examples: [bold]cmbot verify out/triangle --scene triangle[/bold],
    [bold]cmbot verify out/triangle --engine mujoco[/bold]
    """
    import cmbot
    from cmbot.archive import verified_motions
    from cmbot.planning.verification.engine import ENGINE, is_installed, require_installed
    from cmbot.walking import load_goal

    if engine not in (None, ENGINE):
        raise InputError("cmbot verify", "--engine", engine, "a known engine", (ENGINE,))
    if engine is not None:
        require_installed()
    asked_scene = None if scene is None else cmbot.load_scene(scene)
    verdict = verified_motions(directory, asked_scene, None if to is None else load_goal(to))
    motions = verdict.motions
    if as_json:
        entries = [
            {"part": each.part, "name": each.name, "checks": [_entry(check) for check in each.checks]}
            for each in motions
        ]
        print_json(
            {
                "verb": "verify",
                "directory": str(directory),
                "scene": scene,
                "engine": ENGINE if is_installed() else None,
                "looser": verdict.looser,
                "motions": entries,
                "not_verified": verdict.not_verified,
            }
        )
        return
    for text in verdict.looser:
        out.print(flat(f"Promised otherwise than the scene in the folder asks: {text}."))
    if not quiet:
        rows = [(each.part, each.name, f"{each.seconds:.1f}", str(len(each.checks))) for each in motions]
        print_table("Verified", ("part", "motion", "seconds", "checks that hold"), rows, text_columns=2)
        out.print(flat("Certified anew, and computed a second time at 300 states of each motion."))
        if scene is None:
            out.print(flat("Judged by what the folder says that was asked: --scene SCENE names the scene."))
        out.print(flat(f"Not verified: {'; '.join(verdict.not_verified) or 'nothing'}."))
        missing = MissingExtra(ENGINE, "verify")
        asked = f"The second engine, {ENGINE}, was asked."
        out.print(flat(asked if is_installed() else f"The second engine was not asked: {missing}."))


def _entry(check: Check) -> dict[str, Any]:
    """A check for JSON, which has no infinite numbers: without shapes a clearance is one."""
    return {
        name: None if isinstance(value, float) and not isfinite(value) else value
        for name, value in asdict(check).items()
    }
