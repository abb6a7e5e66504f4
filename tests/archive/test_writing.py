"""What is in a plan directory."""

import csv
import json
import math
from dataclasses import asdict, fields, replace
from functools import partial

import numpy as np
import pytest
from oracles.joint_trajectory_controller import refusals
from plan_folders import FILES, changed, edit, with_baseline

import cmbot
from cmbot.archive import add_file, export_csv, export_ros, load_plan, require_free, save
from cmbot.collision import Clearances
from cmbot.common.errors import ArchiveError
from cmbot.elastic.sag import Sag
from cmbot.planning import Check, Plan, Samples, bending_arm
from cmbot.planning.certification.metrics import measure
from cmbot.planning.flexibility.sag_compensation import Compensation
from cmbot.scene import PlannerOptions

FIGURES = {
    *(f"{kind}_guardrail_torque" for kind in ("peak", "mean", "rms", "peak_static")),
    *(
        "min_clearance",
        "max_tool_deviation",
        "max_tool_rotation",
        "max_tool_lag",
        "limit_use",
        "adhesion_needed",
        "duration",
        "guardrail_torque_integral",
    ),
}


@pytest.fixture(scope="module")
def job_samples(triangle_plan: Plan) -> Samples:
    """The approach and the work measured every 0.01 s, one after the other; the sag of each posture alone."""
    plan, robot = triangle_plan, triangle_plan.robot
    clearances, parts = Clearances(robot, plan.scene.all_obstacles), []
    for segment in plan.job.segments:
        trajectory = segment.trajectory
        # The last step is shorter where need be.
        t = np.append(0.01 * np.arange(math.ceil(100 * trajectory.duration - 1e-9)), trajectory.duration)
        motion = [trajectory.evaluate(t, order) for order in range(4)]
        parts.append(measure(robot, segment.task, clearances, t, motion, segment.task and plan.sag))
    parts[1] = replace(parts[1], t=parts[0].t[-1] + parts[1].t)
    sag = Sag(bending_arm(plan.scene, robot))
    parts = [replace(part, expected_tool_point=part.tool_point + sag.at(part.q).tool) for part in parts]
    names = [field.name for field in fields(Samples)]
    return Samples(
        **{name: np.concatenate([getattr(parts[0], name), getattr(parts[1], name)[1:]]) for name in names}
    )


def test_plan_json_has_the_promised_keys(saved_triangle, triangle_plan):
    data = json.loads((saved_triangle / "plan.json").read_text(encoding="utf-8"))
    assert (data["format"], data["status"]) == ("cmbot-plan/2", "certified")
    for motion in ("baseline", "planned"):
        own = {"drift", "smallest_singular_value"} if motion == "baseline" else set()
        assert set(data[motion]) == FIGURES | {"job", "free"} | own
        assert set(data[motion]["job"]) == FIGURES
        assert set(data[motion]["limit_use"]) == {"velocity", "acceleration", "jerk", "torque"}
    assert data["planned"]["peak_guardrail_torque"] == triangle_plan.figures.peak_guardrail_torque
    assert data["baseline"]["min_clearance"] == triangle_plan.baseline.figures.min_clearance
    assert data["torque_floor"] == triangle_plan.lower_bound.value
    assert data["gap_to_floor"] == triangle_plan.gap_to_floor
    assert (data["torque_floor_kind"], data["torque_floor_error"]) == (
        "proven",
        triangle_plan.lower_bound.error,
    )
    assert set(data["floor"]) == {"value", "error", "via_point", "each", "kind", "missed"}
    assert data["floor"]["each"] == triangle_plan.lower_bound.each.tolist()
    assert data["objective"] == {
        "name": "torque",
        "unit": "Nm",
        "own": False,
        "moment_about": "foot",
        "axis_weights": [1.0, 1.0, 1.0],
        "baseline_peak": triangle_plan.baseline.figures.peak_guardrail_torque,
        "planned_peak": triangle_plan.figures.peak_guardrail_torque,
        "floor": triangle_plan.lower_bound.value,
        "gap": triangle_plan.gap_to_floor,
    }
    assert data["choice"] == {"free": triangle_plan.choice.free, "pinned": triangle_plan.choice.pinned}
    assert set(data["start"]) == {"posture_deg", "moved_deg", "failures"}
    assert set(data["hashes"]) == {"robot", "scene"}
    keys = {"stage", "number", "iterations", "ended", "constraints", "peak_torque", "worst"}
    assert {frozenset(entry) for entry in data["passes"]} == {frozenset(keys)}
    assert set(data["passes"][0]["worst"]) == {"name", "value", "limit"}
    keys = {"quantity", "time", "value", "bound", "unit", "at_least", "limit", "joint", "holds"}
    assert (data["runs"], data["stopped"]) == (triangle_plan.runs, None)
    assert {frozenset(entry) for entry in data["certificate"]["checks"]} == {frozenset(keys)}
    certificate, (approach, work) = triangle_plan.approach.certificate, data["segments"]
    keys = {"name", "kind", "begin", "seconds", "along_self_motion", "certificate"}
    assert set(approach) == set(work) == FIGURES | keys
    assert (approach["name"], approach["kind"]) == ("approach", "free")
    assert (work["name"], work["kind"]) == ("work", "stroke")
    assert (approach["begin"], work["begin"]) == (0.0, approach["seconds"])
    assert data["planned"]["job"]["peak_guardrail_torque"] == approach["peak_guardrail_torque"]
    assert {key: work[key] for key in FIGURES} == {key: data["planned"][key] for key in FIGURES}
    assert work["certificate"] == data["certificate"]
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


def test_what_was_done_about_sag_has_the_promised_keys(thin_plan, tmp_path):
    compensation = Compensation(largest_shift=0.01, last_change=1e-6)
    plan = replace(thin_plan, compensation=compensation)
    data = json.loads((save(plan, tmp_path / "plan") / "plan.json").read_text())
    expected = {"largest_shift": 0.01, "last_change": 1e-6, "deviation": 0.0}
    assert data["compensation"] == expected
    assert load_plan(tmp_path / "plan").compensation == compensation


def test_the_promised_files_are_strict_json_and_the_same_each_time(saved_triangle, triangle_plan, tmp_path):
    assert {path.name for path in saved_triangle.iterdir()} == FILES
    assert {path.name for path in saved_triangle.parent.iterdir()} == {"triangle"}
    again = save(triangle_plan, str(tmp_path / "again"))
    assert again == tmp_path / "again"
    for name in FILES:
        content = (saved_triangle / name).read_bytes()
        assert (again / name).read_bytes() == content
        if name.endswith(".json"):
            json.loads(content.decode("utf-8"), parse_constant=pytest.fail)


@pytest.mark.parametrize("name", ["job", "work", "baseline"])
def test_tables_hold_the_samples(saved_triangle, triangle_plan, job_samples, tmp_path, name):
    export_csv(triangle_plan, tmp_path / "work.csv", work=True)
    export_csv(triangle_plan, tmp_path / "job.csv")
    assert (tmp_path / "job.csv").read_bytes() == (saved_triangle / "job.csv").read_bytes()
    samples = {"work": triangle_plan.samples, "job": job_samples, "baseline": triangle_plan.baseline.samples}[
        name
    ]
    with ((tmp_path if name == "work" else saved_triangle) / f"{name}.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    joints = [f"{letter}{i}" for letter in ("q", "v", "a", "j", "tau") for i in range(1, 8)]
    vectors = [f"{v}_{axis}" for v in ("guardrail_torque", "guardrail_force", "tool") for axis in "xyz"]
    bent = [f"expected_tool_{axis}" for axis in "xyz"]
    more = [*bent, "adhesion_needed", "segment"] if name != "baseline" else []
    assert header == ["t", *joints, *vectors, "clearance", *more]
    if name == "job":
        begin = triangle_plan.job.strokes[0].begin
        expected = ["approach" if t <= begin else "work" for t in samples.t.tolist()]
        assert [row.pop() for row in rows] == expected
    elif name == "work":
        assert {row.pop() for row in rows} == {"work"}
    table = np.array(rows, dtype=float)
    if name != "baseline":
        place = header.index(bent[0])
        np.testing.assert_allclose(
            table[:, place : place + 3], samples.expected_tool_point, rtol=0, atol=1e-7
        )
        table = np.delete(table, np.s_[place : place + 3], axis=1)
    joints_and_torque = (samples.q, samples.v, samples.a, samples.j, samples.joint_torque)
    wrench = (samples.guardrail_torque, samples.guardrail_force)
    needed = [samples.adhesion_needed] if name != "baseline" else []
    columns = (samples.t, *joints_and_torque, *wrench, samples.tool_point, samples.clearance, *needed)
    np.testing.assert_allclose(table, np.column_stack(columns), rtol=5e-9, atol=5e-10)
    steps = np.diff(table[:, 0])
    assert (steps > 0).all()
    if name == "job":
        return
    np.testing.assert_allclose(steps[:-1], 0.01, rtol=1e-9)
    assert 0 < steps[-1] <= 0.01 + 1e-9


def test_planned_tables_and_knots_are_those_of_the_splines(saved_triangle, triangle_plan):
    trajectory = triangle_plan.job.trajectory
    table = np.loadtxt(saved_triangle / "job.csv", delimiter=",", skiprows=1, usecols=range(46))
    assert (table[0, 0], table[-1, 0]) == (0.0, pytest.approx(trajectory.duration, rel=1e-12))
    for order in range(4):
        expected = trajectory.evaluate(table[:, 0], order)
        np.testing.assert_allclose(table[:, 1 + 7 * order : 8 + 7 * order], expected, rtol=5e-9, atol=6e-10)
    # At rest the force on the guardrail is the arm's weight.
    np.testing.assert_allclose(table[0, 39:42], [0, 0, -triangle_plan.robot.arm_mass * 9.81], atol=1e-6)
    with np.load(saved_triangle / "job.npz", allow_pickle=False) as knots:
        assert set(knots.files) == set("tqva")
        for array in knots.files:
            np.testing.assert_array_equal(knots[array], getattr(trajectory, array))


def test_ros_joint_trajectory(triangle_plan, tmp_path):
    export_ros(triangle_plan, tmp_path / "job.ros.json")
    text = (tmp_path / "job.ros.json").read_text()
    data = json.loads(text)
    assert text.endswith("}\n")
    assert set(data) == {"header", "joint_names", "points"}
    assert data["joint_names"] == list(triangle_plan.robot.joints)
    points = data["points"]
    times = [10**9 * p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] for p in points]
    assert all(0 <= p["time_from_start"]["nanosec"] < 10**9 for p in points)
    assert times[0] == 0
    assert (np.diff(times) > 0).all()
    assert times[-1] == round(1e9 * triangle_plan.job.duration)
    assert set(points[0]) == {"positions", "velocities", "accelerations", "time_from_start"}
    for end in (points[0], points[-1]):
        np.testing.assert_allclose(end["velocities"], 0, atol=1e-9)
        np.testing.assert_allclose(end["accelerations"], 0, atol=1e-9)
    # All knots, so that controllers drive the plan's own quintics.
    job = triangle_plan.job.trajectory
    np.testing.assert_allclose(1e-9 * np.array(times), job.t, atol=1e-9)
    np.testing.assert_allclose([point["positions"] for point in points], job.q, atol=1e-8)
    assert not refusals(json.loads(text), triangle_plan.robot.joints, "humble")
    assert not refusals(json.loads(text), triangle_plan.robot.joints, "jazzy")


@pytest.mark.parametrize("plan_json", [None, "{}", '{"format": "another-plan/1"}', "[1]", '{"format": '])
def test_force_never_destroys_another_folder(short_plan, tmp_path, plan_json):
    (tmp_path / "thesis.tex").write_text("years of work")
    if plan_json is not None:
        (tmp_path / "plan.json").write_text(plan_json)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for ask in (partial(save, short_plan), require_free):
        with pytest.raises(ArchiveError, match="something other than a plan"):
            ask(tmp_path, force=True)
        with pytest.raises(ArchiveError, match=r"already there.*--force \(in Python force=True\)"):
            ask(tmp_path)
    with pytest.raises(ArchiveError, match="a file of that name"):
        save(short_plan, tmp_path / "thesis.tex", force=True)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("version", ["cmbot-plan/1", "cmbot-plan/2"])
def test_force_replaces_a_plan_of_any_version(short_plan, short_folder, version):
    """With the pages that it names; what it does not name stays, and so does a folder in the way."""
    add_file(short_folder, "report.html", "old")
    (short_folder / "notes.txt").write_text("mine")
    edit(short_folder, lambda data: data.update(format=version))
    require_free(short_folder, force=True)
    (short_folder / "replay.html").mkdir()
    with pytest.raises(ArchiveError, match=r"replay\.html: got a folder"):
        save(short_plan, short_folder, force=True)
    (short_folder / "replay.html").rmdir()
    save(short_plan, short_folder, force=True)
    assert {path.name for path in short_folder.iterdir()} == FILES | {"notes.txt"}
    assert load_plan(short_folder).figures == short_plan.figures


def test_a_new_and_an_empty_folder_are_free(short_plan, tmp_path):
    (tmp_path / "empty").mkdir()
    for place in (tmp_path / "empty", tmp_path / "above" / "new"):
        require_free(place)
        assert save(short_plan, place) == place
        assert {path.name for path in place.iterdir()} == FILES


def test_only_pages_and_plots_are_written_with_a_plan(short_plan, tmp_path):
    with pytest.raises(ArchiveError, match=r"added: got 'thesis\.tex'"):
        save(short_plan, tmp_path / "plan", added={"thesis.tex": b""})
    assert not list(tmp_path.iterdir())
    save(short_plan, tmp_path / "plan", added={"report.html": "ü", "joints.png": b"png"})
    assert (tmp_path / "plan" / "report.html").read_bytes() == "ü".encode()
    assert (tmp_path / "plan" / "joints.png").read_bytes() == b"png"


def test_numbers_that_are_none_and_broken_promises_are_not_written(short_plan, thin_plan, tmp_path):
    torque = short_plan.baseline.samples.joint_torque.copy()
    torque[5, 2] = math.nan
    samples = replace(short_plan.baseline.samples, joint_torque=torque)
    unmeasured = with_baseline(short_plan, samples=samples)
    check = Check(quantity="clearance", time=1.0, value=0.0, bound=0.02, unit="m", at_least=True)
    broken = replace(thin_plan.certificate, checks=(check,))
    for plan, words in (
        (unmeasured, r"baseline\.csv: line 7, tau3: got nan"),
        (with_baseline(short_plan, drift=math.nan), "drift"),
        (changed(short_plan, "work", certificate=broken), "status"),
        (changed(thin_plan, "approach", certificate=broken), "status"),
    ):
        with pytest.raises(ArchiveError, match=words):
            save(plan, tmp_path / "plan")
    assert not list(tmp_path.iterdir())
