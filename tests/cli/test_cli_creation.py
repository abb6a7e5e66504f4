"""``cmbot new``: a scene that can be planned at once, and what keeps it from being written."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import output, refusal, run
from rail_arms import rail_urdf
from urdf_arms import ROBOTS, only_collision

import cmbot
from cmbot.collision import Clearances
from cmbot.common.installation import scene_folder
from cmbot.planning import precheck_scene, robot_of
from cmbot.robot import Kinematics


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_scene_of_the_panda(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    srdf = ROBOTS / "panda_description" / "srdf" / "panda.srdf"
    only_collision("panda", here).with_suffix(".srdf").write_bytes(srdf.read_bytes())
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(ROBOTS.parent.parent))
    out = output("new", "--from", "panda.urdf", "--tool-at", "0.5", "0", "0.4")
    robot_words, leg, base, *_ = out.splitlines()
    assert robot_words == "panda: 7 joints from panda_link0 to panda_hand_tcp"
    assert leg.startswith("A first leg takes the tool by (") and leg.endswith("put your own into tool_path.")
    assert (
        base == "The base is rigid: base.tube or guardrail.stiffness says how it bends, base.name what it is."
    )
    *_, limits, written = out.splitlines()
    assert limits.startswith("The assumed limits are in panda.limits.yaml: put those of your robot's")
    assert written == "Written: panda.yaml, panda.limits.yaml. Plan it: cmbot plan panda.yaml"
    text = (here / "panda.yaml").read_text(encoding="utf-8")
    assert text.startswith("# yaml-language-server: $schema=")
    schema = Path(text.splitlines()[0].partition("=")[2])
    assert json.loads(schema.read_text(encoding="utf-8"))["title"] == "cmbot-scene/2"
    scene = cmbot.load_scene("panda.yaml")
    assert (scene.name, scene.robot.model) == ("panda", str(here / "panda.urdf"))
    assert scene.strokes[0].keep == "pose"
    assert scene.strokes[0].via_points == "auto"
    assert scene.base_name == "base"
    assert "\n  model: panda.urdf\n" in text
    assert (scene.all_obstacles, scene.elastic_guardrail.post_positions) == ((), ())
    robot = robot_of(scene)
    point = Kinematics(robot).tool_pose(scene.posture).translation
    np.testing.assert_allclose(point, [0.5, 0, 0.4], rtol=0, atol=1e-4)
    assert Clearances(robot, []).query(scene.posture[None]).distance[0] >= scene.planner.safety_margin_m
    robot.posture(scene.posture)
    # The limits that it was given are those that were assumed, as the robot's own file now.
    np.testing.assert_allclose(robot.limits.acceleration, 2 * robot.limits.velocity, rtol=1e-5)
    np.testing.assert_allclose(robot.limits.jerk, 20 * robot.limits.velocity, rtol=1e-5)
    limits = here / "panda.limits.yaml"
    told = f"Acceleration and jerk limits in {limits} are assumed: it says assumed: true."
    assert [remark for remark in robot.remarks if "assumed" in remark] == [told]
    limits.write_text(limits.read_text("utf-8").replace("assumed: true", "assumed: false"), "utf-8")
    assert not any("assumed" in remark for remark in robot_of(scene).remarks)


def test_a_scene_of_a_urdf_with_limits_and_an_orientation(here: Path, urdf_folder: Path) -> None:
    angles = ("180", "0", "90")
    words = ("new", "--from", urdf_folder / "cmbot.urdf", "--base", "arm_base", "--tool", "tool0")
    out = output(
        *words,
        "--tool-at",
        "1.5",
        "0.8",
        "-1.5",
        "--rpy-deg",
        *angles,
        "-o",
        here / "a" / "my arm.yaml",
        "--json",
    )
    files = json.loads(out)["files"]
    assert files == [str(here / "a" / "my arm.yaml")]
    scene = cmbot.load_scene(files[0])
    assert scene.name == "my_arm"
    assert scene.robot.model == str(urdf_folder / "cmbot.urdf")
    assert scene.robot.limits is None
    X = Kinematics(robot_of(scene)).tool_pose(scene.posture)
    np.testing.assert_allclose(X.translation, [1.5, 0.8, -1.5], rtol=0, atol=1e-4)
    np.testing.assert_allclose(X.rotation, [[0, 1, 0], [1, 0, 0], [0, 0, -1]], rtol=0, atol=1e-4)


def test_links_that_no_motion_parts_are_left_out_not_the_margin(here: Path) -> None:
    """A UR5's own SRDF checks links that are always 19.8 mm apart, below the default margin."""
    command = ("new", "--from", "ur5", "--tool-at", "0.3", "0.1", "0.4", "-o", "arm.yaml")
    (told,) = (line for line in output(*command).splitlines() if line.startswith("Nearly always nearer"))
    assert "forearm_link and wrist_2_link" in told
    assert told.endswith("; arm.srdf leaves them out.")
    scene = cmbot.load_scene("arm.yaml")
    assert (scene.planner.safety_margin_m, scene.robot.srdf) == (0.02, str(here / "arm.srdf"))
    parted, whole = (
        Clearances(robot, []).query(scene.posture[None]).distance[0]
        for robot in (robot_of(scene), cmbot.load_robot("ur5"))
    )
    assert parted >= 0.02 > whole
    assert run(*command).status == 2
    (here / "arm.yaml").unlink()
    assert "arm.srdf" in run(*command).err


def test_a_scene_of_an_arm_on_a_rail(here: Path) -> None:
    """Postures in rad and m, limits of joints that slide in m; packages as they are given."""
    (here / "packages").mkdir()
    (here / "rail.urdf").write_text(rail_urdf(), encoding="utf-8")
    words = ("new", "--from", "rail.urdf", "--tool-at", "0.9", "0.2", "0.6", "-o", "a/rail.yaml")
    assert "--package-dir: got none, expected a folder" in refusal(*words, "--package-dir", "none")
    out = output(*words, "--package-dir", "packages")
    assert out.splitlines()[0] == "rail: 7 joints from base to tool"
    text = (here / "a" / "rail.yaml").read_text(encoding="utf-8")
    assert '\n  package_dirs: ["../packages"]\n' in text
    scene = cmbot.load_scene("a/rail.yaml")
    assert scene.robot.package_dirs == (str(here / "packages"),)
    assert scene.posture_key == "start.posture"
    robot = robot_of(scene)
    robot.posture(scene.posture)
    point = Kinematics(robot).tool_pose(scene.posture).translation
    np.testing.assert_allclose(point, [0.9, 0.2, 0.6], rtol=0, atol=1e-4)
    np.testing.assert_allclose(robot.limits.jerk, 20 * robot.limits.velocity, rtol=1e-5)
    limits = (here / "a" / "rail.limits.yaml").read_text(encoding="utf-8")
    assert limits.startswith(
        "# Joint limits that a URDF does not have, deg/s2 and deg/s3, or m/s2 and m/s3.\n"
    )
    assert "\n  rail: {acceleration_m_s2: 0.8, jerk_m_s3: 8}\n" in limits
    assert "degrees" not in output("check", "a/rail.yaml")


def test_the_schema_is_named_so_that_a_scene_can_be_moved_with_it(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def schema_of(name: str) -> str:
        output("new", "--from", "cmbot", "--tool-at", "1.8", "0.8", "-1.5", "-o", name, "--force")
        first = (here / name).read_text(encoding="utf-8").splitlines()[0]
        return first.partition("$schema=")[2]

    schema = scene_folder().resolve() / "scene.schema.json"
    assert schema_of("own.yaml") == str(schema)
    (here / schema.name).write_bytes(schema.read_bytes())
    assert schema_of("own.yaml") == schema.name
    # In a checkout of its own.
    monkeypatch.setattr("cmbot.cli.creation.scene_folder", lambda: here / "scenes")
    (here / "of_ours").mkdir()
    assert schema_of("of_ours/own.yaml") == "../scenes/scene.schema.json"


def test_a_scene_of_the_shipped_robot(here: Path) -> None:
    words = ("new", "--from", "cmbot", "--tool-at", "1.8", "0.8", "-1.5", "-o", "own.yaml")
    output(*words)
    scene = cmbot.load_scene("own.yaml")
    assert (scene.robot.model, scene.base_name) == ("cmbot", "guardrail")
    assert {"top_rail", "post_1"} <= {obstacle.name for obstacle in scene.all_obstacles}
    assert [path.name for path in here.iterdir()] == ["own.yaml"]
    # It is made anew as it was, but only when that is asked for.
    text = (here / "own.yaml").read_text(encoding="utf-8")
    again = "own.yaml: got a file that is already there, expected a new file, or --force"
    assert refusal(*words).endswith(again)
    assert run(*words, "--force", "--quiet").out == ""
    assert (here / "own.yaml").read_text(encoding="utf-8") == text


def test_of_a_tool_point_out_of_reach_the_nearest_one_is_told() -> None:
    """Where only the point is kept the two are as far apart as is said, along the line to the arm."""
    said = refusal("new", "--from", "panda", "--tool-at", "9", "0", "0", status=3)
    found = re.search(r"; the nearest is (\S+) mm off.*, at \((.*)\) m$", said)
    assert found is not None
    at = np.array([float(part) for part in found[2].split(",")])
    assert 1e3 * np.linalg.norm(at - [9, 0, 0]) == pytest.approx(float(found[1]), rel=1e-2)
    assert abs(at[1]) < 0.05 and 0.8 < at[0] < 1.1


@pytest.mark.parametrize(
    ("words", "message", "status"),
    [
        (
            ("panda", "--tool-at", "9", "0", "0"),
            "no start posture: none of 2000 random ones leads to one that holds the tool there within the "
            "joints' ranges; the point is 9.006 m from the arm's first joint, beyond its reach of ",
            3,
        ),
        (
            ("panda", "--tool-at", "0.7", "0", "0.05", "--rpy-deg", "0", "0", "0"),
            "holds the tool there, its axis along (0, 0, 1) of W, within the joints' ranges; the point is "
            "0.755 m from the arm's first joint, within its reach",
            3,
        ),
        (("cmbot", "--tool-at", "0", "0", "0"), "no start posture: ", 3),
        (
            ("panda", "--tool-at", "nan", "0", "0"),
            "--tool-at: got nan, expected a number of at least -10000",
            2,
        ),
        (("panda", "--tool-at", "1", "0", "0", "--rpy-deg", "0", "0", "999"), "--rpy-deg: got 999", 2),
        (
            ("cmbot", "--tool-at", "1", "0", "0", "--base", "x"),
            "--base: got an option, expected none with --from cmbot",
            2,
        ),
        (
            ("talos", "--tool-at", "1", "0", "0"),
            "--tool: got nothing, expected the last link of the arm",
            2,
        ),
        (("TwoDofs", "--tool-at", "1", "0", "0"), "joints: got 2, expected an arm of at least 3 joints", 2),
        (("pandas", "--tool-at", "1", "0", "0"), "pandas: no such file", 2),
        (("panda", "--tool-at", "1", "0", "0", "-o", "."), "got a folder, expected the path of a file", 2),
    ],
)
def test_what_cannot_be_written(here: Path, words: tuple[str, ...], message: str, status: int) -> None:
    assert message in refusal("new", "--from", *words, status=status)
    assert list(here.iterdir()) == []


def test_a_robot_is_checked_by_its_name(here: Path) -> None:
    out = output("check", "panda", "--json")
    found = json.loads(out)
    assert (found["kind"], found["usable"], found["found"]["SRDF"]) == ("urdf", True, "panda.srdf")
    assert found["found"]["arm where no frames are given"] == "from panda_link0 to panda_hand_tcp"
    assert "none: there are several choices" in output("check", "talos", "--quiet", "--json")


SHAPE = '<collision><origin xyz="{x} 0 0"/><geometry><box size="0.2 0.05 0.05"/></geometry></collision>'
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} 0 0.2"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>"""
ARM = "".join(
    (
        '<robot name="arm">',
        *(
            f'<link name="{name}"><inertial><mass value="1"/>'
            f'<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>{SHAPE.format(x=x)}</link>'
            for name, x in (("base", 0), ("a", 0.1), ("b", 0.1))
        ),
        JOINT.format(name="j", parent="base", child="a", x=0),
        JOINT.format(name="k", parent="a", child="b", x=0.2),
        "</robot>",
    )
)


def test_an_srdf_is_written_once(here: Path) -> None:
    (here / "arm.urdf").write_text(ARM, encoding="utf-8")
    out = output("check", "arm.urdf", "--write-srdf", "arm.srdf")
    assert "arm.srdf: 3 pairs of links (2 Adjacent, 0 Always, 1 Never)" in out
    assert "--write-srdf" not in out
    pairs = [dict(pair.attrib) for pair in ElementTree.parse(here / "arm.srdf").getroot()]
    assert pairs[1] == {"link1": "a", "link2": "base", "reason": "Adjacent"}
    state = '<group_state name="stow" group="arm"><joint name="j" value="1" /></group_state>'
    text = (here / "arm.srdf").read_text(encoding="utf-8").replace("</robot>", f"{state}</robot>")
    (here / "arm.srdf").write_text(text, encoding="utf-8")
    assert "group states in it stow (arm)" in " ".join(output("check", "arm.urdf").split())
    output("check", "arm.urdf", "--write-srdf", "again.srdf")
    again = ElementTree.parse(here / "again.srdf").getroot()
    assert [each.tag for each in again] == ["group_state", *3 * ["disable_collisions"]]
    assert again[0][0].attrib == {"name": "j", "value": "1"}
    assert "got arm.srdf, which is there, expected the path of a new file" in refusal(
        "check", "arm.urdf", "--write-srdf", "arm.srdf"
    )
    assert "got a scene to check, expected a URDF" in refusal("check", "triangle", "--write-srdf", "b.srdf")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--tool-at", "1", "2", "3"), "--from: got nothing, expected --from URDF"),
        (("--from", "panda"), "--tool-at: got nothing"),
        (
            ("--from", "ur10", "--tool-at", "0.6", "0.1", "0.5", "--near", "elbow=1"),
            "--near: got elbow, expected of shoulder_pan_joint, ",
        ),
        (
            ("--from", "ur10", "--tool-at", "0.6", "0.1", "0.5", "--near", "elbow_joint=up"),
            "--near: got elbow_joint=up, expected NAME=NUMBER, in rad or m",
        ),
    ],
)
def test_a_new_scene_is_of_a_robot_at_a_place(here: Path, words: tuple[str, ...], said: str) -> None:
    assert said in refusal("new", *words)
    assert not list(here.iterdir())


@pytest.mark.parametrize("elbow", [-1.5, 1.5])
def test_the_elbow_is_chosen(here: Path, elbow: float) -> None:
    """There is a posture with the same angle on either side."""
    words = ("--from", "ur10", "--tool-at", "0.6", "0.1", "0.5", "--rpy-deg", "180", "0", "0")
    output("new", *words, "--near", f"elbow_joint={elbow}", "-o", "arm.yaml")
    scene = cmbot.load_scene("arm.yaml")
    assert abs(scene.posture[2] - elbow) < 0.5
    X = Kinematics(robot_of(scene)).tool_pose(scene.posture)
    np.testing.assert_allclose(X.translation, [0.6, 0.1, 0.5], rtol=0, atol=1e-4)


def test_the_start_is_sought_where_a_lift_is_locked(here: Path) -> None:
    (here / "rail.urdf").write_text(rail_urdf(), encoding="utf-8")
    asked = ("new", "--from", "rail.urdf", "--base", "rail_link", "--tool-at", "1.0", "0.5", "0.2")
    output(*asked, "--locked", "rail=0.3", "-o", "here.yaml")
    scene = cmbot.load_scene("here.yaml")
    assert dict(scene.robot.locked or ()) == {"rail": 0.3}
    point = Kinematics(robot_of(scene)).tool_pose(scene.posture).translation
    np.testing.assert_allclose(point, [1.0, 0.5, 0.2], atol=1e-4)
    for value, said in (
        ("rail=0.8", "--locked: got 0.8, expected its range, -0.5 to 0.7"),
        ("rial=0.1", "--locked: got 'rial', expected a joint that turns or slides"),
        ("pan=0.1", "none of the arm's: it moves the arm from 'rail_link'; to lock it, --base pan_link"),
        ("rail=up", "--locked: got rail=up, expected NAME=NUMBER, in rad or m"),
        ("rail", "--locked: got 'rail', expected NAME=VALUE, such as lift_joint=0.3"),
    ):
        assert said in refusal(*asked, "--locked", value)


def test_a_scene_says_how_a_stiffness_on_top_of_a_locked_lift_is_written(here: Path) -> None:
    (here / "rail.urdf").write_text(rail_urdf().replace("0.1 0 0.1", "0.1 0 1.5"), encoding="utf-8")
    asked = ("new", "--from", "rail.urdf", "--base", "rail_link", "--locked", "rail=0.3", "--tool-at")
    output(*asked, "1.0", "0.5", "1.6", "-o", "rail.yaml")
    text = (here / "rail.yaml").read_text(encoding="utf-8")
    assert "measured at rail_link, now at (0.1, 0.3, 1.5) m" in text
    before = robot_of(cmbot.load_scene("rail.yaml"))
    # The comments are lines of the scene: those of the robot go there.
    commented = re.findall(r"\n#   (mount|carried_from)(:.*)", text)
    lines = "".join(f"\n  {key}{value}" for key, value in commented)
    text = text.replace("\nrobot:", f"\nrobot:{lines}")
    text = re.sub(r"\nguardrail: .*\n# guardrail: ", "\nguardrail: ", text)
    (here / "bends.yaml").write_text(text, encoding="utf-8")
    scene = cmbot.load_scene("bends.yaml")
    checked = precheck_scene(scene)
    assert dict(checked.found)["stiffness of the base acts at"] == "(0, 0, 0) m, at rail_link"
    assert not checked.warnings
    # W is at the arm's base; the foot's 5 kg are on the floor.
    robot = robot_of(scene)
    assert before.mass - robot.mass == pytest.approx(5.0)
    points = [Kinematics(each).tool_pose(scene.posture).translation for each in (before, robot)]
    np.testing.assert_allclose(points[0] - points[1], [0.1, 0.3, 1.5], atol=1e-12)


def test_a_place_that_was_meant_from_the_base_is_said_in_the_world(here: Path) -> None:
    (here / "rail.urdf").write_text(rail_urdf().replace("0.1 0 0.1", "0.1 0 1.5"), encoding="utf-8")
    asked = ("new", "--from", "rail.urdf", "--base", "rail_link", "--locked", "rail=0.3", "--tool-at")
    told = refusal(*asked, "0.9", "0.2", "-0.2", status=3)
    in_world = "it is in W, where rail_link is at (0.1, 0.3, 1.5) m"
    assert f"{in_world}; these numbers there are (1, 0.5, 1.3) m in W, where the tool can be held" in told
    # Where neither is reached.
    assert refusal(*asked, "9", "0", "0", status=3).endswith(in_world)
    output(*asked, "1", "0.5", "1.3")


@pytest.mark.parametrize(("angles", "warned"), [(("3.14159", "0", "0"), True), (("180", "0", "0"), False)])
def test_angles_that_look_like_radians_are_warned_of(
    here: Path, angles: tuple[str, ...], warned: bool
) -> None:
    assert here.is_dir()
    out = output(
        "new", "--from", "ur10", "--tool-at", "0.6", "0.1", "0.5", "--rpy-deg", *angles, "-o", "a.yaml"
    )
    told = "warning: --rpy-deg: got numbers that look like radians, expected degrees"
    assert (told in out.splitlines()) == warned
