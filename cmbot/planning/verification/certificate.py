"""The certificate: everything that a plan promises, computed again apart from the optimiser.

It reads the finished trajectory alone. Position, velocity, acceleration and jerk are judged at the exact
extrema of their polynomials, which is for all times; torques, clearance and the tool's deviation on a grid
ten times finer than the optimiser's. For the clearance it also states a bound that holds between samples; by
the same bound most samples are known to be further away than the nearest one and are not measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import LimitViolation
from cmbot.elastic.sag import Sag
from cmbot.planning.task import ToolTask
from cmbot.planning.verification.metrics import MotionMetrics, figures, measure, together
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions
from cmbot.trajectory import QuinticTrajectory

__all__ = ["Certificate", "Check", "certificate_grid", "certify"]


# Grid of the certificate: this many times finer than the optimiser's.
_FINER = 10
# What "continuous", "at rest" and "through the via-points" mean in floating point: jumps relative to the
# joint's bound, and via-point errors in rad.
_JUMP = 1e-9
# Where knots are dense, the last digit of a position is a jump of the jerk. By this many last digits a
# spline's knots may be off the smooth ones.
_DIGITS = 64
_VIA_POINT = 1e-10
# Samples that are measured at once: more only need memory, beyond the processor's cache.
_BLOCK = 1 << 14
_DERIVATIVES = (("velocity", "rad/s"), ("acceleration", "rad/s2"), ("jerk", "rad/s3"))


@dataclass(frozen=True, kw_only=True)
class Check:
    """One promise of a plan: the worst value found against its bound.

    Attributes
    ----------
    quantity : str
    time : float, s
        Where the worst value is.
    value, bound : float
    unit : str
    at_least : bool
        The bound is a lower one.
    """

    quantity: str
    time: float
    value: float
    bound: float
    unit: str
    at_least: bool = False

    @property
    def holds(self) -> bool:
        """Whether the value keeps its bound; never true of a value that is not a number."""
        return self.value >= self.bound if self.at_least else self.value <= self.bound


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """What a trajectory was found to do.

    Attributes
    ----------
    checks : tuple of Check
        All promises; the plan is valid when every one holds.
    figures : MotionMetrics
        Velocity, acceleration and jerk at their exact extrema, the rest at the samples.
    clearance_bound : float, m
        No distance is smaller than this at *any* time: samples, less how far the arm can move in between.
    """

    checks: tuple[Check, ...]
    figures: MotionMetrics
    clearance_bound: float

    @property
    def holds(self) -> bool:
        """Whether every promise is kept."""
        return all(check.holds for check in self.checks)

    def require(self) -> None:
        """Refuse a trajectory that breaks a promise.

        Raises
        ------
        LimitViolation
            For the first check that does not hold.
        """
        for check in self.checks:
            if not check.holds:
                raise LimitViolation(
                    check.quantity, time=check.time, value=check.value, bound=check.bound, unit=check.unit
                )


def certify(
    robot: Robot,
    task: ToolTask,
    trajectory: QuinticTrajectory,
    via_points: FloatArray,
    clearances: Clearances,
    options: PlannerOptions,
    *,
    at_work: bool = True,
    sag: Sag | None = None,
    report: Callable[[int, int], None] | None = None,
) -> Certificate:
    """Look at a finished trajectory with fresh eyes.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
    trajectory : QuinticTrajectory
    via_points : (m + 1, n), rad
        What the trajectory was to pass through at its knot times.
    clearances : Clearances
    options : PlannerOptions
        Margin and tool deviation that were promised, and the optimiser's grid.
    at_work : bool
        False with the tool off: its deviation is measured, not bounded.
    sag : Sag, optional
        Where it is compensated: the tool's deviation is that of the bent arm, as predicted.
    report : callable, optional
        Called with the number of samples that are done, and of all.
    """
    grid = certificate_grid(trajectory, options)
    if report is not None:
        report(0, len(grid))
    q = trajectory.evaluate(grid)
    approach = _approach(trajectory, grid, clearances.reach)
    # Where no interval beside a sample can hold the smallest bound, its clearance need not be exact.
    clearance = clearances.along(q, 2 * float(approach.max()))
    rates = _rate_checks(robot, trajectory)
    velocity, acceleration, jerk = (check.value / check.bound for check in rates)
    torques, deviations, parts = [], [], []
    # Sag that is compensated is interpolated along the motion as a whole.
    block = _BLOCK if sag is None else len(grid)
    for first in range(0, len(grid) - 1, block):
        # Each block ends where the next one begins, so that means are over all times.
        some = slice(first, first + block + 1)
        motion = (q[some], *trajectory.derivatives(grid[some], (1, 2, 3)))
        samples = measure(robot, task, clearances, grid[some], motion, sag, clearance=clearance[some])
        times, torque = np.broadcast_arrays(grid[some, None], np.abs(samples.joint_torque))
        torques.append(_joint_check(robot, "torque of {}", "Nm", times, torque, robot.limits.torque))
        if at_work:
            bound = options.max_tool_deviation_m
            quantity = "tool deviation" if sag is None else "expected tool deviation"
            deviations.append(_grid_check(quantity, grid[some], samples.tool_deviation, bound, "m"))
        parts.append((grid[some][-1] - grid[first], figures(robot, samples, (velocity, acceleration, jerk))))
    checks = [
        _range_check(robot, trajectory),
        *rates,
        _worst(torques),
        _continuity_check(robot, trajectory),
        _via_point_check(trajectory, via_points),
        _grid_check("clearance", grid, clearance, options.safety_margin_m, "m", at_least=True),
    ]
    if at_work:
        checks.append(_worst(deviations))
    return Certificate(
        checks=tuple(checks),
        figures=together(parts),
        clearance_bound=float((0.5 * (clearance[:-1] + clearance[1:]) - approach).min()),
    )


def certificate_grid(trajectory: QuinticTrajectory, options: PlannerOptions) -> FloatArray:
    """Times (N,) at which what has no exact extrema is judged, s."""
    t = trajectory.t
    per_segment = _FINER * options.samples_per_segment
    return np.append(np.linspace(t[:-1], t[1:], per_segment, endpoint=False, axis=1).ravel(), t[-1])


def _range_check(robot: Robot, trajectory: QuinticTrajectory) -> Check:
    """Position of the joint that comes nearest to an end of its range, at its exact extrema."""
    limits, position = robot.limits, trajectory.extrema(0)
    finite = np.isfinite(limits.lower)
    half = np.where(finite, 0.5 * (limits.upper - limits.lower), np.inf)
    middle = np.where(finite, limits.upper, 0.0) - np.where(finite, half, 0.0)
    # Extrema are (segments, n, k).
    value, time = (np.moveaxis(x, 1, 2).reshape(-1, robot.dof) for x in (position.value, position.time))
    quantity = "distance of {} from the middle of its range"
    return _joint_check(robot, quantity, "rad", time, np.abs(value - middle), half)


def _rate_checks(robot: Robot, trajectory: QuinticTrajectory) -> list[Check]:
    """Velocity, acceleration and jerk of the joint that uses most of its bound, at the exact extrema."""
    checks = []
    for order, (name, unit) in enumerate(_DERIVATIVES, start=1):
        largest, time = trajectory.extrema(order).largest()
        bound = getattr(robot.limits, name)
        checks.append(_joint_check(robot, f"{name} of {{}}", unit, time[None], largest[None], bound))
    return checks


def _joint_check(
    robot: Robot, quantity: str, unit: str, times: FloatArray, value: FloatArray, bound: FloatArray
) -> Check:
    """The joint, of absolute values (N, n) at `times` (N, n), that uses most of its bound (n,)."""
    k, joint = np.unravel_index((value / bound).argmax(), value.shape)
    return Check(
        quantity=quantity.format(robot.joints[joint]),
        time=float(times[k, joint]),
        value=float(value[k, joint]),
        bound=float(bound[joint]),
        unit=unit,
    )


def _continuity_check(robot: Robot, trajectory: QuinticTrajectory) -> Check:
    """Largest jump at an inner knot, or rate left at an end, as a share of its bound (Eqs. (34)-(37))."""
    limits, t = robot.limits, trajectory.t
    # A quintic whose end is off by x has 60 x / h^3 of jerk more there.
    digit = np.spacing(np.abs(trajectory.q).max(axis=0))
    rounding = float((60 * _DIGITS * digit / limits.jerk).max()) / float(np.diff(t).min()) ** 3
    worst, where = 0.0, float(t[0])
    bounds: tuple[FloatArray | float, ...] = (np.pi, limits.velocity, limits.acceleration, limits.jerk)
    for order, bound in enumerate(bounds):
        jumps = [(t[1:-1], trajectory.jumps(order))]
        if order > 0:
            jumps.append((t[[0, -1]], trajectory.evaluate(t[[0, -1]], order)))
        for times, jump in jumps:
            if len(times):
                share = np.abs(jump / bound).max(axis=1)
                if not share.max() <= worst:
                    worst, where = float(share.max()), float(times[share.argmax()])
    return Check(
        quantity="jump of a joint's position, velocity, acceleration or jerk",
        time=where,
        value=worst,
        bound=max(_JUMP, rounding),
        unit="of its bound",
    )


def _via_point_check(trajectory: QuinticTrajectory, via_points: FloatArray) -> Check:
    error = np.abs(trajectory.evaluate(trajectory.t) - via_points).max(axis=1)
    return _grid_check("distance from a via-point", trajectory.t, error, _VIA_POINT, "rad")


def _grid_check(
    quantity: str, grid: FloatArray, value: FloatArray, bound: float, unit: str, *, at_least: bool = False
) -> Check:
    worst = int(value.argmin() if at_least else value.argmax())
    return Check(
        quantity=quantity,
        time=float(grid[worst]),
        value=float(value[worst]),
        bound=bound,
        unit=unit,
        at_least=at_least,
    )


def _worst(checks: list[Check]) -> Check:
    """The check, of several with upper bounds, that uses most of it; one that is no number is worst."""
    return checks[int(np.argmax([check.value / check.bound for check in checks]))]


def _approach(trajectory: QuinticTrajectory, grid: FloatArray, reach: FloatArray) -> FloatArray:
    """By how much any distance can fall below the mean of those at two neighbouring samples, (N - 1,), m.

    A joint that turns at rate w moves no point beyond it faster than w times its reach. Two shapes of the arm
    are moved against each other only by the joints between them, so the same rate bounds every distance: it
    falls between two samples, h apart, by at most half of rate times h below the mean of both.
    """
    per_segment = (len(grid) - 1) // (len(trajectory.t) - 1)
    fastest = np.abs(trajectory.extrema(1).value).max(axis=2) @ reach
    return np.asarray(0.5 * np.repeat(fastest, per_segment) * np.diff(grid))
