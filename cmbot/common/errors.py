"""The errors of cmbot.

::

    CmbotError
      InputError (ValueError)          the input is wrong
        ModelError                     a URDF, SRDF, joint-limits or elasticity file
        SceneError                     a scene file
        ArchiveError                   a plan directory
      PlanningError (RuntimeError)     the input is fine, but there is no plan
        PathNotFound                   how far the path came, and why not further
        OptimisationFailed             the constraint that could not be met
        LimitViolation                 joint, time, value, bound
      SimulationDiverged (RuntimeError)   when, and how far the arm was bent
      MissingExtra (ImportError)       the command to run
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from importlib import import_module
from typing import Any

from cmbot.common.installation import install_command
from cmbot.common.limit import Limit

LONGEST_MESSAGE = 590
"""Characters of an error's message; with ``error: `` before it, a line has at most 600."""

FAR_BEYOND = 10.0
"""A violation, as a share of the bound, beyond which its size says nothing."""

# A posture whose smallest singular value is larger is not near a singular one.
_NEAR_SINGULAR_VALUE = 0.05
# Characters of a value, of a file's path and of what happened that are kept at least where a message has to
# be shortened.
_SHORT_VALUE, _SHORT_SOURCE, _SHORT_TEXT = 60, 80, 160
# What is said as one: in brackets and quotes no sentence ends. An apostrophe is no quote.
_BRACKETED = re.compile(r"\([^()]*\)|\[[^][]*\]|(?<!\w)'[^']*'(?!\w)|(?<!\w)\"[^\"]*\"(?!\w)")
_SENTENCE_ENDS = re.compile(r";(?= )|(?<=[.!?])(?= [A-Z])")


def one_line(text: object) -> str:
    """Return one line of printable characters: file names and values may hold anything."""
    return "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in str(text))


def whole_sentences(text: str, length: int) -> str:
    """Return text of one line as far as its sentences fit into so many characters.

    The last sentences, or parts of one that a semicolon ends, are left out. Where the first one alone is too
    long, long values in it lose their middle; where it has none, it loses words from its own.

    Parameters
    ----------
    text : str
    length : int
    """
    if len(text) <= length:
        return text
    masked = text
    # From the innermost groups outwards.
    while (once := _BRACKETED.sub(lambda group: "_" * len(group[0]), masked)) != masked:
        masked = once
    ends = [found.start() for found in _SENTENCE_ENDS.finditer(masked)]
    if fitting := [end for end in ends if 0 < end <= length]:
        return text[: fitting[-1]]
    first = text[: ends[0]] if ends and ends[0] > 0 else text
    for value in sorted((*_BRACKETED.findall(first), *first.split()), key=len, reverse=True):
        if len(first) <= length or len(value) <= _SHORT_VALUE:
            break
        first = first.replace(value, _cut_within(value, max(len(value) - len(first) + length, _SHORT_VALUE)))
    if len(first) <= length:
        return first
    begin, end = first[: length // 2 - 1].rpartition(" ")[0], first[3 - (length + 1) // 2 :].partition(" ")[2]
    return f"{begin} … {end}" if begin and end else _cut_within(first, length)


def _cut_within(text: str, length: int) -> str:
    """Text without its middle, where it is longer."""
    if len(text) <= length:
        return text
    return f"{text[: length // 2]}…{text[len(text) - (length - 1) // 2 :]}"


class CmbotError(Exception):
    """Root of every error that cmbot raises on purpose; its message is one line, `LONGEST_MESSAGE` at most.

    Parameters
    ----------
    message : str
        Where it is longer, as many of its sentences as fit: `whole_sentences`.
    end : str, optional
        What is said at the end in any case, with a semicolon before it.
    """

    _about = ""
    hints: tuple[str, ...] = ()
    """What was appended to the message."""

    def __init__(self, message: str, end: str = "") -> None:
        self._text, self._end = one_line(message), one_line(end)
        super().__init__(self._within(LONGEST_MESSAGE))

    def __reduce__(self) -> tuple[Any, ...]:
        """Let it be copied and passed to other processes, whatever it is made of."""
        return _made_again, (type(self), self.args), vars(self)

    def add_source(self, source: str) -> None:
        """Put before the message what it is about, such as the scene's file."""
        self._about = f"{_end_of(one_line(source))}: {self._about}"
        self._say()

    def add_hint(self, hint: str) -> None:
        """Append a hint to the message, which is shortened for it where need be."""
        self.hints += (one_line(hint),)
        self._say()

    def _within(self, room: int) -> str:
        """What happened, in so many characters."""
        end = whole_sentences(self._end, room - min(len(self._text), _SHORT_TEXT))
        return f"{whole_sentences(self._text, room - len(end))}{end}"

    def _say(self) -> None:
        """Make the message of its parts."""
        room = LONGEST_MESSAGE - len(self._about)
        text = self._within(room)
        kept = min(len(text), _SHORT_TEXT + len(self._end))
        hints = whole_sentences("; ".join(self.hints), room - 2 - kept)
        if hints:
            text = f"{self._within(room - 2 - len(hints))}; {hints}"
        self.args = (f"{self._about}{text}",)


def _made_again(kind: type[CmbotError], args: tuple[Any, ...]) -> CmbotError:
    """An error without what its attributes say."""
    error = kind.__new__(kind)
    error.args = args
    return error


@dataclass(eq=False, repr=False)
class InputError(CmbotError, ValueError):
    """The input is wrong; reads ``FILE:LINE: KEY: got X, expected Y``.

    Parameters
    ----------
    source : str
        The file, or the name of the argument, that holds the value.
    key : str
        Where in it: a key's path such as ``tool_path.legs[1].seconds``; empty for the whole.
    got : object
        What stands there; 300 characters of it are written. ``no such file`` and the like are written without
        "got".
    expected : str
        What should stand there, or what to do.
    choices : sequence of str, optional
        The valid values, when they can be listed; the message has as many as it can hold.
    line : int, optional
        Where in the file, counted from 1.
    """

    holds = ""
    """What the format of a file begins with that was given in place of another one, or ``xml``."""

    source: str
    key: str
    got: object
    expected: str
    choices: Sequence[str] = ()
    _: KW_ONLY
    line: int | None = None

    def __post_init__(self) -> None:
        self.choices = tuple(self.choices)
        super().__init__("")

    def set_line(self, line: int | None) -> None:
        """Say in the message where in the file the key is."""
        self.line = line
        self._say()

    def _within(self, room: int) -> str:
        source, key, expected = one_line(self.source), one_line(self.key), one_line(self.expected)
        got = one_line(self.got)
        found = got if got.startswith("no such ") else f"got {got}"

        def joined() -> str:
            line = "" if self.line is None else f":{self.line}"
            return f"{source}{line}{f': {key}' if key else ''}: {found}, expected {expected}"

        if (excess := len(joined()) - room) > 0:
            # The end often says more than the middle.
            found = _cut_within(found, max(len(found) - excess, _SHORT_VALUE))
        if len(joined()) > room:
            source = _end_of(source)
        if (excess := len(joined()) - room) > 0:
            expected = whole_sentences(expected, max(len(expected) - excess, _SHORT_VALUE))
        if (excess := len(joined()) - room) > 0:
            key = _cut_within(key, max(len(key) - excess, _SHORT_VALUE))
        text = whole_sentences(joined(), room)
        return text + _listed(self.choices, room - len(text))


def _end_of(source: str) -> str:
    """The path of a file, or of a long one its end."""
    return source if len(source) <= _SHORT_SOURCE else f"…{source[1 - _SHORT_SOURCE :]}"


def _listed(choices: Sequence[str], room: int) -> str:
    """As many choices as there is room for, and the number of the others."""
    for number in range(len(choices), 0, -1):
        others = len(choices) - number
        listed = ", ".join(map(one_line, choices[:number])) + (f" and {others} more" if others else "")
        if len(listed) + len(" (one of: )") <= room:
            return f" (one of: {listed})"
    return ""


class ModelError(InputError):
    """A robot description (URDF, SRDF, joint limits, elasticity) is missing, unreadable or impossible."""


class SceneError(InputError):
    """A scene file is missing, unreadable or impossible."""


class ArchiveError(InputError):
    """A plan directory is missing, incomplete, of another version, or in the way."""


def beyond(violation: float) -> str:
    """Return in words by which share of its bound a constraint is violated."""
    return f"{violation:.2%} beyond its bound" if violation <= FAR_BEYOND else "far beyond its bound"


class PlanningError(CmbotError, RuntimeError):
    """The input is fine, but no valid plan came out of it."""

    stopped = False
    """Whether the time was over before it was known whether there is one."""


@dataclass(eq=False, repr=False)
class PathNotFound(PlanningError):
    """No joint path follows the tool path to its end.

    Parameters
    ----------
    reason : str
        What stopped the path, in a sentence.
    time : float
        Where it stopped, s.
    progress : float
        Share of the tool path's length that was covered, 0 to 1.
    smallest_singular_value : float
        Of the task Jacobian there, Chang 2021, Eqs. (18)-(19); told where it is small.
    pair : tuple of str, optional
        The link and the obstacle (or second link) that came too close.
    pace : float
        Where the joints' velocities do not suffice to lead on from there: that factor on them would do.
    stopped : bool
        The time was over.
    key : str
        Of what in the scene stopped it, where that is known; the reason names it.
    """

    reason: str
    _: KW_ONLY
    time: float
    progress: float
    smallest_singular_value: float
    pair: tuple[str, str] | None = None
    pace: float = 1.0
    stopped: bool = False
    key: str = ""

    def __post_init__(self) -> None:
        value = self.smallest_singular_value
        covered = f" beyond t = {self.time:.2f} s ({self.progress:.0%} of the tool path)" * (self.time > 0)
        near = f"; near a singular posture (smallest singular value {value:.3g})"
        text = f"no path{covered}: {self.reason}"
        super().__init__(text, near if 0 < value < _NEAR_SINGULAR_VALUE else "")


@dataclass(eq=False, repr=False)
class OptimisationFailed(PlanningError):
    """The trajectory optimisation ended without a point that meets its constraints.

    Parameters
    ----------
    reason : str
        What happened, in a sentence.
    constraint : str
        The constraint that is furthest from being met.
    violation : float
        By how much, as a share of its bound.
    trajectory : object, optional
        The `QuinticTrajectory` that violates it.
    limit : Limit
        What the constraint limits.
    time : float, optional
        When it is violated most, s.
    stopped : bool
        The time was over.
    """

    reason: str
    _: KW_ONLY
    constraint: str
    violation: float
    trajectory: object = None
    limit: Limit = Limit.OTHER
    time: float | None = None
    stopped: bool = False

    def __post_init__(self) -> None:
        at = "" if self.time is None else f" at t = {self.time:.2f} s"
        worst = f"; worst constraint: {self.constraint}{at}, {beyond(self.violation)}"
        met = f"; every constraint is met, {self.constraint} with the least room"
        super().__init__(self.reason, worst if self.violation > 0 else met)


@dataclass(eq=False, repr=False)
class LimitViolation(PlanningError):
    """A finished trajectory violates a limit.

    Parameters
    ----------
    quantity : str
        What is limited, such as ``velocity of joint_3``.
    time : float
        When, s.
    value, bound : float
        What it is there and what is allowed, both in `unit`.
    unit : str
        SI unit of both.
    limit : Limit
        What the quantity is.
    """

    quantity: str
    _: KW_ONLY
    time: float
    value: float
    bound: float
    unit: str
    limit: Limit = Limit.OTHER

    def __post_init__(self) -> None:
        found, bound = (f"{each:.6g} {self.unit}" for each in (self.value, self.bound))
        super().__init__(f"{self.quantity} is {found} at t = {self.time:.3f} s, the bound is {bound}")


class SimulationDiverged(CmbotError, RuntimeError):
    """The elastic motion left the range of its model.

    Parameters
    ----------
    time : float
        Of the first state outside, s.
    state : sequence of float
        The elastic coordinates there, m and rad.
    """

    def __init__(self, *, time: float, state: Sequence[float]) -> None:
        self.time = time
        self.state = tuple(state)
        largest = max((abs(x) for x in self.state if math.isfinite(x)), default=math.nan)
        lost = sum(not math.isfinite(x) for x in self.state)
        super().__init__(
            f"the simulation diverges at t = {time:.4f} s: the largest elastic coordinate is {largest:.3g} "
            f"(m or rad), {lost} of {len(self.state)} are not finite"
        )


class MissingExtra(CmbotError, ImportError):
    """An optional package or program is not installed.

    Parameters
    ----------
    package : str
        What could not be imported or found.
    extra : str
        The extra of cmbot that it belongs to.
    command : str, optional
        What installs it; left out: `cmbot.common.installation.install_command` of the extra.
    """

    def __init__(self, package: str, extra: str, command: str = "") -> None:
        self.package = package
        self.extra = extra
        self.command = command or install_command(extra)
        super().__init__(f"{package} is not installed; run: {self.command}")

    def _say(self) -> None:
        super()._say()
        # What an ImportError prints.
        self.msg = self.args[0]


def optional_module(name: str, package: str, extra: str) -> Any:
    """Import a module of an optional package of an extra; a `MissingExtra` where it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        raise MissingExtra(package, extra) from error
