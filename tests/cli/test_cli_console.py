"""Progress on standard error: a bar with the remaining time on a terminal, plain lines elsewhere, or none."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path

import pytest
from command_line import on_a_terminal, without_colours, write_scene
from small_scenes import SHORT

import cmbot.cli.console
from cmbot.cli.console import ConsoleProgress
from cmbot.common.eta import Eta
from cmbot.optimization.constraint_set import Violation
from cmbot.planning import ExchangeReport, Progress


class Clock:
    """Time that goes on when it is told to."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@contextmanager
def shown(
    *, terminal: bool = True, width: int = 120, quiet: bool = False
) -> Iterator[tuple[ConsoleProgress, Clock, StringIO]]:
    """Progress on a console, its clock, and what it writes."""
    clock, file = Clock(), StringIO()
    console = type(cmbot.cli.console.err)(file=file, force_terminal=terminal, width=width, markup=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cmbot.cli.console, "err", console)
        with ConsoleProgress(quiet=quiet, clock=clock) as progress:
            yield progress, clock, file


def told(*, terminal: bool, quiet: bool = False) -> str:
    with shown(terminal=terminal, quiet=quiet) as (progress, clock, file):
        progress.update(Progress(stage="path"), prefix="[red]line[/red]: ")
        for step in range(5):
            progress.stage(f"simulating {step}" if terminal else "simulating", step / 4)
            clock.now += 2.0
    return file.getvalue()


def lines(text: str) -> list[str]:
    """What was drawn, one drawing a line."""
    drawn = without_colours(text).replace("\r", "\n").splitlines()
    return [line.rstrip() for line in drawn if line.strip()]


def test_on_a_terminal_it_is_a_bar() -> None:
    text = told(terminal=True)
    plain = without_colours(text)
    assert "\x1b[" in text
    # Markup is shown as it is.
    assert "[red]line[/red]: following the tool path" in plain
    assert "━" in plain
    assert re.search(r"0 s · simulating 0", plain)
    assert re.search(r"2 s, about 6 s left · simulating 1", plain)
    assert re.search(r"6 s, about 2 s left · simulating 3", plain)


def test_the_remaining_time_of_a_step_counts_down() -> None:
    with shown() as (progress, clock, file):
        clock.now = 3.0
        progress.update(Progress(stage="path", step="charting", share=0.1, left=Eta(seconds=20.0)))
        for now, expected in (
            (3.0, "3 s, step: about 20 s left"),
            (11.0, "11 s, step: about 12 s left"),
            # Longer than foretold: no figure rather than a wrong one.
            (30.0, "30 s · charting"),
        ):
            clock.now = now
            progress._bars.refresh()  # type: ignore[union-attr]
            assert expected in lines(file.getvalue())[-1]


def test_the_bar_begins_anew_with_a_step_unless_the_whole_is_known() -> None:
    def bar() -> tuple[float | None, float]:
        (task,) = progress._bars.tasks  # type: ignore[union-attr]
        return task.total, task.completed

    with shown() as (progress, _, _):
        progress.update(Progress(stage="path", step="charting", share=0.9, left=Eta(seconds=1.0)))
        assert bar() == (1.0, 0.9)
        progress.update(Progress(stage="path", step="choosing"))
        assert bar() == (None, 0.0)
        progress.update(Progress(stage="path", step="refining", share=0.0))
        assert bar() == (1.0, 0.0)
    with shown() as (progress, clock, file):
        clock.now = 5.0
        progress.stage("line: via-points that slide", 0.5)
        progress.update(Progress(stage="path", step="charting", share=0.1, left=Eta(seconds=99.0)), "line: ")
        assert bar()[1] == 0.5
        progress.stage("line: simulating", 0.4)
        assert bar()[1] == 0.5
    assert "5 s, about 5 s left · line: charting" in without_colours(file.getvalue())
    assert "99 s" not in file.getvalue()


def test_passes_are_told_with_what_is_left_at_most() -> None:
    with shown() as (progress, _, file):
        progress.update(Progress(stage="optimise", report=a_pass(3), left=some_passes(37)))
    expected = "0 s, at most 37 more passes, 0.4 s each · optimising, pass 3 (peak): peak"
    assert expected in without_colours(file.getvalue())


def a_pass(number: int) -> ExchangeReport:
    worst = Violation("jerk of joint_1", 0.5)
    return ExchangeReport(
        stage="peak", number=number, iterations=3, ended=True, constraints=9, peak_torque=380.0, worst=worst
    )


def some_passes(most: int) -> Eta:
    return Eta(seconds=0.4, most=most, part="pass", parts="passes")


@pytest.mark.parametrize("width", [60, 70, 80, 100])
def test_a_narrow_terminal_cuts_what_is_told_and_nothing_else(width: int) -> None:
    with shown(width=width) as (progress, _, file):
        progress.update(Progress(stage="optimise", report=a_pass(3), left=Eta(seconds=12.0)))
    drawn = [line for line in lines(file.getvalue()) if "opt" in line]
    assert drawn
    for line in drawn:
        assert "0 s, step: about 12 s left" in line
        assert line.endswith("…")
        assert len(line) <= width


def test_elsewhere_it_is_plain_lines_and_with_quiet_nothing() -> None:
    assert told(terminal=False) == "[red]line[/red]: following the tool path\nsimulating\n"
    assert told(terminal=True, quiet=True) == told(terminal=False, quiet=True) == ""


def test_elsewhere_long_work_says_every_so_often_how_far_it_is() -> None:
    with shown(terminal=False) as (progress, clock, file):
        for done in range(31):
            progress.stage("simulating", done / 30)
            clock.now += 1.0
    assert file.getvalue().splitlines() == [
        "simulating",
        "simulating: 33% done, about 20 s left",
        "simulating: 67% done, about 10 s left",
        "simulating: 100% done",
    ]


def test_elsewhere_not_every_step_and_pass_is_told() -> None:
    with shown(terminal=False) as (progress, clock, file):
        progress.update(Progress(stage="path"))
        for share in (0.0, 0.3, 0.6):
            progress.update(Progress(stage="path", step="charting", share=share, left=Eta(seconds=8.0)))
        clock.now = 11.0
        progress.update(Progress(stage="path", step="charting", share=0.7, left=Eta(seconds=8.0)))
        progress.update(Progress(stage="path", step="charting", share=0.8, left=Eta(seconds=7.0)))
        for failed in (1, 2, 3):
            progress.update(Progress(stage="path", failed_starts=failed))
        progress.update(Progress(stage="optimise", report=a_pass(1), left=some_passes(39)))
        for rounds in (1, 2):
            for number in (1, 2, 3):
                progress.update(Progress(stage="optimise", report=a_pass(number), rounds=rounds))
    assert file.getvalue().splitlines() == [
        "following the tool path",
        "charting: 70% done, step: about 8 s left",
        "following the tool path from another start (1 failed)",
        "optimising, pass 1 (peak): peak 380.00 Nm, jerk of joint_1 50.00% beyond its bound",
        "compensating the sag, round 1",
        "compensating the sag, round 2",
    ]


def test_planning_shows_the_remaining_time_on_a_terminal(tmp_path: Path) -> None:
    """Many steps of the path: enough of them that some are told before the last."""
    scene = {**SHORT, "planner": {**SHORT["planner"], "path_step_s": 0.001}}
    path = write_scene(tmp_path / "short.yaml", scene)
    text = on_a_terminal("plan", path, "-o", tmp_path / "out", columns=110)
    drawn = [line for line in lines(text) if " · " in line]
    assert any(re.search(r"\d+ s, step: about \d+ s left · following the tool path", line) for line in drawn)
    assert any(re.search(r"at most \d+ more passes, \d+\.\d s each · optimising", line) for line in drawn)
    assert not any(re.search(r"-\d", line) for line in drawn)
    elapsed = [int(found[1]) for line in drawn if (found := re.search(r"(\d+) s(?:,| ·)", line))]
    assert elapsed == sorted(elapsed)
