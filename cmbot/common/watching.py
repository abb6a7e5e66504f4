"""Progress that is shown to whoever watches a call from Python: on a terminal, or in a notebook."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import TYPE_CHECKING, Any, Literal, TypeVar

if TYPE_CHECKING:
    from cmbot.common.progress_line import Report

__all__ = ["watched", "watched_share"]

T = TypeVar("T")


@contextmanager
def watched(progress: Callable[[T], None] | Literal[False] | None) -> Iterator[Callable[[T], None] | None]:
    """Give what is to be called with reports: `progress`, or where it is None what shows them.

    Reports are shown while the context lasts: by a line on standard error where that is a terminal, by a bar
    in the present cell of a notebook, elsewhere, in worker processes and with False not at all.
    """
    if progress is not None:
        yield progress or None
        return
    with _line() as line:
        yield None if line is None else line.update


@contextmanager
def watched_share(
    progress: Callable[[float], None] | Literal[False] | None, description: str
) -> Iterator[Callable[[float], None] | None]:
    """Give what is to be called with the share of the work that is done, as `watched` does."""
    if progress is not None:
        yield progress or None
        return
    with _line() as line:
        yield None if line is None else lambda share: line.stage(description, share)


@contextmanager
def _line() -> Iterator[Any]:
    """Give a line of progress; None where nobody watches."""
    display = None if multiprocessing.parent_process() is not None else _notebook_display()
    if display is not None:
        bar = _NotebookBar(display)
        try:
            yield bar
        finally:
            bar.close()
    elif multiprocessing.parent_process() is None and sys.stderr is not None and sys.stderr.isatty():
        # Only where it is shown: rich takes a while to import.
        from rich.console import Console

        from cmbot.common.progress_line import ProgressLine

        with ProgressLine(Console(stderr=True, force_jupyter=False)) as line:
            yield line
    else:
        yield None


def _notebook_display() -> Callable[..., Any] | None:
    """IPython's function that shows something in a cell; None where there is no notebook."""
    module = sys.modules.get("IPython")
    shell = None if module is None else module.get_ipython()
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from IPython.display import display

    return display


class _NotebookBar:
    """A bar in a cell's output, which is empty afterwards."""

    def __init__(self, display: Callable[..., Any]) -> None:
        self._shown = display({"text/plain": "", "text/html": ""}, raw=True, display_id=True)
        self._text = ""

    def update(self, report: Report) -> None:
        """Show a report."""
        self.stage(report.step or report.sentence(), report.share)

    def stage(self, description: str, share: float | None = None) -> None:
        """Show what is being done, and how much of it is."""
        value = "" if share is None else f' value="{share:.2f}"'
        text = f"<progress{value}></progress> {escape(description)}"
        if text != self._text:
            self._text = text
            self._shown.update({"text/plain": description, "text/html": text}, raw=True)

    def close(self) -> None:
        """Leave nothing behind."""
        self._shown.update({"text/plain": "", "text/html": ""}, raw=True)
