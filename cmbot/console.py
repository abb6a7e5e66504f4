"""Standard output and standard error of the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

if TYPE_CHECKING:
    from cmbot.planning import Progress

__all__ = ["Narrator", "err", "flat", "out"]

# Without markup and emoji codes, so that file names are shown as they are.
out = Console(soft_wrap=True, highlight=False, markup=False, emoji=False)
err = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, emoji=False)


def flat(text: object) -> str:
    """Return one line of printable characters: messages and file names may hold anything."""
    return "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in str(text))


class Narrator:
    """Tells what is being done: a moving line on a terminal, plain lines elsewhere."""

    def __enter__(self) -> Narrator:
        self._status = err.status("") if err.is_terminal else None
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def tell(self, progress: Progress, about: str = "") -> None:
        """Show one step of the planner, after what it is `about`."""
        if self._status is not None or progress.failed_starts <= 1:
            self.say(about + progress.sentence())

    def say(self, what: str) -> None:
        """Show what begins now."""
        if self._status is not None:
            self._status.update(Text(what))
        else:
            err.print(what)
