"""The first view: what hides what, and that path and arm are seen from there."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from obstacle_entries import with_obstacles
from small_scenes import short_scene

from cmbot.collision import Box, Obstacle
from cmbot.planning import Plan
from cmbot.views.drawing.camera import RISE, focus_of, seen, width_of, workpieces
from cmbot.views.drawing.meshcat_scene import reach
from cmbot.views.drawing.surfaces import box

SIZE = np.array([0.4, 0.6, 0.8])


@given(
    points=arrays(float, (12, 3), elements=st.floats(-2, 2)), eye=arrays(float, 3, elements=st.floats(-9, 9))
)
def test_a_box_hides_what_is_behind_it(points: np.ndarray, eye: np.ndarray) -> None:
    solid = box(SIZE)
    found = seen(points, eye, solid.vertices[solid.faces])
    # The oracle follows the line by small steps, and is sure of what it meets well inside or well outside.
    way = points[:, None] + np.linspace(0, 1, 400)[:, None] * (eye - points)[:, None]
    depth = (SIZE / 2 - np.abs(way)).min(axis=2).max(axis=1)
    outside = (np.abs(points) > SIZE / 2).any(axis=1) & (np.abs(eye) > SIZE / 2).any()
    assert not found[(depth > 1e-6) & outside].any()
    assert found[depth < -0.05].all()


def test_workpieces_are_shown_as_far_as_they_are_near() -> None:
    X = np.eye(4)
    plank = Obstacle(name="plank", shape=Box(size=(10.0, 0.2, 0.2)), X_WO=X, workpiece=True)
    wall = replace(plank, name="wall", workpiece=False)
    far = replace(plank, name="far", X_WO=X + np.array([0, 0, 0, 5.0]) * np.eye(4)[:, 1:2])
    (corners,) = workpieces([wall, plank, far], np.array([[1.0, 0, 0], [2.0, 0, 0]]), 0.5)
    np.testing.assert_allclose(
        [corners.min(axis=0), corners.max(axis=0)], [[0.5, -0.1, -0.1], [2.5, 0.1, 0.1]]
    )


def test_what_is_near_a_point_does_not_hide_it() -> None:
    plate = box([0.01, 1, 1])
    corners = plate.vertices[plate.faces]
    point, eye = np.array([[-0.02, 0.1, 0.2]]), np.array([5.0, 0.3, 0.1])
    assert not seen(point, eye, corners).any()
    assert seen(point, eye, corners, near=0.05).all()


def test_the_width_of_a_path_is_that_of_its_area_or_its_length() -> None:
    rows = np.array([[0, y, z] for z in np.linspace(0, 0.2, 3) for y in np.linspace(0, 0.4, 9)])
    line = rows[:9]
    for angle in np.radians([0, 30, 60, 90]):
        way = np.array([np.cos(angle), np.sin(angle), 0])
        assert width_of(rows, way) == pytest.approx(np.cos(angle), abs=1e-9)
        assert width_of(line, way) == pytest.approx(np.cos(angle), abs=1e-9)


def test_no_wall_hides_the_path_in_the_first_view(triangle_plan: Plan) -> None:
    path = triangle_plan.task.path.outline()
    middle = path.mean(axis=0)
    free = focus_of(triangle_plan, [triangle_plan], [])
    assert free == focus_of(triangle_plan, [triangle_plan], [])

    def hidden(focus: dict[str, object], wall: Obstacle) -> float:
        way = np.array([np.cos(focus["azimuth"]), np.sin(focus["azimuth"]), focus["rise"]])
        eye = np.array(focus["centre"]) + 3 * focus["radius"] * way / np.linalg.norm(way)
        solid = box(wall.shape.size).moved(wall.X_WO)
        return 1 - seen(path, eye, solid.vertices[solid.faces]).mean()

    away = np.array([np.cos(free["azimuth"]), np.sin(free["azimuth"]), free["rise"]])
    X = np.eye(4)
    X[:3, :3] = np.column_stack([away / np.linalg.norm(away), [-away[1], away[0], 0], [0, 0, 1]])
    X[:3, :3] = np.linalg.qr(X[:3, :3])[0] * [1, 1, 1]
    X[:3, :3] *= np.sign(np.linalg.det(X[:3, :3]))
    X[:3, 3] = middle + 0.8 * away
    wall = Obstacle(name="wall", shape=Box(size=(0.05, 1.5, 1.5)), X_WO=X)
    scene = with_obstacles(triangle_plan.scene, wall)
    walled = replace(triangle_plan, scene=scene)
    assert hidden(free, wall) > 0.9
    assert hidden(focus_of(walled, [walled], []), wall) < 0.1


@pytest.mark.parametrize("length", [1.0, 50.0])
def test_the_pole_on_which_the_arm_stands_is_shown(short_plan: Plan, length: float) -> None:
    """Its end, too, unless that is far away."""
    mast = {"name": "mast", "cylinder": [0.05, length], "xyz": [0, 0, -length / 2]}
    plan = replace(short_plan, scene=short_scene(obstacles=[mast], guardrail={"bays": 0}))
    lowest = np.array(focus_of(plan, [plan], [])["points"])[:, 2].min()
    without = np.array(focus_of(short_plan, [short_plan], [])["points"])[:, 2].min()
    assert lowest == pytest.approx(min(without, -min(length, 1.5 * reach(plan.robot))))


def test_without_anything_in_the_way_the_arm_is_seen_from_beside(short_plan: Plan) -> None:
    """A short leg is a line: it is seen at its length, and the arm not from its end."""
    focus = focus_of(short_plan, [short_plan], [])
    way = np.array([np.cos(focus["azimuth"]), np.sin(focus["azimuth"]), 0])
    arm = short_plan.samples.tool_point.mean(axis=0) - np.array(short_plan.robot.foot_point)
    arm[2] = 0
    assert np.linalg.norm(np.cross(arm, way)) > 0.5 * np.linalg.norm(arm)
    assert focus["rise"] in (RISE, 0.6)
