"""Walking: the robot on either foot, what steps ask, a certified step, and refusals."""

import csv
import json
import re
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from small_scenes import short_scene
from walks import ARM_DEG, CLAMP, COUNTERWEIGHT_DEG, feet, one_step, scene_on_two_feet as scene_at

import cmbot
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PlanningError, SceneError
from cmbot.planning import Deadline, FreeSpace
from cmbot.robot import Climber, Kinematics, Robot, load_climbing_robot
from cmbot.scene import FootholdFile, Scene, StanceFile
from cmbot.stances import Candidate, places_of
from cmbot.stances.walking import (
    Walk,
    WalkOptions,
    goal_stance,
    load_goal,
    stance_of,
    walk,
    walk_csv,
    walk_data,
    walk_samples,
)
from cmbot.stances.walking.balance import Balance, Roadmap
from cmbot.stances.walking.route import Edge, Route, nodes_between
from cmbot.stances.walking.steps import plan_step, swinging_robot
from cmbot.stances.walking.walk import _cause, _Search
from cmbot.views import walk_page
from cmbot.views.overview.guardrail_map import guardrail_map


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_at(4.04, 4.44, CLAMP)


@pytest.fixture(scope="module")
def balance(scene: Scene) -> Balance:
    return Balance(scene, np.array(scene.posture))


@pytest.fixture(scope="module")
def node(scene: Scene) -> Candidate:
    return stance_of(scene)


@pytest.fixture(scope="module")
def walked() -> Walk:
    return one_step()


def test_a_step_is_the_same_on_a_slow_machine(walked: Walk, monkeypatch: pytest.MonkeyPatch) -> None:
    """On one whose every look at the clock takes an hour, while trees seek the way."""
    (step,), straight = walked.steps, FreeSpace.straight
    (whole,) = (move.segment.trajectory.q[[0, -1]] for move in step.moves if move.kind == "swing")

    def but_the_whole(space: FreeSpace, start: FloatArray, end: FloatArray) -> bool:
        return not np.allclose([start, end], whole) and straight(space, start, end)

    def planned() -> list[FloatArray]:
        arm = np.radians(COUNTERWEIGHT_DEG)
        moves = plan_step(walked.scene, step.before, step.after, step.foot, arm, walked.speed)
        return [move.segment.trajectory.q for move in moves]

    monkeypatch.setattr(FreeSpace, "straight", but_the_whole)
    quick = planned()
    hours = (3600.0 * k for k in count())
    monkeypatch.setattr(Deadline.__init__, "__defaults__", (np.inf, hours.__next__, None, ""))
    for one, other in zip(quick, planned(), strict=True):
        np.testing.assert_array_equal(one, other)
    assert next(hours) > 3600.0


def test_on_foot_2_it_is_the_same_robot() -> None:
    arm, rng = np.radians(ARM_DEG), np.random.default_rng(1)
    one, two = (load_climbing_robot(foot, np.eye(4), arm, payload=3.0) for foot in (1, 2))
    assert two.joints == one.joints[::-1]
    assert two.mass == pytest.approx(one.mass)
    for q in rng.uniform(-1, 1, (4, 5)):
        X = Kinematics(one).tool_pose(q).homogeneous
        np.testing.assert_allclose(X, Climber().poses(q)[0], atol=1e-9)
        back = Kinematics(two).tool_pose(q[::-1]).homogeneous
        np.testing.assert_allclose(back, np.linalg.inv(X), atol=1e-9)
        centres = [
            (robot.arm_mass * pin.centerOfMass(robot.model, robot.model.createData(), posture.copy())
             + robot.carrier_mass * robot.model.inertias[0].lever) / robot.mass
            for robot, posture in ((one, q), (two, q[::-1]))
        ]  # fmt: skip
        np.testing.assert_allclose(X[:3, :3] @ centres[1] + X[:3, 3], centres[0], atol=1e-9)


@pytest.mark.parametrize("foot", [1, 2])
def test_what_holding_on_to_a_foot_asks(scene: Scene, node: Candidate, balance: Balance, foot: Any) -> None:
    """Against the whole robot's inverse dynamics."""
    load, goes = balance.step_load(node, foot), 2 if foot == 1 else 1
    for k in (0, 17):
        robot = swinging_robot(scene, node, goes, balance.arms[k])
        effort, needed, share = asked_at_rest(robot, node.climber if foot == 1 else node.climber[::-1])
        assert load.effort[k] == pytest.approx(effort, rel=1e-6)
        assert load.adhesion[k] == pytest.approx(needed, rel=1e-6)
        assert load.use[k] == pytest.approx(max(share, effort), rel=1e-6)


@pytest.mark.parametrize("foot", [1, 2])
def test_what_a_straight_swing_asks_of_the_foot_that_holds(
    scene: Scene, node: Candidate, balance: Balance, foot: Any
) -> None:
    """Against the whole robot's inverse dynamics, at sixths of the way."""
    goes, held = 2 if foot == 1 else 1, node.stance.places[foot - 1]
    nodes = nodes_between(scene, node, stance_of(scene_at(4.34, 4.74, CLAMP)), 0.3)
    others = (each for each in nodes if each.stance.places[foot - 1] == held)
    after = max(others, key=lambda each: float(np.abs(each.climber - node.climber).max()))
    way = np.array([(1 - k / 6) * node.climber + k / 6 * after.climber for k in range(1, 6)])
    use, larger = balance.swing_use(node, after, foot), 0
    for k in (0, 17, 40):
        robot = swinging_robot(scene, node, goes, balance.arms[k])
        asked = max(max(asked_at_rest(robot, q)[::2]) for q in (way if foot == 1 else way[:, ::-1]))
        assert use[k] == pytest.approx(asked, rel=1e-6)
        larger += asked > max(balance.step_load(each, foot).use[k] for each in (node, after))
    assert larger


def asked_at_rest(robot: Robot, q: FloatArray) -> tuple[float, float, float]:
    """Share of efforts, adhesion needed, N, and share of what the foot holds; a clamp needs no adhesion."""
    data, q = robot.model.createData(), q.copy()
    torque = pin.computeGeneralizedGravity(robot.model, data, q)
    centre = pin.centerOfMass(robot.model, data, q)
    weight = robot.arm_mass * robot.model.gravity.linear
    wrench = np.hstack([weight, np.cross(centre - robot.foot_point, weight)])[None]
    needed = robot.holding.each(wrench)[0, 0] if robot.holding.adhesive else 0.0
    return np.abs(torque / robot.limits.torque).max(), needed, robot.holding.share(wrench)[0][0]


def test_a_step_is_certified(walked: Walk) -> None:
    """Places, speed and the lift along the face's normal, sampled from the trajectories."""
    (step,) = walked.steps
    assert [move.kind for move in step.moves] == ["lift", "swing", "set"]
    ends, places = [], (step.before.root, step.after.root)
    for move in step.moves:
        assert move.segment.certificate.holds
        assert {"tool speed"} < {check.quantity for check in move.segment.certificate.checks}
        t = np.linspace(0.0, move.segment.duration, 200)
        q, v = move.segment.trajectory.states(t)[:2]
        p, J = Kinematics(move.robot).tool_point_jacobians(q)
        assert np.linalg.norm(np.einsum("kij,kj->ki", J, v), axis=1).max() <= 0.03
        ends += [p[0], p[-1]]
        if move.kind != "swing":
            place = places[0 if move.kind == "lift" else 1]
            aside = (p - place[:3, 3]) @ place[:3, [0, 2]]
            assert np.abs(aside).max() < 2e-3
    np.testing.assert_allclose(ends[0], places[0][:3, 3], atol=1e-6)
    np.testing.assert_allclose(ends[-1], places[1][:3, 3], atol=1e-6)
    np.testing.assert_allclose(ends[1:-1:2], ends[2::2], atol=1e-6)
    assert walked.seconds > 0.11 / 0.03


def test_a_walk_as_files(walked: Walk) -> None:
    rows = [*csv.DictReader(walk_csv(walked).splitlines())]
    assert {row["holds"] for row in rows} == {"2"}
    assert float(rows[-1]["t"]) == pytest.approx(walked.seconds, rel=1e-5)
    for row, node in ((rows[0], walked.steps[0].before), (rows[-1], walked.goal)):
        place = [float(row[f"foot_1_{axis}"]) for axis in "xyz"]
        np.testing.assert_allclose(place, node.root[:3, 3], atol=1e-6)
        assert row["share_1"] == ""
        assert 0 < float(row["share_2"]) <= 1
    data = json.loads(json.dumps(walk_data(walked)))
    assert data["steps"][0]["to"] == "top_rail at 4.09 m (outer)"
    page = walk_page(walked)
    assert '<a href="replay.html">replay</a>' in page
    assert "<script" not in page
    assert "http://" not in page
    assert page.count("<circle") == 3
    assert "1 step and 0 moves of the arm" in page


def test_the_map_shows_what_is_on_the_rail() -> None:
    on_rail = {"name": "lamp", "cylinder": [0.05, 0.2], "xyz": [0.6, 0.0, 0.15]}
    beside = {"name": "tank", "sphere": 0.2, "xyz": [0.6, 0.9, 0.0]}
    samples = list(walk_samples(one_step()))
    drawn = guardrail_map(scene_at(4.04, 4.44, CLAMP, obstacles=[on_rail, beside]), samples)
    assert "lamp" in drawn
    assert "tank" not in drawn
    # 0.1 m wide and 0.2 m high.
    width, height = (
        float(x) for x in re.search(r'width="([\d.]+)" height="([\d.]+)"[^>]*><title>lamp', drawn).groups()
    )
    assert height == pytest.approx(2 * width, rel=0.01)


def test_a_foot_keeps_clear_of_joints_and_lamps(scene: Scene) -> None:
    near_post = FootholdFile(member="top_rail", along_m=3.45)
    assert scene.in_the_way(near_post) == "post_3"
    assert scene.in_the_way(FootholdFile(member="top_rail", along_m=3.9)) is None
    lamp = {"name": "lamp", "cylinder": [0.05, 0.2], "xyz": [0.4, 0.15, 0.0]}
    lit = scene_at(4.04, 4.44, CLAMP, obstacles=[lamp])
    assert lit.in_the_way(FootholdFile(member="top_rail", along_m=3.9)) == "lamp"
    places = {(each.member, each.along_m) for each in places_of(lit, 0.1)}
    assert places < {(each.member, each.along_m) for each in places_of(scene, 0.1)}


def test_ends_beside_a_post_are_refused_before_the_search() -> None:
    """A foot is neither set where a post is in the way, nor lifted there; it may stay there."""

    class Searched(Exception):
        pass

    def progress(_step: str, _share: float) -> None:
        raise Searched

    free, beside = scene_at(3.15, 3.65, CLAMP), scene_at(3.15, 3.45, CLAMP)
    elsewhere = scene_at(3.05, 3.45, CLAMP)
    stance = StanceFile.model_validate(feet(3.15, 3.45))
    for start, to, told in (
        (free, stance, r"^cmbot\.walk: to\.foot_2: got a place beside post_3, expected a free one"),
        (free, beside, r"guardrail\.stance\.foot_2: got a place beside post_3"),
        (beside, free, r"guardrail\.stance\.foot_2: got a place beside post_3"),
    ):
        with pytest.raises(SceneError, match=told):
            walk(start, to, progress=progress)
    with pytest.raises(Searched):
        walk(beside, elsewhere, progress=progress)


def test_the_route_has_only_steps_that_hold(scene: Scene, node: Candidate, balance: Balance) -> None:
    goal = stance_of(scene_at(4.34, 4.74, CLAMP))
    route = Route(nodes_between(scene, node, goal, 0.6), balance)
    edges = route.shortest(0)
    assert edges is not None
    assert (edges[0].before, edges[-1].after) == (0, 1)
    for edge in edges:
        holds = 2 if edge.foot == 1 else 1
        weights = route.counterweights(edge, -1)
        assert len(weights)
        assert (route.use[holds][[edge.before, edge.after]][:, weights] <= 0.9).all()
    for edge in edges:
        route.close(edge)
    assert route.shortest(0) != edges


def test_the_straight_swing_of_a_step_has_to_hold(
    scene: Scene, node: Candidate, balance: Balance, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until it is taken in again, as it may go another way."""
    route = Route(nodes_between(scene, node, stance_of(scene_at(4.34, 4.74, CLAMP)), 0.6), balance)
    edge = route.shortest(0)[0]
    weights = route.counterweights(edge, -1)
    asked = np.where(np.arange(len(balance.arms)) == weights[-1], 0.5, 2.0)
    monkeypatch.setattr(balance, "swing_use", lambda *_: asked)
    assert route.swings(edge)
    assert route.counterweights(edge, -1).tolist() == [weights[-1]]
    route.reopen([edge])
    asked = np.full(len(asked), 0.91)
    assert not route.swings(edge)
    assert len(route.counterweights(edge, -1)) == 0
    assert edge not in (route.shortest(0) or [])
    route.reopen([edge])
    np.testing.assert_array_equal(route.counterweights(edge, -1), weights)


class Graph:
    """A route over a graph given by its edges, each as dear as the others."""

    def __init__(self, *edges: tuple[int, int]) -> None:
        self.edges = {*edges, *((b, a) for a, b in edges)}

    def shortest(self, start: int) -> list[Edge] | None:
        ways, seen = [[start]], {start}
        for way in ways:
            if way[-1] == 1:
                return [Edge(before=a, after=b, foot=1) for a, b in pairwise(way)]
            ahead = sorted(b for a, b in self.edges if a == way[-1] and b not in seen)
            seen |= set(ahead)
            ways += [[*way, b] for b in ahead]
        return None

    def swings(self, edge: Edge) -> bool:
        return (edge.before, edge.after) in self.edges

    def close(self, edge: Edge) -> None:
        self.edges -= {(edge.before, edge.after), (edge.after, edge.before)}


class Steps(_Search):
    """The search with steps that are made at once, but some that are impossible."""

    def __init__(
        self, graph: Graph, impossible: set[tuple[int, int]], vain: tuple[tuple[int, int], ...] = ()
    ) -> None:
        super().__init__(None, None, graph, np.zeros(7), WalkOptions(), lambda _step, _share: None)
        self.impossible, self.vain, self.tried = impossible, vain, 0

    def _passes(self, edge: Edge) -> bool:
        return (edge.before, edge.after) not in self.vain

    def _step(self, edge: Edge) -> Any:
        self.tried += 1
        if (edge.before, edge.after) in self.impossible:
            self.failures.append("impossible")
            return None
        self.arm, self._weight = self.arm + 1.0, edge.after
        return edge.before, edge.after

    def _check(self, k: int) -> None:
        self._possible[k] = np.ones(0, dtype=np.bool_)


def test_steps_that_lead_nowhere_are_not_walked() -> None:
    """What leads on from where the walk was before is taken from there, with the arm as it was."""
    search = Steps(Graph((0, 2), (2, 3), (3, 4), (4, 1), (2, 5), (5, 6), (6, 7), (7, 1)), {(4, 1)})
    assert search.steps() == [(0, 2), (2, 5), (5, 6), (6, 7), (7, 1)]
    assert search.tried == 8
    assert search.arm[0] == 5.0
    assert search._weight == 1


def test_no_step_is_made_on_a_way_on_which_a_swing_is_impossible() -> None:
    edges = (0, 2), (2, 3), (3, 4), (4, 1), (2, 5), (5, 6), (6, 7), (7, 1)
    search = Steps(Graph(*edges), set(), ((4, 1),))
    assert search.steps() == [(0, 2), (2, 5), (5, 6), (6, 7), (7, 1)]
    assert search.tried == 5


class Plane:
    """A free space in which lines from the left half to the right one are free only where y is above 0.8."""

    def straight(self, start: np.ndarray, end: np.ndarray) -> bool:
        return bool((start[0] < 0.5) == (end[0] < 0.5) or min(start[1], end[1]) > 0.8)


def test_the_arm_goes_where_straight_ways_lead(rng: np.random.Generator) -> None:
    points = rng.uniform(0, 1, (150, 2))
    away = np.linalg.norm(points[:, None] - points, axis=2)
    pairs = np.argwhere(np.triu(away < 0.2, 1))
    lengths, plane = away[tuple(pairs.T)], Plane()
    free = np.array([plane.straight(*points[pair]) for pair in pairs])
    graph = csr_array((lengths[free], pairs[free].T), shape=(150, 150))
    exact = dijkstra(graph, directed=False, indices=0)
    roadmap = Roadmap(points, pairs, lengths, plane)  # type: ignore[arg-type]
    for end in range(1, 150, 10):
        way = roadmap.way(0, end)
        if np.isinf(exact[end]):
            assert way is None
        else:
            assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() == pytest.approx(exact[end])
            assert all(plane.straight(*ends) for ends in pairwise(way))


def test_the_first_counterweight_is_where_the_arm_is(scene: Scene, balance: Balance) -> None:
    np.testing.assert_array_equal(balance.arms[0], scene.posture)


def test_causes_are_short_within_what_is_said_of_a_walk() -> None:
    """They are as long as messages themselves: a message that is cut leaves out what matters."""
    first = "no path beyond t = 0.10 s: link_3 is too near to post_2"
    assert _cause(f"{first}; another place for the tool path may help") == first
    assert len(_cause("word " * 100)) <= 100
    assert {*_cause("word " * 100).split()} == {"word", "…"}


def test_a_step_that_does_not_hold_is_refused_with_its_figures() -> None:
    magnet = {"kind": "magnet", "adhesion_n": 2500, "safety": 1, "friction": 0.7}
    weak = scene_at(4.04, 4.44, magnet)
    there, options = StanceFile.model_validate(feet(4.34, 4.74)), WalkOptions(spacing=2.0)
    figures = r"easiest way.*% of its effort, adhesion needed \d+\.\d+ kN\).*"
    with pytest.raises(PlanningError, match=figures) as refused:
        cmbot.walk(weak, there, options)
    times = float(re.search(r"bounds (\d+\.\d) times as large would do at rest", str(refused.value))[1])
    assert times > 1
    # With magnets and joints that are as much stronger there is a way at rest, with less there is none.
    for share, found in ((1.1, True), (0.9, False)):
        strong = scene_at(4.04, 4.44, magnet | {"adhesion_n": 2500 * share * times})
        first, last = stance_of(strong), goal_stance(there, strong)
        balance = Balance(strong, np.array(strong.posture))
        balance._climber.effort = share * times * balance._climber.effort
        route = Route(nodes_between(strong, first, last, options.spacing), balance)
        assert (route.shortest(0) is not None) == found


class InVain(_Search):
    """The search in which every step turns out impossible."""

    def _passes(self, edge: Edge) -> bool:
        self._step(edge)
        return False

    def _step(self, edge: Edge) -> None:
        self.failures.append("a link comes too near")

    def _check(self, k: int) -> None:
        self._possible[k] = np.ones(0, dtype=np.bool_)


def test_where_steps_turn_out_impossible_the_figures_are_told(
    scene: Scene, node: Candidate, balance: Balance
) -> None:
    route = Route(nodes_between(scene, node, stance_of(scene_at(4.34, 4.74, CLAMP)), 0.6), balance)
    search = InVain(scene, balance, route, np.zeros(7), WalkOptions(), lambda _step, _share: None)
    figures = (
        r"the hardest step of the easiest .*way, .* uses \d+ % of what is allowed \(climb_\d \d+ % of its"
    )
    end = r".*; \d+ steps? that would hold at rest tried in vain, the last: a link comes too near"
    with pytest.raises(PlanningError, match=figures + end) as refused:
        search.steps()
    assert len(str(refused.value)) <= 400


def test_where_to(tmp_path: Any, scene: Scene) -> None:
    (tmp_path / "there.json").write_text(json.dumps(feet(4.34, 4.74)))
    goal = load_goal(tmp_path / "there.json")
    assert isinstance(goal, StanceFile)
    assert goal.foot_2.along_m == 4.74
    assert isinstance(load_goal(Path("triangle")), Scene)
    with pytest.raises(SceneError, match="no such file"):
        load_goal("a" * 300)
    with pytest.raises(SceneError, match="the shipped robot, an arm on a climber that holds a guardrail"):
        walk(short_scene(guardrail={"bays": 0}), goal)
