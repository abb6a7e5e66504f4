"""Progress that is shown to whoever watches a call from Python: on a terminal, or in a notebook."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal, TypeVar

T = TypeVar("T")


@contextmanager
def watched(progress: Callable[[T], None] | Literal[False] | None) -> Iterator[Callable[[T], None] | None]:
    """Give what is to be called with reports: `progress`, or where it is None what shows them.

    Reports are shown while the context lasts: by a bar on standard error where that is a terminal, or in the
    present cell of a notebook; elsewhere, in worker processes and with False not at all.
    """
    if progress is not None:
        yield progress or None
        return
    with _shown() as shown:
        yield None if shown is None else shown.update


@contextmanager
def watched_share(
    progress: Callable[[float], None] | Literal[False] | None, description: str
) -> Iterator[Callable[[float], None] | None]:
    """Give what is to be called with the share of the work that is done, as `watched` does."""
    if progress is not None:
        yield progress or None
        return
    with _shown() as shown:
        yield None if shown is None else lambda share: shown.stage(description, share)


@contextmanager
def _shown() -> Iterator[Any]:
    """Give what shows progress; None where nobody watches."""
    display = _notebook_display()
    terminal = sys.stderr is not None and sys.stderr.isatty()
    if multiprocessing.parent_process() is not None or not (display or terminal):
        yield None
        return
    # Only where it is shown: rich takes a while to import.
    from rich.console import Console

    from cmbot.common.progress_display import ProgressDisplay

    with ProgressDisplay(Console(stderr=True, force_jupyter=False), display=display) as shown:
        yield shown


def _notebook_display() -> Callable[..., Any] | None:
    """IPython's function that shows something in a cell; None where there is no notebook."""
    module = sys.modules.get("IPython")
    shell = None if module is None else module.get_ipython()
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from IPython.display import display

    return display
