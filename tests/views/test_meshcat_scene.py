"""What the replay draws: every shape of the robot and of the scene, where and how it is."""

import base64
import dataclasses
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
import umsgpack

from cmbot.common.errors import ModelError
from cmbot.planning import Plan
from cmbot.robot import load_robot
from cmbot.views import replay_page
from cmbot.views.drawing.meshcat_scene import encoded, scene_commands


def drawn(plan: Plan) -> dict[str, list[trimesh.Trimesh]]:
    """Meshes that a page draws, by the first two parts of their path; colours in their metadata."""
    meshes: dict[str, list[trimesh.Trimesh]] = {}
    for text in encoded(scene_commands(plan)):
        command = umsgpack.unpackb(base64.b64decode(text))
        if command["type"] != "set_object":
            continue
        thing = command["object"]
        data = thing["geometries"][0]["data"]
        vertices = np.frombuffer(data["attributes"]["position"]["array"].data, "<f4").reshape(-1, 3)
        number = {"Uint16Array": "<u2", "Uint32Array": "<u4"}[data["index"]["type"]]
        faces = np.frombuffer(data["index"]["array"].data, number).reshape(-1, 3)
        mesh = trimesh.Trimesh(vertices, faces, process=False, metadata=thing["materials"][0])
        normals = np.frombuffer(data["attributes"]["normal"]["array"].data, "<i2").reshape(-1, 3) / 32767
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-3)
        meshes.setdefault("/".join(command["path"].split("/")[1:3]), []).append(mesh)
    return meshes


def with_visual(plan: Plan, geometry: Any, mesh_path: str = "") -> Plan:
    """Return the plan of a robot that looks like one shape, 0.1 m along x of joint 2."""
    placement = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    shape = pin.GeometryObject("only", 2, 0, placement, geometry, mesh_path)
    shape.meshColor = np.array([1.0, 0.5, 0.0, 0.5])
    visual = pin.GeometryModel()
    visual.addGeometryObject(shape)
    return dataclasses.replace(plan, robot=dataclasses.replace(plan.robot, read_visual_model=lambda: visual))


def shaded(rgb: np.ndarray) -> tuple[int, ...]:
    """A colour as it is drawn: of its own hue, no lighter than where shades can be seen."""
    luminance = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
    return tuple(round(255 * float(each) * min(1.0, 0.78 / luminance)) for each in rgb)


def test_the_robot_is_drawn_whole_in_its_colours(triangle_plan: Plan) -> None:
    robot, meshes = triangle_plan.robot, drawn(triangle_plan)
    shapes = list(robot.visual_model.geometryObjects)
    # The files themselves, by coal's usual kind of mesh.
    files = {shape.name: coal.MeshLoader().load(shape.meshPath, shape.meshScale) for shape in shapes}
    for joint in range(robot.model.njoints):
        own = [shape for shape in shapes if shape.parentJoint == joint]
        points = np.concatenate(
            [files[s.name].vertices() @ s.placement.rotation.T + s.placement.translation for s in own]
        )
        vertices = np.concatenate([mesh.vertices for mesh in meshes[f"robot/{joint}"]])
        np.testing.assert_allclose(vertices.min(axis=0), points.min(axis=0), atol=1e-6)
        np.testing.assert_allclose(vertices.max(axis=0), points.max(axis=0), atol=1e-6)
        colours = [mesh.metadata["color"] for mesh in meshes[f"robot/{joint}"]]
        assert {(c >> 16, c >> 8 & 255, c & 255) for c in colours} == {shaded(s.meshColor[:3]) for s in own}
    triangles = sum(len(m.faces) for name in meshes if name.startswith("robot") for m in meshes[name])
    assert triangles == sum(files[shape.name].num_tris for shape in shapes)
    # A longer tool is drawn longer.
    tips = []
    for length in (0.30, 0.45):
        other = dataclasses.replace(triangle_plan, robot=load_robot("cmbot", tool_length=length))
        tips.append(max(float(mesh.vertices[:, 2].max()) for mesh in drawn(other)["robot/7"]))
    assert tips[1] == pytest.approx(1.5 * tips[0], rel=1e-6)


def test_the_bridge_is_drawn_where_it_stands(triangle_plan: Plan) -> None:
    meshes = drawn(triangle_plan)
    bridge = {k: mesh for k, (mesh,) in enumerate(meshes[name] for name in ("bridge/0", "bridge/1", "rails"))}
    slab, workpiece, rails = bridge.values()
    assert len({mesh.metadata["color"] for mesh in bridge.values()}) == 3
    np.testing.assert_allclose(slab.bounds, [[-2, -1.4, -1.12], [4, -0.2, -1.0]], atol=1e-6)
    np.testing.assert_allclose(rails.bounds, [[-3.5375, -0.0375, -1.1], [3.5375, 0.0375, 0.05]], atol=1e-6)
    assert slab.volume == pytest.approx(6 * 1.2 * 0.12, rel=1e-5)
    assert workpiece.volume == pytest.approx(0.06**2 * (1.0 + 0.2 + 0.83), rel=1e-4)
    np.testing.assert_allclose(
        meshes["path"][0].centroid[0], triangle_plan.task.path.corners[0, 0], atol=1e-4
    )


BLOCK = coal.StdVec_Vec3s()
for corner in trimesh.creation.box((0.2, 0.3, 0.4)).vertices:
    BLOCK.append(corner)


@pytest.mark.parametrize(
    ("geometry", "size"),
    [
        (coal.Box(0.2, 0.3, 0.4), (0.2, 0.3, 0.4)),
        (coal.Cylinder(0.1, 0.4), (0.2, 0.2, 0.4)),
        (coal.Capsule(0.1, 0.4), (0.2, 0.2, 0.6)),
        (coal.Cone(0.1, 0.4), (0.2, 0.2, 0.4)),
        (coal.Sphere(0.1), (0.2, 0.2, 0.2)),
        (coal.Ellipsoid(0.1, 0.15, 0.2), (0.2, 0.3, 0.4)),
        (coal.Convex.convexHull(BLOCK, True, "Qt"), (0.2, 0.3, 0.4)),
        (coal.Plane(0, 0, 1, 0), None),
    ],
    ids=lambda value: type(value).__name__,
)
def test_every_shape_of_another_robot(triangle_plan: Plan, geometry: Any, size: Any) -> None:
    plan = with_visual(triangle_plan, geometry)
    if size is None:  # it cannot be drawn
        with pytest.raises(ModelError, match="visual only: got Plane"):
            replay_page(plan)
        return
    (mesh,) = drawn(plan)["robot/2"]
    np.testing.assert_allclose(mesh.extents, size, atol=2e-3)
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), [0.1, 0, 0], atol=1e-6)
    assert mesh.metadata["transparent"] is True
    assert mesh.metadata["opacity"] == 0.5
    assert mesh.is_winding_consistent
    assert mesh.volume > 0


def test_a_mesh_without_its_file_and_a_heavy_mesh(triangle_plan: Plan, tmp_path: Path) -> None:
    light, heavy = (trimesh.creation.icosphere(fineness, 0.3) for fineness in (2, 6))
    plans = []
    for name, mesh in (("light.stl", light), ("heavy.stl", heavy)):
        mesh.export(tmp_path / name)
        shape = coal.MeshLoader().load(str(tmp_path / name), np.ones(3))
        plans.append(with_visual(triangle_plan, shape, str(tmp_path / name)))
    (tmp_path / "light.stl").unlink()
    ((ball,), (simplified,)) = (drawn(plan)["robot/2"] for plan in plans)
    np.testing.assert_allclose(ball.extents, 0.6, atol=1e-5)
    assert len(heavy.faces) > 3 * 24_000
    assert 23_000 < len(simplified.faces) <= 24_000
    np.testing.assert_allclose(np.linalg.norm(simplified.vertices - [0.1, 0, 0], axis=1), 0.3, rtol=1e-3)
    assert len(replay_page(plans[1]).encode()) < 5_000_000
