"""What ``cmbot check`` says of a URDF, of a scene, and of what is neither."""

import json
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import ENTRY, ROOT, SUMMARIES, environment, output, refusal, run, write_scene
from small_scenes import SHORT

import cmbot
from cmbot.cli import COMMANDS
from cmbot.common.installation import model_folder, scene_folder
from cmbot.planning.workcell.objectives import objective_of
from cmbot.robot import Postures
from cmbot.scene import shipped_scenes


def values(out: str) -> dict[str, str]:
    """The lines but the last, as names and values."""
    pairs = (line.partition("  ") for line in out.splitlines()[:-1])
    return {name: value.strip() for name, _, value in pairs}


def test_a_shipped_scene_and_a_scene_file(tmp_path: Path) -> None:
    out = output("check", "triangle")
    found = values(out)
    assert found["via-points"] == "50"
    assert found["robot"].startswith("cmbot: 7 joints, ")
    assert found["tool path"] == "3 legs, 2.030 m in 20 s, keeps the tool's pose"
    assert (
        found["tool point where its path begins"]
        == "(1.8154, 0.7796, -2.0628) m, its axis along (0.77, 0, -0.64)"
    )
    last = out.splitlines()[-1]
    checked = "No warning. Checked: the start, and places along the path, each for a posture that is within"
    unchecked = "Not checked: the way from one to the next; cmbot plan triangle finds out."
    assert last.startswith(checked)
    assert last.endswith(unchecked)
    block = {"name": "block", "box": [1, 1, 1], "xyz": [9, 9, 9], "workpiece": True}
    # Whatever its name.
    path = write_scene(tmp_path / "short.scene", {**SHORT, "obstacles": [block]})
    out = output("check", path)
    assert f"short ({path})" in out
    assert "1 leg, 0.300 m in 4 s" in out
    assert values(out)["obstacles"].endswith(", of them 1 workpiece")
    # Where nothing says how the tool is turned there, it is as before.
    legs = {"from": {"xyz": [1.8, 0.7, -2.0]}, "legs": [{"by": [0, -0.1, 0], "seconds": 4}]}
    out = run("check", write_scene(tmp_path / "from.yaml", {**SHORT, "tool_path": legs})).out
    turned = ", turned as in start.posture_deg: from has no rpy_deg and no axis"
    assert values(out)["tool point where its path begins"].endswith(turned)


# The tool, a cylinder of radius 0.04 m, is 0.01 m deep in it, or as far away.
START = (1.81535, 0.77957, -2.06284)


@pytest.mark.parametrize(
    ("gap", "words"),
    [(-0.01, "tool reaches 0.0100 m into block"), (0.01, "tool comes within 0.0100 m of block")],
)
def test_from_a_start_that_is_not_clear_no_plan_is_possible(tmp_path: Path, gap: float, words: str) -> None:
    x, y, z = START
    block = {"name": "block", "box": [0.1, 0.1, 0.1], "xyz": [x, y + 0.09 + gap, z]}
    path = write_scene(tmp_path / "short.yaml", {**SHORT, "obstacles": [block]})
    first, *_, last = run("check", path).out.splitlines()
    assert first.startswith(
        f"error: {path}:1: start.posture_deg: got {words}, the safety margin is 0.02 m, expected"
    )
    assert last == "No plan is possible: 1 error, 1 warning."
    with pytest.raises(cmbot.PathNotFound, match="block"):
        cmbot.plan(cmbot.load_scene(path), progress=False)
    start, way = json.loads(run("check", path, "--json").out)["findings"]
    assert (start["severity"], start["key"]) == ("error", "start.posture_deg")
    # No other posture that holds the tool there is clear.
    assert (way["severity"], way["key"]) == ("warning", "tool_path.legs[0]")
    assert "none of" in way["got"] and "block" in way["got"]
    assert run("check", path, "--quiet").out == f"{first}\n"


def test_legs_beyond_reach_and_a_load_too_heavy_are_warned_of(tmp_path: Path) -> None:
    """The shipped arm is 3.78 m long with its tool (Table 2), and its first joint at (0, 0.5, 0)."""
    legs = [{"by": by, "seconds": 9} for by in ([0, 0.1, 0], [0, 3.0, 0], [0, -3.0, 0], [2.5, 0, -2.0])]
    path = write_scene(tmp_path / "far.yaml", {**SHORT, "tool_path": {"legs": legs}})
    outcome = run("check", path)
    assert outcome.status == 2
    *warnings, last = (line for line in outcome.out.splitlines() if "error" in line)
    distance = np.hypot(np.hypot(START[0], START[1] + 0.1 + 3.0 - 0.5), START[2])
    place = f"({START[0]:.3f}, {START[1] + 3.1:.3f}, {START[2]:.3f})"
    assert warnings[0].endswith(
        f": tool_path.legs[1]: got an end at {place} m, {distance:.3f} m from the arm's first joint, "
        "at (0.000, 0.500, 0.000) m, expected at most 3.780 m from there, with arm and tool stretched out; "
        "where the tool's pose is kept, less (lengths are in metres)"
    )
    assert [line.split(": ")[2] for line in warnings] == ["tool_path.legs[1]", "tool_path.legs[3]"]
    assert last == "No plan is possible: 2 errors, 0 warnings."
    heavy = {"model": "cmbot", "payload_kg": 60.0}
    path = write_scene(tmp_path / "heavy.yaml", {**SHORT, "robot": heavy})
    first, second, *_ = run("check", path).out.splitlines()
    # What holds comes first: what the locked joints below the arm bear.
    assert "of what the locked climb_1 holds, 460 Nm" in first
    assert "of the torque that joint_" in second
    assert first.startswith(f"error: {path}:1: start.posture_deg: got ")


@pytest.mark.parametrize(
    ("weights", "warned"), [([0, 0, 1], True), ([0, 0, 0.5], True), ([0, 0.1, 1], False), ([1, 1, 0], False)]
)
def test_an_objective_that_gravity_has_no_part_in_is_warned_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, weights: list[float], warned: bool
) -> None:
    path = write_scene(tmp_path / "z.yaml", {**SHORT, "planner": {"axis_weights": weights}})
    found = json.loads(run("check", path, "--json").out)["findings"]
    assert [finding["key"] for finding in found] == ["planner.axis_weights"] * warned
    for finding in found:
        assert "gravity has no torque about z" in finding["got"]
        assert "a weight above 0 for x or y" in finding["expected"]
    # Before it is planned, too.
    monkeypatch.setattr(cmbot, "plan", Mock(side_effect=cmbot.PlanningError("far enough")))
    path = write_scene(tmp_path / "short.yaml", SHORT)
    words = ("plan", path, "-o", tmp_path / "out", "--set", f"axis_weights={weights}")
    *warnings, last = run(*words).err.splitlines()
    start = f"warning: {path}:1: planner.axis_weights: got {weights}: gravity has no torque about z"
    assert [warning.startswith(start) for warning in warnings] == [True] * warned
    assert last.endswith("short.yaml: far enough")
    assert run(*words, "--quiet").err.endswith("short.yaml: far enough\n")


def test_that_gravity_has_no_torque_about_z_is_so() -> None:
    """Whatever the posture, about the foot or the base."""
    robot = cmbot.load_robot("cmbot")
    rng = np.random.default_rng(0)
    q = rng.uniform(robot.limits.lower, robot.limits.upper, (20, robot.dof))
    for about in ("foot", "base"):
        options = cmbot.PlannerOptions(moment_about=about, axis_weights=(0.0, 0.0, 1.0))
        values = objective_of(robot, options).at_rest(Postures(robot).at(q))
        np.testing.assert_allclose(values, 0.0, atol=1e-9)


def test_a_urdf() -> None:
    out = output("check", model_folder() / "urdf" / "cmbot.urdf")
    found = values(out)
    joints = cmbot.load_robot("cmbot").limits.velocity.size
    assert (found["robot"], found["SRDF"]) == ("cmbot", "cmbot.srdf")
    assert found["group states in it"] == "working_stance (climber), stow (arm)"
    assert found["links"] == f"16, {cmbot.load_robot('cmbot').mass:.2f} kg in all"
    assert found["movable joints"] == "12 (12 revolute)"
    assert found["limits in the URDF"] == "of 12 movable joints: position 12, velocity 12, effort 12"
    assert found["joint_limits.yaml beside it"] == f"acceleration and jerk of {joints} of 12 movable joints"
    assert "tool0" in found["tool frame"]
    assert out.splitlines()[-1] == "OK: no error, 0 warnings."


BARE = """<robot name="bare">
  <link name="floor"/>
  <link name="slide"><inertial><mass value="2.5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <link name="wheel"/><link name="plate"/>
  <joint name="a" type="prismatic"><parent link="floor"/><child link="slide"/>
    <limit lower="0" upper="0.0001" velocity="0" effort="3"/></joint>
  <joint name="b" type="continuous"><parent link="slide"/><child link="wheel"/></joint>
  <joint name="c" type="fixed"><parent link="slide"/><child link="plate"/></joint>
</robot>"""


def test_a_urdf_that_lacks_limits_is_described_and_one_that_is_doubtful_is_usable(tmp_path: Path) -> None:
    path = tmp_path / "bare.urdf"
    path.write_text(BARE, encoding="utf-8")
    outcome = run("check", path)
    assert outcome.status == 0
    velocity, effort, mass, dense, described = outcome.out.split("\n", 4)
    bound = "got nothing, expected a positive bound, here or in a joint-limits file; assumed is"
    assert velocity == f"warning: {path}: joint[a].limit.velocity: {bound} 1 rad/s or 0.1 m/s (2 times)"
    assert effort.startswith(f"warning: {path}: joint[b].limit.effort: {bound} twice")
    assert mass.startswith(f"warning: {path}: link[wheel].inertial.mass: got 0 kg")
    assert dense.startswith(
        f"warning: {path}: link.inertial.mass: got 2.5 kg that move, with a reach of 0.000 m"
    )
    assert described.splitlines()[-1] == (
        f"OK: no error, 5 warnings. cmbot check {path} --write-srdf FILE writes an SRDF."
    )
    assert values(described) == {
        "robot": "bare",
        "links": "4, 2.50 kg in all",
        "movable joints": "2 (1 prismatic, 1 continuous)",
        "prismatic joints": "1, in m and N; the others in rad and Nm",
        "limits in the URDF": "of 2 movable joints: position 2, velocity 0, effort 1",
        "joint_limits.yaml beside it": "none: acceleration and jerk limits are assumed where the scene names "
        "none",
        "SRDF": "none: links that are neighbours or nearly always near may touch",
        "elasticity file": "none: nothing bends",
        "base frame": "any link; the root is floor",
        "tool frame": "any link that joints move below it; at the ends: wheel, plate",
        "arm where no frames are given": "from floor to wheel",
    }
    limited = BARE.replace('upper="0.0001" velocity="0"', 'upper="1" velocity="1"')
    limited = limited.replace('"wheel"/></joint>', '"wheel"/><limit velocity="1" effort="3"/></joint>')
    path.write_text(limited.replace('izz="1"', 'izz="5"'), encoding="utf-8")
    outcome = run("check", path)
    first, second, *_, last = outcome.out.splitlines()
    assert outcome.status == 0
    assert first.startswith(f"warning: {path}: link[slide].inertial.inertia: got principal moments")
    assert second.startswith(f"warning: {path}: link[wheel].inertial.mass: got 0 kg")
    assert last.startswith("OK: no error, 2 warnings. ")


def test_a_damaged_urdf(tmp_path: Path, bare_urdf: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(bare_urdf.replace('value="7.8"', 'value="-7.8"'), encoding="utf-8")
    finding, last = output("check", path, status=2).splitlines()
    assert finding.startswith(f"error: {path}: link[link_1].inertial.mass: got ")
    assert last == "Not usable: 1 error, 0 warnings."


NEITHER = "), expected a URDF (.urdf, .xml, .xacro) or a scene file (.yaml, .yml, .json)"


@pytest.mark.parametrize(
    ("name", "content", "words", "end"),
    [
        ("README.md", (ROOT / "README.md").read_bytes(), "got a file that is neither (", NEITHER),
        ("words.txt", b"words", "got a file that is neither (", NEITHER),
        ("empty", b"", "got a file that is neither (", NEITHER),
        ("data.bin", b"\xff\x00", "got a file that is neither (", NEITHER),
        ("arm.sdf", BARE.encode(), "got a file that is neither (", NEITHER),
        ("words.yaml", b"words", "got 'words', expected a mapping", ""),
        ("slip", json.dumps({**SHORT, "nam": "x"}).encode(), "1: nam: got an unknown key", ""),
    ],
)
def test_what_is_neither_is_said_to_be_neither_and_a_slip_is_named(
    tmp_path: Path, name: str, content: bytes, words: str, end: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    line = refusal("check", path)
    assert line.startswith(f"error: {path}:")
    assert line.removeprefix(f"error: {path}:").lstrip().startswith(words)
    assert line.endswith(end)


def test_shipped_scenes_are_listed_with_what_they_are_about() -> None:
    lines = output("scenes").splitlines()
    assert [line.split()[0] for line in lines[:-1]] == list(shipped_scenes())
    assert all(len(line.split(maxsplit=1)[1]) > 20 for line in lines)
    assert all(line.endswith(".") for line in lines)
    assert lines[-1].startswith("cmbot plan NAME, cmbot tour two_brackets --on top_rail; ")
    assert str(scene_folder()) not in "".join(lines)
    data = json.loads(output("scenes", "--json"))
    assert data["scenes"]["triangle"].startswith("The paper's first experiment")


def test_shipped_scenes_are_shown_on_a_page(tmp_path: Path) -> None:
    page = tmp_path / "scenes.html"
    assert output("scenes", "--html", page) == f"Written to {page}.\n"
    text = page.read_text(encoding="utf-8")
    for name in shipped_scenes():
        assert f"<h2>{name}</h2><img " in text
        command = "cmbot tour two_brackets --on top_rail" if name == "two_brackets" else f"cmbot plan {name}"
        assert f"{command}</code>" in text
    assert "already there" in refusal("scenes", "--html", page)


def test_the_schema_is_printed_as_it_is_shipped() -> None:
    assert output("schema") == (scene_folder() / "scene.schema.json").read_text(encoding="utf-8")
    summary = json.loads(output("schema", "--summary"))
    SUMMARIES.check_schema(summary)
    assert set(summary["$defs"]) == set(COMMANDS) - {"schema"} == set(summary["properties"]["verb"]["enum"])


def test_a_shell_completes_scenes_verbs_and_options(tmp_path: Path) -> None:
    (tmp_path / "tower.yaml").touch()

    def completed(*words: str) -> list[str]:
        given = {"COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
        done = subprocess.run(
            [sys.executable, "-c", ENTRY],
            env=environment(_CMBOT_COMPLETE="complete_bash", **given),
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stdout.split()

    assert completed("cmbot", "plan", "t") == ["tower.yaml", "triangle", "two_brackets"]
    assert completed("cmbot", "sc") == ["scenes", "schema"]
    assert completed("cmbot", "plan", "triangle", "--f") == ["--force", "--figures"]
    assert completed("cmbot", "doctor", "t") == completed("cmbot", "nosuch", "t") == []


@pytest.mark.parametrize(("shell", "start"), [("bash", ".bashrc"), ("zsh", ".zshrc"), ("fish", "")])
def test_completion_is_installed_once(
    shell: str, start: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SHELL", f"/bin/{shell}")
    if start:
        (tmp_path / start).write_text("mine\n", encoding="utf-8")
    for _ in range(2):
        assert f"Completion of {shell} is in {tmp_path}" in output("--install-completion")
    (script,) = (path for path in tmp_path.rglob("*cmbot*") if path.is_file())
    assert script.read_text(encoding="utf-8") == output("--show-completion")
    if start:
        before, line = (tmp_path / start).read_text(encoding="utf-8").split("\n\n")
        assert (before, line.count("\n")) == ("mine", 1)
    if shell == "bash":
        ask = f". {script}; COMP_WORDS=(cmbot sc); COMP_CWORD=1; _cmbot cmbot; echo ${{COMPREPLY[@]}}"
        begin = f"cmbot() {{ {sys.executable} -m cmbot; }}; {ask}"
        done = subprocess.run(["bash", "-c", begin], env=environment(), capture_output=True, text=True)
        assert done.stdout == "scenes schema\n"
    monkeypatch.setenv("SHELL", "/bin/ksh")
    assert "the shell ($SHELL) is ksh" in refusal("--install-completion")


def test_a_urdf_is_loaded_as_planning_does(tmp_path: Path) -> None:
    """Masses that are missing or absurd are warned of; what stops the loading is an error."""
    given = (
        '<robot name="two"><link name="base"/>'
        '<link name="l1"><inertial><mass value="{mass}"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><geometry>{shape}</geometry></collision></link><link name="l2"/><link name="l3"/>'
        "{joints}</robot>"
    )
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/>'
        f'<origin xyz="{0.5 * (k > 1)} 0 0"/><axis xyz="0 1 0"/>'
        '<limit lower="-3" upper="3" velocity="1" effort="50"/></joint>'
        for k, parent in enumerate(("base", "l1", "l2"), start=1)
    )
    box, path = '<box size="0.1 0.1 0.4"/>', tmp_path / "two.urdf"

    def checked(mass: float, shape: str) -> list[dict[str, str]]:
        path.write_text(given.format(mass=mass, shape=shape, joints=joints))
        answer = json.loads(run("check", path, "--json").out)
        assert answer["usable"] == all(each["severity"] == "warning" for each in answer["findings"])
        return answer["findings"]

    keys = ["link[l2].inertial.mass", "link[l3].inertial.mass"]
    assert [each["key"] for each in checked(999, box)] == keys
    heavy = checked(3000, box)
    assert [each["key"] for each in heavy] == [*keys, "link.inertial.mass"]
    assert heavy[-1]["got"] == "3000 kg that move, with a reach of 1.000 m"
    assert "1000 kg" in heavy[-1]["expected"]
    (light,) = checked(0, box)
    assert (light["severity"], light["expected"]) == (
        "error",
        "the mass of all of the robot, which is spread over its shapes; or masses of its links",
    )
    for name, sought in (
        ("m/arm.stl", f"({tmp_path / 'm/arm.stl'})"),
        ("package://m/arm.stl", "package_dirs)"),
    ):
        (missing,) = checked(2, f'<mesh filename="{name}"/>')
        assert (missing["severity"], missing["key"]) == ("error", "link[l1].mesh.filename")
        assert name in missing["got"] and missing["got"].endswith(sought)
    assert run("check", path).status == 2


def test_the_rows_of_a_raster_out_of_reach_are_one_warning(tmp_path: Path) -> None:
    raster = {
        "origin": [1.0, 3.0, -3.5],
        "u": [0.6, 0, 0],
        "v": [0, 0.3, 0],
        "spacing_m": 0.1,
        "stand_off_m": 0.1,
    }
    scene = {**SHORT, "tool_path": {"raster": raster, "speed_m_s": 0.1}}
    out = run("check", write_scene(tmp_path / "far.yaml", scene)).out
    assert out.count("tool_path.raster: got an end at (") == 1
    assert out.splitlines()[-1].startswith("No plan is possible: 1 error, ")


def test_a_robots_name_that_is_nearly_right_is_suggested() -> None:
    assert "; did you mean ur5? (one of: " in refusal("check", "ur5e")


def test_a_scene_with_other_values_is_checked(tmp_path: Path) -> None:
    """As `cmbot plan` takes them: an option of the planner, and a key of the file."""
    path = write_scene(tmp_path / "short.yaml", SHORT)
    assert json.loads(output("check", path, "--json"))["findings"] == []
    changes = ("--set", "safety_margin_m=0.5", "--set", "tool_path.legs[0].seconds=0.002")
    told = json.loads(run("check", path, *changes, "--json").out)
    keys = [finding["key"] for finding in told["findings"]]
    assert "start.posture_deg" in keys and any(key.startswith("tool_path") for key in keys)
    assert "--set: got a URDF to check" in refusal("check", "cmbot", "--set", "start=pinned")
    assert "--set: nonsense" in refusal("check", path, "--set", "nonsense=1")
