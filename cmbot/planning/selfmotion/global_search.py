"""The global search: postures at all via-points that minimise the peak of the objective at rest.

Charts of self-motion at every via-point, and dynamic programming over them. The result is optimal up to the
charts' spacing, and comes with a lower bound: at the via-point that sets it, no admissible posture has a
smaller objective at rest. That is proven where `proof` can, and otherwise an estimate.

Where the tool's axis may lean, charts hold it in the middle of its cone, and random postures anywhere in it
are added: where only leaning ones are admissible, or low. Sequences of all these, and of leaning ones beside
that of the lower bound, are refined in the cone. The lower bound is that of all postures in the cone.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.postures.sampler import PostureSampler
from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.charts import Chart, GraphLayer, LayerCache, best_nodes, connected_parts
from cmbot.planning.selfmotion.dynamic_programming import (
    BottleneckDynamicProgram,
    Edges,
    blocked,
    edges_along,
    nearest_turn,
    refine,
)
from cmbot.planning.selfmotion.followed_bound import followed_bound
from cmbot.planning.selfmotion.lower_bound import LowerBound, find_lower_bound, with_proof
from cmbot.planning.selfmotion.sampler import sampled_charts
from cmbot.planning.workcell.diagnosis import no_start_left
from cmbot.toolpath import ToolPoses, shortest_turns

POSTURE_TOLERANCE = 1e-9
"""Two postures nearer than this in every joint are one, rad."""
# Task coordinates of a whole pose.
_POSE_COORDINATES = 6
# Sequences beside one.
_ALTERNATIVES = 40
# Random postures along a path whose tool may lean, and how many of a via-point are carried to the next.
_LEANING_DRAWS, _CARRIED = 24_000, 200
# How often charts are made denser where no way leads through a via-point, and at how many beside it.
_REFINEMENTS, _ABOUT = 3, 2
# Charts with more edges between them are dense enough.
_DENSE_CHART_EDGES = 100_000
# Checks of a chart at most, and random postures of each as a multiple of those that charts are grown from.
_CHECKS, _SEEDS_OF_A_CHECK = 5, 5


@dataclass(frozen=True, kw_only=True, eq=False)
class GlobalSolution:
    """Postures at the via-points with the smallest peak of the objective at rest.

    Attributes
    ----------
    q : (n, d), rad
    value : (n,)
        The objective at rest in each.
    """

    q: FloatArray
    value: FloatArray

    @property
    def peak(self) -> float:
        """Largest value."""
        return float(self.value.max())

    def mean(self, times: FloatArray) -> float:
        """Return the mean over the `times` (n,) of the via-points."""
        return float(np.trapezoid(self.value, times) / (times[-1] - times[0]))


class GlobalSearch:
    """Charts of self-motion at all via-points, and the best sequences of their postures.

    Parameters
    ----------
    request : StrokeRequest
    lean : (3, 3), optional
        Where the tool's axis may lean: rotation in the tool's frame by which charts hold it apart from the
        middle of its cone.
    bounded_as : GlobalSearch, optional
        One of the same task that leaves less out, whose lower bound is taken.

    Attributes
    ----------
    lower_bound : LowerBound
    step_share : float
        Share of the joints' velocity bounds that steps between via-points may use.
    first_chart : Chart
        At the start of the path.

    Raises
    ------
    PathNotFound
        When a via-point has no admissible posture: which one, and what excluded most postures there.
    """

    def __init__(
        self,
        request: StrokeRequest,
        lean: FloatArray | None = None,
        bounded_as: GlobalSearch | None = None,
    ) -> None:
        self._leaning, self._request = request, request.on_axis
        if lean is not None:
            self._request = replace(request, task=request.task.leaning(lean))
        request = self._request
        # The charts have one turn of these joints; the edges between charts count their angles modulo a turn.
        self._winding = request.cell.robot.limits.winding
        self._wide = request.cell.robot.dof - request.task.dimension > 1
        # The bound with the axis in the middle of its cone and that of all postures, and postures with them.
        self._bound: LowerBound | None = None
        self.lower_bound: LowerBound
        self._lowest = np.empty(0)
        self._lowest_leaning: FloatArray
        self._bound_is_given = bounded_as is not None
        if bounded_as is not None:
            self._bound, self._lowest = bounded_as._bound, bounded_as._lowest
            self.lower_bound, self._lowest_leaning = bounded_as.lower_bound, bounded_as._lowest_leaning
        # How often each chart has been made denser.
        self._rounds = np.zeros(len(request.goals), dtype=np.intp)
        self._sampler, each = sampled_charts(request)
        # What is added to charts of a bound, the charts with it, and the layers of both.
        self._more_of: LowerBound | None = None
        self._more = list[list[FloatArray]]()
        self._joined = dict[int, tuple[FloatArray, FloatArray]]()
        self._own, self._wider = LayerCache(request.cell), LayerCache(request.cell)
        self._layers, self._edges, self._linked = list[GraphLayer](), list[Edges](), list[GraphLayer]()
        self._steps = np.empty(0)
        self._chart(each)

    def _chart(self, each: list[FloatArray]) -> None:
        """Find the lower bound and the graph of charts, (M, d) each."""
        request = self._request
        self._each = self._bounded(each)
        if self._wide or self._leaning is not request:
            self._layers = self._wider.layers(self._with_more(self._each))
        self._allow(request.cell.options.step_share)
        self.first_chart = self._layers[0].chart

    def _bounded(self, each: list[FloatArray]) -> list[FloatArray]:
        """Find the lower bound, unless it is known; return all charts, (M, d) each.

        Where it is set, and where no posture is admissible, more random postures check the chart first; in
        the second case denser charts do, too.
        """
        request, sampler, known = self._request, self._sampler, self._bound
        self._spacing = sampler.spacing
        for _ in range(_CHECKS):
            self._layers = self._own.layers(each)
            best = best_nodes(self._layers)
            empty = next((k for k, node in enumerate(best) if node is None), None)
            if empty is None:
                if known is not None and self._holds(known, best):
                    return each
                known = None
                self._bound, self._lowest = find_lower_bound(request, self._layers, sampler.spacing)
                at = self._bound.via_point
                # A constant is no lower in postures that charts miss.
                if self._layers[at].chart.value.max() <= self._bound.value or request.deadline.expired():
                    break
            else:
                at = empty
            before = sum(len(q) for q in each)
            number = _SEEDS_OF_A_CHECK * request.cell.options.chart_seeds
            each = sampler.complete(each, request.goals, [at], number)
            if sum(len(q) for q in each) == before:
                break
        if empty is not None and not (self._leaning is not request and all(map(len, self._leaners))):
            if self._refine(each, empty):
                return self._bounded(self._each)
            raise blocked(request, self._layers, empty, sampler.coverage)
        if self._leaning is request and self._bound is not None:
            self._bound, self._lowest = with_proof(request, self._bound, self._lowest, sampler.coverage)
            self.lower_bound, self._lowest_leaning = self._bound, self._lowest
        else:
            layers = self._wider.layers([np.vstack(both) for both in zip(each, self._leaners, strict=True)])
            found = find_lower_bound(self._leaning, layers, sampler.spacing)
            self.lower_bound, self._lowest_leaning = with_proof(self._leaning, *found, sampler.coverage)
        return each

    @cached_property
    def _leaners(self) -> list[FloatArray]:
        self._request.reporter.step("sampling postures whose axis leans")
        return leaning_postures(self._leaning)

    def _holds(self, bound: LowerBound, best: Sequence[int | None]) -> bool:
        """Whether the bound holds for charts with these best nodes, as it does unless they are denser."""
        node = best[bound.via_point]
        found = self._layers[bound.via_point].chart.value
        return self._bound_is_given or node is None or bool(found[node] >= bound.value - bound.error)

    def _is_too_far(self, via_point: int, pace: float) -> bool:
        """Whether a step asks joints to be faster, by the factor `pace`, in denser charts, too.

        What charts miss is within their spacing of what they have, at both ends of a step.
        """
        request, k = self._request, max(via_point, 1)
        spacing = self._sampler.spacing_after(int(self._rounds[k - 1 : k + 1].min()))
        moved = (
            self.step_share * request.cell.robot.limits.velocity * (request.times[k] - request.times[k - 1])
        )
        return pace > 1 + float((2 * spacing / request.cell.robot.metric.weight / moved).max())

    def _refine(self, each: list[FloatArray], via_point: int) -> bool:
        """Make charts, (M, d) each, denser about a via-point; return whether they became so."""
        rounds = int(self._rounds[via_point]) + 1
        many = max((len(e.before) for e in self._edges[max(via_point - 1, 0) : via_point + 1]), default=0)
        if rounds > _REFINEMENTS or many > _DENSE_CHART_EDGES or self._request.deadline.expired():
            return False
        beside = np.arange(max(via_point - _ABOUT, 0), min(via_point + _ABOUT + 1, len(each)))
        beside = beside[self._rounds[beside] < rounds]
        self._rounds[beside] = rounds
        self._request.reporter.step(f"charting via-point {via_point + 1} more densely")
        self._each = self._sampler.refined(each, self._request.goals, beside.tolist(), rounds)
        return self._each is not each

    def halved(self, share: float = np.inf) -> GlobalSearch:
        """Return the same charts with half the steps between via-points, or half of those of a `share`."""
        half = copy.copy(self)
        half._allow(0.5 * min(self.step_share, share))
        return half

    def is_of(self, times: FloatArray) -> bool:
        """Whether these are the times (n,) of its via-points."""
        return np.array_equal(self._request.times, times)

    def solve(self, *, pinned: bool, starts: BoolArray | None = None) -> GlobalSolution:
        """Find the sequence with the smallest peak, then mean square, of the objective at rest.

        What is asked again is not searched again.

        Parameters
        ----------
        pinned : bool
            Start in the scene's posture; otherwise anywhere with its tool pose.
        starts : (M,), optional
            In which postures of the first chart it may start.

        Raises
        ------
        PathNotFound
            When no sequence of admissible postures can be followed to the end.
        """
        asked = pinned, None if starts is None else starts.tobytes()
        if asked not in self._solutions:
            solution = self._solve(self._request.first, starts) if pinned else self._solve_freely(starts)
            # Charts may have become denser, and what was found before with them is forgotten.
            self._solutions[asked] = solution
        return self._solutions[asked]

    def _solve_freely(self, starts: BoolArray | None) -> GlobalSolution:
        """Find the best sequence from any of the `starts` (M,), if need be in denser charts."""
        while True:
            try:
                return self._solve(None, starts)
            except PathNotFound as failure:
                k = int(np.abs(self._request.times - failure.time).argmin())
                halved = self.step_share < self._request.cell.options.step_share
                if starts is not None or halved or self._is_too_far(k, failure.pace):
                    raise
                if not self._refine(self._each, k):
                    raise
                self._chart(self._each)

    def solve_elsewhere(self, failed: PathNotFound) -> tuple[GlobalSolution, tuple[PathNotFound, ...]]:
        """Start in the posture nearest to the scene's from which the path can be followed.

        Chang 2021, Section 3.1: the robot should then change its initial position.

        Parameters
        ----------
        failed : PathNotFound
            The failure of the scene's posture.

        Returns
        -------
        solution : GlobalSolution
        failures : tuple of PathNotFound
            That, then those of the postures that are nearer than the solution's.

        Raises
        ------
        PathNotFound
            When none of `PlannerOptions.other_starts` postures leads to the end.
        """
        chart, posture = self._layers[0].chart, self._request.first
        moves = self._moves(posture, chart.q)
        away = self._largest(moves)
        others = np.flatnonzero(chart.within & (away >= POSTURE_TOLERANCE))
        nearest = others[np.argsort(away[others], kind="stable")]
        failures = [failed]
        for k in nearest[: self._request.cell.options.other_starts]:
            if self._request.deadline.expired():
                break
            try:
                return self._solve(posture + moves[k]), tuple(failures)
            except PathNotFound as failure:
                failures.append(failure)
        raise no_start_left(failures) from failed

    def followed_bound(self) -> float:
        """Return the bound of sequences that the joints can follow: `followed_bound`; never below the other.

        Where the tool's axis may lean it is the lower bound, as leaning postures may ask less than charts.

        Raises
        ------
        PathNotFound
            When no sequence can be followed.
        """
        if self._leaning is not self._request:
            return self.lower_bound.value
        followed = followed_bound(self._request, self._layers, self._spacing)
        return max(followed, self.lower_bound.value)

    def parts_of_first_chart(self) -> list[BoolArray]:
        """Return which postures (M,) of the first chart each connected part of it has, nearest first."""
        chart = self.first_chart
        metric = self._request.cell.robot.metric
        label = connected_parts(chart.q, chart.within, self._spacing, metric)
        away = self._largest(self._moves(self._request.first, chart.q))
        # Parts without a posture of the chart itself, as random leaning ones make, are no parts of their own.
        parts = [label == number for number in np.unique(label[: len(self._each[0])]) if number >= 0]
        return sorted(parts, key=lambda part: float(away[part].min()))

    def _allow(self, step_share: float) -> None:
        """Let joints use that share of their velocity bounds between via-points."""
        request = self._request
        self.step_share = step_share
        self._solutions: dict[tuple[bool, bytes | None], GlobalSolution] = {}
        before = self._steps
        self._steps = (
            step_share * request.cell.robot.limits.velocity * np.diff(request.times)[:, None]
            + 0.5 * request.cell.options.chart_spacing / request.cell.robot.metric.weight
        )
        # What was found between the same charts is found again, or holds what shorter steps leave of it.
        same = [a is b for a, b in zip(self._layers, self._linked, strict=False)]
        self._linked, known, longer = self._layers, list[Edges](), list[Edges]()
        if np.array_equal(before, self._steps):
            known = self._edges[: max(same.index(False) - 1, 0) if False in same else len(self._edges)]
        elif all(same) and same and (self._steps <= before).all():
            longer = self._edges
        self._edges = edges_along(self._layers, self._steps, self._winding, known, longer)

    def _moves(self, start: FloatArray, q: FloatArray) -> FloatArray:
        """Moves (M, d) from a posture (d,) to others, the shorter way round where that stays in range."""
        return self._request.cell.robot.limits.turned_towards(start, q, self._winding) - start

    def _largest(self, moves: FloatArray) -> FloatArray:
        """The largest move (M,), rad, of a joint in moves (M, d)."""
        return np.asarray(np.abs(self._request.cell.robot.metric.coordinates(moves)).max(axis=1))

    def _solve(self, start: FloatArray | None, starts: BoolArray | None = None) -> GlobalSolution:
        """Find the best sequence from a posture (d,), or from any of those that `starts` (M,) allows."""
        request, layers = self._request, self._layers
        if starts is None:
            starts = np.ones(len(layers[0].chart.q), dtype=np.bool_)
        if start is not None:
            starts = self._largest(self._moves(start, layers[0].chart.q)) < POSTURE_TOLERANCE
        request.reporter.step("choosing the postures of least torque")
        chosen = BottleneckDynamicProgram(request, layers, self._edges, starts).best()
        q = np.stack([layer.chart.q[k] for layer, k in zip(layers, chosen, strict=True)])
        if self._wide or self._leaning is not request:
            stays = start is not None
            # A start that stays is a lower bound as well.
            at_start = float(layers[0].chart.value[chosen[0]]) if stays else 0.0
            bound = max(self.lower_bound.value, at_start, request.negligible)
            q = refine(self._leaning, q, self._steps, self._spacing, bound, self._winding, start_stays=stays)
        unwound, beyond = self._unwound(q, start)
        if beyond.any():
            search, same = self._on_all_turns(int(beyond.argmax()))
            return search._solve(start, starts[same])
        value = request.cell.objective.at_rest(request.cell.postures.at(q))
        return GlobalSolution(q=unwound, value=value)

    def _with_more(self, each: list[FloatArray]) -> list[FloatArray]:
        """Add to coarse charts the finer ones of the whole pose, and sequences beside the lowest posture.

        Where the axis may lean, also sequences beside the leaning posture of the lower bound. So freedom
        never raises the peak, and a sequence leads on from the scene's own posture.
        """
        if self._more_of is not self.lower_bound:
            self._more_of, self._more, self._joined = self.lower_bound, self._found_beside(), {}
        more = zip(*self._more, strict=True)
        # Charts that stay are the same arrays again.
        all_ = [
            self._joined.get(id(q)) or (q, np.vstack([q, *some])) for q, some in zip(each, more, strict=True)
        ]
        self._joined = {id(q): (q, joined) for q, joined in all_}
        return [joined for _, joined in all_]

    def _found_beside(self) -> list[list[FloatArray]]:
        """Postures, (m, d) at each via-point, that charts get beside their own."""
        request, more = self._request, list[list[FloatArray]]()
        if self._bound is not None:
            more.append(sequences_beside(request, self._lowest, self._bound.via_point, self._spacing))
        if request.cell.robot.dof > _POSE_COORDINATES and not request.deadline.expired():
            pose = replace(request, task=replace(request.task, keep="pose"))
            more.append(sampled_charts(pose)[1])
        if self._leaning is not request:
            k = self.lower_bound.via_point
            goals = _leaning_goals(self._leaning, self._lowest_leaning, k)
            more.append(sequences_beside(request, self._lowest_leaning, k, self._spacing, goals))
            more.append(self._leaners)
        return more

    def _unwound(self, q: FloatArray, start: FloatArray | None) -> tuple[FloatArray, BoolArray]:
        """The same postures (n, d) on the turns next to each other, from those of `start` (d,) if given.

        Also says which joints (d,) leave their ranges then.
        """
        limits = self._request.cell.robot.limits
        q, turn = q.copy(), 2 * np.pi
        q[1:, self._winding] = q[0, self._winding] + np.cumsum(
            nearest_turn(np.diff(q[:, self._winding], axis=0)), axis=0
        )
        first = self._request.state.posture if start is None else start
        turns = np.where(self._winding, np.round((first - q[0]) / turn), 0.0)
        if start is None:
            # The turns nearest to where the arm is on which the sequence stays within the ranges.
            fewest = np.ceil((limits.lower - q.min(axis=0)) / turn)
            most = np.floor((limits.upper - q.max(axis=0)) / turn)
            turns = np.where(self._winding & (fewest <= most), np.clip(turns, fewest, most), turns)
        q += turn * turns
        beyond = (q.min(axis=0) < limits.lower) | (q.max(axis=0) > limits.upper)
        return q, beyond & self._winding

    def _on_all_turns(self, joint: int) -> tuple[GlobalSearch, IntArray]:
        """Return the same charts with a joint's angles on all turns of its range.

        And of which postures of the first chart now those of the new one are copies, (M,).
        """
        limits = self._request.cell.robot.limits
        reach = np.ceil((limits.upper[joint] - limits.lower[joint]) / (2 * np.pi))
        turns = np.zeros((int(2 * reach) + 1, len(limits.lower)))
        turns[:, joint] = 2 * np.pi * np.arange(-reach, reach + 1)
        layers, same_as = [], list[IntArray]()
        for chart in (layer.chart for layer in self._layers):
            q = (chart.q + turns[:, None]).reshape(-1, chart.q.shape[1])
            inside = (q[:, joint] >= limits.lower[joint]) & (q[:, joint] <= limits.upper[joint])
            same = np.tile(np.arange(len(chart.q)), len(turns))[inside]
            same_as.append(same)
            copies = Chart(
                q=q[inside],
                value=chart.value[same],
                joint_use=chart.joint_use[same],
                within=chart.within[same],
            )
            layers.append(GraphLayer(self._request.cell, copies))
        search = copy.copy(self)
        search._layers, search._winding = layers, self._winding & (np.arange(len(limits.lower)) != joint)
        search._allow(self.step_share)
        return search, same_as[0]


def leaning_postures(request: StrokeRequest) -> list[FloatArray]:
    """Return admissible postures (m, d) at each via-point with the tool's axis anywhere in its cone.

    Random ones, and those of the via-points beside with the smallest values, carried along the path.
    """
    cell, goals = request.cell, request.goals
    sampler, last = PostureSampler(cell=cell, task=request.task), len(goals) - 1
    which = np.repeat(np.arange(last + 1), -(-_LEANING_DRAWS // (last + 1)))
    side, share = 2 * np.pi * sampler.rng.uniform(size=len(which)), sampler.rng.uniform(size=len(which))
    tilt = (request.task.cone or 0.0) * np.sqrt(share)
    leans = Rotation.from_rotvec(np.stack([tilt * np.cos(side), tilt * np.sin(side), 0 * side], axis=1))
    some = goals[which]
    some = replace(some, rotation=some.rotation @ leans.as_matrix())
    q, reached = sampler.held(sampler.drawn(len(which)), some)
    each = [sampler.admissible(q[reached & (which == k)]) for k in range(last + 1)]
    for ks, way in ((range(1, last + 1), 1), (range(last - 1, -1, -1), -1)):
        for k in ks:
            q = each[k - way]
            q = q[np.argsort(cell.objective.at_rest(cell.postures.at(q)), kind="stable")[:_CARRIED]]
            if len(q):
                some = goals[np.full(len(q), k)]
                some = replace(some, rotation=some.rotation @ _leans(request, q, k - way))
                each[k] = np.vstack([each[k], sampler.near(q, some)])
    return each


def _leans(request: StrokeRequest, q: FloatArray, via_point: int) -> FloatArray:
    """Rotations (N, 3, 3) in the tool's frame by which its axis leans in postures (N, d) of a via-point."""
    z = request.cell.postures.tool_at(q).tool_rotation[:, :, 2] @ request.goals[via_point].rotation[0]
    turns = shortest_turns(np.broadcast_to([0.0, 0.0, 1.0], z.shape), z)
    return np.asarray(Rotation.from_rotvec(turns).as_matrix())


def _leaning_goals(request: StrokeRequest, posture: FloatArray, via_point: int) -> ToolPoses:
    """Goals whose axis leans all along the path as the tool's does in a posture (d,) of a via-point."""
    return request.task.leaning(_leans(request, posture[None], via_point)[0]).goals(request.times)


def sequences_beside(
    request: StrokeRequest,
    posture: FloatArray,
    via_point: int,
    spacing: float,
    goals: ToolPoses | None = None,
) -> list[FloatArray]:
    """Carry a posture (d,) of a via-point, and others within `spacing`, along the path: (m, d) at each.

    They hold the tool at the `goals` of all via-points, by default those of the request.
    """
    rng = np.random.default_rng(0)
    # The same offsets everywhere give sequences that run side by side.
    offsets = rng.normal(size=(_ALTERNATIVES, len(posture)))
    offsets *= spacing * rng.uniform(size=(_ALTERNATIVES, 1)) / np.linalg.norm(offsets, axis=1, keepdims=True)
    offsets = request.cell.robot.metric.positions(offsets)
    goals = request.goals if goals is None else goals
    each = [np.empty((0, len(posture))) for _ in range(len(goals))]
    for direction in (range(via_point, len(goals)), range(via_point - 1, -1, -1)):
        q = posture
        for k in direction:
            near = np.vstack([q, q + offsets])
            placed, reached = project_onto_task(request.cell.postures, request.task, near, goals[k])
            if not reached[0]:
                break
            each[k], q = placed[reached], placed[0]
    return each
