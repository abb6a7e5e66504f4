"""Static equilibrium: beams in closed form, potential energy, exact derivatives, the shipped robot."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from elastic_robots import (
    YOUNG,
    FloatArray,
    cantilever,
    make_arm,
    make_random_arm,
    random_base,
    random_robot,
    second_moment,
)
from finite_differences import check_derivative, finite_difference
from scipy.optimize import minimize

from cmbot.common.errors import InputError
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag
from cmbot.robot import Kinematics, Robot
from cmbot.scene import load_scene

EI = YOUNG * second_moment()


@pytest.fixture(scope="module")
def shipped_arm(cmbot_robot: Robot) -> ElasticArm:
    return make_arm(cmbot_robot, elastic_base(load_scene("triangle").elastic_guardrail))


@pytest.fixture(params=[3, 5, 7])
def random_arm(request: pytest.FixtureRequest, tmp_path: Path, rng: np.random.Generator) -> ElasticArm:
    return make_random_arm(tmp_path, rng, request.param)


def potential(arm: ElasticArm, q: FloatArray) -> Callable[[FloatArray], float]:
    """Energy of springs and weights, the carrier's included, J, as a function of the elastic coordinates."""
    data = arm.model.createData()

    def energy(u: FloatArray) -> float:
        weight = pin.computePotentialEnergy(arm.model, data, arm.configuration(q, u))
        return float(weight + u @ arm.stiffness @ u / 2)

    return energy


@pytest.mark.parametrize("segments", [1, 3])
def test_a_weight_at_the_end_of_a_cantilever(tmp_path: Path, segments: int) -> None:
    L, payload = 0.7, 1e-3  # light: the closed form is that of small deflections
    robot = cantilever(tmp_path, length=L, mass=1e-12, payload=payload)
    states = Sag(make_arm(robot, segments=segments)).at(np.zeros((1, 1)))
    weight = 9.81 * payload
    np.testing.assert_allclose(states.tool[0, 2], -weight * L**3 / (3 * EI), rtol=1e-6)
    np.testing.assert_allclose(states.rotation[0], [0, weight * L**2 / (2 * EI), 0], rtol=1e-6, atol=1e-15)


def test_a_cantilever_under_its_own_weight(tmp_path: Path) -> None:
    L, mass = 0.7, 0.01
    robot = cantilever(tmp_path, length=L, mass=mass)
    expected = -9.81 * mass * L**3 / (8 * EI)
    arms = [make_arm(robot, segments=segments) for segments in (1, 2, 4, 8)]
    errors = [Sag(arm).at(np.zeros((1, 1))).tool[0, 2] / expected - 1 for arm in arms]
    # By hand: two halves sqrt(5)/8 of the length from the middle.
    assert errors[0] == pytest.approx(8 * (1 / 24 + np.sqrt(5) / 32) - 1, rel=1e-5)
    for coarse, fine in pairwise(errors):
        assert 0 < -fine < -coarse / 4


def test_rigid_links_on_an_elastic_base(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    """With rigid links and a stiff hold: weight and its torque about O0 on the hold's compliance."""
    base, factor = random_base(rng), 1e4
    arm = make_arm(replace(cmbot_robot.with_rigid_joints, elasticity={}), base, guardrail_factor=factor)
    q = rng.uniform(-2, 2, (5, 7))
    states = Sag(arm).at(q)
    kinematics = Kinematics(cmbot_robot)
    gravity = np.array([0, 0, -9.81])
    for k in range(len(q)):
        centre = kinematics.centre_of_mass(q[k])[0]
        torque = np.cross(centre, gravity * cmbot_robot.arm_mass) + cmbot_robot.carrier_torque
        u = np.linalg.solve(factor * base.stiffness, [*gravity * cmbot_robot.mass, *torque])
        np.testing.assert_allclose(states.u[k], u, rtol=0, atol=1e-5 * np.abs(u).max())
        p = kinematics.tool_pose(q[k]).translation
        tool = u[:3] + np.cross(u[3:], p)
        np.testing.assert_allclose(states.tool[k], tool, rtol=0, atol=1e-5 * np.abs(tool).max())
        np.testing.assert_allclose(states.rotation[k], u[3:], rtol=0, atol=1e-5 * np.abs(u[3:]).max())


def test_equilibrium_minimises_the_energy(tmp_path: Path, rng: np.random.Generator) -> None:
    """A minimiser that knows nothing but the energy ends in the same place."""
    arm = make_arm(random_robot(tmp_path, rng, 3), random_base(rng), link_factor=0.05)
    q = rng.uniform(-2, 2, 3)
    u, energy = Sag(arm).at(q[None]).u[0], potential(arm, q)
    # Scaled to comparable springs, or the minimiser has a hard time.
    scale = 1 / np.sqrt(np.diag(arm.stiffness))
    found = minimize(lambda x: energy(scale * x), np.zeros(len(u)), method="BFGS", options={"gtol": 1e-6})
    np.testing.assert_allclose(scale * found.x, u, rtol=0, atol=1e-4 * np.abs(u).max())
    assert energy(u) <= found.fun + 1e-12 * abs(found.fun)


def test_forces_and_their_equilibrium(random_arm: ElasticArm, rng: np.random.Generator) -> None:
    q, u = rng.uniform(-2, 2, len(random_arm.driven)), rng.normal(scale=0.05, size=len(random_arm.elastic))
    data, sag, energy = random_arm.model.createData(), Sag(random_arm), potential(random_arm, q)

    def weight_at(angles: FloatArray, x: FloatArray) -> FloatArray:
        weight = pin.computeGeneralizedGravity(random_arm.model, data, random_arm.configuration(angles, x))
        return np.asarray(weight[random_arm.elastic])

    def force(x: FloatArray) -> FloatArray:
        return np.asarray(weight_at(q, x) + random_arm.stiffness @ x)

    check_derivative(energy, u, force(u), rtol=1e-7)
    tangent, by_joints = sag.balance_derivatives(q, u)
    check_derivative(force, u, tangent, rtol=1e-9)
    check_derivative(lambda x: weight_at(x, u), q, by_joints, rtol=1e-7)
    np.testing.assert_allclose(tangent, tangent.T, rtol=0, atol=1e-11 * np.abs(tangent).max())
    held = sag.at(q[None])
    slope = finite_difference(energy, held.u[0], step=1e-4)
    assert np.abs(slope).max() < 1e-6 * np.abs(random_arm.stiffness @ held.u[0]).max()
    check_derivative(lambda x: sag.at(x[None]).tool[0], q, held.d_tool[0], rtol=1e-7)


def test_a_force_on_the_tool_bends_as_a_weight_there_does(
    cmbot_robot: Robot, rng: np.random.Generator
) -> None:
    """A force that points straight down where the loaded arm comes to rest: there it is the load's weight."""
    base, q, mass = random_base(rng), rng.uniform(-2, 2, 7), 12.0
    model = cmbot_robot.model.copy()
    tool = model.frames[cmbot_robot.tool_frame_id]
    point = pin.Inertia(mass, tool.placement.translation, np.zeros((3, 3)))
    model.appendBodyToJoint(tool.parentJoint, point, pin.SE3.Identity())
    rigid = {"elasticity": {}}  # so that no load is cut with a link
    loaded = Sag(make_arm(replace(cmbot_robot, model=model, **rigid), base)).at(q[None])
    R_WT = pin.exp3(loaded.rotation[0]) @ Kinematics(cmbot_robot).tool_pose(q).rotation
    x, y, z = R_WT.T @ [0, 0, -9.81 * mass]
    pushed = Sag(make_arm(replace(cmbot_robot, tool_force=(x, y, z), **rigid), base)).at(q[None])
    np.testing.assert_allclose(pushed.u, loaded.u, rtol=0, atol=1e-9 * np.abs(loaded.u).max())
    alone = Sag(make_arm(replace(cmbot_robot, **rigid), base)).at(q[None])
    assert np.linalg.norm(loaded.u - alone.u) > 1e-4


def test_derivatives_with_a_force_that_turns_with_the_tool(
    random_arm: ElasticArm, rng: np.random.Generator
) -> None:
    robot = replace(random_arm.robot, tool_force=(20.0, -30.0, 40.0))
    arm = make_arm(robot, random_arm.base, segments=2, link_factor=0.05)
    sag, f, data = Sag(arm), arm.elastic, arm.model.createData()
    q, u = rng.uniform(-2, 2, len(arm.driven)), rng.normal(scale=0.02, size=len(f))

    def balance(angles: FloatArray, x: FloatArray) -> FloatArray:
        """By virtual work: the force pushes along the way of the tool point."""
        configuration = arm.configuration(angles, x)
        weight = pin.computeGeneralizedGravity(arm.model, data, configuration).copy()
        frame = pin.ReferenceFrame.LOCAL
        J = pin.computeFrameJacobian(arm.model, data, configuration, arm.tool_frame_id, frame)
        return np.asarray((weight - J[:3].T @ robot.tool_force)[f] + arm.stiffness @ x)

    tangent, by_joints = sag.balance_derivatives(q, u)
    check_derivative(lambda x: balance(q, x), u, tangent, rtol=1e-9)
    check_derivative(lambda x: balance(x, u), q, by_joints, rtol=1e-7)
    held = sag.at(q[None])
    assert np.abs(balance(q, held.u[0])).max() < 1e-6 * np.abs(arm.stiffness @ held.u[0]).max()
    check_derivative(lambda x: sag.at(x[None]).tool[0], q, held.d_tool[0], rtol=1e-7)


def test_derivatives_of_the_shipped_robot(shipped_arm: ElasticArm, rng: np.random.Generator) -> None:
    sag = Sag(shipped_arm)
    for q in rng.uniform(-2, 2, (3, 7)):
        check_derivative(lambda x: sag.at(x[None]).tool[0], q, sag.at(q[None]).d_tool[0], rtol=1e-7)


def test_states_are_independent(shipped_arm: ElasticArm, rng: np.random.Generator) -> None:
    sag = Sag(shipped_arm)
    q = rng.uniform(-2, 2, (4, 7))
    together = sag.at(q)
    for k in range(len(q)):
        alone = Sag(shipped_arm).at(q[k : k + 1])
        for name in ("u", "tool", "rotation", "d_tool"):
            np.testing.assert_array_equal(getattr(alone, name)[0], getattr(together, name)[k])
    none = sag.at(q[:0])
    assert (none.u.shape, none.tool.shape, none.d_tool.shape) == ((0, 33), (0, 3), (0, 3, 7))


def test_postures_that_follow_on_one_another(shipped_arm: ElasticArm, rng: np.random.Generator) -> None:
    """And those that do not."""
    sag, ends = Sag(shipped_arm), rng.uniform(-2, 2, (2, 7))
    for q in (np.linspace(*ends, 200), rng.uniform(-2, 2, (5, 7)), ends[:0]):
        np.testing.assert_allclose(sag.following(q), sag.at(q).tool, rtol=0, atol=1e-8)


@pytest.mark.parametrize("share", [0.9, 0.98, 1.0])
def test_distances_above_a_threshold_are_exact(
    shipped_arm: ElasticArm, rng: np.random.Generator, share: float
) -> None:
    """And no other one is said to be above it."""
    sag, q = Sag(shipped_arm), np.linspace(*rng.uniform(-1, 1, (2, 7)), 300)
    exact = sag.distance(q)
    above = share * float(exact.max())
    known = sag.distance(q, above)
    assert exact[exact > above] == pytest.approx(known[exact > above], rel=1e-9)
    assert (known[exact <= above] <= above * (1 + 1e-9)).all()
    assert np.abs(known / exact - 1).max() < 0.01
    assert (known != exact).any()


def test_a_rigid_arm_does_not_sag(cmbot_robot: Robot, tmp_path: Path, rng: np.random.Generator) -> None:
    q = rng.uniform(-2, 2, (2, 7))
    for robot in (cmbot_robot, cantilever(tmp_path, length=1.0, mass=1.0)):
        sag = Sag(make_arm(replace(robot.with_rigid_joints, elasticity={})))
        states = sag.at(q[:, : robot.dof])
        np.testing.assert_allclose(sag.following(q[:, : robot.dof]), 0, atol=1e-14)
        assert states.u.shape == (2, 0)
        assert states.d_tool.shape == (2, 3, robot.dof)
        for array in (states.tool, states.rotation, states.d_tool):
            np.testing.assert_allclose(array, 0, atol=1e-14)


@pytest.mark.parametrize("factor", [1e3, 1e6, 1e9])
def test_stiffer_sags_less(cmbot_robot: Robot, rng: np.random.Generator, factor: float) -> None:
    base, q = random_base(rng), rng.uniform(-2, 2, (1, 7))
    soft = Sag(make_arm(cmbot_robot, base)).at(q)
    factors = {f"{part}_factor": factor for part in ("guardrail", "link", "joint")}
    stiff = Sag(make_arm(cmbot_robot, base, **factors)).at(q)
    np.testing.assert_allclose(factor * stiff.u, soft.u, rtol=0, atol=0.1 * np.abs(soft.u).max())
    assert np.abs(stiff.tool).max() < 2 / factor * np.abs(soft.tool).max() + 1e-15


def test_a_column_stands_up_to_eulers_load(tmp_path: Path) -> None:
    L = 2.0
    critical = np.pi**2 * EI / (4 * L**2) / 9.81
    upright, hanging = np.array([[np.pi / 2]]), np.array([[-np.pi / 2]])
    mount = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3)).homogeneous

    def sag(share: float) -> Sag:
        robot = cantilever(tmp_path, length=L, mass=1e-9, payload=share * critical, mount=mount)
        return Sag(make_arm(robot, segments=10))

    np.testing.assert_allclose(sag(0.99).at(upright).tool, 0, atol=1e-6)
    over = sag(1.01)
    np.testing.assert_allclose(over.at(hanging).tool, 0, atol=1e-6)
    with pytest.raises(InputError, match=r"Sag.at: q\[1\]: got a posture from which the arm topples"):
        over.at(np.vstack((hanging, upright)))


def test_too_soft_an_arm_is_refused(cmbot_robot: Robot) -> None:
    scene = load_scene("triangle")
    base = elastic_base(scene.elastic_guardrail)
    for factor in (1e-9, 1e-6, 1e-4):
        sag = Sag(make_arm(cmbot_robot, base, guardrail_factor=factor, link_factor=factor))
        with pytest.raises(InputError, match=r"Sag.at: q\[0\]: .*stiff enough"):
            sag.at(scene.posture[None])


def test_segments_converge_on_the_shipped_robot(cmbot_robot: Robot) -> None:
    scene = load_scene("triangle")
    base, q = elastic_base(scene.elastic_guardrail), scene.posture[None]
    one, two, four, eight = (
        Sag(make_arm(cmbot_robot, base, segments=segments)).at(q).tool[0] for segments in (1, 2, 4, 8)
    )
    for coarse, share in ((one, 0.005), (two, 0.001), (four, 0.0002)):
        assert np.linalg.norm(coarse - eight) < share * np.linalg.norm(eight)
