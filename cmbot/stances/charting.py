"""Charting: the bound of a stance by the planner's charts, obstacles and joint velocities included."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning import (
    Deadline,
    StrokeRequest,
    build_request,
    most_often_near,
    quick_bound,
    searched,
    starting_at_path,
    weakest_joint,
)
from cmbot.scene import Scene

# Via-points of a stroke that is charted quickly.
_VIA_POINTS = 13


@dataclass(frozen=True, kw_only=True, eq=False)
class Charted:
    """Bounds and sequences from the charts of all strokes.

    Attributes
    ----------
    bound : float
        Largest of the strokes' lower bounds at rest for sequences of postures that the joints can follow, in
        the objective's unit: an estimate (`GlobalSearch.followed_bound`).
    expected : float
        Largest value, at rest, of the best sequences that were found.
    torque : float, Nm
        Largest torque on the guardrail, at rest, in these sequences.
    begins : (n,), rad
        The first posture of the first stroke's sequence.
    """

    bound: float
    expected: float
    torque: float
    begins: FloatArray


def bounded_quickly(scene: Scene) -> float:
    """Return a bound as `Charted` has it, from charts at few via-points.

    Raises
    ------
    PathNotFound
        When no sequence of admissible postures leads along a stroke.
    """
    return max(quick_bound(request, _VIA_POINTS) for request in _strokes(scene))


def chart(scene: Scene) -> Charted:
    """Chart the strokes of a scene, each within the scene's time limit.

    Raises
    ------
    PathNotFound
        When no sequence of admissible postures leads along a stroke.
    """
    found = list[Charted]()
    for request in _strokes(scene):
        deadline = Deadline(scene.planner.time_limit_s)
        search, solution = searched(replace(request, deadline=deadline))
        if isinstance(solution, PathNotFound):
            raise solution
        bound = min(search.followed_bound(), solution.peak)
        torque = np.linalg.norm(request.cell.postures.at(solution.q).guardrail_torque, axis=1).max()
        found.append(Charted(bound=bound, expected=solution.peak, torque=float(torque), begins=solution.q[0]))
    return Charted(
        bound=max(each.bound for each in found),
        expected=max(each.expected for each in found),
        torque=max(each.torque for each in found),
        begins=found[0].begins,
    )


def _strokes(scene: Scene) -> Iterator[StrokeRequest]:
    """The strokes' requests, each from a posture that holds the tool where it begins."""
    request = build_request(scene, scene.planner)
    if scene.return_to not in ("start", "none"):
        _require_stow(request.tool_off)
    for number in range(len(request.strokes)):
        yield starting_at_path(request.at_stroke(number, scene))


def _require_stow(request: StrokeRequest) -> None:
    """Refuse a stance in which the arm cannot be put away: its base may be tilted."""
    cell = request.cell
    posture = request.state.posture if request.end_posture is None else request.end_posture
    q = posture[None]
    why, pair = "", None
    if cell.use_at_rest(cell.postures.at(q))[0] > 1:
        why = f"{weakest_joint(request.cell, q)} cannot hold the arm in its stow posture"
    elif not cell.clear(q)[0]:
        why, pair = (
            "the arm in its stow posture comes too near to something",
            most_often_near(request.cell, q),
        )
    if why:
        raise request.path_not_found(why, posture, pair=pair)
