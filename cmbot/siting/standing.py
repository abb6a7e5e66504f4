"""Where to stand: candidates screened by bounds, the most promising planned in full, in their order."""

from __future__ import annotations

import heapq
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import CmbotError, PlanningError, SceneError
from cmbot.planning import Plan, plan, robot_of, strokes_of, task_of
from cmbot.scene import Scene, scene_from_file, update_file
from cmbot.siting.candidates import Candidate, candidates_of
from cmbot.siting.charting import chart
from cmbot.siting.screening import Screening, screen

__all__ = [
    "StandOptions",
    "Standing",
    "Stood",
    "best_scene",
    "in_words",
    "in_world",
    "scene_at",
    "stances_csv",
    "stand",
]

_COLUMNS = (
    *("rank", "status", "judged_by", "bound", "planned", "torque_at_rest", "adhesion_at_rest"),
    *(
        "planned_torque",
        "planned_adhesion",
        "foot_1_member",
        "foot_1_along_m",
        "foot_1_face",
        "foot_1_turn_deg",
    ),
    *("foot_2_member", "foot_2_along_m", "foot_2_face", "foot_2_turn_deg", "x", "y", "z"),
    *("climb_1_deg", "climb_2_deg", "climb_3_deg", "climb_4_deg", "climb_5_deg", "reason"),
)


# Seconds for a plan and for the charts of a stroke.
_PLAN_SECONDS, _CHART_SECONDS = 20.0, 10.0
# How near, m, the arm's base is to one that was planned or charted in vain where it is not tried, too.
_ALIKE = {"plan": 0.3, "charts": 0.12}
# So many times as many stances as are to be planned are tried, and once more that many.
_TRIES = 4
_MEANS = ("reach", "postures", "obstacles", "charts", "plan")
_LEFT_OUT_BY = {
    "postures": "obstacles left out",
    "obstacles": "at some via-points, obstacles included",
    "charts": "by its charts, obstacles included",
}
_LEFT_OUT = ("failed", "blocked", "no posture", "out of reach")


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
    """

    spacing: float = 0.05
    pair_spacing: float = 0.15
    plans: int = 3
    charts: int = 20
    checks: int = 400


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Standing:
    """Stances of a scene, the best first.

    Attributes
    ----------
    scene : Scene
    unit : str
        Of the objective.
    ranked : tuple of Stood
        The planned ones by the peak of their objective over the work, then the others by their bounds.
    screening : Screening
        Of the candidates, in their own order.
    """

    scene: Scene
    unit: str
    ranked: tuple[Stood, ...]
    screening: Screening

    @property
    def best(self) -> Stood | None:
        """The best stance that was planned; None where none was."""
        first = self.ranked[0] if self.ranked else None
        return first if first is not None and first.plan is not None else None

    @property
    def best_unplanned(self) -> float:
        """The smallest bound of a stance that was not tried; infinite where all were."""
        return min((each.bound for each in self.ranked if each.status == "screened"), default=np.inf)

    def count(self, status: str) -> int:
        """Return how many stances ended so."""
        return sum(each.status == status for each in self.ranked)


def stand(
    scene: Scene,
    options: StandOptions | None = None,
    progress: Callable[[str, float], None] = lambda _step, _share: None,
) -> Standing:
    """Find where the robot should stand for a scene's job, by the objective of its planner.

    Parameters
    ----------
    scene : Scene
        Of the shipped robot; its own stance plays no part.
    options : StandOptions, optional
    progress : callable
        Takes what is done and the share of it.

    Raises
    ------
    SceneError
        When the robot is another one, there is no guardrail, or the objective cannot be screened.
    """
    options = options or StandOptions()
    _require_standing(scene)
    # Where the tool path begins in the world, and nothing of the stance, is the scene's.
    progress("listing stances", 0.0)
    candidates = list(candidates_of(scene, options.spacing, options.pair_spacing))
    robot = robot_of(scene)
    tasks = [task_of(stroke, scene) for stroke in strokes_of(scene, robot)]
    found = screen(
        scene,
        robot,
        tasks,
        candidates,
        scene.planner,
        report=lambda share: progress(f"screening {len(candidates)} stances", share),
    )
    each = [
        Stood(
            candidate=candidate,
            status=_status(bool(found.within_reach[k]), float(found.bound[k])),
            judged="postures" if found.within_reach[k] else "reach",
            bound=float(found.bound[k]),
            torque=float(found.torque[k]),
            adhesion=float(found.adhesion[k]),
        )
        for k, candidate in enumerate(candidates)
    ]
    _Search(in_world(scene), each, found, options).run(progress)
    unit = "N" if scene.planner.objective == "hold" else "Nm"
    return Standing(scene=scene, unit=unit, ranked=tuple(sorted(each, key=_order)), screening=found)


def best_scene(standing: Standing) -> dict[str, Any]:
    """Return the content of a scene file with the best stance, or the most promising one.

    Raises
    ------
    PlanningError
        When no stance is left.
    """
    first = standing.ranked[0] if standing.ranked else None
    if first is None or not np.isfinite(first.bound):
        raise PlanningError(_nothing_left(standing))
    best = (
        scene_at(in_world(standing.scene), first.candidate, None) if first.plan is None else first.plan.scene
    )
    return update_file(best).file.as_data()


def in_words(standing: Standing) -> Iterator[str]:
    """Yield what was found, a sentence or two each."""
    ranked, unit = standing.ranked, standing.unit
    counts = {
        name: standing.count(name) for name in ("out of reach", "no posture", "blocked", "failed", "planned")
    }
    yield (
        f"{len(ranked)} stances: {counts['out of reach']} out of reach, {counts['no posture']} in which no "
        f"posture within the bounds of joints and feet was found, {counts['blocked']} found blocked, "
        f"{counts['planned']} planned, "
        f"{counts['failed']} of which planning failed."
    )
    judged = {name: sum(each.judged == name for each in ranked) for name in _MEANS}
    yield (
        f"Judged by the reach of the links: {judged['reach']}, by sampled postures within the bounds of "
        f"joints, feet and joint velocities: {judged['postures']}, by those clear of obstacles: "
        f"{judged['obstacles']}, by the planner's charts: {judged['charts']}, by plans: {judged['plan']}."
    )
    best = standing.best
    if best is None or best.plan is None:
        yield "No stance was planned: best.yaml has the most promising one by its bound; it may be blocked."
        return
    peak, figures = best.plan.objective.planned_peak, best.plan.figures
    needed = figures.adhesion_needed
    also = "" if needed is None else f", adhesion needed {needed.peak / 1e3:.2f} kN ({needed.mode})"
    yield (
        f"Best of those planned: {best.place}, {peak:.1f} {unit} at work; "
        f"torque {figures.peak_guardrail_torque:.1f} Nm{also}."
    )
    least = standing.best_unplanned
    if np.isfinite(least):
        more = max(1 - least / peak, 0.0)
        yield (
            f"No stance that was not planned was found to rest below {least:.1f} {unit} (estimate, "
            f"{_LEFT_OUT_BY[_judged_least(ranked)]}): none may be better by more than {100 * more:.1f} %."
        )


def _judged_least(ranked: Sequence[Stood]) -> str:
    """By what the stance of the smallest bound that was not planned was judged."""
    waiting = (each for each in ranked if each.status == "screened")
    return min(waiting, key=lambda each: each.bound).judged


def stances_csv(standing: Standing) -> str:
    """Return the ranked table: one row a stance, SI units, degrees where the name says so."""
    lines = [",".join(_COLUMNS)]
    for rank, each in enumerate(standing.ranked, start=1):
        stance = each.candidate.stance
        feet: list[object] = []
        for place in (stance.foot_1, stance.foot_2):
            feet += ["free", "", "", ""] if place is None else list(place.model_dump().values())
        planned, torque, adhesion = "", "", ""
        if each.plan is not None:
            planned = f"{each.plan.objective.planned_peak:.6g}"
            torque = f"{each.plan.figures.peak_guardrail_torque:.6g}"
            needed = each.plan.figures.adhesion_needed
            adhesion = "" if needed is None else f"{needed.peak:.6g}"
        bound = f"{each.bound:.6g}" if np.isfinite(each.bound) else ""
        rest = [f"{each.torque:.6g}", f"{each.adhesion:.6g}"] if bound else ["", ""]
        point = [f"{x:.4f}" for x in each.candidate.root[:3, 3]]
        angles = [f"{x:.4f}" for x in stance.climber_deg or ()]
        reason = each.reason.replace(",", ";")
        row = [
            rank,
            each.status,
            each.judged,
            bound,
            planned,
            *rest,
            torque,
            adhesion,
            *feet,
            *point,
            *angles,
            reason,
        ]
        lines.append(",".join(map(str, row)))
    return "\n".join([*lines, ""])


def _require_standing(scene: Scene) -> None:
    if not scene.on_guardrail or not scene.guardrail.post_positions:
        got = "no guardrail" if scene.on_guardrail else "another robot"
        raise SceneError(scene.source, "guardrail", got, "the shipped robot, which holds a guardrail")
    if scene.planner.objective == "sag":
        expected = "torque or hold, by which stances are screened"
        raise SceneError(scene.source, "planner.objective", "sag", expected)


def _status(within: bool, bound: float) -> str:
    if not within:
        return "out of reach"
    return "screened" if np.isfinite(bound) else "no posture"


class _Search:
    """Judges stances, those of the smallest bounds first, each by ever dearer means."""

    def __init__(self, scene: Scene, each: list[Stood], found: Screening, options: StandOptions) -> None:
        # A stance that fails takes long, and most often for want of time.
        limit = min(scene.planner.time_limit_s, _PLAN_SECONDS)
        self._scene = replace(scene, planner=replace(scene.planner, time_limit_s=limit))
        self.each, self._found, self._options = each, found, options
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
        """Leave out postures that are too near to something."""
        self._checks += 1
        candidate, scene = self.each[k].candidate, self._scene
        clearances = Clearances(robot_of(scene_at(scene, candidate, None)), scene.obstacles)
        bound = self._found.clearing(candidate, clearances, scene.planner.safety_margin_m)
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


def scene_at(scene: Scene, candidate: Candidate, posture: FloatArray | None) -> Scene:
    """Return the scene with the robot in another stance.

    Parameters
    ----------
    scene : Scene
        As `in_world` returns it.
    candidate : Candidate
    posture : (n,), rad, or None
        In which the arm starts: elsewhere the scene's own, None, may be in the way of something.
    """
    return _read(scene, _scene_data(scene, candidate, posture))


def _scene_data(scene: Scene, candidate: Candidate, posture: FloatArray | None) -> dict[str, Any]:
    """The scene's file with another stance."""
    data = scene.file.as_data()
    if posture is not None:
        data = {key: value for key, value in data.items() if key not in ("posture_deg", "start")}
        data["start"] = {"posture_deg": np.degrees(posture).tolist()}
    guardrail = dict(data["guardrail"])
    stance = candidate.stance
    places = {"foot_1": stance.foot_1, "foot_2": stance.foot_2}
    guardrail["stance"] = {
        **{name: "free" if place is None else place.model_dump() for name, place in places.items()},
        "climber_deg": list(stance.climber_deg or ()),
    }
    return data | {"format": "cmbot-scene/2", "guardrail": guardrail, "name": f"{scene.name}_stance"}


def in_world(scene: Scene) -> Scene:
    """Return the scene with a tool path that begins at a pose in the world, where it begins now."""
    if scene.begins_elsewhere:
        return scene
    pose = strokes_of(scene, robot_of(scene))[0].path.poses([0.0])
    begin = {"frame": "world", "xyz": pose.point[0].tolist(), "rpy_deg": _rpy_deg(pose.rotation[0])}
    data = scene.file.as_data()
    path = data["tool_path"]
    if "strokes" in path:
        first, *others = path["strokes"]
        path = {**path, "strokes": [{**first, "from": begin}, *others]}
    else:
        path = {**path, "from": begin}
    return _read(scene, data | {"format": "cmbot-scene/2", "tool_path": path})


def _read(scene: Scene, data: dict[str, Any]) -> Scene:
    """The scene of a file's content, read where another one was; options as Python has them."""
    file = type(scene.file).model_validate_json(json.dumps(data))
    return replace(scene_from_file(file, Path(scene.source).parent, scene.source), planner=scene.planner)


def _rpy_deg(R: FloatArray) -> list[float]:
    return [float(angle) for angle in Rotation.from_matrix(R).as_euler("xyz", degrees=True)]


def _order(each: Stood) -> tuple[int, float]:
    if each.plan is not None:
        return 0, each.plan.objective.planned_peak
    order = ("screened", *_LEFT_OUT)
    return 1 + order.index(each.status), each.bound


def _nothing_left(standing: Standing) -> str:
    counts = [
        f"{standing.count(status)} {status}" for status in ("failed", "blocked", "no posture", "out of reach")
    ]
    return f"no stance of {len(standing.ranked)} is left: {', '.join(counts)}"
