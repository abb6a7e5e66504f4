"""Free moves: certified motions from one posture to another with the tool off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray, interpolated
from cmbot.common.errors import LimitViolation, PathNotFound
from cmbot.optimization import StateSamples
from cmbot.planning.budget import MORE_TIME
from cmbot.planning.certification.certificate import Certificate, certify
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.planning.free_motion.roadmap import lower_peak
from cmbot.planning.free_motion.rrt_connect import MOST_GROWTHS, rrt_connect
from cmbot.planning.job import Segment
from cmbot.planning.request import StrokeRequest
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.diagnosis import most_often_near, out_of_range, overload
from cmbot.planning.workcell.objectives import efforts_of
from cmbot.planning.workcell.workcell import Workcell
from cmbot.robot import Dynamics, Robot
from cmbot.scene import PlannerOptions
from cmbot.toolpath import SpeedProfile
from cmbot.trajectory import QuinticTrajectory, SplineSpace

# Distance of the spline's knots along the path, rad; halved while the spline's certificate does not hold.
_KNOT_SPACING, _MAX_SPACING_HALVINGS = 0.4, 4
# Share of the limits that a free move may use; where at rest it uses more, this share of what that leaves is
# left while it moves.
_LIMIT_SHARE, _LEFT_SHARE = 0.95, 0.25
# Postures of the straight line that are looked at where nothing leads to the other end.
_LINE_POSTURES = 50
# Values of the objective that differ by less are the same, relative.
_SAME_OBJECTIVE_SHARE = 1e-3
# Factors on the shortest duration, while the moving arm asks more than it may, and samples a segment to see.
_SLOWER, _TORQUE_SAMPLES_PER_SEGMENT = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0), 8
# Periods of the slowest mode that a move takes at least: it leaves a swing that the next stroke inherits.
_LEAST_PERIODS = 3.0
# An objective below this is nothing.
_ZERO_OBJECTIVE = 1e-9


Way = Callable[[FreeSpace], FloatArray | None]
"""From the free space to a path (k, n) in it between the ends of a move, or None."""


def _nothing(_: FreeSpace) -> None:
    return None


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeMove:
    """A free move to be planned.

    Attributes
    ----------
    name : str
        Of the segment, as in ``approach``.
    start, end : (n,), rad, of joints that slide m
    start_name, end_name : str
        What messages call the two postures.
    begin : float, s
        When it begins on the job's clock.
    allowed : float
        Value of the objective that the rest of the job reaches anyway.
    most_growths : int
        Of the trees that seek it: fewer where there is something else to do.
    first : callable
        A `Way` that is tried before the straight one.
    known : callable
        A `Way` that is taken, shortened, where the straight one is not free.
    stands : (2,), s
        How long the arm stands before, and after it, while a process force ends, and sets in.
    """

    name: str
    start: FloatArray
    end: FloatArray
    start_name: str
    end_name: str
    begin: float = 0.0
    allowed: float = 0.0
    most_growths: int = MOST_GROWTHS
    first: Way = _nothing
    known: Way = _nothing
    stands: tuple[float, float] = (0.0, 0.0)


def plan_move(request: StrokeRequest, move: FreeMove) -> Segment:
    """Plan a free move: straight in joint space where that is free, else on any free path.

    Where the objective at rest would exceed both its value at the ends and what is allowed, a path is sought
    on which its largest value is least.

    Parameters
    ----------
    request : StrokeRequest
    move : FreeMove

    Raises
    ------
    PathNotFound
        When nothing leads there.
    """
    request = request.tool_off
    space = _space_around(request, move)
    ends = np.stack([move.start, move.end])
    allowed = (1 + _SAME_OBJECTIVE_SHARE) * max(move.allowed, *space.cost(ends))
    given = move.first(space)
    path = _least(request, space, move, given, allowed)
    held = request.task.held_at_start()
    for halving in range(_MAX_SPACING_HALVINGS):
        trajectory = _timed(request, path, _KNOT_SPACING / 2**halving, allowed, move)
        certificate = certify_move(
            request.cell.robot,
            held,
            trajectory,
            request.cell.clearances,
            request.cell.options,
            move.start,
            move.end,
        )
        if certificate.holds:
            break
    try:
        certificate.require()
    except LimitViolation as violation:
        reason = f"no {move.name} to {move.end_name} is certified: {violation}"
        raise request.path_not_found(reason, move.start) from violation
    return Segment(
        name=move.name,
        kind="free",
        begin=move.begin,
        trajectory=trajectory,
        certificate=certificate,
        task=held,
        along_self_motion=given is not None and path is given,
    )


def find_way(request: StrokeRequest, move: FreeMove) -> FloatArray:
    """Return a broken line (k, n) in free space between the ends of a move, with errors as `plan_move`."""
    request = request.tool_off
    space = _space_around(request, move)
    return _ways(request, space, move, move.first(space))[0]


def certify_move(
    robot: Robot,
    task: ToolTask,
    trajectory: QuinticTrajectory,
    clearances: Clearances,
    options: PlannerOptions,
    start: FloatArray | None = None,
    end: FloatArray | None = None,
) -> Certificate:
    """Certify a free move: the tool is off, so no force acts on it, and its place is measured, not bounded.

    Its tip enters workpieces no deeper than at the ends, see `Clearances.no_deeper`.

    Parameters
    ----------
    robot : Robot
    task : ToolTask
        The tool held where the work starts, from `ToolTask.held_at_start`.
    trajectory : QuinticTrajectory
    clearances : Clearances
    options : PlannerOptions
    start, end : (n,), rad, of joints that slide m, optional
        The postures in which it has to start and to end.

    Returns
    -------
    Certificate
        It may not hold, as with `certify`.
    """
    off = robot.tool_off
    clearances = clearances.no_deeper(trajectory.q[[0, -1]], options.safety_margin_m)
    return certify(off, task, trajectory, clearances, options, via_points=None, start=start, end=end)


def free_space(cell: Workcell) -> FreeSpace:
    """Return the postures in which the arm can rest, with the objective there as their cost."""

    def cost(q: FloatArray) -> FloatArray:
        at = cell.postures.at(q)
        return np.where(cell.strong(at), cell.objective.at_rest(at), np.inf)

    def rests(q: FloatArray) -> BoolArray:
        return cell.strong(cell.postures.at(q))

    return FreeSpace(cell.robot, cell.clearances, cell.options.safety_margin_m, cost, rests)


def largest_objective(cell: Workcell, trajectory: QuinticTrajectory) -> float:
    """Return the largest value of the objective on a trajectory, at samples."""
    return float(cell.objective.values(StateSamples.even(trajectory, _TORQUE_SAMPLES_PER_SEGMENT)).max())


def _space_around(request: StrokeRequest, move: FreeMove) -> FreeSpace:
    """The free space with the ends of a move in it."""
    options, ends = request.cell.options, np.stack([move.start, move.end])
    clearances = request.cell.clearances.no_deeper(ends, options.safety_margin_m)
    whole = replace(free_space(request.cell), clearances=clearances)
    for place, q in ((move.start_name, move.start), (move.end_name, move.end)):
        if whole.around(q[None]) is None:
            nearest = clearances.query(q[None])
            why, pair = f"{out_of_range(request.cell, q[None])} is out of its range", None
            if nearest.distance[0] < options.safety_margin_m:
                shapes = clearances.pairs[nearest.pair[0]]
                pair = (shapes.link, shapes.other)
                why = f"{shapes.link} and {shapes.other} come within the safety margin"
            reason = f"no collision-free {move.name}: in {place} {why}"
            raise request.path_not_found(reason, move.start, pair=pair)
    return whole.around(ends) or whole


def _unconnected(request: StrokeRequest, space: FreeSpace, move: FreeMove) -> PathNotFound:
    """The error of a move that was not found: what is in the way on the straight line."""
    line = move.start + np.linspace(0.0, 1.0, _LINE_POSTURES)[:, None] * (move.end - move.start)
    blocked = line[~space.holds(line)]
    heavy = blocked[np.isinf(space.cost(blocked))]
    way, pair = "", None
    if 2 * len(heavy) > len(blocked):
        use = request.cell.use_at_rest(request.cell.postures.at(heavy))
        way = f" (straight there {overload(request.cell, heavy[use.argmax()])})"
        for place, q in ((move.start_name, move.start), (move.end_name, move.end)):
            # No other way helps.
            way = f" (in {place} {asked})" if (asked := overload(request.cell, q)) else way
    elif len(blocked) and (pair := most_often_near(request.cell, blocked)):
        way = f" (straight there {pair[0]} and {pair[1]} come too near)"
    stopped = request.deadline.expired()
    over = f" before {request.deadline.in_words}, was over" if stopped else ""
    reason = f"no collision-free {move.name} to {move.end_name} was found{way}{over}"
    return request.path_not_found(reason, move.start, pair=pair, stopped=stopped)


def _least(
    request: StrokeRequest, space: FreeSpace, move: FreeMove, given: FloatArray | None, allowed: float
) -> FloatArray:
    """The first path (k, n) whose peak is allowed, else one whose peak is as low as was found.

    Near an earlier plan that is its move, joined to the ends as they are now.
    """
    near = _near(request, space, move)
    if near is not None and given is None:
        return near
    found = _ways(request, space, move, given)
    for path in found:
        if space.peak(path) <= allowed:
            return path
    if near is not None:
        return near
    stop = partial(request.deadline.expired, MORE_TIME)
    path = lower_peak(space, min(found, key=space.peak), allowed, stop)
    return space.below(max(allowed, space.peak(path))).shorten(path)


def _near(request: StrokeRequest, space: FreeSpace, move: FreeMove) -> FloatArray | None:
    """The way (k, n) of an earlier plan's move, displaced to the ends as they are now; None if not free."""
    if (earlier := request.earlier.get(move.name)) is None:
        return None
    # It stands before and after it.
    q = earlier.trajectory.q
    q = q[np.append(True, np.diff(q, axis=0).any(axis=1))]
    if len(q) == 1:
        return None
    along = request.cell.robot.metric.lengths(np.diff(q, axis=0)).cumsum()
    ends = np.stack([move.start - q[0], move.end - q[-1]])
    way = q + interpolated(np.append(0.0, along), along[[0, -1]] * [0.0, 1.0], ends)
    return way if space.holds(way).all() else None


def _ways(
    request: StrokeRequest, space: FreeSpace, move: FreeMove, given: FloatArray | None
) -> list[FloatArray]:
    """Free paths (k, n), those that are found at once or, without any, one that trees lead along."""
    found = [] if given is None else [given]
    if space.straight(move.start, move.end):
        found.append(np.stack([move.start, move.end]))
    if not found:
        path = move.known(space)
        if path is None or not space.holds(path).all():
            stop = partial(request.deadline.expired, MORE_TIME)
            path = rrt_connect(space, move.start, move.end[None], stop, move.most_growths)
        if path is None:
            raise _unconnected(request, space, move)
        found = [space.shorten(path)]
    return found


def _timed(
    request: StrokeRequest, path: FloatArray, spacing: float, allowed: float, move: FreeMove
) -> QuinticTrajectory:
    """Put a C3 spline from rest to rest through a broken line, as fast as limits, modes, objective allow."""
    lengths = request.cell.robot.metric.lengths(np.diff(path, axis=0))
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    knots = max(int(np.ceil(along[-1] / spacing)) + 1, 8)
    u = np.linspace(0.0, 1.0, knots)
    share = SpeedProfile(kind="quiet", ramp=0.5).law.share(u)
    q = interpolated(share * along[-1], along, path)
    space = SplineSpace(u)
    trial = space.trajectory(space.least_jerk(q))
    limits = request.cell.robot.limits
    # Slowing down by T divides derivative k by T^k.
    seconds = max(
        float((trial.extrema(order).largest()[0] / (_LIMIT_SHARE * bound)).max()) ** (1.0 / order)
        for order, bound in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1)
    )
    if (frequency := request.cell.lowest_frequency(path[0])) is not None:
        seconds = max(seconds, _LEAST_PERIODS / frequency)
    # At the places of the moving arm, whose peak may lie between knots: no slower arm asks less.
    sampled = StateSamples.even(trial, _TORQUE_SAMPLES_PER_SEGMENT)
    resting = _asked(request, StateSamples.at_rest(sampled.t, sampled.q), allowed)
    most = _Asked(
        use=max(_LIMIT_SHARE, 1 - _LEFT_SHARE * (1 - resting.use)),
        objective=(1 + _SAME_OBJECTIVE_SHARE) * max(resting.objective, 1.0),
    )
    for slower in _SLOWER:
        timed = _slowed(trial, slower * seconds, move.begin, move.stands[0])
        asked = _asked(request, StateSamples.even(timed, _TORQUE_SAMPLES_PER_SEGMENT), allowed)
        if asked.use <= most.use and asked.objective <= most.objective:
            break
    end = _exactly(move.begin, timed.t[-1] + move.stands[1])
    return timed.standing(0.0, float(end))


def _slowed(trial: QuinticTrajectory, seconds: float, begin: float, after: float) -> QuinticTrajectory:
    """The same motion in so many seconds, `after` others, at times that the job's clock holds exactly."""
    if begin == after == 0.0:
        t = trial.t * seconds
        return QuinticTrajectory(t=t, q=trial.q, v=trial.v / seconds, a=trial.a / seconds**2)
    # Rounded times are other times: a spline through these has no jumps.
    space = SplineSpace(_exactly(begin, after + trial.t * seconds))
    return space.trajectory(space.least_jerk(trial.q))


def _exactly(begin: float, t: FloatArray) -> FloatArray:
    """Times that are the same once they are added to `begin`, and taken from it."""
    return (begin + t) - begin


class _Asked(NamedTuple):
    """The largest shares of their limits that joints and feet use, and of what is allowed the objective."""

    use: float
    objective: float


def _asked(request: StrokeRequest, states: StateSamples, allowed: float) -> _Asked:
    """What states ask of the arm, what holds it and the objective."""
    cell = request.cell
    efforts, holding = efforts_of(Dynamics(cell.robot), states), cell.robot.holding
    use = float((np.abs(efforts.joint_torque) / cell.robot.limits.torque).max())
    use = max(use, float(cell.robot.holding_use(efforts.guardrail_wrench).max(initial=0.0)))
    if holding is not None and holding.bounded:
        use = max(use, float(holding.share(efforts.guardrail_wrench, use)[0].max()))
    return _Asked(use, float(cell.objective.values(states).max()) / max(allowed, _ZERO_OBJECTIVE))
