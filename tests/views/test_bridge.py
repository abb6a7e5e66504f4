"""What is drawn of the bridge for orientation: where no arm goes, and holding what the arm works on."""

import dataclasses

import numpy as np
import pytest
from obstacle_entries import with_obstacles
from walks import one_step

from cmbot import Plan
from cmbot.collision import Box, Clearances, Obstacle
from cmbot.common.poses import pose
from cmbot.views.drawing import bridge
from cmbot.views.drawing.bridge import bridge_of, jobs_of

MARGIN = 0.02  # m


@pytest.fixture(params=["triangle_plan", "line_plan"])
def plan(request: pytest.FixtureRequest) -> Plan:
    found = request.getfixturevalue(request.param)
    assert isinstance(found, Plan)
    return found


def drawn(plan: Plan) -> list[Obstacle]:
    return bridge_of(plan.scene, jobs_of([plan]), plan.options.safety_margin_m)


def kinds(parts: list[Obstacle]) -> set[str]:
    return {part.name.rpartition("_")[0] for part in parts}


def test_the_job_keeps_clear_of_all_that_is_drawn(plan: Plan) -> None:
    parts = drawn(plan)
    assert kinds(parts) >= {
        "web",
        "flange",
        "stiffener",
        "bracket",
        "edge_beam",
        "sleeper",
        "track",
        "holder",
    }
    unique = [dataclasses.replace(part, name=f"part_{k}") for k, part in enumerate(parts)]
    clearances = Clearances(plan.robot, unique)
    others = [k for k, pair in enumerate(clearances.pairs) if not pair.self_collision]
    q = plan.job_samples[0].q[::20]
    posture, pair = np.divmod(np.arange(len(q) * len(others)), len(others))
    distances = clearances.distances(q, posture, np.array(others)[pair])
    # Between the knots that are looked at the arm may come nearer, not hit it.
    assert distances.min() > 0.5 * plan.options.safety_margin_m


def test_a_walk_keeps_clear_of_what_is_drawn() -> None:
    """With every link of the climber and the arm, on whichever foot it stands."""
    walk = one_step()
    motions = [(move.robot, move.segment.trajectory.q) for move in walk.moves]
    parts = bridge_of(walk.scene, motions, MARGIN)
    assert kinds(parts) >= {"walkway", "web", "sleeper", "track"}
    for robot, q in motions:
        clearances = Clearances(robot, parts)
        others = [k for k, pair in enumerate(clearances.pairs) if not pair.self_collision]
        some = q[::7]
        posture, pair = np.divmod(np.arange(len(some) * len(others)), len(others))
        assert clearances.distances(some, posture, np.array(others)[pair]).min() > 0.5 * MARGIN
    # With a larger margin the swinging leg is too near to the walkway's edge.
    assert "edge_beam" not in kinds(bridge_of(walk.scene, motions, 0.8))


def test_nothing_is_drawn_where_an_obstacle_is(plan: Plan) -> None:
    # The scenes have a walkway of their own.
    assert "walkway" not in kinds(drawn(plan))


def test_a_bar_holds_what_is_worked_on(plan: Plan) -> None:
    pieces = [each for each in plan.scene.all_obstacles if each.workpiece]
    assert pieces
    bars = [part for part in drawn(plan) if part.name.startswith("holder")]
    # The triangle's three bars touch: they are one bracket.
    assert len(bars) == 1
    bounds = np.array([bridge._bounds(bridge.obstacle_surface(each)) for each in pieces])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    half = 0.5 * bars[0].shape.size[2] * bars[0].X_WO[:3, 2]
    start, end = bars[0].X_WO[:3, 3] - half, bars[0].X_WO[:3, 3] + half
    assert ((start >= low - 1e-9) & (start <= high + 1e-9)).all()
    assert end[1] == pytest.approx(bridge._WALKWAY_EDGE_M) or end[1] == pytest.approx(bridge._GIRDERS[0])


def test_where_no_straight_bar_is_free_one_ends_beside(triangle_plan: Plan) -> None:
    (straight,) = (part for part in drawn(triangle_plan) if part.name.startswith("holder"))
    x, y, z = straight.X_WO[:3, 3] + 0.4 * straight.shape.size[2] * straight.X_WO[:3, 2]
    # In front of edge beam and girder.
    walls = [
        Obstacle(name=f"wall_{k}", shape=Box(size=(0.12, 0.2, height)), X_WO=pose((x, at, z)))
        for k, (at, height) in enumerate([(y, 0.2), (-1.6, 4.0)])
    ]
    scene = with_obstacles(triangle_plan.scene, *walls)
    other = dataclasses.replace(triangle_plan, scene=scene)
    (bar,) = (part for part in drawn(other) if part.name.startswith("holder"))
    ends = bar.X_WO[0, 3] + np.array([-0.5, 0.5]) * bar.shape.size[2] * bar.X_WO[0, 2]
    assert ends[0] == pytest.approx(x)
    assert abs(ends[1] - x) == pytest.approx(0.4)


def test_what_the_arm_would_hit_is_left_out(triangle_plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    def webs() -> int:
        return sum(part.name.startswith("web") for part in drawn(triangle_plan))

    assert webs() == 2
    monkeypatch.setattr(bridge, "_GIRDERS", (0.3, -3.75))
    assert webs() == 1


def test_without_a_guardrail_there_is_no_bridge(triangle_plan: Plan) -> None:
    scene = triangle_plan.scene.changed(guardrail={"bays": 0})
    assert drawn(dataclasses.replace(triangle_plan, scene=scene)) == []
