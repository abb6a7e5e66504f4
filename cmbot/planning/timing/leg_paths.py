"""Joint paths of legs, and what bounds a motion along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, make_lsq_spline

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import LimitViolation
from cmbot.common.limit import Limit
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.request import StrokeRequest
from cmbot.planning.timing.law_search import Bounded, LawSearch, shortest_laws
from cmbot.robot import Dynamics, Kinematics, Robot
from cmbot.scene import SPEED_TOLERANCE
from cmbot.toolpath import Curve, LegLaw
from cmbot.trajectory import QuinticTrajectory

# Pieces of the spline that a joint path is, one a segment, and points of each that are put onto the task.
_FEWEST_PIECES, _MOST_PIECES, _PROJECTED_PER_PIECE = 12, 200, 3
# More of them on curves, whose curvature jumps where lines and arcs meet; on straight legs more of them show
# self-motion that has nothing to do with the path.
_CURVE_DENSITY = 1.6
# Points a piece, and in all at least, at which torques and the tool's speed are computed.
_POINTS_PER_PIECE, _MIN_POINTS = 6, 240
# Shares of the bounds that laws may use: splines through some points of a law's motion swing a little about
# it.
_VELOCITY, _ACCELERATION, _JERK, _TORQUE, _BASE_TORQUE, _TOOL_SPEED = 0.995, 0.99, 0.97, 0.98, 0.995, 0.999
# Phases of a law: a few for each segment of the splines that follow it, or one for a few segments. Where the
# jerk bends at other times than at knots or halfway, hardly any splines follow.
_PHASES, _FEWEST_PHASES, _MOST_PHASES = 2, 12, 80


@dataclass(frozen=True, kw_only=True, eq=False)
class LegPath:
    """The joints along a leg.

    Attributes
    ----------
    leg : int
    q : BSpline
        Postures (n,) by the share of the leg's length.
    segments : int
        Of the splines on the leg.
    """

    leg: int
    q: BSpline
    segments: int


@dataclass(frozen=True, kw_only=True, eq=False)
class RoughLaw:
    """A law of half the phases.

    Attributes
    ----------
    path : LegPath
    search : LawSearch
        That of a law which splines follow, from this one on.
    seconds : float
        How long it takes.
    """

    path: LegPath
    search: LawSearch
    seconds: float


def leg_paths(
    request: StrokeRequest, legs: Sequence[int], trajectory: QuinticTrajectory
) -> tuple[LegPath, ...]:
    """Return the joint paths of legs that a trajectory of a request follows, put onto the task."""
    path, times = request.task.path, request.times
    found = []
    for leg in legs:
        begin, end = path.leg_times[leg : leg + 2]
        segments = int(((times > begin + 1e-9 * path.duration) & (times <= end + 1e-9 * path.duration)).sum())
        finer = 1.0 if path.segments[leg].is_straight else _CURVE_DENSITY
        pieces = int(np.clip(finer * segments, _FEWEST_PIECES, finer * _MOST_PIECES))
        curve = path.segments[leg].curve
        shares = _even_shares(curve, _PROJECTED_PER_PIECE * pieces)
        at = path.times_at(leg, shares)
        rough = trajectory.evaluate(at)
        # Where the tool hardly moves, at the ends, self-motion is steep in the share: that is smoothed.
        knots = np.concatenate([np.zeros(6), _even_shares(curve, pieces)[1:-1], np.ones(6)])
        smooth = make_lsq_spline(shares, rough, knots, k=5)(shares)
        smooth[[0, -1]] = rough[[0, -1]]
        q, _ = project_onto_task(
            request.cell.postures, request.task, smooth, request.task.goals(at), steps=30
        )
        found.append(LegPath(leg=leg, q=make_lsq_spline(shares, q, knots, k=5), segments=segments))
    return tuple(found)


def _even_shares(curve: Curve, steps: int) -> FloatArray:
    """Shares (steps + 1,) of a curve's length, as dense where it bends as via-points are."""
    even = np.linspace(0.0, 1.0, steps + 1)
    shares = np.concatenate([[0.0], curve.breaks, [1.0]])
    bend = curve.bend_share(shares)
    way = shares + bend
    return np.interp(way[-1] * even, way, shares) if bend.any() else even


def bounds_along(
    robot: Robot, q: BSpline, max_speed: float | None = None, max_base_torque: float | None = None
) -> list[Bounded]:
    """Return what bounds a motion along a joint path: joints, torques, the tool's speed, the base's torque.

    Parameters
    ----------
    robot : Robot
        Its tool on.
    q : BSpline
        Postures (n,) by the share.
    max_speed : float, optional
        Of the tool point, m/s.
    max_base_torque : float, optional
        Nm.
    """
    limits, first, second, third = robot.limits, *(q.derivative(k) for k in (1, 2, 3))
    bounded = [
        Bounded(order=1, terms=(first,), bound=_VELOCITY * limits.velocity),
        Bounded(order=2, terms=(first, second), bound=_ACCELERATION * limits.acceleration),
        Bounded(
            order=3,
            terms=(first, BSpline(second.t, 3 * second.c, second.k), third),
            bound=_JERK * limits.jerk,
        ),
    ]
    s = np.linspace(0.0, 1.0, max(_POINTS_PER_PIECE * (len(np.unique(q.t)) - 1), _MIN_POINTS) + 1)
    still, along, bend = np.zeros_like(q(s)), first(s), second(s)
    each = [Dynamics(robot).efforts(q(s), v, a) for v, a in ((still, still), (still, along), (along, bend))]
    on_base = None if max_base_torque is None else np.array([_BASE_TORQUE * max_base_torque])
    for name, bound, norm in (
        ("joint_torque", _TORQUE * limits.torque, False),
        ("guardrail_torque", on_base, True),
    ):
        if bound is None:
            continue
        rest, speeding, turning = (getattr(efforts, name) for efforts in each)
        terms = (CubicSpline(s, speeding - rest), CubicSpline(s, turning - rest))
        bounded.append(Bounded(order=2, terms=terms, bound=bound, offset=CubicSpline(s, rest), norm=norm))
    if max_speed is not None:
        J = Kinematics(robot).tool_point_jacobians(q(s))[1]
        velocity = CubicSpline(s, np.einsum("kij,kj->ki", J, along))
        bounded.append(
            Bounded(order=1, terms=(velocity,), bound=np.array([_TOOL_SPEED * max_speed]), norm=True)
        )
    return bounded


def rough_laws(request: StrokeRequest, paths: Sequence[LegPath]) -> tuple[RoughLaw, ...]:
    """Return laws of few phases along joint paths within a request's limits, in which others are sought.

    Raises
    ------
    LimitViolation
        Where the arm asks more of the base, or of a joint, at rest than it may.
    """
    task, rough, fine = request.task, list[LawSearch](), list[LawSearch]()
    max_speed = None if task.max_speed is None else task.max_speed / (1 + SPEED_TOLERANCE)
    for each in paths:
        finer = max(min(_PHASES, _MOST_PHASES // each.segments), _FEWEST_PHASES // each.segments)
        phases = each.segments * finer or each.segments // -(-each.segments // _MOST_PHASES)
        bounded = bounds_along(request.cell.robot, each.q, max_speed, task.max_base_torque)
        fine.append(LawSearch(bounded=bounded, phases=phases))
        rough.append(replace(fine[-1], phases=phases // 2 if phases >= 2 * each.segments else phases))
    found = list[RoughLaw]()
    for each, search, (jerk, seconds) in zip(paths, fine, shortest_laws(rough), strict=True):
        if not np.isfinite(seconds):
            raise _too_heavy(request, each)
        found.append(RoughLaw(path=each, search=replace(search, known=[jerk]), seconds=seconds))
    return tuple(found)


def shortest_laws_of(rough: Sequence[RoughLaw], known: Sequence[LegLaw]) -> tuple[LegLaw, ...]:
    """Return the shortest laws along joint paths, sought from rough ones and from those that are known."""
    searches, starts = [each.search for each in rough], {(law.leg, len(law.seconds)): law for law in known}
    for k, each in enumerate(rough):
        if (law := starts.get((each.path.leg, each.search.phases))) is not None:
            jerk = np.array(law.jerk) * law.duration**3
            searches[k] = replace(each.search, known=[*each.search.known, jerk])
    found = zip(rough, shortest_laws(searches), strict=True)
    each_law = ((each.path.leg, each.search.phases, *law) for each, law in found)
    return tuple(
        LegLaw(leg=leg, seconds=(T / k,) * k, jerk=tuple((jerk / T**3).tolist()))
        for leg, k, jerk, T in each_law
    )


def _too_heavy(request: StrokeRequest, path: LegPath) -> LimitViolation:
    """The error of a leg on which no motion is slow enough."""
    cell = request.cell
    shares = np.linspace(0.0, 1.0, 201)
    efforts = Dynamics(cell.robot).static_efforts(path.q(shares))
    time = float(request.task.path.leg_times[path.leg])
    most = request.task.max_base_torque
    asked = float(np.linalg.norm(efforts.guardrail_torque, axis=1).max())
    if most is not None and asked >= _BASE_TORQUE * most:
        return LimitViolation(
            "torque on the base at rest",
            time=time,
            value=asked,
            bound=most,
            unit="Nm",
            limit=Limit.BASE_TORQUE,
        )
    use = np.abs(efforts.joint_torque) / cell.robot.limits.torque
    joint = int(use.max(axis=0).argmax())
    bound = float(cell.robot.limits.torque[joint])
    return LimitViolation(
        f"torque of {cell.robot.joints[joint]} at rest",
        time=time,
        value=float(use.max()) * bound,
        bound=bound,
        unit=cell.robot.limits.units(joint).torque,
        limit=Limit.JOINT_TORQUE,
    )
