"""The problems that solvers are compared on, and how everybody's answer is judged.

Every problem is the peak's of `cmbot.planning.torque.problem` at the smoothing that plans begin with and
mostly end with: ``min b + w/2 mean (jerk/J_C)^2``, no resting end that would turn it into a mean square. All
solvers start at the same spline of least jerk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from cmbot.optimization.continuation import SMOOTH

from cmbot import load_scene
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed, PathNotFound
from cmbot.optimization.program import StateSamples
from cmbot.planning.context import PlanningContext, build_context
from cmbot.planning.initial_guess import InitialGuess, fixed_guess, sliding_guess
from cmbot.planning.solvers import family_through
from cmbot.planning.torque.feasibility import check_feasible
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.robot import Postures
from cmbot.scene import Leg, Scene
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["Case", "Judgement", "fixed_case", "judged", "random_scene", "sliding_case", "way_of"]

SEED = 2793
# The random path takes as long as the paper's, in as many legs as its triangle.
_SECONDS = (8.0, 5.0, 7.0)
_REACH, _TURN = 0.4, 0.5
# Its peak lies so far above what the resting ends ask for that there is something to lower.
_ABOVE_REST = 1.01
_DRAWS = 200
_GAUSS = 4


@dataclass(frozen=True, kw_only=True)
class Case:
    """One problem, to be posed for any of cmbot's solvers.

    Attributes
    ----------
    name : str
    context : PlanningContext
    via_points : (n, d), rad
    sliding, pinned : bool
        Whether via-points slide; all but the first.
    """

    name: str
    context: PlanningContext
    via_points: FloatArray
    sliding: bool
    pinned: bool = False

    @property
    def weight(self) -> float:
        """Of the smoothing."""
        return SMOOTH.smoothing * self.context.options.smoothing_weight

    def problem(self, solver: str) -> TorqueProblem:
        """Pose it for ``sqp`` or ``slsqp``; a floor that everything is below keeps the smoothing as it is."""
        context = replace(self.context, options=replace(self.context.options, solver=solver))
        return TorqueProblem(
            context.robot,
            context.task,
            family_through(context, self.via_points, sliding=self.sliding, pinned=self.pinned),
            context.clearances,
            context.options,
            resting=(),
            floor=np.inf,
            objective=context.objective,
        )


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """A trajectory, whoever found it.

    Attributes
    ----------
    peak : float, Nm
        Largest torque on the guardrail at the problem's samples.
    objective : float
        Peak in units of the start's, and smoothing.
    violation : float
        The largest: of what is sampled at the samples, of joint limits at their exact extrema, of via-points
        and smoothness as shares of their size; 0 where all is met.
    """

    peak: float
    objective: float
    violation: float


def judged(case: Case, problem: TorqueProblem, trajectory: QuinticTrajectory) -> Judgement:
    """Judge a trajectory on all samples of `problem`, from the trajectory alone."""
    states = StateSamples(problem.grid, *trajectory.states(problem.grid))
    peak = float(problem.objective.values(states).max())
    worst = [float(function.values(states)[0].max()) for function in problem.functions]
    for bound in problem.bounds:
        value = trajectory.extrema(bound.order).value
        over = np.maximum(value - bound.high[:, None], bound.low[:, None] - value) / bound.scale[:, None]
        worst.append(float(over.max()))
    jerks = np.concatenate([trajectory.jumps(3), trajectory.evaluate(trajectory.t[[0, -1]], 3)])
    worst.append(float(np.abs(jerks / problem.robot.limits.jerk).max()))
    worst.append(_off_task(case, trajectory))
    nodes, weights = np.polynomial.legendre.leggauss(_GAUSS)
    h = np.diff(trajectory.t)[:, None]
    times = (trajectory.t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
    share = (0.5 * h * weights).ravel() / trajectory.duration
    jerk = trajectory.evaluate(times, 3) / problem.robot.limits.jerk
    smoothing = 0.5 * case.weight * float(share @ (jerk**2).mean(axis=1))
    return Judgement(peak=peak, objective=peak / problem.scale + smoothing, violation=max(0.0, *worst))


def _off_task(case: Case, trajectory: QuinticTrajectory) -> float:
    """How far via-points are from where they have to be, m or rad."""
    if not case.sliding:
        return float(np.abs(trajectory.q - case.via_points).max())
    context = case.context
    at = Postures(context.robot).at(np.ascontiguousarray(trajectory.q))
    points = context.task.path.position(context.times)
    return float(np.abs(context.task.errors(at.tool_point, at.tool_rotation, points)).max())


def way_of(scene: Scene, knots: str) -> tuple[PlanningContext, InitialGuess]:
    """Return where planning a scene would start to optimise."""
    context = build_context(scene, replace(scene.planner, knots=knots, solver="slsqp"))
    return context, sliding_guess(context) if knots == "sliding" else fixed_guess(context)


def fixed_case(scene: Scene) -> Case:
    """Return the problem of Chang 2021, Eq. (30), along a scene's path: the core problem."""
    context, way = way_of(scene, "fixed")
    return Case(name=scene.name, context=context, via_points=way.problem.family.via_points, sliding=False)


def sliding_case(scene: Scene) -> Case:
    """Return the problem with via-points that slide, from where the global stage puts them."""
    context, way = way_of(scene, "sliding")
    q, pinned = way.problem.family.via_points, way.pinned
    return Case(name=scene.name, context=context, via_points=q, sliding=True, pinned=pinned)


def random_scene(via_points: int = 50) -> Scene:
    """Return the first scene of a seeded sequence whose peak is not at a resting end: a triangle in space.

    The arm's posture and where the legs lead are drawn; draws that lead out of reach are passed over.
    """
    rng, scene = np.random.default_rng(SEED), load_scene("triangle")
    for _ in range(_DRAWS):
        posture = np.array(scene.posture) + rng.uniform(-_TURN, _TURN, len(scene.posture))
        corners = rng.uniform(-_REACH, _REACH, (len(_SECONDS) - 1, 3))
        steps = np.diff(np.vstack([np.zeros(3), corners, np.zeros(3)]), axis=0)
        legs = tuple(Leg(by=tuple(by), seconds=s) for by, s in zip(steps.tolist(), _SECONDS, strict=True))
        drawn = replace(scene, name="random", posture=posture, legs=legs, obstacles=(), via_points=via_points)
        try:
            _, way = way_of(replace(drawn, planner=replace(drawn.planner, other_starts=0)), "fixed")
            check_feasible(way.problem)
        except (PathNotFound, OptimisationFailed):
            continue
        if way.problem.scale > _ABOVE_REST * way.problem.peak_at_rest:
            return drawn
    raise SystemExit(f"no random path in {_DRAWS} draws")
