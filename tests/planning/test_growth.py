"""Everything grows in proportion to the path, and what is done for that changes no answer."""

from dataclasses import replace

import growth
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import sparse
from small_scenes import problem_of, request_of, short_scene

from cmbot.common.errors import SceneError
from cmbot.common.installation import install_command
from cmbot.planning import plan, precheck
from cmbot.planning.postures.projection import TangentPredictor, project_onto_task
from cmbot.planning.precheck import MOST_UNKNOWNS, oversized, precheck_scene
from cmbot.planning.request import StrokeRequest, strokes_of
from cmbot.planning.selfmotion import charts as self_motion
from cmbot.planning.selfmotion.charts import GraphLayer, check_clearances
from cmbot.planning.selfmotion.dynamic_programming import BottleneckDynamicProgram, edges, edges_along
from cmbot.planning.selfmotion.global_search import GlobalSearch
from cmbot.planning.torque.decomposition import optimise
from cmbot.planning.workcell.workcell import robot_of
from cmbot.robot import Finding, Postures, Robot
from cmbot.scene import Scene
from cmbot.trajectory.local_basis import SparseSplines
from cmbot.trajectory.spline_space import SplineSpace

# Four times the via-points, and a tenth more for what the ends lack.
FEW, MANY, RATIO = 50, 200, 4.4


@pytest.fixture(scope="module")
def asked() -> StrokeRequest:
    return request_of(short_scene(), knots="sliding")


@pytest.fixture(scope="module")
def stage(asked: StrokeRequest) -> GlobalSearch:
    return GlobalSearch(asked)


def test_matrices_grow_in_proportion(cmbot_robot: Robot) -> None:
    def entries(n: int) -> np.ndarray:
        space = SplineSpace(np.linspace(0.0, 0.4 * n, n))
        local = SparseSplines(space, cmbot_robot.limits)
        rows = local.rows(np.linspace(0.0, 0.4 * n, 10 * n))
        matrices = (space.basis, space.cardinal, space.jerk_gram, local.columns, local.gram)
        assert all(sparse.issparse(matrix) for matrix in matrices)
        return np.array([*(matrix.nnz for matrix in matrices), rows.weight.size])

    assert (entries(MANY) <= RATIO * entries(FEW)).all()


def test_edges_grow_in_proportion_and_are_all_there_are(stage: GlobalSearch) -> None:
    """Of postures that are not known to be inadmissible, and to which some lead: the others lead nowhere."""

    def pairs(reachable: np.ndarray, before: np.ndarray, after: np.ndarray) -> set[tuple[int, int]]:
        return {(int(i), int(j)) for j, i in np.argwhere(reachable.T & before & after[:, None])}

    led_to = np.ones(len(stage.first_chart.q), dtype=np.bool_)
    for a, b, step, found in zip(stage._layers, stage._layers[1:], stage._steps, stage._edges, strict=False):
        reachable = (np.abs(a.chart.q[:, None] - b.chart.q) <= step).all(axis=2)
        got = set(zip(found.before.tolist(), found.after.tolist(), strict=True))
        assert len(got) == len(found.before)
        # Some may have turned out to be too near since.
        assert pairs(reachable, a.admissible & led_to, b.admissible) <= got
        assert led_to[found.before].all()
        led_to = np.isin(np.arange(len(b.chart.q)), found.after)
        might_do = ((node.chart.within & (node.chart.joint_use <= 1.0)) for node in (a, b))
        assert got <= pairs(reachable, *might_do)
        # A chart is a curve: a posture has a few neighbours, however long the curve is.
        assert len(found.before) < 20 * len(a.chart.q)


def test_behind_a_gap_there_are_no_edges(stage: GlobalSearch) -> None:
    """What none leads to need not lead anywhere: charts that were made dense about a gap have many pairs."""
    steps = stage._steps.copy()
    steps[2] = 1e-9
    found = edges_along(stage._layers, steps, stage._winding)
    np.testing.assert_array_equal(found[1].after, stage._edges[1].after)
    assert len(found[2].after) == len(found[3].after) == 0


def test_edges_of_shorter_steps_are_those_left_of_longer_ones(stage: GlobalSearch) -> None:
    half = stage.halved()
    anew = edges_along(half._layers, half._steps, half._winding)
    assert sum(len(each.before) for each in anew) > 0
    for found, expected in zip(half._edges, anew, strict=True):
        assert found.number == expected.number
        for name in ("before", "after", "length"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@given(st.integers(0, 2**32 - 1), st.integers(0, 30), st.integers(0, 30))
def test_edges_go_round_where_joints_do(seed: int, some: int, others: int) -> None:
    rng = np.random.default_rng(seed)
    endless = np.array([True, False, True])
    q_a, q_b = rng.uniform(-10, 10, (some, 3)), rng.uniform(-10, 10, (others, 3))
    step = rng.uniform(0.5, 4.0, 3)
    moves = q_a[:, None] - q_b
    moves[..., endless] -= 2 * np.pi * np.round(moves[..., endless] / (2 * np.pi))
    expected = np.argwhere((np.abs(moves) <= step).all(axis=2).T)
    found = edges(q_a, q_b, step, endless)
    np.testing.assert_array_equal(np.stack([found.after, found.before], axis=1), expected)
    length = ((moves[found.before, found.after] / step) ** 2).sum(axis=1)
    np.testing.assert_allclose(found.length, length, rtol=1e-12, atol=1e-12)
    cost = rng.integers(0, 5, len(found.before)).astype(float)
    least, which = found.smallest(cost)
    np.testing.assert_array_equal(found.least(cost), least)
    for k in range(others):
        mine = np.flatnonzero(found.after == k)
        assert least[k] == cost[mine].min(initial=np.inf)
        if len(mine):
            assert which[k] == mine[cost[mine].argmin()]


def test_the_best_sequence_is_the_same_when_all_clearances_are_computed() -> None:
    """Near a post many postures of the best sequences come too near, so several rounds are needed."""
    post = {"name": "post", "box": [0.1, 0.1, 1.5], "xyz": [1.15, 0.75, -1.8]}
    scene = short_scene(obstacles=[post])
    asked = request_of(scene, knots="sliding")
    stage = GlobalSearch(asked)
    eagerly = [GraphLayer(asked.cell, node.chart) for node in stage._layers]
    check_clearances(eagerly, [node.admissible for node in eagerly])
    assert any(node.too_near.any() for node in eagerly)
    for every in (1, 2, 3):
        starts = np.arange(len(stage.first_chart.q)) % every == 0
        best = [
            BottleneckDynamicProgram(asked, layers, stage._edges, starts).best()
            for layers in ([GraphLayer(asked.cell, node.chart) for node in stage._layers], eagerly)
        ]
        assert best[0] == best[1], every


def test_charts_evaluated_one_by_one_are_the_same(
    stage: GlobalSearch, asked: StrokeRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    each = [node.chart.q for node in stage._layers]
    monkeypatch.setattr(self_motion, "_CHARTS_PER_BATCH", 1)
    again = self_motion.charts_of(asked.cell, each)
    for node, chart in zip(stage._layers, again, strict=True):
        np.testing.assert_allclose(chart.value, node.chart.value, rtol=1e-13)
        np.testing.assert_allclose(chart.joint_use, node.chart.joint_use, rtol=1e-11, atol=1e-12)


def test_the_predictor_is_the_first_step_of_a_projection(stage: GlobalSearch, asked: StrokeRequest) -> None:
    postures, task = Postures(asked.cell.robot), asked.task
    goals = task.path.poses(asked.times)
    q = stage._layers[0].chart.q
    predictor = TangentPredictor.of(postures, task, q, goals[0])
    first, _ = project_onto_task(postures, task, q, goals[1], steps=1)
    np.testing.assert_allclose(predictor.towards(goals[1]), first, atol=1e-8)


def test_longer_paths_do_not_take_many_more_steps() -> None:
    pytest.importorskip("piqp")

    def iterations(via_points: int) -> int:
        optimised = optimise(problem_of(growth.sweep(via_points)))
        return sum(report.iterations for report in optimised.passes)

    assert iterations(150) <= 2 * iterations(50) + 5


def large(via_points: int, **options: object) -> Scene:
    scene = growth.sweep(via_points)
    return scene.with_options(**options)


def too_large(via_points: int, **options: object) -> Finding | None:
    scene = large(via_points, **options)
    return oversized(strokes_of(scene, robot_of(scene))[0], 7, scene.planner)


def test_slsqp_refuses_what_would_take_it_hours() -> None:
    scene = large(2000, solver="slsqp")
    with pytest.raises(
        SceneError, match=r"via_points: got 2000 with solver: slsqp.* at most 378, .*solver: sqp"
    ):
        plan(scene)
    assert [found.key for found in precheck_scene(scene).warnings] == ["tool_path.via_points"]
    for knots, most in (("sliding", 378), ("fixed", 432)):
        assert too_large(most, solver="slsqp", knots=knots) is None
        assert f"at most {most}," in too_large(most + 1, solver="slsqp", knots=knots).expected
    assert MOST_UNKNOWNS == 3000


def test_long_paths_take_the_sparse_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it, it is said how to get it."""
    with monkeypatch.context() as without:
        without.setattr(precheck, "solver_of", lambda _: "slsqp")
        without.setattr(precheck.importlib.util, "find_spec", lambda _: None)
        assert install_command("fast") in too_large(1000, solver="auto").expected
    pytest.importorskip("piqp")
    assert too_large(2000, solver="sqp") is None


def test_costs_are_tabled_with_their_exponents() -> None:
    some = growth.Costs(
        via_points=50,
        path=20,
        global_stage=1,
        optimisation=2,
        certificate=3,
        memory=100,
        iterations=5,
        peak=380,
    )
    more = replace(some, via_points=200, optimisation=8, memory=100, global_stage=16)
    assert growth.exponent(some, more, "optimisation") == pytest.approx(1.0)
    assert growth.exponent(some, more, "global_stage") == pytest.approx(2.0)
    assert growth.table_of([some, more]).row_count == 3
    assert growth.peak_memory() > 10
