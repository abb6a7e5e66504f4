"""What a robot's files may be and hold: each refusal is one line that names file and key, and comes soon."""

import os
import re
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import pytest
from robot_files import load_copy, replace
from urdf_arms import ROBOTS, limits_file

from cmbot.common.errors import ModelError
from cmbot.robot import Robot, faces_of, inspect_loaded, inspect_urdf, load_robot, parse_urdf, robot_files

BOX = '<box size="0.13 0.05 0.15" />'
FOOT = '<link name="foot_1">'
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
INERTIA = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/>'


def refused(folder: Path, source: str = "cmbot.urdf", **options: Any) -> ModelError:
    with pytest.raises(ModelError) as caught:
        load_copy(folder, **options)
    assert caught.value.source == str(folder / source)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    return caught.value


def chain(folder: Path, turning: int, fixed: int, parts: str = "") -> Path:
    """An arm of links in a row, the first ones turned by joints, the others fixed."""
    urdf = ['<robot name="chain"><link name="l0"/>']
    for k in range(1, turning + fixed + 1):
        kind, limit = ("revolute", LIMIT) if k <= turning else ("fixed", "")
        urdf.append(
            f'<link name="l{k}">{INERTIA}{parts}</link><joint name="j{k}" type="{kind}">'
            f'<parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="0 0 0.01"/>{limit}</joint>'
        )
    file = folder / "chain.urdf"
    file.write_text("".join(urdf) + "</robot>")
    limits_file(folder, [f"j{k}" for k in range(1, turning + 1)]).rename(folder / "joint_limits.yaml")
    return file


@pytest.mark.parametrize("name", ["cmbot.urdf", "cmbot.srdf", "joint_limits.yaml", "cmbot.elasticity.yaml"])
def test_pipes_are_not_read(urdf_folder: Path, name: str) -> None:
    (urdf_folder / name).unlink(missing_ok=True)
    os.mkfifo(urdf_folder / name)
    assert refused(urdf_folder, name).got == "something that is not a regular file"


@pytest.mark.parametrize("name", ["cmbot.urdf", "cmbot.srdf", "joint_limits.yaml"])
def test_large_and_empty_files(urdf_folder: Path, name: str) -> None:
    (urdf_folder / name).write_bytes(b"")
    assert "an empty file" in str(refused(urdf_folder, name))
    os.truncate(urdf_folder / name, 10**12)
    assert "a larger file, expected at most" in str(refused(urdf_folder, name))


@pytest.mark.parametrize("place", ["collision", "visual"])
@pytest.mark.parametrize("kind", ["pipe", "empty", "large", "folder", "missing", "pipe of materials"])
def test_meshes_are_files(urdf_folder: Path, kind: str, place: str) -> None:
    text = (urdf_folder / "cmbot.urdf").read_text()
    shape = f'<{place}><geometry><mesh filename="part.obj" /></geometry></{place}>'
    (urdf_folder / "cmbot.urdf").write_text(text.replace(FOOT, f"{FOOT}{shape}"))
    mesh, expected = urdf_folder / "part.obj", "a mesh file"
    if kind == "pipe":
        os.mkfifo(mesh)
    elif kind == "folder":
        mesh.mkdir()
    elif kind == "pipe of materials":
        os.mkfifo(urdf_folder / "red paint.mtl")
        mesh.write_text("mtllib  red paint.mtl\r\n" + TETRAHEDRON)
        expected = "a file of materials"
    elif kind != "missing":
        mesh.touch()
        os.truncate(mesh, 10**12 if kind == "large" else 0)
        expected = "at most 50 MB" if kind == "large" else expected
    if place == "collision":
        error = refused(urdf_folder)
        assert (error.key, error.expected) == ("link[foot_1].mesh.filename", expected)
        assert str(error.got).startswith("'part.obj', ")
        return
    robot = load_copy(urdf_folder)
    (remark,) = (each for each in robot.remarks if "part.obj" in each)
    assert remark.startswith(
        "Visual meshes that cannot be used are drawn as boxes: link[foot_1].mesh.filename"
    )
    (warning,) = (
        found for found in inspect_loaded(robot_files(urdf_folder / "cmbot.urdf")) if "part.obj" in found.got
    )
    assert (warning.severity, warning.key) == ("warning", "link[foot_1].mesh.filename")
    (drawn,) = robot.visual_model.geometryObjects
    assert isinstance(drawn.geometry, coal.Box)
    assert_stands_in(drawn, robot)


def assert_stands_in(drawn: Any, robot: Robot) -> None:
    """A box in place of the first foot's visual shape is its collision shape, which is one."""
    (shape,) = (each for each in robot.collision_model.geometryObjects if each.name.startswith("foot_1_"))
    np.testing.assert_allclose(drawn.geometry.halfSide, shape.geometry.halfSide, atol=1e-9)
    np.testing.assert_allclose(drawn.placement.homogeneous, shape.placement.homogeneous, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "content", "scale"),
    [
        ("part.obj", TETRAHEDRON, "1e4 1e4 1.001e4"),
        ("part.obj", TETRAHEDRON.replace("1", "1e200", 1), "1 1 1"),
        ("part.obj", TETRAHEDRON.replace("1", "1e39", 1), "1 1 1"),
        ("part.obj", TETRAHEDRON.replace("v 0 1 0", "v 0 1"), "1 1 1"),
        ("part.obj", TETRAHEDRON.replace("f 1 2 3", "f 1 2 999"), "1 1 1"),
        ("part.obj", TETRAHEDRON, "0 1 1"),
        ("part.obj", "v 0\nf 1 1 1\n", "1 1 1"),
        ("part.stl", "solid\nfacet normal 0 0 0\nouter loop\nvertex 1 1", "1 1 1"),
        ("part.gltf", "{}", "1 1 1"),
    ],
)
def test_damaged_and_huge_meshes(urdf_folder: Path, name: str, content: str, scale: str) -> None:
    """With vertices at 1e200 m, coal's bounding volumes end the process."""
    replace(urdf_folder / "cmbot.urdf", BOX, f'<mesh filename="{name}" scale="{scale}" />')
    (urdf_folder / name).write_text(content)
    with pytest.raises(ModelError) as caught:
        load_copy(urdf_folder)
    assert name in str(caught.value) or "mesh.scale" in caught.value.key


def test_visual_meshes_are_read_when_they_are_asked_for(urdf_folder: Path) -> None:
    shape = '<visual><geometry><mesh filename="part.obj" /></geometry></visual>'
    replace(urdf_folder / "cmbot.urdf", FOOT, f"{FOOT}{shape}")
    part = urdf_folder / "part.obj"
    part.write_text(TETRAHEDRON)
    (mesh,) = load_copy(urdf_folder).visual_model.geometryObjects
    (moved,) = load_copy(urdf_folder, mount=np.diag([-1, -1, 1, 1])).visual_model.geometryObjects
    assert faces_of(mesh.geometry).shape == (4, 3)
    part.write_text(f"{TETRAHEDRON}f 1 2 3\n")
    (other,) = load_copy(urdf_folder).visual_model.geometryObjects
    assert faces_of(other.geometry).shape == (5, 3)
    assert not mesh.placement.isApprox(moved.placement)
    for damaged in ("v 0\nf 1 1 1\n", TETRAHEDRON.replace("1", "1e200", 1)):
        part.write_text(damaged)
        robot = load_copy(urdf_folder)
        with pytest.warns(UserWarning, match=r"boxes: link\[foot_1\].mesh.filename, 'part.obj', which"):
            (drawn,) = robot.visual_model.geometryObjects
        assert_stands_in(drawn, robot)


def test_mirrored_meshes_and_slashes_in_front_of_packages(urdf_folder: Path) -> None:
    mesh = f"package:///{urdf_folder.name}/part.obj"
    replace(urdf_folder / "cmbot.urdf", BOX, f'<mesh filename="{mesh}" scale="1 -1 1" />')
    (urdf_folder / "part.obj").write_text(TETRAHEDRON)
    assert load_copy(urdf_folder).dof == 7


@pytest.mark.parametrize(
    ("element", "attribute", "value", "most"),
    [
        ("mass", "value", "1e308", "100000"),
        ("mass", "value", "100001", "100000"),
        ("inertia", "ixx", "1e10", "1e+09"),
        ("inertia", "ixy", "-1e10", "1e+09"),
        ("origin", "xyz", "0 0 1e308", "10000"),
        ("origin", "xyz", "0 -10001 0", "10000"),
        ("origin", "rpy", "90 0 0", "25 rad (degrees?)"),
        ("cylinder", "radius", "1e9", "10000"),
        ("cylinder", "length", "1e9", "10000"),
        ("box", "size", "1 1 1e5", "10000"),
        ("axis", "xyz", "1e200 0 0", "1000"),
        ("limit", "lower", "-1e18", "1e+17"),
        ("limit", "upper", "1e308", "1e+17"),
        ("limit", "velocity", "1e7", "1e+06"),
        ("limit", "effort", "1e10", "1e+09"),
    ],
)
def test_numbers_beyond_any_robot(
    urdf_folder: Path, element: str, attribute: str, value: str, most: str
) -> None:
    text = (urdf_folder / "cmbot.urdf").read_text()
    changed, number = re.subn(rf'(<{element} [^>]*?{attribute}=")[^"]*', rf"\g<1>{value}", text, count=1)
    assert number == 1
    (urdf_folder / "cmbot.urdf").write_text(changed)
    error = refused(urdf_folder)
    assert error.key.endswith(f".{element}.{attribute}")
    assert error.got == repr(value)
    assert error.expected.endswith(f"of at most {most}")


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        (LIMIT, LIMIT + '<dynamics damping="nan" friction="0"/>', "joint[j1].dynamics.damping"),
        (LIMIT, LIMIT + '<dynamics damping="0" friction="1e10"/>', "joint[j1].dynamics.friction"),
        (LIMIT, LIMIT + '<mimic joint="j2" multiplier="1e5"/>', "joint[j1].mimic.multiplier"),
        (LIMIT, LIMIT.replace("0 0 1", "0 0 1e-10"), "joint[j1].axis"),
        ("0 0 0.01", "0 0 " + "1" * 2000, "joint[j1].origin.xyz"),
        ("0 0 0.01", "0 0 0.01" + "0" * 50 + "x", "joint[j1].origin.xyz"),
        ('<origin xyz="0 0 0.01"', '<origin quat_xyzw="0 0 0 2"', "joint[j1].origin.quat_xyzw"),
        ('name="l1"', 'name="a&#10;b"', r"joint[j1].child"),
        ('child link="l1"', 'child link="l0"', "joint[j1].parent"),
        ('"j1"', '"j2"', "joint[j2]"),
    ],
)
def test_odd_joints(tmp_path: Path, old: str, new: str, key: str) -> None:
    file = chain(tmp_path, 3, 0)
    replace(file, old, new, 1)
    with pytest.raises(ModelError) as caught:
        load_robot(file, base_frame="l0", tool_frame="l3")
    keys = [finding.key for finding in inspect_urdf(parse_urdf(file))] or [caught.value.key]
    assert key in keys or "parent" in key
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_origins_that_add_up(tmp_path: Path) -> None:
    file = chain(tmp_path, 2, 2)
    replace(file, "0 0 0.01", "0 0 9000")
    with pytest.raises(ModelError, match=r"18000 m from its joint, expected .* within 10000 m"):
        load_robot(file, base_frame="l0", tool_frame="l4")


@pytest.mark.parametrize(
    ("name", "old", "new", "key"),
    [
        ("joint_limits.yaml", "jerk_deg: 160", "jerk_deg: 1.0e+300", "joints.joint_1.jerk_deg"),
        ("joint_limits.yaml", "jerk_deg: 160", "jerk_deg: 1.0e-300", "joints.joint_1.jerk_deg"),
        ("cmbot.srdf", 'value="0.0"', 'value="1e300"', "group_state.climb_2"),
    ],
)
def test_numbers_in_the_other_files(urdf_folder: Path, name: str, old: str, new: str, key: str) -> None:
    replace(urdf_folder / name, old, new)
    assert refused(urdf_folder, name).key == key


@pytest.mark.parametrize(("option", "value"), [("tool_length", 1e5), ("payload", 1e5)])
def test_lengths_and_payloads_beyond_any_robot(option: str, value: float) -> None:
    with pytest.raises(ModelError, match=f"{option}: got 100000.0, expected .* at most 10000"):
        load_robot("cmbot", **{option: value})


def test_an_arm_without_mass(tmp_path: Path) -> None:
    file = chain(tmp_path, 2, 1)
    replace(file, INERTIA, "")
    with pytest.raises(
        ModelError, match=r"total_mass_kg: got 0 kg from 'l0' to 'l3', expected the mass of all of the robot"
    ):
        load_robot(file, base_frame="l0", tool_frame="l3")


BOMB = "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(9))


@pytest.mark.parametrize("name", ["cmbot.urdf", "cmbot.srdf"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("subset", ["", f'[<!ENTITY a0 "aaaaaaaaaa">{BOMB}]', 'SYSTEM "robot.dtd"'])
def test_no_document_types(urdf_folder: Path, name: str, encoding: str, subset: str) -> None:
    text = f'<!DOCTYPE robot {subset}><robot name="bomb">&a9;</robot>'
    (urdf_folder / name).write_bytes(text.encode(encoding))
    assert refused(urdf_folder, name).got == "a document type (<!DOCTYPE …>)"


def test_elements_that_nest_too_deep(urdf_folder: Path) -> None:
    replace(urdf_folder / "cmbot.urdf", "</robot>", "<a>" * 10**5 + "</a>" * 10**5 + "</robot>")
    assert refused(urdf_folder).expected == "at most 50 levels of elements"


def test_numbers_of_parts(tmp_path: Path) -> None:
    """Pinocchio's reader ends the process with some thousand links in a row."""
    shapes = '<collision><geometry><box size="1 1 1"/></geometry></collision>' * 101
    for counts, parts, got in (
        ((3, 998), "", "1001 joints in a row"),
        ((3, 6000), "", "6004 links"),
        ((600, 0), "", "600 movable joints"),
        ((10, 0), shapes, "1010 collision shapes"),
    ):
        root = parse_urdf(chain(tmp_path, *counts, parts))
        assert got in [finding.got for finding in inspect_urdf(root)]


def test_many_joints(tmp_path: Path) -> None:
    file = chain(tmp_path, 101, 0)
    assert load_robot(file, base_frame="l1", tool_frame="l101").dof == 100
    with pytest.raises(ModelError, match=r"'l101', 101 joints above 'l0', expected an arm of at most 100"):
        load_robot(file, base_frame="l0", tool_frame="l101")


def test_many_links_in_a_row(tmp_path: Path) -> None:
    robot = load_robot(chain(tmp_path, 3, 997), base_frame="l0", tool_frame="l1000")
    assert robot.arm_mass == pytest.approx(1000.0)
    np.testing.assert_allclose(robot.reach, 9.99)


def test_inspection_grows_with_the_links(tmp_path: Path) -> None:
    """Counted in calls: four times as many links, four times as many calls."""
    calls = []
    for links in (200, 800):
        root = parse_urdf(chain(tmp_path, 3, links - 3))
        number = 0

        def count(*_: Any) -> None:
            nonlocal number
            number += 1

        sys.setprofile(count)
        try:
            assert inspect_urdf(root) == []
        finally:
            sys.setprofile(None)
        calls.append(number)
    assert calls[1] < 4.2 * calls[0]


def test_every_robot_of_the_reference_set_is_within_the_bounds() -> None:
    """Micrograms outside of the arm, endless ranges at 1e16, and meshes of 29 MB are in it."""
    files = sorted(ROBOTS.rglob("*.urdf"))
    assert len(files) > 60
    for file in files:
        for finding in inspect_urdf(parse_urdf(file)):
            assert finding.severity == "warning" or "at most" not in finding.expected, (file, finding)
    for file in ROBOTS.rglob("*.srdf"):
        parse_urdf(file, "an SRDF")


@pytest.mark.parametrize("with_srdf", [True, False])
def test_pairs_are_those_of_pinocchio(urdf_folder: Path, cmbot_robot: Robot, with_srdf: bool) -> None:
    srdf = urdf_folder / "cmbot.srdf"
    text = srdf.read_text()
    if not with_srdf:
        srdf.unlink()
    robot = load_copy(urdf_folder)
    expected = pin.GeometryModel(robot.collision_model)
    expected.addAllCollisionPairs()
    if with_srdf:
        pin.removeCollisionPairsFromXML(robot.model, expected, text)
    else:
        joints = [shape.parentJoint for shape in expected.geometryObjects]
        for one, other in [(pair.first, pair.second) for pair in expected.collisionPairs]:
            if robot.model.parents[max(joints[one], joints[other])] == min(joints[one], joints[other]):
                expected.removeCollisionPair(pin.CollisionPair(one, other))
    pairs = [
        {(pair.first, pair.second) for pair in each.collisionPairs}
        for each in (robot.collision_model, expected)
    ]
    # Without an SRDF links may also touch that are always near: the wrist's, whose joints are close.
    assert pairs[1] - pairs[0] == (set() if with_srdf else {(10, 11), (11, 12)})
    assert pairs[0] <= pairs[1]
    assert len(pairs[0]) == len(robot.collision_model.collisionPairs)


def test_no_tool_length_for_a_tool_that_a_joint_moves(tmp_path: Path) -> None:
    """The joint's parent link lies at negative z on the joint before: its frame is another joint's."""
    file = chain(tmp_path, 2, 0)
    text = file.read_text()
    text = text.replace(
        "</robot>",
        '<link name="low"/><joint name="down" type="fixed"><parent link="l1"/>'
        '<child link="low"/><origin xyz="0 0 -0.5"/></joint></robot>',
    )
    text = text.replace('<parent link="l1"/><child link="l2"/>', '<parent link="low"/><child link="l2"/>')
    file.write_text(text)
    arm = {"base_frame": "l0", "tool_frame": "l2"}
    assert load_robot(file, **arm).dof == 2
    with pytest.raises(ModelError, match=r"tool_length: got 0.7, expected 'l2' to be fixed to its flange"):
        load_robot(file, **arm, tool_length=0.7)


def test_the_smallest_elements_are_no_finding() -> None:
    root = ElementTree.fromstring(
        '<robot name="r"><link name="a"><inertial><mass value="1e-12"/>'
        '<inertia ixx="1e-30" iyy="1e-30" izz="1e-30" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>'
    )
    assert inspect_urdf(root) == []
