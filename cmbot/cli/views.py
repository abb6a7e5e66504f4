"""The verbs of the command line that show a plan; `cmbot.cli` lists them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import cmbot
from cmbot.cli.console import ConsoleProgress, flat, out
from cmbot.common.errors import InputError

if TYPE_CHECKING:
    from cmbot.planning import Plan
    from cmbot.simulation import Tracking

__all__ = ["add_figures", "add_pages", "replay", "report"]

PlanArgument = Annotated[Path, typer.Argument(metavar="DIR", help="A plan directory.")]


def replay(
    directory: PlanArgument,
    html: Annotated[
        Path | None, typer.Option("--html", help="Page to write; DIR/replay.html if left out.")
    ] = None,
    serve: Annotated[bool, typer.Option("--serve", help="Serve the page on 127.0.0.1 instead.")] = False,
    video: Annotated[
        Path | None, typer.Option("--video", help="Film it instead, such as FILE.mp4; takes minutes.")
    ] = None,
) -> None:
    """Write a page that replays a plan in any browser, without a network.

    Example: [bold]cmbot replay out/triangle --html triangle.html[/bold]
    """
    ways = {"--html": html is not None, "--serve": serve, "--video": video is not None}
    if sum(ways.values()) > 1:
        given = ", ".join(name for name, wanted in ways.items() if wanted)
        raise InputError("cmbot replay", given, "both" if sum(ways.values()) == 2 else "all", "one of them")
    loaded = cmbot.load_plan(directory)
    tracking = cmbot.load_tracking(loaded, directory)
    if serve:
        from cmbot.views import ReplayServer, replay_page

        with ReplayServer(replay_page(loaded, tracking)) as server:
            try:
                out.print(f"Replay of {loaded.scene.name} at {server.url}; stop with Ctrl-C.")
                server.wait()
            except KeyboardInterrupt:
                return
    elif video is not None:
        _film(loaded, tracking, video)
        out.print(f"Written to {flat(video)}.")
    elif html is not None:
        cmbot.replay(loaded, html=html, tracking=tracking)
        out.print(f"Written to {flat(html)}.")
    else:
        from cmbot.views import REPLAY, replay_page

        out.print(f"Written to {flat(_add(directory, REPLAY, replay_page(loaded, tracking)))}.")


def report(
    directory: PlanArgument,
    html: Annotated[
        Path | None, typer.Option("--html", help="Page to write; DIR/report.html if left out.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace the file named with --html if it is there.")
    ] = False,
) -> None:
    """Write a page that says what a plan gains and what it keeps: replay, plots and tables.

    Tracking errors are in it when the plan has been simulated.

    Example: [bold]cmbot report out/triangle[/bold]
    """
    if html is not None and html.exists() and not force:
        raise InputError(str(html), "", "a file that is already there", "a new file, or --force")
    loaded = cmbot.load_plan(directory)
    tracking = cmbot.load_tracking(loaded, directory)
    if html is not None:
        cmbot.report(loaded, html=html, tracking=tracking)
        out.print(f"Written to {flat(html)}.")
    else:
        from cmbot.views import REPORT, report_page

        out.print(f"Written to {flat(_add(directory, REPORT, report_page(loaded, tracking)))}.")


def add_pages(planned: Plan, tracking: Tracking | None, directory: Path) -> tuple[Path, ...]:
    """Put replay and report into a plan directory, each whole or not at all."""
    from cmbot.archive import add_file
    from cmbot.views import pages

    return tuple(add_file(directory, name, page) for name, page in pages(planned, tracking).items())


def add_figures(result: Plan | Tracking, directory: Path) -> tuple[Path, ...]:
    """Put plots into a plan directory as PNG and SVG, each file whole or not at all."""
    from cmbot.archive import add_file
    from cmbot.views import figure_files, plot

    return tuple(add_file(directory, name, content) for name, content in figure_files(plot(result)))


def _add(directory: Path, name: str, page: str) -> Path:
    from cmbot.archive import add_file

    return add_file(directory, name, page.encode("utf-8", "replace"))


def _film(planned: Plan, tracking: Tracking | None, video: Path) -> None:
    from cmbot.views import film, replay_page

    page = replay_page(planned, tracking)
    with ConsoleProgress() as console_progress:
        console_progress.say("filming")
        film(page, video, progress=lambda share: console_progress.say(f"filming, {100 * share:.0f} %"))
