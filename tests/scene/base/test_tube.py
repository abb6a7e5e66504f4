"""The tube that a robot stands on: its matrices, and what is refused."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from rail_arms import rail_data
from scipy.linalg import null_space
from small_scenes import short_scene

from cmbot.common.errors import SceneError
from cmbot.elastic.beam import beam_mass, beam_stiffness
from cmbot.planning import held_point, rigid_parts_remark, robot_of, tube_warning
from cmbot.scene import Scene, load_scene

MAST: dict[str, Any] = {
    **{"start_m": [0, 0, -2.5], "outer_diameter_m": 0.1, "wall_m": 0.004},
    **{"young_pa": 70e9, "shear_pa": 26e9, "density_kg_m3": 2700},
}
COORDINATES = st.tuples(*[st.floats(-3, 3)] * 3)


def standing_on(**tube: Any) -> Scene:
    data = short_scene(guardrail={"bays": 0}).as_data()
    keys = {key: value for key, value in (MAST | tube).items() if value is not None}
    return load_scene(data | {"base": {"name": "mast", "tube": keys}})


def test_a_tip_bends_as_handbooks_say() -> None:
    """3 E I / L^3 against a force alone, E I / L against a moment alone."""
    compliance = np.linalg.inv(standing_on().elastic_guardrail.stiffness)
    EI, L = 70e9 * np.pi / 64 * (0.1**4 - 0.092**4), 2.5
    np.testing.assert_allclose(1 / np.diag(compliance)[[0, 1, 3, 4]], [3 * EI / L**3] * 2 + [EI / L] * 2)
    area = np.pi / 4 * (0.1**2 - 0.092**2)
    np.testing.assert_allclose(1 / compliance[2, 2], 70e9 * area / L)
    np.testing.assert_allclose(1 / compliance[5, 5], 26e9 * 2 * EI / 70e9 / L)


@pytest.mark.parametrize("along", [(0, 0, 1), (0, 0, -1), (0, 1, 0), (1, 0, 0)])
def test_a_box_bends_by_its_sides_and_twists_by_bredt(along: tuple[int, int, int]) -> None:
    """A horizontal box is the upright one laid down along y or x the shortest way."""
    a, b, w, L = 0.12, 0.06, 0.004, 1.6
    sides = {
        "outer_diameter_m": None,
        "outer_m": [a, b],
        "wall_m": w,
        "start_m": (-L * np.array(along)).tolist(),
    }
    guardrail = standing_on(**sides).elastic_guardrail
    compliance = np.linalg.inv(guardrail.stiffness)
    # Side a lies along x, but along z where the tube does; side b along y, or along z.
    across = {"x": (0, a), "y": (1, b)}
    if along == (0, 1, 0):
        across["y"] = (2, b)
    if along == (1, 0, 0):
        across["x"] = (2, a)
    (first, wide), (second, narrow) = across.values()
    # Four plates with Steiner's parts, not differences of rectangles.
    for axis, side, other in ((first, wide, narrow), (second, narrow, wide)):
        plates = 2 * w * side**3 / 12
        flanges = 2 * ((other - 2 * w) * w**3 / 12 + (other - 2 * w) * w * ((side - w) / 2) ** 2)
        assert 1 / compliance[axis, axis] == pytest.approx(3 * 70e9 * (plates + flanges) / L**3, rel=1e-9)
    axis = int(np.flatnonzero(along)[0])
    area = 2 * w * (a + b - 2 * w)
    assert 1 / compliance[axis, axis] == pytest.approx(70e9 * area / L, rel=1e-9)
    enclosed, round_it = (a - w) * (b - w), 2 * (a + b - 2 * w)
    assert 1 / compliance[3 + axis, 3 + axis] == pytest.approx(
        26e9 * 4 * enclosed**2 * w / round_it / L, rel=1e-9
    )
    assert guardrail.mass is not None
    assert guardrail.mass[axis, axis] == pytest.approx(2700 * area * L / 3, rel=1e-9)


@given(start=COORDINATES, end=COORDINATES)
def test_anywhere_it_is_an_element_of_a_frame(start: tuple[float, ...], end: tuple[float, ...]) -> None:
    """The free end of a beam, its motion that of a rigid body about the origin of W."""
    along = np.subtract(end, start)
    L = np.atleast_1d(np.linalg.norm(along))
    assume(L[0] > 0.2)
    own = np.column_stack([along / L, null_space(along[None])])
    own[:, 2] *= np.sign(np.linalg.det(own))
    moment, area = np.pi / 64 * (0.1**4 - 0.092**4), np.pi / 4 * (0.1**2 - 0.092**2)
    E, G, mass = np.array([70e9]), np.array([26e9]), 2700 * area * L
    K = beam_stiffness(own[None], L, E * area, 2 * G * moment, E * moment, E * moment)[0, 6:, 6:]
    M = beam_mass(own[None], L, mass, 2 * mass * moment / area)[0, 6:, 6:]
    moved = np.eye(6)
    moved[:3, 3:] = np.cross(end, np.eye(3))
    guardrail = standing_on(start_m=start, end_m=end).elastic_guardrail
    for found, expected in ((guardrail.stiffness, K), (guardrail.mass, M)):
        np.testing.assert_allclose(found, moved.T @ expected @ moved, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("tube", "expected"),
    [
        (
            {"outer_diameter_m": 3, "wall_m": 0.01},
            r"base.tube: got start_m .* ends farther apart than outer_d",
        ),
        ({"wall_m": 0.06}, "at most half"),
        ({"start_m": [0, 0, -2500]}, r"start_m: .*millimetres[?] then \[0, 0, -2.5\]"),
        ({"outer_diameter_m": 120}, "millimetres[?] then 0.12"),
        ({"young_pa": 70000}, "N/mm2[?] then 70000e[+]6"),
        ({"young_pa": 70}, "GPa[?] then 70e[+]9"),
        ({"density_kg_m3": 2.7}, "g/cm3[?] then 2700"),
        ({"end_m": [0, 0, -2.5]}, r"base.tube: got start_m .* and end_m .* ends farther"),
        ({"outer_m": [0.1, 0.1]}, "outer_diameter_m"),
        ({"outer_diameter_m": None}, "outer_m"),
        ({"outer_diameter_m": None, "outer_m": [0.1, 0.05], "wall_m": 0.02}, "thin wall"),
    ],
)
def test_what_is_no_tube_is_refused(tube: dict[str, Any], expected: str) -> None:
    with pytest.raises(SceneError, match=expected):
        standing_on(**tube)


def test_one_key_says_how_the_base_bends() -> None:
    data = standing_on().as_data() | {"guardrail": {"bays": 0, "stiffness": [1e6] * 6}}
    with pytest.raises(SceneError, match="no such key beside another one"):
        load_scene(data)
    assert standing_on().softest_key == "base.tube"
    # Nor a guardrail beside the tube, which the robot does not stand on.
    with pytest.raises(SceneError, match=r"guardrail.bays: got 2, expected 0 beside base.tube"):
        load_scene(standing_on().as_data() | {"guardrail": {"bays": 2}})


def test_a_tube_ends_where_the_arm_is() -> None:
    """The base frame of the Panda is away from the origin of W, where a tube ends if nothing else is said."""
    data = load_scene("mast_inspection").as_data()
    data["robot"] |= {"mount": {"xyz": [0.0, 0.6, 0.8], "rpy_deg": [0, 0, 0]}}
    said = r"base.tube.end_m: got an end 1 m from what it holds, the arm at \(0, 0.6, 0.8\), expected at most"
    with pytest.raises(
        SceneError,
        match=said + r" 0.5 m; set end_m: \[0, 0.6, 0.8\], so that it is 3.35 m long, or robot.mount: {xyz",
    ):
        robot_of(load_scene(data))
    # Below the first joint, which is 0.33 m above the arm's base.
    for end in ([0.0, 0.6, 1.1], [0.0, 0.6, 0.72]):
        data["base"]["tube"]["end_m"] = end
        scene = load_scene(data)
        away = f"The mast ends {abs(end[2] - 0.8):.2g} m from the arm's base"
        assert tube_warning(scene, robot_of(scene)).startswith(away)
    data["base"]["tube"]["end_m"] = [0.0, 0.31, 0.41]
    scene = load_scene(data)
    robot = robot_of(scene)
    assert robot.name == "panda"
    said = (
        "ends 0.49 m from the arm's base at (0, 0.6, 0.8) m: what is between is taken to be rigid (base.tube."
    )
    assert said in rigid_parts_remark(scene, robot)
    data["base"]["tube"]["end_m"] = [0.0, 0.6, 0.8]
    scene = load_scene(data)
    assert "between" not in rigid_parts_remark(scene, robot_of(scene))


@pytest.mark.parametrize(
    ("obstacle", "left_out"),
    [
        ({"cylinder": [0.05, 2.5], "xyz": [0, 0, -1.25]}, ""),
        ({"box": [0.1, 0.1, 1.0], "xyz": [0, 0, -0.5]}, "The obstacle mast leaves out 1.5 m of base.tube"),
        ({"box": [0.1, 0.1, 2.5], "xyz": [0, 0, -1.5]}, "The obstacle mast leaves out 0.25 m of base.tube"),
    ],
)
def test_an_obstacle_that_is_shorter_than_its_tube_is_told(obstacle: dict[str, Any], left_out: str) -> None:
    data = load_scene("mast_inspection").as_data()
    data["obstacles"] = [{"name": "mast", **obstacle}]
    scene = load_scene(data)
    found = tube_warning(scene, robot_of(scene))
    assert found.startswith(left_out) and bool(found) == bool(left_out)


@pytest.mark.parametrize("end", [(0.0, 0.0, 2.0), (0.1, 0.0, -2.0)])
def test_a_tube_that_starts_at_the_arm_is_told_to_stand_below_it(end: tuple[float, float, float]) -> None:
    """Advised is a mast of the same length that ends at the arm and carries it from below."""
    data = load_scene("mast_inspection").as_data()
    tube = data["base"]["tube"]
    tube |= {"start_m": [0.0, 0.0, 0.0], "end_m": list(end)}
    with pytest.raises(SceneError, match=r"set end_m: \[.*\], start_m: \[.*\], or") as caught:
        robot_of(load_scene(data))
    advised = re.findall(r"(\w+_m): (\[[^]]*\])", str(caught.value))
    tube |= {key: json.loads(value) for key, value in advised}
    scene = load_scene(data)
    assert tube_warning(scene, robot_of(scene)) == ""
    start, top = (np.array(tube[key]) for key in ("start_m", "end_m"))
    np.testing.assert_allclose(top, 0, atol=1e-9)
    np.testing.assert_allclose(start, np.array(end) * (-1 if end[2] > 0 else 1), atol=1e-9)


def test_a_tube_may_end_at_a_first_joint_that_slides_with_and_without_a_mount(tmp_path: Path) -> None:
    """A column that lifts the arm: where its base frame is held, no arm is."""
    tube = load_scene("mast_inspection").as_data()["base"]["tube"] | {"start_m": [0, 0, -1]}
    data = rail_data(tmp_path) | {"guardrail": {"bays": 0}}
    data["robot"]["mount"] = mount = {"xyz": [0.0, 0.0, 0.0], "rpy_deg": [0, 0, 0]}
    joint = [0.1, 0, 0.1]
    for end, away in ((0.0, ""), (0.4, "The mast ends 0.4 m from the arm's first joint at (0.1, 0, 0.1)")):
        data["base"] = {"name": "mast", "tube": tube | {"end_m": [joint[0], 0, joint[2] + end]}}
        for stands in ({}, {"mount": mount}):
            robot = {key: value for key, value in data["robot"].items() if key != "mount"}
            scene = load_scene(data | {"robot": robot | stands})
            said = tube_warning(scene, robot_of(scene))
            assert said.startswith(away) and bool(said) == bool(away)
            assert held_point(scene, robot_of(scene)) == scene.base.tube.end_m
    mount["xyz"] = [0, 0, 700]
    with pytest.raises(SceneError, match=r"mount.xyz: got \[0, 0, 700\], .*millimetres\? then \[0, 0, 0.7\]"):
        robot_of(load_scene(data))
