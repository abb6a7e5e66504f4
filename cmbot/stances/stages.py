"""The stages that judge a stance, the cheapest first: clearance, charts, a plan; and proofs of bounds."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import CmbotError, PathNotFound
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import Sag, TooSoftError
from cmbot.excitation import sway_mm_per_m_s2
from cmbot.planning import Deadline, Plan, bending_arm, plan_candidate, reached_scene, unreached_area
from cmbot.robot import Dynamics
from cmbot.scene import Scene
from cmbot.stances.arm import FIGURES
from cmbot.stances.bounds import Bounds, StanceFigures, StanceObjective
from cmbot.stances.candidates import AnyCandidate, Candidate, climber_in_the_way
from cmbot.stances.charting import AtRest, bounded_quickly, chart, proven_bound
from cmbot.stances.placed_scene import scene_at
from cmbot.stances.screening import VIA_POINTS, Screener, Screening
from cmbot.stances.search import PROVEN_SHARE, Ending, Rejection, Stage, StanceResult, StandOptions

# Attempts to plan: so many times the number of plans wanted and one more.
_ATTEMPTS_PER_PLAN = 2
# A stance is not planned where the postures of its charts exceed a bound by this factor; a plan may not.
_CHART_ALLOWANCE = 1.05
# Charts are by the sag, which plans minimise, too: of 12 stances for three jobs plans swayed by 0.81 to 1.58
# times what their charts do.
_CHARTED_SWAY_SHARE = 0.8
# Postures of the work in which sag and modes of a plan are computed.
_SAGS, _MODES = 61, 5
# Postures of a job between which the joints' travel is measured.
_TRAVEL_POSTURES = 2000
# Bounds of what is charted.
_BOUNDED = {"torque": "base_torque_nm", "hold": "adhesion_n", "sag": "sag_mm"}
_WORDS = {
    "base_torque_nm": ("torque on the base", "Nm"),
    "adhesion_n": ("adhesion needed", "N"),
    "sag_mm": ("sag", "mm"),
    "sway_mm": ("sway", "mm per m/s2"),
    "travel_deg": ("travel", "degrees"),
    "seconds": ("duration", "s"),
}
# By so much of itself an area may differ by rounding.
_SAME_AREA = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Judge:
    """What judges the stances for some strokes.

    Attributes
    ----------
    scene : Scene
        Of these strokes, as `in_world` returns it; the arm comes from its stow posture and returns there.
    as_it_is : Scene
        The same, with the arm where the scene has it before and after.
    screener : Screener
    own : mapping of candidate to (n,), rad, or None
        The scenes' own stances, and the posture in which the arm starts there; None: that of the scene.
    options : StandOptions
    bounds : Bounds
        Of all stances but the scenes' own, for which those of the options count.
    objective : str
    suits : callable or None
        Takes a candidate; why it is left out, or None.
    """

    scene: Scene
    as_it_is: Scene
    screener: Screener
    own: Mapping[AnyCandidate, FloatArray | None]
    options: StandOptions
    bounds: Bounds
    objective: StanceObjective
    suits: Callable[[AnyCandidate], str | None] | None = None

    def stages(self) -> tuple[Stage, ...]:
        """Return them in their order."""
        options, tries = self.options, _ATTEMPTS_PER_PLAN * (self.options.plans + 1)
        first, sent = "checking the most promising", replace(self, suits=None)
        return (
            Stage(name="clearance", judge=self.cleared, most=sys.maxsize, step=first, is_long=False),
            Stage(name="obstacles", judge=sent.checked, most=options.checks, step=f"{first} for obstacles"),
            Stage(name="charts", judge=sent.charted, most=options.charts, step="charting the most promising"),
            Stage(name="plan", judge=sent.planned, most=tries, step="planning the most promising"),
        )

    def cleared(self, result: StanceResult, _ending: Ending) -> StanceResult:
        """Leave out a stance of which what does not move is too near to something."""
        candidate = result.candidate
        why = climber_in_the_way(self.scene, candidate) if isinstance(candidate, Candidate) else None
        why = why or (self.suits(candidate) if self.suits is not None else None)
        if why is not None:
            return result.rejected("clearance", Rejection(kind="blocked", reason=why, cause=why))
        # The job's bounds count where the arm is put away, too.
        away = at_rest_of(self.screener.away[:, result.number])
        figures = StanceFigures(torque=away.torque, adhesion=away.adhesion)
        if rejection := _beyond(self.bounds, figures, "where it is put away"):
            return result.rejected("clearance", rejection)
        return replace(result, stage="clearance")

    def checked(self, result: StanceResult, ending: Ending) -> StanceResult:
        """Chart a stance at some via-points, obstacles included."""
        try:
            scene = scene_at(self.scene, result.candidate, None)
            bound = bounded_quickly(scene, self._at_rest(result), ending.left())
        except CmbotError as error:
            if not (isinstance(error, PathNotFound) and self._own_unreached):
                return result.rejected("obstacles", Rejection.of("blocked", error))
            # Which rows may be left out is asked of few stances: it takes seconds.
            bound = result.bound
        if bound == 0 or self.objective == "sway":
            # Nothing is charted where the tool's axis may lean; for the sway it is by the sag.
            bound = result.bound
        bound = max(bound, float(self.screener.least[result.number]))
        name = _BOUNDED.get(self.objective)
        if name is not None and bound > _CHART_ALLOWANCE * getattr(self.bounds, name):
            return result.rejected("obstacles", _rejection(self.bounds, name, bound, "in its best postures"))
        return replace(result, stage="obstacles", bound=bound, expected=bound)

    def charted(self, result: StanceResult, ending: Ending) -> StanceResult:
        """Chart a stance at all via-points."""
        limit = min(self.scene.planner.time_limit_s, ending.part("charts"))
        try:
            placed = scene_at(self.scene, result.candidate, None)
            reached = self._reached(placed, Deadline(limit)) if self._own_unreached else placed
            if isinstance(reached, Rejection):
                return result.rejected("charts", reached)
            charted = chart(reached, self._at_rest(result), limit)
        except CmbotError as error:
            return result.rejected("charts", Rejection.of("blocked", error))
        number = np.full(len(charted.postures), result.number)
        rows = self.screener.arm.figures(charted.postures, number, self.screener.loads)
        at_rest = at_rest_of(rows.max(axis=1))
        if rejection := _beyond(self.bounds, at_rest, "in its best postures", _CHART_ALLOWANCE):
            return result.rejected("charts", rejection)
        # With few via-points the allowance between postures is smaller, with many the bound is tighter.
        least = float(self.screener.least[result.number])
        bound, expected = max(charted.bound, result.bound), max(charted.expected, least)
        if self.objective == "sway":
            expected = float(rows[0].max())
            bound = max(result.bound, _CHARTED_SWAY_SHARE * expected)
        bound = min(bound, expected)
        return replace(result, stage="charts", bound=bound, expected=expected, at_rest=at_rest)

    def _at_rest(self, result: StanceResult) -> AtRest | None:
        """What is ranked at rest; None: that is the objective of the planner."""
        if self.objective in ("torque", "hold"):
            return None
        return partial(self.screener.arm.at_rest, stance=result.number, loads=self.screener.loads)

    def planned(self, result: StanceResult, ending: Ending) -> StanceResult:
        """Plan a stance, with the way from the stow posture and back; that of a scene as the scene has it."""
        limit = min(self.scene.planner.time_limit_s, ending.part("plan", own=result.own))
        try:
            placed, whole = self._placed(result), Deadline(self.scene.planner.time_limit_s)
            deadline = Deadline(limit, whole=whole, name="this stance")
            options = replace(placed.planner, time_limit_s=limit)
            # First what takes a tenth of a plan's time.
            scene: Scene | Rejection = (
                reached_scene(placed, options, deadline) if result.own else self._reached(placed, deadline)
            )
            if isinstance(scene, Rejection):
                return result.rejected("plan", scene)
            made = plan_candidate(scene, options, deadline, wanted=result.own)
        except CmbotError as error:
            return result.rejected("plan", Rejection.of("failed", error))
        figures = figures_of(made, result.candidate)
        result = replace(result, stage="plan", figures=figures, rejection=None)
        bounds = self.options.bounds if result.own else self.bounds
        if beyond := _beyond(bounds, figures, "planned"):
            return result.rejected("plan", beyond)
        value = value_of(made, figures, self.objective)
        # No estimate is above what was found.
        return replace(result, value=value, plan=made, bound=min(result.bound, value))

    def _reached(self, placed: Scene, deadline: Deadline) -> Scene | Rejection:
        """The scene without the rows that nothing reaches, as `plan` leaves them out.

        No stance leaves out more than the scene's own.
        """
        scene = reached_scene(placed, placed.planner, deadline)
        left_out = unreached_area(scene)
        if not left_out or left_out <= self._own_unreached * (1 + _SAME_AREA):
            return scene
        why = "of the rasters are not reached"
        return Rejection(kind="failed", reason=f"{left_out:.3g} m2 {why}", cause=f"parts {why}")

    @cached_property
    def _own_unreached(self) -> float:
        """Area of rasters, m2, that the arm does not reach where the scene has it; 0 where it has no plan.

        Where its feet hold nothing there, what it would not reach if they did.
        """
        scene, limit = self.as_it_is, self.as_it_is.planner.time_limit_s
        for as_welded in (False, True):
            # A scene may need feet, as for objective: hold.
            with suppress(CmbotError):
                held = scene.changed(guardrail=scene.guardrail.changed(hold=None)) if as_welded else scene
                return unreached_area(reached_scene(held, scene.planner, Deadline(limit)))
        return 0.0

    def _placed(self, result: StanceResult) -> Scene:
        if result.own:
            return scene_at(self.as_it_is, result.candidate, self.own[result.candidate])
        return scene_at(self.scene, result.candidate, None)

    def proven(
        self,
        results: Sequence[StanceResult],
        found: Screening,
        strokes: Sequence[int],
        times: FloatArray,
        ending: Ending,
        progress: Callable[[str, float], None],
    ) -> Iterator[StanceResult]:
        """Yield stances with what is proven not to be undercut in them, up to a share of the best value.

        `times` (S, K), s, are those of the screening's via-points in the strokes (S).
        """
        best = min((each.value for each in results), default=np.inf)
        left = self.options.proofs if np.isfinite(best) and self.objective == "torque" else 0
        value = PROVEN_SHARE * best
        for done, result in enumerate(results):
            number = result.number
            if not found.within_reach[strokes, number].all():
                yield replace(result, proven=np.inf)
            elif result.plan is not None or left == 0 or result.own or ending.is_due():
                yield result
            else:
                left -= 1
                progress("proving bounds of the others", done / len(results))
                worst = int(found.bound[strokes, number].argmax())
                first = int(found.via_point[strokes[worst], number])
                each = times[strokes[worst], [first, *(k for k in range(VIA_POINTS) if k != first)]]
                scene = scene_at(self.scene, result.candidate, None)
                yield replace(result, proven=proven_bound(scene, worst, each, value))


def at_rest_of(rows: FloatArray) -> StanceFigures:
    """Return the figures (8,) of the screening as such."""
    known = {name: float(x) for name, x in zip(FIGURES, rows, strict=True) if np.isfinite(x)}
    known.pop("bound", None)
    return StanceFigures(**known)


def figures_of(made: Plan, candidate: AnyCandidate) -> StanceFigures:
    """Return the figures of a plan in a stance."""
    work, job, needed = made.figures, made.job.figures, made.figures.adhesion_needed
    also = job.adhesion_needed
    torque, whole = work.peak_guardrail_torque, job.peak_guardrail_torque
    if not isinstance(candidate, Candidate):
        torque, whole = (_about_base(made, candidate, part) for part in (made.work, made.job))
    t = np.linspace(0.0, made.job.duration, _TRAVEL_POSTURES)
    turns = ~made.robot.limits.prismatic
    travel = np.abs(np.diff(made.job.trajectory.evaluate(t)[:, turns], axis=0)).sum()
    held = made.holding_torque
    efforts = np.array([joint.effort for joint in made.robot.holding_joints])
    return StanceFigures(
        holding_nm=float(held.max()) if len(held) else None,
        holding_of_effort=float((held / efforts).max()) if len(held) else None,
        torque=torque,
        job_torque=whole,
        adhesion=None if needed is None else needed.peak,
        job_adhesion=None if also is None else also.peak,
        stop_adhesion=None if also is None or made.emergency_stop is None else made.emergency_stop.peak,
        **_bending(made),
        travel_deg=float(np.degrees(travel)),
        seconds=made.job.duration,
        within_mm=None if made.accuracy is None else made.accuracy.within_mm,
    )


def _bending(made: Plan) -> dict[str, float]:
    """Sag, slowest mode and sway at work, where something bends."""
    arm = bending_arm(made.scene, made.robot)
    if arm is None:
        return {}
    q = made.trajectory.evaluate(made.trajectory.t[0] + np.linspace(0.0, made.work.duration, _SAGS))
    try:
        return {
            "sag_mm": 1e3 * float(Sag(arm).length(q)[0].max()),
            "first_hz": min(float(arm_modes(arm, each).frequencies[0]) for each in q[:: _SAGS // _MODES]),
            "sway_mm": sway_mm_per_m_s2(made),
        }
    except TooSoftError:
        return {}  # remarks of the plan say so


def _about_base(made: Plan, candidate: AnyCandidate, part: object) -> float:
    """Largest moment, Nm, about the origin of the base frame, as the plan has it about O0."""
    trajectory = made.trajectory if part is made.work else made.job.trajectory
    t = np.linspace(trajectory.t[0], trajectory.t[-1], _TRAVEL_POSTURES)
    q, v, a = trajectory.states(t)[:3]
    wrench = Dynamics(made.robot).efforts(q, v, a).guardrail_wrench
    away = candidate.base[:3, 3] - np.array(made.robot.foot_point)
    return float(np.linalg.norm(wrench[:, 3:] - np.cross(away, wrench[:, :3]), axis=1).max())


def value_of(made: Plan, figures: StanceFigures, objective: StanceObjective) -> float:
    """Return what is ranked of a plan."""
    if objective == "sag":
        return figures.sag_mm or 0.0
    if objective == "sway":
        return figures.sway_mm or 0.0
    peak = made.objective.planned_peak
    if objective == "torque":
        return peak
    if figures.job_adhesion is not None:
        return max(peak, figures.job_adhesion)
    # The pull of magnets in place of the clamps.
    each = (samples.adhesion_needed for samples in made.segment_samples.values())
    return max(peak, *(float(needed.max()) for needed in each if needed is not None))


def _beyond(bounds: Bounds, figures: StanceFigures, where: str, allowance: float = 1.0) -> Rejection | None:
    """Why figures exceed a bound by more than a factor, most of all; None where none does."""
    wider = Bounds(**{name: allowance * getattr(bounds, name) for name in _WORDS})
    beyond = figures.beyond(wider)
    return None if beyond is None else _rejection(bounds, *beyond[:2], where)


def _rejection(bounds: Bounds, name: str, value: float, where: str) -> Rejection:
    words, unit = _WORDS[name]
    reason = f"{words} {value:.4g} {unit} {where}, {getattr(bounds, name):g} {unit} are allowed"
    cause, most = f"more {words} than is allowed", getattr(bounds, name)
    return Rejection(
        kind="beyond a bound", reason=reason, cause=cause, excess=value / most if most else np.inf
    )
