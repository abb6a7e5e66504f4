"""A tour: the work from the fewest stances, and the walks from each to the next, all certified."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from cmbot.common.errors import CmbotError, PlanningError
from cmbot.common.reading.validation import counted
from cmbot.common.representation import ShortRepr
from cmbot.planning import Plan
from cmbot.scene import Scene
from cmbot.stances import (
    AnyCandidate,
    Candidate,
    StanceRanking,
    StanceResult,
    StandOptions,
    joined,
    require_on_guardrail,
    require_planned,
    require_standing,
    scene_at,
    stand,
)
from cmbot.stances.walking.balance import Balance
from cmbot.stances.walking.walk import Walk, WalkOptions, walk
from cmbot.version import __version__

_Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Tour(ShortRepr):
    """Work and walks in their order.

    Attributes
    ----------
    name : str
    standings : tuple of StanceRanking
        Of each group of strokes, in the order in which they are done.
    works : tuple of StanceResult
        The planned stance that was taken of each.
    walks : tuple of Walk
        From each to the next, one less.
    failures : tuple of str
        Pairs of stances between which no walk was found, and why.
    """

    name: str
    standings: tuple[StanceRanking, ...]
    works: tuple[StanceResult, ...]
    walks: tuple[Walk, ...]
    failures: tuple[str, ...] = ()

    @property
    def plans(self) -> tuple[Plan, ...]:
        """The plans of the work."""
        return tuple(each.plan for each in self.works if each.plan is not None)

    @property
    def parts(self) -> Iterator[tuple[str, float, Plan | Walk]]:
        """Work and walks in their order: name of each, when it begins, s, and what it is."""
        begin = 0.0
        for number, plan in enumerate(self.plans, start=1):
            yield f"work_{number}", begin, plan
            begin += plan.job.duration
            if number <= len(self.walks):
                yield f"walk_{number}", begin, self.walks[number - 1]
                begin += self.walks[number - 1].seconds

    @property
    def seconds(self) -> float:
        """How long it takes, s."""
        work = sum(plan.job.duration for plan in self.plans)
        return work + sum(each.seconds for each in self.walks)

    def in_words(self) -> Iterator[str]:
        """Yield what was found, a sentence each."""
        strokes = sum(len(each.strokes) for each in self.standings)
        steps = sum(len(each.steps) for each in self.walks)
        walked = sum(each.seconds for each in self.walks)
        yield (
            f"{counted(strokes, 'stroke')} from {counted(len(self.works), 'stance')}, "
            f"{counted(steps, 'step')} between them, in {self.seconds:.0f} s: "
            f"{self.seconds - walked:.0f} s of work, "
            f"{walked:.0f} s of walking. Every motion is certified."
        )
        if len(self.works) > 1:
            yield "No fewer stances were found to be enough."
        peak = max(plan.job.figures.peak_guardrail_torque for plan in self.plans)
        yield f"At work the torque on the guardrail is at most {peak:.1f} Nm."
        needed = [each for each in (_needed(part) for _, _, part in self.parts) if each is not None]
        if needed:
            yield f"A magnet would need {max(needed) / 1e3:.2f} kN of adhesion at most."
        if self.standings[0].scene.guardrail.hold is None:
            yield "The feet are taken as welded: this says nothing about holding; see guardrail.hold."
        if self.failures:
            yield f"Between {counted(len(self.failures), 'other pair')} of stances no walk was found."


def tour(
    scenes: Scene | Sequence[Scene],
    stand_options: StandOptions | None = None,
    walk_options: WalkOptions | None = None,
    progress: _Progress = lambda _step, _share: None,
) -> Tour:
    """Plan the work of one or several scenes of a bridge, from as few stances as possible, and the walks.

    The stances are those of `cmbot.stances.stand` in which a foot can be lifted; of each group's planned
    stances, the best first, the first ones are taken between which a walk is found. A walk begins in the
    posture in which the work before it ends, and ends in that in which the next one starts.

    Parameters
    ----------
    scenes : Scene or sequence of Scene
    stand_options : StandOptions, optional
    walk_options : WalkOptions, optional
    progress : callable
        Takes what is done and the share of it.

    Raises
    ------
    SceneError
        As by `stand`.
    PlanningError
        When no stance was planned for a stroke, or no walk leads from one to the next.

    Examples
    --------
    A search of minutes:

    >>> found = cmbot.tour(cmbot.load_scene("two_brackets"))  # doctest: +SKIP
    """
    scenes = (scenes,) if isinstance(scenes, Scene) else tuple(scenes)
    for one in scenes:
        require_on_guardrail(one)
        require_standing(one, (stand_options or StandOptions()).members)
    world = joined(scenes)
    progress("listing postures of the arm", 0.0)
    balance = Balance(world, np.array(world.posture))

    def suits(candidate: AnyCandidate) -> str | None:
        leads = isinstance(candidate, Candidate) and balance.leads_away(world, candidate)
        return None if leads else "no step leads away from there"

    standings = stand(scenes, stand_options, progress, suits)
    if any(standing.ended_by == "interrupt" for standing in standings):
        raise KeyboardInterrupt  # no part of a tour is one
    choices = [[each for each in standing.ranked if each.status == "planned"] for standing in standings]
    require_planned(standings)
    walks, failures = dict[tuple[StanceResult, StanceResult], Walk | None](), list[str]()

    def leads(here: StanceResult, there: StanceResult) -> bool:
        if (here, there) not in walks:
            try:
                walks[here, there] = _walk(here, there, walk_options, progress)
            except CmbotError as error:
                walks[here, there] = None
                failures.append(f"{here.place} to {there.place}: {error}")
        return walks[here, there] is not None

    works = _linked(choices, leads, ())
    if works is None:
        raise PlanningError(f"no walk from one stance to the next: {failures[-1]}")
    found = tuple(each for pair in pairwise(works) if (each := walks[pair]) is not None)
    return Tour(name=world.name, standings=standings, works=works, walks=found, failures=tuple(failures))


def _linked(
    choices: Sequence[Sequence[StanceResult]],
    leads: Callable[[StanceResult, StanceResult], bool],
    works: tuple[StanceResult, ...],
) -> tuple[StanceResult, ...] | None:
    """The stances of all groups, those so far first; None where none leads on from each to the next."""
    if len(works) == len(choices):
        return works
    possible = (each for each in choices[len(works)] if not works or leads(works[-1], each))
    found = (_linked(choices, leads, (*works, each)) for each in possible)
    return next((each for each in found if each is not None), None)


def _walk(here: StanceResult, there: StanceResult, options: WalkOptions | None, progress: _Progress) -> Walk:
    if here.plan is None or there.plan is None:
        raise ValueError("both stances are planned")
    start = scene_at(here.plan.scene, here.candidate, here.plan.job.trajectory.q[-1])
    return walk(start, there.plan.scene, options, lambda step, share: progress(f"walking: {step}", share))


def _seconds(part: Plan | Walk) -> float:
    return part.job.duration if isinstance(part, Plan) else part.seconds


def _needed(part: Plan | Walk) -> float | None:
    """The largest adhesion that a foot needs, N."""
    peak = part.job.figures.adhesion_needed if isinstance(part, Plan) else part.adhesion_needed
    return None if peak is None else peak.peak


def tour_data(tour: Tour) -> dict[str, Any]:
    """Return the parts of a tour, ready for JSON."""
    parts = [part_data(*part) for part in tour.parts]
    return {
        "format": "cmbot-tour/1",
        "cmbot": __version__,
        "seconds": tour.seconds,
        "parts": parts,
        "words": list(tour.in_words()),
    }


def part_data(name: str, begin: float, part: Plan | Walk) -> dict[str, Any]:
    """Return what a tour says of a part that begins so many seconds after it, ready for JSON."""
    return {
        "name": name,
        "kind": "work" if isinstance(part, Plan) else "walk",
        "begin": begin,
        "seconds": _seconds(part),
        "adhesion_needed": _needed(part),
        **(_work(part) if isinstance(part, Plan) else {"steps": len(part.steps)}),
    }


def _work(plan: Plan) -> dict[str, Any]:
    return {
        "strokes": [stroke.name for stroke in plan.scene.strokes],
        "peak_torque": plan.job.figures.peak_guardrail_torque,
        "peak_torque_at_work": plan.figures.peak_guardrail_torque,
    }
