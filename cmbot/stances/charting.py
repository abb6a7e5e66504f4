"""Charting: the bound of a stance by the planner's charts, obstacles and joint velocities included."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning import (
    Deadline,
    PostureObjective,
    StrokeRequest,
    TorqueFloorProof,
    build_request,
    most_often_near,
    quick_bound,
    searched,
    starting_at_path,
    weakest_joint,
)
from cmbot.scene import Scene

AtRest = Callable[[FloatArray], FloatArray]
"""What is ranked (N,) at rest in postures (N, n); in place of the planner's objective."""
# Share of a value by which a proof of it may be off.
_PROOF_TOLERANCE = 1e-4
# Via-points of a stroke that is charted quickly.
_VIA_POINTS = 13


class CannotBePutAway(PathNotFound):
    """The arm cannot be in the posture in which it starts or is put away: the reason is the same for many.

    Attributes
    ----------
    use : float
        Largest share of what joints and feet bear that it takes there; infinite where it is in the way.
    weakest : str
        Which joint takes that, or `FEET`; empty where it is in the way.
    """

    use = np.inf
    weakest = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Charted:
    """Bounds and sequences from the charts of all strokes.

    Attributes
    ----------
    bound : float
        Largest of the strokes' lower bounds at rest for sequences of postures that the joints can follow, in
        the unit of what is ranked: an estimate (`GlobalSearch.followed_bound`).
    expected : float
        Largest value, at rest, of the best sequences that were found.
    postures : (K, n), rad
        Of these sequences.
    """

    bound: float
    expected: float
    postures: FloatArray


def bounded_quickly(scene: Scene, at_rest: AtRest | None = None, limit: float = np.inf) -> float:
    """Return a bound as `Charted` has it, from charts at few via-points; of strokes until a time, s.

    Raises
    ------
    PathNotFound
        When no sequence of admissible postures leads along a stroke.
    """
    bound, deadline = 0.0, Deadline(limit)
    for request in _strokes(scene, at_rest):
        bound = max(bound, quick_bound(request, _VIA_POINTS))
        if deadline.expired():
            break
    return bound


def chart(scene: Scene, at_rest: AtRest | None = None, limit: float = np.inf) -> Charted:
    """Chart the strokes of a scene within a time `limit`, s.

    Raises
    ------
    PathNotFound
        When no sequence of admissible postures leads along a stroke.
    """
    bounds, peaks, postures = list[float](), list[float](), list[FloatArray]()
    deadline = Deadline(limit)
    for request in _strokes(scene, at_rest):
        search, solution = searched(replace(request, deadline=deadline, proves=False))
        if isinstance(solution, PathNotFound):
            raise solution
        bounds.append(min(search.followed_bound(), solution.peak))
        peaks.append(solution.peak)
        postures.append(solution.q)
    return Charted(bound=max(bounds), expected=max(peaks), postures=np.concatenate(postures))


def proven_bound(scene: Scene, stroke: int, times: FloatArray, value: float) -> float:
    """Return what is proven that no plan rests below, up to `value`; zero without a proof.

    Parameters
    ----------
    scene : Scene
        With the robot in the stance.
    stroke : int
    times : (K,), s
        Of via-points of the stroke: at one of them no admissible posture undercuts it. They are tried in
        their order until the value is proven.
    value : float
        What is to be proven.
    """
    request = replace(build_request(scene, scene.planner).at_stroke(stroke), times=times)
    proof, lowest = TorqueFloorProof.of(request), 0.0
    for k in range(len(times) if proof is not None else 0):
        if proof is not None and lowest < (1 - _PROOF_TOLERANCE) * value:
            lowest = max(lowest, proof.prove(k, value).lowest)
    return lowest


def _strokes(scene: Scene, at_rest: AtRest | None) -> Iterator[StrokeRequest]:
    """The strokes' requests, each from a posture that holds the tool where it begins."""
    request = build_request(scene, scene.planner)
    if at_rest is not None:
        objective = PostureObjective(function=_value(at_rest), name="", unit="")
        request = replace(request, cell=replace(request.cell, objective=objective))
    _require_put_away(scene, request.tool_off)
    for number in range(len(request.strokes)):
        yield starting_at_path(request.at_stroke(number))


def _value(at_rest: AtRest) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    def function(q: FloatArray, /) -> tuple[FloatArray, FloatArray]:
        return at_rest(q), np.zeros_like(q)  # charts need no gradient

    return function


def cannot_hold(weakest: str, name: str) -> str:
    """Return in words that a joint, or feet, cannot hold the arm in its ``stow`` or ``start`` posture."""
    return f"{weakest} cannot hold the arm in its {name} posture"


def _require_put_away(scene: Scene, request: StrokeRequest) -> None:
    """Refuse a stance in which the arm cannot be where it starts or is put away: its base may be tilted."""
    cell = request.cell
    if scene.return_to == "none" or request.end_posture is None:
        return  # it is put away by hand
    back = "start" if scene.return_to == "start" else str(scene.return_to)
    stowed = scene.start is None or scene.start.stow is not None
    ends = {back: request.end_posture, "stow" if stowed else "start": request.state.posture}
    for name, posture in ends.items():
        q = posture[None]
        why, pair, weakest = "", None, ""
        use = float(cell.use_at_rest(cell.postures.at(q))[0])
        if use > 1:
            weakest = weakest_joint(cell, q)
            why = cannot_hold(weakest, name)
        elif not cell.clear(q)[0]:
            why, pair = (
                f"the arm in its {name} posture comes too near to something",
                most_often_near(cell, q),
            )
        if why:
            singular = request.task.smallest_singular_value(cell.robot, posture)
            error = CannotBePutAway(why, time=0.0, progress=0.0, smallest_singular_value=singular, pair=pair)
            error.use, error.weakest = np.inf if pair else use, weakest
            raise error
