"""A plan as an MCAP file, read back by other code: what is in it is the planned job."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import output, refusal, run
from obstacle_entries import with_obstacles
from oracles.joint_trajectory_controller import refusals
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from cmbot.archive import export_mcap, export_ros, load_plan, save
from cmbot.collision import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere
from cmbot.common.errors import ArchiveError, InputError, MissingExtra
from cmbot.planning import Plan, QuinticTrajectory
from cmbot.robot import Dynamics, Kinematics

pytestmark = pytest.mark.usefixtures("judged_once")

Messages = dict[str, list[tuple[float, Any]]]


@pytest.fixture(scope="module")
def messages(strokes_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Messages:
    path = tmp_path_factory.mktemp("bag") / "strokes.mcap"
    export_mcap(strokes_plan, path)
    found: Messages = {}
    with AnyReader([path]) as reader:
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((1e-9 * time, message))
    return found


def test_the_trajectory_is_the_whole_job(messages: Messages, strokes_plan: Plan) -> None:
    ((time, message),) = messages["/joint_trajectory"]
    job = strokes_plan.job.trajectory
    assert time == 0
    assert tuple(message.joint_names) == strokes_plan.robot.joints
    t = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points])
    q, v, a = (
        np.array([getattr(point, name) for point in message.points])
        for name in ("positions", "velocities", "accelerations")
    )
    # What a controller makes of it.
    driven = QuinticTrajectory(t=t, q=q, v=v, a=a)
    every = np.linspace(0, min(job.duration, t[-1]), 5001)
    np.testing.assert_allclose(driven.evaluate(every), job.evaluate(every), atol=1e-8)
    np.testing.assert_allclose(q[[0, -1]], job.q[[0, -1]], atol=1e-14)
    assert t[-1] == pytest.approx(job.duration, abs=1e-9)
    assert all(len(point.effort) == 0 for point in message.points)


@pytest.mark.parametrize("effort", [False, True])
def test_controllers_accept_what_is_written_without_efforts(
    short_plan: Plan, saved_short: Path, tmp_path: Path, effort: bool
) -> None:
    """Of Humble and of Jazzy; with efforts newer ones alone, where the controller commands an effort."""
    bag, file = tmp_path / "job.mcap", tmp_path / "job.json"
    words = ["--effort"] if effort else []
    told = output("export", saved_short, "--mcap", bag, "--ros", file, *words)
    assert told.startswith(f"Written to {bag}.\nWritten to {file}: ")
    message = json.loads(file.read_text(encoding="utf-8"))
    start = re.search(r"The arm has to be at posture_deg: \[(.*)\] before: the way there is not", told)
    assert start is not None
    there = [float(angle) for angle in start[1].split(", ")]
    np.testing.assert_allclose(there, np.degrees(message["points"][0]["positions"]), atol=1e-4)
    joints = short_plan.robot.joints
    expected = ["effort"] if effort else []
    assert refusals(message, joints, "humble") == refusals(message, joints, "jazzy") == expected
    assert refusals(message, joints, "humble", commands_effort=True) == expected
    assert refusals(message, joints, "jazzy", commands_effort=True) == []
    with AnyReader([bag]) as reader:
        (connection,) = (each for each in reader.connections if each.topic == "/joint_trajectory")
        ((_, _, raw),) = reader.messages([connection])
        recorded = reader.deserialize(raw, connection.msgtype)
    t = [_seconds(point) for point in message["points"]]
    states = short_plan.job.trajectory.states(np.minimum(t, short_plan.job.duration))
    torques = Dynamics(short_plan.robot).efforts(*states).joint_torque
    for point, other, torque in zip(message["points"], recorded.points, torques, strict=True):
        for name in ("positions", "velocities", "accelerations"):
            assert point[name] == getattr(other, name).tolist()
        assert point.get("effort", []) == other.effort.tolist()
        np.testing.assert_allclose(point.get("effort", torque), torque, rtol=1e-9)


def _seconds(point: dict[str, Any]) -> float:
    time = point["time_from_start"]
    return float(time["sec"] + 1e-9 * time["nanosec"])


@pytest.mark.parametrize("words", [["--max-points", "12"], ["--rate", "40"], ["--joints", "{1},{0}"]])
def test_fewer_points_and_joints_stay_within_what_is_stated(
    words: list[str], strokes_plan: Plan, tmp_path: Path
) -> None:
    folder, file = save(strokes_plan, tmp_path / "plan"), tmp_path / "plan" / "job.ros.json"
    joints = strokes_plan.robot.joints
    told = run("export", folder, "--ros", file, *(word.format(*joints) for word in words)).out
    stated = float(told.split("within ")[1].split(" rad")[0])
    message = json.loads(file.read_text(encoding="utf-8"))
    names, points = message["joint_names"], message["points"]
    assert names == (list(joints) if words[0] != "--joints" else [joints[1], joints[0]])
    assert refusals(message, names, "humble") == refusals(message, names, "jazzy") == []
    t = np.array([_seconds(point) for point in points])
    if words[0] == "--max-points":
        assert len(points) == 12
    if words[0] == "--rate":
        np.testing.assert_allclose(np.diff(t)[:-1], 1 / 40, atol=2e-9)
    driven = QuinticTrajectory(
        t=t,
        q=np.array([point["positions"] for point in points]),
        v=np.array([point["velocities"] for point in points]),
        a=np.array([point["accelerations"] for point in points]),
    )
    job = strokes_plan.job.trajectory
    every, columns = np.linspace(0, min(job.duration, t[-1]), 3001), [joints.index(name) for name in names]
    away = np.abs(driven.evaluate(every) - job.evaluate(every)[:, columns]).max()
    assert away <= 1.05 * stated + 1e-9
    np.testing.assert_array_equal(driven.q[0], job.q[0, columns])
    # It is compared with the plan where the plan is verified: a point that was moved is found.
    if stated < 1e-3:
        load_plan(folder, verify=True)
        points[len(points) // 2]["positions"][0] += 1e-4
    file.write_text(json.dumps(message), encoding="utf-8")
    with pytest.raises(ArchiveError, match=r"job\.ros\.json"):
        load_plan(folder, verify=True)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ["--joints", "oint_2"],
            "cmbot export: --joints: got oint_2, expected a joint; did you mean joint_2?",
        ),
        (["--rate", "0"], "rate: got 0"),
        (["--rate", "9", "--max-points", "9"], "got both"),
    ],
)
def test_messages_that_cannot_be_written(
    words: list[str], told: str, saved_short: Path, tmp_path: Path
) -> None:
    assert told in refusal("export", saved_short, "--ros", tmp_path / "job.json", *words)
    assert not (tmp_path / "job.json").exists()
    alone = refusal("export", saved_short, "--csv", tmp_path / "job.csv", *words[:2])
    assert "with --ros" in alone


def test_joints_that_move_outside_a_message_are_named(rail_plan: Plan, tmp_path: Path) -> None:
    """A controller of the arm alone must not get half a motion without a word."""
    folder, joints = save(rail_plan, tmp_path / "plan"), rail_plan.robot.joints
    samples = rail_plan.job.trajectory.evaluate(np.linspace(0, rail_plan.job.duration, 4001))
    moves = dict(zip(joints, np.ptp(samples, axis=0), strict=True))
    some = [name for name in joints if name not in ("rail", "draw")]
    outcome = run("export", folder, "--ros", tmp_path / "arm.json", "--joints", ",".join(some), "--quiet")
    assert (outcome.status, outcome.out) == (0, "")
    for name in ("rail", "draw"):
        assert f"{name}, which moves {moves[name]:.3g} m" in outcome.err
    assert "--joints rail,draw" in outcome.err
    # The advice is what makes the set whole; each file names what the other has.
    words = ["--joints", "rail,draw", "--json"]
    told = json.loads(run("export", folder, "--ros", tmp_path / "rails.json", *words).out)
    assert told["moving_joints_left_out"].keys() == {name for name in some if moves[name] > 1e-6}
    assert told["files"] == [str(tmp_path / "rails.json")]
    message = json.loads((tmp_path / "rails.json").read_text(encoding="utf-8"))
    begins = [told["start"][name] for name in message["joint_names"]]
    assert begins == pytest.approx(message["points"][0]["positions"], abs=1e-12)
    assert told["start"].keys() == set(joints)
    # Nothing is left out of the whole message: no warning.
    output("export", folder, "--ros", tmp_path / "all.json")


def test_the_oracle_refuses_what_controllers_do(short_plan: Plan, saved_short: Path, tmp_path: Path) -> None:
    output("export", saved_short, "--ros", tmp_path / "job.json")
    good = json.loads((tmp_path / "job.json").read_text(encoding="utf-8"))
    *some, last = good["points"]
    joints = short_plan.robot.joints
    bad = [
        good | {"joint_names": [*joints[1:], "other"]},
        good | {"points": []},
        good | {"points": [*some, last | {"velocities": [1e-3] * 7}]},
        good | {"points": [*some, some[-1]]},
        good | {"points": [*some, last | {"positions": []}]},
        good | {"header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": ""}},
    ]
    assert not refusals(good, joints, "humble")
    assert all(refusals(each, joints, "humble") and refusals(each, joints, "jazzy") for each in bad)


def test_links_and_wrench_are_those_of_the_plan(messages: Messages, strokes_plan: Plan) -> None:
    samples, _ = strokes_plan.job_samples
    assert len(messages["/tf"]) == len(messages["/joint_states"]) == len(messages["/base_wrench"])
    assert messages["/tf"][-1][0] == pytest.approx(strokes_plan.job.duration)
    for number in (0, 300, -1):
        time, message = messages["/tf"][number]
        k = int(np.argmin(np.abs(samples.t - time)))
        tool = strokes_plan.robot.tool_frame
        (found,) = (each.transform for each in message.transforms if each.child_frame_id == tool)
        X = Kinematics(strokes_plan.robot).tool_pose(samples.q[k])
        place = [getattr(found.translation, axis) for axis in "xyz"]
        np.testing.assert_allclose(place, X.translation, atol=1e-9)
        turn = Rotation.from_quat([getattr(found.rotation, axis) for axis in "xyzw"])
        np.testing.assert_allclose(turn.as_matrix(), X.rotation, atol=1e-9)
        assert {each.header.frame_id for each in message.transforms} == {"world"}
        assert messages["/base_wrench"][number][1].header.frame_id == "O0"
        torque = messages["/base_wrench"][number][1].wrench.torque
        expected = samples.guardrail_torque[k]
        np.testing.assert_allclose([torque.x, torque.y, torque.z], expected)
        np.testing.assert_array_equal(messages["/joint_states"][number][1].position, samples.q[k])


def test_markers_show_obstacles_and_paths(messages: Messages, strokes_plan: Plan) -> None:
    ((_, message),) = messages["/markers"]
    names = [marker.ns for marker in message.markers]
    expected = [obstacle.name for obstacle in strokes_plan.scene.all_obstacles]
    assert names == [*expected, "path there", "path back"]
    assert len({marker.id for marker in message.markers}) == len(names)
    path = strokes_plan.strokes[0].task.path.outline()
    points = np.array([[point.x, point.y, point.z] for point in message.markers[-2].points])
    np.testing.assert_allclose(points, path)


def test_markers_have_the_sizes_of_the_shapes(short_plan: Plan, tmp_path: Path) -> None:
    """RViz and Foxglove scale a cube, a sphere and a cylinder of size 1 about their centres."""
    (tmp_path / "cone.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_euler("x", 90, degrees=True).as_matrix(), (4.0, 5.0, 6.0)
    shapes = {
        "box": Box(size=(0.1, 0.2, 0.3)),
        "ball": Sphere(radius=0.2),
        "rod": Cylinder(radius=0.1, length=0.7),
        "pill": Capsule(radius=0.1, length=0.6),
        "cone": Mesh(path=tmp_path / "cone.obj"),
    }
    bare = short_plan.scene.changed(guardrail={"bays": 0})
    obstacles = tuple(Obstacle(name=name, shape=shape, X_WO=X) for name, shape in shapes.items())
    export_mcap(replace(short_plan, scene=with_obstacles(bare, *obstacles)), tmp_path / "a.mcap")
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        (connection,) = (each for each in reader.connections if each.topic == "/markers")
        ((_, _, raw),) = reader.messages([connection])
        *markers, _ = reader.deserialize(raw, connection.msgtype).markers
    sizes = [(marker.ns, marker.type, (marker.scale.x, marker.scale.y, marker.scale.z)) for marker in markers]
    cube, sphere, cylinder, triangles = 1, 2, 3, 11  # visualization_msgs/Marker
    assert sizes == [
        ("box", cube, (0.1, 0.2, 0.3)),
        ("ball", sphere, (0.4, 0.4, 0.4)),
        ("rod", cylinder, (0.2, 0.2, 0.7)),
        ("pill", cylinder, (0.2, 0.2, 0.6)),
        ("pill", sphere, (0.2, 0.2, 0.2)),
        ("pill", sphere, (0.2, 0.2, 0.2)),
        ("cone", triangles, (1.0, 1.0, 1.0)),
    ]
    places = [[getattr(marker.pose.position, axis) for axis in "xyz"] for marker in markers]
    ends = [[4.0, 5.0 + side * 0.3, 6.0] for side in (1, -1)]
    np.testing.assert_allclose(places, [*[[4.0, 5.0, 6.0]] * 4, *ends, [4.0, 5.0, 6.0]], atol=1e-12)
    assert all(marker.color.a == 1.0 for marker in markers)
    assert len(markers[-1].points) == 12


def test_what_is_refused(
    short_plan: Plan, saved_short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "short.mcap"
    assert output("export", saved_short, "--mcap", path).startswith(f"Written to {path}.\nThe arm has to be")
    assert "already there" in refusal("export", saved_short, "--mcap", path)
    assert "already there" in refusal("export", saved_short, "--ros", path)
    folder = tmp_path / "description"
    told = refusal("export", saved_short, "--ros-package", folder, "--effort")
    assert "--effort: got nothing beside it" in told and not folder.exists()
    with pytest.raises(InputError, match=r"cmbot\.export_ros: plan"):
        export_ros(str(saved_short), path)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"cmbot\.export_ros: max_points: got 1, expected 2 to 100000$"):
        export_ros(short_plan, tmp_path / "one.json", max_points=1)
    with pytest.raises(InputError, match=r"cmbot\.export_mcap: plan"):
        export_mcap(str(saved_short), path)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    with pytest.raises(MissingExtra, match=r"mcap-ros2-support is not installed; run: pip install .*ros"):
        export_mcap(short_plan, tmp_path / "other.mcap")
    assert list(tmp_path.iterdir()) == [path]
