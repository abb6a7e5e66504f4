"""The shapes that are checked in: collision primitives, the pairs of the SRDF, and the looks."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yourdfpy

MODELS = Path(__file__).parents[2] / "models"
URDF = MODELS / "urdf" / "cmbot.urdf"
SRDF = MODELS / "urdf" / "cmbot.srdf"

ARM = [f"joint_{i}" for i in range(1, 8)]
CLIMBING = [f"climb_{i}" for i in range(1, 6)]
CLIMBER = ["foot_1", "ankle_1", "leg_1", "arm_base", "leg_2", "ankle_2", "foot_2"]
TRIANGLE_DEG = [-10, -90, 90, 0, 10, 50, 0]
LINE_DEG = [-45, -90, 90, -10, 10, -55, 0]
ENABLED_MARGIN = 0.15  # m, d_s: below it the path keeps away from obstacles


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
    q = posture(model, stance, LINE_DEG)
    data = model.createData()
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION)
    placed = pin.GeometryData(geometry)
    pin.framesForwardKinematics(model, data, q)
    pin.updateGeometryPlacements(model, data, geometry, placed)
    # link_4 and link_5 share a tube: its capsule belongs to link_5.
    frames = ["link_1", "link_2", "link_3", "link_4", "link_5", "tool0"]
    for start, end, name in zip(
        frames, frames[1:], ["link_1", "link_2", "link_3", "link_5", "tool"], strict=False
    ):
        index = geometry.getGeometryId(f"{name}_0")
        shape, X_WC = geometry.geometryObjects[index].geometry, placed.oMg[index]
        caps = [X_WC.act(np.array([0, 0, sign * shape.halfLength])) for sign in (-1, 1)]
        p_start, p_end = (data.oMf[model.getFrameId(frame)].translation for frame in (start, end))
        if name == "tool":  # the far cap ends at the tip, the centre of its sphere lies a radius before it
            p_end = p_end - shape.radius * data.oMf[model.getFrameId("tool0")].rotation[:, 2]
        np.testing.assert_allclose(caps, [p_start, p_end], atol=1e-12)


def test_srdf_names_exist(model, root):
    links = {link.get("name") for link in root.iter("link")}
    joints = {joint.get("name") for joint in root.iter("joint")}
    srdf = ET.parse(SRDF).getroot()
    pairs = [frozenset((pair.get("link1"), pair.get("link2"))) for pair in srdf.iter("disable_collisions")]
    assert len(set(pairs)) == len(pairs)
    assert all(len(pair) == 2 and pair <= links for pair in pairs)
    assert all(pair.get("reason") for pair in srdf.iter("disable_collisions"))
    assert {joint.get("name") for joint in srdf.iter("joint")} == set(CLIMBING) <= joints
    chain = srdf.find("group[@name='arm']/chain")
    assert (chain.get("base_link"), chain.get("tip_link")) == ("arm_base", "tool0")
    assert {"arm_base", "tool0"} <= links


def distances(model, q):
    """Smallest distance of every pair of links whose collision check is enabled."""
    data = model.createData()
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION)
    geometry.addAllCollisionPairs()
    pin.removeCollisionPairs(model, geometry, str(SRDF))
    placed = pin.GeometryData(geometry)
    pin.computeDistances(model, data, geometry, placed, q)
    found: dict[frozenset[str], float] = {}
    for pair, result in zip(geometry.collisionPairs, placed.distanceResults, strict=True):
        parents = (geometry.geometryObjects[index].parentFrame for index in (pair.first, pair.second))
        links = frozenset(model.frames[frame].name for frame in parents)
        found[links] = min(found.get(links, np.inf), result.min_distance)
    return found


@pytest.mark.parametrize("arm_deg", [TRIANGLE_DEG, LINE_DEG])
def test_initial_postures_are_clear_of_the_robot_itself(model, stance, arm_deg):
    found = distances(model, posture(model, stance, arm_deg))
    assert min(found.values()) > ENABLED_MARGIN
    moving = ("link_2", "link_3", "link_5", "tool")
    wanted = {frozenset((body, link)) for body in CLIMBER for link in moving}
    wanted |= {frozenset((body, "link_1")) for body in ("foot_1", "ankle_1", "ankle_2", "foot_2")}
    wanted |= {frozenset(("link_1", link)) for link in ("link_3", "link_5", "tool")}
    wanted |= {frozenset(pair) for pair in (("link_2", "link_5"), ("link_2", "tool"), ("link_3", "tool"))}
    assert found.keys() == wanted


def test_legs_stay_above_the_sweep_of_link_1(model, stance):
    """The reason that the SRDF gives for leaving out link_1 against the legs."""
    data = model.createData()
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION)
    names = [shape.name for shape in geometry.geometryObjects]
    for leg in (name for name in names if name.startswith("leg_")):
        geometry.addCollisionPair(pin.CollisionPair(names.index(leg), names.index("link_1_0")))
    placed = pin.GeometryData(geometry)
    assert len(geometry.collisionPairs) == 3
    for turn_deg in np.linspace(-170, 170, 69):
        q = posture(model, stance, [turn_deg, 0, 0, 0, 0, 0, 0])
        pin.computeDistances(model, data, geometry, placed, q)
        assert min(result.min_distance for result in placed.distanceResults) > 0.12 - 0.07 - 1e-6


def test_climber_stays_compact_in_the_stance(model, stance):
    data = model.createData()
    geometry = pin.buildGeomFromUrdf(model, str(URDF), pin.GeometryType.COLLISION)
    placed = pin.GeometryData(geometry)
    pin.framesForwardKinematics(model, data, stance)
    pin.updateGeometryPlacements(model, data, geometry, placed)
    for shape, X_WG in zip(geometry.geometryObjects, placed.oMg, strict=True):
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
