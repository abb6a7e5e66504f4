"""Why an attempt failed, as data: by its class remedies are chosen, and its error is what is raised."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import TypeVar, assert_never

import numpy as np

from cmbot.common.errors import LimitViolation, OptimisationFailed, PathNotFound, PlanningError
from cmbot.common.limit import Limit
from cmbot.planning.request import StrokeRequest
from cmbot.robot import Dynamics
from cmbot.trajectory import QuinticTrajectory

Made = TypeVar("Made")

# Samples per segment at which the nearest pair and the weakest joint are sought.
_PAIR_SAMPLES_PER_SEGMENT = 10
_DERIVATIVE_OF_LIMIT = {Limit.RATES: 0, Limit.VELOCITY: 1, Limit.ACCELERATION: 2, Limit.JERK: 3}


@dataclass(frozen=True, kw_only=True)
class NearObstacle:
    """Two shapes come nearer to each other than the safety margin; both are in m."""

    distance: float
    margin: float


@dataclass(frozen=True, kw_only=True)
class JointRate:
    """A joint exceeds a bound on the derivative of an order of its position; order 0: on one of them."""

    order: int
    ratio: float  # of the value to its bound


@dataclass(frozen=True, kw_only=True)
class JointTorque:
    """A joint's torque exceeds its bound."""

    ratio: float


@dataclass(frozen=True, kw_only=True)
class ToolOff:
    """The tool is off its timed path, as splines leave it between via-points."""

    what: Limit
    ratio: float


@dataclass(frozen=True, kw_only=True)
class OtherLimit:
    """Another limit is broken."""

    what: Limit


Broken = NearObstacle | JointRate | JointTorque | ToolOff | OtherLimit
"""What is broken."""


@dataclass(frozen=True, kw_only=True)
class NoWay:
    """No sequence of postures, or no free move, leads on."""

    error: PathNotFound

    @property
    def is_start_near(self) -> bool:
        """Whether it is the start posture that is too near to something: no other place is the matter."""
        return self.error.pair is not None and self.error.time == 0.0


@dataclass(frozen=True, kw_only=True)
class NoTrajectory:
    """The optimiser found no trajectory."""

    error: OptimisationFailed
    broken: Broken


@dataclass(frozen=True, kw_only=True)
class Uncertified:
    """The certificate of a trajectory does not hold."""

    error: LimitViolation
    broken: Broken
    trajectory: QuinticTrajectory | None = None

    @property
    def excess(self) -> float:
        """By how much the bound is missed, as a share of it."""
        return abs(self.error.value - self.error.bound) / max(abs(self.error.bound), 1e-12)


@dataclass(frozen=True, kw_only=True)
class OutOfTime:
    """The time was over before it was known whether there is one."""

    during: NoWay | NoTrajectory


Failure = NoWay | NoTrajectory | Uncertified | OutOfTime
"""Why an attempt failed."""


def strays(failure: object) -> bool:
    """Whether no motion was found, or certified, that keeps the tool on its path."""
    return isinstance(failure, NoTrajectory | Uncertified) and isinstance(failure.broken, ToolOff)


def attempted(request: StrokeRequest, make: Callable[[], Made]) -> Made | Failure:
    """Return what is made with a request, or why it fails: solvers raise their errors as far as this."""
    try:
        return make()
    except (PathNotFound, OptimisationFailed, LimitViolation) as error:
        return failure_of(request, error)


def failure_of(
    request: StrokeRequest,
    error: PathNotFound | OptimisationFailed | LimitViolation,
    trajectory: QuinticTrajectory | None = None,
) -> Failure:
    """Return the failure that an error tells of, with pairs and joints named.

    A `trajectory` is the one whose certificate does not hold.
    """
    failure: NoWay | NoTrajectory
    match error:
        case PathNotFound():
            # What planning comes upon has no line in the scene's file.
            failure = NoWay(error=copy(error))
            failure.error.key, failure.error.stopped = "", False
        case OptimisationFailed():
            constraint, broken = _named(request, error)
            again = replace(error, constraint=constraint, stopped=False)
            failure = NoTrajectory(error=again, broken=broken)
        case LimitViolation():
            broken = _broken(error.limit, error.value, error.bound)
            return Uncertified(error=replace(error), broken=broken, trajectory=trajectory)
        case _:
            assert_never(error)
    return OutOfTime(during=failure) if error.stopped else failure


def error_of(failure: Failure) -> PlanningError:
    """Return the error that tells of a failure, to be raised."""
    if isinstance(failure, OutOfTime):
        error = error_of(failure.during)
        error.stopped = True
        return error
    return copy(failure.error)


def in_words(failure: Failure) -> str:
    """Say what failed, as part of a sentence."""
    if isinstance(failure, NoTrajectory):
        return f"{failure.error.reason}; {failure.error.constraint}"
    return str(error_of(failure))


def briefly(failure: Failure) -> str:
    """Say in a few words what failed."""
    told = failure.error.reason if isinstance(failure, NoWay | NoTrajectory) else in_words(failure)
    return told.partition(";")[0]


def _named(request: StrokeRequest, error: OptimisationFailed) -> tuple[str, Broken]:
    """The worst constraint with its pair or joint, and what is broken."""
    cell = request.cell
    trajectory, broken = error.trajectory, _broken(error.limit, 1.0 + error.violation, 1.0)
    if isinstance(broken, NearObstacle):
        broken = NearObstacle(distance=0.0, margin=cell.options.safety_margin_m)
    if not isinstance(trajectory, QuinticTrajectory):
        return error.constraint, broken
    q, v, a = trajectory.sampled(_PAIR_SAMPLES_PER_SEGMENT)
    match broken:
        case NearObstacle(margin=margin):
            smallest = cell.clearances.query(q)
            worst = int(smallest.distance.argmin())
            pair = cell.clearances.pairs[int(smallest.pair[worst])]
            near = NearObstacle(distance=float(smallest.distance[worst]), margin=margin)
            return f"clearance of {pair.link} from {pair.other}{pair.touching}", near
        case JointTorque():
            torque = Dynamics(cell.robot).efforts(q, v, a).joint_torque
            use = np.abs(torque) / cell.robot.limits.torque
            return f"torque of {cell.robot.joints[int(use.max(axis=0).argmax())]}", broken
        case OtherLimit(what=Limit.HOLD) if cell.robot.holding is not None:
            wrench = Dynamics(cell.robot).efforts(q, v, a).guardrail_wrench
            most = cell.robot.holding.most_used(wrench[[cell.robot.holding.share(wrench)[0].argmax()]])
            return f"{error.constraint}, {most.bound}: {most.in_words}", broken
    return error.constraint, broken


def _broken(limit: Limit, value: float, bound: float) -> Broken:
    """What is broken where a value is beyond its bound."""
    ratio = value / bound if bound else np.inf
    match limit:
        case Limit.CLEARANCE:
            return NearObstacle(distance=value, margin=bound)
        case Limit.VELOCITY | Limit.ACCELERATION | Limit.JERK | Limit.RATES:
            return JointRate(order=_DERIVATIVE_OF_LIMIT[limit], ratio=ratio)
        case Limit.JOINT_TORQUE:
            return JointTorque(ratio=ratio)
        case Limit.TOOL_DEVIATION | Limit.TOOL_ROTATION | Limit.TOOL_TILT | Limit.TOOL_LAG:
            return ToolOff(what=limit, ratio=ratio)
        case Limit.TOOL_SPEED | Limit.PROCESS_SPEED | Limit.SHIFT:
            return ToolOff(what=limit, ratio=ratio)
        case (
            Limit.POSITION
            | Limit.HOLD
            | Limit.HOLDING_TORQUE
            | Limit.BASE_TORQUE
            | Limit.CONTINUITY
            | Limit.PEAK
            | Limit.SWAY
            | Limit.LEAP
            | Limit.OTHER
        ):
            return OtherLimit(what=limit)
        case _:
            assert_never(limit)
