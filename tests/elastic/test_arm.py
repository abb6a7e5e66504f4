"""The arm as driven joints and springs: beams in closed form, inertias kept, the rigid arm as its limit."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from elastic_robots import (
    SHEAR,
    YOUNG,
    FloatArray,
    cantilever,
    make_arm,
    mass_matrix,
    random_base,
    random_robot,
    second_moment,
)
from hypothesis import given, strategies as st
from oracles import beams
from robot_files import load_copy

from cmbot.common.errors import InputError
from cmbot.elastic.arm import ElasticArm, ElasticOptions, cut_inertia
from cmbot.robot import Dynamics, JointElasticity, Kinematics, Robot, turn_axis

SEGMENTS = (1, 2, 5)
HALF = np.array([0.5])


def compliance(arm: ElasticArm, q: FloatArray) -> FloatArray:
    """Displacement and turn (6, 6) of the tool under unit forces and moments at it, in W, undeformed."""
    u = np.zeros(len(arm.elastic))
    J = pin.computeFrameJacobian(
        arm.model,
        arm.model.createData(),
        arm.configuration(q, u),
        arm.tool_frame_id,
        pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
    )[:, arm.elastic]
    return np.asarray(J @ np.linalg.solve(arm.stiffness, J.T))


@pytest.mark.parametrize("segments", [1, 2, 7])
@pytest.mark.parametrize("direction", [0, 1, 2])
def test_a_cantilever_bends_as_a_beam(tmp_path: Path, segments: int, direction: int) -> None:
    L, area_moment = 0.7, second_moment()
    robot = cantilever(tmp_path, length=L, mass=1.0, direction=direction)
    u = np.eye(3)[direction]
    expected = beams.cantilever(
        along=L * u,
        moments=area_moment * (np.eye(3) - np.outer(u, u)),
        young=YOUNG,
        axial=np.inf,
        torsional=SHEAR * 2 * area_moment,
    )
    C = compliance(make_arm(robot, segments=segments), np.zeros(1))
    np.testing.assert_allclose(C, expected, rtol=0, atol=1e-12 * expected.max())


@pytest.mark.parametrize("segments", SEGMENTS)
def test_any_arm_bends_as_a_chain_of_beams(tmp_path: Path, rng: np.random.Generator, segments: int) -> None:
    """By unit loads: the bending energy of every tube, integrated exactly over its length."""
    robot = random_robot(tmp_path, rng, 5)
    springs = {
        "joint_2": JointElasticity(stiffness=2e3),
        "joint_5": JointElasticity(stiffness=5e3, tilting=1e4),
    }
    robot = replace(robot, joint_elasticity=springs)
    base = random_base(rng)
    q = rng.uniform(-2, 2, 5)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    tool = data.oMf[robot.tool_frame_id].translation
    # A load at the tool (rows: force, moment) as the load at another point.
    expected = _moved(tool).T @ np.linalg.inv(base.stiffness) @ _moved(tool)
    points, weights = np.polynomial.legendre.leggauss(3)
    for link, tube in robot.elasticity.items():
        X = data.oMf[robot.model.getFrameId(link)]
        start, end = X.act(np.array(tube.start)), X.act(np.array(tube.end))
        u = (end - start) / tube.length
        EI, GJ = tube.young * tube.second_moment, 2 * tube.shear * tube.second_moment
        flexibility = (np.eye(3) - np.outer(u, u)) / EI + np.outer(u, u) / GJ
        for x, w in zip((1 + points) / 2, weights / 2, strict=True):
            moment = _moved(tool - start - x * (end - start))[3:]
            expected += w * tube.length * moment.T @ flexibility @ moment
    for joint, spring in springs.items():
        X = data.oMi[robot.model.getJointId(joint)]
        axis = X.rotation @ turn_axis(robot.model.joints[robot.model.getJointId(joint)])
        turning = np.outer(axis, axis) / spring.stiffness
        if spring.tilting is not None:
            turning += (np.eye(3) - np.outer(axis, axis)) / spring.tilting
        moment = _moved(tool - X.translation)[3:]
        expected += moment.T @ turning @ moment
    got = compliance(make_arm(robot, base, segments=segments), q)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def _moved(arm: FloatArray) -> FloatArray:
    """Matrix (6, 6) from a force and moment at `arm` to those about the origin."""
    return np.asarray(pin.SE3(np.eye(3), arm).toDualActionMatrix())


def test_stiffness_factors(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    base = random_base(rng)
    usual = make_arm(cmbot_robot, base).stiffness
    factors = {"guardrail_factor": 0.7, "link_factor": 1.3, "joint_factor": 2.0}
    other = make_arm(cmbot_robot, base, **factors)
    names = [other.model.names[int(k) + 1] for k in other.elastic]
    kinds = [name.split()[0][:4] for name in names]
    factor = np.array([{"guar": 0.7, "link": 1.3, "join": 2.0}[kind] for kind in kinds])
    np.testing.assert_allclose(other.stiffness, factor[:, None] * usual, rtol=1e-14)
    drives = np.diag(usual)[[kind == "join" for kind in kinds]]
    np.testing.assert_array_equal(drives, [1e5, 1e5, 1e5, 5e4, 5e4, 2e4, 2e4])
    assert not other.damping.any()
    np.testing.assert_array_equal(usual[:6, :6], base.stiffness)
    assert not usual[:6, 6:].any()
    assert (usual == usual.T).all()


@st.composite
def bodies(draw: st.DrawFn) -> Any:
    """Anything from a point to a bulky body, by a cloud of points."""
    number = draw(st.integers(1, 6))
    coordinate = st.floats(-1, 1).map(lambda x: round(x, 3))
    total = pin.Inertia.Zero()
    for _ in range(number):
        point = np.array(draw(st.tuples(coordinate, coordinate, coordinate)))
        total += pin.Inertia(draw(st.floats(0.1, 3)), point, np.zeros((3, 3)))
    return total


@given(body=bodies(), segments=st.integers(1, 6), end=st.tuples(*[st.floats(0.05, 1)] * 3))
def test_pieces_are_possible_and_add_up(body: Any, segments: int, end: tuple[float, float, float]) -> None:
    start = np.array([0.1, -0.2, 0.0])
    cuts = (np.arange(segments) + 0.5) / segments
    pieces = cut_inertia(body, start, start + np.array(end), cuts)
    assert len(pieces) == segments + 1
    assert sum(piece.mass for piece in pieces) == pytest.approx(body.mass, rel=1e-13)
    moments = [piece.toPseudoInertia().toMatrix() for piece in pieces]
    np.testing.assert_allclose(sum(moments), body.toPseudoInertia().toMatrix(), rtol=0, atol=1e-12)
    for matrix in moments:
        assert np.linalg.eigvalsh(matrix)[0] > -1e-12


def rod(mass: float, centre: float, length: float) -> Any:
    """A uniform rod along x."""
    moment = mass * length**2 / 12
    return pin.Inertia(mass, np.array([centre, 0, 0]), np.diag([0, moment, moment]))


def cut(body: Any, length: float = 1.0, cuts: FloatArray = HALF) -> list[Any]:
    return cut_inertia(body, np.zeros(3), np.array([length, 0, 0]), cuts)


def test_a_uniform_tube_is_cut_where_it_is() -> None:
    pieces = cut(rod(2.0, 0.4, 0.8), 0.8, np.array([1, 3, 5, 7]) / 8)
    np.testing.assert_allclose([piece.mass for piece in pieces], [0.25, 0.5, 0.5, 0.5, 0.25], rtol=1e-12)
    lengths = np.array([0.1, 0.2, 0.2, 0.2, 0.1])
    # A quarter of their own second moment stays; the middles move apart for the rest.
    for piece, length in zip(pieces, lengths, strict=True):
        across = piece.mass * length**2 / 48
        np.testing.assert_allclose(piece.inertia, np.diag([0, across, across]), atol=1e-15)
    middles = np.array([-0.35, -0.2, 0, 0.2, 0.35])
    offsets = np.array([piece.lever[0] for piece in pieces]) - 0.4
    stretch = offsets[-1] / middles[-1]
    np.testing.assert_allclose(offsets, stretch * middles, atol=1e-12)
    assert 1.01 < stretch < 1.04


@pytest.mark.parametrize("centre", [0.45, 0.6, 0.73, 0.7499])
def test_no_piece_is_outside_the_rod(centre: float) -> None:
    """A rod half as long as the axis: cut in the middle, near its end, at its very end."""
    body = rod(1.0, centre, 0.5)
    near, far = cut(body)
    np.testing.assert_allclose([near.mass, far.mass], [1.5 - 2 * centre, 2 * centre - 0.5], rtol=1e-9)
    assert centre - 0.25 <= near.lever[0] + 1e-12
    assert far.lever[0] <= centre + 0.25 + 1e-12
    assert (near + far).isApprox(body, 1e-12)


def test_mass_stays_on_its_side_of_a_cut() -> None:
    head = pin.Inertia(3.0, np.array([0.9, 0.1, 0]), 1e-3 * np.eye(3))
    near, far = cut(head)
    assert near.mass == 0
    assert far.isApprox(head)
    assert [piece.mass for piece in cut(rod(1.0, 0.2, 0.0))] == [1.0, 0.0]
    assert [piece.mass for piece in cut(pin.Inertia.Zero())] == [0, 0]
    # Its radius of gyration would overflow.
    assert [piece.mass for piece in cut(pin.Inertia(5e-324, np.zeros(3), np.eye(3)))] == [0, 0]


def test_the_payload_is_at_the_end_of_a_bending_link(tmp_path: Path) -> None:
    without, loaded = (
        [inertia.mass for inertia in make_arm(robot, segments=2).model.inertias]
        for robot in (cantilever(tmp_path, length=0.7, mass=1.0, payload=payload) for payload in (0.0, 4.0))
    )
    difference = np.subtract(loaded, without)
    assert difference[-1] == pytest.approx(4.0)
    np.testing.assert_allclose(difference[:-1], 0, atol=1e-12)


def test_a_load_at_the_tool_of_a_softened_arm_counts_in_its_dynamics(cmbot_robot: Robot) -> None:
    arm = make_arm(cmbot_robot)
    q = np.full((1, cmbot_robot.dof), 0.3)
    rest, loaded = (Dynamics(each.robot).static_efforts(q) for each in (arm, arm.softened(1.0, 4.0)))
    point, J = (each[0] for each in Kinematics(cmbot_robot).tool_point_jacobians(q))
    push = np.array([0.0, 0.0, -4.0 * 9.81])
    np.testing.assert_allclose((loaded.guardrail_force - rest.guardrail_force)[0], push, atol=1e-9)
    torque = (loaded.guardrail_torque - rest.guardrail_torque)[0]
    np.testing.assert_allclose(torque, np.cross(point - cmbot_robot.foot_point, push), atol=1e-9)
    np.testing.assert_allclose((loaded.joint_torque - rest.joint_torque)[0], -J.T @ push, atol=1e-9)


@pytest.mark.parametrize("segments", SEGMENTS)
def test_undeformed_it_is_the_rigid_arm(
    cmbot_robot: Robot, tmp_path: Path, rng: np.random.Generator, segments: int
) -> None:
    for robot in (cmbot_robot, *(random_robot(tmp_path / str(n), rng, n) for n in (3, 5, 7))):
        n = robot.dof
        arm = make_arm(robot, random_base(rng), segments=segments)
        springs = 5 * segments * len(robot.elasticity) + len(robot.joint_elasticity)
        assert arm.model.nq == arm.model.nv == n + 6 + springs
        q, v, a = rng.uniform(-2, 2, (3, n))
        u = np.zeros(len(arm.elastic))
        full = arm.configuration(q, u)
        assert pin.computeTotalMass(arm.model) == pytest.approx(robot.mass, rel=1e-13)
        whole, fixed = arm.model.createData(), robot.model.createData()
        pin.framesForwardKinematics(arm.model, whole, full)
        X = Kinematics(robot).tool_pose(q)
        np.testing.assert_allclose(whole.oMf[arm.tool_frame_id].homogeneous, X.homogeneous, atol=1e-13)
        block = mass_matrix(arm.model, full)[np.ix_(arm.driven, arm.driven)]
        expected = mass_matrix(robot.model, q)
        np.testing.assert_allclose(block, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
        tau = pin.rnea(arm.model, whole, full, arm.configuration(v, u), arm.configuration(a, u))
        expected = pin.rnea(robot.model, fixed, q, v, a)
        np.testing.assert_allclose(tau[arm.driven], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
        # The load on the base is that of the whole robot.
        weight = pin.computeGeneralizedGravity(arm.model, whole, full)[arm.elastic[:6]]
        gravity = np.array([0, 0, -9.81])
        torque = np.cross(Kinematics(robot).centre_of_mass(q)[0], gravity * robot.arm_mass)
        expected = np.concatenate([gravity * robot.mass, torque + robot.carrier_torque])
        np.testing.assert_allclose(-weight, expected, atol=1e-10)


def test_order_of_the_coordinates(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    base = random_base(rng)
    arm = make_arm(cmbot_robot, base, segments=2)
    assert sorted([*arm.driven, *arm.elastic]) == list(range(arm.model.nv))
    names = list(arm.model.names)[1:]
    assert tuple(names[i] for i in arm.driven) == cmbot_robot.joints
    assert len(set(names)) == len(names)
    np.testing.assert_array_equal(arm.added_mass[:6, :6], base.mass)
    assert not arm.added_mass[6:].any()
    q, u = rng.uniform(-2, 2, (3, 7)), rng.normal(size=(3, len(arm.elastic)))
    joined = arm.configuration(q, u)
    np.testing.assert_array_equal(joined[:, arm.driven], q)
    np.testing.assert_array_equal(joined[:, arm.elastic], u)
    # The first six move the foot along and about the axes of W.
    J = pin.computeFrameJacobian(
        arm.model,
        arm.model.createData(),
        arm.configuration(q[0], 0 * u[0]),
        arm.tool_frame_id,
        pin.ReferenceFrame.WORLD,
    )
    np.testing.assert_allclose(J[:, arm.elastic[:6]], np.eye(6), atol=1e-14)
    for array in (arm.driven, arm.elastic, arm.stiffness, arm.added_mass):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_rigid_hold_and_rigid_links(urdf_folder: Path, rng: np.random.Generator) -> None:
    rigid, base = load_copy(urdf_folder).with_rigid_joints, random_base(rng)
    assert len(make_arm(rigid).elastic) == 0
    assert make_arm(rigid).stiffness.shape == (0, 0)
    np.testing.assert_array_equal(make_arm(rigid, base).stiffness, base.stiffness)


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"segments": 0}, "segments"),
        ({"segments": 51}, "segments"),
        ({"segments": True}, "segments"),
        ({"segments": 1.0}, "segments"),
        ({"guardrail_factor": 0.0}, "guardrail_factor"),
        ({"link_factor": float("nan")}, "link_factor"),
        ({"link_factor": float("inf")}, "link_factor"),
        ({"joint_factor": -1.0}, "joint_factor"),
    ],
)
def test_options_are_checked(options: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError) as caught:
        ElasticOptions(**options)
    assert (caught.value.source, caught.value.key) == ("ElasticOptions", key)
