"""Joints that follow others: all is that of the full arm, projected, and what is wrong of them is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import check_derivative
from robot_files import replace

from cmbot.collision import Clearances
from cmbot.common.errors import ModelError
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.sag import Sag
from cmbot.planning.verification.bent_tool import bent_tool_points
from cmbot.robot import Dynamics, Kinematics, Postures, Robot, link_poses, load_robot

ARM = Path(__file__).parent / "foreign" / "mimic_in_chain" / "arm.urdf"
# By hand: joint_3 is at 0.1 less joint_2, the second coordinate; joint_3b is the third one.
G = np.insert(np.eye(6), 2, [0, -1, 0, 0, 0, 0], axis=0)
OFFSET = np.array([0, 0, 0.1, 0, 0, 0, 0])
MIMIC = '<mimic joint="joint_2" multiplier="-1" offset="0.1"/>'


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot(ARM)


@pytest.fixture(scope="module")
def states(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    return robot.limits.drawn(rng, 6), *rng.normal(size=(2, 6, 6))


def edited(folder: Path, *changes: tuple[str, str]) -> Path:
    file = folder / "arm.urdf"
    file.write_text(ARM.read_text("utf-8"), encoding="utf-8")
    for old, new in changes:
        replace(file, old, new)
    return file


def test_a_follower_is_no_joint_of_a_posture(robot: Robot) -> None:
    assert robot.joints == ("joint_1", "joint_2", "joint_3b", "joint_4", "joint_5", "joint_6")
    np.testing.assert_array_equal(robot.coupling.matrix, G)
    # -3 <= 0.1 - q <= 1.4, and -1.6 <= q <= 2.2.
    np.testing.assert_allclose([robot.limits.lower[1], robot.limits.upper[1]], [-1.3, 2.2])


def test_kinematics_and_dynamics_are_those_of_the_full_arm_projected(
    robot: Robot, states: tuple[np.ndarray, ...]
) -> None:
    full, led = pin.buildModelFromUrdf(str(ARM)), pin.buildModelFromUrdf(str(ARM), mimic=True)
    data, led_data = full.createData(), led.createData()
    tool, axes = full.getFrameId("tool0"), pin.LOCAL_WORLD_ALIGNED
    kinematics, efforts, batch = (
        Kinematics(robot),
        Dynamics(robot).efforts(*states),
        Postures(robot).at(states[0]),
    )
    for k, (q, v, a) in enumerate(zip(*states, strict=True)):
        every = G @ q + OFFSET
        J = pin.computeFrameJacobian(full, data, every, tool, axes) @ G
        for own in (kinematics.tool_jacobian(q)[1], batch.jacobian[k]):
            np.testing.assert_allclose(own, J, atol=1e-12)
        np.testing.assert_allclose(batch.tool_point[k], data.oMf[tool].translation, atol=1e-12)
        np.testing.assert_allclose(
            kinematics.centre_of_mass(q)[1], pin.jacobianCenterOfMass(full, data, every) @ G, atol=1e-12
        )
        tau = pin.rnea(full, data, every, G @ v, G @ a)
        np.testing.assert_allclose(efforts.joint_torque[k], G.T @ tau, atol=1e-10)
        np.testing.assert_allclose(pin.rnea(led, led_data, q, v, a), G.T @ tau, atol=1e-10)
        # What the base bears, by the change of momentum of all that moves.
        pin.computeCentroidalMomentumTimeVariation(full, data, every, G @ v, G @ a)
        force = data.dhg.linear - data.mass[0] * full.gravity.linear
        torque = data.dhg.angular + np.cross(data.com[0], force)
        np.testing.assert_allclose(efforts.guardrail_wrench[k], -np.r_[force, torque], atol=1e-9)
    still = Dynamics(robot).static_efforts(states[0])
    np.testing.assert_allclose(batch.joint_torque, still.joint_torque, atol=1e-10)
    np.testing.assert_allclose(batch.guardrail_torque, still.guardrail_torque, atol=1e-10)
    names, poses = link_poses(robot, states[0])
    np.testing.assert_allclose(poses[:, names.index("tool0"), :3], batch.tool_point, atol=1e-12)


def test_derivatives_are_those_of_what_is_computed(robot: Robot, states: tuple[np.ndarray, ...]) -> None:
    dynamics, postures = Dynamics(robot), Postures(robot)
    rows, wrench = dynamics.derivatives(*states), dynamics.wrench_derivatives(*states)
    q, v, a = (each[0] for each in states)

    def efforts(x: np.ndarray) -> np.ndarray:
        found = dynamics.efforts(*x.reshape(3, 1, 6))
        return np.hstack([found.guardrail_wrench[0], found.joint_torque[0]])

    slopes = [
        np.hstack([d_q[0], d_v[0], d_a[0]])
        for d_q, d_v, d_a in ((each.d_q, each.d_v, each.d_a) for each in (wrench, rows))
    ]
    check_derivative(efforts, np.hstack([q, v, a]), np.vstack([slopes[0], slopes[1][3:]]))
    np.testing.assert_allclose(slopes[1][:3], slopes[0][3:], atol=1e-9)
    velocity, d_q = postures.tool_at(states[0]).point_velocity(states[1])
    np.testing.assert_allclose(velocity[0], postures.tool_at(q[None]).jacobian[0, :3] @ v, atol=1e-12)
    check_derivative(lambda x: postures.tool_at(x[None]).point_velocity(v[None])[0][0], q, d_q[0])


def test_distances_change_with_the_joint_that_leads(robot: Robot, states: tuple[np.ndarray, ...]) -> None:
    clearances, q = Clearances(robot, []), states[0]
    for posture in q:
        pair = int(clearances.query(posture[None]).pair[0])
        gradient = clearances.nearest(posture, pair).gradient

        def distance(x: np.ndarray, pair: int = pair) -> float:
            return float(clearances.distances(x[None], np.zeros(1, int), np.array([pair]))[0])

        step = 1e-6 * np.eye(6)
        slope = [(distance(posture + each) - distance(posture - each)) / 2e-6 for each in step]
        np.testing.assert_allclose(gradient, slope, atol=1e-5)
        # No distance changes by more than the joints' moves times their reach.
        assert (np.abs(gradient) <= clearances.pair_reach[pair] + 1e-9).all()
    many = np.concatenate([q + shift for shift in np.linspace(0, 0.02, 8)])
    assert (clearances.lower_bounds(many).min(axis=1) <= clearances.query(many).distance + 1e-9).all()


def test_the_bent_arm_sags_as_by_hinges(tmp_path: Path) -> None:
    tube = "{start_m: [0, 0, 0], end_m: [0, 0, 0.42], outer_diameter_m: 0.08, wall_m: 0.004, "
    tube += "young_pa: 7e10, shear_pa: 2.6e10}"
    joint = "joint_1: {stiffness_nm_rad: 4e4}"
    text = f"format: cmbot-elasticity/2\nlinks: {{link_2: {tube}}}\njoints: {{{joint}}}\n"
    (tmp_path / "arm.elasticity.yaml").write_text(text, encoding="utf-8")
    robot = load_robot(edited(tmp_path))
    q = robot.limits.drawn(np.random.default_rng(5), 4)
    sag = Sag(elastic_arm(robot, None))
    at, rigid = sag.at(q), Kinematics(robot).tool_poses(q)[0]
    bent = bent_tool_points(robot, None, q) - rigid
    np.testing.assert_allclose(at.tool, bent, atol=0.02 * np.abs(bent).max())
    np.testing.assert_allclose(sag.following(q), at.tool, atol=1e-9)
    check_derivative(lambda x: sag.at(x[None]).tool[0], q[0], at.d_tool[0], rtol=1e-5)
    replace(tmp_path / "arm.elasticity.yaml", "joint_1:", "joint_3:")
    with pytest.raises(
        ModelError, match=r"joints.joint_3: got a joint of a linkage \(mimic\), expected one that"
    ):
        load_robot(tmp_path / "arm.urdf")


def test_rates_of_a_follower_bound_those_of_its_leader(tmp_path: Path) -> None:
    robot = load_robot(edited(tmp_path, (MIMIC, MIMIC.replace('"-1"', '"-4"'))))
    assert robot.limits.velocity[1] == pytest.approx(2.6 / 4)
    assert robot.limits.acceleration[1] == pytest.approx(2 * 2.6 / 4)
    assert robot.limits.upper[1] == pytest.approx(3.1 / 4)
    # The linkage has no drive: what the leader's holds is what counts.
    assert robot.limits.torque[1] == 300


def test_a_leader_may_follow_and_come_after(tmp_path: Path) -> None:
    """A joint that follows one behind it, which follows the first: all by one coordinate."""
    limit = 'velocity="2.6" effort="300"/>'
    file = edited(tmp_path, (MIMIC, '<mimic joint="joint_1" multiplier="0.5"/>'))
    old = f'<axis xyz="0 1 0"/><limit lower="-1.6" upper="2.2" {limit}'
    replace(file, old, f'{old}<mimic joint="joint_3" multiplier="2" offset="0.3"/>')
    robot = load_robot(file)
    assert robot.joints == ("joint_1", "joint_3b", "joint_4", "joint_5", "joint_6")
    np.testing.assert_allclose(robot.coupling.positions(np.eye(5)[0])[:3], [1, 1.3, 0.5])


def test_a_follower_of_a_joint_before_the_arm_is_locked_with_it() -> None:
    robot = load_robot(ARM, base_frame="link_2", tool_frame="tool0", locked={"joint_2": 0.4})
    assert robot.joints == ("joint_3b", "joint_4", "joint_5", "joint_6")
    whole = Kinematics(load_robot(ARM))
    q = np.array([0.2, -0.3, 0.5, 0.1])
    expected = whole.tool_pose(np.r_[0.0, 0.4, q]).homogeneous
    np.testing.assert_allclose(Kinematics(robot).tool_pose(q).homogeneous, expected, atol=1e-9)
    assert any(
        each == "joint_3 follows joint_2, which does not move the arm: it is locked, too."
        for each in robot.remarks
    )


@pytest.mark.parametrize(
    ("mimic", "told"),
    [
        (
            '<mimic joint="nowhere"/>',
            r"joint\[joint_3\].mimic: got the joint 'nowhere', expected a joint that",
        ),
        ('<mimic joint="joint_3"/>', r"joint\[joint_3\].mimic: got joints that follow each other"),
        (
            '<mimic joint="joint_2" multiplier="0"/>',
            r"joint_3\].mimic.multiplier: got 0, expected .* type fixed",
        ),
        (
            '<mimic joint="joint_2" offset="9"/>',
            r"joint_3\].mimic: got a range, -3 to 1.4, that leaves joint_2 none",
        ),
    ],
)
def test_what_leads_nowhere_is_refused(tmp_path: Path, mimic: str, told: str) -> None:
    with pytest.raises(ModelError, match=told):
        load_robot(edited(tmp_path, (MIMIC, mimic)), base_frame="base_link", tool_frame="tool0")


def test_what_is_always_near_is_so_in_the_linkages_positions(tmp_path: Path) -> None:
    """The elbow is always near link_2 as joint_3 turns; where a linkage holds that one, it is not."""
    for mimic, checked in ((MIMIC, False), ('<mimic joint="joint_2" multiplier="1e-3"/>', True)):
        robot = load_robot(edited(tmp_path, (MIMIC, mimic)))
        pairs = {frozenset((each.link, each.other)) for each in Clearances(robot, []).pairs}
        assert ({"elbow", "link_2"} in pairs) == checked
