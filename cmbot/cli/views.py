"""The commands that show a plan, and what others need to add pages and plots to it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cmbot
from cmbot.cli.command import Reporting, Writing, argument, option, options_named, require_new
from cmbot.cli.console import ConsoleProgress, err, out
from cmbot.common.errors import InputError, one_line

if TYPE_CHECKING:
    from cmbot.archive.ros import RosTrajectory

# Seconds of motion in a second of a GIF.
_GIF_SPEED = 4.0
_MAX_SIZE_CHARACTERS = 12
_FILM_OPTIONS = ("--video", "--gif")


@dataclass(frozen=True, kw_only=True)
class ReplayCommand(Reporting):
    """Write a page that replays a plan, or a walk, in any browser, without a network.

    A walk is certified again first.

    Example: cmbot replay out/triangle --html triangle.html
    """

    directory: Path = argument("A plan directory, or a walk's folder.", "DIR")
    html: Path | None = option(
        None, "Page to write; DIR/replay.html if left out.", "--html", "-o", alone="output"
    )
    serve: bool = option(False, "Serve the page on 127.0.0.1 instead.", alone="output")
    video: Path | None = option(None, "Film it instead, such as FILE.mp4; takes minutes.", alone="output")
    gif: Path | None = option(None, "Film it as a small GIF instead, four times as fast.", alone="output")
    fps: int | None = option(None, "Frames a second; left out: 30, of a GIF 10.", needs=_FILM_OPTIONS)
    size: str | None = option(
        None, "Size, px; left out: 1280x720, of a GIF 640x360.", metavar="WxH", needs=_FILM_OPTIONS
    )
    bending: float | None = option(
        None, "Times by which deflections are magnified; left out: as the page.", needs=_FILM_OPTIONS
    )
    colours: str | None = option(None, "Of the arm: own, load or strain; left out: own.", needs=_FILM_OPTIONS)

    def __call__(self) -> None:
        shape = _size(self.size or ("640x360" if self.gif else "1280x720"))
        directory, html, filmed = self.directory, self.html, self.video or self.gif
        is_walk = cmbot.archive.record_of(directory) == cmbot.archive.WALK_FILE and filmed is None
        if not is_walk:
            # What is no plan directory is refused before anything is written beside it.
            cmbot.archive.plan_data(directory)
        written, shown = None, self.serve or filmed
        with nullcontext() if html or shown else cmbot.archive.claim(directory):
            page, name = _walk_page(directory) if is_walk else _plan_page(directory)
            if not shown:
                written = _written(page, html, directory, cmbot.views.REPLAY)
        if filmed is not None:
            self._film(page, filmed, shape)
        elif written is not None:
            self.wrote(written)
        else:
            self._serve(page, name)

    def _film(self, page: str, file: Path, size: tuple[int, int]) -> None:
        """Film a replay page, and print how long that took."""
        as_gif = self.gif is not None
        if as_gif and file.suffix.lower() != ".gif":
            raise InputError("cmbot replay", "--gif", str(file), "a file whose name ends with .gif")
        started = time.perf_counter()
        with ConsoleProgress(quiet=self.quiet) as progress:
            progress.stage("filming", 0.0)
            frames = cmbot.views.film(
                page,
                file,
                speed=_GIF_SPEED if as_gif else 1.0,
                fps=self.fps or (10 if as_gif else 30),
                size=size,
                bending=self.bending,
                colours=self.colours or "own",
                progress=lambda share: progress.stage("filming", share),
            )
        seconds = time.perf_counter() - started
        self.wrote(file, f": {frames} frames in {seconds:.1f} s", frames=frames)

    def _serve(self, page: str, name: str) -> None:
        with cmbot.views.ReplayServer(page) as server, suppress(KeyboardInterrupt):
            said = f"Replay of {name} at {server.url}; stop with Ctrl-C."
            self.answer(lambda: {"url": server.url}, lambda: out.print(said))
            server.wait()


def _plan_page(directory: Path) -> tuple[str, str]:
    """The replay of a plan, and its scene's name."""
    loaded = cmbot.load_plan(directory)
    return cmbot.views.replay_page(loaded, cmbot.load_tracking(loaded, directory)), loaded.scene.name


def _walk_page(directory: Path) -> tuple[str, str]:
    """The replay of a walk, and its scene's name."""
    walked = cmbot.load_walk(directory)
    return cmbot.views.walk_replay_page(walked), walked.scene.name


def _size(text: str) -> tuple[int, int]:
    """Width and height from text such as 1280x720."""
    width, times, height = text.partition("x")
    if not (times and width.isdecimal() and height.isdecimal() and len(text) < _MAX_SIZE_CHARACTERS):
        raise InputError("cmbot replay", "--size", one_line(text), "width and height, such as 1280x720")
    return int(width), int(height)


@dataclass(frozen=True, kw_only=True)
class ReportCommand(Writing):
    """Write a page that says what a plan gains and what it keeps: replay, plots and tables.

    Tracking errors are in it when the plan has been simulated, and what shakes it after `cmbot excite`.

    Example: cmbot report out/triangle
    """

    directory: Path = argument("A plan directory.", "DIR")
    html: Path | None = option(
        None, "Page to write; DIR/report.html if left out.", "--html", "--output", "-o"
    )

    def __call__(self) -> None:
        directory, html = self.directory, self.html
        with claimed_plan(directory) if html is None else nullcontext(cmbot.load_plan(directory)) as loaded:
            if html is not None:
                require_new(html, self.force)
            tracking, excitation = cmbot.load_tracking(loaded, directory), cmbot.load_excitation(directory)
            page = cmbot.views.report_page(loaded, tracking, excitation)
            written = _written(page, html, directory, cmbot.views.REPORT)
        self.wrote(written)


def _written(page: str, html: Path | None, directory: Path, name: str) -> Path:
    """Write a page, or add it to a plan directory under a name; return its path."""
    if html is None:
        return cmbot.archive.add_file(directory, name, page)
    cmbot.views.write_page(html, page)
    return html


@dataclass(frozen=True, kw_only=True)
class CompareCommand(Writing):
    """Write a page that shows several plans together: overlaid in 3-D and in plots, figures side by side.

    Example: cmbot compare out/triangle out/pinned -o compare.html
    """

    directories: tuple[Path, ...] = argument("Plan directories of one arm, 2 to 6.", "DIR")
    output: Path = option(Path("compare.html"), "Page to write.", "--output", "-o", "--html")

    def __call__(self) -> None:
        places = [directory.resolve() for directory in self.directories]
        if len(set(places)) < len(places):
            expected = "different plan directories"
            raise InputError("cmbot compare", "", "one directory more than once", expected)
        names = [one_line(place.name) for place in places]
        # Folders of the same name are told apart by their paths.
        shown = [
            name if names.count(name) == 1 else one_line(path)
            for name, path in zip(names, self.directories, strict=True)
        ]
        plans = dict(zip(shown, map(cmbot.load_plan, self.directories), strict=True))
        require_new(self.output, self.force)
        trackings = map(cmbot.load_tracking, plans.values(), self.directories)
        tracked = dict(zip(plans, trackings, strict=True))
        cmbot.views.write_page(self.output, cmbot.views.compare_page(plans, tracked))
        if unlike := cmbot.views.unlike(plans):
            err.print(" ".join(unlike))  # there, as no -q may lose it
        self.wrote(self.output, unlike=unlike)


@dataclass(frozen=True, kw_only=True)
class ExportCommand(Writing):
    """Write a plan for other programs: the job as a table or for ROS 2, the robot as a package.

    Examples: cmbot export out/triangle --csv work.csv --work, cmbot export out/triangle --mcap triangle.mcap,
    cmbot export out/triangle --ros-package cmbot_description
    """

    directory: Path = argument("A plan directory.", "DIR")
    mcap: Path | None = option(None, "MCAP file of ROS 2 messages to write.", metavar="FILE")
    csv: Path | None = option(None, "Table to write, as job.csv; see --work.", metavar="FILE")
    work: bool = option(False, "The work alone, on its own clock.", needs=["--csv"])
    ros: Path | None = option(
        None, "JSON of a ROS JointTrajectory of the whole job to write.", metavar="FILE"
    )
    ros_package: Path | None = option(None, "Description package to write; a new folder.", metavar="FOLDER")
    max_points: int | None = option(
        None, "points at most; left out: 200.", least=2, most=100_000, needs=["--ros"], alone="points"
    )
    rate: float | None = option(
        None, "points a second, in place of --max-points.", metavar="HZ", needs=["--ros"], alone="points"
    )
    joints: str | None = option(
        None, "these joints alone, for one of several controllers.", metavar="A,B,…", needs=["--ros"]
    )
    effort: bool = option(False, "torques, too, for controllers that take them.", needs=["--mcap", "--ros"])

    def __call__(self) -> None:
        if not (self.mcap or self.csv or self.ros or self.ros_package):
            expected = "--csv, --ros, --mcap or --ros-package"
            raise InputError("cmbot export", "", "nothing to write", expected)
        loaded = cmbot.load_plan(self.directory)
        exports: tuple[tuple[Path | None, Callable[[cmbot.Plan, Path], Any]], ...] = (
            (self.csv, partial(cmbot.archive.export_csv, work=self.work)),
            (self.mcap, partial(cmbot.archive.export_mcap, effort=self.effort)),
            (self.ros, self._write_message),
        )
        for file, _ in exports:
            if file is not None:
                require_new(file, self.force)
        written = {
            file: write(loaded, file)
            for file, write in ((self.ros_package, cmbot.archive.export_ros_package), *exports)
            if file is not None
        }
        message: RosTrajectory | None = None if self.ros is None else written[self.ros]
        if message is not None and message.left_out:
            err.print(_without(self.ros, message, loaded))  # there, as no -q may lose it
        if message is not None and not message.follows(loaded):
            err.print(_off(self.ros, message, loaded))
        if locked := dict(loaded.scene.robot.locked or ()):
            places = ", ".join(f"{name} at {value:g}" for name, value in locked.items())
            err.print(f"Not moved, to be there first (rad or m, robot.locked): {one_line(places)}.")
        start = dict(zip(loaded.robot.joints, loaded.job.trajectory.q[0].tolist(), strict=True))
        self.answer(
            lambda: _exported(written, message) | {"locked": locked, "start": start},
            lambda: _print_exported(written, message, loaded),
        )

    def _write_message(self, plan: cmbot.Plan, file: Path) -> RosTrajectory:
        names = {name: f"--{name.replace('_', '-')}" for name in ("max_points", "rate", "joints")}
        with options_named(names, "cmbot export"):
            return cmbot.archive.export_ros(
                plan,
                file,
                max_points=self.max_points,
                rate=self.rate,
                joints=None if self.joints is None else [name.strip() for name in self.joints.split(",")],
                effort=self.effort,
            )


def _exported(written: Iterable[Path], message: RosTrajectory | None) -> dict[str, object]:
    told: dict[str, object] = {"files": [str(file) for file in written]}
    if message is None:
        return told
    told |= {"points": message.points, "deviation": message.deviation}
    told |= {"tool_deviation": message.tool_deviation}
    return told | {"moving_joints_left_out": message.left_out}


def _print_exported(written: Mapping[Path, object], message: RosTrajectory | None, plan: cmbot.Plan) -> None:
    for file, made in written.items():
        said = ""
        if message is not None and made is message:
            within = f"{message.deviation:.1e} rad (or m), at the tool {1e3 * message.tool_deviation:.2g} mm,"
            said = f": {message.points} points, between them within {within} of the plan"
        out.print(f"Written to {one_line(file)}{said}.")
    if any(file.is_file() for file in written):
        start = cmbot.scene.start_entry(plan.job.trajectory.q[0], plan.robot.limits)
        out.print(f"The arm has to be at {start} before: the way there is not planned.")


def _off(file: Path | None, message: RosTrajectory, plan: cmbot.Plan) -> str:
    """Say how far off the plan a message of few points is, and how many would do."""
    off = f"the tool {1e3 * message.tool_deviation:.2g} mm and joints {message.deviation:.1e} rad (or m)"
    enough = cmbot.archive.enough_points(plan, message.points)
    told = f"leads {off} off the plan, more than cmbot verify takes: --max-points {enough} does not."
    return f"Warning: {one_line(file)} {told}"


def _without(file: Path | None, message: RosTrajectory, plan: cmbot.Plan) -> str:
    """Name the joints that move and are not in a message, and say how their controllers get them."""
    joints, names = [], plan.robot.joints
    for name, way in message.left_out.items():
        units = plan.robot.limits.units(names.index(name), shown=True)
        joints.append(f"{name}, which moves {way * units.factor:.3g} {units.position}")
    others = one_line(",".join(message.left_out))
    return (
        f"Warning: not in {one_line(file)}: {'; '.join(joints)}. The motion is that of the plan only where "
        f"these joints are driven at the same time: --joints {others} writes their message."
    )


@contextmanager
def claimed_plan(directory: Path) -> Iterator[cmbot.Plan]:
    """Read a plan and keep other processes from changing its directory in the meantime."""
    # What is no plan directory is refused before anything is written beside it.
    cmbot.archive.plan_data(directory)
    with cmbot.archive.claim(directory):
        yield cmbot.load_plan(directory)


def require_plots(wanted: bool) -> None:
    """Refuse plots that are wanted where matplotlib is missing, before a long computation."""
    if wanted:
        cmbot.views.require_matplotlib()


def plot_files(result: cmbot.Plan | cmbot.Tracking, wanted: bool) -> dict[str, bytes]:
    """Return plots as PNG, SVG and PDF files by their names, if they are wanted."""
    return dict(cmbot.views.figure_files(cmbot.plot(result))) if wanted else {}
