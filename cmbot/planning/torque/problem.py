"""The torque problem (Chang 2021, Eqs. (30)-(37)) as a program over C3 splines: no equality is left.

The objective f is the torque on the guardrail, |n_0|, or another one, in units of its peak at the initial
guess. With p the least peak,

    min (1/2) mean_t f(t)^2 + (rho/2) mean [(jerk/J_C)^2 + (velocity/V_C)^2]

    f(t) <= p (1 + epsilon) at all times

with, for a quiet stroke whose base bends, (1/2) sigma mean_t |Y(t) q''(t)|^2 beside the mean of f^2: the sway
where accelerations change slowly, Y in the postures of the guess, in units of its root mean square there;
subject to the bounds of Eqs. (31)-(32), the tool's deviation and the clearance. epsilon is the option
`peak_tolerance` where p is its lower bound, and `least_peak_tolerance` where that is missed.

Via-points move on manifolds: the postures that hold the tool task.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cmbot.collision import RESOLUTION
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import OptimisationFailed
from cmbot.common.limit import Limit
from cmbot.elastic.modes import linearised
from cmbot.optimization import KinematicBound, Linearization, StateFunction, StateSamples
from cmbot.planning.postures.projection import null_space, project_onto_task
from cmbot.planning.request import StrokeRequest
from cmbot.planning.task import ToolTask
from cmbot.planning.torque.constraints import (
    ClearanceMargin,
    FootHold,
    HoldingTorque,
    JointTorque,
    ProcessSpeed,
    ToolDeviation,
    ToolLag,
    ToolRotation,
    ToolSpeed,
    ToolTilt,
    numbered,
)
from cmbot.planning.workcell.bent_tool import BentTool
from cmbot.planning.workcell.objectives import Objective
from cmbot.robot import Dynamics, Postures, Robot, ToolBatch
from cmbot.toolpath import ToolPoses
from cmbot.trajectory import Parametrization, QuinticTrajectory, SparseSplines, SplineSpace

# Newton steps that project moved via-points onto the tool task, and the error that they leave.
_NEWTON_STEPS = 13
_TASK_TOLERANCE = 1e-11
# Sampled constraints are kept this share, divided by the squared samples per segment, inside their bounds,
# for what parabolas through samples do not see; bounds on polynomials are met at their exact extrema and need
# only room for the solver's tolerance.
_SAMPLED_SHARE = 0.5
_EXACT_SHARE_IN_TOLERANCES = 10.0
# The same room for the clearance, m, and what the certificate's bound may fall short of the distance.
_CLEARANCE_MARGIN_M = 1e-5 + RESOLUTION
# Jerks up to this times the velocity limit, 1/s2, are the most that smoothing counts as one: what is assumed
# of arms whose jerk limits are not known.
_ORDINARY_JERK_RATIO = 20.0
# Gauss points per segment at which the mean square of the torque is taken.
_MEAN_SAMPLES = 3
# Weight of the mean square of a quiet stroke's sway beside that of the objective, and a root mean square, m,
# below which it matters less.
_SWAY_WEIGHT, _STILL_M = 0.005, 1e-5


@dataclass(frozen=True)
class TaskManifold:
    """The postures that hold the tool task at n via-points (a retraction of the parametrization)."""

    postures: Postures
    task: ToolTask
    goals: ToolPoses  # of each
    times: FloatArray  # (n,), s
    bent: BentTool | None = None  # None: the rigid arm's tool holds the task

    def tangents(self, q: FloatArray) -> FloatArray:
        """Directions (n, a, d) of the self-motion at postures `q` (n, d), orthonormal by their metric."""
        return null_space(self.postures, self.task, q, self._tool(q, np.arange(len(q))))

    def _tool(self, q: FloatArray, which: IntArray) -> ToolBatch:
        """The tool in postures `q` (k, d) of some via-points."""
        return self.postures.tool_at(q) if self.bent is None else self.bent.at(self.times[which], q)

    def retract(
        self, q: FloatArray, tangents: FloatArray, u: FloatArray, which: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Move via-points by `u` (k, a), rad: ``task(q) = 0, N^T (q - q_start) = u``, with N the tangents.

        The product is that of the metric of the postures.

        Returns and errors are those of `cmbot.trajectory.Retraction`.
        """
        q, reached = project_onto_task(
            self.postures,
            self.task,
            q[which] + np.einsum("ka,kai->ki", u, tangents),
            self.goals[which],
            steps=_NEWTON_STEPS,
            tolerance=_TASK_TOLERANCE,
            held=tangents,
            tool_of=lambda at, some: self._tool(at, which[some]),
        )
        at = self._tool(q, which)
        if not reached.all():
            error = self.task.errors(at.tool_point, at.tool_rotation, self.goals[which])
            raise OptimisationFailed(
                "a via-point moved to where the tool task cannot be held",
                constraint="tool task at a via-point",
                violation=float(np.abs(error).max()),
            )
        metric = self.postures.metric
        rows = metric.coordinates(metric.coordinates(tangents))
        A = np.concatenate([self.task.jacobian(at.tool_rotation, at.jacobian), rows], axis=1)
        rhs = np.zeros((len(q), A.shape[1], u.shape[1]))
        rhs[:, A.shape[1] - u.shape[1] :] = np.eye(u.shape[1])
        return q, np.linalg.solve(A, rhs).transpose(0, 2, 1)

    def part(self, first: int, last: int) -> TaskManifold:
        """Return the task at the via-points `first` to `last`."""
        some = slice(first, last + 1)
        return TaskManifold(self.postures, self.task, self.goals[some], self.times[some], self.bent)


class TorqueProblem:
    """The program of a planning request around an initial guess; see `cmbot.optimization.program.Program`.

    Parameters
    ----------
    request : StrokeRequest
    parametrization : Parametrization
        Around the initial guess.
    least : float
        What the objective's peak cannot fall below, but for what motion takes off. In postures that do not
        move the arm rests, and they count too; so does what is negligible.
    optimised : bool
        The guess is a motion that was optimised before: no peak below what it has at rest is sought again.
    """

    def __init__(
        self,
        request: StrokeRequest,
        parametrization: Parametrization,
        least: float,
        *,
        optimised: bool = False,
    ) -> None:
        cell = request.cell
        robot, options = cell.robot, cell.options
        self.request, self.parametrization, self.least = request, parametrization, least
        self.samples_per_segment = options.samples_per_segment
        self.joints = robot.joints
        t, q = self.space.t, parametrization.via_points
        self.at_via_points = request.objective.values(StateSamples.at_rest(t, q))
        """The objective at rest in each of the via-points, (n,)."""
        sampled = StateSamples.even(parametrization.trajectory, self.samples_per_segment)
        self.grid = sampled.t
        """Times (N,) at which functions of the state are sampled."""
        # Feet that need nothing ask for 0.
        self.scale = float(request.objective.values(sampled).max()) or 1.0
        fixed = np.setdiff1d(np.arange(len(t)), parametrization.movable)
        if parametrization.retraction is None:
            fixed = fixed[[0, -1]]
        at_fixed = float((self.at_via_points if optimised else self.at_via_points[fixed]).max(initial=0.0))
        self.lower_bound = max(least, at_fixed, request.negligible) / self.scale
        self.objective: StateFunction = ScaledObjective(request.objective, self.scale)
        self.bounds = _kinematic_bounds(robot, 1 - _EXACT_SHARE_IN_TOLERANCES * options.constraint_tolerance)
        inside = 1 - _SAMPLED_SHARE / options.samples_per_segment**2
        postures, task = request.bent or cell.postures, request.task
        hold = robot.holding if robot.holding and robot.holding.bounded else None
        near = inside * request.tool_share
        angle = np.deg2rad(options.max_tool_rotation_deg) * near
        self.constraints: tuple[StateFunction, ...] = (
            JointTorque(Dynamics(robot), robot.limits.torque * inside),
            ToolDeviation(postures, task, options.max_tool_deviation_m * near),
            ClearanceMargin(
                cell.clearances, options.safety_margin_m + request.spare_clearance + _CLEARANCE_MARGIN_M
            ),
            ToolLag(postures, task, options.max_tool_lag_m * near),
            *([] if hold is None else [FootHold(Dynamics(robot), hold, inside)]),
            *(
                [HoldingTorque(Dynamics(robot), robot.holding_limits * inside)]
                if np.isfinite(robot.holding_limits).any()
                else []
            ),
            *([] if task.keep == "position" else [ToolRotation(postures, task, angle)]),
            *([] if task.cone is None else [ToolTilt(postures, task, task.cone * inside)]),
            *([] if task.max_speed is None else [ToolSpeed(postures, task.max_speed * inside)]),
            *(
                []
                if task.speed_tolerance is None
                else [ProcessSpeed(postures, task, task.speed_tolerance * inside)]
            ),
        )
        nodes, weights = np.polynomial.legendre.leggauss(_MEAN_SAMPLES)
        h = np.diff(t)[:, None]
        self.mean_times = (t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
        self._root_weights = np.sqrt((0.5 * h * weights).ravel() / (t[-1] - t[0])) / self.scale

    @property
    def space(self) -> SplineSpace:
        """The splines' space."""
        return self.parametrization.space

    def mean_residuals(self, trajectory: QuinticTrajectory) -> tuple[Linearization, ...]:
        """Return weighted parts of the objective at `mean_times`, and of the sway.

        Their squares sum to the objective's mean square, and to the sway's times its weight.
        """
        states = StateSamples.along(trajectory, self.mean_times)
        parts, still = self.request.objective.residuals(states), np.zeros_like(states.q)
        sway = (Linearization(np.einsum("ki,ki->k", Y, states.a), still, still, Y) for Y in self._sway_rows)
        return (*(part.scaled(self._root_weights) for part in parts), *sway)

    @cached_property
    def _sway_rows(self) -> FloatArray:
        """Weighted derivatives of the sway along x, y and z by the accelerations, (3, G, n)."""
        form, cell = self.parametrization, self.request.cell
        if cell.arm is None or self.request.stroke.file.speed_profile.kind != "quiet":
            return np.empty((0, 0, 0))
        at = linearised(cell.arm, form.via_points).yielding
        place = np.searchsorted(self.space.t, self.mean_times) - 1
        share = (self.mean_times - self.space.t[place]) / np.diff(self.space.t)[place]
        rows = at[place] + share[:, None, None] * (at[place + 1] - at[place])
        rows *= (self.scale * self._root_weights)[:, None, None]
        sway = np.einsum("kij,kj->ki", rows, form.trajectory.evaluate(self.mean_times, 2))
        unit = max(float(np.linalg.norm(sway)), _STILL_M)
        return np.asarray(np.sqrt(_SWAY_WEIGHT) / unit * rows.transpose(1, 0, 2))

    def segment(self, first: int, last: int) -> TorqueProblem:
        """Return the problem between two via-points: at ends inside the path the arm rests, and stays."""
        return TorqueProblem(
            self.request, self.parametrization.segment(first, last), self.lower_bound * self.scale
        )


def parametrization_through(
    request: StrokeRequest,
    via_points: FloatArray,
    *,
    sliding: bool,
    pinned: bool = False,
    near: QuinticTrajectory | None = None,
    splines: SparseSplines | None = None,
) -> Parametrization:
    """Return the splines around those of least jerk through `via_points`.

    Parameters
    ----------
    request : StrokeRequest
    via_points : (n, d), rad
    sliding : bool
        They may move along the self-motion.
    pinned : bool
        All but the first.
    near : QuinticTrajectory, optional
        Around this one instead, as far as it does not miss them; a spline on the same times.
    splines : SparseSplines, optional
        Those of another parametrization of the same request.
    """
    limits = request.cell.robot.limits
    # Jerk bounds far above what the work asks would leave smoothing without weight: splines would swing.
    jerk = np.minimum(limits.jerk, _ORDINARY_JERK_RATIO * limits.velocity)
    bounds = np.stack([limits.velocity, limits.acceleration, jerk])
    splines = splines or SparseSplines(SplineSpace(request.times), bounds)
    manifold = TaskManifold(request.cell.postures, request.task, request.goals, request.times, request.bent)
    coefficients = splines.least_jerk(via_points)
    if near is not None:
        coefficients = splines.coefficients(near) + splines.least_jerk(via_points - near.q)
    return Parametrization(
        splines,
        via_points,
        coefficients,
        retraction=manifold if sliding else None,
        movable=np.arange(1 if pinned else 0, len(via_points)) if sliding else None,
    )


@dataclass(frozen=True)
class ScaledObjective:
    """An objective in units of `scale` (Chang 2021, Eqs. (12) and (30))."""

    objective: Objective
    scale: float
    components: int = 1
    limit: Limit = Limit.PEAK

    @property
    def name(self) -> str:
        """The objective's."""
        return self.objective.name

    def sample(self, states: StateSamples, threshold: float = -np.inf) -> tuple[FloatArray, IntArray]:
        """Return the values (N, 1), exact above the threshold."""
        return numbered(self.objective.values(states, threshold * self.scale)[:, None] / self.scale)

    def linearize(self, states: StateSamples, component: IntArray) -> Linearization:
        """Linearize the value."""
        return self.objective.linearize(states).scaled(1 / self.scale)


def _kinematic_bounds(robot: Robot, inside: float) -> tuple[KinematicBound, ...]:
    limits = robot.limits
    half, middle = limits.range_half, limits.range_middle
    low, high = middle - half * inside, middle + half * inside
    symmetric = ((limits.velocity, "velocity"), (limits.acceleration, "acceleration"), (limits.jerk, "jerk"))
    return (
        KinematicBound(0, low, high, np.where(np.isfinite(half), half, 1.0), "position"),
        *(
            KinematicBound(order, -bound * inside, bound * inside, bound, name)
            for order, (bound, name) in enumerate(symmetric, start=1)
        ),
    )
