"""Initial guesses: via-points on the path of gradient projection, or of least torque at rest."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import OptimisationFailed, PathNotFound
from cmbot.common.limit import Limit
from cmbot.common.reading.file_types import NonNegative
from cmbot.optimization import find_violations
from cmbot.planning.path.displaced_motion import displaced
from cmbot.planning.path.gradient_projection import find_path, follow_path
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.postures.sampler import axis_leans
from cmbot.planning.request import Motion, StrokeRequest
from cmbot.planning.selfmotion.global_search import POSTURE_TOLERANCE, GlobalSearch, GlobalSolution
from cmbot.planning.selfmotion.lower_bound import LowerBound
from cmbot.planning.torque import TorqueProblem, parametrization_through
from cmbot.planning.workcell.diagnosis import nearest_to_end, out_of_range
from cmbot.trajectory import QuinticTrajectory

SMOOTHER = 0.9
"""A guess with shorter steps is worth it when its roughness is at most this share of that before."""

# From rougher guesses hardly any trajectory leads on: their steps are halved so often at most, as long as the
# peak at rest rises by no more than this share. Where guesses leap it may, and they are halved more often.
_HOPELESS, _MAX_GUESS_HALVINGS, _NEXT_TO_NOTHING, _MAX_LEAP_HALVINGS = 4.0, 3, 1e-3, 6
# A step between via-points leaps from one branch of postures to another where it is longer than the first,
# rad, and the posture with the tool on its path that is nearest to its middle is further from there than this
# share of it.
_LEAP_RAD, _OFF_THE_MIDDLE = 0.3, 0.3
# Random postures in which links are sought that are always near each other.
_SAMPLE_SIZE = 200
# Newton steps at most from postures that may be far from the task.
_MANY_STEPS = 50
# Joints that travel no more than this share of what others do travel much less.
_MUCH_LESS_TRAVEL_SHARE = 0.7
# Directions in which the tool's axis leans where nothing is found in the middle of its cone, and how far, as
# a share of the cone.
_LEANS, _LEANING = 4, 0.7


class Aim(enum.Enum):
    """What is made of an initial guess."""

    OPTIMUM = "the motion of the smallest peak that is found from there"
    FEASIBLE = "the first motion that meets the constraints"
    KEPT = "its own motion"


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What the global search found for each choice of the start.

    Attributes
    ----------
    free, pinned : float or None
        Peak of the objective at rest over the via-points; None where no sequence of postures was found.
    """

    free: NonNegative | None
    pinned: NonNegative | None


@dataclass(frozen=True, kw_only=True, eq=False)
class InitialGuess:
    """Where the optimisation starts, and what is known of it."""

    problem: TorqueProblem
    pinned: bool  # the first via-point does not slide
    lower_bound: LowerBound  # of the peak at rest; without a search that of these via-points
    failures: tuple[PathNotFound, ...] = ()  # of the starts before this one, the scene's posture first
    choice: Choice | None = None  # with sliding knots only
    search: GlobalSearch | None = None  # with sliding knots only; None from an earlier plan
    unreached: PathNotFound | None = None  # why no approach leads where ``start: free`` would start
    way: FloatArray | None = (
        None  # a free broken line (k, d), rad, to the part of the self-motion it starts in
    )
    aim: Aim = Aim.OPTIMUM
    optimised: bool = False  # its via-points are those of a motion that was optimised

    def asked(self, request: StrokeRequest) -> InitialGuess:
        """Return the same splines for a problem of other bounds."""
        form = self.problem.parametrization
        return replace(self, problem=TorqueProblem(request, form, self.lower_bound.value))


def initial_guess(
    request: StrokeRequest, search: GlobalSearch | None = None, *, stay: bool = False
) -> InitialGuess:
    """Return the guess that the option ``knots`` asks for; see `fixed_guess` and `sliding_guess`.

    Where a sliding guess is so rough that hardly any trajectory leads on from it, a smoother one that rests
    below nearly the same peak: shorter steps between via-points often cost no torque. Where it leaps between
    branches of postures, as slow joints have time to, one that does not: no trajectory follows a leap.
    """
    if request.cell.options.knots == "fixed":
        return fixed_guess(request)
    guess = sliding_guess(request, search=search, stay=stay)
    best, shorter = guess, guess.search
    for halving in range(_MAX_LEAP_HALVINGS):
        leaping = leap(request, best.problem.parametrization.via_points)
        enough = halving >= _MAX_GUESS_HALVINGS or roughness(best.problem) <= _HOPELESS
        if shorter is None or (enough and not leaping) or request.deadline.expired():
            break
        # Where there is much time, half of what joints could do is no less than a leap.
        shorter = shorter.halved(leaping or np.inf)
        try:
            # Shorter steps are no reason to leave a posture in which the arm was to stay.
            other = sliding_guess(request, search=shorter, stay=stay or guess.pinned)
        except PathNotFound:
            break
        if leaping:
            guess = best = replace(other, choice=guess.choice)
            continue
        rests = (each.problem.at_via_points.max() for each in (other, guess))
        if next(rests) > next(rests) * (1 + _NEXT_TO_NOTHING):
            break
        may_start = other.pinned == guess.pinned or request.cell.options.start == "free"
        if may_start and roughness(other.problem) <= SMOOTHER * roughness(best.problem):
            best = replace(other, choice=guess.choice)
    return best


def leap(request: StrokeRequest, via_points: FloatArray) -> float:
    """Share of the velocity bounds that the longest leap between via-points (n, d), rad, asks; 0 without one.

    A step leaps that leads from one branch of postures to another: the tool leaves its path on the way, as no
    posture near the middle of the step holds it there.
    """
    cell = request.cell
    metric = cell.robot.metric
    x = metric.coordinates(via_points)
    steps = np.abs(np.diff(x, axis=0)).max(axis=1)
    long = np.flatnonzero(steps > _LEAP_RAD)
    if len(long) == 0:
        return 0.0
    middles = metric.positions(0.5 * (x[long] + x[long + 1]))
    goals = request.task.goals(0.5 * (request.times[long] + request.times[long + 1]))
    near, reached = project_onto_task(cell.postures, request.task, middles, goals, steps=_MANY_STEPS)
    moved = np.abs(metric.coordinates(near - middles)).max(axis=1)
    share = np.abs(np.diff(via_points, axis=0)) / cell.robot.limits.velocity
    share = share.max(axis=1) / np.diff(request.times)
    return float(share[long[~reached | (moved > _OFF_THE_MIDDLE * steps[long])]].max(initial=0.0))


def leap_failure(problem: TorqueProblem) -> OptimisationFailed | None:
    """Return the failure of a problem whose via-points leap, with what splines through them violate most.

    None where none leaps.
    """
    form = problem.parametrization
    if leap(problem.request, form.via_points) == 0.0:
        return None
    worst = find_violations(problem, form.trajectory, np.inf, 0.0, 1).worst
    failure = worst.failure(
        "only by leaps to other branches of postures, off the tool path, were via-points joined in time"
    )
    failure.limit = Limit.LEAP
    return failure


def furthest(request: StrokeRequest, guess: InitialGuess) -> float:
    """Return the time, s, up to which via-points are joined without a leap, where those of a guess leap."""
    while (leaping := leap(request, guess.problem.parametrization.via_points)) and guess.search is not None:
        try:
            guess = sliding_guess(request, search=guess.search.halved(leaping))
        except PathNotFound as failure:
            return failure.time
    return 0.0 if leaping else float(request.times[-1])


def roughness(problem: TorqueProblem) -> float:
    """Largest velocity, acceleration or jerk where a problem starts, as a share of its bound."""
    start = problem.parametrization.trajectory
    shares = (
        np.abs(start.extrema(bound.order).value) / bound.scale[:, None]
        for bound in problem.bounds
        if bound.order > 0
    )
    return max(float(share.max()) for share in shares)


def fixed_guess(request: StrokeRequest) -> InitialGuess:
    """Take via-points from the path of gradient projection, to stay there (Chang 2021, Eqs. (15)-(30))."""
    path, failures = find_path(request)
    placed = _placed(request.on_axis, path.at(request.times))
    form = parametrization_through(request, placed, sliding=False)
    each = request.cell.objective.at_rest(request.cell.postures.at(form.via_points))
    bound = LowerBound(
        value=float(each.max()), error=0.0, via_point=int(each.argmax()), each=each, kind="proven"
    )
    problem = TorqueProblem(request, form, bound.value)
    return InitialGuess(problem=problem, pinned=True, lower_bound=bound, failures=failures)


def sliding_guess(
    request: StrokeRequest,
    unreached: PathNotFound | None = None,
    search: GlobalSearch | None = None,
    starts: BoolArray | None = None,
    unfollowed: PathNotFound | None = None,
    pinned: GlobalSolution | PathNotFound | None = None,
    *,
    stay: bool = False,
) -> InitialGuess:
    """Take via-points from the global search, to slide along the self-motion.

    With ``start: free`` the arm starts wherever the tool pose is the scene's, if that gains enough. With
    ``pinned``, where it is to `stay`, or where no approach leads there (`unreached`), it starts in the
    scene's posture, or in the nearest one from which a path leads on. A `search` of the same request saves
    making the charts again; `starts` says in which postures of its first chart the arm may start. Where no
    trajectory leads on from the scene's posture (`unfollowed`), it starts elsewhere. `pinned` is what the
    search finds from there, where that is known.

    Raises
    ------
    PathNotFound
        When the scene's posture is in collision or within the safety margin, a via-point is blocked, or
        nothing leads from one to the next.
    """
    options = request.cell.options
    if search is None:
        _require_clear_start(request)
        search, free = searched(request)
    else:
        free = solved(search, pinned=False, starts=starts)
    if pinned is None:
        pinned = solved(search, pinned=True)
    failures: tuple[PathNotFound, ...] = () if unreached is None else (unreached,)
    if isinstance(free, PathNotFound):
        raise free
    may_leave = options.start == "free" and unreached is None and not stay
    if unfollowed is not None:
        solution, failures = free, (unfollowed,)
    elif isinstance(pinned, GlobalSolution):
        gains = _gain(pinned, free, request.times) >= options.min_gain
        solution = free if may_leave and gains else pinned
    elif may_leave:
        solution = free
    else:
        solution, failures = search.solve_elsewhere(pinned)
    stays = solution is not free
    form = parametrization_through(request, solution.q, sliding=True, pinned=stays)
    return InitialGuess(
        problem=TorqueProblem(request, form, search.lower_bound.value),
        pinned=stays,
        lower_bound=search.lower_bound,
        failures=failures,
        choice=Choice(free=free.peak, pinned=pinned.peak if isinstance(pinned, GlobalSolution) else None),
        search=search,
        unreached=unreached,
    )


def least_travel_guess(request: StrokeRequest, guess: InitialGuess) -> InitialGuess | None:
    """Take via-points from the path of gradient projection where another path has next to nothing to gain.

    That is where the peak and the mean of the objective at rest are above those of the `guess` by less than
    the option `min_gain`, and the joints travel much less. `request` minimises their travel; None elsewhere.

    Raises
    ------
    PathNotFound
        When that path is blocked.
    """
    path = follow_path(request)
    placed = _placed(request.on_axis, path.at(request.times))
    placed[0] = request.first
    found = [
        GlobalSolution(q=q, value=request.cell.objective.at_rest(request.cell.postures.at(q)))
        for q in (placed, guess.problem.parametrization.via_points)
    ]
    metric = request.cell.robot.metric
    travels = [np.abs(np.diff(metric.coordinates(each.q), axis=0)).sum() for each in found]
    gain = _gain(found[0], found[1], request.times)
    if gain >= request.cell.options.min_gain or travels[0] > _MUCH_LESS_TRAVEL_SHARE * travels[1]:
        return None
    form = parametrization_through(request, placed, sliding=True, pinned=True)
    return replace(guess, problem=TorqueProblem(request, form, 1.0))


def _gain(one: GlobalSolution, better: GlobalSolution, times: FloatArray) -> float:
    """By what share of another solution's peak, or mean, this one's is above it, whichever is more."""
    # Feet that need nothing ask for 0.
    least = float(np.finfo(np.float64).tiny)
    ratios = one.peak / max(better.peak, least), one.mean(times) / max(better.mean(times), least)
    return max(ratios) - 1


def guess_near(request: StrokeRequest, earlier: Motion) -> InitialGuess:
    """Take via-points from the postures of an earlier motion along the stroke, projected onto its task now.

    Where the path has the same via-times the splines are those of that motion, moved, and it is to be kept.
    Without charts nothing is known of the least peak, and no optimum is sought. The first one stays where the
    motion began in the posture in which the work starts now, or has to. Fixed knots are those of the path
    now.

    Raises
    ------
    PathNotFound
        When a posture cannot be projected onto the tool path.
    """
    options = request.cell.options
    if options.knots == "fixed":
        return fixed_guess(request)
    rate = earlier.trajectory.duration / request.times[-1]
    q = earlier.trajectory.evaluate(request.times * rate)
    begins_there = float(np.abs(q[0] - request.first).max()) <= POSTURE_TOLERANCE
    pinned = options.start == "pinned" or begins_there
    placed = _placed(request, q)
    if pinned:
        placed[0] = request.first
    each = request.cell.objective.at_rest(request.cell.postures.at(placed))
    bound = LowerBound(value=float(each.max()), error=0.0, via_point=int(each.argmax()), each=each)
    times = earlier.trajectory.t
    is_same = len(times) == len(request.times) and np.allclose(times, request.times * rate, atol=1e-9)
    near = displaced(request, earlier, placed) if is_same else None
    form = parametrization_through(request, placed, sliding=True, pinned=pinned, near=near)
    problem = TorqueProblem(request, form, bound.value)
    aim = Aim.KEPT if is_same else Aim.FEASIBLE
    return InitialGuess(problem=problem, pinned=pinned, lower_bound=bound, aim=aim)


def problem_near(
    request: StrokeRequest,
    guess: InitialGuess,
    via_points: FloatArray,
    *,
    least: float | None = None,
    near: QuinticTrajectory | None = None,
    stays: bool = False,
) -> TorqueProblem:
    """Return the problem of a guess as `request` asks, near `via_points` (n, d), rad; where it `stays` there.

    Its splines are around those of least jerk, or around the trajectory `near`, whose via-points they are.
    `least` is what the peak cannot fall below; left out, the guess's.

    Raises
    ------
    PathNotFound
        When a via-point cannot be projected onto the tool path.
    """
    placed, before = _placed(request, via_points), guess.problem.parametrization
    slides = before.retraction is not None and not stays
    pinned = slides and guess.pinned
    splines = before.splines if np.array_equal(before.space.t, request.times) else None
    form = parametrization_through(request, placed, sliding=slides, pinned=pinned, near=near, splines=splines)
    least = guess.lower_bound.value if least is None else least
    return TorqueProblem(request, form, least, optimised=guess.optimised)


def guess_along(request: StrokeRequest, guess: InitialGuess, optimised: QuinticTrajectory) -> InitialGuess:
    """Return the guess that goes on from where an optimisation ended; errors as `problem_near`."""
    ended, form = replace(guess, optimised=True), guess.problem.parametrization
    # Via-points that do not slide are not moved by what a bent arm's were moved by, either.
    q = form.via_points if form.retraction is None else optimised.q
    return replace(ended, problem=problem_near(request, ended, q, near=optimised))


def searched(
    request: StrokeRequest, bounded_as: GlobalSearch | None = None
) -> tuple[GlobalSearch, GlobalSolution | PathNotFound]:
    """The global search, and what it finds from any start; its bound is that of another one where given.

    Where the tool's axis may lean and nothing is found with it in the middle of its cone, it leans all along.
    """
    if request.task.cone is None:
        search = GlobalSearch(request, bounded_as=bounded_as)
        return search, solved(search, pinned=False)
    failures: list[PathNotFound] = []
    for lean in (None, *axis_leans(_LEANING * request.task.cone, _LEANS)):
        if failures and request.deadline.expired():
            break
        try:
            search = GlobalSearch(request, lean, bounded_as)
            return search, search.solve(pinned=False)
        except PathNotFound as failure:
            failures.append(failure)
            request.reporter.step("nothing found in the middle of the cone; leaning the tool's axis")
    raise failures[0]


def _require_clear_start(request: StrokeRequest) -> None:
    """Refuse a scene's posture within the safety margin: neither work nor approach can start there."""
    cell = request.cell
    margin, q = cell.options.safety_margin_m, request.first
    smallest = cell.clearances.query(q[None])
    distance = float(smallest.distance[0])
    if distance >= margin:
        return
    shapes = cell.clearances.pairs[smallest.pair[0]]
    always = ""
    if shapes.self_collision and _are_always_near(request, int(smallest.pair[0])):
        always = f"; in all of {_SAMPLE_SIZE} random postures they do, and robot.srdf can disable the pair"
    raise request.path_not_found(
        f"in the scene's posture {shapes.describe(distance, margin)}{always}",
        q,
        pair=(shapes.link, shapes.other),
    )


def _are_always_near(request: StrokeRequest, pair: int) -> bool:
    """Whether two links are within the safety margin in random postures, too."""
    cell = request.cell
    q = cell.robot.limits.drawn(np.random.default_rng(0), _SAMPLE_SIZE)
    row = np.arange(_SAMPLE_SIZE)
    distance = cell.clearances.distances(q, row, np.full(_SAMPLE_SIZE, pair))
    return bool((distance < cell.options.safety_margin_m).all())


def solved(
    search: GlobalSearch, *, pinned: bool, starts: BoolArray | None = None
) -> GlobalSolution | PathNotFound:
    """Return what `GlobalSearch.solve` does, or its failure."""
    try:
        return search.solve(pinned=pinned, starts=starts)
    except PathNotFound as failure:
        return failure


def _placed(request: StrokeRequest, rough: FloatArray) -> FloatArray:
    """Project postures (n, d) near the via-points onto the tool task."""
    bent = request.bent
    q, reached = project_onto_task(
        request.cell.postures,
        request.task,
        rough,
        request.goals,
        steps=_MANY_STEPS,
        tolerance=1e-12,
        tool_of=None if bent is None else lambda at, which: bent.at(request.times[which], at),
    )
    for k in np.flatnonzero(~reached)[:1]:
        joint = out_of_range(request.cell, rough[k : k + 1]) or nearest_to_end(request.cell, rough[k])
        raise request.path_not_found(
            f"via-point {k + 1} cannot be put onto the tool path exactly by Newton steps (nearest "
            f"to an end of its range is {joint})",
            rough[k],
            request.times[k],
        )
    return q
