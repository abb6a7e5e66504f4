"""Progress on standard error: a bar with the remaining time on a terminal, plain lines elsewhere, or none."""

from __future__ import annotations

import re
from io import StringIO
from pathlib import Path

import pytest
from command_line import on_a_terminal, without_colours, write_scene
from rich.console import Console
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


@pytest.fixture
def clock() -> Clock:
    return Clock()


def stream(monkeypatch: pytest.MonkeyPatch, *, terminal: bool, width: int = 120) -> StringIO:
    file = StringIO()
    console = Console(file=file, force_terminal=terminal, width=width, markup=False)
    monkeypatch.setattr(cmbot.cli.console, "err", console)
    return file


def told(monkeypatch: pytest.MonkeyPatch, clock: Clock, *, terminal: bool, quiet: bool = False) -> str:
    """What a narrator writes of some work."""
    file = stream(monkeypatch, terminal=terminal)
    with ConsoleProgress(quiet=quiet, clock=clock) as progress:
        progress.update(Progress(stage="path"), prefix="[red]line[/red]: ")
        for step in range(5):
            progress.stage(f"simulating {step}" if terminal else "simulating", step / 4)
            clock.now += 2.0
    return file.getvalue()


def lines(text: str) -> list[str]:
    """What was drawn, one drawing a line."""
    drawn = without_colours(text).replace("\r", "\n").splitlines()
    return [line.rstrip() for line in drawn if line.strip()]


def test_on_a_terminal_it_is_a_bar(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    text = told(monkeypatch, clock, terminal=True)
    plain = without_colours(text)
    assert "\x1b[" in text
    # Markup is shown as it is.
    assert "[red]line[/red]: following the tool path" in plain
    assert "━" in plain
    assert re.search(r"0 s · simulating 0", plain)
    assert re.search(r"2 s, about 6 s left · simulating 1", plain)
    assert re.search(r"6 s, about 2 s left · simulating 3", plain)


def test_the_remaining_time_of_a_step_counts_down(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    file = stream(monkeypatch, terminal=True)
    with ConsoleProgress(clock=clock) as progress:
        clock.now = 3.0
        progress.update(Progress(stage="path", step="charting", share=0.1, left=Eta(seconds=20.0)))
        for later, expected in ((0.0, "3 s, step: about 20 s left"), (8.0, "11 s, step: about 12 s left")):
            clock.now = 3.0 + later
            progress._bars.refresh()  # type: ignore[union-attr]
            assert expected in lines(file.getvalue())[-1]
        clock.now = 30.0
        progress._bars.refresh()  # type: ignore[union-attr]
        # Longer than foretold: no figure rather than a wrong one.
        assert "30 s · charting" in lines(file.getvalue())[-1]


def test_the_bar_begins_anew_with_a_step(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    stream(monkeypatch, terminal=True)
    with ConsoleProgress(clock=clock) as progress:
        progress.update(Progress(stage="path", step="charting", share=0.9, left=Eta(seconds=1.0)))
        (task,) = progress._bars.tasks  # type: ignore[union-attr]
        assert (task.total, task.completed) == (1.0, 0.9)
        progress.update(Progress(stage="path", step="choosing"))
        (task,) = progress._bars.tasks  # type: ignore[union-attr]
        assert task.total is None
        progress.update(Progress(stage="path", step="refining", share=0.0))
        (task,) = progress._bars.tasks  # type: ignore[union-attr]
        assert (task.total, task.completed) == (1.0, 0.0)


def test_where_the_whole_is_known_a_step_does_not_move_its_bar(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    file = stream(monkeypatch, terminal=True)
    with ConsoleProgress(clock=clock) as progress:
        clock.now = 5.0
        progress.stage("line: via-points that slide", 0.5)
        progress.update(Progress(stage="path", step="charting", share=0.1, left=Eta(seconds=99.0)), "line: ")
        (task,) = progress._bars.tasks  # type: ignore[union-attr]
        assert task.completed == 0.5
        progress.stage("line: simulating", 0.4)
        assert task.completed == 0.5
    assert "5 s, about 5 s left · line: charting" in without_colours(file.getvalue())
    assert "99 s" not in file.getvalue()


def test_passes_are_told_with_what_is_left_at_most(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    file = stream(monkeypatch, terminal=True)
    with ConsoleProgress(clock=clock) as progress:
        progress.update(Progress(stage="optimise", report=a_pass(3), left=some_passes(37)))
    assert "0 s, at most 37 more passes, 0.4 s each · optimising, pass 3 (peak): peak" in without_colours(
        file.getvalue()
    )


def a_pass(number: int) -> ExchangeReport:
    worst = Violation("jerk of joint_1", 0.5)
    return ExchangeReport(
        stage="peak", number=number, iterations=3, constraints=9, peak_torque=380.0, worst=worst
    )


def some_passes(most: int) -> Eta:
    return Eta(seconds=0.4, most=most, part="pass", parts="passes")


@pytest.mark.parametrize("width", [60, 70, 80, 100])
def test_a_narrow_terminal_cuts_what_is_told_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch, clock: Clock, width: int
) -> None:
    file = stream(monkeypatch, terminal=True, width=width)
    with ConsoleProgress(clock=clock) as progress:
        progress.update(Progress(stage="optimise", report=a_pass(3), left=Eta(seconds=12.0)))
    drawn = [line for line in lines(file.getvalue()) if "opt" in line]
    assert drawn
    for line in drawn:
        assert "0 s, step: about 12 s left" in line
        assert line.endswith("…")
        assert len(line) <= width


def test_elsewhere_it_is_plain_lines(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    text = told(monkeypatch, clock, terminal=False)
    assert text == "[red]line[/red]: following the tool path\nsimulating\n"


def test_elsewhere_long_work_says_every_so_often_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    file = stream(monkeypatch, terminal=False)
    with ConsoleProgress(clock=clock) as progress:
        for done in range(31):
            progress.stage("simulating", done / 30)
            clock.now += 1.0
    assert file.getvalue().splitlines() == [
        "simulating",
        "simulating: 33% done, about 20 s left",
        "simulating: 67% done, about 10 s left",
        "simulating: 100% done",
    ]


def test_elsewhere_not_every_step_and_pass_is_told(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    file = stream(monkeypatch, terminal=False)
    with ConsoleProgress(clock=clock) as progress:
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


@pytest.mark.parametrize("terminal", [True, False])
def test_quiet_shows_nothing(monkeypatch: pytest.MonkeyPatch, clock: Clock, terminal: bool) -> None:
    assert told(monkeypatch, clock, terminal=terminal, quiet=True) == ""


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
