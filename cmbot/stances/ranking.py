"""Where to stand: the fewest stances from which a job's strokes can be done, and the best ones for them."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from math import ceil
from typing import Literal

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp
from threadpoolctl import threadpool_limits

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import CmbotError, InputError, PlanningError, SceneError
from cmbot.common.reading.validation import counted, shown
from cmbot.common.representation import ShortRepr
from cmbot.common.workers import Workers
from cmbot.planning import FEET, precheck_scene, robot_of, strokes_of, task_of
from cmbot.scene import Scene
from cmbot.stances.bounds import UNITS, SagLimit, StanceObjective
from cmbot.stances.candidates import (
    AnyCandidate,
    Candidate,
    candidates_of,
    faces_of,
    has_flat_foot,
    mounts_of,
    own_candidate,
)
from cmbot.stances.charting import bounded_quickly
from cmbot.stances.placed_scene import joined, put_away, scene_at, with_strokes
from cmbot.stances.screening import Screener, Screening, times_of
from cmbot.stances.search import (
    CHARTED,
    PROVEN_SHARE,
    Ending,
    Progress,
    Rejection,
    StanceResult,
    StandOptions,
    evaluate_stances,
)
from cmbot.stances.stages import Judge, at_rest_of

# For whose scenes alone steps are sought.
_CLIMBER_WORDS = "the shipped robot, an arm on a climber that holds a guardrail"

_MAX_NAME_CHARACTERS = 90
# What a stance may sag where the scene's own is not known to do the work; and in any case.
_MOST_SAG_MM, _LEAST_SAG_MM = 50.0, 5.0
# Share of the best value that is proven of the others, less what a proof may be off.
_NO_BETTER = PROVEN_SHARE - 1e-3
# So many of the reasons for which stances are left out are named.
_MAX_REASONS_NAMED = 3
# Metres between places of two feet where that was not asked for: the first with no more stances.
_PAIR_SPACINGS, _MOST_STANCES = (0.15, 0.2, 0.3), 2000
# By how many times a stance's plan may take longer by `plan`.
_PROVEN_TIME = 3.0
_Group = frozenset[int]


@dataclass(frozen=True, kw_only=True, eq=False)
class StanceRanking(ShortRepr):
    """Stances for strokes that are done from one, the best first.

    Attributes
    ----------
    scene : Scene
        Of these strokes, which begin at poses in the world.
    objective : str
        By what they are ranked: ``torque``, ``hold``, ``sag`` or ``sway``.
    ranked : tuple of StanceResult
        The planned ones by their values, then the others by their bounds.
    plans : int
        How many of them were to be planned.
    ended_by : str
        What ended the search early: the ``time``, or an ``interrupt`` by the user; else empty.
    sag_limit : SagLimit or None
        What others than the own stance may sag, where that was not asked for: the scene's tolerance where it
        has one and its sag is not compensated, else what the own stance sags, at least 5 mm. None where any
        sag is allowed, nothing bends or the sag is ranked.
    """

    scene: Scene
    objective: StanceObjective = "torque"
    ranked: tuple[StanceResult, ...]
    plans: int = StandOptions.plans
    ended_by: Literal["", "interrupt", "time"] = ""
    sag_limit: SagLimit | None = None

    @property
    def unit(self) -> str:
        """Of what is ranked."""
        return UNITS[self.objective]

    @property
    def when(self) -> str:
        """Over what it is ranked, in words."""
        return "over the job" if self.objective == "hold" else "at work"

    @property
    def strokes(self) -> tuple[str, ...]:
        """Names of the strokes."""
        return tuple(str(stroke.name) for stroke in self.scene.strokes)

    @property
    def best(self) -> StanceResult | None:
        """The best stance that was planned; None where none was."""
        first = self.ranked[0] if self.ranked else None
        return first if first is not None and first.status == "planned" else None

    @property
    def own(self) -> tuple[StanceResult, ...]:
        """The stances of the scenes themselves, the best first."""
        return tuple(each for each in self.ranked if each.own)

    @property
    def reasons(self) -> list[tuple[str, int]]:
        """The reasons for which most stances are left out, and how many each."""
        causes = (each.rejection.cause for each in self.ranked if each.rejection is not None)
        return Counter(causes).most_common(_MAX_REASONS_NAMED)

    @property
    def reasons_in_words(self) -> str:
        """The same, and what is the most frequent one of those judged with obstacles; empty without any."""
        late = [each for each in self.ranked if each.stage in CHARTED and each.rejection is not None]
        causes = Counter(each.rejection.cause for each in late if each.rejection is not None)
        first = [part for part in causes.most_common(1) if part not in self.reasons]
        said = ", ".join(f"{cause} ({number})" for cause, number in self.reasons)
        return said + "".join(f"; of {len(late)} with obstacles {cause} ({n})" for cause, n in first)

    @property
    def is_ruled_out(self) -> bool:
        """Whether all that were judged with obstacles, if any were, are blocked; but for the own stance."""
        late = [each.status for each in self.ranked if each.stage in CHARTED and not each.own]
        return {*late} == {"blocked"}

    @property
    def remedies(self) -> Iterator[str]:
        """What would take away some of these reasons, a sentence each without its full stop."""
        for cause, _ in self.reasons:
            some = [
                each.rejection for each in self.ranked if each.rejection and each.rejection.cause == cause
            ]
            if some[0].weakest:
                yield _remedy(some)

    @property
    def nearest(self) -> StanceResult | None:
        """That which exceeds a bound by the smallest factor; None where none was judged by one."""
        beyond = [each for each in self.ranked if each.rejection and np.isfinite(each.rejection.excess)]
        return min(beyond, key=lambda each: each.rejection.excess if each.rejection else np.inf, default=None)

    @property
    def best_unplanned(self) -> float:
        """The smallest bound of a stance that was not judged to its end; infinite where all were."""
        return min((each.bound for each in self.waiting), default=np.inf)

    @property
    def closest_in_time(self) -> str:
        """What is left out by the time alone, in words, with the first of them; else empty."""
        first, screened = next(iter(self.waiting), None), self.count("screened")
        if first is None or not (self.ended_by or self.count("not judged")):
            return ""
        late = (
            f"not judged to the end for want of time: {len(self.waiting)}, {screened} of them only screened"
        )
        if not first.bound:
            return late  # the time was over before any bound was known
        if self.best is not None and first.bound >= self.best.value:
            return f"{late}; by their bounds (estimates) none of them is better than the best one"
        return (
            f"{late}; first {first.place}, by its bound {first.bound:.4g} {self.unit}; a longer "
            "--time-limit with planner.time_limit_s as long judges it"
        )

    @property
    def waiting(self) -> list[StanceResult]:
        """Those that were not judged to their end, the most promising first."""
        return [each for each in self.ranked if each.status in ("screened", "not judged")]

    @property
    def proven(self) -> int:
        """How many that were not planned are proven to be no better than the best one by more than 2.1 %."""
        least = np.inf if self.best is None else _NO_BETTER * self.best.value
        return sum(each.plan is None and each.proven >= least for each in self.ranked)

    def count(self, status: str) -> int:
        """Return how many stances ended so."""
        return sum(each.status == status for each in self.ranked)


def _remedy(some: Sequence[Rejection]) -> str:
    """What would take away a reason, rounded up, so that it does; of feet what many stances ask at least."""
    each = sorted(some, key=lambda each: each.excess)
    first, half = each[0], each[len(each) // 2].excess
    if first.weakest == FEET:
        # What the least asks others ask again: feet that bear a little more seldom help.
        asks = f"half of {counted(len(each), 'stance')} ask at least {half:.2f} times what it bears"
        return f"where {first.cause}, {asks} for that alone"
    times = f"{first.excess + 0.005:.2f} times what it bears"
    return f"where {first.cause}, {times} would do, or another start with return: start"


def stand(
    scenes: Scene | Sequence[Scene],
    options: StandOptions | None = None,
    progress: Progress = lambda _step, _share: None,
    suits: Callable[[AnyCandidate], str | None] = lambda _: None,
) -> tuple[StanceRanking, ...]:
    """Find where the robot should stand for jobs on one bridge, or among the mounts of a scene.

    The scene's own stance is planned first, so that none which is worse is the best one. A stance counts only
    with the way from the arm's stow posture and back. A user who stops the search (KeyboardInterrupt), or its
    time limit, ends it with the best stances so far; where nothing has been planned yet, it is stopped.

    As few stances as possible: the strokes of all jobs are parted so that each group can be done from one
    stance. Of partitions with as few groups that one is taken whose largest bound is the smallest. A group
    for which no stance could be planned is parted further.

    Parameters
    ----------
    scenes : Scene or sequence of Scene
        Of the same robot and guardrail; of another robot than the shipped one, with ``mounts``.
    options : StandOptions, optional
    progress : callable
        Takes what is done and the share of it.
    suits : callable
        Takes a candidate that is promising; why it is left out, or None.

    Returns
    -------
    tuple of StanceRanking
        One for each group, in the order of their best stances along the guardrail.

    Raises
    ------
    SceneError
        When there is no guardrail and no mount, nothing of what is asked can be ranked, or scenes have not
        robot, guardrail, tool, return and planner in common.
    InputError
        When a member of the options is none of the guardrail.
    PlanningError
        When for some stroke no stance is left.
    """
    options = options or StandOptions()
    scenes = (scenes,) if isinstance(scenes, Scene) else tuple(scenes)
    for one in scenes:
        require_standing(one, options.members)
    with threadpool_limits(limits=1, user_api="blas"), Workers(options.jobs) as workers:
        return _Stand(scenes, options, progress, suits, workers).ranked()


class _Stand:
    """One search: its candidates, how they are screened, and the groups of strokes."""

    def __init__(
        self,
        scenes: Sequence[Scene],
        options: StandOptions,
        progress: Progress,
        suits: Callable[[AnyCandidate], str | None],
        workers: Workers,
    ) -> None:
        self._workers = workers
        scene, self._options, self._progress, self._suits = joined(scenes), options, progress, suits
        planned = scene.planner.objective
        self._objective: StanceObjective = options.objective or ("torque" if planned == "travel" else planned)
        # Of the postures in one stance those that sag least sway nearly least, and cost a quarter to plan.
        by = "sag" if self._objective == "sway" else self._objective
        self._scene = scene = scene.with_options(objective=by)
        progress("listing stances", 0.0)
        self._ending = Ending(limit=options.time_limit)
        self._own: dict[AnyCandidate, FloatArray | None]
        if scene.on_guardrail:
            self._own = _own(scenes)
            first = [each for each in self._own if isinstance(each, Candidate)]
            self._candidates: list[AnyCandidate] = [*self._listed(first)]
        else:
            self._candidates = [*mounts_of(scene)]
            self._own = {self._candidates[0]: None}
        if not self._candidates:
            where = ", ".join(options.members) or "the guardrail"
            sides = (
                (place.face, face.held_by_clamps_alone) for place, face in faces_of(scene, options.members)
            )
            tried = ", ".join(dict.fromkeys(f"{name}: {alone or 'in the way'}" for name, alone in sides))
            others = "clamps hold edges and round bars; other faces are tried where guardrail.stance has one"
            raise PlanningError(f"no place on {where} in which a foot holds ({tried}); {others}")
        if scene.tool.fixed is not None:
            expected = "no fixed tool: stances are sought for tools that the arm holds"
            raise SceneError(scene.source, "tool.fixed", "a fixed tool", expected)
        robot = robot_of(scene)
        strokes = strokes_of(scene, robot)
        # Each cell of a raster is a stroke of its own: together they are one of the scene's.
        self._names = [str(stroke.name) for stroke in scene.strokes]
        own = [stroke.name if stroke.name in self._names else str(stroke.file.part_of) for stroke in strokes]
        self._of = [[k for k, name in enumerate(own) if name == each] for each in self._names]
        self._tasks = [task_of(stroke, scene) for stroke in strokes]
        self._bounds = options.bounds
        self._screener = Screener(
            scene, robot, self._candidates, self._objective, options.bounds, self._ending.cuts_screening
        )
        if self._objective in ("sag", "sway") and not self._screener.loads.bends:
            expected = (
                f"something that bends, for objective {self._objective}: guardrail, mounts or elasticity"
            )
            raise SceneError(scene.source, "guardrail", "nothing that bends", expected)

    def _listed(self, first: Sequence[Candidate]) -> list[Candidate]:
        """The stances on a guardrail; of too many pairs of feet those of a coarser grid."""
        options, found = self._options, list[Candidate]()
        given = options.pair_spacing
        for pairs in _PAIR_SPACINGS if given is None else (given,):
            most = _MOST_STANCES if given is None and pairs != _PAIR_SPACINGS[-1] else None
            each = candidates_of(self._scene, options.spacing, pairs, options.members, first)
            flat = (one for one in each if self._objective != "hold" or has_flat_foot(self._scene, one))
            found = [*islice(flat, most and most + 1)]
            if most is None or len(found) <= most:
                break
        return found

    def ranked(self) -> tuple[StanceRanking, ...]:
        """Screen all, part the strokes, and search for the best stance of each group."""
        said = f"screening {len(self._candidates)} stances"
        limit = self._sag_limit()
        if limit is not None:
            self._bounds = replace(self._bounds, sag_mm=limit.most_mm)
            self._screener.loads = self._screener.loads.within(self._bounds)
        self._limit = limit
        self._unheld = {
            k: why for k, why in self._screener.unheld().items() if self._candidates[k] not in self._own
        }
        found = self._screener.screened(
            self._tasks, lambda share: self._progress(said, share), [*self._unheld], self._workers
        )
        found.figures[0] = np.maximum(found.bound, self._screener.least)
        bound = np.array([found.bound[each].max(axis=0, initial=-np.inf) for each in self._of])
        for number in range(len(self._of)):
            if not np.isfinite(bound[number]).any():
                raise self._unreached(number, found)
        done, excluded = dict[frozenset[int], StanceRanking](), set[frozenset[int]]()
        while groups := fewest_groups(bound, excluded):
            for number, group in enumerate(groups, start=1):
                if group in done:
                    continue
                where = f"stance {number} of {len(groups)}: " if len(groups) > 1 else ""

                def told(step: str, share: float, where: str = where) -> None:
                    self._progress(where + step, share)

                done[group] = self._group(group, found, told, several=len(groups) > 1)
                stays = done[group].best is None and self._options.plans and not self._ending.by
                if stays and len(group) > 1:
                    excluded.add(group)
                    break
            else:
                along = {group: done[group].ranked[0].candidate.root[0, 3] for group in groups}
                return tuple(done[group] for group in sorted(groups, key=along.__getitem__))
        raise PlanningError(f"no stances for {counted(len(self._names), 'stroke')}")

    def _sag_limit(self) -> SagLimit | None:
        given = self._options.any_sag or np.isfinite(self._options.bounds.sag_mm)
        if given or self._objective == "sag" or not self._screener.loads.bends:
            return None
        asked = self._scene.tool.tolerance
        sides = () if asked is None else (asked.across_mm, asked.along_axis_mm)
        least = min((side for side in sides if side is not None), default=None)
        if least is not None and self._scene.planner.compensate is False:
            return SagLimit(most_mm=least, source="the tolerance of the tool, as the sag is not compensated")
        own = [k for k, each in enumerate(self._candidates) if each in self._own]
        able = [k for stroke, numbers in enumerate(self._of) if self._is_done(stroke) for k in numbers]
        most = self._screener.sag_mm([self._tasks[k] for k in able], own)
        if most >= _LEAST_SAG_MM:
            return SagLimit(most_mm=most, source="what the scene's own stance sags (estimate)")
        if np.isfinite(most):
            return SagLimit(most_mm=_LEAST_SAG_MM, source="more than the scene's own stance sags")
        return SagLimit(most_mm=_MOST_SAG_MM, source="an assumption of ours")

    def _is_done(self, stroke: int) -> bool:
        """Whether postures lead along a stroke in an own stance, obstacles included."""
        part = with_strokes(self._scene, {stroke}, self._scene.name)
        for candidate, posture in self._own.items():
            try:
                bounded_quickly(scene_at(part, candidate, posture), None, self._ending.left())
            except CmbotError:
                continue
            return True
        return False

    def _group(
        self, group: frozenset[int], found: Screening, progress: Progress, *, several: bool
    ) -> StanceRanking:
        """The ranked stances for some strokes."""
        members, scene = sorted(group), self._scene
        name = "_".join([scene.name, *(str(k + 1) for k in members)])
        part = with_strokes(scene, group, name[:_MAX_NAME_CHARACTERS]) if several else scene
        strokes = [k for each in members for k in self._of[each]]
        judge = Judge(
            scene=put_away(part),
            as_it_is=part,
            screener=self._screener,
            own=self._own,
            options=self._options,
            bounds=self._bounds,
            objective=self._objective,
            suits=self._suits,
        )
        results = [self._screened(k, found, strokes) for k in range(len(self._candidates))]
        proves = not scene.on_guardrail
        results = evaluate_stances(
            results,
            judge.stages(),
            self._options,
            self._ending,
            progress,
            self._workers,
            alone=not several,
            proves=proves,
        )
        if proves:
            times = np.array([times_of(task) for task in self._tasks])
            results = [*judge.proven(results, found, strokes, times, self._ending, progress)]
        return StanceRanking(
            scene=part,
            objective=self._objective,
            ranked=tuple(sorted(results, key=lambda each: each.order)),
            plans=self._options.plans,
            ended_by=self._ending.by or ("time" if self._ending.screening_cut else ""),
            sag_limit=self._limit,
        )

    def _feet_asked(self, found: Screening, strokes: Sequence[int]) -> str:
        """What strokes ask of feet at least, where they are too weak in all stances; else empty."""
        screener, unbound = self._screener, np.isinf(found.bound[strokes]).any(axis=0)
        weak = np.asarray(found.within_reach[strokes].all(axis=0) & unbound)
        weak[[k for k, why in self._unheld.items() if why.weakest != FEET]] = False
        if not (weak.any() and screener.loads.bounded):
            return ""
        numbers = np.flatnonzero(weak).tolist()
        least, best = screener.least_use([self._tasks[k] for k in strokes], numbers)
        if not 1 < least < np.inf:
            return ""
        foot, times = screener.loads.weakest_foot(best), ceil(100 * least) / 100
        pull, most = times * (foot.adhesion or 0.0), foot.most_adhesion
        beyond = f", where none pulls more than {most / 1e3:.1f} kN" * (pull > most)
        magnets = f" (magnets of {pull / 1e3:.1f} kN{beyond})" * (pull > 0)
        return (
            f"the whole job asks at least {times:.2f} times what feet bear{magnets} in the best of "
            f"{counted(len(numbers), 'stance')} in which they are too weak (estimate, without obstacles)"
        )

    def _unreached(self, number: int, found: Screening) -> PlanningError:
        """The error of a stroke that no stance reaches, with what `cmbot check` says of the nearest one."""
        scene, candidates, own, limit = self._scene, self._candidates, self._of[number], self._limit
        within = np.asarray(found.within_reach[own].all(axis=0))
        points = np.vstack([self._tasks[k].path.outline() for k in own])
        bases = np.array([candidate.base[:3, 3] for candidate in candidates])
        away = np.linalg.norm(points[:, None] - bases, axis=2).max(axis=0)
        nearest = candidates[min(range(len(candidates)), key=lambda k: (not within[k], away[k]))]
        most = "" if limit is None else f" that sags at most {limit.most_mm:.3g} mm ({limit.source})"
        causes = Counter(why.cause for k, why in self._unheld.items() if within[k])
        rest = int(within.sum()) - causes.total()
        kinds = {"out of reach": (~within).sum(), f"in which no posture was found{most}": rest}
        kinds |= {f"in which {cause}": number for cause, number in causes.most_common()}
        counts = ", ".join(f"{number} {kind}" for kind, number in kinds.items() if number)
        name = str(scene.strokes[number].name)
        error = PlanningError(f"no stance of {len(candidates)} is left for stroke {name}: {counts}")
        checked = precheck_scene(scene_at(with_strokes(scene, {number}, scene.name), nearest, None)).warnings
        got = [warning.got for warning in checked if warning.key.startswith("tool_path")][:1]
        joints = [why for why in self._unheld.values() if why.weakest != FEET]
        hints = [self._feet_asked(found, own)]
        hints += [f"in the nearest one, {nearest.place}, {each}" for each in got]
        hints += [_remedy(joints)] if joints else []
        for hint in filter(None, hints):
            error.add_hint(hint)
        return error

    def _screened(self, k: int, found: Screening, strokes: Sequence[int]) -> StanceResult:
        """What the screening says of a candidate for some strokes."""
        candidate, within = self._candidates[k], bool(found.within_reach[strokes, k].all())
        rows = found.figures[:, strokes, k].max(axis=1)
        rejection: Rejection | None = None
        if not within:
            why = "out of reach of the arm's links"
            rejection = Rejection(kind="out of reach", reason=why, cause=why)
        elif (rejection := self._unheld.get(k)) is None and not np.isfinite(rows[0]):
            sag = " and sag" if self._screener.loads.sags and np.isfinite(self._bounds.sag_mm) else ""
            why = f"no posture found within the bounds of joints{',' if sag else ' and'} feet{sag}"
            rejection = Rejection(kind="no posture", reason=why, cause=why)
        result = StanceResult(
            candidate=candidate,
            number=k,
            stage="postures" if within else "reach",
            bound=float(rows[0]),
            at_rest=at_rest_of(rows),
            rejection=rejection,
            own=candidate in self._own,
        )
        if result.own and within and (unfit := self._suits(candidate)):
            return result.rejected("clearance", Rejection(kind="blocked", reason=unfit, cause=unfit))
        return result


def _own(scenes: Sequence[Scene]) -> dict[AnyCandidate, FloatArray | None]:
    """The scenes' stances, and in which posture the arm starts there; None: in that of the first one."""
    each = [(own_candidate(one), np.array(one.posture)) for one in scenes]
    return {
        candidate: None if np.array_equal(posture, each[0][1]) else posture
        for candidate, posture in each
        if candidate is not None
    }


def require_planned(rankings: Sequence[StanceRanking]) -> None:
    """Refuse a search in which no stance was planned for some strokes.

    Raises
    ------
    PlanningError
        With the reasons for which most stances are left out.
    """
    for ranking in rankings:
        if ranking.best is None:
            late = "; the time was over (--time-limit)" if ranking.ended_by == "time" else ""
            late += f": {closest}" if (closest := ranking.closest_in_time) else ""
            strokes = f" for {', '.join(ranking.strokes)}" if len(rankings) > 1 else ""
            reasons = ranking.reasons_in_words
            first = not late or ranking.is_ruled_out
            why = f"{',' if first else ';'} most often for: {reasons}" if reasons else ""
            # Long messages are shortened from their end.
            told = f"{why}{late}" if first else f"{late}{why}"
            error = PlanningError(f"no stance of {len(ranking.ranked)} was planned{strokes}{told}")
            # What would do is known where the time was not what is missing; and it takes the place of that.
            for remedy in ranking.remedies if first else ():
                error.add_hint(remedy)
            raise error


def best_scene(ranking: StanceRanking, rank: int = 1) -> Scene:
    """Return the scene with the best stance, or the most promising one; or that of another rank, from 1.

    Raises
    ------
    PlanningError
        When no stance is left.
    """
    ranked = ranking.ranked[rank - 1]
    if not np.isfinite(ranked.bound):
        raise PlanningError(f"no stance of {len(ranking.ranked)} is left: {ranking.reasons_in_words}")
    if ranked.plan is not None:
        # A plan that is not one of many proves its bound, too.
        made, needs = ranked.plan.scene, ceil(_PROVEN_TIME * ranked.plan.seconds.total)
        return made.with_options(time_limit_s=max(made.planner.time_limit_s, float(needs)))
    return scene_at(ranking.scene if ranked.own else put_away(ranking.scene), ranked.candidate, None)


def require_on_guardrail(scene: Scene) -> None:
    """Refuse a scene whose robot holds no guardrail.

    Raises
    ------
    SceneError
    """
    if not scene.on_guardrail or not scene.elastic_guardrail.post_positions:
        key, got = ("guardrail", "none") if scene.on_guardrail else ("robot", "another robot")
        raise SceneError(scene.source, key, got, _CLIMBER_WORDS)


def require_standing(scene: Scene, members: Sequence[str] = ()) -> None:
    """Refuse a scene whose stances cannot be sought, or members that its guardrail has not.

    Raises
    ------
    SceneError, InputError
    """
    if not scene.on_guardrail and not scene.mounts:
        expected = f"where the base frame may be held; or {_CLIMBER_WORDS}"
        raise SceneError(scene.source, "mounts", "none", expected)
    if scene.on_guardrail:
        require_on_guardrail(scene)
    known = scene.guardrail.member_names
    for member in members:
        if member not in known:
            expected = f"a member of the guardrail of {scene.name}"
            raise InputError("members (--on)", "", shown(member), expected, known)


def fewest_groups(bound: FloatArray, excluded: Collection[_Group] = ()) -> tuple[_Group, ...] | None:
    """Part strokes into the fewest groups of which each can be done from one stance.

    Among these partitions the largest bound over all strokes is the smallest. Both by integer programs over
    the sets of strokes that stances reach (HiGHS by `scipy.optimize.milp`).

    Parameters
    ----------
    bound : (S, C)
        Bound of each of C stances for each of S strokes; infinite where it does not reach it.
    excluded : collection of frozenset of int
        Strokes that no stance does together, whatever their bounds say.

    Returns
    -------
    tuple of frozenset of int, or None
        Numbers of the strokes, by the smallest of each; None where a stroke cannot be done at all.
    """
    sets = _sets(np.isfinite(bound), excluded)
    cover = _smallest_cover(sets)
    if cover is None:
        return None
    # The smallest value of the bound at which as few stances do: it is one of those in the table.
    values = np.unique(bound[np.isfinite(bound)])

    def enough(value: float) -> bool:
        found = _smallest_cover(_sets(bound <= value, excluded))
        return found is not None and len(found) == len(cover)

    sets = _sets(bound <= values[bisect_left(values, True, key=enough)], excluded)
    return _parted(sets[:, _smallest_cover(sets) or cover], bound)


def _sets(reached: BoolArray, excluded: Collection[_Group]) -> BoolArray:
    """The sets (S, U) of strokes that stances reach together, each once, less what is excluded."""
    rows = np.unique(reached.T, axis=0)
    for group in excluded:
        members = sorted(group)
        whole = rows[:, members].all(axis=1)
        if whole.any():
            # Without one of its strokes each.
            less = np.repeat(rows[whole], len(members), axis=0)
            less[np.arange(len(less)), np.tile(members, int(whole.sum()))] = False
            rows = np.unique(np.vstack([rows[~whole], less]), axis=0)
    return np.asarray(rows[rows.any(axis=1)].T)


def _smallest_cover(sets: BoolArray) -> list[int] | None:
    """Numbers of the fewest sets (S, U) that have all strokes; None where one is in none."""
    if not sets.any(axis=1).all():
        return None
    U = sets.shape[1]
    every = LinearConstraint(sparse.csr_array(sets.astype(float)), lb=1.0)
    found = milp(np.ones(U), integrality=np.ones(U), bounds=Bounds(0, 1), constraints=every)
    return np.flatnonzero(found.x > 0.5).tolist()


def _parted(cover: BoolArray, bound: FloatArray) -> tuple[_Group, ...]:
    """Strokes of overlapping sets (S, k), each with that of the best stances whose bound is smallest."""
    stance = [int(bound[each].max(axis=0).argmin()) for each in cover.T]
    asked = np.where(cover, bound[:, stance], np.inf)
    group = asked.argmin(axis=1)
    return tuple(
        sorted((frozenset(np.flatnonzero(group == k).tolist()) for k in range(len(stance))), key=min)
    )
