"""The commands that show a plan, and what others need to add pages and plots to it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import cmbot
from cmbot.cli.console import ConsoleProgress, ForceOption, PlanArgument, flat, out
from cmbot.common.errors import InputError
from cmbot.common.input_files import is_folder

if TYPE_CHECKING:
    from cmbot.planning import Plan
    from cmbot.simulation import Tracking

__all__ = [
    "claimed_plan",
    "compare",
    "export",
    "plot_files",
    "replay",
    "report",
    "require_new",
    "require_plots",
]

# Seconds of motion in a second of a GIF.
_GIF_SPEED = 4.0
_LONGEST_SIZE = 12


ReplayedArgument = Annotated[
    Path, typer.Argument(metavar="DIR", help="A plan directory, or a walk's folder.")
]
HtmlOption = Annotated[
    Path | None, typer.Option("--html", help="Page to write; DIR/replay.html if left out.")
]
ServeOption = Annotated[bool, typer.Option("--serve", help="Serve the page on 127.0.0.1 instead.")]
VideoOption = Annotated[
    Path | None, typer.Option("--video", help="Film it instead, such as FILE.mp4; takes minutes.")
]
GifOption = Annotated[
    Path | None, typer.Option("--gif", help="Film it as a small GIF instead, four times as fast.")
]
FpsOption = Annotated[
    int | None, typer.Option("--fps", help="Frames a second of a film; left out: 30, of a GIF 10.")
]
SizeOption = Annotated[
    str | None,
    typer.Option("--size", metavar="WxH", help="Size of a film, px; left out: 1280x720, of a GIF 640x360."),
]
BendingOption = Annotated[
    float | None,
    typer.Option("--bending", help="Times by which a film magnifies deflections; left out: as the page."),
]
ColoursOption = Annotated[
    str | None, typer.Option("--colours", help="Of the arm in a film: own, load or strain; left out: own.")
]


def replay(
    directory: ReplayedArgument,
    html: HtmlOption = None,
    serve: ServeOption = False,
    video: VideoOption = None,
    gif: GifOption = None,
    fps: FpsOption = None,
    size: SizeOption = None,
    bending: BendingOption = None,
    colours: ColoursOption = None,
) -> None:
    """Write a page that replays a plan, or a walk, in any browser, without a network.

    A walk is certified again first.

    Example: [bold]cmbot replay out/triangle --html triangle.html[/bold]
    """
    kinds = (("--html", html), ("--serve", serve), ("--video", video), ("--gif", gif))
    given = [name for name, value in kinds if value]
    if len(given) > 1:
        got = "both" if len(given) == 2 else "all"
        raise InputError("cmbot replay", ", ".join(given), got, "one of them")
    filmed = video or gif
    shape = _size(size or ("640x360" if gif else "1280x720"))
    for name, value in (("--fps", fps), ("--size", size), ("--bending", bending), ("--colours", colours)):
        if value is not None and filmed is None:
            raise InputError("cmbot replay", name, str(value), "it with --video or --gif")
    from cmbot.archive import WALK_FILE, record_of
    from cmbot.views import REPLAY, replay_page

    is_walk = record_of(directory) == WALK_FILE
    if is_walk and filmed is None:
        _replay_walk(directory, html, serve=serve)
        return
    if not given:
        with claimed_plan(directory) as loaded:
            tracking = cmbot.load_tracking(loaded, directory)
            written = _add(directory, REPLAY, replay_page(loaded, tracking))
        out.print(f"Written to {flat(written)}.")
        return
    loaded = cmbot.load_plan(directory)
    tracking = cmbot.load_tracking(loaded, directory)
    if html is not None:
        cmbot.replay(loaded, html=html, tracking=tracking)
        out.print(f"Written to {flat(html)}.")
    elif serve:
        _serve(replay_page(loaded, tracking), loaded.scene.name)
    elif filmed is not None:
        page = replay_page(loaded, tracking)
        _film(page, filmed, shape, fps=fps, as_gif=gif is not None, bending=bending, colours=colours)


def _film(
    page: str,
    file: Path,
    size: tuple[int, int],
    *,
    fps: int | None,
    as_gif: bool,
    bending: float | None,
    colours: str | None,
) -> None:
    """Film a replay page, and print how long that took."""
    from cmbot.views import film

    if as_gif and file.suffix.lower() != ".gif":
        raise InputError("cmbot replay", "--gif", str(file), "a file whose name ends with .gif")
    started = time.perf_counter()
    with ConsoleProgress() as progress:
        progress.stage("filming", 0.0)
        frames = film(
            page,
            file,
            speed=_GIF_SPEED if as_gif else 1.0,
            fps=fps or (10 if as_gif else 30),
            size=size,
            bending=bending,
            colours=colours or "own",
            progress=lambda share: progress.stage("filming", share),
        )
    seconds = time.perf_counter() - started
    out.print(f"Written to {flat(file)}: {frames} frames in {seconds:.1f} s.")


def _serve(page: str, name: str) -> None:
    from cmbot.views import ReplayServer

    with ReplayServer(page) as server:
        try:
            out.print(f"Replay of {name} at {server.url}; stop with Ctrl-C.")
            server.wait()
        except KeyboardInterrupt:
            return


def _replay_walk(directory: Path, html: Path | None, *, serve: bool) -> None:
    from cmbot.archive import load_walk
    from cmbot.views import REPLAY, walk_replay_page, write_page

    walked = load_walk(directory)
    page = walk_replay_page(walked)
    if serve:
        _serve(page, walked.scene.name)
        return
    if html is not None:
        write_page(html, page)
    written = html or _add(directory, REPLAY, page)
    out.print(f"Written to {flat(written)}.")


def _size(text: str) -> tuple[int, int]:
    """Width and height from text such as 1280x720."""
    width, times, height = text.partition("x")
    if not (times and width.isdecimal() and height.isdecimal() and len(text) < _LONGEST_SIZE):
        raise InputError("cmbot replay", "--size", flat(text), "width and height, such as 1280x720")
    return int(width), int(height)


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
    if html is not None:
        loaded = cmbot.load_plan(directory)
        require_new(html, force)
        cmbot.report(loaded, html=html, tracking=cmbot.load_tracking(loaded, directory))
        out.print(f"Written to {flat(html)}.")
        return
    from cmbot.views import REPORT, report_page

    with claimed_plan(directory) as loaded:
        page = report_page(loaded, cmbot.load_tracking(loaded, directory))
        written = _add(directory, REPORT, page)
    out.print(f"Written to {flat(written)}.")


def compare(
    directories: Annotated[
        list[Path], typer.Argument(metavar="DIR", help="Plan directories of one arm, 2 to 6.")
    ],
    html: Annotated[Path, typer.Option("--html", help="Page to write.")] = Path("compare.html"),
    force: ForceOption = False,
) -> None:
    """Write a page that shows several plans together: overlaid in 3-D and in plots, figures side by side.

    Example: [bold]cmbot compare out/triangle out/pinned --html compare.html[/bold]
    """
    from cmbot.views import compare_page, write_page

    places = [directory.resolve() for directory in directories]
    if len(set(places)) < len(places):
        raise InputError("cmbot compare", "", "one directory more than once", "different plan directories")
    names = [flat(place.name) for place in places]
    # Folders of the same name are told apart by their paths.
    shown = [
        name if names.count(name) == 1 else flat(path) for name, path in zip(names, directories, strict=True)
    ]
    plans = dict(zip(shown, map(cmbot.load_plan, directories), strict=True))
    require_new(html, force)
    tracked = zip(plans.items(), directories, strict=True)
    page = compare_page(plans, {name: cmbot.load_tracking(plan, place) for (name, plan), place in tracked})
    write_page(html, page)
    out.print(f"Written to {flat(html)}.")


def export(
    directory: PlanArgument,
    mcap: Annotated[
        Path | None, typer.Option("--mcap", metavar="FILE", help="MCAP file of ROS 2 messages to write.")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Table to write, as job.csv; see --work.")
    ] = None,
    work: Annotated[
        bool, typer.Option("--work", help="In the table the work alone, on its own clock.")
    ] = False,
    ros: Annotated[
        Path | None,
        typer.Option(
            "--ros", metavar="FILE", help="JSON of a ROS JointTrajectory of the whole job to write."
        ),
    ] = None,
    ros_package: Annotated[
        Path | None,
        typer.Option("--ros-package", metavar="FOLDER", help="Description package to write; a new folder."),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace files with these names that are there.")
    ] = False,
    effort: Annotated[
        bool,
        typer.Option("--effort", help="With --mcap and --ros: torques, too, for controllers that take them."),
    ] = False,
) -> None:
    """Write a plan for other programs: the job as a table or for ROS 2, the robot as a package.

    Examples: [bold]cmbot export out/triangle --csv work.csv --work[/bold],
    [bold]cmbot export out/triangle --mcap triangle.mcap[/bold],
    [bold]cmbot export out/triangle --ros-package cmbot_description[/bold]
    """
    if mcap is None and csv is None and ros is None and ros_package is None:
        raise InputError("cmbot export", "", "nothing to write", "--csv, --ros, --mcap or --ros-package")
    if work and csv is None:
        raise InputError("cmbot export", "--work", "no table", "it with --csv FILE")
    if effort and mcap is None and ros is None:
        raise InputError("cmbot export", "--effort", "no trajectory to write", "it with --mcap or --ros")
    from cmbot.archive import export_csv, export_mcap, export_ros, export_ros_package

    loaded = cmbot.load_plan(directory)
    exports: tuple[tuple[Path | None, Callable[[Plan, Path], object]], ...] = (
        (csv, partial(export_csv, work=work)),
        (mcap, partial(export_mcap, effort=effort)),
        (ros, partial(export_ros, effort=effort)),
    )
    for file, _ in exports:
        if file is not None:
            require_new(file, force)
    for file, write in ((ros_package, export_ros_package), *exports):
        if file is not None:
            write(loaded, file)
            out.print(f"Written to {flat(file)}.")


def require_new(path: Path, force: bool) -> None:
    """Refuse a file to write that is there already, unless it may be replaced, and a folder always."""
    # Those of Path raise for names that no file can have.
    if is_folder(path):
        raise InputError(str(path), "", "a folder", "the path of a file to write")
    if os.path.exists(path) and not force:  # noqa: PTH110
        raise InputError(str(path), "", "a file that is already there", "a new file, or --force")


@contextmanager
def claimed_plan(directory: Path) -> Iterator[Plan]:
    """Read a plan and keep other processes from changing its directory in the meantime."""
    from cmbot.archive import claim, plan_data

    plan_data(directory)  # what is no plan directory is refused before anything is written beside it
    with claim(directory):
        yield cmbot.load_plan(directory)


def require_plots(wanted: bool) -> None:
    """Refuse plots that are wanted where matplotlib is missing, before a long computation."""
    if wanted:
        from cmbot.views import require_matplotlib

        require_matplotlib()


def plot_files(result: Plan | Tracking, wanted: bool) -> dict[str, bytes]:
    """Return plots as PNG and SVG files by their names, if they are wanted."""
    if not wanted:
        return {}
    from cmbot.views import figure_files, plot

    return dict(figure_files(plot(result)))


def _add(directory: Path, name: str, page: str) -> Path:
    from cmbot.archive import add_file

    return add_file(directory, name, page.encode("utf-8", "replace"))
