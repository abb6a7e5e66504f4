"""The search among stances: those of the smallest bounds first, each judged by more and more costly means."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import CmbotError
from cmbot.common.representation import short_repr
from cmbot.planning import Plan, plan
from cmbot.scene import Scene
from cmbot.siting.candidates import Candidate, climber_in_the_way
from cmbot.siting.charting import bounded_quickly, chart
from cmbot.siting.placed_scene import scene_at
from cmbot.siting.screening import Screening

__all__ = ["StandOptions", "Stood", "judged"]

# Bases nearer, m, to one that could not be planned or charted are tried last.
_NEAR = {"plan": 0.3, "charts": 0.12}
# Attempts to plan: so many times the number of plans wanted and one more.
_TRIES = 2
# A stance is not planned where the postures of its charts have this factor of the largest torque; a plan may
# have a smaller one.
_ROOM = 1.05
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
    """

    spacing: float = 0.05
    pair_spacing: float = 0.15
    plans: int = 3
    charts: int = 40
    checks: int = 400
    members: tuple[str, ...] = ()
    max_torque: float = np.inf


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
    """

    candidate: Candidate
    status: str
    judged: str
    bound: float
    torque: float
    adhesion: float
    plan: Plan | None = None
    reason: str = ""

    __repr__ = short_repr

    @property
    def place(self) -> str:
        """Where the feet hold, in words."""
        stance = self.candidate.stance
        feet = [stance.foot_1] if stance.foot_2 is None else [stance.foot_1, stance.foot_2]
        return " and ".join(f"{foot.member} at {foot.along_m:.2f} m ({foot.face})" for foot in feet)


def judged(
    scene: Scene,
    candidates: Sequence[Candidate],
    found: Screening,
    strokes: Sequence[int],
    options: StandOptions,
    progress: Callable[[str, float], None],
    suits: Callable[[Candidate], str | None] = lambda _: None,
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
    """
    within = np.asarray(found.within_reach[strokes].all(axis=0))
    each = [
        Stood(
            candidate=candidate,
            status=_status(bool(within[k]), float(found.bound[strokes, k].max())),
            judged="postures" if within[k] else "reach",
            bound=float(found.bound[strokes, k].max()),
            torque=float(found.torque[strokes, k].max()),
            adhesion=float(found.adhesion[strokes, k].max()),
        )
        for k, candidate in enumerate(candidates)
    ]
    _Search(scene, each, options, suits).run(progress)
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
    ) -> None:
        self._suits = suits
        self._scene = scene
        self.each, self._options = each, options
        self._begins, self._failures = dict[int, FloatArray](), list[tuple[FloatArray, float]]()
        self._waiting = [(one.bound, k) for k, one in enumerate(each) if one.status == "screened"]
        heapq.heapify(self._waiting)
        # Those near a failure, until no others wait.
        self._later = list[tuple[float, int]]()
        self._best: int | None = None
        self._checks = self._charts = self._tries = self._planned = 0

    def run(self, progress: Callable[[str, float], None]) -> None:
        """Judge until enough are planned and none can be better, or the attempts are used up."""
        options = self._options
        while options.plans and (self._waiting or self._later):
            if not self._waiting:
                self._waiting, self._later, self._failures = self._later, [], []
                heapq.heapify(self._waiting)
            key, k = heapq.heappop(self._waiting)
            if self.each[k].bound >= self._enough:
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
            self._reject(k, "blocked", "obstacles", why)
            return
        # The next check takes longer.
        self._checks += 1
        try:
            bound = bounded_quickly(scene_at(scene, candidate, None))
        except CmbotError as error:
            self._reject(k, "blocked", "obstacles", str(error))
            return
        # Nothing is charted where the tool's axis may lean.
        bound = bound or self.each[k].bound
        self._bounded(k, "obstacles", bound, bound)

    def _chart(self, k: int) -> None:
        self._charts += 1
        try:
            charted = chart(scene_at(self._scene, self.each[k].candidate, None))
        except CmbotError as error:
            self._reject(k, "blocked", "charts", str(error))
            return
        most = self._options.max_torque
        if charted.torque > _ROOM * most:
            why = f"{charted.torque:.1f} Nm on the guardrail in its best postures, {most:g} Nm are allowed"
            self._reject(k, "too much torque", "charts", why)
            return
        self._begins[k] = charted.begins
        # With few via-points the allowance between postures is smaller, with many the bound is tighter.
        bound = min(max(charted.bound, self.each[k].bound), charted.expected)
        self._bounded(k, "charts", bound, charted.expected)

    def _plan(self, k: int) -> None:
        self._tries += 1
        try:
            made = plan(scene_at(self._scene, self.each[k].candidate, self._begins[k]))
        except CmbotError as error:
            self._reject(k, "failed", "plan", str(error))
            return
        if left_out := sum(one.unreached for one in made.coverage.values()):
            self._reject(k, "failed", "plan", f"{left_out:.3g} m2 of the rasters are not reached")
            return
        torque = made.figures.peak_guardrail_torque
        if torque > self._options.max_torque:
            allowed = f"{self._options.max_torque:g} Nm are allowed"
            self._reject(k, "too much torque", "plan", f"{torque:.1f} Nm on the guardrail, {allowed}")
            return
        # No estimate is above what was found.
        bound = min(self.each[k].bound, made.objective.planned_peak)
        self.each[k] = replace(self.each[k], status="planned", judged="plan", plan=made, bound=bound)
        self._planned += 1
        if self._best is None or _order(self.each[k]) < _order(self.each[self._best]):
            self._best = k

    def _bounded(self, k: int, judged: str, bound: float, expected: float) -> None:
        """Note a bound; the stance takes its place among the others again, by what is expected of it."""
        self.each[k] = replace(self.each[k], judged=judged, bound=bound)
        heapq.heappush(self._waiting, (max(expected, bound), k))

    def _reject(self, k: int, status: str, judged: str, why: str) -> None:
        self.each[k] = replace(self.each[k], status=status, judged=judged, reason=why)
        # A little further on the torque may be less.
        if judged in _NEAR and status != "too much torque":
            self._failures.append((self.each[k].candidate.base[:3, 3], _NEAR[judged]))
