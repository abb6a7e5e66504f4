"""The verbs of the command line that show a plan, and the pages and plots that other verbs add to one."""

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

__all__ = ["add_pages", "add_plots", "replay", "report", "require_plots"]

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
    given = [name for name, value in (("--html", html), ("--serve", serve), ("--video", video)) if value]
    if len(given) > 1:
        got = "both" if len(given) == 2 else "all"
        raise InputError("cmbot replay", ", ".join(given), got, "one of them")
    loaded = cmbot.load_plan(directory)
    tracking = cmbot.load_tracking(loaded, directory)
    if html is not None:
        cmbot.replay(loaded, html=html, tracking=tracking)
        out.print(f"Written to {flat(html)}.")
        return
    from cmbot.views import REPLAY, ReplayServer, film, replay_page

    page = replay_page(loaded, tracking)
    if serve:
        with ReplayServer(page) as server:
            try:
                out.print(f"Replay of {loaded.scene.name} at {server.url}; stop with Ctrl-C.")
                server.wait()
            except KeyboardInterrupt:
                return
    elif video is not None:
        with ConsoleProgress() as progress:
            progress.stage("filming")
            film(page, video, progress=lambda share: progress.stage(f"filming, {100 * share:.0f} %"))
        out.print(f"Written to {flat(video)}.")
    else:
        out.print(f"Written to {flat(_add(directory, REPLAY, page))}.")


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


def require_plots(wanted: bool) -> None:
    """Refuse plots that are wanted where matplotlib is missing, before a long computation."""
    if wanted:
        from cmbot.views import require_matplotlib

        require_matplotlib()


def add_plots(result: Plan | Tracking, directory: Path) -> tuple[Path, ...]:
    """Put plots into a plan directory as PNG and SVG, each file whole or not at all."""
    from cmbot.archive import add_file
    from cmbot.views import figure_files, plot

    return tuple(add_file(directory, name, content) for name, content in figure_files(plot(result)))


def _add(directory: Path, name: str, page: str) -> Path:
    from cmbot.archive import add_file

    return add_file(directory, name, page.encode("utf-8", "replace"))
