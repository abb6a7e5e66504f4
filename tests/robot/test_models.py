"""The robot description that is checked in: up to date, physically possible, the same to three programs.

Its limits, masses and tool poses are tested on the loaded robot, in test_loading.py and test_kinematics.py.
"""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import combinations
from pathlib import Path

import cmbot_tables
import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yourdfpy
from oracles import chang2021_arm
from oracles.chang2021_arm import tensor

ROOT = Path(__file__).parents[2]
MODELS = ROOT / "models"
URDF = MODELS / "urdf" / "cmbot.urdf"
SRDF = MODELS / "urdf" / "cmbot.srdf"
TOOL = ROOT / "tools" / "build_models.py"

ARM = [f"joint_{i}" for i in range(1, 8)]
CLIMBING = [f"climb_{i}" for i in range(1, 6)]
CLIMBER = ["foot_1", "ankle_1", "leg_1", "arm_base", "leg_2", "ankle_2", "foot_2"]
TRIANGLE_DEG = [-10, -90, 90, 0, 10, 50, 0]
LINE_DEG = [-45, -90, 90, -10, 10, -55, 0]

# Chang 2021, Table 2, as printed.
TABLE_2_LINK_3_AND_4 = {3: (0.06, 0.56, 0.59, 0.011, 0.12, 0), 4: (0.05, 0.03, 0.03, -0.01, 0.01, 0)}


@pytest.fixture(scope="module")
def model():
    return pin.buildModelFromUrdf(str(URDF))


@pytest.fixture(scope="module")
def stance(model):
    pin.loadReferenceConfigurations(model, str(SRDF))
    return model.referenceConfigurations["working_stance"].copy()


@pytest.fixture(scope="module")
def root():
    return ET.parse(URDF).getroot()


def posture(model, stance, arm_deg):
    q = stance.copy()
    for name, angle in zip(ARM, np.deg2rad(arm_deg), strict=True):
        q[model.joints[model.getJointId(name)].idx_q] = angle
    return q


def pose(model, q, frame):
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(frame)]


def run_tool(*arguments):
    return subprocess.run(
        [sys.executable, "-B", str(TOOL), *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def contents(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_checked_in_files_are_what_the_tool_writes(tmp_path):
    missing = run_tool("--check", "--output", str(tmp_path))
    assert missing.returncode == 1
    assert "out of date: urdf/cmbot.srdf" in missing.stderr
    assert contents(tmp_path) == {}
    assert run_tool("--check").returncode == 0
    ran = run_tool("--output", str(tmp_path))
    assert ran.returncode == 0, ran.stderr
    written, checked_in = contents(tmp_path), contents(MODELS)
    assert written.keys() == checked_in.keys()
    assert [name for name in written if written[name] != checked_in[name]] == []


def test_tool_refuses_an_impossible_body(monkeypatch):
    monkeypatch.setattr(cmbot_tables, "CLIMBER_INERTIA", 0.3)
    with pytest.raises(SystemExit, match=r"ankle_1: .* no possible rigid body"):
        cmbot_tables.bodies()


def test_stance_hangs_the_arm_at_its_place(model, stance):
    X_WB = pose(model, stance, "arm_base")
    np.testing.assert_allclose(X_WB.translation, (0, 0.5, 0), atol=1e-12)
    np.testing.assert_allclose(X_WB.rotation, np.diag([1, -1, -1]), atol=1e-12)
    np.testing.assert_array_equal(stance[[model.joints[model.getJointId(n)].idx_q for n in ARM]], np.zeros(7))
    assert np.all(model.lowerPositionLimit <= stance)
    assert np.all(stance <= model.upperPositionLimit)


def test_arm_bodies_are_the_tables_and_every_body_is_possible():
    read = yourdfpy.URDF.load(str(URDF), build_scene_graph=False, load_meshes=False)
    bodies = {link.name: link.inertial for link in read.robot.links if link.inertial}
    for i in range(7):
        body = bodies[f"link_{i + 1}"]
        assert body.mass == chang2021_arm.MASS[i]
        np.testing.assert_array_equal(body.origin[:3, 3], chang2021_arm.CENTRE_OF_MASS[i])
        np.testing.assert_array_equal(body.inertia, tensor(chang2021_arm.INERTIA[i]))
    assert bodies.keys() == {*CLIMBER, *(f"link_{i}" for i in range(1, 8))}
    for name, body in bodies.items():
        np.testing.assert_array_equal(body.origin[:3, :3], np.eye(3))
        least, middle, most = np.linalg.eigvalsh(body.inertia)
        assert body.mass > 0, name
        assert least > 0, name
        assert most <= least + middle, name


@pytest.mark.parametrize(("link", "printed"), TABLE_2_LINK_3_AND_4.items())
def test_replaced_inertias_are_needed_and_near(link, printed):
    least, middle, most = np.linalg.eigvalsh(tensor(printed))
    excess = most - least - middle
    assert excess > 0.003  # Table 2's body is impossible
    # The boundary most = least + middle is a plane in the principal moments, excess / sqrt(3) away.
    distance = np.linalg.norm(tensor(chang2021_arm.INERTIA[link - 1]) - tensor(printed))
    assert distance == pytest.approx(excess / np.sqrt(3), abs=5e-5)


def test_three_programs_read_the_same_robot(model):
    # MuJoCo refuses impossible bodies (the file keeps it from balancing inertias).
    physics = mujoco.MjModel.from_xml_path(str(URDF))
    state = mujoco.MjData(physics)
    viewer = yourdfpy.URDF.load(str(URDF))
    masses = (
        # pinocchio files the fixed root link under the universe.
        pin.computeTotalMass(model) + model.inertias[0].mass,
        physics.body_mass.sum(),
        sum(link.inertial.mass for link in viewer.robot.links if link.inertial),
    )
    assert masses == pytest.approx((68.0, 68.0, 68.0), abs=1e-9)
    assert sorted(viewer.actuated_joint_names) == sorted(ARM + CLIMBING)
    random = np.random.default_rng(2793)
    for _ in range(10):
        angles = {name: random.uniform(-2, 2) for name in ARM + CLIMBING}
        q = np.array([angles[name] for name in list(model.names)[1:]])
        X_WT = pose(model, q, "tool0").homogeneous
        viewer.update_cfg(angles)
        np.testing.assert_allclose(viewer.get_transform("tool0", "foot_1"), X_WT, atol=1e-9)
        for name, angle in angles.items():
            state.joint(name).qpos = angle
        mujoco.mj_kinematics(physics, state)
        np.testing.assert_allclose(state.body("tool0").xpos, X_WT[:3, 3], atol=1e-9)
        np.testing.assert_allclose(state.body("tool0").xmat.reshape(3, 3), X_WT[:3, :3], atol=1e-9)


def placed_shapes(model, q):
    """Collision shapes, and where they and the frames are."""
    data = model.createData()
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION)
    placed = pin.GeometryData(geometry)
    pin.framesForwardKinematics(model, data, q)
    pin.updateGeometryPlacements(model, data, geometry, placed)
    return geometry, placed.oMg, data.oMf


def test_collision_shapes_are_primitives_and_capsules(model, root):
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION)
    stated = [(link, shape) for link in root.iter("link") for shape in link.findall("collision")]
    assert len({shape.get("name") for _, shape in stated}) == len(stated) == geometry.ngeoms
    built = {}
    for link, shape in stated:  # pinocchio names shapes LINK_NUMBER, counting from 0
        number = list(link.findall("collision")).index(shape)
        built[shape.get("name")] = geometry.geometryObjects[
            geometry.getGeometryId(f"{link.get('name')}_{number}")
        ].geometry
    capsules = {element.get("name") for element in root.iter("capsule")}
    assert {name for name, shape in built.items() if isinstance(shape, coal.Capsule)} == capsules
    assert all(isinstance(shape, coal.Capsule | coal.Cylinder | coal.Box) for shape in built.values())
    moving = [name for name in capsules if name.startswith(("link", "tool"))]
    arm = {name: (built[name].radius, 2 * built[name].halfLength) for name in moving}
    assert arm == {
        "link_1_capsule": (0.07, 0.83), "link_2_capsule": (0.06, 1.0), "link_3_capsule": (0.055, 0.78),
        "link_5_capsule": (0.05, 0.87), "tool_capsule": (0.04, 0.26),
    }  # fmt: skip


def test_arm_capsules_run_from_joint_to_joint(model, stance):
    geometry, shape_poses, frame_poses = placed_shapes(model, posture(model, stance, LINE_DEG))
    # link_4 and link_5 share a tube: its capsule belongs to link_5.
    frames = ["link_1", "link_2", "link_3", "link_4", "link_5", "tool0"]
    names = ["link_1", "link_2", "link_3", "link_5", "tool"]
    for start, end, name in zip(frames[:-1], frames[1:], names, strict=True):
        index = geometry.getGeometryId(f"{name}_0")
        shape, X_WC = geometry.geometryObjects[index].geometry, shape_poses[index]
        caps = [X_WC.act(np.array([0, 0, sign * shape.halfLength])) for sign in (-1, 1)]
        p_start, p_end = (frame_poses[model.getFrameId(frame)].translation for frame in (start, end))
        if name == "tool":  # the far cap ends at the tip, the centre of its sphere lies a radius before it
            p_end = p_end - shape.radius * frame_poses[model.getFrameId("tool0")].rotation[:, 2]
        np.testing.assert_allclose(caps, [p_start, p_end], atol=1e-12)


def test_srdf_names_exist(model, root):
    links = {link.get("name") for link in root.iter("link")}
    joints = {joint.get("name") for joint in root.iter("joint")}
    srdf = ET.parse(SRDF).getroot()
    pairs = [frozenset((pair.get("link1"), pair.get("link2"))) for pair in srdf.iter("disable_collisions")]
    assert len(set(pairs)) == len(pairs)
    assert all(len(pair) == 2 and pair <= links for pair in pairs)
    assert all(pair.get("reason") for pair in srdf.iter("disable_collisions"))
    assert {joint.get("name") for joint in srdf.iter("joint")} == {*CLIMBING, *ARM} <= joints
    chain = srdf.find("group[@name='arm']/chain")
    assert (chain.get("base_link"), chain.get("tip_link")) == ("arm_base", "tool0")
    assert {"arm_base", "tool0"} <= links


@pytest.mark.parametrize("arm_deg", [TRIANGLE_DEG, LINE_DEG])
def test_initial_postures_are_clear_of_the_robot_itself(cmbot_robot, arm_deg):
    robot, shapes = cmbot_robot.model, cmbot_robot.collision_model
    placed = pin.GeometryData(shapes)
    pin.computeDistances(robot, robot.createData(), shapes, placed, np.deg2rad(arm_deg))
    links = [robot.frames[shape.parentFrame].name for shape in shapes.geometryObjects]
    pairs = [frozenset((links[pair.first], links[pair.second])) for pair in shapes.collisionPairs]
    for pair, result in zip(pairs, placed.distanceResults, strict=True):
        # 0.15 m is d_s: nearer than that the path keeps away from obstacles. Link_1 turns beside leg_2.
        assert result.min_distance > (0.05 if pair == {"leg_2", "link_1"} else 0.15)
    found = set(pairs)
    moving = ("link_2", "link_3", "link_5", "tool")
    wanted = {frozenset((body, link)) for body in CLIMBER for link in moving}
    wanted |= {frozenset((body, "link_1")) for body in ("foot_1", "ankle_1", "leg_2", "ankle_2", "foot_2")}
    wanted |= {frozenset(("link_1", link)) for link in ("link_3", "link_5", "tool")}
    wanted |= {frozenset(pair) for pair in (("link_2", "link_5"), ("link_2", "tool"), ("link_3", "tool"))}
    assert found == wanted


def test_what_is_left_out_never_meets_in_any_stance(model):
    """The reasons that the SRDFs give for pairs of links that move against each other."""
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION)
    links = [model.frames[shape.parentFrame].name for shape in geometry.geometryObjects]
    entries = [entry for file in (SRDF, SRDF.with_name("climbing.srdf")) for entry in ET.parse(file).iter()]
    reasons = [(entry.get("reason", ""), entry.get("link1"), entry.get("link2")) for entry in entries]
    moving = [tuple(pair) for why, *pair in reasons if why.startswith("Never") and "locked" not in why]
    assert moving == [("leg_1", "link_1"), ("arm_base", "leg_2")]
    for i, j in combinations(range(len(links)), 2):
        if (links[i], links[j]) in moving or (links[j], links[i]) in moving:
            geometry.addCollisionPair(pin.CollisionPair(i, j))
    placed, data, rng = pin.GeometryData(geometry), model.createData(), np.random.default_rng(5)
    for q in rng.uniform(model.lowerPositionLimit, model.upperPositionLimit, (2000, model.nq)):
        pin.computeDistances(model, data, geometry, placed, q)
        assert min(result.min_distance for result in placed.distanceResults) > 0.01 - 1e-9


def test_climber_stays_compact_in_the_stance(model, stance):
    geometry, shape_poses, _ = placed_shapes(model, stance)
    for shape, X_WG in zip(geometry.geometryObjects, shape_poses, strict=True):
        if model.frames[shape.parentFrame].name in CLIMBER:
            shape.geometry.computeLocalAABB()
            box = shape.geometry.aabb_local
            centre = X_WG.act((box.min_ + box.max_) / 2)
            half = abs(X_WG.rotation) @ (box.max_ - box.min_) / 2
            assert abs(centre[0]) + half[0] <= 0.25, shape.name
            assert centre[1] - half[1] >= -0.05, shape.name
            assert centre[1] + half[1] <= 0.62, shape.name


def test_meshes_are_closed_small_and_all_used(root):
    files = sorted((MODELS / "meshes").iterdir())
    assert sum(path.stat().st_size for path in files) < 1_000_000
    used = {mesh.get("filename") for mesh in root.iter("mesh")}
    assert used == {f"../meshes/{path.name}" for path in files}
    for path in files:
        parts = trimesh.load_mesh(path).split(only_watertight=False)
        for part in parts:
            assert part.is_watertight, path.name
            assert part.is_winding_consistent, path.name
            assert part.volume > 0, path.name


def test_meshes_load_everywhere(model, root):
    count = len(list(root.iter("visual")))
    shown = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.VISUAL, None, str(URDF.parent))
    assert shown.ngeoms == count
    assert len(yourdfpy.URDF.load(str(URDF)).scene.geometry) == count
    physics = mujoco.MjModel.from_xml_path(str(URDF))
    assert physics.nmesh == len(list((MODELS / "meshes").iterdir()))
    materials = {material.get("name") for material in root.findall("material")}
    assert {visual.find("material").get("name") for visual in root.iter("visual")} == materials
