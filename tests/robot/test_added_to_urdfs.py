"""What a URDF lacks and its user adds: masses, a tool, arguments of xacro; and what cannot be meant."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from robot_files import replace

from cmbot.collision import Clearances
from cmbot.common.errors import InputError, ModelError
from cmbot.robot import AttachedTool, Dynamics, Kinematics, Robot, ToolShape, load_robot
from cmbot.robot.description.mesh_file import body_of

FOREIGN = Path(__file__).parent / "foreign"
BARE = FOREIGN / "no_masses" / "acme_support" / "urdf" / "acme.urdf"
ARM = FOREIGN / "flange" / "arm.urdf"
# Of the links' boxes in tests/robot/foreign, m.
EDGES = {
    "base_link": (0.24, 0.24, 0.3),
    "link_1": (0.2, 0.2, 0.16),
    "link_2": (0.12, 0.1, 0.5),
    "link_3": (0.14, 0.12, 0.14),
    "link_4": (0.26, 0.1, 0.1),
    "link_5": (0.1, 0.07, 0.08),
    "link_6": (0.04, 0.07, 0.07),
}


def described_masses(robot: Robot) -> dict[str, ElementTree.Element]:
    root = ElementTree.fromstring(robot.description)
    found = {link.get("name", ""): link.find("inertial") for link in root.findall("link")}
    return {name: inertial for name, inertial in found.items() if inertial is not None}


def test_a_total_mass_is_spread_over_the_volumes() -> None:
    """Meshes of boxes get the masses and the moments of inertia of boxes."""
    robot = load_robot(BARE, total_mass=60.0)
    assert robot.mass == pytest.approx(60.0)
    volume = {name: float(np.prod(edges)) for name, edges in EDGES.items()}
    for name, inertial in described_masses(robot).items():
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        assert mass is not None
        assert inertia is not None
        m = float(mass.get("value", "0"))
        assert m == pytest.approx(60 * volume[name] / sum(volume.values()))
        squares = np.square(EDGES[name])
        expected = m / 12 * (squares.sum() - squares)
        np.testing.assert_allclose([float(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz")], expected)
    assert described_masses(robot).keys() == EDGES.keys()
    assert robot.remarks[0] == (
        "The masses of 7 links are estimated, 60 kg of even density in the convex hulls of their shapes: so "
        "is every torque, force, sag and sway."
    )
    assert robot.content_hash != load_robot(BARE, total_mass=61.0).content_hash


def test_masses_of_a_limits_file_count_before_the_rest_is_spread(tmp_path: Path) -> None:
    limits = tmp_path / "limits.yaml"
    limits.write_text("format: cmbot-joint-limits/1\nmasses_kg: {link_2: 20, link_3: 10}\n", encoding="utf-8")
    robot = load_robot(BARE, limits=limits, total_mass=50.0)
    masses = [inertia.mass for inertia in robot.model.inertias]
    np.testing.assert_allclose(masses[2:4], [20, 10])
    assert sum(masses) == pytest.approx(50)
    # Alone they are all that the arm weighs.
    assert load_robot(BARE, limits=limits).mass == pytest.approx(30)
    for text, said in (
        ("{link_9: 2}", r"masses_kg: got 'link_9', expected a link of the URDF"),
        (
            "{tool0: 2}",
            r"masses_kg.tool0: got 2.0, expected a link without a mass in the URDF, and with a shape",
        ),
    ):
        limits.write_text(f"format: cmbot-joint-limits/1\nmasses_kg: {text}\n", encoding="utf-8")
        with pytest.raises(ModelError, match=said):
            load_robot(BARE, limits=limits)


def test_a_total_mass_that_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(
        ModelError, match=r"total_mass_kg: got 70 kg, beside 61.9 kg .* expected no total mass"
    ):
        load_robot(ARM, total_mass=70.0)
    limits = tmp_path / "limits.yaml"
    limits.write_text("format: cmbot-joint-limits/1\nmasses_kg: {link_2: 45}\n", encoding="utf-8")
    # As a data sheet has it, that weighs the arm alone.
    with pytest.raises(
        ModelError, match=r"total_mass_kg: got 29.9 kg, beside 45 kg .* more than these: 74.9 if that is of"
    ):
        load_robot(BARE, limits=limits, total_mass=29.9)
    with pytest.raises(
        ModelError, match=r"total_mass_kg: got 0 kg from 'base_link' to 'tool0', expected the mass"
    ):
        load_robot(BARE)


def tool(**changes: Any) -> AttachedTool:
    shape = ToolShape(kind="box", numbers=(0.2, 0.04, 0.06), xyz=(0.1, 0.0, 0.0))
    values: dict[str, Any] = {
        "xyz": (0.2, 0.0, 0.05),
        "rpy": (0.0, np.pi / 2, 0.0),
        "mass": 1.5,
        "shapes": (shape,),
    }
    return AttachedTool(**values | changes)


def test_a_tool_carries_its_point_mass_and_shape() -> None:
    bare, robot = load_robot(ARM), load_robot(ARM, tool=tool())
    assert (bare.tool_frame, robot.flange, robot.tool_frame) == ("flange", "flange", "flange_tool_point")
    q = np.array([0.3, -0.4, 0.5, 0.2, 0.9, -1.0])
    X_WF, X_WT = (Kinematics(each).tool_pose(q) for each in (bare, robot))
    X_FT = pin.SE3(pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0), np.array([0.2, 0.0, 0.05]))
    np.testing.assert_allclose(X_WT.homogeneous, (X_WF * X_FT).homogeneous, atol=1e-12)
    # At rest the tool adds its weight at its centre of mass.
    weight = 1.5 * np.array([0, 0, -9.81])
    added = Dynamics(robot).static_efforts(q[None]).guardrail_torque - (
        Dynamics(bare).static_efforts(q[None]).guardrail_torque
    )
    np.testing.assert_allclose(added[0], np.cross(X_WF.act(np.array([0.1, 0, 0])), weight), atol=1e-9)
    given = load_robot(ARM, tool=tool(com=(0.15, 0.0, 0.0)))
    added = Dynamics(given).static_efforts(q[None]).guardrail_torque - (
        Dynamics(bare).static_efforts(q[None]).guardrail_torque
    )
    np.testing.assert_allclose(added[0], np.cross(X_WF.act(np.array([0.15, 0, 0])), weight), atol=1e-9)
    drawn = [shape.name for shape in robot.visual_model.geometryObjects]
    assert sum(name.startswith("flange_tool") for name in drawn) == 1
    said = [each.remarks for each in (load_robot(ARM, tool=tool(shapes=())), robot)]
    told = "The tool has no shapes: it is neither drawn nor kept clear of anything."
    assert [told in remarks for remarks in said] == [True, False]


def test_a_tool_keeps_its_clearance() -> None:
    """The wrist turns it towards the forearm: the distance of two boxes, with an SRDF and without one."""
    robot = load_robot(ARM, tool=tool())
    pairs = {frozenset((pair.link, pair.other)) for pair in Clearances(robot, []).pairs}
    assert frozenset(("flange_tool", "link_4")) in pairs
    # The neighbouring joint's link and its own are not looked at.
    assert frozenset(("flange_tool", "link_5")) not in pairs
    assert frozenset(("flange_tool", "link_6")) not in pairs


def test_a_tool_is_checked_beside_an_srdf(tmp_path: Path) -> None:
    srdf = tmp_path / "arm.srdf"
    srdf.write_text(
        '<robot name="arm"><disable_collisions link1="link_4" link2="link_6"/></robot>', encoding="utf-8"
    )
    robot = load_robot(ARM, srdf=srdf, tool=tool())
    pairs = {frozenset((pair.link, pair.other)) for pair in Clearances(robot, []).pairs}
    assert frozenset(("flange_tool", "link_4")) in pairs
    assert frozenset(("flange_tool", "link_5")) not in pairs
    assert frozenset(("link_4", "link_6")) not in pairs
    # The SRDF is as it was for all else.
    assert frozenset(("link_4", "link_5")) in pairs


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (ToolShape(kind="cylinder", numbers=(0.05, 0.2)), np.pi * 0.05**2 * 0.2),
        (ToolShape(kind="sphere", numbers=(0.05,)), 4 / 3 * np.pi * 0.05**3),
        (
            ToolShape(kind="mesh", numbers=(0.5,), path=FOREIGN / "flange" / "torch.obj"),
            0.2 * 0.04 * 0.04 / 8,
        ),
    ],
)
def test_shapes_of_tools(shape: ToolShape, volume: float) -> None:
    """Two shapes of even density share the mass as their volumes do."""
    box = ToolShape(kind="box", numbers=(0.1, 0.1, 0.1), xyz=(0.0, 0.0, 0.5))
    robot = load_robot(ARM, tool=tool(shapes=(shape, box)))
    inertial = described_masses(robot)["flange_tool"]
    origin = inertial.find("origin")
    assert origin is not None
    height = float(origin.get("xyz", "").split()[2])
    assert height == pytest.approx(0.5 * 1e-3 / (1e-3 + volume), rel=0.02)


def test_a_capsule_is_covered() -> None:
    shape = ToolShape(kind="capsule", numbers=(0.03, 0.2), rpy=(0.0, np.pi / 2, 0.0), xyz=(0.1, 0.0, 0.0))
    robot = load_robot(ARM, tool=tool(shapes=(shape,)))
    kinds = [
        type(each.geometry).__name__
        for each in robot.collision_model.geometryObjects
        if each.name.startswith("flange_tool")
    ]
    assert sorted(kinds) == ["Cylinder", "Sphere", "Sphere"]
    ends = [
        robot.model.frames[robot.model.getFrameId("flange")].placement.actInv(each.placement).translation
        for each in robot.collision_model.geometryObjects
        if each.name.startswith("flange_tool") and type(each.geometry).__name__ == "Sphere"
    ]
    np.testing.assert_allclose(sorted(np.array(ends)[:, 0]), [0.0, 0.2], atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "key"),
    [({"xyz": (np.nan, 0, 0)}, "xyz"), ({"mass": -1.0}, "mass"), ({"com": (0, 1e6, 0)}, "com")],
)
def test_tools_that_are_none(changes: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError, match=rf"^AttachedTool: .*{key}"):
        tool(**changes)


def test_a_tool_in_millimetres_is_told() -> None:
    shape = ToolShape(kind="mesh", numbers=(1000.0,), path=FOREIGN / "flange" / "torch.obj")
    with pytest.raises(
        ModelError, match=r"link\[flange_tool\].collision: got torch.obj that extends to 200 m.*milli"
    ):
        load_robot(ARM, tool=tool(shapes=(shape,)))


ACME = FOREIGN / "arguments" / "acme_description" / "urdf" / "acme.urdf.xacro"


def test_arguments_of_xacro() -> None:
    small, large = (load_robot(ACME, xacro={"name": name}) for name in ("small", "large"))
    assert (small.name, large.name) == ("acme", "acme")
    np.testing.assert_allclose(large.limits.velocity, 1.4 * small.limits.velocity)
    assert small.content_hash != large.content_hash
    with pytest.raises(ModelError, match=r"xacro.name: got nothing, expected a value of this argument"):
        load_robot(ACME)
    with pytest.raises(
        ModelError, match=r"xacro.nmae: got no argument of it, .*; did you mean name\?"
    ) as caught:
        load_robot(ACME, xacro={"name": "small", "nmae": "small"})
    assert caught.value.choices == ("name",)
    with pytest.raises(ModelError, match=r"xacro.name: got a file without xacro"):
        load_robot(ARM, xacro={"name": "small"})
    macro = FOREIGN / "macros" / "acme-master" / "urdf" / "acme_macro.xacro"
    with pytest.raises(
        ModelError, match=r"got macros alone, .*expected the file that calls them: acme.xacro$"
    ):
        load_robot(macro)


def test_a_copy_of_a_package_with_another_name_is_found() -> None:
    """The macros lie in a folder above, which has the name of no package."""
    assert load_robot(FOREIGN / "renamed_package" / "robot" / "urdf" / "arm.urdf.xacro").dof == 6


def test_meshes_that_are_too_large_or_none(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"link\[base_link\].collision: .*extends to 300 m.*millimetres\?"):
        load_robot(FOREIGN / "millimetres" / "arm.urdf")
    file = tmp_path / "arm.urdf"
    file.write_text(ARM.read_text(encoding="utf-8"), encoding="utf-8")
    replace(file, '<box size="0.24 0.24 0.3"/>', '<box size="60 60 0.3"/>')
    # A floor may be large.
    assert load_robot(file).dof == 6
    replace(file, '<box size="0.26 0.1 0.1"/>', '<box size="0.26 10 0.1"/>')
    with pytest.raises(ModelError, match=r"link\[link_4\].collision: got a shape that extends to 5 m"):
        load_robot(file)
    replace(file, '<origin xyz="0 0 0.42" rpy="0 0 0"/>', '<origin xyz="0 0 420" rpy="0 0 0"/>')
    with pytest.raises(ModelError, match=r"joint\[joint_3\].origin: got 420 m .*, expected metres \(milli"):
        load_robot(file)
    replace(file, '<origin xyz="0 0 420" rpy="0 0 0"/>', '<origin xyz="0 0 0.42" rpy="0 0 0"/>')
    (tmp_path / "part.stl").write_text("version https://git-lfs.github.com/spec/v1\n", encoding="utf-8")
    replace(file, '<box size="0.26 10 0.1"/>', '<mesh filename="part.stl"/>')
    with pytest.raises(
        ModelError, match=r"a pointer of Git LFS in its place .*expected a mesh file: git lfs pull"
    ):
        load_robot(file)


def test_a_link_that_is_always_near_others_is_told(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(ARM.read_text(encoding="utf-8"), encoding="utf-8")
    assert not any("Warning" in remark for remark in load_robot(file).remarks)
    replace(file, '<box size="0.14 0.12 0.14"/>', '<box size="1.4 1.2 1.4"/>')
    warned = [
        remark for remark in load_robot(file).remarks if "Warning: link_3 is nearly always near" in remark
    ]
    assert len(warned) == 1
    assert "millimetres?" in warned[0]


def test_a_body_is_that_of_its_shapes() -> None:
    """A box that stands off its link, turned, against its closed form."""
    link = ElementTree.fromstring(
        '<link name="l"><collision><origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><geometry>'
        '<box size="1 2 3"/></geometry></collision></link>'
    )
    body = body_of(link)
    assert body.volume == pytest.approx(6.0)
    np.testing.assert_allclose(body.centre, [0, 0, 1], atol=1e-9)
    # Turned by a quarter about z: x and y are exchanged.
    np.testing.assert_allclose(np.diag(body.inertia), [6 / 12 * 10, 6 / 12 * 13, 6 / 12 * 5], rtol=1e-9)
