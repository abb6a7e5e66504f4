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
        self.shown: list[str] = []

    def display(self, data: Any, **_: object) -> "Cell":
        self.update(data)
        return self

    def update(self, data: Any, *, raw: bool = False, **_: object) -> None:
        made = data if raw else data._repr_mimebundle_(include=[], exclude=[])
        self.shown.append(made["text/html"])


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


def test_a_terminal_has_a_bar_that_goes_away(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with watched(None) as report:
        assert report is not None
        report(Progress(stage="path", step="charting", share=0.5))
    drawn = stream.getvalue()
    assert "charting" in drawn
    assert drawn.endswith("\x1b[2K")


def test_a_notebook_has_a_bar_that_goes_away(cell: Cell) -> None:
    with watched_share(None, "simulating") as told:
        assert told is not None
        told(0.25)
        told(0.2501)
    assert len(cell.shown) == 3  # empty, a quarter, gone
    assert "simulating" in cell.shown[1]
    assert "━" in cell.shown[1]
    assert cell.shown[2] == ""
    with watched(None) as report:
        assert report is not None
        report(Progress(stage="path", step="<b>"))
    assert "&lt;b&gt;" in cell.shown[-2]
    assert cell.shown[-1] == ""


def test_worker_processes_show_nothing(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("multiprocessing.parent_process", object)
    with watched(None) as report:
        assert report is None
    assert cell.shown == []
