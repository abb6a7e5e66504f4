"""The nearest miss: where a stroke is furthest from having postures, and by how much."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.path.place_search import MissedPlace, worst_missed
from cmbot.planning.request import StrokeRequest
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.diagnosis import FEET, most_often_near, overload, weakest_joint
from cmbot.scene import AxisCone, Keep

# Distance of places along a leg, m, and the least number of steps on one; how many there are at most of a
# stroke, and of all together, and at least; as many ends of legs come on top.
_PLACE_DISTANCE_M, _MIN_LEG_STEPS = 0.05, 4
_MAX_STROKE_PLACES, _ALL_PLACES, _MIN_PLACES = 64, 480, 6
# By how many times what is missing a path is moved: the first one that does.
_MORE_MOVED = (1.1, 3.0, 10.0)
# A margin of zero has no shares.
_MIN_MARGIN_M = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class NearestMiss:
    """The place along a stroke for which a posture is furthest from found.

    Attributes
    ----------
    request : StrokeRequest
        Of the stroke.
    times : (N,), s
        Of the places that were tried.
    missed : MissedPlace
        The worst of them.
    is_clear : bool
        Whether postures had to be clear and strong enough, too.
    """

    request: StrokeRequest
    times: FloatArray
    missed: MissedPlace
    is_clear: bool

    @property
    def time(self) -> float:
        """When the tool would be there, s."""
        return float(self.times[self.missed.place])

    @property
    def first_time(self) -> float:
        """When the tool would be at the first place without a posture, s."""
        return float(self.times[~self.missed.found][0])

    @property
    def key(self) -> str:
        """The key of the leg that leads there."""
        return self.request.stroke.leg_key(self.request.task.path.leg_to(self.time))

    @property
    def where(self) -> str:
        """The place, in words."""
        return f"({', '.join(f'{x:.3f}' for x in self.request.task.path.position([self.time])[0])}) m"

    def reason(self, *, proven: bool = False) -> str:
        """Return what is the matter there, by how much, and how many places are like it."""
        request, missed = self.request, self.missed
        keep = request.stroke.file.keep
        kept = keep if isinstance(keep, str) else "axis"
        also = f"{int((~missed.found).sum())} of {len(missed.found)} places are like it"
        if missed.is_held:
            return (
                f"blocked at {self.where}: none of {missed.attempts} attempts to hold the tool's {kept} is "
                f"clear and strong enough, at best {self.at_best}; {also}"
            )
        held = f"no posture within the joint ranges that holds the tool's {kept} was found in"
        held = f"{held} {missed.attempts} attempts"
        if proven:
            held = f"no posture within the joint ranges holds the tool's {kept} (proven)"
        return f"out of reach at {self.where}: {held}, {missed.off(kept)}; {also}"

    def remedy(self) -> str:
        """Return what was tried and has a posture for every place; empty where nothing does."""
        each = [*self._moved()]
        for keep in less_kept(self.request.stroke.file.keep):
            task = ToolTask.of(self.request.task.path, keep)
            other = replace(self.request, task=task)
            if _worst(other, self.times, is_clear=self.is_clear) is None:
                key = f"{self.request.stroke.key}.keep"
                told = keep == "position" and self.request.stroke.file.waypoints is not None
                turns = f"the tool may turn{', whatever the table says of that' * told}"
                each.append(f"with {key} {keep}, by which {turns}, every place has a posture")
                break
        return ", or ".join(each)

    def _moved(self) -> Iterator[str]:
        """Yield by how much the path may be moved to where the nearest posture has the tool, if that does."""
        request, there = self.request, self.request.task.goals(self.times)
        if self.missed.is_held or request.cell.robot.fixed_tool is not None:
            return
        tool = request.cell.postures.tool_at(self.missed.best[None]).tool_point[0]
        for times in _MORE_MOVED:
            # As it is told.
            by = np.round(times * (tool - there.point[self.missed.place]), 3) + 0.0
            moved = replace(there, point=there.point + by)
            if worst_missed(request.cell.robot, request.task, moved, request.state.posture) is None:
                how = ", ".join(f"{x:.3f}" for x in by)
                yield f"moved by ({how}) m the path is within reach, obstacles aside"
                return

    @property
    def pair(self) -> tuple[str, str] | None:
        """What comes too near in the best posture; None where it is not held, or not strong enough."""
        near = self.missed.is_held and self._use <= 1.0
        return most_often_near(self.request.cell, self.missed.best[None]) if near else None

    @cached_property
    def _use(self) -> float:
        """Share of its bound that a joint or foot uses in the best posture, at most."""
        return float(self.request.cell.use_at_rest(self.request.cell.postures.at(self.missed.best[None]))[0])

    @property
    def feet_bind(self) -> bool:
        """Whether it is the feet that the best posture asks too much of."""
        return self._overloads and self._weakest == FEET

    @property
    def joints_bind(self) -> bool:
        """Whether it is a joint that the best posture asks too much of."""
        return self._overloads and self._weakest != FEET

    @property
    def _overloads(self) -> bool:
        return self.missed.is_held and self._use > 1.0

    @property
    def _weakest(self) -> str:
        return weakest_joint(self.request.cell, self.missed.best[None])

    @property
    def at_best(self) -> str:
        """What the best posture that was found lacks."""
        cell, best = self.request.cell, self.missed.best
        if asked := overload(cell, best):
            return asked
        smallest = cell.clearances.query(best[None])
        pair = cell.clearances.pairs[int(smallest.pair[0])]
        return pair.describe(float(smallest.distance[0]), cell.options.safety_margin_m)


def nearest_miss(
    request: StrokeRequest, *, is_clear: bool, times: FloatArray | None = None
) -> NearestMiss | None:
    """Return the nearest miss of a stroke; None where each place has a posture within the joint ranges.

    Parameters
    ----------
    request : StrokeRequest
        Of the stroke.
    is_clear : bool
        The postures have to be clear of obstacles and strong enough, too.
    times : (N,), s, optional
        Of the places in order; left out: those of `places_along`.
    """
    times = places_along(request) if times is None else times
    missed = _worst(request, times, is_clear=is_clear)
    if missed is None:
        return None
    return NearestMiss(request=request, times=times, missed=missed, is_clear=is_clear)


def places_along(request: StrokeRequest) -> FloatArray:
    """Return times (N,), s, of places along a stroke: ends of legs, and by length between them."""
    path = request.task.path
    most = max(min(_MAX_STROKE_PLACES, _ALL_PLACES // len(request.strokes)), _MIN_PLACES)
    steps = np.maximum(np.ceil(path.lengths / _PLACE_DISTANCE_M), _MIN_LEG_STEPS).astype(np.intp)
    between = [path.times_at(leg, np.linspace(0.0, 1.0, n + 1)) for leg, n in enumerate(steps)]
    each = [
        times[np.unique(np.linspace(0, len(times) - 1, most).round().astype(np.intp))]
        for times in (path.section_times, np.unique(np.concatenate(between)))
    ]
    return np.unique(np.concatenate(each))


def _worst(request: StrokeRequest, times: FloatArray, *, is_clear: bool) -> MissedPlace | None:
    cell = request.cell
    margin = cell.options.safety_margin_m

    def violation(q: FloatArray) -> FloatArray:
        weak = cell.use_at_rest(cell.postures.at(q)) - 1.0
        near = (margin - cell.clearances.query(q).distance) / max(margin, _MIN_MARGIN_M)
        return np.asarray(np.maximum(np.maximum(weak, near), 0.0))

    goals = request.task.goals(times)
    return worst_missed(
        cell.robot, request.task, goals, request.state.posture, violation if is_clear else None
    )


def less_kept(keep: Keep) -> Iterator[Literal["axis", "position"]]:
    """Yield what keeps less of the tool's pose, the most first."""
    if keep == "pose":
        yield "axis"
    if keep == "axis" or keep == "pose" or isinstance(keep, AxisCone):
        yield "position"
