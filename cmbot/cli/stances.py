"""The commands for stances and the steps between them: `cmbot stand`, `walk` and `tour`."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cmbot
from cmbot.cli.command import Reporting, Writing, argument, option
from cmbot.cli.completion import complete_scene
from cmbot.cli.console import (
    ConsoleProgress,
    ExitStatus,
    interrupt_taken,
    out,
    print_lines,
    print_table,
    scenes_named,
)
from cmbot.cli.planning import changed_scene
from cmbot.common.errors import PlanningError, one_line

if TYPE_CHECKING:
    from cmbot.stances import StanceRanking

_MAX_ROWS = 10
_STANCE_FILES = ("stances.csv", "index.html")
_HEADER = "# Written by cmbot stand: the scene in a stance that was {}.\n# Metres, seconds, degrees.\n"
_NOT_PLANNED = "not planned, so that cmbot plan may fail"
_WALK_FILES = ("walk.csv", "index.html", "replay.html")


_SCENES_HELP = "Scene files, or names of shipped scenes, of jobs on one bridge."
_CHANGES_HELP = "As of cmbot plan, in every scene; repeatable."
_JOBS_HELP = "Processes that judge stances; left out, one for each processor, up to 4."
_MEMBERS_HELP = "A post or rail that feet hold at work; may be repeated; else all."


@dataclass(frozen=True, kw_only=True)
class StandCommand(Writing):
    """Find where the robot should stand for jobs: stances screened by bounds, the best planned.

    For the shipped robot, an arm on a climber that holds a guardrail, and for any arm with mounts in its
    scene. Strokes that no stance does together are done from several, as few as possible. A stance counts
    only with the way from the stow posture and back. Writes a ranked table, a page with a map, and the scene
    with the best stance: best.yaml, or best_1.yaml and so on; stance_2.yaml and so on have those of the next
    rows. The scene's own stance is planned first: no worse one is called the best. Ctrl-C keeps the best so
    far. Exit status 3 where none was planned.

    Examples: cmbot stand line --objective hold, then cmbot plan out/line_stances/best.yaml;
    cmbot stand left.yaml right.yaml -o out/both
    """

    scenes: tuple[str, ...] = argument(_SCENES_HELP, "SCENE", complete=complete_scene)
    output: Path | None = option(None, "Folder to write; out/NAME_stances if left out.", "--output", "-o")
    objective: Literal["torque", "hold", "sag", "sway"] | None = option(
        None, "torque, hold, sag or sway, in place of the scene's."
    )
    plans: int = option(3, "How many of the best stances to plan.", least=0)
    spacing: float = option(0.05, "Metres between places of foot 1.", least=0.01)
    pair_spacing: float | None = option(
        None, "Metres between places of two feet; 0.15, or up to 0.3 of more than 2000 stances.", least=0.05
    )
    one_foot: bool = option(False, "Leave foot 2 free.")
    max_base_torque_nm: float | None = option(None, "Torque on the base over the job.", least=0.0)
    max_adhesion_n: float | None = option(None, "Adhesion needed over the job.", least=0.0)
    max_sag_mm: float | None = option(None, "Sag of the tool at work.", least=0.0)
    any_sag: bool = option(False, "Without --max-sag-mm, leave no stance out by its sag.")
    max_sway_mm: float | None = option(None, "Sway by 1 m/s2 of the deck.", least=0.0)
    max_travel_deg: float | None = option(None, "Travel of all joints together.", least=0.0)
    max_seconds: float | None = option(None, "Duration of the job.", least=0.0)
    proofs: int = option(1000, "How many bounds of other mounts to prove.", least=0)
    members: tuple[str, ...] = option((), _MEMBERS_HELP, "--on", metavar="MEMBER")
    changes: tuple[str, ...] = option((), _CHANGES_HELP, "--set", metavar="NAME=VALUE")
    time_limit: float | None = option(None, "Seconds after which the best so far is kept.", least=0.0)
    jobs: int | None = option(None, _JOBS_HELP, least=1)

    def __call__(self) -> int:
        started = time.perf_counter()
        loaded = [changed_scene(scene, self.changes) for scene in self.scenes]
        name = "_".join(each.name for each in loaded)
        directory = self.output or Path("out") / f"{name}_stances"
        record, spacing = cmbot.archive.STANCES_FILE, float("inf") if self.one_foot else self.pair_spacing
        bounds = self.made(cmbot.stances.Bounds, "max_")
        jobs = _jobs(self.jobs)
        options = self.made(cmbot.stances.StandOptions, pair_spacing=spacing, bounds=bounds, jobs=jobs)

        def work(progress: ConsoleProgress) -> Sequence[StanceRanking]:
            rankings = cmbot.stances.stand(loaded, options, progress.stage)
            if _stopped(rankings):
                interrupt_taken()
            return rankings

        def write(rankings: Sequence[StanceRanking]) -> None:
            content, files = _summary(rankings), _contents(rankings, name)
            cmbot.archive.write_results(directory, record, content, files, force=self.force)

        def say() -> None:
            _print_rankings(rankings)
            print_lines(_judged_by(rankings, directory))
            _print_written(directory, started)

        files = (*_STANCE_FILES, record, "best.yaml", "best_1.yaml")
        rankings = self.work_in(directory, self.absent(directory, files), work, write, self.scenes)
        if self.plans and not _stopped(rankings):
            with scenes_named(*self.scenes):
                _require_planned(rankings, directory)
        self.answer(lambda: _summary(rankings), say, directory)
        return ExitStatus.STOPPED if _stopped(rankings) else ExitStatus.DONE


@dataclass(frozen=True, kw_only=True)
class WalkCommand(Writing):
    """Plan the steps from a scene's stance to another one: a foot lets go, swings, and holds again.

    For scenes of the shipped robot alone, an arm on a climber that holds a guardrail. Writes all joints
    over time, the steps with what was certified of them, and a page.

    Example: cmbot walk here.yaml --to out/line_stances/best.yaml
    """

    scene: str = argument("A scene file, or the name of a shipped scene.", "SCENE", complete=complete_scene)
    to: Path = option(MISSING, "Where to: a scene, or a file with foot_1 and foot_2.")
    output: Path | None = option(None, "Folder to write; out/NAME_walk if left out.", "--output", "-o")
    spacing: float = option(0.15, "Metres between places of the feet.", least=0.05)
    speed: float = option(0.03, "Metres a second of a foot at most.", least=1e-3, most=1.0)

    def __call__(self) -> None:
        started = time.perf_counter()
        loaded = cmbot.load_scene(self.scene)
        directory = self.output or Path("out") / f"{loaded.name}_walk"
        from cmbot.stances import walking

        goal, options = walking.load_goal(self.to), self.made(walking.WalkOptions)

        def say() -> None:
            rows = [
                (str(number), f"foot {step.foot}", *step.places, f"{step.seconds:.1f}")
                for number, step in enumerate(walked.steps, start=1)
            ]
            print_table("Steps", ("", "moves", "from", "to", "seconds"), rows, text_columns=4)
            print_lines(walked.in_words())
            _print_written(directory, started)

        walked = self.work_in(
            directory,
            self.absent(directory, (*_WALK_FILES, cmbot.archive.WALK_FILE)),
            lambda progress: walking.walk(loaded, goal, options, progress.stage),
            lambda walked: _write_walk(directory, walked, force=self.force),
            [self.scene],
        )
        self.answer(lambda: {"steps": len(walked.steps), "words": list(walked.in_words())}, say, directory)


@dataclass(frozen=True, kw_only=True)
class TourCommand(Reporting):
    """Plan work and walks: the fewest stances for all strokes, the job in each, the steps between them.

    For scenes of the shipped robot alone, an arm on a climber that holds a guardrail. Writes a folder
    with a plan directory for the work in each stance, a folder for each walk, and one page about all of
    it.

    Example: cmbot tour two_brackets --on top_rail, then open out/two_brackets_tour/index.html in a browser.
    """

    scenes: tuple[str, ...] = argument(_SCENES_HELP, "SCENE", complete=complete_scene)
    output: Path | None = option(None, "New folder to write; out/NAME_tour if left out.", "--output", "-o")
    plans: int = option(3, "How many of the best stances to plan for each group.", least=1)
    spacing: float = option(0.15, "Metres between places of the feet.", least=0.05)
    speed: float = option(0.03, "Metres a second of a foot at most.", least=1e-3, most=1.0)
    members: tuple[str, ...] = option((), _MEMBERS_HELP, "--on", metavar="MEMBER")
    changes: tuple[str, ...] = option((), _CHANGES_HELP, "--set", metavar="NAME=VALUE")
    jobs: int | None = option(None, _JOBS_HELP, least=1)

    def __call__(self) -> None:
        started = time.perf_counter()
        loaded = [changed_scene(scene, self.changes) for scene in self.scenes]
        name = "_".join(each.name for each in loaded)
        directory = self.output or Path("out") / f"{name}_tour"
        from cmbot.stances import StandOptions, walking

        ranking = StandOptions(
            plans=self.plans, pair_spacing=self.spacing, members=self.members, jobs=_jobs(self.jobs)
        )
        options = self.made(walking.WalkOptions)

        def say() -> None:
            rows = [
                (part["name"], part["kind"], f"{part['begin']:.1f}", f"{part['seconds']:.1f}")
                for part in walking.tour_data(found)["parts"]
            ]
            print_table("Tour", ("", "what", "begins, s", "seconds"), rows, text_columns=2)
            print_lines(found.in_words())
            _print_written(directory, started)

        found = self.work_in(
            directory,
            lambda: cmbot.archive.require_free(directory),
            lambda progress: walking.tour(loaded, ranking, options, progress.stage),
            lambda found: _write_tour(directory, found),
            self.scenes,
        )
        self.answer(lambda: walking.tour_data(found), say, directory)


def _jobs(asked: int | None) -> int:
    """How many processes judge stances."""
    # Imported where needed: other commands have no use for what it loads.
    from cmbot.common.workers import processors

    return asked or processors()


def _stopped(rankings: Sequence[StanceRanking]) -> bool:
    return any(ranking.ended_by == "interrupt" for ranking in rankings)


def _require_planned(rankings: Sequence[StanceRanking], directory: Path) -> None:
    """Refuse a search without a plan, and say where the reasons are."""
    try:
        cmbot.stances.require_planned(rankings)
    except PlanningError as error:
        one, reasons = rankings[0], one_line(directory / _STANCE_FILES[0])
        if len(rankings) == 1 and one.closest_in_time and next(iter(one.waiting)).bound:
            first, reasons = one_line(directory / "stance_1.yaml"), f"{_STANCE_FILES[0]} beside it"
            error.add_hint(f"cmbot plan {first} --set time_limit_s=600 judges the first")
        error.add_hint(f"{reasons} has the reason of each")
        error.add_hint("cmbot plan of the scene judges its own stance alone, --on MEMBER seeks on fewer")
        raise


def _print_rankings(rankings: Sequence[StanceRanking]) -> None:
    told = cmbot.stances
    for number, ranking in enumerate(rankings, start=1):
        title = f"Stances {number}" if len(rankings) > 1 else "Stances"
        print_table(f"{title}, planned", *told.planned_table(ranking), text_columns=2)
        others = told.bounds_table(ranking, _MAX_ROWS)
        print_table(f"{title}, {_NOT_PLANNED}: bounds (estimates)", *others, text_columns=4)
        print_lines(told.in_words(ranking))
    print_lines(told.shared_out(rankings))


def _print_written(directory: Path, started: float) -> None:
    """Print where the results and their page are, and the seconds since the command began."""
    out.print(f"Written to {one_line(directory)} in {time.perf_counter() - started:.1f} s.")
    out.print(f"Look at it: open {one_line(directory / 'index.html')} in a browser.")


def _write_tour(directory: Path, found: cmbot.Tour) -> None:
    from cmbot.stances.walking import tour_data

    with cmbot.archive.new_folder(directory) as draft:
        for part_name, _, part in found.parts:
            if isinstance(part, cmbot.Plan):
                cmbot.save(part, draft / part_name, added=cmbot.views.pages(part))
            else:
                _write_walk(draft / part_name, part)
        page = {"index.html": cmbot.views.tour_page(found).encode()}
        cmbot.archive.write_results(draft, cmbot.archive.TOUR_FILE, tour_data(found), page)


def _write_walk(directory: Path, walked: cmbot.Walk, *, force: bool = False) -> None:
    from cmbot.stances.walking import walk_csv, walk_data

    texts = (walk_csv(walked), cmbot.views.walk_page(walked), cmbot.views.walk_replay_page(walked))
    contents = {name: text.encode() for name, text in zip(_WALK_FILES, texts, strict=True)}
    record = cmbot.archive.WALK_FILE
    cmbot.archive.write_results(directory, record, walk_data(walked), contents, force=force)


def _contents(rankings: Sequence[StanceRanking], name: str) -> dict[str, bytes]:
    from cmbot.common.reading.validation import plain
    from cmbot.common.reading.yaml_reader import yaml_text

    texts = (cmbot.stances.stances_csv(rankings), cmbot.views.stances_page(rankings, name))
    contents = dict(zip(_STANCE_FILES, texts, strict=True))
    for number, each in enumerate(rankings, start=1):
        for rank, one in enumerate(each.ranked[:_MAX_ROWS], start=1):
            best = rank == 1 and (each.best is not None or not each.plans)
            judged = rank == 1 or not each.plans or one.stage in cmbot.stances.CHARTED
            if best or (judged and one.bound < float("inf")):
                scene = yaml_text(plain(cmbot.stances.best_scene(each, rank), each.scene.name))
                file = _file("best", rankings, number) if best else _file("stance", rankings, number, rank)
                was = "planned" if one.plan is not None else _NOT_PLANNED
                contents[file] = f"{_HEADER.format(was)}{scene}"
    return {file: text.encode() for file, text in contents.items()}


def _file(what: str, rankings: Sequence[StanceRanking], number: int, *rank: int) -> str:
    """The file of a scene of the ranking of a number: ``best_1.yaml``, ``stance_2.yaml``."""
    return f"{'_'.join(map(str, [what, *[number] * (len(rankings) > 1), *rank]))}.yaml"


def _judged_by(rankings: Sequence[StanceRanking], directory: Path) -> Iterator[str]:
    """Say what judges the first stance of each written ranking for which there was no time."""
    for number, ranking in enumerate(rankings, start=1):
        first = next(iter(ranking.waiting), None)
        if first is None or not ranking.closest_in_time:
            continue
        rank = ranking.ranked.index(first) + 1
        if (file := directory / _file("stance", rankings, number, rank)).is_file():
            yield f"cmbot plan {one_line(file)} --set time_limit_s=600 judges stance {rank} to the end."


def _summary(rankings: Sequence[StanceRanking]) -> dict[str, Any]:
    each = [
        {
            "strokes": list(ranking.strokes),
            "candidates": len(ranking.ranked),
            **{name.replace(" ", "_"): ranking.count(name) for name in cmbot.stances.STATUSES},
            "best": ranking.ranked[0].place,
            "figures": asdict(ranking.ranked[0].figures),
            "words": list(cmbot.stances.in_words(ranking)),
        }
        for ranking in rankings
    ]
    return each[0] if len(each) == 1 else {"stances": each, "words": list(cmbot.stances.shared_out(rankings))}
