"""Jobs in which the arm holds the part and the tool stands in W."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from held_scenes import FACE, OFFSET, TOOL, held_scene

import cmbot
from cmbot.accuracy.parts import parts_of
from cmbot.archive import Asked, load_plan, save, verified_motions
from cmbot.collision import Clearances, PointDistances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, PathNotFound, SceneError
from cmbot.elastic.arm import elastic_arm
from cmbot.planning import Plan, plan, robot_of
from cmbot.scene import Scene, Uncertainty

SPRINGS = {"stiffness": [2e5, 2e5, 2e5, 2e4, 2e4, 2e4], "bays": 0}


def placed_parts(q: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) in W of the part in postures, by the URDF alone."""
    bare = cmbot.load_robot("panda")
    model, data = bare.model, bare.model.createData()
    found = []
    for each in q:
        pin.framesForwardKinematics(model, data, each)
        X = data.oMf[model.getFrameId("panda_hand_tcp")] * pin.SE3(np.eye(3), np.array([0, 0, OFFSET]))
        found.append(X.homogeneous)
    return np.array(found)


def off_path(p: FloatArray, begins: float) -> FloatArray:
    """Distances (N,) of points (N, 3) of the part from the line and the quarter circle on it."""
    p = p - np.array([0.0, 0.0, begins])
    x, y = np.clip(p[:, 0], -0.03, 0.03), np.full(len(p), -0.03)
    line = np.linalg.norm(p - np.stack([x, y, 0 * x], axis=1), axis=1)
    angle = np.clip(np.arctan2(p[:, 1], p[:, 0]), -np.pi / 4, np.pi / 4)
    radius = 0.03 * np.sqrt(2)
    arc = np.linalg.norm(p - radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), axis=1)
    return np.minimum(line, arc)


def work(made: Plan) -> tuple[FloatArray, FloatArray]:
    """Of the work at 300 times: joint positions, and the tool's poses (N, 4, 4) seen from the part."""
    (segment,) = made.job.strokes
    q = segment.trajectory.evaluate(np.linspace(*segment.trajectory.t[[0, -1]], 300))
    X_WT = np.eye(4)
    X_WT[:3, 3] = TOOL["xyz"]
    return q, np.linalg.inv(placed_parts(q)) @ X_WT


@pytest.mark.parametrize("keep", ["pose", "axis", {"axis_within_deg": 10}], ids=str)
def test_the_tool_follows_its_path_on_the_part(keep: Any) -> None:
    """By other kinematics, at all samples: the point, and what is kept of the orientation."""
    made = plan(held_scene(keep))
    most = made.options.max_tool_deviation_m
    _, seen = work(made)
    away = off_path(seen[:, :3, 3], FACE + 0.02)
    assert made.certificate.holds and away.max() <= most
    assert away.max() <= made.figures.max_tool_deviation * (1 + 1e-6) + 1e-9
    down = np.degrees(np.arccos(np.clip(-seen[:, 2, 2], -1, 1)))
    assert down.max() <= (10.0 if isinstance(keep, dict) else made.options.max_tool_rotation_deg)
    turned = np.degrees(np.arctan2(seen[:, 1, 0], seen[:, 0, 0]))
    assert (np.ptp(turned) > 1.0) == (keep != "pose")


def test_a_held_pose_is_the_job_of_the_flange_that_moves_the_other_way() -> None:
    """A line on the part by d is one of the part by -d: same proven bound of the torque, same peak."""
    start = {"xyz": [-0.03, -0.03, FACE + 0.02], "rpy_deg": [180, 0, 0]}
    held = {"keep": "pose", "from": start, "via_points": 7, "legs": [{"by": [0.03, 0, 0], "seconds": 2}]}
    # The part's pose with the tool there: the tool's axes are those of W, turned by half a turn about x.
    moved = {"xyz": [0.5 + 0.03, 0.0 - 0.03, 0.3 + FACE + 0.02], "rpy_deg": [180, 0, 0]}
    usual = held | {"from": moved, "legs": [{"by": [-0.03, 0, 0], "seconds": 2}]}
    one, other = (
        plan(held_scene(tool_path=path, **more).with_options(objective="torque"))
        for path, more in ((held, {}), (usual, {"tool": {"fixed": None}}))
    )
    assert one.torque_floor_kind == other.torque_floor_kind == "proven"
    assert one.torque_floor == pytest.approx(other.torque_floor, rel=1e-3)
    assert one.figures.peak_guardrail_torque == pytest.approx(other.figures.peak_guardrail_torque, rel=1e-3)


@pytest.fixture(scope="module")
def bent() -> Plan:
    """On a base that gives way, its sag compensated."""
    return plan(held_scene(guardrail=SPRINGS))


def test_the_bent_arms_part_meets_the_tool(bent: Plan) -> None:
    """The base by its six springs, moved by the weights' wrench until it rests."""
    q, rigid = work(bent)
    robot, X_WT = bent.robot, np.eye(4)
    X_WT[:3, 3] = TOOL["xyz"]
    parts, K = placed_parts(q), np.diag(SPRINGS["stiffness"])
    data = robot.model.createData()
    # What is fixed to the base is part of its load.
    carrier = robot.model.inertias[0]
    away = np.empty(len(q))
    for k, each in enumerate(q):
        centre, mass, D = pin.centerOfMass(robot.model, data, each), robot.arm_mass, pin.SE3.Identity()
        first = mass * centre + carrier.mass * carrier.lever
        weight = np.array([0, 0, -9.81 * (mass + carrier.mass)])
        for _ in range(8):
            lever = D.rotation @ first / (mass + carrier.mass)
            moved = np.linalg.solve(K, np.hstack([weight, np.cross(lever, weight)]))
            D = pin.SE3(pin.exp3(moved[3:]), moved[:3])
        seen = np.linalg.inv(D.homogeneous @ parts[k]) @ X_WT
        away[k] = off_path(seen[None, :3, 3], FACE + 0.02)[0]
    assert bent.sag is not None and bent.certificate.holds
    assert away.max() <= bent.options.max_tool_deviation_m
    # Uncompensated it would miss by far more.
    assert off_path(rigid[:, :3, 3], FACE + 0.02).max() > 3 * bent.options.max_tool_deviation_m


def test_a_plan_is_verified_with_its_scene_alone(bent: Plan, tmp_path: Path) -> None:
    """Not with one whose tool stands a millimetre beside, and the part has it there."""
    save(bent, tmp_path)
    verified_motions(tmp_path, Asked(scenes=(bent.scene,)))
    aside = {"fixed": {**TOOL, "xyz": [0.5, 0.001, 0.3]}}
    with pytest.raises(ArchiveError):
        load_plan(tmp_path, verify=True, scene=held_scene(guardrail=SPRINGS, tool=aside))


def test_paths_are_drawn_where_the_part_has_them(bent: Plan) -> None:
    (segment,), (outline,) = bent.job.strokes, bent.outlines
    X_WE = placed_parts(segment.trajectory.q[:1])[0]
    np.testing.assert_allclose(
        outline[0], X_WE[:3, :3] @ [-0.03, -0.03, FACE + 0.02] + X_WE[:3, 3], atol=1e-9
    )
    # The tool is there when the work begins.
    np.testing.assert_allclose(outline[0], TOOL["xyz"], atol=5e-3)


def test_only_the_tip_of_a_fixed_tool_touches_the_part(rng: np.random.Generator) -> None:
    touching = held_scene(stand_off=0.0, tool={"contact_mm": 30})
    made = plan(touching)
    assert made.certificate.holds
    q = np.array(touching.posture) + rng.uniform(-0.3, 0.3, (30, 7))
    robot, obstacles = robot_of(touching), touching.all_obstacles
    np.testing.assert_allclose(
        PointDistances(robot, obstacles).smallest(q)[0],
        Clearances(robot, obstacles).query(q).distance,
        atol=1e-6,
    )
    # The face is at the tip, and so far from the rest, which ends square to the axis.
    begin = made.job.strokes[0].trajectory.q[:1]
    assert Clearances(robot, obstacles).query(begin).distance[0] == pytest.approx(0.03, abs=1e-5)
    whole = [replace(each, contact=0.0) for each in obstacles]
    assert Clearances(robot, whole).query(begin).distance[0] == pytest.approx(0.0, abs=1e-5)
    with pytest.raises(PathNotFound, match="nozzle"):
        plan(held_scene(stand_off=0.0))


def test_a_path_deep_in_the_part_is_refused() -> None:
    """The tool point 15 mm below the face of the block, which is moved and turned in the part's frame."""
    turned = {"xyz": [0, 0, OFFSET], "rpy_deg": [0, 0, 30], "mass_kg": 1.0}
    block = {"box": [0.12, 0.12, 2 * FACE], "xyz": [0.01, 0, OFFSET]}
    robot = {"model": "panda", "tool_frame": "panda_hand_tcp", "tool": {**turned, "shapes": [block]}}
    deep = held_scene(stand_off=-0.015, tool={"contact_mm": 60}, robot=robot)
    (part,) = deep.touched
    # In the frame of the flange, which the part's is turned from by 30 degrees.
    np.testing.assert_allclose(part.X_WO[:3, 3], [0.01 * np.cos(np.pi / 6), -0.005, 0], atol=1e-12)
    with pytest.raises(SceneError, match=r"legs\[0\]: got 15 mm of the tip in part, the tool point at \("):
        plan(deep)
    pressed = held_scene(stand_off=-0.005, tool={"contact_mm": 60}, robot=robot)
    assert not [each for each in cmbot.planning.precheck_scene(pressed).warnings if "of the tip" in each.got]


def test_a_base_beside_its_place_moves_the_tool_on_the_part(bent: Plan) -> None:
    """The budget's part, against the part moved with the base by small steps."""
    nothing = {"mm": 0.0, "deg": 0.0}
    unknown = Uncertainty.none().changed(foot={"mm": 1.0, "deg": 1.0}, workpiece=nothing)
    robot, (q, seen) = bent.robot, work(bent)
    parts = parts_of(elastic_arm(robot, None), q[:3], unknown, compensated=False)
    (placed,) = (each for each in parts if each.name == "placement of the base")
    X_WT, step = np.eye(4), 1e-4
    X_WT[:3, 3] = TOOL["xyz"]
    for k, X_WE in enumerate(placed_parts(q[:3])):
        for axis in range(6):
            twist = np.zeros(6)
            twist[axis] = step * (1e-3 if axis < 3 else np.radians(1.0))
            moved = np.linalg.inv(pin.SE3(pin.exp3(twist[3:]), twist[:3]).homogeneous @ X_WE) @ X_WT
            by = (moved - seen[k])[:3, 3] / step
            np.testing.assert_allclose(placed.maps[k, :, axis], by, atol=1e-8)


def test_what_would_help_is_told_of_what_helps(bent: Plan) -> None:
    """Touched points say where work is, not where a tool stands: no remedy, as locate refuses it."""
    assert bent.accuracy is not None
    assert bent.accuracy.parts[0].name == "placement of the base"
    assert "cmbot locate" not in [remedy.name for remedy in bent.accuracy.remedies]
    touches = {
        "format": "cmbot-touches/1",
        "scene": "given",
        "touches": [{"place": [0, 0, 0], "point": [0, 0, 0]}],
    }
    with pytest.raises(SceneError, match=r"tool.fixed: got a fixed tool, expected a tool that the arm holds"):
        cmbot.locate(touches, scene=bent.scene)


def in_frame(**path: Any) -> Scene:
    return held_scene(frames={"jig": {"xyz": [0, 0, 0], "rpy_deg": [0, 0, 0]}}, tool_path=path)


LEG = {"to": {"xyz": [0, 0, 0.05], "frame": "jig"}, "seconds": 3}


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (
            lambda: held_scene(tool={"process_force_n": [0, 0, -5]}),
            r"process_force_n: got .* beside tool.fixed",
        ),
        (lambda: plan(in_frame(legs=[LEG])), r"frame: got .?jig.?, expected no frame, for that of the part"),
        (
            lambda: plan(
                in_frame(raster={"mesh": "nozzle", "spacing_m": 0.01, "stand_off_m": 0.02}, seconds=5)
            ),
            "mesh: got .?nozzle.?, expected the path of a mesh file",
        ),
        (lambda: held_scene(tool={"fixed": {"xyz": [0, 0]}}), "tool.fixed"),
        (
            lambda: cmbot.stances.stand(held_scene(mounts=[{"xyz": [0, 0, 0]}])),
            "tool.fixed: got a fixed tool",
        ),
    ],
    ids=["force", "frame", "mesh", "pose", "stand"],
)
def test_what_a_fixed_tool_cannot_have_is_refused(scene: Any, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scene()
