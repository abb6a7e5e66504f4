"""The judging suite: its scenes, its oracle, and what it says of plans that are right and wrong."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import run_suite
from plan_folders import changed
from report.document import PAGE, page
from rich.console import Console
from suite import jobs, judge, oracle, scenes, tables
from suite.task import TimedPath, read_scene, rigid, world_of
from suite.world import World

from cmbot.campaigns import Task, TaskResult, TaskStatus
from cmbot.collision import Clearances
from cmbot.common.errors import PathNotFound
from cmbot.planning import Plan, plan, robot_of, strokes_of, task_of
from cmbot.robot import Dynamics, Kinematics, Postures
from cmbot.scene import Scene, load_scene
from cmbot.toolpath import SpeedProfile


def timed(scene: Scene, world: World) -> tuple[TimedPath, np.ndarray]:
    p, R = world.pose(np.array(scene.posture))
    legs = [(np.array(leg.by), leg.seconds) for leg in scene.strokes[0].legs]
    kind = scene.strokes[0].speed_profile.kind
    return TimedPath(p, legs, scene.strokes[0].speed_profile.ramp, jerk_limited=kind == "jerk_limited"), R


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Scenes of the shipped arm, of a Panda and of a UR3."""
    made = []
    for number in range(3):
        made.append(tmp_path_factory.mktemp("suite") / scenes.scene_name(5, number))
        scenes.make_scene(5, number, str(made[-1]))
    return made


def test_a_scenes_number_and_seed_determine_it(folders: list[Path], tmp_path: Path) -> None:
    scenes.make_scene(5, 1, str(tmp_path / "again"))
    for name in ("scene.yaml", "limits.yaml", "robot.srdf"):
        assert (tmp_path / "again" / name).read_bytes() == (folders[1] / name).read_bytes()
    scenes.make_scene(6, 1, str(tmp_path / "other"))
    assert (tmp_path / "other" / "scene.yaml").read_bytes() != (folders[1] / "scene.yaml").read_bytes()


@pytest.mark.parametrize("number", range(3))
def test_the_oracle_sees_what_the_package_sees(folders: list[Path], number: int) -> None:
    scene, world, path, R = read_scene(folders[number])
    robot = robot_of(scene)
    task = task_of(strokes_of(scene, robot)[0], scene)
    assert tuple(world.joints) == robot.joints
    np.testing.assert_allclose(R, task.path.orientation, atol=1e-12)
    times = np.linspace(0.0, path.duration, 50)
    np.testing.assert_allclose([path.point(t) for t in times], task.path.position(times), atol=1e-8)
    rng = np.random.default_rng(0)
    clearances = Clearances(robot, scene.all_obstacles)
    q = np.array([world.random(rng) for _ in range(20)])
    expected = clearances.query(q).distance
    for k in range(len(q)):
        p, R_k = world.pose(q[k])
        X_WT = Kinematics(robot).tool_pose(q[k])
        np.testing.assert_allclose(p, X_WT.translation, atol=1e-12)
        np.testing.assert_allclose(R_k, X_WT.rotation, atol=1e-12)
        static = np.linalg.norm(Postures(robot).at(q[k : k + 1]).guardrail_torque)
        assert world.gravity_torque(q[k]) == pytest.approx(static, rel=1e-9)
        tau = Dynamics(robot).static_efforts(q[k : k + 1]).joint_torque[0]
        assert world.holds(q[k]) == bool((np.abs(tau) <= robot.limits.torque).all())
        assert world.clear(q[k]) == bool(expected[k] >= world.margin)
        if expected[k] > 0:
            assert world.distance(q[k]) == pytest.approx(expected[k], abs=1e-5)


@pytest.mark.parametrize("keep", ["pose", "axis", "position"])
def test_newton_steps_end_on_the_task(folders: list[Path], keep: str) -> None:
    _, world, path, R = read_scene(folders[1])
    search = oracle.Oracle(world, path, R, keep)
    p = path.point(0.5 * path.duration)
    found = search.anywhere(p, 30)
    assert found
    for q in found:
        p_q, R_q = world.pose(q)
        np.testing.assert_allclose(p_q, p, atol=1e-9)
        columns = {"pose": slice(None), "axis": slice(2, 3), "position": slice(0)}[keep]
        np.testing.assert_allclose(R_q[:, columns], R[:, columns], atol=1e-8)
        assert world.admissible(q)
    values = [world.gravity_torque(q) for q in found]
    assert search.least_gravity_torque(p, found, 0)[0] <= min(values) + 1e-9


def test_the_oracle_finds_a_path_and_none_through_a_wall(tmp_path: Path) -> None:
    scene = {
        "format": "cmbot-scene/2",
        "name": "wall",
        "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
        "tool_path": {"legs": [{"by": [0, -0.2, 0], "seconds": 4}], "via_points": 8},
    }
    file = tmp_path / "scene.yaml"
    file.write_text(json.dumps(scene), encoding="utf-8")
    found = oracle.find_paths(str(tmp_path))
    assert found["scene"]
    # It starts in the scene's posture, and every posture is admissible and on the path.
    _, world, path, _ = read_scene(tmp_path)
    q = np.radians(found["path_deg"])
    np.testing.assert_allclose(q[0], np.radians(scene["start"]["posture_deg"]), atol=1e-5)
    for t, q_t in zip(found["times"], q, strict=True):
        assert world.admissible(q_t)
        np.testing.assert_allclose(world.pose(q_t)[0], path.point(t), atol=1e-5)
    at = 0.5 * (path.corners[0] + path.corners[1])
    wall = {"name": "wall", "box": [0.3, 0.02, 0.3], "xyz": at.tolist()}
    file.write_text(json.dumps(scene | {"obstacles": [wall]}), encoding="utf-8")
    found = oracle.find_paths(str(tmp_path))
    assert not found["any"]
    assert 0 < found["any_until"] < 2


def test_a_plan_is_judged_right_and_a_forged_one_wrong() -> None:
    # The judge has the paper's law of its own.
    scene = rigid(load_scene("triangle").with_path(speed_profile=SpeedProfile()))
    triangle_plan = plan(scene)
    world = world_of(scene)
    path, R = timed(scene, world)
    assert judge.violations(triangle_plan, world, path, R) == []
    search = oracle.Oracle(world, path, R, scene.strokes[0].keep)
    assert judge._false_bound(triangle_plan, search) == ""
    bound = triangle_plan.lower_bound
    assert bound is not None
    forged = replace(triangle_plan, lower_bound=replace(bound, value=1.01 * bound.value))
    assert "was found there" in judge._false_bound(forged, search)
    made = triangle_plan.trajectory
    shifted = changed(triangle_plan, "work", trajectory=replace(made, q=made.q + 0.01))
    assert any("deviation of the tool" in broken for broken in judge.violations(shifted, world, path, R))
    hasty = changed(triangle_plan, "work", trajectory=replace(made, v=3 * made.v))
    assert any(broken.startswith("jerk of") for broken in judge.violations(hasty, world, path, R))


def test_a_false_reason_is_found(triangle_plan: Plan) -> None:
    world = world_of(triangle_plan.scene)
    path, R = timed(triangle_plan.scene, world)
    search = oracle.Oracle(world, path, R, "pose")
    for reason, said in (
        ("via-point 3 of 50 is blocked: out of reach: no posture within the joint ranges holds it", "range"),
        ("via-point 1 of 50 is blocked: in the posture to start in a and b come too near", "admissible"),
        ("no way was found through via-point 3: of 7 postures that were tried there 7 come too near", ""),
        ("no way was found through via-point 3: no posture within the joint ranges was found", ""),
        ("its admissible postures are too far from those before", ""),
    ):
        error = PathNotFound(reason, time=1.0, progress=0.1, smallest_singular_value=0.1)
        claim = judge._false_claim(search, error, np.array(triangle_plan.scene.posture))
        assert said in claim
        assert bool(said) == bool(claim)


SMALL = {
    "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
    "tool_path": {"legs": [{"by": [0, -0.1, 0], "seconds": 3}], "via_points": 6},
}
# Around the end of its leg.
WALL = {"name": "wall", "box": [0.3, 0.02, 0.3], "xyz": [1.8154, 0.6796, -2.0628]}


def test_a_small_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two scenes up to the table; the tasks in this process, as dask has its own test."""

    def make(seed: int, number: int, folder: str) -> dict[str, Any]:
        # One that is planned in a moment, and one whose path ends at a wall.
        data = {"format": "cmbot-scene/2", "name": "small", **SMALL}
        data["obstacles"] = [WALL] * number
        Path(folder).mkdir(parents=True)
        Path(folder, "scene.yaml").write_text(json.dumps(data), encoding="utf-8")
        return {"arm": "cmbot", "keep": "pose"}

    calls = {"make_scene": make, "find_paths": oracle.find_paths, "plan_scene": judge.plan_scene}

    def here(tasks: Iterable[Task], *_: object) -> Iterator[TaskResult]:
        for task in tasks:
            value = calls[task.function.partition(":")[2]](**task.arguments)
            yield TaskResult(name=task.name, key=task.key, status=TaskStatus.DONE, value=value)

    monkeypatch.setattr("cmbot.campaigns.runner._run", here)
    # Its end would be this process's.
    monkeypatch.setattr(judge.resource, "setrlimit", lambda *_: None)
    console = Console(quiet=True)
    results = run_suite.suite_run([5], 2, 1, tmp_path, again=False, console=console)
    good, blocked = results["scenes"]
    assert (good["plan"]["status"], good["oracle"]["scene"]) == ("planned", True)
    assert (blocked["plan"]["status"], blocked["oracle"]["any"]) == ("no path", False)
    assert not any(good["plan"][key] for key in ("violations", "false_bound"))
    assert not blocked["plan"]["false_claim"]
    tables.show(results, tmp_path, console)
    assert (tmp_path / "suite.png").stat().st_size > 1000
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "Success by arm" in text
    assert "no path (path: none found)" in text
    for sheet in tables.sheets(results):
        assert {len(row) for row in sheet.rows} == {len(sheet.headings)}
    # Nothing is run again, and a scene whose process died is a failure of its own.
    calls.clear()
    assert run_suite.suite_run([5], 2, 1, tmp_path, again=False, console=console) == results
    died = good | {"plan": {"status": "crash", "reason": "signal SIGSEGV"}}
    assert tables.failures(results | {"scenes": [died]})[0][1].startswith("crash (path: ")


def test_goals_are_judged_by_what_was_counted_not_by_what_is_shown() -> None:
    """61 of 63 is 97 % when rounded, and less than that."""
    seen = {"any": True, "scene": False}
    planned = {"oracle": seen, "plan": {"status": "planned", "cpu_seconds": 1.0}}
    missed = {"oracle": seen | {"scene": True}, "plan": {"status": "no path", "cpu_seconds": 9.0}}
    none = {"oracle": {"any": False}, "plan": {"status": "no path", "cpu_seconds": 9.0}}
    fresh = [{**row, "seed": 2} for row in [planned] * 61 + [missed] * 2 + [none] * 5]
    rows = tables._goals([*fresh, {**planned, "seed": 1}], 1).rows
    assert rows[0][2:] == ("61 of 63: 96.8%, missed", "1 of 1: 100.0%, met")
    assert rows[1][2:] == ("0 of 2: 0.0%", "–")
    assert rows[2][2:] == ("1.00 s, met",) * 2


def test_the_tables_of_the_suite_follow_from_its_results() -> None:
    results = json.loads(tables.REFERENCE.read_text(encoding="utf-8"))
    assert page(PAGE, tables.blocks(results)) == PAGE.read_text(encoding="utf-8")


def test_a_random_job_is_one_of_strokes_from_poses_of_their_own(tmp_path: Path) -> None:
    made = jobs.make_job(5, 4, str(tmp_path / "job"))
    again = jobs.make_job(5, 4, str(tmp_path / "again"))
    texts = [(tmp_path / name / "job.yaml").read_bytes() for name in ("job", "again")]
    assert texts[0] == texts[1]
    assert made == again
    scene = load_scene(tmp_path / "job" / "job.yaml")
    assert (made["arm"], scene.name) == ("ur5", jobs.job_name(5, 4))
    plain, world, path, R = read_scene(tmp_path / "job")
    strokes = strokes_of(scene, robot_of(scene))
    assert len(strokes) == made["strokes"] == len(plain.strokes[0].legs)
    # The legs of the scene, each from where it began there, in some order.
    for stroke in strokes:
        k = int(stroke.name.removeprefix("leg_")) - 1
        np.testing.assert_allclose(stroke.path.corners, path.corners[k : k + 2], atol=1e-9)
        np.testing.assert_allclose(stroke.path.orientation, R, atol=1e-9)
    assert world.admissible(np.array(scene.posture))
    assert scene.return_to == "start"


def test_trees_connect_what_is_free_and_nothing_else(folders: list[Path]) -> None:
    _, world, _, _ = read_scene(folders[2])
    rng = np.random.default_rng(0)
    free = [q for q in (world.random(rng) for _ in range(200)) if world.admissible(q)][:2]
    assert jobs.connected(world, free[0], free[0], rng)
    blocked = next(q for q in (world.random(rng) for _ in range(2000)) if not world.clear(q))
    assert not jobs.connected(world, free[0], blocked, rng, nodes=5)
