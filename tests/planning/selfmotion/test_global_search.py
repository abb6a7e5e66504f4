"""The global search: best sequences through the charts, the bound below them, failures with reasons."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from small_scenes import off_task, request_of, short_scene
from urdf_arms import six_joint_scene

from cmbot.collision import Smallest
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound, PlanningError
from cmbot.planning import GlobalSearch, plan
from cmbot.planning.postures.projection import null_space, project_onto_task
from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion import global_search, sampler as sampling
from cmbot.planning.selfmotion.dynamic_programming import edges_along, refine
from cmbot.planning.selfmotion.global_search import sequences_beside
from cmbot.planning.selfmotion.lower_bound import LowerBound, find_lower_bound
from cmbot.planning.selfmotion.sampler import SelfMotionSampler
from cmbot.robot import Dynamics


def sliding(**changes: object) -> StrokeRequest:
    return request_of(short_scene(**changes), knots="sliding")


@pytest.fixture(scope="module")
def asked() -> StrokeRequest:
    return sliding()


@pytest.fixture(scope="module")
def search(asked: StrokeRequest) -> GlobalSearch:
    return GlobalSearch(asked)


@pytest.mark.parametrize("pinned", [False, True])
def test_a_solution_is_admissible(asked: StrokeRequest, search: GlobalSearch, pinned: bool) -> None:
    solution = search.solve(pinned=pinned)
    robot, task, options = asked.cell.robot, asked.task, asked.cell.options
    at = asked.cell.postures.at(solution.q)
    assert off_task(robot, task, solution.q, asked.goals) < 1e-9
    assert ((solution.q >= robot.limits.lower) & (solution.q <= robot.limits.upper)).all()
    assert asked.cell.clearances.query(solution.q).distance.min() >= options.safety_margin_m
    assert (np.abs(at.joint_torque) <= robot.limits.torque).all()
    steps = options.step_share * robot.limits.velocity * np.diff(asked.times)[:, None]
    assert (np.abs(np.diff(solution.q, axis=0)) <= steps + 0.5 * options.chart_spacing).all()
    np.testing.assert_allclose(solution.value, np.linalg.norm(at.guardrail_torque, axis=1))
    if pinned:
        np.testing.assert_allclose(solution.q[0], asked.state.posture, atol=1e-12)


def test_arms_that_weigh_otherwise_share_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same to the last bit as charts of their own; those of another tool path or arm are others."""
    drawn, draw = list[object](), SelfMotionSampler.along

    def along(sampler: SelfMotionSampler, *arguments: Any) -> list[FloatArray]:
        drawn.append(sampler)
        return draw(sampler, *arguments)

    def searched(**changes: object) -> GlobalSearch:
        return GlobalSearch(sliding(**changes))

    monkeypatch.setattr(SelfMotionSampler, "along", along)
    own = searched(robot={"payload_kg": 2.0})
    sampling._SAMPLER_CACHE.clear()
    light, shared = searched(), searched(robot={"payload_kg": 2.0})
    # The speed counts as little; so does how it rounds the via-points' times.
    searched(tool_path={"legs": [{"by": [0, -0.3, 0], "seconds": 4.4}]})
    assert len(drawn) == 2
    assert shared.lower_bound.value == own.lower_bound.value != light.lower_bound.value
    for pinned in (False, True):
        np.testing.assert_array_equal(shared.solve(pinned=pinned).q, own.solve(pinned=pinned).q)
    searched(robot={"tool_length_m": 0.2})
    searched(tool_path={"legs": [{"by": [0, -0.29, 0], "seconds": 4}]})
    assert len(drawn) == 4
    monkeypatch.setattr(sampling, "_MAX_KEPT_CHARTS", 2)
    searched(planner={"chart_seeds": 40})
    assert len(sampling._SAMPLER_CACHE) == 2
    # Long paths would fill the memory.
    monkeypatch.setattr(sampling, "_MOST_KEPT", 10)
    searched(planner={"chart_seeds": 41})
    assert not any(41 in key for key in sampling._SAMPLER_CACHE)


def test_freedom_never_costs_torque(search: GlobalSearch) -> None:
    free, pinned = search.solve(pinned=False).peak, search.solve(pinned=True).peak
    assert search.lower_bound.value - search.lower_bound.error <= free <= pinned


def test_the_bound_is_below_what_random_postures_ask(asked: StrokeRequest, search: GlobalSearch) -> None:
    """No admissible posture at its via-point, found by other random seeds, is below the bound."""
    finer = GlobalSearch(asked.with_options(chart_spacing=0.05, chart_seeds=500)).lower_bound
    bound = search.lower_bound
    assert finer.value >= bound.value - bound.error - 1e-9
    assert bound.value == pytest.approx(finer.value, rel=1e-4)
    assert bound.value == bound.each[bound.via_point] == bound.each.max()


@settings(max_examples=4)
@given(
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.3, 0.1), st.floats(-0.1, 0.15)).filter(
        lambda by: np.linalg.norm(by) > 0.05
    )
)
def test_no_plan_rests_below_the_bound(by: tuple[float, float, float]) -> None:
    scene = short_scene(tool_path={"legs": [{"by": list(by), "seconds": 6}], "via_points": 6})
    try:
        fixed = plan(scene)
    except PlanningError:
        return
    bound = GlobalSearch(request_of(scene, knots="sliding")).lower_bound
    static = Dynamics(fixed.robot).static_efforts(fixed.trajectory.q).guardrail_torque
    assert np.linalg.norm(static, axis=1).max() >= bound.value - bound.error


WALL = {"name": "wall", "box": [2.5, 0.1, 2.5], "xyz": [1.85, 0.5, -2.06]}
FAR = {"legs": [{"by": [0, 0, -2.5], "seconds": 60}]}


@pytest.mark.parametrize(
    ("changes", "message", "first"),
    [
        (
            {"obstacles": [WALL]},
            r"through via-point \d of 8: of \d+ postures .* come within the safety margin, most often",
            False,
        ),
        ({"tool_path": FAR}, r"blocked: out of reach: no posture .* there \(proven\)", False),
        (
            {"robot": {"payload_kg": 60.0}},
            r"too much of a joint's torque, most often of joint_\d and \d{3}% at best, ",
            True,
        ),
    ],
)
def test_a_blocked_via_point_is_named_with_its_reason(changes: Any, message: str, first: bool) -> None:
    with pytest.raises(PathNotFound, match=message) as caught:
        GlobalSearch(sliding(**changes))
    assert 0 <= caught.value.progress < 1
    assert (caught.value.progress == 0) == first


def test_joints_that_are_too_slow_are_named() -> None:
    slow = {"legs": [{"by": [0, -0.6, 0], "seconds": 0.3}], "via_points": 5}
    search = GlobalSearch(sliding(tool_path=slow, planner={"chart_spacing": 0.1}))
    expected = r"as far as .* found, are .* times too far from those before for the velocity of joint_\d$"
    with pytest.raises(PathNotFound, match=expected) as caught:
        search.solve(pinned=True)
    # So much slower, the next via-point is reached.
    assert caught.value.pace > 1
    assert f"are {caught.value.pace:.3g} times too far" in str(caught.value)
    slow["legs"][0]["seconds"] *= 1.01 * caught.value.pace
    assert search._is_too_far(2, caught.value.pace) == (caught.value.pace > 2)
    search = GlobalSearch(sliding(tool_path=slow, planner={"chart_spacing": 0.1}))
    try:
        search.solve(pinned=True)
    except PathNotFound as later:
        assert later.progress > caught.value.progress


def test_charts_get_no_denser_where_joints_are_far_too_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """What charts miss is within their spacing of what they have."""
    slow = {"legs": [{"by": [0, -0.6, 0], "seconds": 0.3}], "via_points": 5}
    search = GlobalSearch(sliding(tool_path=slow, planner={"chart_spacing": 0.1}))
    sampler = search._sampler
    assert sampler.spacing_after(0) == sampler.spacing
    assert sampler.spacing_after(2) == pytest.approx(sampler.spacing / 16)
    monkeypatch.setattr(sampler, "refined", None)
    monkeypatch.setattr(sampler, "spacing_after", lambda rounds: 1e-3)
    with pytest.raises(PathNotFound, match="too far from those before"):
        search.solve(pinned=False)
    assert not search._is_too_far(2, 1.0)


@pytest.fixture(scope="module", params=["axis", "position"])
def freer(request: pytest.FixtureRequest) -> tuple[StrokeRequest, GlobalSearch]:
    wide = sliding(tool_path={"keep": request.param})
    return wide, GlobalSearch(wide)


@pytest.mark.parametrize("pinned", [False, True])
def test_wide_self_motions(
    search: GlobalSearch, freer: tuple[StrokeRequest, GlobalSearch], pinned: bool
) -> None:
    """More freedom costs nothing, and what is done about coarse charts keeps everything that was asked."""
    wide, wider = freer
    solution = wider.solve(pinned=pinned)
    test_a_solution_is_admissible(wide, wider, pinned)
    assert solution.peak <= search.solve(pinned=pinned).peak + 1e-9
    if not pinned:
        assert solution.peak <= wider.lower_bound.value * (1 + 2e-3)


def test_refining_never_raises_the_peak() -> None:
    asked = sliding(tool_path={"keep": "axis"})
    robot, task, postures = asked.cell.robot, asked.task, asked.cell.postures
    sequences = sequences_beside(asked, asked.state.posture, 0, 0.3)
    q = np.stack([each[0] for each in sequences])
    np.testing.assert_array_equal(q[0], asked.state.posture)
    for each, goal in zip(sequences, asked.goals, strict=True):
        assert len(each) > 20
        assert off_task(robot, task, each, goal) < 1e-9
    steps = np.full((len(q) - 1, 7), 0.3)
    before = asked.cell.objective.at_rest(postures.at(q)).max()
    for stays in (True, False):
        better = refine(asked, q, steps, 0.3, 0.0, np.zeros(7, dtype=bool), start_stays=stays)
        assert off_task(robot, task, better, asked.goals) < 1e-9
        assert (np.abs(np.diff(better, axis=0)) <= steps).all()
        assert asked.cell.clear(better).all()
        peak = asked.cell.objective.at_rest(postures.at(better)).max()
        assert peak <= before
        assert (peak < before - 10) != stays
        assert (better[0] == q[0]).all() == stays


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> StrokeRequest:
    """A UR5, whose joints can turn twice, with joint 4 one turn on."""
    path = {"keep": "pose", "legs": [{"by": [0.06, -0.05, -0.02], "seconds": 5}], "via_points": 6}
    folder = tmp_path_factory.mktemp("ur5")
    return request_of(six_joint_scene(folder, "ur5", [-105, -76, -94, 84 - 360, 48, -61], path))


def test_joints_that_can_turn_twice(turned: StrokeRequest) -> None:
    """One turn of the chart stands for all; a sequence begins on the turn of the scene's posture."""
    limits, search = turned.cell.robot.limits, GlobalSearch(turned)
    pinned, free = search.solve(pinned=True), search.solve(pinned=False)
    np.testing.assert_allclose(pinned.q[0], turned.state.posture, atol=1e-9)
    for solution in (pinned, free):
        assert ((solution.q >= limits.lower) & (solution.q <= limits.upper)).all()
        assert off_task(turned.cell.robot, turned.task, solution.q, turned.goals) < 1e-9
        assert np.abs(np.diff(solution.q, axis=0)).max() < 1.0
    everywhere, same = search._on_all_turns(3)
    assert len(same) > len(search.first_chart.q)
    for got, expected in ((everywhere.solve(pinned=True), pinned), (everywhere.solve(pinned=False), free)):
        assert got.peak == pytest.approx(expected.peak, rel=1e-12)
    # Where a range ends between two turns the sequence takes one that stays within.
    narrow = replace(turned.cell.robot.limits, upper=limits.upper - 2 * np.pi * (np.arange(6) == 3))
    within = GlobalSearch(
        replace(turned, cell=replace(turned.cell, robot=replace(turned.cell.robot, limits=narrow)))
    ).solve(pinned=False)
    assert (within.q <= narrow.upper).all()


def test_a_way_that_is_narrower_than_the_charts_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only what is next to a sequence between the charts' postures counts as clear."""
    asked = sliding(planner={"chart_spacing": 0.5})
    q = GlobalSearch(asked).solve(pinned=False).q
    null = null_space(asked.cell.postures, asked.task, q)[:, 0]
    # The directions of neighbours agree.
    null *= np.cumprod(np.sign(np.append(1.0, (null[1:] * null[:-1]).sum(axis=1))))[:, None]
    narrow, reached = project_onto_task(asked.cell.postures, asked.task, q + 0.2 * null, asked.goals)
    assert reached.all()

    query = asked.cell.clearances.query

    def narrowly(some: FloatArray, below: float | None = None) -> Smallest:
        blocked = np.linalg.norm(some[:, None] - narrow, axis=2).min(axis=1) > 0.05
        found = query(some, below)
        return found if below is None else found._replace(distance=np.where(blocked, -np.inf, np.inf))

    monkeypatch.setattr(asked.cell.clearances, "query", narrowly)
    assert GlobalSearch(asked).solve(pinned=False).peak > 0
    monkeypatch.setattr(global_search, "_REFINEMENTS", 0)
    with pytest.raises(PathNotFound, match=r"no way was found .* of \d+ postures that were tried"):
        GlobalSearch(asked).solve(pinned=False)


def test_what_is_asked_again_is_not_searched_again(
    asked: StrokeRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, tried = GlobalSearch(asked), list[object]()
    real = GlobalSearch._solve

    def solve(self: GlobalSearch, *arguments: Any) -> Any:
        tried.append(arguments)
        return real(self, *arguments)

    monkeypatch.setattr(GlobalSearch, "_solve", solve)
    starts = np.ones(len(search.first_chart.q), dtype=np.bool_)
    found = [search.solve(pinned=pinned, starts=some) for pinned in (False, True) for some in (None, starts)]
    again = [search.solve(pinned=pinned, starts=some) for pinned in (False, True) for some in (None, starts)]
    assert [a is b for a, b in zip(found, again, strict=True)] == 4 * [True]
    assert len(tried) == 4
    assert search.halved().solve(pinned=True) is not found[2]
    search._chart(search._each)
    assert search.solve(pinned=True) is not found[2]
    np.testing.assert_array_equal(search.solve(pinned=True).q, found[2].q)


def test_denser_charts_keep_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound is found again only where they hold a posture below it, which shows that it was none."""
    search, found = GlobalSearch(sliding(planner={"chart_spacing": 0.5})), list[float]()
    bound, before = search.lower_bound, len(search._each[3])

    def find(*arguments: Any) -> tuple[LowerBound, FloatArray]:
        lower, posture = find_lower_bound(*arguments)
        found.append(lower.value)
        return lower, posture

    monkeypatch.setattr(global_search, "find_lower_bound", find)
    layers, edges = search._layers, search._edges
    assert search._refine(search._each, 3)
    search._chart(search._each)
    assert len(search._each[3]) > before
    # What is known of the charts that stay, and of the edges that lead there, is kept.
    assert [a is b for a, b in zip(layers, search._layers, strict=True)] == [
        k not in range(1, 6) for k in range(8)
    ]
    monkeypatch.setattr(search._request.cell.clearances, "query", None)
    anew = edges_along(search._layers, search._steps, search._winding)
    for got, expected in zip(search._edges, anew, strict=True):
        np.testing.assert_array_equal(got.before, expected.before)
    assert len(search._edges[3].before) > len(edges[3].before)
    monkeypatch.undo()
    monkeypatch.setattr(global_search, "find_lower_bound", find)
    assert search.lower_bound is bound
    assert not found
    search._bound = search.lower_bound = replace(bound, value=2 * bound.value, error=0.0)
    search._chart(search._each)
    assert search.lower_bound.value == pytest.approx(bound.value, rel=1e-5)
    assert found
