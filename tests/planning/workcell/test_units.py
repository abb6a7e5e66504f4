"""Obstacles in millimetres: refused, warned of, read by their scale, or meant."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import trimesh
from command_line import run, write_scene
from pydantic import ValidationError
from rail_arms import rail_data
from small_scenes import SHORT, short_scene

import cmbot
from cmbot.common.errors import SceneError
from cmbot.common.installation import shipped_scenes
from cmbot.planning import precheck_scene, robot_of
from cmbot.planning.workcell.units import mistaken_units, require_metres, unit_findings
from cmbot.scene.changes import changed_content
from cmbot.scene.robot_entry import AttachedToolFile, ToolShapeFile

TABLE = {"name": "table", "box": [1000, 800, 60], "xyz": [1800, 700, -2700]}
WALL = {"name": "wall", "box": [20, 0.3, 5], "xyz": [0, 60, 0]}
DECK = {"name": "deck", "box": [40, 9, 5], "xyz": [0, 0, 20]}


ROWS = {"origin": [1.7, 0, -2.1], "u": [0.3, 0, 0], "v": [0, 0.1, 0], "spacing_m": 0.1, "stand_off_m": 0.1}


def with_obstacle(**changes: Any) -> dict[str, Any]:
    return {**SHORT, "obstacles": [changes]}


@pytest.mark.parametrize("command", ["check", "plan"])
@pytest.mark.parametrize(
    ("obstacle", "expected"),
    [
        (TABLE, "size and xyz in metres; scale: 1"),
        ({**TABLE, "xyz": [1.8, 0.7, -2.7]}, "metres; scale: 0.001 reads its size in millimetres, not xyz; "),
        ({**TABLE, "scale": 0.001}, "xyz in metres, as scale has no part in it"),
        ({"name": "ball", "sphere": 50, "xyz": [2000, 700, -2700]}, "size and xyz in metres"),
        (WALL, "scale: 1 says that it is meant"),
    ],
)
def test_what_is_near_as_millimetres_and_far_as_given_is_refused(
    obstacle: dict[str, Any], expected: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = run(command, write_scene(tmp_path / "mm.yaml", with_obstacle(**obstacle)))
    assert (outcome.status, outcome.out) == (2, "")
    line = outcome.err.splitlines()[-1]
    assert ": obstacles[0]: got " in line
    assert "millimetres" in line
    assert expected in line


@pytest.mark.parametrize(
    ("path", "tool", "suspected"),
    [
        ({"raster": {**ROWS, "lean_deg": [0, 15]}, "speed_m_s": 0.05}, {"contact_mm": 60}, {}),
        ({"raster": ROWS, "speed_m_s": 0.05}, {"contact_mm": 0.06}, {"tool.contact_mm": "metres"}),
        (
            {"raster": {**ROWS, "lean_deg": [0, 0.26]}, "speed_m_s": 50},
            {},
            {"tool_path.raster.lean_deg": "radians", "tool_path.speed_m_s": "mm/s"},
        ),
        (
            {"legs": [{"by": [0, 0.1, 0], "speed_m_s": 50}]},
            {"max_speed_m_s": 90},
            {"tool.max_speed_m_s": "mm/s", "tool_path.legs[0].speed_m_s": "mm/s"},
        ),
        (
            {"legs": [{"arc": {"centre": [0, 99, 0], "axis": [1, 0, 0], "angle_deg": 1.571}, "seconds": 9}]},
            {"process_force_n": [0, 0, -20], "process_ramp_s": 50},
            {
                "tool.process_ramp_s": "milliseconds",
                "tool_path.legs[0].arc.centre": "millimetres",
                "tool_path.legs[0].arc.angle_deg": "radians",
            },
        ),
        (
            {"waypoints": [[1800, 0, 0, 1, 0, 0, 0], [1800, 9, 0, 1, 0, 0, 0]], "seconds": 9},
            {"fixed": {"xyz": [1.8, 0, 0], "rpy_deg": [3.1416, 0, 1.57]}},
            {"tool.fixed.rpy_deg": "radians", "tool_path.waypoints": "millimetres"},
        ),
        # Odd, and not mistaken.
        (
            {"legs": [{"arc": {"centre": [0, -0.2, 0], "axis": [1, 0, 0], "angle_deg": 1.5}, "seconds": 9}]},
            {"fixed": {"xyz": [1.8, 0, 0], "rpy_deg": [0.35, 0, 1.1]}},
            {},
        ),
    ],
)
def test_units_of_tool_and_path_are_suspected(
    path: dict[str, Any], tool: dict[str, Any], suspected: dict[str, str]
) -> None:
    scene = cmbot.load_scene({**SHORT, "tool_path": path, "tool": tool})
    assert {key: looks for key, looks, _ in mistaken_units(scene)} == suspected


def test_following_the_advice_leads_to_a_scene_without_a_warning() -> None:
    """The table in metres, by its scale, and in metres by hand are the same obstacle."""
    lying = [1.8, 0.7, -4.7]
    read = cmbot.load_scene(with_obstacle(**{**TABLE, "scale": 0.001, "xyz": lying}))
    same = cmbot.load_scene(with_obstacle(name="table", box=[1, 0.8, 0.06], xyz=lying))
    assert read.all_obstacles[0].shape == same.all_obstacles[0].shape
    assert not precheck_scene(read).warnings
    assert not precheck_scene(cmbot.load_scene(with_obstacle(**WALL, scale=1))).warnings


def test_what_is_long_is_warned_of_until_its_scale_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cmbot.views.pages", lambda _: {})
    warning = "obstacles[0]: got numbers that look like millimetres, expected metres (scale: 1 says that"
    for scale, number in (({}, 1), ({"scale": 1}, 0)):
        path = write_scene(tmp_path / "deck.yaml", with_obstacle(**DECK, **scale))
        outcome = run("plan", path, "--force", "--verbose")
        assert outcome.err.count(warning) == number
        assert outcome.out.count("Numbers of obstacles[0] look like millimetres; ") == number
        assert run("check", path).out.count(warning) == number


@pytest.mark.parametrize("name", shipped_scenes())
def test_no_shipped_scene_is_suspected(name: str) -> None:
    scene = cmbot.load_scene(name)
    robot = robot_of(scene)
    require_metres(scene, robot)
    assert not [*mistaken_units(scene, robot)]


def test_a_long_guardrail_is_no_obstacle_in_millimetres() -> None:
    """Its posts are far away, and would be near if they were in millimetres."""
    scene = short_scene(guardrail={"bays": 40, "post_spacing_m": 2.0})
    require_metres(scene, robot_of(scene))


def test_a_vast_mesh_is_refused_and_its_scale_is_what_helps(tmp_path: Path) -> None:
    trimesh.creation.box((300, 400, 60)).export(tmp_path / "block.stl")
    block = {"name": "block", "mesh": str(tmp_path / "block.stl"), "xyz": [1.8, 0.7, -4.7]}
    scene = cmbot.load_scene(with_obstacle(**block))
    with pytest.raises(SceneError, match=r"got block, 300 x 400 x 60 m: like millimetres, .*scale: 0\.001"):
        cmbot.plan(scene)
    scaled = precheck_scene(cmbot.load_scene(with_obstacle(**block, scale=0.001)))
    assert not scaled.warnings
    assert dict(scaled.found)["obstacles"].startswith(str(len(short_scene().all_obstacles) + 1))


def test_a_fixed_tool_in_millimetres_is_told_first() -> None:
    tool = {"fixed": {"xyz": [500, 0, 250], "rpy_deg": [0, 0, 0]}}
    first, *_ = precheck_scene(cmbot.load_scene({**SHORT, "tool": tool})).warnings
    assert (first.key, first.got) == ("tool.fixed.xyz", "numbers that look like millimetres")


@pytest.mark.parametrize(
    ("payload", "mass", "suspected"),
    [
        (5, 4, {}),
        (500, 400, {"robot.payload_kg": "grams", "robot.tool.mass_kg": "grams"}),
    ],
)
def test_a_payload_and_a_tool_in_grams_are_suspected(
    payload: float, mass: float, suspected: dict[str, str]
) -> None:
    scene = short_scene(robot={"payload_kg": payload})
    tool = AttachedToolFile(xyz=(0.0, 0.0, 0.12), mass_kg=mass)
    scene = scene.model_copy(update={"robot": scene.robot.model_copy(update={"tool": tool})})
    assert {key: looks for key, looks, _ in mistaken_units(scene)} == suspected


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"u": [500, 0, 0]}, r"raster.u: got \(500.0, .*, expected metres: millimetres\? then \[0.5, 0, 0\]"),
        (
            {"v": [0, 200, 0]},
            r"raster.v: got \(0.0, 200.0, .*, expected metres: millimetres\? then \[0, 0.2, 0\]",
        ),
        ({"stand_off_m": 120}, r"raster.stand_off_m: got 120.0, expected metres: millimetres\? then 0.12"),
    ],
)
def test_a_raster_in_millimetres_is_refused_for_that_first(given: dict[str, Any], said: str) -> None:
    """Not for the number of its rows or via-points, which follow from it."""
    path = {"raster": {**ROWS, **given}, "speed_m_s": 0.1}
    with pytest.raises(SceneError, match=said):
        cmbot.load_scene({**SHORT, "tool_path": path})


@pytest.mark.parametrize(
    ("key", "given", "advised"),
    [
        ("guardrail.hold.plate_m", [150, 130], "[0.15, 0.13]"),
        ("guardrail.post_spacing_m", 1750, "1.75"),
        ("planner.safety_margin_m", 20, "0.02"),
        ("robot.tool_length_m", 300, "0.3"),
        ("robot.tool.xyz", [0, 0, 150], "[0, 0, 0.15]"),
        ("robot.tool.com", [0, 0, 75], "[0, 0, 0.075]"),
        ("robot.tool.shapes[0].cylinder", [20, 130], "[0.02, 0.13]"),
        ("robot.tool.shapes[0].xyz", [0, 0, 65], "[0, 0, 0.065]"),
        ("base.hold.plate_m", [100, 100], "[0.1, 0.1]"),
        ("base.hold.xyz", [0, 0, -50], "[0, 0, -0.05]"),
        ("base.hold.pads[0].disc_m", 60, "0.06"),
        ("base.hold.pads[1].at_m", [-100, 170], "[-0.1, 0.17]"),
    ],
)
def test_millimetres_of_a_part_of_the_robot_are_refused_and_the_advice_helps(
    key: str, given: Any, advised: str
) -> None:
    """A foot as wide in metres as it is in millimetres would hold anything."""
    arm = {"model": "panda", "tool": {"xyz": [0, 0, 0.1], "shapes": [{"cylinder": [0.02, 0.1]}]}}
    pads = [{"disc_m": 0.06, "at_m": [0.2, 0]}, {"disc_m": 0.06, "at_m": [-0.1, 0.17]}]
    hold = {"kind": "magnet", "adhesion_n": 900} | ({"pads": pads} if "pads" in key else {})
    parts: dict[str, dict[str, Any]] = {
        "robot.tool.": {"robot": arm, "start": {"posture": [0.0] * 7}, "guardrail": {"bays": 0}},
        "base.": {"base": {"name": "base", "hold": hold}},
        "guardrail.hold.": {"guardrail": {"hold": {"kind": "magnet", "adhesion_n": 9000}}},
    }
    parts["base."] |= parts["robot.tool."]
    data = SHORT | next((part for begins, part in parts.items() if key.startswith(begins)), {})
    with pytest.raises(SceneError) as caught:
        cmbot.load_scene(changed_content(data, {key: given}))
    said = re.fullmatch(
        rf".*: {re.escape(key)}: got .*, expected metres: millimetres\? then (.*)", str(caught.value)
    )
    assert said and said[1] == advised
    cmbot.load_scene(changed_content(data, {key: json.loads(advised)}))


def test_a_scale_of_a_tool_shape_that_is_no_mesh_is_refused() -> None:
    """It would do nothing."""
    with pytest.raises(ValidationError, match="expected no such key beside cylinder"):
        ToolShapeFile(cylinder=(0.02, 0.13), scale=0.001)


@pytest.mark.parametrize(("mm", "suspected"), [(0.002, ["uncertainty.foot.mm"]), (0.05, [])])
def test_a_foot_known_within_metres_is_suspected(mm: float, suspected: list[str]) -> None:
    scene = short_scene(uncertainty={"foot": {"mm": mm, "deg": 0.2}})
    assert [key for key, *_ in mistaken_units(scene)] == suspected


@pytest.mark.parametrize(
    ("turning", "sliding", "suspected"),
    [(60, 0.5, []), (4.19, 0.5, ["rad/s2"]), (60, 160, ["mm/s2"]), (4.19, 160, ["rad/s2", "mm/s2"])],
)
def test_accelerations_in_radians_or_millimetres_are_suspected(
    turning: float, sliding: float, suspected: list[str], tmp_path: Path
) -> None:
    """By the check; what is planned with them fails late, and for what follows from them."""
    data = rail_data(tmp_path)
    listed = f"all: {{acceleration_deg: {turning}, acceleration_m_s2: {sliding}}}"
    (tmp_path / "limits.yaml").write_text(f"format: cmbot-joint-limits/1\n{listed}\n", encoding="utf-8")
    scene = cmbot.load_scene(data)
    told = [each.got for each in unit_findings(scene, robot_of(scene))]
    assert told == [f"numbers that look like accelerations in {unit}" for unit in suspected]
