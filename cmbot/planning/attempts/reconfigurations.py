"""Where a path is cut, as no posture leads on: the arm goes on from another one.

Each part goes as far as a way was found. Parts of what can be followed can be followed, so other cuts would
not be fewer; Wang et al. (2024, IKLink) ask for the same number.
"""

from __future__ import annotations

import numpy as np

from cmbot.common.errors import PathNotFound
from cmbot.common.limit import Limit
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.attempts.failure import Failure, NoTrajectory, NoWay, OtherLimit
from cmbot.planning.initial_guess import InitialGuess, furthest
from cmbot.planning.request import StrokeRequest
from cmbot.scene import Scene, StrokeFile, waypoint_shares

# Parts at most, where the scene does not say how often a path may be cut.
_MOST_CUTS = 20
# Parts are no shorter, as a share of what is cut; places on legs are told in so many digits.
_SHORTEST_PART, _PLACE_DIGITS = 1e-3, 4


class Reconfigurations:
    """The cuts of a scene's strokes.

    Attributes
    ----------
    ends : dict of str to tuple of float
        Of strokes that are cut, by their names, where each part ends and the next one begins: see
        `Scene.with_cuts`.
    """

    def __init__(self, asked: Scene) -> None:
        self._asked = {str(file.name): file for file in asked.strokes}
        self.ends = dict[str, tuple[float, ...]]()

    def cut(self, first: Attempt, failure: Failure) -> bool:
        """Cut a stroke, or a part, before the place where planning it failed; whether that may help.

        Parameters
        ----------
        first : Attempt
            The first one at the stroke.
        failure : Failure
            The one that is to be told.
        """
        file = first.request.stroke.file
        name, begin = str(file.part_of or file.name), file.begins_at or 0.0
        # Parts that were asked, as those of a raster, are not cut further.
        reached, asked = _reached(first, failure), self._asked.get(name)
        # Fixed knots are those of the path of gradient projection, which leads on from one posture.
        if reached is None or asked is None or first.request.cell.options.knots == "fixed":
            return False
        leg, share = divmod(_behind(first.request, reached), 1)
        leg += int(begin)
        # Of the legs that the part begins and ends in it has some.
        last = next((each for each in self.ends.get(name, ()) if each > begin), asked.steps)
        since = max(begin, leg)
        end = round(since + share * (min(leg + 1, last) - since), _PLACE_DIGITS)
        # Parts behind this one are cut anew.
        ends = (*(each for each in self.ends.get(name, ()) if each <= begin), end)
        most = _MOST_CUTS if asked.reconfigurations is None else asked.reconfigurations
        if not asked.can_be_cut(end) or min(end - begin, last - end) < _SHORTEST_PART or len(ends) > most:
            return False
        self.ends[name] = ends
        return True

    @property
    def in_words(self) -> tuple[str, ...]:
        """What is cut, a sentence each."""
        return tuple(
            f"{name} is cut at {_places(self._asked[name], ends)}: no posture was found that leads on, so "
            "the arm goes on from another one there; reconfigurations: 0 forbids it."
            for name, ends in self.ends.items()
        )


def _places(file: StrokeFile, ends: tuple[float, ...]) -> str:
    if file.waypoints is not None:
        return f"waypoint {', '.join(f'{end + 1:g}' for end in ends)} of {len(file.waypoints)}"
    return ", ".join(
        f"the end of legs[{end - 1:g}]" if end.is_integer() else f"{end % 1:.0%} of legs[{int(end)}]"
        for end in ends
    )


def _reached(first: Attempt, failure: Failure) -> float | None:
    """The time, s, of the last via-point that a way was found to; None where nothing tells."""
    match failure, first.guess:
        case NoWay(error=PathNotFound(time=time)), _:
            pass
        case NoTrajectory(broken=OtherLimit(what=Limit.LEAP)), InitialGuess() as guess:
            time = furthest(first.request, guess)
        case _:
            return None
    times = first.request.times
    return float(times[max(int(np.searchsorted(times, time - 1e-9)) - 1, 0)])


def _behind(request: StrokeRequest, time: float) -> float:
    """How many legs of a stroke, or steps between waypoints, are behind at a time."""
    file, path = request.stroke.file, request.task.path
    if file.waypoints is not None:
        shares = waypoint_shares(file)
        return float(np.searchsorted(shares, path.progress(time), side="right") - 1)
    leg, share = path.leg_shares([time])
    return float(leg[0] + share[0])
