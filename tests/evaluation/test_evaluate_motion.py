"""Motions planned elsewhere: judged as plans are, where they follow the scene and where they do not."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from command_line import output, refusal
from small_scenes import short_scene

from cmbot.archive import export_ros, save
from cmbot.common.errors import InputError
from cmbot.evaluation import JointMotion, evaluate, evaluation_json, read_motion
from cmbot.planning import MotionMetrics, Plan, plan
from cmbot.robot import Kinematics, Robot
from cmbot.scene import load_scene
from cmbot.simulation import Tracking
from cmbot.toolpath import SpeedProfile

TOPPRA = Path(__file__).with_name("line_toppra.csv")


def _require_same(figures: MotionMetrics, expected: MotionMetrics, to: float = 1e-6) -> None:
    for field in fields(MotionMetrics):
        got, wanted = getattr(figures, field.name), getattr(expected, field.name)
        if isinstance(wanted, float):
            assert got == pytest.approx(wanted, rel=to, abs=1e-12), field.name
    for field in fields(expected.limit_use):
        wanted = getattr(expected.limit_use, field.name)
        assert getattr(figures.limit_use, field.name) == pytest.approx(wanted, rel=to), field.name


@pytest.fixture
def compensated_plan(compensated_short: tuple[Plan, Tracking]) -> Plan:
    return compensated_short[0]


@pytest.mark.parametrize("name", ["strokes_plan", "returning_plan", "rail_plan", "compensated_plan"])
def test_a_plans_own_message_has_its_figures(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    planned: Plan = request.getfixturevalue(name)
    export_ros(planned, tmp_path / "job.json")
    found = evaluate(
        planned.scene, read_motion(tmp_path / "job.json", planned.robot), options=planned.options
    )
    assert [segment.name for segment in found.job.segments] == [each.name for each in planned.job.segments]
    assert not found.untimed and not found.missing and not found.broken
    _require_same(found.job.figures, planned.job.figures)
    _require_same(found.job.stroke_figures, planned.job.stroke_figures)
    bounds, expected = found.job.certificate, planned.job.certificate
    assert bounds.clearance_bound == pytest.approx(expected.clearance_bound, abs=1e-6)
    assert bounds.guardrail_torque_bound == pytest.approx(expected.guardrail_torque_bound, rel=1e-6)


def test_a_stroke_begins_where_its_arm_moves_off(short_plan: Plan) -> None:
    """A tool that is 5 mm beside its path all along, as where sag is compensated, is not late."""
    waiting = short_plan.trajectory.standing(-1.0, short_plan.trajectory.t[-1])
    t = np.linspace(-1.0, waiting.t[-1], round(waiting.duration / 2e-3) + 1)
    point = Kinematics(short_plan.robot).tool_pose(waiting.q[0]).translation + np.array([0.0, 5e-3, 0.0])
    scene = short_scene(tool_path={"from": {"xyz": point.tolist()}})
    (stroke,) = evaluate(scene, t, *(waiting.evaluate(t, order) for order in range(3))).job.strokes
    assert stroke.begin == pytest.approx(1.0, abs=1e-9)


def test_a_plan_directory_and_its_table_have_the_same_motion(short_plan: Plan, saved_short: Path) -> None:
    knots, table = (read_motion(each, short_plan.robot) for each in (saved_short, saved_short / "job.csv"))
    np.testing.assert_array_equal(knots.q, short_plan.job.trajectory.q)
    t = table.t[::7]
    np.testing.assert_allclose(table.trajectory.evaluate(t), knots.trajectory.evaluate(t), atol=1e-8)
    _require_same(evaluate(short_plan.scene, knots).job.figures, short_plan.job.figures)


def test_a_plan_directory_has_the_time_laws_that_were_chosen(tmp_path: Path) -> None:
    """The scene leaves them to planning; with other strokes, or by its table alone, the motion has none."""
    scene = short_scene(tool_path={"speed_profile": {"kind": "quiet", "ramp": 0.3}})
    made = plan(scene)
    assert made.scene.strokes[0].time_laws and not scene.strokes[0].time_laws
    save(made, tmp_path / "made")
    own, table = (
        evaluate(scene, read_motion(each, made.robot))
        for each in (tmp_path / "made", tmp_path / "made" / "job.csv")
    )
    assert not own.broken and not own.untimed
    assert own.job.stroke_figures.max_tool_lag == pytest.approx(made.figures.max_tool_lag, abs=1e-9)
    assert table.job.stroke_figures.max_tool_lag > 10 * made.figures.max_tool_lag
    longer = short_scene(
        tool_path={
            "speed_profile": {"kind": "quiet", "ramp": 0.3},
            "legs": [{"by": [0, -0.3, 0], "seconds": 8}],
        }
    )
    assert evaluate(longer, read_motion(tmp_path / "made", made.robot)).untimed == ("work",)


def test_a_motion_of_toppra_in_another_timing() -> None:
    """It takes the rigid arm's path in other times: rests as deep, other accelerations, no timed pose."""
    # Law and options are those of the plan that toppra was given.
    scene = load_scene("line").with_path(speed_profile=SpeedProfile())
    given = replace(scene.planner, compensate=False, max_tool_deviation_m=1e-3, smoothing_weight=0.1)
    rigid_plan = plan(scene, options=given)
    motion = read_motion(TOPPRA, rigid_plan.robot)
    found = evaluate(scene, motion)
    assert found.untimed == ("work",) and not found.missing
    assert "another timing" in " ".join(found.remarks())
    figures, planned = found.job.figures, rigid_plan.figures
    static = planned.peak_static_guardrail_torque
    assert figures.peak_static_guardrail_torque == pytest.approx(static, rel=1e-3)
    # Toppra was given the path of a plan that kept this.
    assert 0 < figures.max_tool_deviation <= given.max_tool_deviation_m
    assert figures.max_tool_lag == 0
    # What toppra was given: half of the velocities.
    assert figures.limit_use.velocity == pytest.approx(0.5, rel=1e-2)
    samples, _ = found.samples
    torque = np.linalg.norm(samples.guardrail_torque, axis=1)
    assert torque.max() <= found.job.certificate.guardrail_torque_bound
    assert samples.clearance.min() >= found.job.certificate.clearance_bound


def test_what_a_motion_breaks_is_told(short_plan: Plan) -> None:
    """Three times as fast it breaks bounds of joints; elsewhere it follows nothing."""
    motion = short_plan.job.trajectory
    fast = evaluate(short_plan.scene, motion.t / 3, motion.q)
    assert {check.joint for _, check in fast.broken} <= {*short_plan.robot.joints, ""}
    told = list(fast.remarks())
    assert sum(text.startswith("Broken in") for text in told) == len(fast.broken) > 0
    still = np.repeat(motion.q[:1], 3, axis=0)
    held = evaluate(short_plan.scene, [0.0, 1.0, 2.0], still)
    assert held.missing == tuple(stroke.name for stroke in short_plan.strokes)
    assert [segment.kind for segment in held.job.segments] == ["free"]
    torque = np.linalg.norm(short_plan.job_samples[0].guardrail_torque[0])
    assert held.job.figures.peak_guardrail_torque == pytest.approx(torque, rel=1e-6)


def test_the_curve_is_the_spline_or_the_quintics(rng: np.random.Generator) -> None:
    t = np.sort(rng.uniform(0, 5, 9))
    q, v, a = (rng.normal(size=(9, 3)) for _ in range(3))
    spline, quintic = JointMotion(t=t, q=q), JointMotion(t=t, q=q, v=v, a=a)
    assert not spline.is_quintic and spline.spread == 0
    curve = spline.trajectory
    for order in (0, 1, 2):
        assert np.abs(curve.jumps(order)).max() < 1e-9
    assert np.abs(curve.extrema(4).value).max() < 1e-7
    assert np.abs(curve.evaluate(curve.t[[0, -1]], 1)).max() < 1e-12
    np.testing.assert_array_equal(quintic.trajectory.v, v)
    every = np.linspace(0, t[-1] - t[0], 4001)
    same_ends = JointMotion(t=t, q=q, v=v)
    away = np.abs(quintic.trajectory.evaluate(every) - same_ends.spline.evaluate(every)).max()
    assert quintic.spread == pytest.approx(away, rel=2e-2)


_MESSAGE = {
    "joint_names": [f"joint_{k}" for k in range(7, 0, -1)],
    "points": [
        {"positions": [float(k)] * 7, "time_from_start": {"sec": k, "nanosec": 500_000_000}} for k in range(3)
    ],
}


@pytest.mark.parametrize(
    "message",
    [
        _MESSAGE,
        {"trajectory": _MESSAGE, "goal_tolerance": []},
        {"trajectory": [{"joint_trajectory": _MESSAGE}], "model_id": "arm"},
        {"goal": {"trajectory": _MESSAGE}},
    ],
)
def test_messages_are_found_in_others(message: object, cmbot_robot: Robot, tmp_path: Path) -> None:
    text = json.dumps(message)
    for k, joint in enumerate(cmbot_robot.joints, start=1):
        text = text.replace(f'"joint_{k}"', f'"{joint}"')
    for suffix in (".json", ".yaml"):
        file = tmp_path / f"motion{suffix}"
        file.write_text(text, encoding="utf-8")
        motion = read_motion(file, cmbot_robot)
        np.testing.assert_allclose(motion.t, [0.5, 1.5, 2.5])
        np.testing.assert_array_equal(motion.q[:, 0], [0, 1, 2])
        assert motion.v is None and motion.a is None


def test_tables_by_the_names_of_joints(cmbot_robot: Robot, tmp_path: Path) -> None:
    names = list(cmbot_robot.joints)
    file = tmp_path / "motion.csv"
    heading = ";".join(["Time (s)", "current", *reversed([f"{name}_deg" for name in names])])
    rows = [";".join(map(str, [k, 0.1, *reversed(range(7))])).replace(".", ",") for k in range(3)]
    file.write_text("\n".join([heading, *rows]), encoding="utf-8")
    motion = read_motion(file, cmbot_robot)
    np.testing.assert_allclose(motion.q, np.radians([range(7)] * 3))
    assert motion.unknown == ("current",)


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("m.csv", "t,q1\n0,1\n1,2\n", "no column of joint"),
        ("m.csv", "a,q1\n0,1\n1,2\n", "expected a column t"),
        ("m.csv", "t,q1,q2,q3,q4,q5,q6,q7\n0,1,1,1,1,1,1,x\n1,1,1,1,1,1,1,1\n", "line 2, q7: got 'x'"),
        ("m.csv", "t,q1,q2,q3,q4,q5,q6,q7\n1,1,1,1,1,1,1,1\n1,1,1,1,1,1,1,1\n", "times increasing"),
        ("m.csv", "t (min),q1,q2,q3,q4,q5,q6,q7\n0,1,1,1,1,1,1,1\n1,1,1,1,1,1,1,1\n", "the unit min"),
        ("m.mcap", "", "got a bag of ROS messages, expected a table with t and the joints, .* cmbot verify"),
        ("m.json", "{", "no JSON"),
        (
            "m.json",
            '{"goal": [{"points": [{"t": 1, "t": 2}, {}]}], "x": 0}',
            "m.json: t: got a key that is there twice, expected each key once",
        ),
        ("m.json", '{"goal": {"a": 1, "a": 1}, "goal": {}}', "m.json: a: got a key that is there twice"),
        ("m.json", "[]", r"got \[\]"),
        ("m.json", '{"a": 1}', "joint_names and points"),
        ("m.json", '{"joint_names": ["a"], "points": [{}]}', "all joints of the arm"),
    ],
)
def test_files_that_are_no_motion(
    name: str, content: str, told: str, cmbot_robot: Robot, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=told) as caught:
        read_motion(tmp_path / name, cmbot_robot)
    assert name in str(caught.value) and len(str(caught.value)) <= 400


@pytest.mark.parametrize(
    ("t", "q", "told"),
    [
        ([0, 1], None, "cmbot.evaluate: q"),
        ([0, 1], [[0.0] * 6] * 2, "q: got 6 columns"),
        ([0, 1], [[0.0] * 7] * 3, "q: got shape"),
        ([1, 1], [[0.0] * 7] * 2, "t: got"),
        ([0, 1], [[np.nan] * 7] * 2, "q: got a number that is too large or none"),
        (["a", "b"], [[0.0] * 7] * 2, "arrays of numbers"),
    ],
)
def test_arguments_that_are_no_motion(t: object, q: object, told: str) -> None:
    with pytest.raises(InputError, match=told):
        evaluate(load_scene("triangle"), t, q)  # type: ignore[arg-type]


def test_the_command_tells_motion_and_plan(tmp_path: Path) -> None:
    told = output("evaluate", "line", "--motion", TOPPRA, "-o", tmp_path / "out")
    assert "peak torque on the guardrail, whole job, Nm" in told and "Certified: 8 checks hold" in told
    record = json.loads((tmp_path / "out" / "evaluation.json").read_text(encoding="utf-8"))
    assert record["format"] == "cmbot-evaluation/1" and record["untimed"] == ["work"]
    assert (
        record["planned"]["job"]["peak_guardrail_torque"] > record["motion"]["job"]["peak_guardrail_torque"]
    )
    table = (tmp_path / "out" / "motion.csv").read_text(encoding="utf-8").splitlines()
    assert table[0].startswith("t,q1,") and table[-1].endswith(",work")
    assert "these files" in refusal("evaluate", "line", "--motion", TOPPRA, "-o", tmp_path / "out")
    alone = json.loads(output("evaluate", "line", "--motion", TOPPRA, "--alone", "--json"))
    assert alone["planned"] is None and alone["motion"].keys() == record["motion"].keys()
    # Rounded differently: the matrices lie elsewhere in memory.
    job = {name: value for name, value in record["motion"]["job"].items() if isinstance(value, float)}
    assert {name: alone["motion"]["job"][name] for name in job} == pytest.approx(job, rel=1e-9)


def test_json_of_an_evaluation_has_no_number_that_is_not_finite(short_plan: Plan) -> None:
    motion = short_plan.job.trajectory
    data = evaluation_json(evaluate(short_plan.scene, motion.t, motion.q, motion.v, motion.a))
    assert json.loads(json.dumps(data, allow_nan=False)) == data
