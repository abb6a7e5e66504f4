"""The problems that solvers are compared on, and the measure that every answer is judged by.

Every problem is the peak stage of `cmbot.planning.torque.problem`, the paper's objective (Chang 2021,
Eq. (30)) with the plan's smoothing, which makes the optimum unique::

    min  max_t f(t) + (rho/2) mean (jerk/J_C)^2

subject to the plan's bounds. The stage of the mean square, with which plans end, is not compared: with fixed
via-points the start is within 1e-4 of its optimum. `planning.py` measures all stages as plans have them. All
solvers start at the same splines of least jerk, and none is given a lower bound.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbot import load_scene
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import OptimisationFailed, PathNotFound
from cmbot.optimization.exchange import Result, minimize_smoothed_peak
from cmbot.optimization.program import StateSamples
from cmbot.planning.initial_guess import InitialGuess, initial_guess
from cmbot.planning.request import StrokeRequest, build_request
from cmbot.planning.torque.decomposition import check_feasible, exchange_options
from cmbot.planning.torque.problem import TorqueProblem, parametrization_through
from cmbot.robot import Postures
from cmbot.scene import Scene
from cmbot.toolpath import Leg
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = [
    "Case",
    "Judgement",
    "case_of",
    "guess_of",
    "judged",
    "random_scene",
]

SEED = 2793
# The random path takes as long as the paper's, in as many legs as its triangle.
_SECONDS = (8.0, 5.0, 7.0)
_REACH, _TURN = 0.4, 0.5
# Its peak exceeds the torque at both resting ends by this factor.
_ABOVE_REST = 1.01
_DRAWS = 200
_GAUSS = 4


@dataclass(frozen=True, kw_only=True)
class Case:
    """One problem, for every solver.

    Attributes
    ----------
    name : str
    request : StrokeRequest
    via_points : (n, d), rad
    sliding, pinned : bool
        Whether via-points slide; all but the first.
    """

    name: str
    request: StrokeRequest
    via_points: FloatArray
    sliding: bool = False
    pinned: bool = False

    @property
    def knots(self) -> str:
        """``sliding`` or ``fixed``."""
        return "sliding" if self.sliding else "fixed"

    @property
    def smoothing(self) -> float:
        """Weight of half the mean squared jerk, rho."""
        return self.request.cell.options.smoothing_weight

    def problem(self) -> TorqueProblem:
        """Pose it around the splines of least jerk."""
        form = parametrization_through(
            self.request, self.via_points, sliding=self.sliding, pinned=self.pinned
        )
        return TorqueProblem(self.request, form, 0.0)

    def solve(self, solver: str) -> Result:
        """Pose and solve it with cmbot's ``sqp`` or ``slsqp``."""
        problem = self.problem()
        return minimize_smoothed_peak(problem, replace(exchange_options(problem), solver=solver))


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """A trajectory, whoever found it.

    Attributes
    ----------
    peak : float, Nm
        Largest torque on the guardrail at the problem's samples.
    objective : float
        Peak in units of the start's, and the smoothing.
    violation : float
        The largest of all constraints, as a share of its bound: those of the state at the samples, of the
        joints at exact extrema, of via-points and smoothness; 0 where all are met.
    """

    peak: float
    objective: float
    violation: float


def judged(case: Case, problem: TorqueProblem, trajectory: QuinticTrajectory) -> Judgement:
    """Judge a trajectory by the constraints of `problem`, from the trajectory alone."""
    limits = case.request.cell.robot.limits
    states = StateSamples.along(trajectory, problem.grid)
    peak = float(case.request.cell.objective.values(states).max())
    worst = [float(function.sample(states)[0].max()) for function in problem.constraints]
    for bound in problem.bounds:
        value = trajectory.extrema(bound.order).value
        over = np.maximum(value - bound.high[:, None], bound.low[:, None] - value) / bound.scale[:, None]
        worst.append(float(over.max()))
    jerks = np.concatenate([trajectory.jumps(3), trajectory.evaluate(trajectory.t[[0, -1]], 3)])
    worst.append(float(np.abs(jerks / limits.jerk).max()))
    worst.append(_off_task(case, trajectory))
    nodes, weights = np.polynomial.legendre.leggauss(_GAUSS)
    h = np.diff(trajectory.t)[:, None]
    times = (trajectory.t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
    share = (0.5 * h * weights).ravel() / trajectory.duration
    jerk = trajectory.evaluate(times, 3) / limits.jerk
    smoothing = 0.5 * case.smoothing * float(share @ (jerk**2).mean(axis=1))
    return Judgement(peak=peak, objective=peak / problem.scale + smoothing, violation=max(0.0, *worst))


def _off_task(case: Case, trajectory: QuinticTrajectory) -> float:
    """How far via-points are from where they have to be, m or rad."""
    if not case.sliding:
        return float(np.abs(trajectory.q - case.via_points).max())
    request = case.request
    at = Postures(request.cell.robot).at(np.ascontiguousarray(trajectory.q))
    return float(np.abs(request.task.errors(at.tool_point, at.tool_rotation, request.goals)).max())


def guess_of(scene: Scene, knots: str) -> tuple[StrokeRequest, InitialGuess]:
    """Return the request and the initial guess of a scene with ``sliding`` or ``fixed`` via-points."""
    request = build_request(scene, replace(scene.planner, knots=knots))
    return request, initial_guess(request)


def case_of(scene: Scene, knots: str) -> Case:
    """Return the problem of a scene around its initial guess; with ``fixed`` ones Chang 2021, Eq. (30)."""
    request, guess = guess_of(scene, knots)
    sliding = knots == "sliding"
    return Case(
        name=scene.name,
        request=request,
        via_points=guess.problem.parametrization.via_points,
        sliding=sliding,
        pinned=sliding and guess.pinned,
    )


def random_scene(via_points: int = 50) -> Scene:
    """Return the first scene of a seeded sequence whose peak is not at a resting end: a triangle in space.

    The arm's posture and the legs' ends are drawn; draws that lead out of reach are passed over.
    """
    rng, scene = np.random.default_rng(SEED), load_scene("triangle")
    for _ in range(_DRAWS):
        posture = np.array(scene.posture) + rng.uniform(-_TURN, _TURN, len(scene.posture))
        corners = rng.uniform(-_REACH, _REACH, (len(_SECONDS) - 1, 3))
        steps = np.diff(np.vstack([np.zeros(3), corners, np.zeros(3)]), axis=0)
        legs = tuple(Leg(by=tuple(by), seconds=s) for by, s in zip(steps.tolist(), _SECONDS, strict=True))
        drawn = scene.changed(name="random", obstacles=(), guardrail=scene.guardrail.changed(bays=0))
        drawn = drawn.with_posture(posture).with_path(legs=legs, via_points=via_points)
        try:
            _, guess = guess_of(drawn.with_options(other_starts=0), "fixed")
            check_feasible(guess.problem)
        except (PathNotFound, OptimisationFailed):
            continue
        if guess.problem.scale > _ABOVE_REST * guess.problem.at_via_points[[0, -1]].max():
            return drawn
    raise SystemExit(f"no random path in {_DRAWS} draws")
