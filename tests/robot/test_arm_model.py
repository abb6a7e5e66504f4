"""Mount, tool length and payload do what they say."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from robot_files import load_copy, pose, replace
from state_samples import StateSamples

from cmbot.common.errors import ModelError
from cmbot.robot import Dynamics, Kinematics, Robot, load_robot


def shape_poses(robot: Robot, q: np.ndarray) -> list[Any]:
    model, shapes = robot.model, robot.collision_model
    data = shapes.createData()
    pin.updateGeometryPlacements(model, model.createData(), shapes, data, q)
    return [X.copy() for X in data.oMg]


@pytest.mark.parametrize(
    ("rpy", "xyz"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.7), (0.3, -0.2, 0.5)),
        ((0.4, -0.8, 0.3), (0.3, -0.2, 0.5)),
    ],
)
def test_mount_moves_everything_rigidly(
    cmbot_robot: Robot,
    random_states: StateSamples,
    rpy: tuple[float, float, float],
    xyz: tuple[float, float, float],
) -> None:
    X_WB = pose((np.pi, 0, 0), (0, 0.5, 0))
    moved = pose(rpy, xyz)  # of the whole robot
    mounted = load_robot("cmbot", mount=(moved * X_WB).homogeneous)
    q, v, a = random_states(cmbot_robot, 20)

    for q_k in q[:3]:
        pairs = [
            (Kinematics(mounted).tool_pose(q_k), Kinematics(cmbot_robot).tool_pose(q_k)),
            *zip(shape_poses(mounted, q_k), shape_poses(cmbot_robot, q_k), strict=True),
        ]
        for got_pose, expected_pose in pairs:
            expected = (moved * expected_pose).homogeneous
            np.testing.assert_allclose(got_pose.homogeneous, expected, rtol=0, atol=1e-12)
    lever = mounted.model.inertias[0].lever
    np.testing.assert_allclose(lever, moved.act(cmbot_robot.model.inertias[0].lever), atol=1e-12)
    carrier_torque = np.cross(lever, [0, 0, -9.81 * mounted.carrier_mass])
    np.testing.assert_allclose(mounted.carrier_torque, carrier_torque, atol=1e-8)

    # Only about the vertical is weight the same after the turn; what motion adds to it always is.
    parts = [False, True] if rpy[:2] == (0.0, 0.0) else [False]
    for with_weight in parts:
        before, after = (_wrenches(robot, q, v, a, with_weight) for robot in (cmbot_robot, mounted))
        expected = [moved.act(pin.Force(wrench)).vector for wrench in before]
        np.testing.assert_allclose(after, expected, rtol=0, atol=1e-9)
    value, efforts = Dynamics(mounted).derivatives(q, v, a).value, Dynamics(mounted).efforts(q, v, a)
    np.testing.assert_allclose(value[:, :3], efforts.guardrail_torque, rtol=0, atol=1e-9)
    np.testing.assert_allclose(value[:, 3:], efforts.joint_torque, rtol=0, atol=1e-9)


def _wrenches(robot: Robot, q: np.ndarray, v: np.ndarray, a: np.ndarray, with_weight: bool) -> np.ndarray:
    dynamics = Dynamics(robot)
    moving, still = dynamics.efforts(q, v, a), dynamics.static_efforts(q)
    wrench = np.hstack([moving.guardrail_force, moving.guardrail_torque])
    return wrench - (0 if with_weight else np.hstack([still.guardrail_force, still.guardrail_torque]))


NO_POSES = [np.eye(3), np.zeros((4, 4)), 2 * np.eye(4), np.full((4, 4), np.nan)]
NO_POSES += [np.diag([1.0, 1, -1, 1]), np.diag([1.0, 1, 1, 2]), "here", [[1, 2], [3]]]


@pytest.mark.parametrize("length", [0.02, 0.05, 0.3, 0.45])
def test_tool_length(cmbot_robot: Robot, random_states: StateSamples, length: float) -> None:
    robot = load_robot("cmbot", tool_length=length)
    states = random_states(cmbot_robot, 50)
    p, R = Kinematics(robot).tool_poses(states[0])
    p_before, R_before = Kinematics(cmbot_robot).tool_poses(states[0])
    np.testing.assert_allclose(p, p_before + (length - 0.3) * R_before[:, :, 2], rtol=0, atol=1e-13)
    np.testing.assert_array_equal(R, R_before)
    # It has no mass.
    torque, torque_before = (
        Dynamics(each).efforts(*states).guardrail_torque for each in (robot, cmbot_robot)
    )
    np.testing.assert_array_equal(torque, torque_before)
    # The tool's capsule begins where it began and ends at the tool point.
    shape = next(shape for shape in robot.collision_model.geometryObjects if shape.name == "tool_0")
    ends = shape.placement.translation[2] + np.array([-1, 1]) * shape.geometry.halfLength
    assert shape.geometry.radius == 0.04
    assert ends[0] == pytest.approx(0.0, abs=1e-12)
    assert ends[1] + 0.04 == pytest.approx(max(length, 0.04), abs=1e-12)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        *(({"mount": bad}, "load_robot: mount: .* a pose") for bad in NO_POSES),
        *(({"tool_length": bad}, "tool_length: .* positive length") for bad in (0.0, -0.1, np.nan, np.inf)),
        *(({"payload": bad}, "payload: .* not negative") for bad in (-1e-9, -5.0, np.nan, np.inf)),
    ],
)
def test_mounts_are_poses_and_lengths_and_masses_are_positive(option: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        load_robot("cmbot", **option)


def test_tool_that_does_not_lie_ahead_of_its_flange(urdf_folder: Path) -> None:
    with pytest.raises(ModelError, match=r"tool_length: .*'link_7' to be fixed to its flange, not moved"):
        load_copy(urdf_folder, tool_frame="link_7", tool_length=0.3)
    replace(urdf_folder / "cmbot.urdf", 'xyz="0.0 0.0 0.3"', 'xyz="0.1 0.0 0.3"')
    with pytest.raises(ModelError, match="flange's z axis"):
        load_copy(urdf_folder, tool_length=0.3)


TOOL_CAPSULE = '<cylinder radius="0.04" length="0.26" />'


@pytest.mark.parametrize(
    ("shape", "half"), [('<box size="0.1 0.2 0.26"/>', (0.05, 0.1, 0.26)), (TOOL_CAPSULE, None)]
)
def test_tool_of_other_shapes_is_stretched(
    urdf_folder: Path, shape: str, half: tuple[float, float, float] | None
) -> None:
    replace(urdf_folder / "cmbot.urdf", TOOL_CAPSULE, shape)
    replace(urdf_folder / "cmbot.urdf", '<capsule name="tool_capsule" />', "")
    tool = load_copy(urdf_folder, tool_length=0.6).collision_model
    (stretched,) = (shape for shape in tool.geometryObjects if shape.name == "tool_0")
    assert stretched.placement.translation[2] == pytest.approx(0.26)
    if half is None:
        assert stretched.geometry.halfLength == pytest.approx(0.26)
        assert stretched.geometry.radius == 0.04
    else:
        np.testing.assert_allclose(stretched.geometry.halfSide, half)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (TOOL_CAPSULE, '<sphere radius="0.04"/>'),
        ('xyz="0.0 0.0 0.13" rpy="0.0', 'xyz="0.0 0.0 0.13" rpy="0.5'),
    ],
)
def test_tool_that_cannot_be_stretched(urdf_folder: Path, old: str, new: str) -> None:
    replace(urdf_folder / "cmbot.urdf", old, new)
    with pytest.raises(ModelError, match=r"tool_length, tool_0: .* cannot be stretched"):
        load_copy(urdf_folder, tool_length=0.6)


def test_joint_called_guardrail(
    urdf_folder: Path, cmbot_dynamics: Dynamics, random_states: StateSamples
) -> None:
    """The robot's names do not meet that of the free-flyer below it."""
    for name, old in (("cmbot.urdf", '"joint_3"'), ("joint_limits.yaml", "joint_3:")):
        replace(urdf_folder / name, old, old.replace("joint_3", "guardrail"))
    robot = load_copy(urdf_folder)
    states = random_states(robot, 3)
    got, expected = Dynamics(robot).derivatives(*states), cmbot_dynamics.derivatives(*states)
    np.testing.assert_allclose(got.value, expected.value, rtol=0, atol=1e-10)
    np.testing.assert_allclose(got.d_q, expected.d_q, rtol=0, atol=1e-10)
