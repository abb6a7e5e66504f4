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


def verify(
    directory: FolderArgument,
    engine: EngineOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Certify what is in a folder anew, and compute it a second time by other means.

    Exit status 2, and one line that says what is wrong, where a promise is broken or two computations differ.

    Examples: [bold]cmbot verify out/triangle[/bold], [bold]cmbot verify out/triangle --engine mujoco[/bold]
    """
    from cmbot.archive import verified_motions
    from cmbot.planning.verification.engine import ENGINE, is_installed, require_installed

    if engine not in (None, ENGINE):
        raise InputError("cmbot verify", "--engine", engine, "a known engine", (ENGINE,))
    if engine is not None:
        require_installed()
    motions = verified_motions(directory)
    if as_json:
        entries = [
            {"part": each.part, "name": each.name, "checks": [_entry(check) for check in each.checks]}
            for each in motions
        ]
        asked = ENGINE if is_installed() else None
        print_json({"verb": "verify", "directory": str(directory), "engine": asked, "motions": entries})
    elif not quiet:
        rows = [(each.part, each.name, f"{each.seconds:.1f}", str(len(each.checks))) for each in motions]
        print_table("Verified", ("part", "motion", "seconds", "checks that hold"), rows, text_columns=2)
        out.print(flat("Certified anew, and computed a second time at 300 states of each motion."))
        missing = MissingExtra(ENGINE, "verify")
        asked = f"The second engine, {ENGINE}, was asked."
        out.print(flat(asked if is_installed() else f"The second engine was not asked: {missing}."))


def _entry(check: Check) -> dict[str, Any]:
    """A check for JSON, which has no infinite numbers: without shapes a clearance is one."""
    return {
        name: None if isinstance(value, float) and not isfinite(value) else value
        for name, value in asdict(check).items()
    }
