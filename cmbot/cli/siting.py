"""The verbs of the command line that look for a place to stand, and for the steps to get there."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import cmbot
from cmbot.cli.console import (
    ConsoleProgress,
    JsonOption,
    QuietOption,
    SceneArgument,
    flat,
    out,
    print_result,
    print_table,
)
from cmbot.common.errors import InputError

__all__ = ["stand", "walk"]

_SHOWN = 10
_FILES = ("stances.csv", "best.yaml", "index.html")
_WALK_FILES = ("walk.csv", "walk.json", "index.html")


def stand(
    scene: SceneArgument,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write; out/NAME_stances if left out.")
    ] = None,
    objective: Annotated[
        str | None, typer.Option("--objective", help="torque or hold, in place of the scene's.")
    ] = None,
    plans: Annotated[int, typer.Option("--plans", help="How many of the best stances to plan.", min=0)] = 3,
    spacing: Annotated[
        float, typer.Option("--spacing", help="Metres between places of foot 1.", min=0.01)
    ] = 0.05,
    pair_spacing: Annotated[
        float, typer.Option("--pair-spacing", help="Metres between places of two feet.", min=0.05)
    ] = 0.15,
    one_foot: Annotated[bool, typer.Option("--one-foot", help="Leave foot 2 free.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the files of an earlier search.")] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Find where the robot should stand for a scene's job: stances screened by bounds, the best planned.

    Writes a ranked table, a page with a map, and the scene with the best stance.

    Example: [bold]cmbot stand line --objective hold[/bold], then
    [bold]cmbot plan out/line_stances/best.yaml[/bold]
    """
    started = time.perf_counter()
    loaded = cmbot.load_scene(scene)
    if objective is not None:
        loaded = replace(loaded, planner=replace(loaded.planner, objective=_known(objective)))
    directory = output if output is not None else Path("out") / f"{loaded.name}_stances"
    from cmbot.archive import require_absent, write_files
    from cmbot.siting import StandOptions, in_words
    from cmbot.siting import stand as find

    require_absent(directory, _FILES, force=force)

    options = StandOptions(
        spacing=spacing, pair_spacing=float("inf") if one_foot else pair_spacing, plans=plans
    )
    with ConsoleProgress(quiet=quiet) as progress:
        progress.stage("listing stances", 0.0)
        standing = find(loaded, options, progress.stage)
    write_files(directory, _contents(standing), force=force)
    if as_json:
        print_result("stand", directory, _summary(standing))
    elif not quiet:
        rows = [
            (str(rank), each.place, each.status, each.judged, *each.figures)
            for rank, each in enumerate(standing.ranked[:_SHOWN], start=1)
        ]
        unit = standing.unit
        headings = ("", "stance", "status", "judged by", f"bound, {unit}", f"planned, {unit}")
        print_table("Stances", headings, rows, text_columns=4)
        for line in in_words(standing):
            out.print(flat(line))
        out.print(f"Written to {flat(directory)} in {time.perf_counter() - started:.1f} s.")


def walk(
    scene: SceneArgument,
    to: Annotated[Path, typer.Option("--to", help="Where to: a scene, or a file with foot_1 and foot_2.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder to write; out/NAME_walk if left out.")
    ] = None,
    spacing: Annotated[
        float, typer.Option("--spacing", help="Metres between places of the feet.", min=0.05)
    ] = 0.15,
    speed: Annotated[
        float, typer.Option("--speed", help="Metres a second of a foot at most.", min=1e-3, max=1.0)
    ] = 0.03,
    force: Annotated[bool, typer.Option("--force", help="Replace the files of an earlier walk.")] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Plan the steps from a scene's stance to another one: a foot lets go, swings, and holds again.

    Writes all joints over time, the steps with what was certified of them, and a page.

    Example: [bold]cmbot walk here.yaml --to out/line_stances/best.yaml[/bold]
    """
    started = time.perf_counter()
    loaded = cmbot.load_scene(scene)
    directory = output if output is not None else Path("out") / f"{loaded.name}_walk"
    from cmbot.archive import json_bytes, require_absent, write_files
    from cmbot.walking import WalkOptions, load_goal, walk_csv, walk_data
    from cmbot.walking import walk as find

    goal = load_goal(to)
    require_absent(directory, _WALK_FILES, force=force)
    with ConsoleProgress(quiet=quiet) as progress:
        progress.stage("listing stances", 0.0)
        walked = find(loaded, goal, WalkOptions(spacing=spacing, speed=speed), progress.stage)
    from cmbot.views import walk_page

    files = (walk_csv(walked).encode(), json_bytes(walk_data(walked)), walk_page(walked).encode())
    write_files(directory, dict(zip(_WALK_FILES, files, strict=True)), force=force)
    if as_json:
        print_result("walk", directory, {"steps": len(walked.steps), "words": list(walked.in_words())})
    elif not quiet:
        rows = [
            (str(number), f"foot {step.foot}", *step.places, f"{step.seconds:.1f}")
            for number, step in enumerate(walked.steps, start=1)
        ]
        print_table("Steps", ("", "moves", "from", "to", "seconds"), rows, text_columns=4)
        for line in walked.in_words():
            out.print(flat(line))
        out.print(f"Written to {flat(directory)} in {time.perf_counter() - started:.1f} s.")


def _known(objective: str) -> Literal["torque", "hold"]:
    match objective:
        case "torque" | "hold":
            return objective
    raise InputError("cmbot stand", "--objective", objective, "a known value", ("torque", "hold"))


def _contents(standing: Any) -> dict[str, bytes]:
    from cmbot.siting import best_scene, stances_csv
    from cmbot.views import stances_page

    files = (stances_csv(standing), _yaml(best_scene(standing)), stances_page(standing))
    return {name: text.encode() for name, text in zip(_FILES, files, strict=True)}


def _yaml(data: dict[str, Any]) -> str:
    """YAML in which JSON is valid: what `cmbot.load_scene` reads."""
    import json

    return f"# Written by cmbot stand: the scene in its best stance.\n{json.dumps(data, indent=2)}\n"


def _summary(standing: Any) -> dict[str, Any]:
    from cmbot.siting import in_words

    counts = {name: standing.count(name.replace("_", " ")) for name in _STATUSES}
    best = standing.ranked[0]
    return {
        "candidates": len(standing.ranked),
        **counts,
        "best": best.place,
        "words": list(in_words(standing)),
    }


_STATUSES = ("planned", "screened", "failed", "blocked", "no_posture", "out_of_reach")
