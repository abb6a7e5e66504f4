"""What decides how much is tried: a budget of counted runs, and a deadline, which only stops."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

RUNS, SHORTEST_TIME_RUNS, ADVICE_RUNS, LESS_KEPT_RUNS, CANDIDATE_RUNS = 12, 24, 6, 3, 3
"""Runs of optimise-and-certify at most: for a stroke of given seconds, for one with ``seconds: auto``, for
the advice of a refusal, and for that to keep less of the tool's pose; of one of many stances, of which those
that succeed took up to 3: there is another one to try."""

MORE_TIME = 0.2
"""Share of the time by which the search for a free move may exceed it: no plan is complete without them."""


@dataclass(kw_only=True)
class Budget:
    """A number of runs, which are counted.

    Attributes
    ----------
    runs : int
        At most.
    used : int
        So far.
    """

    runs: int
    used: int = 0

    @property
    def left(self) -> int:
        """Runs that are left."""
        return self.runs - self.used

    def take(self) -> bool:
        """Take a run, where one is left."""
        if self.left <= 0:
            return False
        self.used += 1
        return True


class Deadline:
    """When planning has to stop; it decides nothing else.

    Until `expired` has answered with True once, nothing that is planned depends on the clock.

    Parameters
    ----------
    limit : float, s
    clock : callable
        Gives seconds that do not go back.
    whole : Deadline, optional
        That of which this is a part.
    name : str
        Of that part.
    """

    def __init__(
        self,
        limit: float = math.inf,
        clock: Callable[[], float] = time.perf_counter,
        whole: Deadline | None = None,
        name: str = "",
    ) -> None:
        self._clock, self._began, self._whole, self._name = clock, clock(), whole, name
        self.limit = limit
        """How long planning, or a part of it, may take, s."""
        self._stopped = False

    def part(self, left: int, name: str = "") -> Deadline:
        """Return the deadline of a part of several, of which so many are left: it has an equal part."""
        return Deadline(max(self.limit - self.used, 0.0) / left, self._clock, self, name)

    def expired(self, more: float = 0.0) -> bool:
        """Whether the time is over, and so is a share `more` of it; then what asks has to stop."""
        over = self.used >= (1.0 + more) * self.limit
        if over:
            self._stop()
        return over

    def _stop(self) -> None:
        self._stopped = True
        if self._whole is not None:
            self._whole._stop()

    @property
    def in_words(self) -> str:
        """What messages call the time that planning has, and the part of it that the stroke has."""
        whole = self
        while whole._whole is not None:
            whole = whole._whole
        part = f", of which {self._name} had {self.limit:.3g} s" if self._name else ""
        return f"the time, {whole.limit:g} s (raise planner.time_limit_s for more){part}"

    @property
    def over_in_words(self) -> str:
        """What messages say where the time was over."""
        return f"{self.in_words}, was over after {self.used:.3g} s,"

    @property
    def mark(self) -> Literal["time"] | None:
        """What plans say of it: ``time`` where something was stopped."""
        return "time" if self._stopped else None

    @property
    def used(self) -> float:
        """What is used of the time, s."""
        return self._clock() - self._began
