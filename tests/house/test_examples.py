"""The examples run as a reader runs them, and print what they say."""

import math
import re
import runpy
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from shared_plans import planned

import cmbot

EXAMPLES = Path(__file__).resolve().parent.parent.parent / "examples"


def run(name: str, folder: Path) -> str:
    """Standard output of an example, run in an empty folder; warnings are errors here."""
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(folder)
        patch.setattr(sys, "argv", [str(EXAMPLES / name)])
        patch.setattr(cmbot, "plan", planned)
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert err.getvalue() == ""
    assert list(folder.iterdir()) == [], "an example left something behind"
    return out.getvalue()


def run_apart(name: str, folder: Path) -> str:
    """The same in a process of its own, which has to import what it needs."""
    command = [sys.executable, "-W", "error", str(EXAMPLES / name)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert list(folder.iterdir()) == [], "an example left something behind"
    return done.stdout


def number(pattern: str, text: str) -> float:
    return numbers(pattern, text)[0]


def numbers(pattern: str, text: str) -> list[float]:
    """The numbers of the first group."""
    found = re.search(pattern, text, flags=re.MULTILINE)
    assert found is not None, f"{pattern!r} is not in:\n{text}"
    return [float(word) for word in found[1].split()]


def test_every_example_is_tested() -> None:
    tested = set(re.findall(r'= run\w*\("(\w+\.py)"', Path(__file__).read_text(encoding="utf-8")))
    assert {path.name for path in EXAMPLES.glob("*.py")} == tested
    # In reading order, without a gap.
    assert sorted(name[:3] for name in tested) == [f"{n:02}_" for n in range(1, len(tested) + 1)]


def test_load_robot(tmp_path: Path) -> None:
    text = run_apart("01_load_robot.py", tmp_path)
    assert "cmbot: 7 joints, 68.00 kg, 37.62 kg of it moving" in text
    # The weight of the 37.62 kg of Table 2, and the torque of the paper's initial posture.
    assert number(r"force on guardrail.*?(-\d+\.\d+)\]", text) == pytest.approx(-37.62 * 9.81, abs=0.005)
    assert number(r"its norm: +(\S+) Nm", text) == pytest.approx(486.41, abs=0.005)
    assert len(re.findall(r"^  joint_\d:", text, flags=re.MULTILINE)) == 7


def test_plan_a_scene(tmp_path: Path) -> None:
    text = run("02_plan_a_scene.py", tmp_path)
    checks = text.split("check by check:\n")[1].split("\n\n")[0].splitlines()
    assert len(checks) == 15
    # What it is there to show: knot derivatives cannot undercut gravity at the via-points, slides can.
    baseline = number(r"baseline, from the scene's posture: +(\S+)", text)
    at_via_points = number(r"fixed knots, at the via-points: +(\S+)", text)
    fixed = number(r"fixed knots, all along: +(\S+)", text)
    sliding = number(r"as the scene has it, all along: +(\S+)", text)
    floor = number(r"lower bound, at one of these: +(\S+)", text)
    assert baseline == at_via_points == pytest.approx(486.41, abs=0.005)
    assert fixed >= at_via_points - 0.005
    assert floor - 0.05 <= sliding < 1.02 * floor < fixed


def test_your_own_arm(tmp_path: Path) -> None:
    text = run("03_your_own_arm.py", tmp_path)
    assert "sander: 7 joints, 21.3 kg moving" in text
    assert "Lower bound: no plan within the limits has a static peak below " in text, "the knots slide"
    deviation = number(r"^largest tool deviation, mm +(\S+)", text)
    assert 0 < deviation <= 1.0
    assert number(r"^smallest clearance, whole job, mm +(\S+)", text) >= 20
    assert re.search(r"^Certified: \d+ checks hold", text, flags=re.MULTILINE)
    assert "A slip is told like this: tool_frame: got 'dsic', expected a link of the URDF" in text


def test_simulate_and_compensate(tmp_path: Path) -> None:
    text = run("04_simulate_and_compensate.py", tmp_path)
    assert number(r"shifted by up to (\S+) mm", text) > 5
    parts = ("bent from expected tool", "  of that at rest", "  of that vibration", "bent tool off its path")
    rms = {part: numbers(rf"^{part} +(.+)$", text) for part in parts}
    total, sag, vibration, path = rms.values()
    # Sag that was predicted counts no more; vibration stays.
    assert sag[2] < 0.01 * sag[1]
    assert total == pytest.approx(list(map(math.hypot, sag, vibration)), rel=0.05)
    baseline, planned, compensated = path
    assert compensated < 0.1 * planned < 0.1 * baseline
    for name, value in (("planned", planned), ("compensated", compensated)):
        reduction = number(rf"^{name}: off its path (\S+) % less", text)
        assert reduction == pytest.approx(100 * (1 - value / baseline), abs=0.06)


def test_your_own_objective(tmp_path: Path) -> None:
    text = run("05_your_own_objective.py", tmp_path)
    torque, stress = (
        [number(rf"minimised: {name} +{figure} +(\S+)", text) for figure in ("stress", r"stress.*torque")]
        for name in ("torque", "stress")
    )
    # Each is the better one at what it makes small, and at that only.
    assert stress[0] < torque[0]
    assert torque[1] < stress[1]
    assert stress[0] == pytest.approx(number(r"static stress below (\S+) MPa", text), rel=0.01)


def test_report(tmp_path: Path) -> None:
    text = run("06_report.py", tmp_path)
    written = set(re.findall(r"^ *\d+ kB  (\S+)$", text, flags=re.MULTILINE))
    assert written >= {"plan.json", "job.csv", "tracking.csv", "replay.html", "report.html"}
    assert written >= {"guardrail_torque.pdf", "joints.pdf", "tracking_error.pdf"}
    assert "peak torque on the guardrail" in text
    assert text.endswith("tracking errors, too: True\n")


def test_send_to_a_robot(tmp_path: Path) -> None:
    text = run("07_send_to_a_robot.py", tmp_path)
    assert numbers(r"^starts in: (.+) rad m$", text.replace(",", ""))[:2] == pytest.approx(
        [math.radians(-10), math.radians(-90)], abs=1e-4
    )
    # The knots of the plan: as many as via-points, after those of the approach to where the bent arm begins.
    points, seconds = (number(pattern, text) for pattern in (r"^(\d+) points", r"points in (\S+) s$"))
    assert points > 8 and seconds > 4
    assert text.endswith("nothing is sent\n")


@pytest.mark.parametrize(
    ("accepted", "code", "said"),
    [
        (False, 0, "/arm did not accept the goal: its log says why"),
        (True, -4, "the arm did not finish: error -4, Aborted due to path tolerance violation"),
        (True, 0, None),
    ],
)
def test_what_a_controller_answers_is_looked_at(
    accepted: bool, code: int, said: str | None, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """With stand-ins for ROS 2: a goal that was refused or not finished is no success."""
    result = SimpleNamespace(error_code=code, error_string="Aborted due to path tolerance violation")
    handle = SimpleNamespace(accepted=accepted)
    if accepted:
        handle.get_result_async = lambda: future(SimpleNamespace(result=result))
    client = SimpleNamespace(wait_for_server=lambda: True, send_goal_async=lambda _: future(handle))
    action = SimpleNamespace(Goal=SimpleNamespace, Result=SimpleNamespace(SUCCESSFUL=0))
    ros = SimpleNamespace(
        init=lambda: None,
        shutdown=lambda: None,
        create_node=lambda _: None,
        spin_until_future_complete=lambda *_: None,
    )
    for name, module in {
        "rclpy": ros,
        "rclpy.action": SimpleNamespace(ActionClient=lambda *_: client),
        "control_msgs": SimpleNamespace(),
        "control_msgs.action": SimpleNamespace(FollowJointTrajectory=action),
        "rosidl_runtime_py": SimpleNamespace(set_message_fields=lambda *_: None),
    }.items():
        monkeypatch.setitem(sys.modules, name, module)
    send = runpy.run_path(str(EXAMPLES / "07_send_to_a_robot.py"))["send"]
    if said is None:
        send({}, "/arm")
        assert capsys.readouterr().out == "done\n"
        return
    with pytest.raises(SystemExit, match=re.escape(said)):
        send({}, "/arm")
    assert "done" not in capsys.readouterr().out


def test_without_ros_nothing_is_sent(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    runpy.run_path(str(EXAMPLES / "07_send_to_a_robot.py"))["send"]({}, "/arm")
    assert capsys.readouterr().out == "ROS 2 is not installed here: nothing is sent\n"


def future(value: Any) -> Any:
    """Something of rclpy that has ended."""
    return SimpleNamespace(result=lambda: value)
