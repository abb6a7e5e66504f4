"""Progress on standard error: a bar on a terminal, elsewhere a line now and then."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path

import pytest
from command_line import on_a_terminal, run, without_colours, write_scene
from small_scenes import SHORT

import cmbot.cli.console
from cmbot.cli.console import ConsoleProgress
from cmbot.optimization.constraint_set import Violation
from cmbot.planning import ExchangeReport, Progress


@contextmanager
def shown(
    *, terminal: bool = True, width: int = 120, quiet: bool = False
) -> Iterator[tuple[ConsoleProgress, StringIO]]:
    """Progress on a console, and what it writes."""
    file = StringIO()
    console = type(cmbot.cli.console.err)(file=file, force_terminal=terminal, width=width, markup=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cmbot.cli.console, "err", console)
        with ConsoleProgress(quiet=quiet) as progress:
            yield progress, file


def told(*, terminal: bool, quiet: bool = False) -> str:
    with shown(terminal=terminal, quiet=quiet) as (progress, file):
        progress.update(Progress(stage="path"), prefix="[red]line[/red]: ")
        for step in range(5):
            progress.stage(f"simulating {step}", step / 4)
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
    # The time so far, and after the first share the time that is left.
    assert re.search(r"\d:\d\d:\d\d -:--:-- simulating 1", plain)
    assert re.search(r"\d:\d\d:\d\d \d:\d\d:\d\d simulating [23]", plain)


def completed(progress: ConsoleProgress) -> tuple[float | None, float]:
    (task,) = progress._bars.tasks
    return task.total, task.completed


def test_the_bar_begins_anew_with_a_step_unless_the_whole_is_known() -> None:
    with shown() as (progress, _):
        progress.update(Progress(stage="path", step="charting", share=0.9))
        assert completed(progress) == (100, 90)
        progress.update(Progress(stage="path", step="choosing"))
        assert completed(progress) == (None, 0)
        progress.update(Progress(stage="path", step="refining", share=0.0))
        assert completed(progress) == (100, 0)
    with shown() as (progress, file):
        progress.stage("line: via-points that slide", 0.5)
        progress.update(Progress(stage="path", step="charting", share=0.1), "line: ")
        assert completed(progress) == (100, 50)
    assert "line: charting" in without_colours(file.getvalue())


def a_pass(number: int) -> ExchangeReport:
    worst = Violation("jerk of joint_1", 0.5)
    return ExchangeReport(
        stage="peak", number=number, iterations=3, ended=True, constraints=9, peak_torque=380.0, worst=worst
    )


@pytest.mark.parametrize("width", [60, 70, 80, 100])
def test_a_narrow_terminal_cuts_what_is_told_and_nothing_else(width: int) -> None:
    with shown(width=width) as (progress, file):
        progress.update(Progress(stage="optimise", report=a_pass(3)))
    drawn = [line for line in lines(file.getvalue()) if "opt" in line]
    assert drawn
    for line in drawn:
        assert "0:00:00" in line
        assert line.endswith("…")
        assert len(line) <= width


def test_elsewhere_a_line_is_written_every_half_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 29.9, 30.0, 40.0, 75.0, 80.0, 95.0])
    monkeypatch.setattr(cmbot.cli.console, "monotonic", lambda: next(clock))
    assert told(terminal=False) == "30 s: simulating 0 (0 %)\n75 s: simulating 2 (50 %)\n"


def test_elsewhere_at_first_and_with_quiet_it_is_nothing() -> None:
    assert told(terminal=False) == told(terminal=True, quiet=True) == told(terminal=False, quiet=True) == ""


def test_planning_shows_its_steps_on_a_terminal_and_nothing_on_a_pipe(tmp_path: Path) -> None:
    scene = {**SHORT, "planner": {**SHORT["planner"], "path_step_s": 0.001}}
    path = write_scene(tmp_path / "short.yaml", scene)
    drawn = lines(on_a_terminal("plan", path, "-o", tmp_path / "out", columns=110))
    assert any(re.search(r"━.* \d:\d\d:\d\d .*following the tool path", line) for line in drawn)
    assert any("optimising, pass 1" in line for line in drawn)
    outcome = run("plan", write_scene(tmp_path / "quick.yaml", SHORT), "-o", tmp_path / "other")
    assert (outcome.status, outcome.err) == (0, "")
