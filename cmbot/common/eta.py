"""Estimates of the time that work still takes, from the time that its parts took so far."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Eta", "Remaining"]

# The time of a part has a decimal below this, s.
_SHORT = 10.0


@dataclass(frozen=True, kw_only=True)
class Eta:
    """The time that work still takes.

    Attributes
    ----------
    seconds : float
        For all that is left; with `most`, for one part.
    most : int or None
        Most parts that are left, where their number is not known.
    part, parts : str
        With `most`: the name of a part, and its plural.
    at_most : bool
        The work may end before all of it is done.
    """

    seconds: float
    most: int | None = None
    part: str = ""
    parts: str = ""
    at_most: bool = False

    def after(self, seconds: float) -> Eta | None:
        """Return the estimate that is left `seconds` later; None when it has run out."""
        if self.most is not None:
            return self
        if seconds >= self.seconds:
            return None
        return Eta(seconds=self.seconds - seconds, at_most=self.at_most)

    def sentence(self) -> str:
        """Return the estimate in words, such as ``about 12 s left``."""
        if self.most is None:
            return f"{'at most' if self.at_most else 'about'} {max(round(self.seconds), 1)} s left"
        each = f"{self.seconds:.{0 if self.seconds >= _SHORT else 1}f} s each"
        return f"at most {self.most} more {self.part if self.most == 1 else self.parts}, {each}"


class Remaining:
    """Estimates for one piece of work whose parts are taken to cost the same.

    Parameters
    ----------
    now : float, s
        When it begins, by a monotonic clock.
    share : float
        What is done by then, in a time that is not known or no measure.
    at_most : bool
        It may end before all of it is done.
    """

    def __init__(self, now: float, *, share: float = 0.0, at_most: bool = False) -> None:
        self._began = self._noted = now
        self._at_most = at_most
        self._first = self.share = min(max(share, 0.0), 1.0)
        """What is done, 0 to 1; never falls."""

    def note(self, share: float, now: float) -> None:
        """Note the share that is done at a time; a share that falls is ignored."""
        if share > self.share:
            self.share, self._noted = min(share, 1.0), now

    def left(self, now: float) -> Eta | None:
        """Return the estimate at a time; None before the first part is done, and when it has run out."""
        done = self.share - self._first
        if not done > 0.0:
            return None
        seconds = (self._noted - self._began) * (1.0 - self.share) / done
        return Eta(seconds=seconds, at_most=self._at_most).after(max(now - self._noted, 0.0))
