"""Progress for whoever watches: on a terminal, in a notebook, and nowhere else."""

import sys
from collections.abc import Iterator
from io import StringIO
from types import SimpleNamespace
from typing import Any

import pytest

from cmbot.common.watching import watched, watched_share
from cmbot.planning import Progress


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


class Cell:
    """A cell of a notebook: what it showed, one after the other."""

    def __init__(self) -> None:
        self.shown: list[dict[str, str]] = []

    def display(self, data: dict[str, str], **_: object) -> "Cell":
        self.shown.append(data)
        return self

    def update(self, data: dict[str, str], **_: object) -> None:
        self.shown.append(data)


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Iterator[Cell]:
    made, shell = Cell(), SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=made.display))
    return made


def test_what_is_given_is_called_and_false_is_nothing() -> None:
    calls: list[Any] = []
    with watched(calls.append) as report, watched(False) as silent, watched(None) as unseen:
        assert report is not None
        report(Progress(stage="path"))
    assert len(calls) == 1
    assert silent is unseen is None  # standard error is no terminal in a test


def test_a_terminal_has_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with watched(None) as report:
        assert report is not None
        report(Progress(stage="path", step="charting", share=0.5))
    assert "charting" in stream.getvalue()


def test_a_notebook_has_a_bar_that_goes_away(cell: Cell) -> None:
    with watched_share(None, "simulating") as told:
        assert told is not None
        told(0.25)
        told(0.2501)
    with watched(None) as report:
        assert report is not None
        report(Progress(stage="path", step="<b>"))
    texts = [data["text/html"] for data in cell.shown]
    bar = '<progress value="0.25"></progress> simulating'
    assert texts == ["", bar, "", "", "<progress></progress> &lt;b&gt;", ""]


def test_worker_processes_show_nothing(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("multiprocessing.parent_process", object)
    with watched(None) as report:
        assert report is None
    assert cell.shown == []
