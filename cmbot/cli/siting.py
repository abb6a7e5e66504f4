"""The commands for stances and the steps between them: `cmbot stand`, `walk` and `tour`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

import cmbot
from cmbot.cli.console import (
    ConsoleProgress,
    ExitStatus,
    ForceOption,
    JsonOption,
    QuietOption,
    SceneArgument,
    complete_scene,
    flat,
    out,
    print_result,
    print_table,
    scenes_named,
)
from cmbot.cli.signals import interrupt_taken
from cmbot.common.errors import InputError, PlanningError
from cmbot.common.validation import plain

if TYPE_CHECKING:
    from cmbot.siting import Standing
    from cmbot.walking import Walk

__all__ = ["stand", "tour", "walk"]

_SHOWN = 10
_FILES = ("stances.csv", "index.html")
_MARK = "# Written by cmbot stand: the scene in its best stance.\n"
_WALK_FILES = ("walk.csv", "index.html", "replay.html")


ScenesArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="SCENE",
        help="Scene files, or names of shipped scenes, of jobs on one bridge.",
        autocompletion=complete_scene,
    ),
]

StancesFolderOption = Annotated[
    Path | None, typer.Option("--output", "-o", help="Folder to write; out/NAME_stances if left out.")
]
WalkFolderOption = Annotated[
    Path | None, typer.Option("--output", "-o", help="Folder to write; out/NAME_walk if left out.")
]
TourFolderOption = Annotated[
    Path | None, typer.Option("--output", "-o", help="New folder to write; out/NAME_tour if left out.")
]
ObjectiveOption = Annotated[
    str | None, typer.Option("--objective", help="torque or hold, in place of the scene's.")
]
PlansOption = Annotated[int, typer.Option("--plans", help="How many of the best stances to plan.", min=0)]
TourPlansOption = Annotated[
    int, typer.Option("--plans", help="How many of the best stances to plan for each group.", min=1)
]
SpacingOption = Annotated[float, typer.Option("--spacing", help="Metres between places of foot 1.", min=0.01)]
PairSpacingOption = Annotated[
    float, typer.Option("--pair-spacing", help="Metres between places of two feet.", min=0.05)
]
GoalOption = Annotated[
    Path, typer.Option("--to", help="Where to: a scene, or a file with foot_1 and foot_2.")
]
WalkSpacingOption = Annotated[
    float, typer.Option("--spacing", help="Metres between places of the feet.", min=0.05)
]
OneFootOption = Annotated[bool, typer.Option("--one-foot", help="Leave foot 2 free.")]
MaxTorqueOption = Annotated[
    float | None,
    typer.Option("--max-torque", help="Newton metres on the guardrail at work at most.", min=0.0),
]
SpeedOption = Annotated[
    float, typer.Option("--speed", help="Metres a second of a foot at most.", min=1e-3, max=1.0)
]
TimeLimitOption = Annotated[
    float | None,
    typer.Option("--time-limit", help="Seconds after which the best so far is kept.", min=0.0),
]
MembersOption = Annotated[
    list[str] | None,
    typer.Option(
        "--on", metavar="MEMBER", help="A post or rail that feet hold at work; may be repeated; else all."
    ),
]


def stand(
    scenes: ScenesArgument,
    output: StancesFolderOption = None,
    objective: ObjectiveOption = None,
    plans: PlansOption = 3,
    spacing: SpacingOption = 0.05,
    pair_spacing: PairSpacingOption = 0.15,
    one_foot: OneFootOption = False,
    max_torque: MaxTorqueOption = None,
    members: MembersOption = None,
    time_limit: TimeLimitOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> int:
    """Find where the robot should stand for jobs: stances screened by bounds, the best planned.

    For scenes of the shipped robot alone, an arm on a climber that holds a guardrail. Strokes that no
    stance does together are done from several, as few as possible. Writes a ranked table, a page with a
    map, and the scene with the best stance: best.yaml, or best_1.yaml and so on. The scene's own stance is
    planned first: no worse one is written. Ctrl-C keeps the best so far. Exit status 3 where none was
    planned.

    Examples: [bold]cmbot stand line --objective hold[/bold], then
    [bold]cmbot plan out/line_stances/best.yaml[/bold];
    [bold]cmbot stand left.yaml right.yaml -o out/both[/bold]
    """
    started = time.perf_counter()
    loaded = [cmbot.load_scene(scene) for scene in scenes]
    if objective is not None:
        wanted = _known(objective)
        loaded = [each.with_options(objective=wanted) for each in loaded]
    name = "_".join(each.name for each in loaded)
    directory = output if output is not None else Path("out") / f"{name}_stances"
    from cmbot.archive import STANCES_FILE, claim, require_absent, write_results
    from cmbot.siting import StandOptions
    from cmbot.siting import stand as find

    options = StandOptions(
        spacing=spacing,
        pair_spacing=float("inf") if one_foot else pair_spacing,
        plans=plans,
        members=tuple(members or ()),
        max_torque=float("inf") if max_torque is None else max_torque,
        time_limit=float("inf") if time_limit is None else time_limit,
    )
    with claim(directory):
        require_absent(directory, (*_FILES, STANCES_FILE, "best.yaml", "best_1.yaml"), force=force)
        with scenes_named(*scenes), ConsoleProgress(quiet=quiet) as progress:
            standings = find(loaded, options, progress.stage)
            stopped = any(standing.ended_by == "interrupt" for standing in standings)
            if stopped:
                interrupt_taken()
        summary = _summary(standings)
        write_results(directory, STANCES_FILE, summary, _contents(standings, name), force=force)
    if plans and not stopped:
        with scenes_named(*scenes):
            _require_planned(standings, directory)
    if as_json:
        print_result("stand", directory, summary)
    elif not quiet:
        _print_standings(standings)
        _print_written(directory, started)
    return ExitStatus.STOPPED if stopped else ExitStatus.DONE


def _require_planned(standings: Sequence[Standing], directory: Path) -> None:
    """Refuse a search without a plan, and say where the reasons are."""
    from cmbot.siting import require_planned

    try:
        require_planned(standings)
    except PlanningError as error:
        error.add_hint(f"{flat(directory / _FILES[0])} has the reason of each")
        raise


def _print_standings(standings: Sequence[Standing]) -> None:
    from cmbot.siting import shared_out

    for number, standing in enumerate(standings, start=1):
        _print_standing(standing, f"Stances {number}" if len(standings) > 1 else "Stances")
    for line in shared_out(standings):
        out.print(flat(line))


def _print_written(directory: Path, started: float) -> None:
    """Print where the results and their page are, and the seconds since the command began."""
    out.print(f"Written to {flat(directory)} in {time.perf_counter() - started:.1f} s.")
    out.print(f"Look at it: open {flat(directory / 'index.html')} in a browser.")


def _print_standing(standing: Standing, title: str) -> None:
    from cmbot.siting import bounds_table, in_words, planned_table

    headings, rows = planned_table(standing)
    if rows:
        print_table(f"{title}, planned", headings, rows, text_columns=2)
    headings, rows = bounds_table(standing, _SHOWN)
    if rows:
        print_table(f"{title}, not planned: bounds (estimates)", headings, rows, text_columns=4)
    for line in in_words(standing):
        out.print(flat(line))


def walk(
    scene: SceneArgument,
    to: GoalOption,
    output: WalkFolderOption = None,
    spacing: WalkSpacingOption = 0.15,
    speed: SpeedOption = 0.03,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Plan the steps from a scene's stance to another one: a foot lets go, swings, and holds again.

    For scenes of the shipped robot alone, an arm on a climber that holds a guardrail. Writes all joints
    over time, the steps with what was certified of them, and a page.

    Example: [bold]cmbot walk here.yaml --to out/line_stances/best.yaml[/bold]
    """
    started = time.perf_counter()
    loaded = cmbot.load_scene(scene)
    directory = output if output is not None else Path("out") / f"{loaded.name}_walk"
    from cmbot.archive import WALK_FILE, claim, require_absent
    from cmbot.walking import WalkOptions, load_goal
    from cmbot.walking import walk as find

    goal = load_goal(to)
    with claim(directory):
        require_absent(directory, (*_WALK_FILES, WALK_FILE), force=force)
        with scenes_named(scene), ConsoleProgress(quiet=quiet) as progress:
            walked = find(loaded, goal, WalkOptions(spacing=spacing, speed=speed), progress.stage)
        _write_walk(directory, walked, force=force)
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
        _print_written(directory, started)


def tour(
    scenes: ScenesArgument,
    output: TourFolderOption = None,
    plans: TourPlansOption = 3,
    spacing: WalkSpacingOption = 0.15,
    speed: SpeedOption = 0.03,
    members: MembersOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Plan work and walks: the fewest stances for all strokes, the job in each, the steps between them.

    For scenes of the shipped robot alone, an arm on a climber that holds a guardrail. Writes a folder
    with a plan directory for the work in each stance, a folder for each walk, and one page about all of
    it.

    Example: [bold]cmbot tour two_brackets --on top_rail[/bold], then open
    out/two_brackets_tour/index.html in a browser.
    """
    started = time.perf_counter()
    loaded = [cmbot.load_scene(scene) for scene in scenes]
    name = "_".join(each.name for each in loaded)
    directory = output if output is not None else Path("out") / f"{name}_tour"
    from cmbot.archive import TOUR_FILE, claim, new_folder, require_new_folder, write_results
    from cmbot.planning import Plan
    from cmbot.siting import StandOptions
    from cmbot.views import pages, tour_page
    from cmbot.walking import WalkOptions, tour_data
    from cmbot.walking import tour as find

    standing = StandOptions(plans=plans, pair_spacing=spacing, members=tuple(members or ()))
    with claim(directory):
        require_new_folder(directory)
        with scenes_named(*scenes), ConsoleProgress(quiet=quiet) as progress:
            found = find(loaded, standing, WalkOptions(spacing=spacing, speed=speed), progress.stage)
        data = tour_data(found)
        with new_folder(directory) as draft:
            for part_name, _, part in found.parts:
                if isinstance(part, Plan):
                    cmbot.save(part, draft / part_name, added=pages(part))
                else:
                    _write_walk(draft / part_name, part)
            write_results(draft, TOUR_FILE, data, {"index.html": tour_page(found).encode()})
    if as_json:
        print_result("tour", directory, data)
    elif not quiet:
        rows = [
            (part["name"], part["kind"], f"{part['begin']:.1f}", f"{part['seconds']:.1f}")
            for part in data["parts"]
        ]
        print_table("Tour", ("", "what", "begins, s", "seconds"), rows, text_columns=2)
        for line in found.in_words():
            out.print(flat(line))
        _print_written(directory, started)


def _write_walk(directory: Path, walked: Walk, *, force: bool = False) -> None:
    from cmbot.archive import WALK_FILE, write_results
    from cmbot.views import walk_page, walk_replay_page
    from cmbot.walking import walk_csv, walk_data

    files = (walk_csv(walked).encode(), walk_page(walked).encode(), walk_replay_page(walked).encode())
    contents = dict(zip(_WALK_FILES, files, strict=True))
    write_results(directory, WALK_FILE, walk_data(walked), contents, force=force)


def _known(objective: str) -> Literal["torque", "hold"]:
    match objective:
        case "torque" | "hold":
            return objective
    raise InputError("cmbot stand", "--objective", objective, "a known value", ("torque", "hold"))


def _contents(standings: Sequence[Standing], name: str) -> dict[str, bytes]:
    from cmbot.common.yaml_reader import yaml_text
    from cmbot.siting import best_scene, stances_csv
    from cmbot.views import stances_page

    texts = (stances_csv(standings), stances_page(standings, name))
    contents = dict(zip(_FILES, texts, strict=True))
    for number, each in enumerate(standings, start=1):
        if each.plans and each.best is None:
            continue
        file = "best.yaml" if len(standings) == 1 else f"best_{number}.yaml"
        contents[file] = (
            f"{_MARK}# Metres, seconds, degrees.\n{yaml_text(plain(best_scene(each), each.scene.name))}"
        )
    return {file: text.encode() for file, text in contents.items()}


def _summary(standings: Sequence[Standing]) -> dict[str, Any]:
    from cmbot.siting import in_words, shared_out

    each = [
        {
            "strokes": list(standing.strokes),
            "candidates": len(standing.ranked),
            **{name: standing.count(name.replace("_", " ")) for name in _STATUSES},
            "best": standing.ranked[0].place,
            "words": list(in_words(standing)),
        }
        for standing in standings
    ]
    return each[0] if len(each) == 1 else {"stances": each, "words": list(shared_out(standings))}


_STATUSES = ("planned", "screened", "failed", "too_much_torque", "blocked", "no_posture", "out_of_reach")
