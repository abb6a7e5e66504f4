"""Natural mistakes are recognised, and the place in the file is named."""

import json
import math
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from command_line import refusal, run, write_scene
from small_scenes import SHORT

import cmbot
from cmbot.common.errors import InputError, PathNotFound
from cmbot.common.installation import model_folder, scene_folder
from cmbot.elastic.sag import TooSoftError
from cmbot.planning.precheck import failures_explained
from cmbot.scene import PlannerOptions

TEXT = """\
# A scene whose lines are counted.
format: cmbot-scene/2
name: counted
start: {posture_deg: [-10, -90, 90, 0, 10, 50, 0]}
tool_path:
  legs:
    - by: [0, -0.3, 0]
      seconds: 4
    - {by: [0, 0.3, 0], seconds: 4}
  via_points: 8
obstacles:
  - name: ball
    sphere: 0.1
    xyz: [3, 3, 3]
"""


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("name: counted", "nam: counted", "3: nam: got an unknown key"),
        ("name: counted\n", "", " name: got nothing"),
        ("seconds: 4\n", "seconds: -4\n", "8: tool_path.legs[0].seconds: got -4"),
        ("seconds: 4}", "seconds: x}", "9: tool_path.legs[1].seconds: got 'x'"),
        ("0.3, 0], s", "0.3], s", "9: tool_path.legs[1].by: got [0, 0.3]"),
        ("      seconds: 4\n", "", "7: tool_path.legs[0]: got none"),
        ("    sphere: 0.1\n", "", "12: obstacles[0]: got none"),
        ("sphere: 0.1", "mesh: none.obj", "13: obstacles[0].mesh: got 'none.obj'"),
        ("10, 50, 0]", "10, 50]", "4: start.posture_deg: got 6 numbers, expected 7"),
        ("8\n", "8\nplanner:\n  chart_seeds: 2147483648\n", "12: planner.chart_seeds: got 2147483648"),
        ("8\n", "8\n  via_points: 9\n", "11: tool_path.via_points: got the same key again"),
        ("8\n", "8 9: x\n", "10: got mapping values are not allowed here"),
    ],
)
def test_the_line_of_a_wrong_key_or_value_is_named(old: str, new: str, place: str, tmp_path: Path) -> None:
    path = tmp_path / "counted.yaml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    assert refusal("check", path).startswith(f"error: {path}:{place}")


def test_the_line_is_named_in_a_robots_files_too(urdf_folder: Path) -> None:
    path = urdf_folder / "joint_limits.yaml"
    text = path.read_text(encoding="utf-8").replace(
        "joint_2: {acceleration_deg: 60", "joint_2: {acceleration_deg: 0"
    )
    path.write_text(text, encoding="utf-8")
    line = text[: text.index("joint_2:")].count("\n") + 1
    with pytest.raises(
        InputError, match=rf"joint_limits.yaml:{line}: joints.joint_2.acceleration_deg: got 0"
    ):
        cmbot.load_robot(urdf_folder / "cmbot.urdf", base_frame="arm_base", tool_frame="tool0")


def in_radians(**changes: Any) -> dict[str, Any]:
    return {
        **SHORT,
        "start": {"posture_deg": [round(math.radians(angle), 4) for angle in SHORT["start"]["posture_deg"]]},
        **changes,
    }


def test_radians_for_degrees_are_suspected(tmp_path: Path) -> None:
    path = write_scene(tmp_path / "radians.yaml", in_radians())
    first, *others = run("check", path).out.splitlines()
    assert (
        first == f"warning: {path}:1: start.posture_deg: got numbers that look like radians, expected degrees"
    )
    assert others[0].startswith("error: ")
    with pytest.raises(cmbot.PlanningError, match=r"^line 1: start.posture_deg: looks like radians, it is"):
        cmbot.plan(cmbot.load_scene(path))


@pytest.mark.parametrize(
    "posture", [SHORT["start"]["posture_deg"], [0, 0, 0, 0, 0, 0, 0], [1, 2, 3, 4, 5, 6, 0]]
)
def test_degrees_are_not_taken_for_radians(posture: list[float], tmp_path: Path) -> None:
    legs = [{"by": [0, -30, 0], "seconds": 4}]
    scene = {**SHORT, "start": {"posture_deg": posture}, "tool_path": {"legs": legs}}
    path = write_scene(tmp_path / "far.yaml", scene)
    outcome = run("check", path)
    assert outcome.out.startswith(("warning: ", "error: "))
    assert "radians" not in outcome.out
    with pytest.raises(cmbot.PlanningError) as caught:
        cmbot.plan(cmbot.load_scene(path))
    assert "radians" not in str(caught.value)


def test_degrees_for_radians_are_suspected(tmp_path: Path) -> None:
    scene = SHORT | {"start": {"posture": SHORT["start"]["posture_deg"]}}
    line = refusal("check", write_scene(tmp_path / "degrees.yaml", scene))
    assert ": start.posture[0]: got " in line
    looks = "start.posture looks like degrees, or mm of a joint that slides, it is in rad and m"
    assert line.endswith(f": {looks} (start.posture_deg is in degrees)")


def test_stiffness_and_adhesion_in_other_units_are_suspected(tmp_path: Path) -> None:
    soft = {**SHORT, "guardrail": {"stiffness": [2000, 400, 3000, 200, 100, 80]}}
    path = write_scene(tmp_path / "soft.yaml", soft)
    first, second, *_ = run("check", path).out.splitlines()
    assert first == (
        f"warning: {path}:1: guardrail.stiffness: got numbers that look like N/mm, expected N/m and Nm/rad"
    )
    assert f"{path}:1: guardrail.stiffness: got " in second
    weak = {**SHORT, "guardrail": {"hold": {"kind": "magnet", "adhesion_n": 5}}}
    path = write_scene(tmp_path / "weak.yaml", weak)
    out = run("check", path).out
    assert f"{path}:1: guardrail.hold.adhesion_n: got numbers that look like kN, expected N\n" in out
    assert re.search(r"got \d+ N of adhesion, times safety 2, where a foot has 5 N, expected", out)
    clamp = {"kind": "clamp", "force_n": [4, 4, 4], "moment_nm": [1.2, 1.2, 1.2]}
    clamped = write_scene(tmp_path / "clamp.yaml", {**SHORT, "guardrail": {"hold": clamp}})
    told = f"{clamped}:1: guardrail.hold.force_n: got numbers that look like kN, expected N\n"
    assert told in run("check", clamped).out
    with pytest.raises(
        cmbot.PlanningError, match=r"^line 1: guardrail.hold.adhesion_n: looks like kN, it is in N: line 1: "
    ) as e:
        cmbot.plan(cmbot.load_scene(path))
    assert re.search(
        r"the start asks \d+ N of adhesion, times safety 2, where a foot has 5 N: ", str(e.value)
    )


def test_a_base_on_which_the_arm_topples_is_named(tmp_path: Path) -> None:
    """Stiff enough against shifts to be in N/m, and too soft against tilts."""
    scene = {**SHORT, "guardrail": {"stiffness": [2e5, 2e5, 2e5, 60, 60, 60]}}
    path = write_scene(tmp_path / "topples.yaml", scene)
    assert f"warning: {path}:1: guardrail.stiffness: got " in run("check", path).out
    with (
        pytest.raises(
            cmbot.SceneError, match=r"topples\.yaml:\d+: guardrail\.stiffness: got so soft .* topples"
        ),
        failures_explained(cmbot.load_scene(path)),
    ):
        raise TooSoftError("Sag.at", "q[2]", "a posture from which the arm topples", "a stiff arm")


def test_drives_on_which_the_arm_topples_are_named(tmp_path: Path) -> None:
    """Not the base, which would not help."""
    elasticity = tmp_path / "soft.yaml"
    elasticity.write_text("format: cmbot-elasticity/2\njoints: {panda_joint2: {stiffness_nm_rad: 14}}\n")
    scene = cmbot.load_scene("mast_inspection").with_values({"robot.elasticity": str(elasticity)})
    found = [each for each in cmbot.planning.precheck_scene(scene).warnings if "topples" in each.got]
    assert [each.key for each in found] == ["robot.elasticity"]
    assert found[0].expected.endswith("panda_joint2 has 14 Nm/rad: Nm/arcmin?")
    with (
        pytest.raises(cmbot.SceneError, match=r"robot\.elasticity: got so soft .* topples"),
        failures_explained(scene),
    ):
        raise TooSoftError("Sag.at", "q[2]", "a posture from which the arm topples", "a stiff arm")


def test_check_refuses_a_leg_that_no_plan_reaches(tmp_path: Path) -> None:
    far = {**SHORT, "tool_path": {**SHORT["tool_path"], "legs": [{"by": [0, -400, 0], "seconds": 900}]}}
    outcome = run("check", write_scene(tmp_path / "far.yaml", far))
    assert outcome.status == 2
    assert "No plan is possible: 1 error, " in outcome.out
    near = run("check", write_scene(tmp_path / "near.yaml", SHORT))
    assert near.status == 0
    # Names and values are apart, however long the name.
    assert re.search(r"^locked joint that bears most there  climb_", near.out, re.MULTILINE)


def test_obstacles_in_millimetres_are_suspected(tmp_path: Path) -> None:
    box = {"name": "table", "box": [1000, 800, 50], "xyz": [0, 0, 0]}
    near = write_scene(tmp_path / "near.yaml", {**SHORT, "obstacles": [box]})
    first = run("check", near).out.splitlines()[0]
    assert first == (
        f"warning: {near}:1: obstacles[0]: got numbers that look like millimetres, expected metres "
        "(scale: 1 says that they are)"
    )
    with pytest.raises(
        cmbot.PlanningError, match=r"^line 1: obstacles\[0\]: looks like millimetres, it is in metres \(scale"
    ):
        cmbot.plan(cmbot.load_scene(near))
    floor = {"name": "floor", "box": [100, 100, 1], "xyz": [0, 0, -9]}
    out = run("check", write_scene(tmp_path / "floor.yaml", {**SHORT, "obstacles": [floor]})).out
    assert "look like millimetres" not in out


def test_a_urdf_given_as_scene() -> None:
    urdf = model_folder() / "urdf" / "cmbot.urdf"
    expected = "got XML, such as a URDF, expected a YAML file of keys and values; cmbot check inspects a URDF"
    assert refusal("plan", urdf) == f"error: {urdf}: {expected}"


@pytest.mark.parametrize("content", [TEXT, json.dumps(SHORT), json.dumps(SHORT, indent=2)])
def test_a_scene_given_as_urdf(content: str, tmp_path: Path) -> None:
    (tmp_path / "other.yaml").write_text(content, encoding="utf-8")
    robot = {
        "model": "other.yaml",
        "base_frame": "arm_base",
        "tool_frame": "tool0",
        "limits": str(model_folder() / "urdf" / "joint_limits.yaml"),
        "mount": {"xyz": [0, 0, 0], "rpy_deg": [0, 0, 0]},
    }
    line = refusal("check", write_scene(tmp_path / "scene.yaml", {**SHORT, "robot": robot}))
    assert line == f"error: {tmp_path / 'other.yaml'}: got a scene file, expected a URDF file"


def test_a_missing_urdf_is_said_before_what_goes_with_it(tmp_path: Path) -> None:
    path = write_scene(tmp_path / "scene.yaml", {**SHORT, "robot": {"model": "nosuch.urdf"}})
    assert refusal("plan", path).startswith(
        f"error: {path}:1: robot.model: got 'nosuch.urdf', expected a file"
    )
    with pytest.raises(InputError, match=r"^nosuch\.urdf: no such file, expected a URDF file$"):
        cmbot.load_robot("nosuch.urdf")


def test_the_obstacle_in_the_way_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    # Whether less of the tool's pose would do takes a while to find out.
    monkeypatch.setattr("cmbot.planning.planner.advice", lambda trial: "")
    wall = {"name": "wall", "box": [0.02, 3, 3], "xyz": [2.0, 0.7, -2.0]}
    for knots in ("fixed", "sliding"):
        scene = {
            **SHORT,
            "obstacles": [wall],
            "planner": {"knots": knots, "other_starts": 0, "chart_seeds": 20},
        }
        scene["tool_path"] = {"legs": [{"by": [0.4, 0, 0], "seconds": 4}], "via_points": 8}
        with pytest.raises(PathNotFound, match="wall") as caught:
            cmbot.plan(cmbot.load_scene(scene))
        assert caught.value.pair is not None
        assert "wall" in caught.value.pair


def test_every_option_is_listed_with_default_bounds_and_meaning() -> None:
    outcome = run("plan", "--options")
    assert (outcome.status, outcome.err) == (0, "")
    listed = dict(re.findall(r"^(\w+)=(.*)\n    \w.*$", outcome.out, flags=re.MULTILINE))
    defaults = PlannerOptions()
    assert list(listed) == [field.name for field in fields(PlannerOptions)]
    assert listed["start"] == "free  (free, pinned)"
    assert listed["chart_seeds"] == f"{defaults.chart_seeds}  (whole, 1 to 10000)"
    assert listed["compensate"] == "auto  (auto, true or false)"
    assert listed["safety_margin_m"] == "0.02  (0 to 1000)"
    assert listed["axis_weights"].endswith("(a list of 3 numbers, each 0 to 1e+06)")
    assert (scene_folder() / "scene.schema.json").is_file()


def test_doctor_lists_the_programs_of_videos() -> None:
    names = {line.split()[1] for line in run("doctor").out.splitlines()}
    assert names >= {"chromium", "chromedriver", "ffmpeg", "selenium"}
