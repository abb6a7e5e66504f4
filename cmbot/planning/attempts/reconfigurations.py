"""Where a path through waypoints is cut, as no posture leads on: the arm goes on from another one.

Each part goes as far as a way was found. Parts of what can be followed can be followed, so other cuts would
not be fewer; Wang et al. (2024, IKLink) ask for the same number.
"""

from __future__ import annotations

import numpy as np

from cmbot.planning.attempts.failure import Failure, NoWay
from cmbot.planning.request import StrokeRequest
from cmbot.scene import Scene, waypoint_shares

# Parts at most, where the scene does not say how often a path may be cut.
_MOST_CUTS = 20
# Parts are no shorter.
_SHORTEST_M = 1e-3


class Reconfigurations:
    """The cuts of a scene's strokes.

    Attributes
    ----------
    ends : dict of str to tuple of int
        Of strokes that are cut, by their names, the waypoints that end a part and begin the next one.
    """

    def __init__(self, asked: Scene) -> None:
        self._asked = {str(file.name): file for file in asked.strokes}
        self.ends = dict[str, tuple[int, ...]]()

    def cut(self, request: StrokeRequest, failure: Failure) -> bool:
        """Cut a stroke, or a part, before the place where planning it failed; whether that may help."""
        file = request.stroke.file
        name = str(file.part_of or file.name)
        # Leads, passes and the way back are those of a whole path.
        is_whole = file.backwards or file.passes or file.lead_in_m or file.lead_out_m
        if file.waypoints is None or is_whole or not isinstance(failure, NoWay):
            return False
        via = int(np.searchsorted(request.times, failure.time - 1e-9)) - 1
        reached = request.task.path.progress(float(request.times[max(via, 0)]))
        shares = waypoint_shares(file)
        number = int(np.searchsorted(shares, reached, side="right")) - 1
        shorter = min(shares[number], 1 - shares[number]) * float(request.task.path.lengths.sum())
        before = [each.file for each in request.strokes[: request.number] if each.file.part_of == name]
        begin = sum(len(each.waypoints or ()) - 1 for each in before)
        # Parts behind this one are cut anew.
        ends = (*self.ends.get(name, ())[: len(before)], begin + number)
        allowed = self._asked[name].reconfigurations
        if shorter < _SHORTEST_M or len(ends) > (_MOST_CUTS if allowed is None else allowed):
            return False
        self.ends[name] = ends
        return True

    @property
    def in_words(self) -> tuple[str, ...]:
        """What is cut, a sentence each."""
        return tuple(
            f"{name} is cut at waypoint {', '.join(str(end + 1) for end in ends)} of "
            f"{len(self._asked[name].waypoints or ())}: no posture was found that leads on, so "
            "the arm goes on from another one there; reconfigurations: 0 forbids it."
            for name, ends in self.ends.items()
        )
