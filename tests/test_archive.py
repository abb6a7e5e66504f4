"""Plan directories: what is in them, that they come whole, and that nothing doubtful is read back."""

import csv
import io
import json
import math
import re
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from plan_folders import edit, npz, refused, rewrite, same_arrays
from small_scenes import short_scene

import cmbot
from cmbot.archive import load_plan, save
from cmbot.archive.folder import APPROACH_FILES
from cmbot.archive.knots import read_knots
from cmbot.archive.tables import read_motion
from cmbot.errors import ArchiveError, PathNotFound, SceneError
from cmbot.planning import Check, Plan, QuinticTrajectory, Samples, Start, robot_of
from cmbot.planning import plan as make_plan
from cmbot.planning.figures import figures, measure
from cmbot.resources import model_folder
from cmbot.scene import Mesh, PlannerOptions, load_scene
from cmbot.scene.clearance import Clearances

MOTIONS = ("trajectory", "approach")
FILES = {"plan.json", "baseline.csv"} | {
    f"{name}{end}" for name in MOTIONS for end in (".csv", ".npz", ".ros.json")
}
FIGURES = {
    "peak_guardrail_torque",
    "mean_guardrail_torque",
    "min_clearance",
    "peak_static_guardrail_torque",
    "max_tool_deviation",
    "max_tool_rotation",
    "limit_use",
}
# A closed tetrahedron far from the arm.
TETRAHEDRON = "\n".join(
    ["v 9 9 9", "v 10 9 9", "v 9 10 9", "v 9 9 10", "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
)


@pytest.fixture(scope="module")
def saved(triangle_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan directory that no test changes."""
    return save(triangle_plan, tmp_path_factory.mktemp("archive") / "triangle")


@pytest.fixture
def folder(saved: Path, tmp_path: Path) -> Path:
    """A plan directory to be changed."""
    return Path(shutil.copytree(saved, tmp_path / "plan"))


@pytest.fixture(scope="module")
def thin_plan(triangle_plan: Plan) -> Plan:
    """The same with few samples of the baseline, quick to save."""
    samples = triangle_plan.baseline
    few = {field.name: getattr(samples, field.name)[::100] for field in fields(samples)}
    return replace(triangle_plan, baseline=Samples(**few))


@pytest.fixture(scope="module")
def fixed_plan() -> Plan:
    """A small plan whose knots are fixed: no floor, no choice, no approach."""
    return make_plan(short_scene())


@pytest.fixture(scope="module")
def approach_samples(triangle_plan: Plan) -> Samples:
    """The approach measured every 0.01 s."""
    trajectory, robot = triangle_plan.approach.trajectory, triangle_plan.robot
    t = np.append(0.01 * np.arange(math.ceil(100 * trajectory.duration)), trajectory.duration)
    motion = [trajectory.evaluate(t, order) for order in range(4)]
    clearances = Clearances(robot, triangle_plan.scene.obstacles)
    return measure(robot, triangle_plan.approach.task, clearances, t, motion)


@pytest.fixture(scope="module")
def loaded(saved: Path) -> Plan:
    return load_plan(saved)


@pytest.fixture(scope="module")
def foreign_files(tmp_path_factory: pytest.TempPathFactory, bare_urdf: str) -> Path:
    """Folder of a robot's files and a mesh."""
    files = tmp_path_factory.mktemp("foreign")
    (files / "cmbot.urdf").write_text(bare_urdf, encoding="utf-8")
    for name in ("cmbot.srdf", "joint_limits.yaml"):
        shutil.copy(model_folder() / "urdf" / name, files)
    (files / "rock.obj").write_text(TETRAHEDRON)
    return files


@pytest.fixture(scope="module")
def foreign_plan(thin_plan: Plan, foreign_files: Path) -> Plan:
    """The same motion in a scene whose robot and mesh are files with relative paths."""
    robot = thin_plan.robot
    X_WB = robot.model.frames[robot.model.getFrameId(robot.base_frame)].placement
    data = load_scene("triangle").file.as_data()
    data["robot"] = {
        "model": "cmbot.urdf",
        "base_frame": robot.base_frame,
        "tool_frame": robot.tool_frame,
        "limits": "joint_limits.yaml",
        "mount": {
            "xyz": X_WB.translation.tolist(),
            "rpy_deg": np.degrees(pin.rpy.matrixToRpy(X_WB.rotation)).tolist(),
        },
    }
    data["obstacles"].append({"name": "rock", "mesh": "rock.obj", "xyz": [0, 0, 0]})
    (foreign_files / "scene.yaml").write_text(json.dumps(data))
    scene = load_scene(foreign_files / "scene.yaml")
    return replace(thin_plan, scene=scene, robot=robot_of(scene))


@pytest.fixture(scope="module")
def foreign_saved(foreign_plan: Plan, foreign_files: Path) -> Path:
    return save(foreign_plan, foreign_files / "plan")


def motion_of(plan: Plan, name: str) -> QuinticTrajectory:
    return plan.approach.trajectory if name == "approach" else plan.trajectory


@contextmanager
def other_content(path: Path, content: str | None) -> Iterator[None]:
    """Change a file, or take it away, for a while."""
    before = path.read_bytes()
    path.unlink()
    if content is not None:
        path.write_text(content)
    yield
    path.write_bytes(before)


# What is written


def test_exactly_the_promised_files(saved):
    assert {path.name for path in saved.iterdir()} == FILES
    assert {path.name for path in saved.parent.iterdir()} == {"triangle"}


def test_plan_json_has_the_promised_keys(saved, triangle_plan):
    data = json.loads((saved / "plan.json").read_text(encoding="utf-8"))
    assert (data["format"], data["status"]) == ("cmbot-plan/1", "certified")
    for motion in ("baseline", "planned"):
        assert set(data[motion]) == FIGURES
        assert set(data[motion]["limit_use"]) == {"velocity", "acceleration", "jerk", "torque"}
    assert data["planned"]["peak_guardrail_torque"] == triangle_plan.figures.peak_guardrail_torque
    assert data["baseline"]["min_clearance"] == triangle_plan.baseline_figures.min_clearance
    assert data["torque_floor"] == triangle_plan.floor.torque
    assert data["gap_to_floor"] == triangle_plan.gap_to_floor
    assert set(data["floor"]) == {"torque", "error", "via_point", "each"}
    assert data["floor"]["each"] == triangle_plan.floor.each.tolist()
    assert data["choice"] == {"free": triangle_plan.choice.free, "pinned": triangle_plan.choice.pinned}
    certificate, approach = triangle_plan.approach.certificate, data["approach"]
    assert set(approach) == FIGURES | {"seconds", "along_self_motion", "certificate"}
    assert approach["peak_guardrail_torque"] == certificate.figures.peak_guardrail_torque
    assert approach["limit_use"] == asdict(certificate.figures.limit_use)
    assert approach["seconds"] == triangle_plan.approach.trajectory.duration
    assert approach["along_self_motion"] is triangle_plan.approach.along_self_motion
    assert approach["certificate"]["clearance_bound"] == certificate.clearance_bound
    assert set(data["files"]) == FILES - {"plan.json"}
    assert set(data["seconds"]) == {"path", "optimise", "certify", "total"}
    assert set(data["versions"]) == {"cmbot", "python", "numpy", "scipy", "pin", "coal"}
    assert data["versions"]["cmbot"] == cmbot.__version__
    assert data["hashes"]["robot"] == triangle_plan.robot.content_hash
    assert data["hashes"]["scene"] == triangle_plan.scene.content_hash
    assert data["scene"]["planner"]["max_passes"] == PlannerOptions().max_passes
    np.testing.assert_allclose(data["start"]["posture_deg"], np.degrees(triangle_plan.start.posture))
    for block, made in ((data, triangle_plan.certificate), (approach, certificate)):
        checks = block["certificate"]["checks"]
        assert [check["quantity"] for check in checks] == [check.quantity for check in made.checks]
        assert all(check["holds"] is True for check in checks)


def test_json_is_strict_and_comes_out_the_same_each_time(saved, triangle_plan, tmp_path):
    def no_number(text):
        raise AssertionError(text)

    again = save(triangle_plan, str(tmp_path / "again"))
    assert again == tmp_path / "again"
    for name in FILES:
        content = (saved / name).read_bytes()
        assert (again / name).read_bytes() == content
        if name.endswith(".json"):
            json.loads(content.decode("utf-8"), parse_constant=no_number)


@pytest.mark.parametrize("name", [*MOTIONS, "baseline"])
def test_tables_hold_the_samples_exactly(saved, triangle_plan, approach_samples, name):
    samples = {
        "trajectory": triangle_plan.samples,
        "approach": approach_samples,
        "baseline": triangle_plan.baseline,
    }[name]
    with (saved / f"{name}.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    joints = [f"{letter}{i}" for letter in ("q", "v", "a", "j", "tau") for i in range(1, 8)]
    vectors = [f"{v}_{axis}" for v in ("guardrail_torque", "guardrail_force", "tool") for axis in "xyz"]
    assert header == ["t", *joints, *vectors, "clearance"]
    table = np.array(rows, dtype=float)
    expected = [
        samples.t[:, None],
        samples.q,
        samples.v,
        samples.a,
        samples.j,
        samples.joint_torque,
        samples.guardrail_torque,
        samples.guardrail_force,
        samples.tool_point,
        samples.clearance[:, None],
    ]
    np.testing.assert_array_equal(table, np.hstack(expected))
    steps = np.diff(table[:, 0])
    np.testing.assert_allclose(steps[:-1], 0.01, rtol=1e-9)
    assert 0 < steps[-1] <= 0.01 + 1e-9


@pytest.mark.parametrize("name", MOTIONS)
def test_planned_tables_follow_the_splines(saved, triangle_plan, name):
    trajectory = motion_of(triangle_plan, name)
    table = np.loadtxt(saved / f"{name}.csv", delimiter=",", skiprows=1)
    assert (table[0, 0], table[-1, 0]) == (0.0, trajectory.duration)
    for order in range(4):
        expected = trajectory.evaluate(table[:, 0], order)
        np.testing.assert_array_equal(table[:, 1 + 7 * order : 8 + 7 * order], expected)
    # At rest the force on the guardrail is the arm's weight.
    np.testing.assert_allclose(table[0, 39:42], [0, 0, -triangle_plan.robot.arm_mass * 9.81], atol=1e-6)


@pytest.mark.parametrize("name", MOTIONS)
def test_knots_need_no_pickle(saved, triangle_plan, name):
    with np.load(saved / f"{name}.npz", allow_pickle=False) as knots:
        assert set(knots.files) == {"t", "q", "v", "a"}
        for array in knots.files:
            np.testing.assert_array_equal(knots[array], getattr(motion_of(triangle_plan, name), array))


@pytest.mark.parametrize("name", MOTIONS)
def test_ros_joint_trajectory(saved, triangle_plan, approach_samples, name):
    samples = approach_samples if name == "approach" else triangle_plan.samples
    data = json.loads((saved / f"{name}.ros.json").read_text())
    assert set(data) == {"header", "joint_names", "points"}
    assert data["joint_names"] == list(triangle_plan.robot.joints)
    points = data["points"]
    times = [10**9 * p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] for p in points]
    assert all(0 <= p["time_from_start"]["nanosec"] < 10**9 for p in points)
    assert times[0] == 0
    assert (np.diff(times) > 0).all()
    assert times[-1] == round(1e9 * motion_of(triangle_plan, name).duration)
    assert set(points[0]) == {"positions", "velocities", "accelerations", "effort", "time_from_start"}
    for end in (points[0], points[-1]):
        np.testing.assert_allclose(end["velocities"], 0, atol=1e-9)
        np.testing.assert_allclose(end["accelerations"], 0, atol=1e-9)
    assert len(points) == len(samples.t)
    middle = points[300]
    assert middle["positions"] == samples.q[300].tolist()
    assert middle["effort"] == samples.joint_torque[300].tolist()


def test_numbers_that_are_none_are_not_written(fixed_plan, tmp_path):
    torque = fixed_plan.baseline.joint_torque.copy()
    torque[5, 2] = math.nan
    plan = replace(fixed_plan, baseline=replace(fixed_plan.baseline, joint_torque=torque))
    with pytest.raises(ArchiveError, match=r"baseline\.csv: line 7, tau3: got nan"):
        save(plan, tmp_path / "plan")
    with pytest.raises(ArchiveError, match="drift"):
        save(replace(fixed_plan, drift=math.nan), tmp_path / "plan")
    assert not list(tmp_path.iterdir())


def test_a_plan_that_breaks_a_promise_is_not_written(fixed_plan, thin_plan, tmp_path):
    check = Check(quantity="clearance", time=1.0, value=0.0, bound=0.02, unit="m", at_least=True)
    broken = replace(thin_plan.certificate, checks=(check,))
    approach = replace(thin_plan.approach, certificate=broken)
    for plan in (replace(fixed_plan, certificate=broken), replace(thin_plan, approach=approach)):
        with pytest.raises(ArchiveError, match="status"):
            save(plan, tmp_path / "plan")
    assert not list(tmp_path.iterdir())


# Reading back


def test_round_trip(loaded, triangle_plan):
    plan = loaded
    same_arrays(plan.trajectory, triangle_plan.trajectory)
    for name in ("t", "q", "v", "a", "j"):
        np.testing.assert_array_equal(getattr(plan.baseline, name), getattr(triangle_plan.baseline, name))
    for field in fields(plan.baseline):
        got, expected = getattr(plan.baseline, field.name), getattr(triangle_plan.baseline, field.name)
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9, err_msg=field.name)
    same = (
        "options",
        "baseline_figures",
        "drift",
        "smallest_singular_value",
        "certificate",
        "choice",
        "gap_to_floor",
        "passes",
        "seconds",
    )
    for name in same:
        assert getattr(plan, name) == getattr(triangle_plan, name), name
    assert plan.scene.content_hash == triangle_plan.scene.content_hash
    assert plan.scene.file == triangle_plan.scene.file
    assert plan.robot.content_hash == triangle_plan.robot.content_hash
    assert plan.task.keep == triangle_plan.task.keep
    np.testing.assert_array_equal(plan.task.path.corners, triangle_plan.task.path.corners)
    np.testing.assert_allclose(plan.start.posture, triangle_plan.start.posture, rtol=1e-15)
    assert plan.start.moved == pytest.approx(triangle_plan.start.moved, rel=1e-15)
    assert plan.start.failures == ()
    same_arrays(plan.floor, triangle_plan.floor)
    assert plan.summary() == triangle_plan.summary()
    same_arrays(plan.samples, triangle_plan.samples)


def test_round_trip_of_the_approach(loaded, triangle_plan):
    got, expected = loaded.approach, triangle_plan.approach
    same_arrays(got.trajectory, expected.trajectory)
    assert got.certificate == expected.certificate
    assert got.along_self_motion is expected.along_self_motion
    assert (got.task.keep, got.task.path.profile) == (expected.task.keep, expected.task.path.profile)
    same_arrays(got.task.path, expected.task.path)


def test_saved_again_it_is_the_same(saved, loaded, tmp_path):
    again = save(loaded, tmp_path / "again")
    for name in FILES - {"plan.json", "baseline.csv"}:
        assert (again / name).read_bytes() == (saved / name).read_bytes()
    first, second = (json.loads((path / "plan.json").read_text()) for path in (saved, again))
    # Angles in degrees, and what is measured again, may differ in their last digits.
    changing = {"start", "files"}
    assert {key: first[key] for key in first.keys() - changing} == {
        key: second[key] for key in second.keys() - changing
    }


def test_round_trip_with_fixed_knots(fixed_plan, tmp_path):
    folder = save(fixed_plan, tmp_path / "plan")
    data = json.loads((folder / "plan.json").read_text())
    for key in ("approach", "torque_floor", "gap_to_floor", "floor", "choice"):
        assert data[key] is None
    assert {path.name for path in folder.iterdir()} == FILES - set(APPROACH_FILES)
    assert set(data["files"]) == FILES - {"plan.json", *APPROACH_FILES}
    read = load_plan(folder, verify=True)
    assert (read.floor, read.choice, read.approach, read.gap_to_floor) == (None, None, None, None)
    same_arrays(read.trajectory, fixed_plan.trajectory)
    assert read.baseline_figures == fixed_plan.baseline_figures
    assert read.start.moved == 0


def test_a_start_elsewhere_is_kept(fixed_plan, tmp_path):
    failures = (
        PathNotFound(
            "in the way", time=1.5, progress=0.25, smallest_singular_value=0.3, pair=("link", "slab")
        ),
        PathNotFound("out of reach", time=0.5, progress=0.125, smallest_singular_value=0.1),
    )
    start = Start(posture=fixed_plan.start.posture + 0.1, moved=0.1, failures=failures)
    moved = replace(fixed_plan.trajectory, q=fixed_plan.trajectory.q + 0.1)
    read = load_plan(save(replace(fixed_plan, start=start, trajectory=moved), tmp_path / "plan")).start
    np.testing.assert_allclose(read.posture, start.posture, rtol=1e-15)
    assert read.moved == pytest.approx(0.1, rel=1e-15)
    for got, expected in zip(read.failures, failures, strict=True):
        assert vars(got) == vars(expected)
        assert str(got) == str(expected)


def without_obstacles(certificate):
    checks = tuple(
        replace(check, value=math.inf) if check.quantity == "clearance" else check
        for check in certificate.checks
    )
    free = replace(certificate.figures, min_clearance=math.inf)
    return replace(certificate, checks=checks, figures=free, clearance_bound=math.inf)


def test_without_anything_to_hit_clearances_are_infinite(thin_plan, tmp_path):
    certificate = without_obstacles(thin_plan.certificate)
    approach = replace(thin_plan.approach, certificate=without_obstacles(thin_plan.approach.certificate))
    plan = replace(
        thin_plan,
        certificate=certificate,
        approach=approach,
        baseline=replace(thin_plan.baseline, clearance=np.full(len(thin_plan.baseline.t), np.inf)),
        baseline_figures=replace(thin_plan.baseline_figures, min_clearance=math.inf),
    )
    read = load_plan(save(plan, tmp_path / "plan"))
    assert read.certificate == certificate
    assert read.approach.certificate == approach.certificate
    assert read.baseline_figures.min_clearance == math.inf
    text = (tmp_path / "plan" / "plan.json").read_text()
    assert "Infinity" not in text
    assert (tmp_path / "plan" / "baseline.csv").read_text().splitlines()[1].endswith(",inf")


def test_paths_become_absolute(foreign_plan, foreign_saved, foreign_files, tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    plan = load_plan(shutil.copytree(foreign_saved, tmp_path / "elsewhere"))
    assert plan.robot.urdf == foreign_plan.robot.urdf
    assert plan.scene.robot == foreign_plan.scene.robot
    assert plan.scene.content_hash == foreign_plan.scene.content_hash
    meshes = [o.shape for o in plan.scene.obstacles if isinstance(o.shape, Mesh)]
    assert meshes == [Mesh(path=(foreign_files / "rock.obj").resolve())]
    same_arrays(plan.samples, foreign_plan.samples)
    # Saved once more it keeps the identity of the scene it came from.
    save(plan, tmp_path / "again")
    hashes = [
        json.loads((path / "plan.json").read_text())["hashes"] for path in (foreign_saved, tmp_path / "again")
    ]
    assert hashes[0] == hashes[1]


def test_changed_robot_files_are_noticed(foreign_plan, foreign_saved, foreign_files):
    limits = foreign_files / "joint_limits.yaml"
    with other_content(limits, limits.read_text() + "\n# a remark\n"):
        error = refused(foreign_saved, "plan.json", "hashes.robot")
        assert robot_of(foreign_plan.scene).content_hash[:16] in error.got
    assert "the robot's files have changed since" in error.expected
    assert foreign_plan.robot.content_hash[:16] in error.expected


def test_changed_meshes_are_noticed(foreign_saved, foreign_files):
    with other_content(foreign_files / "rock.obj", TETRAHEDRON.replace("v 10 9 9", "v 11 9 9")):
        refused(foreign_saved, "plan.json", "hashes.resolved_scene")


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("rock.obj", "scene.obstacles[4].mesh"),
        ("cmbot.urdf", "scene.robot.model"),
        ("joint_limits.yaml", "scene.robot.limits"),
    ],
)
def test_missing_scene_files_are_named(foreign_saved, foreign_files, name, key):
    with other_content(foreign_files / name, None):
        refused(foreign_saved, "plan.json", key)


def test_a_scene_whose_files_have_gone_is_not_written(foreign_plan, foreign_files, tmp_path):
    with other_content(foreign_files / "rock.obj", None), pytest.raises(SceneError):
        save(foreign_plan, tmp_path / "plan")
    assert not list(tmp_path.iterdir())


def test_a_broken_robot_file_is_named(foreign_saved, foreign_files):
    with other_content(foreign_files / "cmbot.urdf", "<robot"), pytest.raises(ArchiveError) as caught:
        load_plan(foreign_saved)
    assert caught.value.source == str(foreign_files / "cmbot.urdf")


# Verifying


def test_verify_certifies_again(saved, triangle_plan):
    plan = load_plan(saved, verify=True)
    for again, made in (
        (plan.certificate, triangle_plan.certificate),
        (plan.approach.certificate, triangle_plan.approach.certificate),
    ):
        # Unlike most figures it tells one grid from another.
        assert again.clearance_bound == pytest.approx(made.clearance_bound, rel=1e-9)
        for got, expected in zip(again.checks, made.checks, strict=True):
            assert got.quantity == expected.quantity
            assert got.value == pytest.approx(expected.value, rel=1e-9, abs=1e-12)


def test_baseline_figures_are_those_of_the_table(loaded):
    plan = loaded
    again = figures(plan.robot, plan.baseline)
    assert again.peak_guardrail_torque == pytest.approx(plan.baseline_figures.peak_guardrail_torque)
    assert again.limit_use.jerk == pytest.approx(plan.baseline_figures.limit_use.jerk)


# What is refused


@pytest.mark.parametrize("name", sorted(FILES))
def test_missing_files(folder, name):
    (folder / name).unlink()
    assert "no such file" in str(refused(folder, name, ""))


@pytest.mark.parametrize("name", sorted(FILES))
def test_folders_in_place_of_files(folder, name):
    (folder / name).unlink()
    (folder / name).mkdir()
    refused(folder, name, "")


@pytest.mark.parametrize("name", sorted(FILES - {"plan.json"}))
def test_files_of_another_plan(folder, name):
    """Valid by itself, but not what the figures are of."""
    content = (folder / name).read_bytes()
    if name.endswith("npz"):
        with np.load(folder / name) as knots:
            content = npz(**{**knots, "q": knots["q"] + 1e-6})
    elif name.endswith("csv"):
        header, first, *rest = content.decode().splitlines()
        content = "\n".join([header, first, *rest[:-1], rest[-1].replace("9", "8", 1), ""]).encode()
    else:
        content += b" "
    (folder / name).write_bytes(content)
    with pytest.raises(ArchiveError) as caught:
        load_plan(folder)
    assert caught.value.source == str(folder / name)


def test_no_folder(tmp_path):
    with pytest.raises(ArchiveError, match="no such folder"):
        load_plan(tmp_path / "nowhere")
    with pytest.raises(ArchiveError):
        load_plan("pl\0an")


@pytest.mark.parametrize("version", ["cmbot-plan/2", "cmbot-scene/1", 1, None])
def test_other_versions(folder, version):
    edit(folder, lambda data: (data.update(format=version), data.pop("seconds")))
    error = refused(folder, "plan.json", "format")
    assert error.expected == "'cmbot-plan/1'"


def with_drift(number):
    return lambda text: re.sub(r'"drift": [^,]+', f'"drift": {number}', text)


@pytest.mark.parametrize(
    ("change", "key", "got"),
    [
        (lambda text: text[: len(text) // 2], "", "breaks off"),
        (lambda text: "", "", "breaks off"),
        (lambda text: "[1]", "", "[1]"),
        (lambda text: "[" * 100_000, "", "recursion"),
        (lambda text: text.replace('"drift"', '"status"', 1), "'status'", "the same key again"),
        (with_drift("NaN"), "", "NaN"),
        (with_drift("-Infinity"), "", "-Infinity"),
        (with_drift("9" * 5000), "", "integer"),
    ],
)
def test_damaged_json(folder, change, key, got):
    path = folder / "plan.json"
    path.write_text(change(path.read_text()))
    assert got in str(refused(folder, "plan.json", key))


def test_json_in_another_encoding(folder):
    path = folder / "plan.json"
    path.write_bytes(path.read_bytes().replace(b"clearance", b"\xff", 1))
    assert "UTF-8" in str(refused(folder, "plan.json", ""))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda data: data.pop("drift"), "drift"),
        (lambda data: data.update(colour="red"), "colour"),
        (lambda data: data.update(status="hoped for"), "status"),
        (lambda data: data.update(torque_floor=1.0), "torque_floor"),
        (lambda data: data["planned"].update(peak_guardrail_torque="486"), "planned.peak_guardrail_torque"),
        (lambda data: data["planned"]["limit_use"].pop("jerk"), "planned.limit_use.jerk"),
        (lambda data: data["scene"]["tool_path"].update(legs=[]), "scene.tool_path.legs"),
        (lambda data: data["options"].update(damping_max=-1), "options.damping_max"),
        (lambda data: data["hashes"].update(robot="0"), "hashes.robot"),
        (lambda data: data["hashes"].update(robot="0" * 64), "hashes.robot"),
        (lambda data: data["scene"].update(name="other"), "hashes.resolved_scene"),
        (lambda data: data["certificate"].update(checks=[]), "certificate.checks"),
        (lambda data: data["certificate"]["checks"][3].update(holds=False), "certificate.checks[3]"),
        (lambda data: data["certificate"]["checks"][7].update(value=0.0), "certificate.checks[7]"),
        (lambda data: data["start"].update(posture_deg=[1.0, 2.0]), "start.posture_deg"),
        (lambda data: data["start"].update(posture_deg=[]), "start.posture_deg"),
        (lambda data: data["start"]["posture_deg"].__setitem__(2, 1.0), "start.posture_deg"),
    ],
)
def test_wrong_content_is_named_by_its_key(folder, change, key):
    edit(folder, change)
    refused(folder, "plan.json", key)


def test_a_number_too_large_for_a_float(folder):
    path = folder / "plan.json"
    path.write_text(with_drift("1e999")(path.read_text()))
    refused(folder, "plan.json", "drift")


def knots_with(**changes):
    """Function of the good knots that returns the file with some of them changed."""

    def content(knots):
        arrays = {name: change(knots[name]) for name, change in changes.items()}
        return npz(**{**{name: knots[name] for name in knots.files}, **arrays})

    return content


def in_place(index, value):
    def change(array):
        array = array.copy()
        array[index] = value
        return array

    return change


def member_without_header(knots):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name in knots.files:
            archive.writestr(f"{name}.npy", b"0123456789")
    return file.getvalue()


@pytest.mark.parametrize(
    ("content", "key"),
    [
        (lambda knots: b"", ""),
        (lambda knots: b"not a zip file", ""),
        (lambda knots: npz(**knots)[:5000], ""),
        (lambda knots: npz(t=knots["t"], q=knots["q"]), ""),
        (lambda knots: npz(**knots, extra=knots["a"]), ""),
        (knots_with(q=lambda q: q.astype(object)), ""),
        (member_without_header, "t"),
        (knots_with(q=lambda q: q.astype(np.float32)), "q"),
        (knots_with(q=lambda q: q.astype(str)), "q"),
        (knots_with(q=lambda q: q[:-1]), "q"),
        (knots_with(v=lambda v: v[:, :6]), "v"),
        (knots_with(a=in_place((3, 2), np.nan)), "a"),
        (knots_with(t=in_place(3, 0.0)), "t"),
        (knots_with(t=in_place(3, np.inf)), "t"),
        (knots_with(q=lambda q: q[:, :6], v=lambda v: v[:, :6], a=lambda a: a[:, :6]), "q"),
    ],
)
def test_damaged_knots(saved, content, key):
    with np.load(saved / "trajectory.npz") as knots:
        damaged = content(knots)
    with pytest.raises(ArchiveError) as caught:
        read_knots(damaged, "FILE", 7)
    assert (caught.value.source, caught.value.key) == ("FILE", key)


@pytest.mark.parametrize(
    "content", [knots_with(t=lambda t: t + 1), knots_with(t=lambda t: 2 * t), lambda knots: b""]
)
def test_knots_of_another_scene(folder, content):
    with np.load(folder / "trajectory.npz") as knots:
        rewrite(folder, "trajectory.npz", content(knots))
    refused(folder, "trajectory.npz", "" if not (folder / "trajectory.npz").read_bytes() else "t")


def test_a_lone_array_is_no_npz():
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    with pytest.raises(ArchiveError, match="a lone array"):
        read_knots(file.getvalue(), "FILE", 7)


def test_pickles_are_not_opened(saved, tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "sprung",))

    with np.load(saved / "trajectory.npz") as knots:
        content = npz(**{**knots, "q": np.array([Trap()], dtype=object)})
    with pytest.raises(ArchiveError, match="pickle"):
        read_knots(content, "FILE", 7)
    assert not (tmp_path / "sprung").exists()


def cell(row, column, value):
    def change(lines):
        cells = lines[row].split(",")
        cells[column] = value
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return change


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda lines: [], "line 1"),
        (lambda lines: lines[1:], "line 1"),
        (lambda lines: [lines[0].replace("tau1", "torque1"), *lines[1:]], "line 1"),
        (lambda lines: lines[:1], "t"),
        (lambda lines: lines[:2], "t"),
        (lambda lines: [*lines[:5], *lines[6:4:-1], *lines[7:]], "t"),
        (lambda lines: [*lines[:-1], lines[-1][:40]], "line 2002"),
        (cell(3, 2, "fast"), "line 4, q2"),
        (cell(3, 2, ""), "line 4, q2"),
        (cell(3, 2, "nan"), "line 4, q2"),
        (cell(3, -1, "nan"), "line 4, clearance"),
        (cell(3, -1, "-inf"), "line 4, clearance"),
        (cell(3, -2, "inf"), "line 4, tool_z"),
        (cell(3, 0, "nan"), "t"),
        (cell(3, 2, "é"), ""),
    ],
)
def test_damaged_tables(saved, change, key):
    lines = (saved / "baseline.csv").read_text().splitlines()
    with pytest.raises(ArchiveError) as caught:
        read_motion("\n".join([*change(lines), ""]).encode(), "FILE", 7)
    assert (caught.value.source, caught.value.key) == ("FILE", key)


def test_a_baseline_that_ends_too_early(folder):
    lines = (folder / "baseline.csv").read_text().splitlines()
    rewrite(folder, "baseline.csv", "\n".join(lines[:-1]).encode())
    refused(folder, "baseline.csv", "t")
