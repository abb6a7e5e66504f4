"""A damaged URDF ends in an error that names the place, never in a wrong robot, a crash or console noise."""

import copy
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st
from robot_files import load_copy, replace

from cmbot.common.errors import ModelError
from cmbot.common.installation import model_folder
from cmbot.robot import Finding, inspect_urdf, load_robot, parse_urdf

BOX = '<box size="0.13 0.05 0.15" />'
JOINT_2 = '<parent link="link_1" />\n    <child link="link_2" />'
LOWER_1 = 'lower="-2.9670597283903604"'
JOINT_4 = '<joint name="joint_4" type="revolute">'
VELOCITY_1 = 'velocity="0.3490658503988659"'
RED = '<material name="red"><color rgba="1 0 0 1"/></material>'
INERTIA_1 = 'ixx="0.02" iyy="0.32" izz="0.32" ixy="0.0" ixz="-0.01" iyz="0.0"'

# What is replaced by what; the key that the error names; a word of the message.
DAMAGE = {
    "NaN mass": ('value="7.8"', 'value="nan"', "link[link_1].mass.value", "finite"),
    "infinite mass": ('value="7.8"', 'value="1e999"', "link[link_1].mass.value", "finite"),
    "negative mass": ('value="7.8"', 'value="-7.8"', "link[link_1].inertial.mass", "not negative"),
    "mass without value": ('<mass value="7.8" />', "<mass />", "link[link_1].mass.value", "a value"),
    "no mass": ('<mass value="7.8" />', "", "link[link_1].inertial", "no mass"),
    "underscore": ('value="7.8"', 'value="7_8"', "link[link_1].mass.value", "7_8"),
    "comma": ('value="7.8"', 'value="7,8"', "link[link_1].mass.value", "7,8"),
    "foreign digits": ('value="7.8"', 'value="٧"', "link[link_1].mass.value", "number"),
    "inertia not definite": (INERTIA_1, INERTIA_1.replace("0.02", "-0.5"), "[link_1].inertial", "none neg"),
    "inertia incomplete": (INERTIA_1, INERTIA_1[:-10], "link[link_1].inertia.iyz", "a value"),
    "zero axis": ('<axis xyz="0.0 0.0 1.0" />', '<axis xyz="0 0 0" />', ".axis", "not zero"),
    "axis of nothing": ('<axis xyz="0.0 0.0 1.0" />', "<axis />", ".axis", "not zero"),
    "short axis": ('<axis xyz="0.0 0.0 1.0" />', '<axis xyz="0 1" />', ".axis.xyz", "3 finite"),
    "tab between": ('<axis xyz="0.0 0.0 1.0" />', '<axis xyz="0&#9;0 1" />', ".axis.xyz", "3 finite"),
    "empty rpy": ('rpy="-1.5707963267948966 0.0 0.0"', 'rpy=""', ".origin.rpy", "3 finite"),
    "lower above upper": (LOWER_1, 'lower="3"', "joint[joint_1].limit", "lower <= upper"),
    "no limit": ("<limit ", "<no_limit ", "joint[climb_1].limit", "<limit>"),
    "no velocity": ('velocity="0.2"', "", "joint[climb_1].limit.velocity", "a value"),
    "negative velocity": ('velocity="0.2"', 'velocity="-1"', "joint[climb_1].limit.velocity", "not negative"),
    "negative effort": ('effort="240.0"', 'effort="-1"', "joint[joint_1].limit.effort", "not negative"),
    "mimic": (JOINT_4, f'{JOINT_4}<mimic joint="joint_4"/>', "joint[joint_4].mimic", "follow"),
    "unknown type": ('type="revolute"', 'type="screw"', "joint[climb_1].type", "revolute, continuous"),
    "floating": (JOINT_4, JOINT_4.replace("revolute", "floating"), "[joint_4].type", "of revolute, contin"),
    "two links of a name": ('link name="link_2"', 'link name="link_1"', "link[link_1]", "unique"),
    "two joints of a name": ('joint name="joint_2"', 'joint name="joint_1"', "joint[joint_1]", "unique"),
    "link without name": ('link name="link_2"', "link", "link[]", "unique"),
    "name of a link": ('joint name="joint_2"', 'joint name="tool"', "joint[tool]", "name of a link"),
    "name of the world": ('joint name="joint_2"', 'joint name="universe"', "joint[universe]", "another name"),
    "too bright": ('rgba="0.16', 'rgba="16', "material[dark].color.rgba", "0 to 1"),
    "unknown parent": (JOINT_2, JOINT_2.replace("link_1", "nowhere"), "joint[joint_2].parent", "nowhere"),
    "no parent": ('<parent link="link_1" />', "", "joint[joint_2].parent", "name of a link"),
    "unknown child": (JOINT_2, JOINT_2.replace("link_2", "nowhere"), "joint[joint_2].child", "nowhere"),
    "two parents": (JOINT_2, JOINT_2.replace("link_2", "link_5"), ".child", "no other joint's child"),
    "two roots": ("</robot>", '<link name="island"/></robot>', "robot", "exactly one"),
    "cycle": (JOINT_2, JOINT_2.replace("link_1", "tool0"), "link[link_2]", "a cycle"),
    "no robot name": ('<robot name="cmbot">', "<robot>", "robot.name", "a name"),
    "other version": ('<robot name="cmbot">', '<robot name="cmbot" version="2.0">', "robot.version", "2.0"),
    "no shape": (BOX, "", "link[foot_1].collision.geometry", "one of box"),
    "two shapes": (BOX, BOX + BOX, "link[foot_1].collision.geometry", "one of box"),
    "capsule, which URDF has not": (BOX, '<capsule radius="1" length="1" />', "geometry", "<capsule>"),
    "box without size": (BOX, "<box />", "link[foot_1].box.size", "a value"),
    "negative box": (BOX, '<box size="1 -1 1" />', "geometry.box.size", "no negative"),
    "negative radius": ('radius="0.07"', 'radius="-0.07"', "geometry.cylinder.radius", "no negative"),
    "mesh without file": (BOX, "<mesh />", "link[foot_1].mesh.filename", "a value"),
    "missing mesh": (BOX, '<mesh filename="none.stl" />', "", "none.stl"),
    "mesh of a missing package": (BOX, '<mesh filename="package://none/a.stl" />', "", "package://none"),
    "mesh from the net": (BOX, '<mesh filename="http://localhost/a.stl" />', "", "http"),
    "capsule without name": ('<capsule name="ankle_1_neck" />', "<capsule />", "", "pinocchio refuses"),
}


@pytest.mark.parametrize(("old", "new", "key", "word"), DAMAGE.values(), ids=DAMAGE.keys())
def test_damage_is_named(
    urdf_folder: Path, capfd: pytest.CaptureFixture[str], old: str, new: str, key: str, word: str
) -> None:
    replace(urdf_folder / "cmbot.urdf", old, new)
    with pytest.raises(ModelError) as caught:
        load_copy(urdf_folder)
    error = caught.value
    assert error.source == str(urdf_folder / "cmbot.urdf")
    assert key in error.key
    assert word in str(error)
    assert "\n" not in str(error)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "got an empty file, expected a URDF file"),
        (b"joints: {}", "not well-formed XML"),
        (b"<robot name='a'>", r"got text that is not well-formed XML \(no element found"),
        (b"<sdf/>", "<sdf>"),
        (b"<robot xmlns='http://example.org' name='a'/>", "<robot>"),
        (b"<robot name='a'/>", "at least one link"),
        (b"<?xml version='1.0' encoding='klingon'?><robot name='a'/>", "klingon"),
        (b"<?xml version='1.0' encoding='shift_jis'?><robot name='a'/>", "not well-formed XML"),
        (b"<robot name='a'>\xff</robot>", "not well-formed XML"),
        (
            b'<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/hostname">]><robot name="a">&x;</robot>',
            "a document type",
        ),
    ],
)
def test_file_that_is_no_urdf(tmp_path: Path, content: bytes, word: str) -> None:
    file = tmp_path / "robot.urdf"
    file.write_bytes(content)
    with pytest.raises(ModelError, match=word):
        load_robot(file, base_frame="a", tool_frame="b")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"none\.urdf: no such file, expected a URDF file"):
        parse_urdf(tmp_path / "none.urdf")
    with pytest.raises(ModelError, match=r"got a folder, expected a URDF file"):
        parse_urdf(tmp_path)


def findings(text: str) -> list[Finding]:
    return inspect_urdf(ElementTree.fromstring(text))


def test_impossible_inertia_is_a_warning(bare_urdf: str) -> None:
    """Table 2's link 3 as printed: many a published URDF is no better."""
    rounded = '<inertia ixx="0.06" iyy="0.56" izz="0.59" ixy="0.011" ixz="0.12" iyz="0"/>'
    start = bare_urdf.index('<inertia ixx="0.06668"')
    end = bare_urdf.index("/>", start) + 2
    (finding,) = findings(bare_urdf[:start] + rounded + bare_urdf[end:])
    assert finding.severity == "warning"
    assert finding.key == "link[link_3].inertial.inertia"
    assert "0.03388" in finding.got
    assert "0.616" in finding.got


def test_prismatic_joints_are_fine(bare_urdf: str) -> None:
    for number in (1, 12):
        assert findings(bare_urdf.replace('type="revolute"', 'type="prismatic"', number)) == []


def test_everything_is_listed_errors_first(bare_urdf: str) -> None:
    text = bare_urdf.replace('value="7.8"', 'value="-1"').replace(LOWER_1, 'lower="3"')
    text = text.replace('ixx="0.25" iyy="0.25" izz="0.01"', 'ixx="0.25" iyy="0.25" izz="0.9"')
    listed = findings(text)
    assert [finding.severity for finding in listed] == ["error"] * 6 + ["warning"]
    assert {finding.key.split("[")[1].split("]")[0] for finding in listed} >= {"link_1", "joint_1", "link_5"}


def test_the_shipped_robot_a_point_mass_and_a_rod_have_no_findings(bare_urdf: str) -> None:
    assert inspect_urdf(parse_urdf(model_folder() / "urdf" / "cmbot.urdf")) == []
    point = " ".join(f'{name}="0"' for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    rod = INERTIA_1.replace("0.02", "0").replace("-0.01", "0")
    for inertia in (point, rod):
        assert findings(bare_urdf.replace(INERTIA_1, inertia)) == []


@pytest.fixture
def original(bare_urdf: str) -> ElementTree.Element:
    return ElementTree.fromstring(bare_urdf)


NO_NUMBERS = ("", " ", "nan", "-inf", "1e999", "0 0", "0 0 0", "1 2 3 4", "junk", "universe")
JUNK = (*NO_NUMBERS, "-1", "0", "1e308", "1e-320")


def change_attribute(root: ElementTree.Element, data: st.DataObject) -> None:
    element = data.draw(st.sampled_from([element for element in root.iter() if element.attrib]))
    name = data.draw(st.sampled_from(sorted(element.attrib)))
    # XML has no control characters.
    text = st.text(st.characters(min_codepoint=32, exclude_categories=["Cs", "Cc"]), max_size=6)
    value = data.draw(st.none() | st.sampled_from(JUNK) | text)
    if value is None:
        del element.attrib[name]
    else:
        element.set(name, value)


def remove_or_double_element(root: ElementTree.Element, data: st.DataObject) -> None:
    parent = data.draw(st.sampled_from([element for element in root.iter() if len(element)]))
    child = data.draw(st.sampled_from(list(parent)))
    data.draw(st.sampled_from([parent.remove, parent.append]))(child)


@settings(max_examples=180, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_any_damage_ends_in_an_error_or_a_robot(
    original: ElementTree.Element, urdf_folder: Path, capfd: pytest.CaptureFixture[str], data: st.DataObject
) -> None:
    root = copy.deepcopy(original)
    for change in data.draw(
        st.sampled_from([[change_attribute], [change_attribute] * 2, [remove_or_double_element]])
    ):
        change(root, data)
    (urdf_folder / "cmbot.urdf").write_bytes(ElementTree.tostring(root, encoding="utf-8"))
    try:
        robot = load_copy(urdf_folder)
    except ModelError as error:
        assert str(urdf_folder) in str(error)
    else:
        assert np.isfinite(robot.mass)
        assert (robot.limits.velocity > 0).all()
    assert capfd.readouterr() == ("", "")


@given(content=st.binary(max_size=200))
@example(content=b"<robot name='x'><link name='a'/></robot>")
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_any_bytes_end_in_an_error(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "robot.urdf"
    file.write_bytes(content)
    with pytest.raises(ModelError):
        load_robot(file, base_frame="a", tool_frame="b")
