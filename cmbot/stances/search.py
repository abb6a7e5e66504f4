"""The search among stances: best first, each judged by stages that cost more and more.

Each stage returns a better bound of a stance, or why it is left out. Of those that wait, the most promising
is judged by its next stage, until enough are planned and none can be better.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import Literal, get_args

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import (
    CmbotError,
    InputError,
    LimitViolation,
    OptimisationFailed,
    PathNotFound,
    PlanningError,
)
from cmbot.common.representation import ShortRepr
from cmbot.common.workers import Call, Workers
from cmbot.planning import Plan
from cmbot.stances.bounds import NO_BOUNDS, NO_FIGURES, Bounds, StanceFigures, StanceObjective
from cmbot.stances.candidates import AnyCandidate
from cmbot.stances.charting import CannotBePutAway

StageName = Literal["reach", "postures", "clearance", "obstacles", "charts", "plan"]
"""By what a stance is judged, the cheapest first."""
CHARTED: tuple[StageName, ...] = ("obstacles", "charts", "plan")
"""Those that know of obstacles, and of the arm being put away."""
Status = Literal[
    "planned", "not judged", "screened", "failed", "beyond a bound", "blocked", "no posture", "out of reach"
]
"""How a stance ended, the most promising first; the names of its rejections, too."""
STATUSES: tuple[Status, ...] = get_args(Status)
Progress = Callable[[str, float], None]
# Bases nearer, m, to one that could not be planned or charted are tried last.
_NEAR_BASE_M: dict[StageName, float] = {"plan": 0.3, "charts": 0.12}
# Time that a stage is given at least, s; and which share of what is left charts and the own stance's plan
# have: charts so many times more in each round of those that were not judged in that time. Another plan has
# all of it, as the next one takes about as long.
_MIN_SECONDS = 1e-3
_CHARTS_SHARE, _OWN_SHARE = 0.15, 0.5
_MORE_TIME = 2.0
# Share of a time limit that the screening may take; and from which on the rest is for plans.
_SCREENING_SHARE, _PLANS_FROM_SHARE = 0.4, 0.6
# Without a plan of the own stance: what the first one of another may take at first, s; how long is searched
# where no time is given, s, and where all are blocked; and how near to those others come later, m.
_FIRST_PLAN_S, _HASTENED_S, _BLOCKED_S, _NEAR_BLOCKED_M = 25.0, 60.0, 30.0, 0.1
# Its candidates are taken in turn where these shares of the bounds are smaller: the least bounds are those of
# folded arms near singularities, whose plans take long and fail; one that is stretched out is planned soon.
_SHARES_BELOW = (0.9, 0.0, 0.75, 0.5)
PROVEN_SHARE = 0.98
"""Share of the best value that others are proven not to undercut."""
# Once enough are planned, only stances that may be better by more than this share are judged; and where the
# others' bounds are then proven, those that may be better by what a proof leaves open.
_WORTHWHILE_GAIN, _OPEN_GAIN = 0.05, 1 - PROVEN_SHARE
# So many stances are judged beside each other, however many processes do so: what is judged next depends on
# results in their order alone, and not on how soon they come. Where time is short, as many as there are
# processes.
_BESIDE = 4


@dataclass(frozen=True, kw_only=True)
class StandOptions:
    """Which stances are candidates, and how many of them are judged.

    Attributes
    ----------
    objective : str or None
        ``torque``, ``hold``, ``sag`` or ``sway``; None: that of the scene's planner.
    bounds : Bounds
        Stances that exceed one are left out.
    any_sag : bool
        Without a bound of the sag, leave no stance out by it; else see `StanceRanking.sag_limit`.
    spacing : float, m
        Between places of foot 1 with foot 2 free.
    pair_spacing : float, m, or None
        Between places of both feet; infinite: foot 2 stays free; None: 0.15 m, or more of too many stances.
    plans : int
        Number of stances that are planned in full, the best by their bounds.
    charts : int
        Largest number of stances that are charted.
    checks : int
        Largest number of stances that are checked for obstacles.
    proofs : int
        Largest number of other mounts whose bounds are proven.
    members : tuple of str
        Posts and rails that feet hold; empty: all.
    time_limit : float, s
        After which no stance is judged any more; what was planned until then is kept.
    jobs : int
        Number of processes that judge stances beside each other, see `Workers`; more than 4 have nothing to
        do. The result is the same.
    """

    objective: StanceObjective | None = None
    bounds: Bounds = NO_BOUNDS
    any_sag: bool = False
    spacing: float = 0.05
    pair_spacing: float | None = None
    plans: int = 3
    charts: int = 40
    checks: int = 400
    proofs: int = 1000
    members: tuple[str, ...] = ()
    time_limit: float = np.inf
    jobs: int = 1


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
    screening_cut : bool
        Whether the screening was ended, so that time was left for plans.
    hastens : bool
        Whether the first plan is sought, as there is none of the own stance: it comes before better ones.
    """

    limit: float
    by: Literal["", "interrupt", "time"] = ""
    keeps: bool = False
    screening_cut: bool = False
    hastens: bool = False
    _began: float = field(default_factory=monotonic)
    _more: float = 1.0
    _until: float = np.inf
    _hastened: float = 0.0

    def is_due(self) -> bool:
        """Whether no other stance is to be judged."""
        if not self.by and self.left() <= 0:
            self.by = "time"
        return bool(self.by)

    def cuts_screening(self) -> bool:
        """Whether the screening is to end, as the rest of the time is for plans."""
        self.screening_cut = self.screening_cut or monotonic() - self._began >= _SCREENING_SHARE * self.limit
        return self.screening_cut

    def is_for_plans(self) -> bool:
        """Whether the rest of the time is for plans of what was judged furthest."""
        better_ones = self._until < np.inf and not self.hastens
        return better_ones or monotonic() - self._began >= _PLANS_FROM_SHARE * self.limit

    def hasten(self, most: float) -> None:
        """Seek the first plan before better ones; with no time given, end `most` seconds after that began."""
        if not self.hastens:
            self.hastens, self._hastened = True, monotonic()
        if not np.isfinite(self.limit):
            self._until = self._hastened + most

    def part(self, stage: StageName, *, own: bool = False) -> float:
        """Return what a stage may take of what is left, s."""
        if self.hastens and not own:
            return max(min(self._more * _FIRST_PLAN_S, self.left()), _MIN_SECONDS)
        share = _OWN_SHARE if own else 1.0 if stage == "plan" else min(self._more * _CHARTS_SHARE, 1.0)
        return max(share * self.left(), _MIN_SECONDS)

    def give_more(self) -> None:
        """Give charts a larger share of what is left from now on."""
        self._more *= _MORE_TIME

    def spent(self) -> float:
        """Return which share of its time is over; 0 where none was given."""
        over = monotonic() - self._began
        return over / (over + max(self.left(), _MIN_SECONDS))

    def left(self) -> float:
        """Return what is left of the time, s."""
        now = monotonic()
        return min(self.limit - (now - self._began), self._until - now)


@dataclass(frozen=True, kw_only=True)
class Rejection:
    """Why a stance is left out.

    Attributes
    ----------
    kind : str
        ``out of reach`` of the links, ``no posture`` within the bounds of joints and feet, ``blocked`` where
        climber or postures come too near to something or no sequence of them leads along a stroke, ``beyond
        a bound``, ``failed`` where planning did, or ``not judged`` where its time was over before.
    reason : str
        With the figures of this stance.
    cause : str
        That without what it has to do with this stance alone: the same for many.
    excess : float
        By what factor a bound is exceeded; infinite where it is none.
    weakest : str
        Whose bound that is where the arm cannot be put away: a joint, or `FEET`; else empty.
    """

    kind: Status
    reason: str
    cause: str
    excess: float = np.inf
    weakest: str = ""

    @staticmethod
    def unheld(
        cause: str, use: float, weakest: str, *, kind: Status = "blocked", said: str = ""
    ) -> Rejection:
        """Return that of an arm that cannot be put away, as that takes `use` times what `weakest` bears."""
        # Rounded up: 1.00 times would be no reason.
        reason = f"{said or cause}, {use + 0.005:.2f} times what it bears"
        return Rejection(kind=kind, reason=reason, cause=cause, excess=use, weakest=weakest)

    @staticmethod
    def of(kind: Status, error: CmbotError) -> Rejection:
        """Return that by an error; where the time was over before, it says nothing of the stance."""
        match error:
            case PlanningError(stopped=True):
                kind, cause = "not judged", "not judged: time"
            case CannotBePutAway(pair=None):
                return Rejection.unheld(error.reason, error.use, error.weakest, kind=kind, said=str(error))
            case PathNotFound(pair=(link, other)):
                cause = f"{link} and {other} too near to each other"
            case PathNotFound() if error.pace > 1:
                cause = "joints too slow for the path"
            case PathNotFound():
                cause = "no sequence of admissible postures found"
            case OptimisationFailed():
                cause = f"{error.constraint} beyond its bound"
            case LimitViolation():
                cause = f"{error.quantity} beyond its bound"
            case InputError():
                cause = f"{error.key}: not {error.expected}"
            case _:
                cause = str(error)
        return Rejection(kind=kind, reason=str(error), cause=cause)


@dataclass(frozen=True, kw_only=True, eq=False)
class StanceResult(ShortRepr):
    """A stance, how far it was judged, and with what result.

    Attributes
    ----------
    candidate : Candidate or MountCandidate
    number : int
        Of the candidate, in the screening.
    stage : str
        By what it was judged, the furthest it came: ``reach`` of the links, sampled ``postures``,
        ``clearance`` of what does not move, ``obstacles`` with charts at some via-points, ``charts`` at all
        of them, a ``plan``.
    bound : float
        Of what is ranked, by the last stage, in its unit: an estimate; infinite where there is no posture.
    proven : float
        What no plan in it rests below, as is proven: infinite out of reach; zero where nothing was.
    expected : float
        What a plan is expected to reach.
    at_rest : StanceFigures
        In the sampled postures of the bound.
    figures : StanceFigures
        Of the plan.
    value : float
        Of what is ranked, of the plan; infinite without one.
    plan : Plan or None
    rejection : Rejection or None
    own : bool
        Whether it is that of the scene, or of one of several.
    """

    candidate: AnyCandidate
    number: int = 0
    stage: StageName
    bound: float
    proven: float = 0.0
    expected: float = 0.0
    at_rest: StanceFigures = NO_FIGURES
    figures: StanceFigures = NO_FIGURES
    value: float = np.inf
    plan: Plan | None = None
    rejection: Rejection | None = None
    own: bool = False

    @property
    def place(self) -> str:
        """Where it stands, in words."""
        return self.candidate.place

    @property
    def status(self) -> Status:
        """How it ended: ``planned``, ``screened`` where no plan was tried, or the kind of its rejection."""
        if self.rejection is not None:
            return self.rejection.kind
        return "screened" if self.plan is None else "planned"

    @property
    def order(self) -> tuple[int, float]:
        """What is planned first, by its value; the others by their bounds."""
        return STATUSES.index(self.status), self.value if self.status == "planned" else self.bound

    def rejected(self, stage: StageName, rejection: Rejection) -> StanceResult:
        """Return it as left out by a stage, where that judged it."""
        judged = self.stage if rejection.kind == "not judged" else stage
        return replace(self, stage=judged, rejection=rejection)


@dataclass(frozen=True, kw_only=True)
class Stage:
    """What judges a stance.

    Attributes
    ----------
    name : str
    judge : callable
        Takes a stance and the search's ending, and returns it with a better bound, a plan or a rejection.
    most : int
        How often it does so at most.
    step : str
        What is said while it does.
    is_long : bool
        Whether it is worth another process.
    """

    name: StageName
    judge: Callable[[StanceResult, Ending], StanceResult]
    most: int
    step: str
    is_long: bool = True


_Judged = tuple[int, Stage, Call[StanceResult]]


def evaluate_stances(
    results: Sequence[StanceResult],
    stages: Sequence[Stage],
    options: StandOptions,
    ending: Ending,
    progress: Progress = lambda _step, _share: None,
    workers: Workers | None = None,
    *,
    alone: bool = False,
    proves: bool = False,
) -> list[StanceResult]:
    """Judge stances, and return them in the order in which they came.

    Until enough are planned and none can be better, or the attempts or the time are used up. What was planned
    is kept where a user stops the search; where nothing was, it is stopped.

    Parameters
    ----------
    results : sequence of StanceResult
        As they were screened; own ones are planned first, whatever their bounds.
    stages : sequence of Stage
        In the order in which they judge a stance; the last one plans.
    options : StandOptions
    ending : Ending
    progress : callable
        Takes what is done and the share of it.
    workers : Workers, optional
        Judge stances beside each other.
    alone : bool
        Whether they are for all strokes: then the first plan is sought first where no own stance has one.
    proves : bool
        Whether it is then proven that others are no better.
    """
    gain = _OPEN_GAIN if proves else _WORTHWHILE_GAIN
    search = _Search(list(results), stages, options, ending, progress, gain)
    if options.plans:
        try:
            search.plan_own()
            own = [each for each in search.results if each.own]
            if alone and own and all(each.figures is NO_FIGURES for each in own):
                ending.hasten(_BLOCKED_S)
            search.run(workers or Workers(1))
        except KeyboardInterrupt:
            if not ending.keeps:
                raise
            ending.by = "interrupt"
    return search.results


class _Search:
    """Stances that wait for their next stages."""

    def __init__(
        self,
        results: list[StanceResult],
        stages: Sequence[Stage],
        options: StandOptions,
        ending: Ending,
        progress: Progress,
        gain: float,
    ) -> None:
        self._gain = gain
        self.results, self._stages = results, stages
        self._bases = np.array([each.candidate.base[:3, 3] for each in results])
        self._wanted, self._jobs = options.plans, options.jobs
        self._ending, self._progress = ending, progress
        self._done = Counter[StageName]()
        self._next = {stage.name: k + 1 for k, stage in enumerate(stages)}
        self._failures = list[tuple[FloatArray, float]]()
        self._waiting = [k for k, each in enumerate(results) if each.status == "screened"]
        # Those near a failure, until no others wait; and those that were not judged in the time they had.
        self._later, self._late = list[int](), list[int]()
        # Those that are being bounded, and planned, in the order in which that began.
        self._bounded, self._plans = deque[_Judged](), deque[_Judged]()
        self._best, self._planned, self._tried, self._deep = np.inf, 0, 0, False

    def plan_own(self) -> None:
        """Plan the scenes' own stances: no other one is better than they are unless it is planned, too."""
        for k, each in enumerate(self.results):
            if each.own and each.stage == "postures" and not self._ending.is_due():
                self._progress("planning the scene's own stance", 0.0)
                self._take(k, self._stages[-1], self._stages[-1].judge(each, self._ending))

    def run(self, workers: Workers) -> None:
        """Judge the most promising by its next stage, again and again."""
        while not self._ending.is_due():
            k = self._following() if self._room > 0 else None
            if k is not None:
                self._waiting.remove(k)
                self._judge(k, self._stage(k), workers)
            elif self._bounded or self._plans:
                # Plans take long: that of one is waited for where nothing else is left to do.
                k, stage, call = (self._bounded or self._plans).popleft()
                if self._near([k], self._failures).any():
                    self._later.append(k)
                elif self._is_wanted(k):
                    self._take(k, stage, call.result())
            else:
                break
        for k, stage, call in (*self._bounded, *self._plans):
            if call.has_begun():
                # Its time ends with that of the search.
                self._take(k, stage, call.result())

    def _judge(self, k: int, stage: Stage, workers: Workers) -> None:
        """Have a stage judge a stance, unless that is put off or given up."""
        each, last = replace(self.results[k], rejection=None), stage is self._stages[-1]
        if stage is not self._stages[0] and self._near([k], self._failures).any():
            # It most likely fails for the same reason: others come first.
            self._later.append(k)
            return
        judged = self._plans if last else self._bounded
        if self._done[stage.name] + sum(other is stage for _, other, _ in judged) >= stage.most:
            return
        share = self._planned / self._wanted if last else self._done[stage.name] / stage.most
        # Where none is found, time goes by all the same.
        self._progress(stage.step, min(max(share, self._ending.spent()), 1.0))
        if last and self._ending.hastens:
            self._ending.hasten(_HASTENED_S)
            self._tried += 1
        if stage.is_long:
            judged.append((k, stage, workers.call(stage.judge, each, self._ending)))
        else:
            self._take(k, stage, stage.judge(each, self._ending))

    @property
    def _room(self) -> int:
        """How many more stances may be judged beside those that are."""
        bounded, plans = len(self._bounded), len(self._plans)
        if np.isfinite(self._ending.limit) or self._ending.hastens:
            return min(self._jobs, _BESIDE) - bounded - plans
        return _BESIDE - bounded

    def _is_wanted(self, k: int) -> bool:
        """Whether a stance may be planned, and then be better than what is."""
        each = self.results[k]
        return each.status in ("screened", "not judged") and each.bound < self._enough

    def _stage(self, k: int) -> Stage:
        """The next one of a stance."""
        number = self._next.get(self.results[k].stage, 0)
        # What charts say a plan says, too.
        number += self._deep and self._stages[number].name == "charts"
        return self._stages[number]

    def _following(self) -> int | None:
        """The number of the stance that is judged now; None where others are to be known first."""
        late = self._ending.is_for_plans()
        self._deep = late or self._ending.hastens
        judged = (*self._bounded, *self._plans)
        rest = bool(self._waiting or self._later or judged)
        if self._late and (late or len(self._late) >= self._wanted or not rest):
            self._ending.give_more()
            self._waiting, self._late = self._waiting + self._late, []
        if not self._waiting and not judged:
            self._waiting, self._later, self._failures = self._later, [], []
        self._waiting = [k for k in self._waiting if self._is_wanted(k)]
        # Until there is a plan those beside one that is being planned most likely fail with it.
        apart = judged if self._ending.hastens else self._bounded
        here = [(self._bases[k], self._near_m(stage)) for k, stage, _ in apart]
        far = (~self._near(self._waiting, here)).tolist()
        able = sorted((k for k, is_far in zip(self._waiting, far, strict=True) if is_far), key=self._order)
        if not able:
            return None
        if self._ending.hastens and self._stage(able[0]) is self._stages[0]:
            return able[int(_SHARES_BELOW[self._tried % len(_SHARES_BELOW)] * len(able))]
        if self._stage(able[0]) is not self._stages[-1]:
            return able[0]
        most = self._wanted - self._planned if self._planned < self._wanted else _BESIDE
        return able[0] if len(self._plans) < most else None

    def _order(self, k: int) -> tuple[int, float, int]:
        """By what a stance comes: what is expected of it; where plans are to come, how far it was judged."""
        each = self.results[k]
        return -self._next.get(each.stage, 0) if self._deep else 0, max(each.expected, each.bound), k

    @property
    def _enough(self) -> float:
        """Once enough are planned, only stances whose bound is below this are looked at."""
        return np.inf if self._planned < self._wanted else (1 - self._gain) * self._best

    def _near(self, numbers: Sequence[int], places: Iterable[tuple[FloatArray, float]]) -> BoolArray:
        """Which stances of these numbers have their base near one of the places, each within so many m."""
        bases, found = self._bases[numbers], np.zeros(len(numbers), dtype=np.bool_)
        for place, near in places:
            found |= np.linalg.norm(bases - place, axis=1) < near
        return found

    def _near_m(self, stage: Stage) -> float:
        """How near a base most likely fails in a stage for the same reason, m."""
        blocked = _NEAR_BLOCKED_M if self._ending.hastens and stage.name == "obstacles" else 0.0
        return _NEAR_BASE_M.get(stage.name, blocked)

    def _take(self, k: int, stage: Stage, result: StanceResult) -> None:
        """Take a result, and go on from there."""
        self.results[k], rejection = result, result.rejection
        # What its time was too short for is judged again.
        late = result.status == "not judged" and self._ending.hastens
        self._done[stage.name] += not (result.own or late)
        if result.status == "screened":
            self._waiting.append(k)
        elif result.status == "not judged":
            given_up = stage is self._stages[-1] and not self._ending.hastens
            self._late += [] if result.own or given_up else [k]
        elif result.status == "planned":
            self._ending.keeps = True
            # The scene's own is one more.
            self._planned += not result.own
            self._best = min(self._best, result.value)
            self._ending.hastens = False
        elif rejection is not None and not result.own and rejection.kind != "beyond a bound":
            # A little further on what is bounded may be less; and only the scene's own has its start posture.
            self._failures.append((self._bases[k], self._near_m(stage)))
