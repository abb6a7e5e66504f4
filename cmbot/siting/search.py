"""The search among stances: those of the smallest bounds first, each judged by ever dearer means."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import CmbotError
from cmbot.planning import Plan, plan, robot_of
from cmbot.scene import Scene
from cmbot.siting.candidates import Candidate
from cmbot.siting.charting import chart
from cmbot.siting.footholds import climber_in_the_way
from cmbot.siting.placed_scene import scene_at
from cmbot.siting.screening import Screening

__all__ = ["MEANS", "StandOptions", "Stood", "judged"]

MEANS = ("reach", "postures", "obstacles", "charts", "plan")
"""By what stances are judged."""

# Seconds for a plan and for the charts of a stroke.
_PLAN_SECONDS, _CHART_SECONDS = 20.0, 10.0
# How near, m, the arm's base is to one that was planned or charted in vain where it is not tried, too.
_ALIKE = {"plan": 0.3, "charts": 0.12}
# So many times as many stances as are to be planned are tried, and once more that many.
_TRIES = 4


@dataclass(frozen=True, kw_only=True)
class StandOptions:
    """How many stances are looked at.

    Attributes
    ----------
    spacing : float, m
        Between places of foot 1 with foot 2 free.
    pair_spacing : float, m
        Between places of both feet; infinite: foot 2 stays free.
    plans : int
        So many of the most promising are planned in full.
    charts : int
        So many at most are charted.
    checks : int
        So many at most are checked for obstacles.
    members : tuple of str
        Posts and rails that feet hold; empty: all.
    """

    spacing: float = 0.05
    pair_spacing: float = 0.15
    plans: int = 3
    charts: int = 20
    checks: int = 400
    members: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Stood:
    """What became of a candidate.

    Attributes
    ----------
    candidate : Candidate
    status : str
        ``planned``, ``failed`` where that was tried, ``screened`` where it was not, ``blocked`` where all
        postures that were found at some via-point come too near to something or no sequence of them leads
        along a stroke, ``no posture`` where none within the bounds of joints and feet was found at one,
        ``out of reach``.
    judged : str
        By what, the furthest it came: ``reach`` of the links, sampled ``postures``, those clear of
        ``obstacles``, the planner's ``charts``, a ``plan``.
    bound, torque, adhesion : float
        As `Screening` has them, the bound raised by later judgements.
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

    @property
    def place(self) -> str:
        """Where the feet hold, in words."""
        stance = self.candidate.stance
        feet = [stance.foot_1] if stance.foot_2 is None else [stance.foot_1, stance.foot_2]
        return " and ".join(f"{foot.member} at {foot.along_m:.2f} m ({foot.face})" for foot in feet)

    @property
    def figures(self) -> tuple[str, str]:
        """Its bound and the planned peak, as they are shown."""
        bound = f"{self.bound:.1f}" if np.isfinite(self.bound) else "-"
        return bound, "-" if self.plan is None else f"{self.plan.objective.planned_peak:.1f}"


def judged(
    scene: Scene,
    candidates: Sequence[Candidate],
    found: Screening,
    strokes: Sequence[int],
    options: StandOptions,
    progress: Callable[[str, float], None],
    suits: Callable[[Candidate], str | None] = lambda _: None,
) -> tuple[Stood, ...]:
    """Return what became of candidates for some strokes, the best first.

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
    _Search(scene, each, found, strokes, options, suits).run(progress)
    return tuple(sorted(each, key=_order))


def _status(within: bool, bound: float) -> str:
    if not within:
        return "out of reach"
    return "screened" if np.isfinite(bound) else "no posture"


def _order(each: Stood) -> tuple[int, float]:
    if each.plan is not None:
        return 0, each.plan.objective.planned_peak
    order = ("screened", "failed", "blocked", "no posture", "out of reach")
    return 1 + order.index(each.status), each.bound


class _Search:
    """Judges stances, those of the smallest bounds first, each by ever dearer means."""

    def __init__(
        self,
        scene: Scene,
        each: list[Stood],
        found: Screening,
        strokes: Sequence[int],
        options: StandOptions,
        suits: Callable[[Candidate], str | None],
    ) -> None:
        self._suits = suits
        # A stance that fails takes long, and most often for want of time.
        limit = min(scene.planner.time_limit_s, _PLAN_SECONDS)
        self._scene = replace(scene, planner=replace(scene.planner, time_limit_s=limit))
        self.each, self._found, self._strokes, self._options = each, found, strokes, options
        self._begins, self._in_vain = dict[int, FloatArray](), list[tuple[FloatArray, float]]()
        self._waiting = [(one.bound, k) for k, one in enumerate(each) if one.status == "screened"]
        heapq.heapify(self._waiting)
        self._checks = self._charts = self._tries = self._planned = 0

    def run(self, progress: Callable[[str, float], None]) -> None:
        """Judge until enough are planned and none can be better, or the numbers of attempts are over."""
        best, options = np.inf, self._options
        while self._waiting and self._planned < options.plans:
            _, k = heapq.heappop(self._waiting)
            if self.each[k].bound >= best:
                continue
            if self.each[k].judged != "postures" and self._is_beside_one_in_vain(k):
                # What failed there most likely fails here: others come first, and this one stays.
                continue
            match self.each[k].judged:
                case "postures" if self._checks < options.checks:
                    progress("checking the most promising for obstacles", self._checks / options.checks)
                    self._check(k)
                case "obstacles" if self._charts < options.charts:
                    progress("charting the most promising", self._charts / options.charts)
                    self._chart(k)
                case "charts" if self._tries < _TRIES * (options.plans + 1):
                    step = f"planning stance {self._planned + 1} of {options.plans}"
                    progress(step, self._planned / options.plans)
                    best = min(best, self._plan(k))

    def _is_beside_one_in_vain(self, k: int) -> bool:
        base = self.each[k].candidate.base[:3, 3]
        return any(np.linalg.norm(base - other) < near for other, near in self._in_vain)

    def _check(self, k: int) -> None:
        """Leave out stances and postures that are too near to something."""
        candidate, scene = self.each[k].candidate, self._scene
        why = climber_in_the_way(scene, candidate) or self._suits(candidate)
        if why is not None:
            self._give_up(k, "blocked", "obstacles", why)
            return
        # What comes next takes longer.
        self._checks += 1
        clearances = Clearances(robot_of(scene_at(scene, candidate, None)), scene.obstacles)
        margin = scene.planner.safety_margin_m
        bound = self._found.clearing(candidate, clearances, margin, self._strokes)
        if np.isinf(bound):
            why = "every posture found at some via-point comes too near to something"
            self._give_up(k, "blocked", "obstacles", why)
        else:
            self._raise_bound(k, "obstacles", bound, bound)

    def _chart(self, k: int) -> None:
        self._charts += 1
        try:
            charted = chart(scene_at(self._scene, self.each[k].candidate, None), _CHART_SECONDS)
        except CmbotError as error:
            self._give_up(k, "blocked", "charts", str(error))
            return
        self._begins[k] = charted.begins
        self._raise_bound(k, "charts", charted.bound, charted.expected)

    def _plan(self, k: int) -> float:
        """Peak of the plan in a stance; infinite where there is none."""
        self._tries += 1
        try:
            made = plan(scene_at(self._scene, self.each[k].candidate, self._begins[k]))
        except CmbotError as error:
            self._give_up(k, "failed", "plan", str(error))
            return np.inf
        if left_out := sum(one.unreached for one in made.coverage.values()):
            self._give_up(k, "failed", "plan", f"{left_out:.3g} m2 of the rasters are not reached")
            return np.inf
        self.each[k] = replace(self.each[k], status="planned", judged="plan", plan=made)
        self._planned += 1
        return made.objective.planned_peak

    def _raise_bound(self, k: int, judged: str, bound: float, expected: float) -> None:
        """Note a bound; the stance takes its place among the others again, by what is expected of it."""
        self.each[k] = replace(self.each[k], judged=judged, bound=max(bound, self.each[k].bound))
        heapq.heappush(self._waiting, (max(expected, self.each[k].bound), k))

    def _give_up(self, k: int, status: str, judged: str, why: str) -> None:
        self.each[k] = replace(self.each[k], status=status, judged=judged, reason=why)
        if judged in _ALIKE:
            self._in_vain.append((self.each[k].candidate.base[:3, 3], _ALIKE[judged]))
