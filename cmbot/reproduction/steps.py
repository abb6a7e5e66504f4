"""How much of a reproduction is done."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["Steps"]


class Steps:
    """Tells how much is done: a run is a plan and simulations of it, and all of these count the same.

    Parameters
    ----------
    tell : callable
        Called with the scene's name, what is being done, and the share of all steps that is done.
    total : int
        Number of all steps.
    """

    def __init__(self, tell: Callable[[str, str, float], None], total: int) -> None:
        self._tell, self._total, self._before, self._step = tell, total, 0, 0
        self._scene, self._about, self._what = "", "", ""

    @contextmanager
    def run(self, scene: str, about: str, steps: int) -> Iterator[None]:
        """Begin a run with its plan; it ends with all its `steps` done, even if some were left out."""
        self._scene, self._about, self._step = scene, about, -1
        self.next("")
        try:
            yield
        finally:
            self._before += steps

    def next(self, what: str) -> None:
        """Begin the next step of a run."""
        self._step += 1
        self._what = ": ".join(filter(None, (self._about, what)))
        self.within(0.0)

    def within(self, share: float) -> None:
        """Tell the share of the present step that is done."""
        done = self._before + self._step + share
        self._tell(self._scene, self._what, done / self._total)
