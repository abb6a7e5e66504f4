"""A tool that touches: the tip of its length `contact_mm` may, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import least_squares

from cmbot.archive import Asked, load_plan, save, verified_motions
from cmbot.collision import Box, Capsule, Clearances, Cylinder, Obstacle, PointDistances, Sphere
from cmbot.collision.shapes import coal_shapes, without_tip
from cmbot.common.errors import ArchiveError, PathNotFound, SceneError
from cmbot.planning import certify_move, plan, precheck_scene, robot_of, strokes_of, task_of
from cmbot.robot import Kinematics, Robot
from cmbot.scene import Scene, load_scene
from cmbot.trajectory import SplineSpace

SHAPES: dict[str, dict[str, Any]] = {
    "box": {"box": [0.05, 0.04, 0.1], "xyz": [0, 0, 0.1]},
    "cylinder": {"cylinder": [0.03, 0.1], "xyz": [0, 0, 0.1]},
    "capsule": {"capsule": [0.03, 0.04], "xyz": [0, 0, 0.1]},
}


def touching_scene(contact_mm: float, shape: str = "cylinder", depth: float = 0.0, **planner: Any) -> Scene:
    """A Panda that sands a line on a board, its tool point `depth` m below the face."""
    tool = {"xyz": [0, 0, 0.15], "mass_kg": 0.5, "shapes": [SHAPES[shape]]}
    board = {"box": [0.4, 0.4, 0.04], "xyz": [0.5, 0, 0.28 + depth], "workpiece": True}
    return load_scene(
        {
            "format": "cmbot-scene/2",
            "name": "touching",
            "robot": {"model": "panda", "tool_frame": "panda_hand_tcp", "tool": tool},
            "guardrail": {"bays": 0},
            "start": {"posture": [0.0, -0.6, 0.0, -2.2, 0.0, 1.7, 0.8]},
            "tool": {"process_force_n": [0, 0, -20], "contact_mm": contact_mm},
            "tool_path": {
                "from": {"xyz": [0.5, -0.05, 0.3], "rpy_deg": [180, 0, 0]},
                "legs": [{"by": [0, 0.1, 0], "seconds": 4}],
                "keep": "axis",
                "via_points": 9,
            },
            "obstacles": [{"name": "board", **board}],
            "planner": {"baseline": "none", **planner},
        }
    )


def held(robot: Any, q: Any) -> Any:
    """The tool point and the tool's z axis in postures, (N, 3) each."""
    poses = [Kinematics(robot).tool_pose(posture).homogeneous for posture in q]
    return np.array([X[:3, 3] for X in poses]), np.array([X[:3, 2] for X in poses])


@pytest.mark.parametrize("shape", SHAPES)
def test_distances_are_those_of_the_tool_without_its_tip(shape: str, rng: np.random.Generator) -> None:
    """The rest ends square to the tool's axis, so that far behind the tool point."""
    whole, cut = touching_scene(0.0, shape), touching_scene(30.0, shape)
    robot = robot_of(cut)
    q = np.array(cut.posture) + rng.uniform(-0.3, 0.3, (40, 7))
    point, axis = held(robot, q)
    # A thin plate square to the axis of the first posture, at its tool point.
    plate, X = Box(size=(0.1, 0.1, 1e-3)), np.eye(4)
    X[:3, :3], X[:3, 3] = Kinematics(robot).tool_pose(q[0]).homogeneous[:3, :3], point[0] + 5e-4 * axis[0]
    touched = Obstacle(name="plate", shape=plate, X_WO=X, workpiece=True, contact=0.03)
    np.testing.assert_allclose(of_tool(robot, touched, q)[0], 0.03, atol=1e-6)
    far = Obstacle(name="far", shape=plate, X_WO=np.eye(4), workpiece=True)
    before, after = (of_tool(robot, each, q) for each in (far, replace(far, contact=0.03)))
    assert (after >= before - 1e-3).all() and (after <= before + 0.031).all()
    for obstacle in (*whole.all_obstacles, *cut.all_obstacles):
        own = Clearances(robot, [obstacle]).query(q).distance
        np.testing.assert_allclose(PointDistances(robot, [obstacle]).smallest(q)[0], own, atol=1e-6)


def test_a_capsule_is_cut_across_and_keeps_its_other_end(cmbot_robot: Robot) -> None:
    """Of the shipped arm, whose tool is one: its ends along the tool's axis, and how wide it is."""
    (tool,) = (x for x in cmbot_robot.collision_model.geometryObjects if x.parentJoint == cmbot_robot.dof)
    assert isinstance(tool.geometry, coal.Capsule)
    X_JT = cmbot_robot.model.frames[cmbot_robot.tool_frame_id].placement
    seen = []
    for shape in (tool, without_tip(tool, X_JT, 0.05)):
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        corners = np.array(list(product(*np.transpose([box.min_, box.max_]))))
        seen.append(np.array([X_JT.actInv(tool.placement.act(corner)) for corner in corners]))
    whole, rest = seen
    np.testing.assert_allclose(rest.min(axis=0), whole.min(axis=0), atol=0.02 * tool.geometry.radius)
    np.testing.assert_allclose(rest.max(axis=0)[:2], whole.max(axis=0)[:2], atol=0.02 * tool.geometry.radius)
    assert whole.max(axis=0)[2] > -0.05
    assert rest.max(axis=0)[2] == pytest.approx(-0.05, abs=1e-9)


def of_tool(robot: Any, obstacle: Obstacle, q: Any) -> Any:
    """Distances (N,) of the tool, but for its tip, from an obstacle."""
    clearances = Clearances(robot, [obstacle])
    rows = [k for k, pair in enumerate(clearances.pairs) if pair.tool_at_work]
    every = clearances.distances(q, np.arange(len(q)).repeat(len(rows)), np.tile(rows, len(q)))
    return every.reshape(len(q), -1).min(axis=1)


def test_only_a_tool_that_may_touch_is_planned_on_a_board(tmp_path: Path) -> None:
    asked = touching_scene(30.0)
    made = plan(asked)
    assert made.certificate.holds
    (check,) = [each for each in made.certificate.checks if each.quantity.endswith("from board")]
    assert 0.02 <= check.value <= 0.03
    approach = made.job.segments[0]
    told = made.segment_samples[approach.name].clearance.min()
    assert told == pytest.approx(approach.figures.min_clearance, abs=1e-3) and told < 0.023
    save(made, tmp_path)
    verified_motions(tmp_path, Asked(scenes=(asked,)))
    with pytest.raises(ArchiveError, match="contact_mm"):
        load_plan(tmp_path, verify=True, scene=touching_scene(25.0))
    with pytest.raises(PathNotFound, match=r"board \(tool.contact_mm lets the tip touch it\), the"):
        plan(touching_scene(0.0))


def test_the_tip_goes_no_deeper_than_what_it_exceeds_the_margin_by() -> None:
    with pytest.raises(PathNotFound, match=r"board \(tool.contact_mm lets the tip touch it\), the"):
        plan(touching_scene(25.0, depth=0.008))


@pytest.mark.parametrize(
    ("contact_mm", "is_told"), [(15.0, True), (20.0, True), (20.5, False), (30.0, False)]
)
def test_a_tip_that_is_too_short_to_touch_is_told(contact_mm: float, is_told: bool) -> None:
    """The rest of the tool keeps the margin, 20 mm: from a touched face it can only with a longer tip."""
    told = [
        each for each in precheck_scene(touching_scene(contact_mm)).warnings if each.key == "tool.contact_mm"
    ]
    assert [each.got for each in told] == [f"{contact_mm:g}, and the tool point touches board"] * is_told
    if contact_mm == 20.0:
        with pytest.raises(PathNotFound):
            plan(touching_scene(contact_mm))


@pytest.mark.parametrize(("depth", "length"), [(0.012, 12), (0.04, 40), (0.05, 40)])
def test_a_path_deep_in_what_it_may_touch_is_refused(depth: float, length: int) -> None:
    """A board of 40 mm, a tool point within it, at its far side and beyond."""
    scene = touching_scene(60.0, depth=depth)
    told = rf"tool_path.legs\[0\]: got {length} mm of the tip in board, the tool point at \(0.500, "
    with pytest.raises(SceneError, match=told):
        plan(scene)
    errors = [each.got for each in precheck_scene(scene).warnings if each.severity == "error"]
    assert any(each.startswith(f"{length} mm of the tip in board") for each in errors)


@given(
    shape=st.sampled_from(
        [
            Box(size=(0.3, 0.2, 0.1)),
            Cylinder(radius=0.1, length=0.3),
            Capsule(radius=0.1, length=0.2),
            Sphere(radius=0.15),
        ]
    ),
    turn=arrays(np.float64, 3, elements=st.floats(-3, 3)),
    point=arrays(np.float64, 3, elements=st.floats(-0.3, 0.3)),
)
def test_points_in_an_obstacle_are_those_at_no_distance(shape: Any, turn: Any, point: Any) -> None:
    X = pin.SE3(pin.exp3(turn), np.array([0.1, -0.2, 0.05]))
    at, (solid,) = X.translation + point, coal_shapes(shape, "solid")
    there = coal.Transform3s(X.rotation, X.translation)
    small, place = coal.Sphere(1e-3), coal.Transform3s(np.eye(3), at)
    away = coal.distance(small, place, solid, there, coal.DistanceRequest(), coal.DistanceResult()) + 1e-3
    assume(abs(away) > 1e-5)
    inside = Obstacle(name="solid", shape=shape, X_WO=X.homogeneous).contains(at[None])
    assert inside.tolist() == [away < 0]


def translation(*xyz: float) -> Any:
    X = np.eye(4)
    X[:3, 3] = xyz
    return X


def posture_at(robot: Robot, q: Any, point: Any) -> Any:
    """The posture near `q` (n,) with the tool point there (3,), its axis down, by least squares."""

    def residual(x: Any) -> Any:
        pose = Kinematics(robot).tool_pose(x).homogeneous
        return np.concatenate([pose[:3, 3] - point, pose[:3, 2] + [0, 0, 1], 1e-9 * (x - q)])

    return least_squares(residual, q, xtol=1e-15, ftol=1e-15, gtol=1e-15).x


def test_on_free_moves_the_tip_goes_no_deeper_than_at_their_ends() -> None:
    """Where a free move between two postures would dig deeper into the board it is not free."""
    scene = touching_scene(60.0)
    robot, margin = robot_of(scene), scene.planner.safety_margin_m
    whole = Clearances(robot, scene.all_obstacles)
    surface, deep, deeper = (
        posture_at(robot, scene.posture, [0.5, 0.0, z])[None] for z in (0.3, 0.288, 0.2855)
    )
    off = [whole.no_deeper(q, margin) for q in (surface, np.vstack([surface, deep]))]
    for distances, allowed, refused in ((off[0], surface, deep), (off[1], deep, deeper)):
        assert distances.query(allowed).distance[0] >= margin > distances.query(refused).distance[0]
        assert whole.query(refused).distance[0] >= margin
    # Each workpiece by itself: what one is entered by is no leave to enter another one.
    (board,) = scene.all_obstacles
    raised = replace(board, name="beside", X_WO=board.X_WO @ translation(0.0, 0.5, 0.0))
    both = Clearances(robot, [board, raised]).no_deeper(np.vstack([surface, deep]), margin)
    aside = posture_at(robot, scene.posture, [0.5, 0.35, 0.295])[None]
    assert Clearances(robot, [raised]).query(aside).distance[0] >= margin > both.query(aside).distance[0]


def test_a_free_move_that_digs_is_not_certified() -> None:
    scene = touching_scene(60.0)
    robot, options = robot_of(scene), scene.planner
    task = task_of(strokes_of(scene, robot)[0], scene).held_at_start()
    ends = [posture_at(robot, scene.posture, [0.5, y, 0.3]) for y in (-0.05, 0.05)]
    for depth, holds in ((0.0, True), (0.02, False)):
        middle = posture_at(robot, scene.posture, [0.5, 0.0, 0.305 - depth])
        space = SplineSpace(np.linspace(0.0, 12.0, 5))
        half = [0.5 * (end + middle) for end in ends]
        knots = np.stack([ends[0], half[0], middle, half[1], ends[1]])
        trajectory = space.trajectory(space.least_jerk(knots))
        clearances = Clearances(robot, scene.all_obstacles)
        certificate = certify_move(robot, task, trajectory, clearances, options, *ends)
        broken = [check.quantity for check in certificate.checks if not check.holds]
        assert certificate.holds == holds, broken
        assert holds or any("board" in quantity for quantity in broken)
