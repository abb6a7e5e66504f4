"""Robot descriptions as publishers write them get to a certified plan without an editor: a sample.

`benchmarks/robots.py` has the others, and those of published packages.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import robots
from command_line import output, refusal, run

import cmbot
from cmbot.archive import load_plan
from cmbot.common.errors import SceneError
from cmbot.planning import robot_of

SAMPLE = [
    "no_masses/acme_support/urdf/acme.urdf",
    robots.ACME,
    "moveit/urdf/acme.urdf",
    "flange/arm.urdf",
]
CASES = [next(case for case in robots.WRITTEN if case.file == file) for file in SAMPLE]


def new(case: robots.Case, scene: Path) -> str:
    at = tuple(map(str, case.at))
    words = ("new", "--from", robots.FOREIGN / case.file, "--tool-at", *at, *case.options, "-o", scene)
    return output(*words)


@pytest.mark.parametrize("case", CASES, ids=SAMPLE)
def test_a_sample_is_planned(case: robots.Case, tmp_path: Path) -> None:
    new(case, tmp_path / "scene.yaml")
    told = output("plan", tmp_path / "scene.yaml", "-o", tmp_path / "plan", "--verbose")
    assert "Certified" in told
    plan = load_plan(tmp_path / "plan")
    # What was estimated is said again.
    assert ("masses of 7 links are estimated" in told) == (case.file == SAMPLE[0])
    np.testing.assert_allclose(plan.trajectory.evaluate([0.0])[0], plan.scene.posture, atol=1e-12)


@pytest.mark.parametrize(("case", "said"), robots.WRONG.items(), ids=[case.file for case in robots.WRONG])
def test_what_is_wrong_is_refused_with_what_to_do(case: robots.Case, said: str, tmp_path: Path) -> None:
    at = tuple(map(str, case.at))
    words = ("new", "--from", robots.FOREIGN / case.file, "--tool-at", *at, *case.options)
    assert said in refusal(*words, "-o", tmp_path / "scene.yaml")
    assert list(tmp_path.iterdir()) == []


def test_the_benchmark_lists_thirty_descriptions() -> None:
    planned = [*robots.PUBLISHED, *robots.WRITTEN]
    assert len({(case.file, case.options) for case in planned}) == len(planned) >= 30
    assert len(robots.PUBLISHED) >= 10
    assert all((robots.FOREIGN / case.file).is_file() for case in (*robots.WRITTEN, *robots.WRONG))


SCENE = """format: cmbot-scene/2
name: s
robot: {{model: {model}}}
start: {{state: {state}}}
return: {{state: folded}}
tool_path: {{legs: [{{by: [0, 0.05, 0], seconds: 3}}], via_points: 8}}
guardrail: {{bays: 0}}
"""


def written(folder: Path, state: str = "home") -> Path:
    file = folder / "scene.yaml"
    file.write_text(
        SCENE.format(model=robots.FOREIGN / "moveit/urdf/acme.urdf", state=state), encoding="utf-8"
    )
    return file


def test_a_job_starts_and_ends_in_named_states(tmp_path: Path) -> None:
    scene = cmbot.load_scene(written(tmp_path))
    np.testing.assert_array_equal(scene.posture, [0, -0.3, 0.2, 0, 0.3, 0])
    assert scene.posture_key == "start.state"
    plan = cmbot.plan(scene)
    np.testing.assert_allclose(
        plan.job.trajectory.evaluate([plan.job.duration])[0], [0, -0.6, 0.3, 0, 0.6, 0], atol=1e-9
    )
    assert any("the arm goes to its state folded." in remark for remark in cmbot.planning.remarks(plan))
    assert cmbot.load_scene(scene.as_data()) == scene
    with pytest.raises(
        SceneError, match=r"start.state: got the arm acme, whose SRDF has no group state hom "
    ):
        cmbot.load_scene(written(tmp_path, "hom"))
    data = scene.as_data() | {"return": {"state": "fold"}}
    with pytest.raises(SceneError, match=r"return.state: got 'fold', expected a group state .*home, folded"):
        cmbot.plan(cmbot.load_scene(data))


def test_a_scene_keeps_what_new_was_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(robots.FOREIGN / "flange")
    options = ("--tool", "{xyz: [0.2, 0, 0], rpy_deg: [0, 90, 0], mass_kg: 1.2, mesh: torch.obj}")
    output(
        *("new", "--from", "arm.urdf", "--tool-at", "0.5", "0", "0.6", *options), "-o", tmp_path / "t.yaml"
    )
    scene = cmbot.load_scene(tmp_path / "t.yaml")
    assert scene.robot.tool is not None
    assert scene.robot.tool.mesh == str(robots.FOREIGN / "flange" / "torch.obj")
    robot = robot_of(scene)
    assert robot.mass == pytest.approx(61.9 + 1.2)
    assert (robot.tool_frame, scene.robot.tool_frame) == ("flange_tool_point", "flange")
    # Its mesh is part of what the scene says.
    other = scene.robot.tool.changed(mesh=None)
    assert scene.changed(robot=scene.robot.changed(tool=other)).content_hash != scene.content_hash
    assert hash(scene) == hash(cmbot.load_scene(tmp_path / "t.yaml"))
    both = scene.as_data()
    both["robot"] |= {"tool_length_m": 0.2}
    with pytest.raises(SceneError, match=r"robot.tool_length_m: got both, expected tool or tool_length_m"):
        cmbot.load_scene(both)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--flange", "tool0"), "--flange: got 'tool0', expected a tool on it"),
        (("--tool", "{xyz: [0, 0]}"), "--tool: xyz: got [0, 0], expected a list of 3 items"),
        (("--tool", "{xyz: [0, 0, 0.1], mesh: none.stl}"), "--tool: mesh: got 'none.stl', expected a file"),
        (("--total-mass", "0"), "--total-mass: got 0"),
        (("--xacro", "name"), "--xacro: got 'name', expected NAME=VALUE, such as name=ur5e"),
        (("--xacro", "name=x"), "--xacro name=VALUE: got a file without xacro"),
    ],
)
def test_options_that_mean_nothing(options: tuple[str, ...], said: str, tmp_path: Path) -> None:
    arm = robots.FOREIGN / "zero_effort" / "arm.urdf"
    words = ("new", "--from", arm, "--tool-at", "0.5", "0", "0.6", *options, "-o", tmp_path / "s.yaml")
    assert said in refusal(*words)


def test_check_takes_arguments_of_xacro_and_counts_what_is_alike(tmp_path: Path) -> None:
    file = robots.FOREIGN / robots.ACME
    assert "OK: no error" in output("check", file, "--xacro", "name=large")
    assert "xacro.name: got nothing" in refusal("check", file)
    stickers = run("check", robots.FOREIGN / "stickers" / "arm.urdf").out.splitlines()
    named = [line for line in stickers if "material: got no name" in line]
    assert len(named) == 1
    assert named[0].endswith("(6 times)")
    assert "robot.xacro" in refusal("check", written(tmp_path), "--xacro", "name=large")


def test_new_writes_the_limits_that_it_assumes(tmp_path: Path) -> None:
    """They are those with which it made the scene, and the plan says whose they are."""
    new(robots.Case(file="no_limits/arm.urdf"), tmp_path / "s.yaml")
    text = (tmp_path / "s.limits.yaml").read_text(encoding="utf-8")
    assert "velocity_deg: 57.2958" in text
    assert "effort: " in text
    assumed = cmbot.load_robot(robots.FOREIGN / "no_limits" / "arm.urdf").limits
    limits = robot_of(cmbot.load_scene(tmp_path / "s.yaml")).limits
    for name in ("velocity", "acceleration", "jerk", "torque"):
        np.testing.assert_allclose(getattr(limits, name), getattr(assumed, name), rtol=1e-5)
        assert getattr(limits, f"assumed_{name}").all()
