"""How long work will still take, from how long its parts took so far; no figure where there is no basis."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Eta", "Remaining"]

# The time of a part has a decimal below this, s.
_SHORT = 10.0


@dataclass(frozen=True, kw_only=True)
class Eta:
    """What is left of some work.

    Attributes
    ----------
    seconds : float
        Of all that is left; with `most`, of one part.
    most : int or None
        Parts that are left at most, where nobody knows how many it will be.
    part : str
        What they are called, with `most`.
    parts : str
        Several of them.
    at_most : bool
        The work may end before all of it is done.
    """

    seconds: float
    most: int | None = None
    part: str = ""
    parts: str = ""
    at_most: bool = False

    def after(self, seconds: float) -> Eta | None:
        """Return what is left so many seconds later; None when the estimate has run out."""
        if self.most is not None:
            return self
        if seconds >= self.seconds:
            return None
        return Eta(seconds=self.seconds - seconds, at_most=self.at_most)

    def sentence(self) -> str:
        """Return it in words."""
        if self.most is None:
            # What takes less than a second is over before it is read.
            return f"{'at most' if self.at_most else 'about'} {max(round(self.seconds), 1)} s left"
        each = f"{self.seconds:.{0 if self.seconds >= _SHORT else 1}f} s each"
        return f"at most {self.most} more {self.part if self.most == 1 else self.parts}, {each}"


class Remaining:
    """Estimates for one piece of work whose parts are taken to cost the same.

    Parameters
    ----------
    now : float, s
        When it begins, by a clock that does not go back.
    share : float
        What is done by then: how long that took is not known, or is no measure.
    at_most : bool
        It may end before all of it is done.
    """

    def __init__(self, now: float, *, share: float = 0.0, at_most: bool = False) -> None:
        self._began = self._noted = now
        self._at_most = at_most
        self._first = self.share = min(max(share, 0.0), 1.0)
        """What is done, 0 to 1; never falls."""

    def note(self, share: float, now: float) -> None:
        """Take note of the share that is done at a time; one that falls is none."""
        if share > self.share:
            self.share, self._noted = min(share, 1.0), now

    def left(self, now: float) -> Eta | None:
        """Return what is left at a time; None before the first part is done, and when it takes longer."""
        done = self.share - self._first
        if not done > 0.0:
            return None
        seconds = (self._noted - self._began) * (1.0 - self.share) / done
        return Eta(seconds=seconds, at_most=self._at_most).after(max(now - self._noted, 0.0))
