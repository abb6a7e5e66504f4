"""The torque problem (Chang 2021, Eqs. (30)-(37)) over a family of C3 splines: no equality is left.

Two stages share the constraints of Eqs. (31)-(32), the tool's deviation and the clearance:

- peak: minimise ``b + smoothing`` with ``|n_0(t)| <= b scale`` at the working times (Eq. (30));
- mean square: where the peak sits at a resting end that is fixed it cannot fall, so with ``|n_0(t)|`` held
  below it ``mean_t |n_0 / scale|^2 / 2 + smoothing`` is minimised instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.planning.families import FixedKnots
from cmbot.planning.spline_space import SplineSpace
from cmbot.planning.state_functions import (
    ClearanceMargin,
    GuardrailTorque,
    JointTorque,
    StateFunction,
    States,
    ToolDeviation,
)
from cmbot.planning.task import ToolTask
from cmbot.planning.trajectory import QuinticTrajectory
from cmbot.robot import Dynamics, Kinematics, Robot
from cmbot.scene.clearance import Clearances
from cmbot.scene.options import PlannerOptions

__all__ = ["KinematicBound", "TorqueProblem"]

# Sampled constraints are kept this share inside their bounds, for what lies between the samples; bounds on
# polynomials are met at their exact extrema and need only room for the solver's tolerance.
_SAMPLED_SHARE = 2e-3
_EXACT_SHARE_IN_TOLERANCES = 10.0
# The same room for the clearance, m.
_CLEARANCE_ROOM = 1e-5
# Gauss points per segment at which the mean square of the torque is taken.
_MEAN_SAMPLES = 3


@dataclass(frozen=True)
class KinematicBound:
    """``low <= derivative of the joint's position <= high``, all along (Chang 2021, Eq. (31))."""

    order: int
    low: FloatArray
    high: FloatArray
    scale: FloatArray
    name: str


class TorqueProblem:
    """Constraints and objectives of trajectories with given knot times.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
    family : FixedKnots
        Where the search starts; members of the same kind are handed to the methods.
    clearances : Clearances
    options : PlannerOptions
    resting : tuple of int
        Indices of the via-points where the arm rests in a posture that the family cannot change.
    floor : float, Nm
        What the peak torque cannot fall below, but for what motion takes off; near it the peak is low enough.
    """

    def __init__(
        self,
        robot: Robot,
        task: ToolTask,
        family: FixedKnots,
        clearances: Clearances,
        options: PlannerOptions,
        *,
        resting: tuple[int, ...],
        floor: float = 0.0,
    ) -> None:
        self.robot = robot
        self.options = options
        self.family = family
        self.dynamics = Dynamics(robot)
        t = self.space.t
        grid = np.linspace(t[:-1], t[1:], options.samples_per_segment, endpoint=False, axis=1)
        self.grid = np.append(grid.ravel(), t[-1])
        static = self.dynamics.static_efforts(family.via_points).guardrail_torque
        at_via_points = np.linalg.norm(static, axis=1)
        self.via_point_peak = float(at_via_points.max())
        self.peak_at_rest = float(at_via_points[list(resting)].max(initial=0.0))
        states = self.states(family, family.start, self.grid)
        torque = self.dynamics.efforts(states.q, states.v, states.a).guardrail_torque
        self.scale = float(np.linalg.norm(torque, axis=1).max())
        self.low_enough = floor * (1 + options.gap_target) / self.scale
        self.torque = GuardrailTorque(self.dynamics, self.scale)
        self.bounds = _kinematic_bounds(robot, 1 - _EXACT_SHARE_IN_TOLERANCES * options.constraint_tolerance)
        inside = 1 - _SAMPLED_SHARE
        self.functions: tuple[StateFunction, ...] = (
            JointTorque(self.dynamics, robot.limits.torque * inside),
            ToolDeviation(Kinematics(robot), task, options.max_tool_deviation_m * inside),
            ClearanceMargin(clearances, options.safety_margin_m + _CLEARANCE_ROOM),
        )
        nodes, weights = np.polynomial.legendre.leggauss(_MEAN_SAMPLES)
        h = np.diff(t)[:, None]
        self._mean_times = (t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
        self._mean_weights = (0.5 * h * weights).ravel() / (t[-1] - t[0])
        self._mean_rows = self.rows(self._mean_times)

    @property
    def space(self) -> SplineSpace:
        """The splines' space."""
        return self.family.splines.space

    def trajectory(self, family: FixedKnots, x: FloatArray) -> QuinticTrajectory:
        """Return the trajectory of the unknowns `x` of `family`."""
        return self.space.trajectory(family.knots(x))

    def states(self, family: FixedKnots, x: FloatArray, times: FloatArray) -> States:
        """Return the joints' states at `times` (N,)."""
        return States(times, *self.trajectory(family, x).states(times))

    def rows(self, times: FloatArray) -> FloatArray:
        """Rows of the family's splines at `times`, for its `chain`."""
        return self.family.splines.rows(times, sliding=self.family.sliding)

    def mean_square(self, family: FixedKnots, x: FloatArray) -> tuple[float, FloatArray]:
        """Half the time mean of ``|n_0 / scale|^2``, and its gradient (dimension,)."""
        torque, J = self._weighted_torque(family, x)
        return 0.5 * float(torque @ torque), np.asarray(torque @ J)

    def mean_square_curvature(self, family: FixedKnots, x: FloatArray) -> FloatArray:
        """Gauss-Newton Hessian (dimension, dimension) of `mean_square` at `x`."""
        J = self._weighted_torque(family, x)[1]
        return np.asarray(J.T @ J)

    def _weighted_torque(self, family: FixedKnots, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Torques at the Gauss points, axis after axis, whose squares sum to the mean; their Jacobian."""
        states = self.states(family, x, self._mean_times)
        at = self.dynamics.derivatives(states.q, states.v, states.a)
        weight = np.sqrt(self._mean_weights)[:, None] / self.scale
        J = [
            family.chain(x, self._mean_rows, *(weight * d[:, axis] for d in (at.d_q, at.d_v, at.d_a)))
            for axis in range(3)
        ]
        return (weight * at.value[:, :3]).T.ravel(), np.vstack(J)


def _kinematic_bounds(robot: Robot, inside: float) -> tuple[KinematicBound, ...]:
    limits = robot.limits
    middle = np.where(np.isfinite(limits.lower), 0.5 * (limits.lower + limits.upper), 0.0)
    half = np.where(np.isfinite(limits.lower), 0.5 * (limits.upper - limits.lower), np.inf)
    low, high = middle - half * inside, middle + half * inside
    symmetric = ((limits.velocity, "velocity"), (limits.acceleration, "acceleration"), (limits.jerk, "jerk"))
    return (
        KinematicBound(0, low, high, np.where(np.isfinite(half), half, 1.0), "position"),
        *(
            KinematicBound(order, -bound * inside, bound * inside, bound, name)
            for order, (bound, name) in enumerate(symmetric, start=1)
        ),
    )
