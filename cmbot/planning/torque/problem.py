"""The torque problem (Chang 2021, Eqs. (30)-(37)) over a family of C3 splines: no equality is left.

Two stages share the constraints of Eqs. (31)-(32), the tool's deviation and the clearance:

- peak: minimise ``b + smoothing`` with ``f(t) <= b scale`` at the working times (Eq. (30), where the
  objective f is ``|n_0|``);
- mean square: where the peak sits at a resting end that is fixed it cannot fall, so with ``f(t)`` held below
  it ``mean_t (f / scale)^2 / 2 + smoothing`` is minimised instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.planning.path.task import ToolTask
from cmbot.planning.torque.constraints import (
    ClearanceMargin,
    JointTorque,
    Linearisation,
    StateConstraint,
    StateSamples,
    ToolDeviation,
)
from cmbot.planning.torque.families import FixedKnots
from cmbot.planning.torque.family import Family
from cmbot.planning.torque.objectives import Objective, ObjectiveShare, objective_of
from cmbot.robot import Dynamics, Kinematics, Robot
from cmbot.scene import PlannerOptions
from cmbot.trajectory.quintic import QuinticTrajectory
from cmbot.trajectory.spline_space import SplineSpace

__all__ = ["KinematicBound", "TorqueProblem"]

# Sampled constraints are kept this share, divided by the squared samples per segment, inside their bounds,
# for what parabolas through samples do not see; bounds on polynomials are met at their exact extrema and need
# only room for the solver's tolerance.
_SAMPLED_SHARE = 0.5
_EXACT_SHARE_IN_TOLERANCES = 10.0
# The same room for the clearance, m.
_CLEARANCE_ROOM = 1e-5
# Gauss points per segment at which the mean square of the torque is taken.
_MEAN_SAMPLES = 3
_ALL = slice(None)


@dataclass(frozen=True)
class KinematicBound:
    """``low <= derivative of the joint's position <= high``, all along (Chang 2021, Eq. (31))."""

    order: int
    low: FloatArray
    high: FloatArray
    scale: FloatArray
    name: str

    def above(self, value: FloatArray, joint: IntArray | slice = _ALL) -> FloatArray:
        """How far values (..., n), or those of some joints, exceed the upper bound, as shares."""
        return np.asarray((value - self.high[joint]) / self.scale[joint])

    def below(self, value: FloatArray, joint: IntArray | slice = _ALL) -> FloatArray:
        """How far values (..., n), or those of some joints, fall short of the lower bound, as shares."""
        return np.asarray((self.low[joint] - value) / self.scale[joint])


class TorqueProblem:
    """Constraints and objectives of trajectories with given knot times.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
    family : Family
        Where the search starts; members of the same kind are handed to the methods.
    clearances : Clearances
    options : PlannerOptions
    resting : tuple of int
        Indices of the via-points where the arm rests in a posture that the family cannot change.
    floor : float
        What the peak cannot fall below, but for what motion takes off; near it the peak is low enough.
    content : float
        The peak need not fall below this: elsewhere as much is asked anyway.
    objective : Objective, optional
        What is made small; left out, as the options say.
    """

    def __init__(
        self,
        robot: Robot,
        task: ToolTask,
        family: Family,
        clearances: Clearances,
        options: PlannerOptions,
        *,
        resting: tuple[int, ...],
        floor: float = 0.0,
        content: float = 0.0,
        objective: Objective | None = None,
    ) -> None:
        self.robot = robot
        self.task = task
        self.clearances = clearances
        self.options = options
        self.family = family
        self.floor = floor
        self.dynamics = Dynamics(robot)
        t = self.space.t
        grid = np.linspace(t[:-1], t[1:], options.samples_per_segment, endpoint=False, axis=1)
        self.grid = np.append(grid.ravel(), t[-1])
        self.objective = objective_of(robot, options) if objective is None else objective
        still = np.zeros_like(family.via_points)
        self.at_via_points = self.objective.values(StateSamples(t, family.via_points, still, still))
        """What is made small at rest in each of the via-points, (n,)."""
        self.via_point_peak = float(self.at_via_points.max())
        self.peak_at_rest = float(self.at_via_points[list(resting)].max(initial=0.0))
        states = self.sampled(self.trajectory(family, family.start))
        self.scale = float(self.objective.values(states).max())
        self.low_enough = floor * (1 + options.gap_target) / self.scale
        self.content = content / self.scale
        self.torque = ObjectiveShare(self.objective, self.scale)
        self.bounds = _kinematic_bounds(robot, 1 - _EXACT_SHARE_IN_TOLERANCES * options.constraint_tolerance)
        inside = 1 - _SAMPLED_SHARE / options.samples_per_segment**2
        self.functions: tuple[StateConstraint, ...] = (
            JointTorque(self.dynamics, robot.limits.torque * inside),
            ToolDeviation(Kinematics(robot), task, options.max_tool_deviation_m * inside),
            ClearanceMargin(clearances, options.safety_margin_m + _CLEARANCE_ROOM),
        )
        nodes, weights = np.polynomial.legendre.leggauss(_MEAN_SAMPLES)
        h = np.diff(t)[:, None]
        self.mean_times = (t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
        """Gauss points at which time means are taken."""
        self._mean_weights = (0.5 * h * weights).ravel() / (t[-1] - t[0])
        self._mean_rows: FloatArray | None = None

    @property
    def space(self) -> SplineSpace:
        """The splines' space."""
        return self.family.space

    def trajectory(self, family: Family, x: FloatArray) -> QuinticTrajectory:
        """Return the trajectory of the unknowns `x` of `family`."""
        return self.space.trajectory(family.knots(x))

    def states(self, family: Family, x: FloatArray, times: FloatArray) -> StateSamples:
        """Return the joints' states at `times` (N,)."""
        return StateSamples(times, *self.trajectory(family, x).states(times))

    def sampled(self, trajectory: QuinticTrajectory, stride: int = 1) -> StateSamples:
        """Return a trajectory's states at every so-manieth time of `grid`."""
        times, samples = self.grid[::stride], self.options.samples_per_segment
        if samples % stride:
            return StateSamples(times, *trajectory.states(times))
        return StateSamples(times, *trajectory.sampled(samples // stride))

    def mean_square(self, family: FixedKnots, x: FloatArray) -> tuple[float, FloatArray]:
        """Half the time mean of the squared objective in units of scale, and its gradient (dimension,)."""
        part, J = self._parts(family, x)
        return 0.5 * float(part @ part), np.asarray(part @ J)

    def mean_square_curvature(self, family: FixedKnots, x: FloatArray) -> FloatArray:
        """Gauss-Newton Hessian (dimension, dimension) of `mean_square` at `x`."""
        J = self._parts(family, x)[1]
        return np.asarray(J.T @ J)

    def mean_parts(self, trajectory: QuinticTrajectory) -> tuple[Linearisation, ...]:
        """Parts of the objective at `mean_times`, weighted: their squares sum to its mean, scale as unit."""
        parts = self.objective.parts(StateSamples(self.mean_times, *trajectory.states(self.mean_times)))
        w = np.sqrt(self._mean_weights) / self.scale
        column = w[:, None]
        return tuple(
            Linearisation(w * part.value, column * part.d_q, column * part.d_v, column * part.d_a)
            for part in parts
        )

    def _parts(self, family: FixedKnots, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """All the parts in a row, and their Jacobian."""
        parts = self.mean_parts(self.trajectory(family, x))
        if self._mean_rows is None:
            self._mean_rows = family.rows(self.mean_times)
        J = [family.chain(x, self._mean_rows, part.d_q, part.d_v, part.d_a) for part in parts]
        return np.concatenate([part.value for part in parts]), np.vstack(J)


def _kinematic_bounds(robot: Robot, inside: float) -> tuple[KinematicBound, ...]:
    limits = robot.limits
    half = np.where(np.isfinite(limits.lower), 0.5 * (limits.upper - limits.lower), np.inf)
    middle = np.where(np.isfinite(half), limits.upper, 0.0) - np.where(np.isfinite(half), half, 0.0)
    low, high = middle - half * inside, middle + half * inside
    symmetric = ((limits.velocity, "velocity"), (limits.acceleration, "acceleration"), (limits.jerk, "jerk"))
    return (
        KinematicBound(0, low, high, np.where(np.isfinite(half), half, 1.0), "position"),
        *(
            KinematicBound(order, -bound * inside, bound * inside, bound, name)
            for order, (bound, name) in enumerate(symmetric, start=1)
        ),
    )
