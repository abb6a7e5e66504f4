"""The search among stances: those of the smallest bounds first, each judged by more and more costly means."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import Literal

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import (
    CmbotError,
    InputError,
    LimitViolation,
    OptimisationFailed,
    PathNotFound,
)
from cmbot.common.representation import short_repr
from cmbot.planning import Plan, plan
from cmbot.scene import PlannerOptions, Scene
from cmbot.stances.candidates import Candidate, climber_in_the_way
from cmbot.stances.charting import bounded_quickly, chart
from cmbot.stances.placed_scene import scene_at
from cmbot.stances.screening import Screening

# Bases nearer, m, to one that could not be planned or charted are tried last.
_NEAR = {"plan": 0.3, "charts": 0.12}
# Attempts to plan: so many times the number of plans wanted and one more.
_TRIES = 2
# A stance is not planned where the postures of its charts have this factor of the largest torque; a plan may
# have a smaller one.
_ROOM = 1.05
# Time that planning is given at least, s.
_SHORTEST = 1e-3
# Why no bound was found of stances that the arm's links do not reach, and that they do reach.
_UNFOUND = {
    False: "out of reach of the arm's links",
    True: "no posture found within the bounds of joints and feet",
}
_TOO_MUCH = "more torque on the guardrail than is allowed"
# Once enough are planned, only stances that may be better by more than this share are judged.
_GAP = 0.02


@dataclass(frozen=True, kw_only=True)
class StandOptions:
    """Which stances are candidates, and how many of them are judged.

    Attributes
    ----------
    spacing : float, m
        Between places of foot 1 with foot 2 free.
    pair_spacing : float, m
        Between places of both feet; infinite: foot 2 stays free.
    plans : int
        Number of stances that are planned in full, the best by their bounds.
    charts : int
        Largest number of stances that are charted.
    checks : int
        Largest number of stances that are checked for obstacles.
    members : tuple of str
        Posts and rails that feet hold; empty: all.
    max_torque : float, Nm
        Stances whose plan has a larger peak of the torque on the guardrail at work are left out.
    time_limit : float, s
        After which no stance is judged any more; what was planned until then is kept.
    """

    spacing: float = 0.05
    pair_spacing: float = 0.15
    plans: int = 3
    charts: int = 40
    checks: int = 400
    members: tuple[str, ...] = ()
    max_torque: float = np.inf
    time_limit: float = np.inf


@dataclass(kw_only=True)
class Ending:
    """When a search ends before its time, and why it did.

    Attributes
    ----------
    limit : float, s
        From now on.
    by : str
        ``interrupt`` where the user stopped it, ``time`` where that was over, else empty.
    keeps : bool
        Whether something was planned that is kept.
    """

    limit: float
    by: Literal["", "interrupt", "time"] = ""
    keeps: bool = False
    _began: float = field(default_factory=monotonic)

    def is_due(self) -> bool:
        """Whether no other stance is to be judged."""
        if not self.by and self._left() <= 0:
            self.by = "time"
        return bool(self.by)

    def within(self, scene: Scene) -> PlannerOptions:
        """Return the scene's options with no more time than is left."""
        given, most = scene.planner, max(self._left(), _SHORTEST)
        return given if given.time_limit_s <= most else replace(given, time_limit_s=most)

    def _left(self) -> float:
        return self.limit - (monotonic() - self._began)


@dataclass(frozen=True, kw_only=True, eq=False)
class Stood:
    """A candidate, how far it was judged, and with what result.

    Attributes
    ----------
    candidate : Candidate
    status : str
        ``planned``, ``failed`` where planning failed, ``too much torque`` where the plan exceeds the largest
        torque, ``screened`` where none was tried, ``blocked`` where the
        climber or all postures that were found at some via-point come too near to something, or no sequence
        of postures leads along a stroke, ``no posture`` where none within the bounds of joints and feet was
        found at one, ``out of reach``.
    judged : str
        By what, the furthest it came: ``reach`` of the links, sampled ``postures``, ``obstacles`` with charts
        at some via-points, ``charts`` at all of them, a ``plan``.
    bound, torque, adhesion : float
        As `Screening` has them; the bound that of the last judgement.
    plan : Plan or None
    reason : str
        Why there is no plan.
    cause : str
        That without what it has to do with this stance alone: the same for many.
    own : bool
        Whether it is that of the scene, or of one of several.
    """

    candidate: Candidate
    status: str
    judged: str
    bound: float
    torque: float
    adhesion: float
    plan: Plan | None = None
    reason: str = ""
    cause: str = ""
    own: bool = False

    __repr__ = short_repr

    @property
    def place(self) -> str:
        """Where the feet hold, in words."""
        return self.candidate.place


def judged(
    scene: Scene,
    candidates: Sequence[Candidate],
    found: Screening,
    strokes: Sequence[int],
    options: StandOptions,
    progress: Callable[[str, float], None],
    suits: Callable[[Candidate], str | None] = lambda _: None,
    own: Mapping[Candidate, FloatArray | None] | None = None,
    ending: Ending | None = None,
) -> tuple[Stood, ...]:
    """Return the candidates for some strokes as they were judged, the best first.

    Parameters
    ----------
    scene : Scene
        Of these strokes, as `in_world` returns it.
    candidates : sequence of Candidate
    found : Screening
        Of the candidates.
    strokes : sequence of int
        Numbers of the strokes in the screening.
    options : StandOptions
    progress : callable
        Takes what is done and the share of it.
    suits : callable
        Takes a candidate; why it is left out, or None.
    own : mapping of Candidate to (n,), rad, or None, optional
        Stances of the scenes, which are planned before all others, from these postures.
    ending : Ending, optional
    """
    own = own or {}
    within = np.asarray(found.within_reach[strokes].all(axis=0))
    each = [
        Stood(
            candidate=candidate,
            status=_status(bool(within[k]), float(found.bound[strokes, k].max())),
            judged="postures" if within[k] else "reach",
            bound=float(found.bound[strokes, k].max()),
            torque=float(found.torque[strokes, k].max()),
            adhesion=float(found.adhesion[strokes, k].max()),
            cause="" if np.isfinite(found.bound[strokes, k].max()) else _UNFOUND[bool(within[k])],
            own=candidate in own,
        )
        for k, candidate in enumerate(candidates)
    ]
    _Search(scene, each, options, suits, own, ending or Ending(limit=options.time_limit)).run(progress)
    return tuple(sorted(each, key=_order))


def _status(within: bool, bound: float) -> str:
    if not within:
        return "out of reach"
    return "screened" if np.isfinite(bound) else "no posture"


def _order(each: Stood) -> tuple[int, float]:
    if each.plan is not None:
        return 0, each.plan.objective.planned_peak
    order = ("screened", "failed", "too much torque", "blocked", "no posture", "out of reach")
    return 1 + order.index(each.status), each.bound


class _Search:
    """Judges stances, those of the smallest bounds first, each by more and more costly means."""

    def __init__(
        self,
        scene: Scene,
        each: list[Stood],
        options: StandOptions,
        suits: Callable[[Candidate], str | None],
        own: Mapping[Candidate, FloatArray | None],
        ending: Ending,
    ) -> None:
        self._suits, self._own, self._ending = suits, own, ending
        self._scene = scene
        self.each, self._options = each, options
        self._begins, self._failures = dict[int, FloatArray | None](), list[tuple[FloatArray, float]]()
        self._waiting = [(one.bound, k) for k, one in enumerate(each) if one.status == "screened"]
        heapq.heapify(self._waiting)
        # Those near a failure, until no others wait.
        self._later = list[tuple[float, int]]()
        self._best: int | None = None
        self._checks = self._charts = self._tries = self._planned = 0

    def run(self, progress: Callable[[str, float], None]) -> None:
        """Judge until enough are planned and none can be better, or the attempts or the time are used up.

        What was planned is kept where a user stops the search; where nothing was, it is stopped.
        """
        if not self._options.plans:
            return
        try:
            self._plan_own(progress)
            self._judge(progress)
        except KeyboardInterrupt:
            if not self._ending.keeps:
                raise
            self._ending.by = "interrupt"

    def _plan_own(self, progress: Callable[[str, float], None]) -> None:
        """Plan the scenes' own stances: no other one is better than they are unless it is planned, too."""
        for k, each in enumerate(self.each):
            if each.own and each.status != "out of reach" and not self._ending.is_due():
                progress("planning the scene's own stance", 0.0)
                self._begins[k] = self._own[each.candidate]
                if why := self._suits(each.candidate):
                    self._reject(k, "blocked", "obstacles", why, why)
                else:
                    self._plan(k)

    def _judge(self, progress: Callable[[str, float], None]) -> None:
        options = self._options
        while (self._waiting or self._later) and not self._ending.is_due():
            if not self._waiting:
                self._waiting, self._later, self._failures = self._later, [], []
                heapq.heapify(self._waiting)
            key, k = heapq.heappop(self._waiting)
            if self.each[k].status != "screened" or self.each[k].bound >= self._enough:
                continue
            if self.each[k].judged != "postures" and self._is_near_a_failure(k):
                # It most likely fails for the same reason: others come first.
                self._later.append((key, k))
                continue
            match self.each[k].judged:
                case "postures" if self._checks < options.checks:
                    progress("checking the most promising for obstacles", self._checks / options.checks)
                    self._check(k)
                case "obstacles" if self._charts < options.charts:
                    progress("charting the most promising", self._charts / options.charts)
                    self._chart(k)
                case "charts" if self._tries < _TRIES * (options.plans + 1):
                    enough = self._planned >= options.plans
                    step = f"planning stance {self._planned + 1} of {options.plans}"
                    step = "planning one that may be better" if enough else step
                    progress(step, min(self._planned / options.plans, 1.0))
                    self._tries += 1
                    self._plan(k)

    @property
    def _enough(self) -> float:
        """Once enough are planned, only stances whose bound is below this are looked at."""
        best = None if self._best is None else self.each[self._best].plan
        if best is None or self._planned < self._options.plans:
            return np.inf
        return (1 - _GAP) * best.objective.planned_peak

    def _is_near_a_failure(self, k: int) -> bool:
        base = self.each[k].candidate.base[:3, 3]
        return any(np.linalg.norm(base - other) < near for other, near in self._failures)

    def _check(self, k: int) -> None:
        """Leave out stances that are too near to something, or from which no postures lead along a stroke."""
        candidate, scene = self.each[k].candidate, self._scene
        why = climber_in_the_way(scene, candidate) or self._suits(candidate)
        if why is not None:
            self._reject(k, "blocked", "obstacles", why, why)
            return
        # The next check takes longer.
        self._checks += 1
        try:
            bound = bounded_quickly(scene_at(scene, candidate, None))
        except CmbotError as error:
            self._reject(k, "blocked", "obstacles", str(error), _cause(error))
            return
        # Nothing is charted where the tool's axis may lean.
        bound = bound or self.each[k].bound
        self._bounded(k, "obstacles", bound, bound)

    def _chart(self, k: int) -> None:
        self._charts += 1
        try:
            scene = scene_at(self._scene, self.each[k].candidate, None)
            charted = chart(scene.with_options(self._ending.within(scene)))
        except CmbotError as error:
            self._reject(k, "blocked", "charts", str(error), _cause(error))
            return
        most = self._options.max_torque
        if charted.torque > _ROOM * most:
            why = f"{charted.torque:.1f} Nm on the guardrail in its best postures, {most:g} Nm are allowed"
            self._reject(k, "too much torque", "charts", why, _TOO_MUCH)
            return
        self._begins[k] = charted.begins
        # With few via-points the allowance between postures is smaller, with many the bound is tighter.
        bound = min(max(charted.bound, self.each[k].bound), charted.expected)
        self._bounded(k, "charts", bound, charted.expected)

    def _plan(self, k: int) -> None:
        try:
            scene = scene_at(self._scene, self.each[k].candidate, self._begins[k])
            made = plan(scene, options=self._ending.within(scene))
        except CmbotError as error:
            self._reject(k, "failed", "plan", str(error), _cause(error))
            return
        if left_out := sum(one.unreached for one in made.coverage.values()):
            why = "of the rasters are not reached"
            self._reject(k, "failed", "plan", f"{left_out:.3g} m2 {why}", f"parts {why}")
            return
        torque = made.figures.peak_guardrail_torque
        if torque > self._options.max_torque:
            allowed = f"{self._options.max_torque:g} Nm are allowed"
            why = f"{torque:.1f} Nm on the guardrail, {allowed}"
            self._reject(k, "too much torque", "plan", why, _TOO_MUCH)
            return
        # No estimate is above what was found.
        bound = min(self.each[k].bound, made.objective.planned_peak)
        done = replace(self.each[k], status="planned", judged="plan", plan=made, bound=bound, cause="")
        self.each[k], self._ending.keeps = done, True
        # The scene's own is one more.
        self._planned += not done.own
        if self._best is None or _order(self.each[k]) < _order(self.each[self._best]):
            self._best = k

    def _bounded(self, k: int, judged: str, bound: float, expected: float) -> None:
        """Note a bound; the stance takes its place among the others again, by what is expected of it."""
        self.each[k] = replace(self.each[k], judged=judged, bound=bound)
        heapq.heappush(self._waiting, (max(expected, bound), k))

    def _reject(self, k: int, status: str, judged: str, why: str, cause: str) -> None:
        self.each[k] = replace(self.each[k], status=status, judged=judged, reason=why, cause=cause)
        # A little further on the torque may be less; and only the scene's own has its start posture.
        if judged in _NEAR and status != "too much torque" and not self.each[k].own:
            self._failures.append((self.each[k].candidate.base[:3, 3], _NEAR[judged]))


def _cause(error: CmbotError) -> str:
    """Why a stance is left out, without the figures that are its own."""
    match error:
        case PathNotFound(pair=(link, other)):
            return f"{link} and {other} too near to each other"
        case PathNotFound() if error.pace > 1:
            return "joints too slow for the path"
        case PathNotFound():
            return "no sequence of admissible postures found"
        case OptimisationFailed():
            return f"{error.constraint} beyond its bound"
        case LimitViolation():
            return f"{error.quantity} beyond its bound"
        case InputError():
            return f"{error.key}: not {error.expected}"
        case _:
            return str(error)
