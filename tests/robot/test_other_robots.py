"""Robots that are not ours: a Panda with meshes and fingers, a Kinova with continuous joints."""

from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from robot_files import FLAT, load_copy, replace, write_flat_obj
from scipy.spatial import ConvexHull
from state_samples import StateSamples
from urdf_arms import KINOVA, KINOVA_JOINTS, PANDA, PANDA_JOINTS, limits_file

from cmbot.robot import Dynamics, Kinematics, Robot, load_robot


@pytest.fixture(scope="module")
def panda(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    limits = limits_file(tmp_path_factory.mktemp("panda"), PANDA_JOINTS)
    return load_robot(PANDA, base_frame="panda_link0", tool_frame="panda_hand", limits=limits)


@pytest.fixture(scope="module")
def kinova(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    limits = limits_file(tmp_path_factory.mktemp("kinova"), KINOVA_JOINTS)
    return load_robot(KINOVA, base_frame="base", tool_frame="j2s6s200_end_effector", limits=limits)


def test_arm_of_the_panda(panda: Robot, tmp_path: Path) -> None:
    assert panda.joints == PANDA_JOINTS
    assert panda.limits.upper[0] == 2.8973
    assert (panda.limits.torque == [87, 87, 87, 87, 12, 12, 12]).all()
    np.testing.assert_allclose(panda.limits.acceleration, np.deg2rad(200))
    # The fingers slide, but not on the way to the hand.
    reference = pin.buildModelFromUrdf(str(PANDA))
    assert panda.arm_mass == pytest.approx(sum(inertia.mass for inertia in reference.inertias[1:]))
    assert panda.carrier_mass == pytest.approx(reference.inertias[0].mass)
    limits = limits_file(tmp_path, PANDA_JOINTS)
    finger = load_robot(PANDA, base_frame="panda_link0", tool_frame="panda_leftfinger", limits=limits)
    assert finger.joints == (*PANDA_JOINTS, "panda_finger_joint1")
    assert finger.limits.prismatic.tolist() == [False] * 7 + [True]


def test_continuous_joints_have_one_coordinate_and_no_range(kinova: Robot) -> None:
    assert kinova.joints == KINOVA_JOINTS
    assert kinova.model.nq == kinova.model.nv == 6
    np.testing.assert_array_equal(np.isinf(kinova.limits.upper), [1, 0, 0, 1, 0, 1])
    np.testing.assert_array_equal(np.isinf(kinova.limits.lower), [1, 0, 0, 1, 0, 1])
    q = np.array([100.0, 3.0, 3.0, -100.0, 3.0, 50.0])
    np.testing.assert_array_equal(kinova.posture(q), q)
    turned = q + 2 * np.pi * np.array([1, 0, 0, -1, 0, 2])
    poses = [Kinematics(kinova).tool_pose(x).homogeneous for x in (q, turned)]
    np.testing.assert_allclose(poses[0], poses[1], rtol=0, atol=1e-12)


def test_kinova_is_the_reference_model(kinova: Robot, random_states: StateSamples) -> None:
    """Continuous joints as unit circles, as pinocchio reads them."""
    reference = pin.buildModelFromUrdf(str(KINOVA))
    data = reference.createData()
    q, v, a = random_states(kinova, 20)
    got = Dynamics(kinova).efforts(q, v, a).joint_torque
    for k in range(len(q)):
        coordinates = pin.integrate(reference, pin.neutral(reference), q[k])
        expected = pin.rnea(reference, data, coordinates, v[k], a[k])
        np.testing.assert_allclose(got[k], expected, rtol=0, atol=1e-11)


def test_collision_meshes_become_their_convex_hulls(panda: Robot) -> None:
    loader = coal.MeshLoader(coal.NODE_TYPE.BV_OBBRSS)
    meshes = [shape for shape in panda.collision_model.geometryObjects if shape.meshPath.endswith(".stl")]
    assert len(meshes) >= 8
    for shape in meshes:
        hull = shape.geometry
        assert isinstance(hull, coal.ConvexBase)
        vertices = loader.load(shape.meshPath, shape.meshScale).vertices()
        points = np.array([hull.point(i) for i in range(hull.num_points)])
        # Every vertex of the mesh lies in the hull, every point of the hull is one of them.
        planes = ConvexHull(points).equations
        assert (vertices @ planes[:, :3].T + planes[:, 3]).max() < 1e-9
        nearest = np.linalg.norm(points[:, None] - vertices, axis=2).min(axis=1)
        assert nearest.max() < 1e-12


def test_distance_to_a_hull_is_never_more_than_to_its_mesh(kinova: Robot, rng: np.random.Generator) -> None:
    """These meshes are not convex, so mesh and hull differ."""
    shape = next(s for s in kinova.collision_model.geometryObjects if s.name == "j2s6s200_link_2_0")
    mesh = coal.MeshLoader(coal.NODE_TYPE.BV_OBBRSS).load(shape.meshPath, shape.meshScale)
    ball, here = coal.Sphere(0.01), coal.Transform3s()
    for _ in range(50):
        there = coal.Transform3s(np.eye(3), rng.uniform(-0.6, 0.6, 3))
        request = coal.DistanceRequest()
        to_hull = coal.distance(shape.geometry, here, ball, there, request, coal.DistanceResult())
        to_mesh = coal.distance(mesh, here, ball, there, request, coal.DistanceResult())
        assert to_hull <= to_mesh + 1e-6


def test_tool_with_a_mesh_is_stretched(
    panda: Robot, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    options: dict[str, Any] = {"base_frame": "panda_link0", "tool_frame": "panda_hand_tcp"}
    # The tool point lies 0.1034 m ahead of the hand.
    limits = limits_file(tmp_path, PANDA_JOINTS)
    longer = load_robot(PANDA, limits=limits, tool_length=0.2068, **options)
    assert capfd.readouterr() == ("", "")
    (before,) = (s for s in panda.collision_model.geometryObjects if s.name == "panda_hand_0")
    (after,) = (s for s in longer.collision_model.geometryObjects if s.name == "panda_hand_0")
    flange = panda.model.frames[panda.model.getFrameId("panda_hand")].placement
    extents = []
    for shape in (before, after):
        X_FS = flange.inverse() * shape.placement
        points = [X_FS.act(shape.geometry.point(i)) for i in range(shape.geometry.num_points)]
        extents.append(np.array([np.min(points, axis=0), np.max(points, axis=0)]))
    np.testing.assert_allclose(extents[1], extents[0] * [1, 1, 2], rtol=0, atol=1e-9)


@pytest.mark.parametrize("vertices", FLAT.values(), ids=FLAT.keys())
def test_a_mesh_without_volume_is_a_millimetre_thick(urdf_folder: Path, vertices: list[list[float]]) -> None:
    """Its hull has all of it, and nothing that is further than half a millimetre from it in any direction."""
    write_flat_obj(urdf_folder / "flat.obj", vertices)
    replace(urdf_folder / "cmbot.urdf", '<box size="0.13 0.05 0.15" />', '<mesh filename="flat.obj" />')
    robot = load_copy(urdf_folder)
    assert "Flat collision meshes count as 1 mm thick: of foot_1, foot_2." in robot.remarks
    (shape,) = (each for each in robot.collision_model.geometryObjects if each.name == "foot_1_0")
    points = np.array([shape.geometry.point(k) for k in range(shape.geometry.num_points)])
    planes = ConvexHull(points).equations
    inside = -(np.array(vertices) @ planes[:, :3].T + planes[:, 3])
    assert inside.min() >= -1e-7  # planes of qhull merge those that are nearly one
    thickness = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] / np.sqrt(len(points))
    assert thickness == pytest.approx(0.5e-3, rel=0.2)
    directions = np.random.default_rng(2).normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    further = (points @ directions.T).max(axis=0) - (np.array(vertices) @ directions.T).max(axis=0)
    # Across a line there are two directions in which it is moved.
    assert further.max() <= 0.5e-3 * np.sqrt(2) + 1e-12
