"""Where to stand: the fewest stances from which a job's strokes can be done, and the best ones for them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import InputError, PlanningError, SceneError
from cmbot.common.representation import short_repr
from cmbot.common.validation import counted, shown
from cmbot.planning import ToolTask, precheck_scene, robot_of, strokes_of, task_of
from cmbot.scene import Scene
from cmbot.stances.candidates import Candidate, candidates_of, own_candidate
from cmbot.stances.cover import fewest_groups
from cmbot.stances.placed_scene import joined, scene_at, with_strokes
from cmbot.stances.screening import screen
from cmbot.stances.search import Ending, StandOptions, Stood, judged

# For whose scenes alone stances and steps are sought.
_SHIPPED_ROBOT = "the shipped robot, an arm on a climber that holds a guardrail"

_LONGEST_NAME = 90
# So many of the reasons for which stances are left out are named.
_REASONS = 3
_Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Standing:
    """Stances for strokes that are done from one, the best first.

    Attributes
    ----------
    scene : Scene
        Of these strokes, which begin at poses in the world.
    unit : str
        Of the objective.
    ranked : tuple of Stood
        The planned ones by the peak of their objective over the work, then the others by their bounds.
    plans : int
        How many of them were to be planned.
    ended_by : str
        What ended the search early: the ``time``, or an ``interrupt`` by the user; else empty.
    """

    scene: Scene
    unit: str
    ranked: tuple[Stood, ...]
    plans: int = StandOptions.plans
    ended_by: Literal["", "interrupt", "time"] = ""

    __repr__ = short_repr

    @property
    def strokes(self) -> tuple[str, ...]:
        """Names of the strokes."""
        return tuple(str(stroke.name) for stroke in self.scene.strokes)

    @property
    def best(self) -> Stood | None:
        """The best stance that was planned; None where none was."""
        first = self.ranked[0] if self.ranked else None
        return first if first is not None and first.plan is not None else None

    @property
    def own(self) -> tuple[Stood, ...]:
        """The stances of the scenes themselves, the best first."""
        return tuple(each for each in self.ranked if each.own)

    @property
    def reasons(self) -> list[tuple[str, int]]:
        """The reasons for which most stances are left out, and how many each."""
        return Counter(each.cause for each in self.ranked if each.cause).most_common(_REASONS)

    @property
    def best_unplanned(self) -> float:
        """The smallest bound of a stance that was not tried; infinite where all were."""
        return min((each.bound for each in self.ranked if each.status == "screened"), default=np.inf)

    def count(self, status: str) -> int:
        """Return how many stances ended so."""
        return sum(each.status == status for each in self.ranked)


def stand(
    scenes: Scene | Sequence[Scene],
    options: StandOptions | None = None,
    progress: _Progress = lambda _step, _share: None,
    suits: Callable[[Candidate], str | None] = lambda _: None,
) -> tuple[Standing, ...]:
    """Find where the robot should stand for jobs on one bridge, by the objective of the planner.

    The scene's own stance is planned first, so that none which is worse is the best one. A user who stops the
    search (KeyboardInterrupt), or its time limit, ends it with the best stances so far; where nothing has
    been planned yet, it is stopped.

    As few stances as possible: the strokes of all jobs are parted so that each group can be done from one
    stance. Of partitions with as few groups that one is taken whose largest bound is the smallest. A group
    for which no stance could be planned is parted further.

    Parameters
    ----------
    scenes : Scene or sequence of Scene
        Of the shipped robot and the same guardrail.
    options : StandOptions, optional
    progress : callable
        Takes what is done and the share of it.
    suits : callable
        Takes a candidate that is promising; why it is left out, or None.

    Returns
    -------
    tuple of Standing
        One for each group, in the order of their best stances along the guardrail.

    Raises
    ------
    SceneError
        When the robot is another one, there is no guardrail, the objective cannot be screened, or scenes have
        not robot, guardrail, tool, return and planner in common.
    InputError
        When a member of the options is none of the guardrail.
    PlanningError
        When for some stroke no stance is left.
    """
    options = options or StandOptions()
    scenes = (scenes,) if isinstance(scenes, Scene) else tuple(scenes)
    for one in scenes:
        require_standing(one, options.members)
    scene = joined(scenes)
    progress("listing stances", 0.0)
    ending, at_first = Ending(limit=options.time_limit), _own(scenes)
    candidates = list(
        candidates_of(scene, options.spacing, options.pair_spacing, options.members, tuple(at_first))
    )
    if not candidates:
        where = ", ".join(options.members) or "the guardrail"
        raise PlanningError(f"no place on {where} in which a foot holds; round bars take clamps alone")
    robot = robot_of(scene)
    strokes = strokes_of(scene, robot)
    # Each cell of a raster is a stroke of its own: together they are one of the scene's.
    names = [str(stroke.name) for stroke in scene.strokes]
    own = [stroke.name if stroke.name in names else str(stroke.file.part_of) for stroke in strokes]
    tasks = [task_of(stroke, scene) for stroke in strokes]
    found = screen(
        scene,
        robot,
        tasks,
        candidates,
        scene.planner,
        report=lambda share: progress(f"screening {len(candidates)} stances", share),
    )
    of = [[k for k, name in enumerate(own) if name == each] for each in names]
    bound = np.array([found.bound[each].max(axis=0, initial=-np.inf) for each in of])
    for number, each in enumerate(of):
        if not np.isfinite(bound[number]).any():
            within = np.asarray(found.within_reach[each].all(axis=0))
            raise _unreached(scene, number, [tasks[k] for k in each], candidates, within)
    unit = "N" if scene.planner.objective == "hold" else "Nm"
    done, excluded = dict[frozenset[int], Standing](), set[frozenset[int]]()
    while groups := fewest_groups(bound, excluded):
        for number, group in enumerate(groups, start=1):
            if group in done:
                continue
            members, several = sorted(group), len(groups) > 1
            name = "_".join([scene.name, *(str(k + 1) for k in members)])
            part = with_strokes(scene, group, name[:_LONGEST_NAME]) if several else scene
            here = partial(_told, progress, f"stance {number} of {len(groups)}: " if several else "")
            numbers = [k for each in members for k in of[each]]
            ranked = judged(part, candidates, found, numbers, options, here, suits, at_first, ending)
            done[group] = Standing(
                scene=part, unit=unit, ranked=ranked, plans=options.plans, ended_by=ending.by
            )
            if done[group].best is None and options.plans and len(group) > 1 and not ending.by:
                excluded.add(group)
                break
        else:
            return tuple(sorted((done[group] for group in groups), key=_along))
    raise PlanningError(f"no stances for {counted(len(names), 'stroke')}")


def _own(scenes: Sequence[Scene]) -> dict[Candidate, FloatArray | None]:
    """The scenes' stances, and in which posture the arm starts there; None: in that of the first one."""
    each = [(own_candidate(one), np.array(one.posture)) for one in scenes]
    return {
        candidate: None if np.array_equal(posture, each[0][1]) else posture
        for candidate, posture in each
        if candidate is not None
    }


def _unreached(
    scene: Scene, number: int, tasks: Sequence[ToolTask], candidates: Sequence[Candidate], within: BoolArray
) -> PlanningError:
    """The error of a stroke that no stance reaches, with what `cmbot check` says of it in the nearest one."""
    points = np.vstack([task.path.outline() for task in tasks])
    bases = np.array([candidate.base[:3, 3] for candidate in candidates])
    away = np.linalg.norm(points[:, None] - bases, axis=2).max(axis=0)
    nearest = candidates[min(range(len(candidates)), key=lambda k: (not within[k], away[k]))]
    name = str(scene.strokes[number].name)
    kinds = {"out of reach": (~within).sum(), "in which no posture was found": within.sum()}
    counts = ", ".join(f"{number} {kind}" for kind, number in kinds.items() if number)
    error = PlanningError(f"no stance of {len(candidates)} is left for stroke {name}: {counts}")
    checked = precheck_scene(scene_at(with_strokes(scene, {number}, scene.name), nearest, None))
    for warning in checked.warnings:
        if warning.key.startswith("tool_path"):
            error.add_hint(f"in the nearest one, {nearest.place}, {warning.got}")
            break
    return error


def require_planned(standings: Sequence[Standing]) -> None:
    """Refuse a search in which no stance was planned for some strokes.

    Raises
    ------
    PlanningError
        With the reasons for which most stances are left out.
    """
    for standing in standings:
        if standing.best is None:
            reasons = ", ".join(f"{cause} ({number})" for cause, number in standing.reasons)
            late = "; the time was over (--time-limit)" if standing.ended_by == "time" else ""
            strokes = f" for {', '.join(standing.strokes)}" if len(standings) > 1 else ""
            why = f", most often for: {reasons}" if reasons else ""
            raise PlanningError(f"no stance of {len(standing.ranked)} was planned{strokes}{late}{why}")


def _along(standing: Standing) -> float:
    """Where foot 1 is in the best stance, along the guardrail, m."""
    return float(standing.ranked[0].candidate.root[0, 3])


def _told(progress: _Progress, where: str, step: str, share: float) -> None:
    progress(where + step, share)


def best_scene(standing: Standing) -> Scene:
    """Return the scene with the best stance, or if none was planned the most promising one.

    Raises
    ------
    PlanningError
        When no stance is left.
    """
    first = standing.ranked[0]
    if not np.isfinite(first.bound):
        reasons = ", ".join(f"{cause} ({number})" for cause, number in standing.reasons)
        raise PlanningError(f"no stance of {len(standing.ranked)} is left: {reasons}")
    return scene_at(standing.scene, first.candidate, None) if first.plan is None else first.plan.scene


def require_on_guardrail(scene: Scene) -> None:
    """Refuse a scene whose robot holds no guardrail.

    Raises
    ------
    SceneError
    """
    if not scene.on_guardrail or not scene.elastic_guardrail.post_positions:
        key, got = ("guardrail", "none") if scene.on_guardrail else ("robot", "another robot")
        raise SceneError(scene.source, key, got, _SHIPPED_ROBOT)


def require_standing(scene: Scene, members: Sequence[str] = ()) -> None:
    """Refuse a scene whose stances cannot be sought, or members that its guardrail has not.

    Raises
    ------
    SceneError, InputError
    """
    require_on_guardrail(scene)
    if scene.planner.objective == "sag":
        expected = "torque or hold, by which stances are screened"
        raise SceneError(scene.source, "planner.objective", "sag", expected)
    known = scene.guardrail.member_names
    for member in members:
        if member not in known:
            expected = f"a member of the guardrail of {scene.name}"
            raise InputError("members (--on)", "", shown(member), expected, known)
