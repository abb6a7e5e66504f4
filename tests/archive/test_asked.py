"""What was asked for: folders of other scenes, or of weaker promises, are refused in one line."""

import io
import json
import re
import shutil
import struct
import zipfile
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import output, refusal, run, write_scene
from mcap.reader import make_reader
from mcap.writer import Writer
from plan_folders import changed, edit, promise, rewrite, seal, without_approach
from raster_scenes import HOLE, raster_scene
from small_scenes import SHORT, panda_scene, short_scene, strokes_scene
from walks import one_step

from cmbot import load_plan
from cmbot.archive import (
    WALK_FILE,
    Asked,
    export_csv,
    export_mcap,
    export_ros,
    save,
    verified_motions,
    write_results,
)
from cmbot.archive.knots import knots_npz
from cmbot.archive.verification import exported as exported_files
from cmbot.archive.verification.asked import (
    looser_promises,
    other_options,
    require_asked,
    require_fixed,
)
from cmbot.archive.verification.exported import compared_files
from cmbot.common.errors import ArchiveError, InputError
from cmbot.planning import (
    Job,
    Plan,
    QuinticTrajectory,
    aside_at_start,
    build_request,
    fixed_knots,
    plan,
    reached_scene,
    robot_of,
)
from cmbot.planning.postures.projection import null_space
from cmbot.planning.torque import parametrization_through
from cmbot.robot import Kinematics
from cmbot.scene import PlannerOptions, Scene, load_scene
from cmbot.stances.walking import walk_csv, walk_data
from cmbot.trajectory import SplineSpace

pytestmark = pytest.mark.usefixtures("judged_once")


@pytest.fixture
def asked(tmp_path: Path) -> Path:
    """The file of the short scene."""
    return write_scene(tmp_path / "short.yaml", SHORT)


def options(**changes: Any) -> Callable[[dict[str, Any]], object]:
    return lambda data: data["options"].update(changes)


# What was asked


def test_a_plan_of_the_scene_by_another_name_holds_and_says_so(short_folder: Path, tmp_path: Path) -> None:
    """As a job of a campaign is."""
    other = write_scene(tmp_path / "other.yaml", SHORT | {"name": "other"})
    data = json.loads(output("verify", short_folder, "--scene", other, "--json"))
    assert data["other_options"] == ["scene.name 'short' (asked 'other')"]


def test_an_objective_of_the_users_is_not_what_was_asked(
    short_plan: Plan, asked: Path, tmp_path: Path
) -> None:
    nothing = dict.fromkeys(("moment_about", "axis_weights", "floor"))
    own = replace(
        short_plan.objective, own=True, name="mine", unit="", planned_peak=1.0, baseline_peak=2.0, **nothing
    )
    save(replace(short_plan, objective=own), tmp_path / "plan")
    data = json.loads(output("verify", tmp_path / "plan", "--scene", asked, "--json"))
    assert data["other_options"] == ["objective 'mine', a function in Python (asked 'torque')"]


def test_without_a_scene_blocks_and_options_of_its_own_are_told(short_plan: Plan, tmp_path: Path) -> None:
    scene = short_plan.scene.with_values({"damper": {}, "planner.min_gain": 0.5})
    save(replace(short_plan, scene=scene), tmp_path / "plan")
    assert {"damper {}", "min_gain 0.5 (default 0.02)"} <= set(verified_motions(tmp_path / "plan").taken)


def test_a_plan_of_the_scene_holds(short_folder: Path, asked: Path, short_plan: Plan) -> None:
    data = json.loads(output("verify", short_folder, "--scene", asked, "--json"))
    assert (data["scenes"], data["looser"]) == ([str(asked)], [])
    told, _, rest = output("verify", short_folder).partition("\n")
    assert "Not verified:" in rest
    assert told.startswith("Judged by what the folder says that was asked: --scene SCENE names the scene.")
    assert told.endswith(
        "'rigid'; its own start and tool_path; compensate False (default 'auto'); knots 'fixed' (default "
        "'sliding'); baseline 'paper' (default 'none'); path_step_s 0.02 (default 0.01)."
    )
    assert data["taken"] == []
    again = load_plan(short_folder, verify=True, scene=load_scene(asked), options=short_plan.options)
    assert again.job.certificate.holds


@pytest.mark.parametrize(
    ("option", "value", "wanted"),
    [
        ("max_tool_deviation_m", 0.1, "0.0002"),
        ("max_tool_rotation_deg", 9.0, "1.0"),
        ("max_tool_lag_m", 0.5, "0.02"),
        ("safety_margin_m", 0.0, "0.02"),
    ],
)
def test_a_promise_is_loosened(
    short_folder: Path, asked: Path, option: str, value: float, wanted: str
) -> None:
    """In plan.json alone: told first without the scene, refused with it and where options are given."""
    promise(short_folder, option, value)
    told = f"{option} {value} (asked {wanted})"
    assert output("verify", short_folder).startswith(
        f"Promised otherwise than the scene in the folder asks: {told}"
    )
    error = refusal("verify", short_folder, "--scene", asked)
    expected = "promises as strict as what was asked"
    assert error == f"error: {short_folder}/plan.json: options: got {told}, expected {expected}"
    with pytest.raises(ArchiveError, match="promises as strict"):
        load_plan(short_folder, verify=True, options=PlannerOptions())


def test_what_checks_are_bounded_by_is_what_the_options_promise(short_folder: Path) -> None:
    edit(short_folder, options(max_tool_deviation_m=0.1))
    assert ".bound: got 0.0002, expected" in refusal("verify", short_folder)


def test_a_path_that_is_quicker_than_the_tool_may_be(tmp_path: Path) -> None:
    """Of the arm's tool the certificate allows 5 % more than of its path."""
    made = plan(short_scene(tool={"max_speed_m_s": 1.0}), progress=False)
    path = made.task.path
    fastest = float(np.linalg.norm(path.velocity(np.linspace(0, path.duration, 1001)), axis=1).max())

    def slower(data: dict[str, Any]) -> None:
        data["scene"]["tool"]["max_speed_m_s"] = fastest / 1.02
        data["hashes"]["scene"] = Scene.of(data["scene"], "plan.json", tmp_path).content_hash

    edit(save(made, tmp_path / "plan"), slower)
    assert ", for tool.max_speed_m_s " in refusal("verify", tmp_path / "plan")


def test_a_stricter_promise_was_asked(short_folder: Path) -> None:
    stricter = replace(load_scene(SHORT).planner, safety_margin_m=0.03)
    with pytest.raises(ArchiveError, match=r"safety_margin_m 0.02 \(asked 0.03\)"):
        load_plan(short_folder, verify=True, options=stricter)
    assert looser_promises(stricter, load_scene(SHORT).planner) == ()


def test_other_options_than_asked_are_told(short_folder: Path, asked: Path) -> None:
    """What is promised is the same: it is no reason to refuse."""
    edit(short_folder, options(min_gain=0.5, chart_seeds=1))
    differ = ["chart_seeds 1 (asked 200)", "min_gain 0.5 (asked 0.02)"]
    assert sorted(json.loads(output("verify", short_folder, "--json"))["other_options"]) == differ
    told = output("verify", short_folder, "--scene", asked)
    assert "Options other than asked, as the folder states them: " in told


def test_a_link_is_named(short_folder: Path, tmp_path: Path) -> None:
    """What it leads to may become another file after it was verified."""
    there = (short_folder / "job.npz").rename(tmp_path / "elsewhere.npz")
    (short_folder / "job.npz").symlink_to(there)
    assert "job.npz (a link)" in json.loads(output("verify", short_folder, "--json"))["not_verified"]


def test_what_is_sought_is_a_promise_and_effort_is_none() -> None:
    asked = PlannerOptions()
    effort = replace(
        asked, max_passes=1, samples_per_segment=4, step_share=0.1, solver="slsqp", time_limit_s=1.0
    )
    assert looser_promises(effort, asked) == ()
    # Where the solver is left open, any is what was asked.
    assert sorted(text.split()[0] for text in other_options(effort, asked)) == [
        "max_passes",
        "samples_per_segment",
        "step_share",
        "time_limit_s",
    ]
    assert looser_promises(replace(asked, objective="sag"), asked) == ("objective 'sag' (asked 'torque')",)
    assert looser_promises(replace(asked, knots="fixed"), asked) == ("knots 'fixed' (asked 'sliding')",)


def test_the_tool_is_lower_than_asked(short_plan: Plan, asked: Path, tmp_path: Path) -> None:
    """Rows 50 mm too low under a deviation of 0.1 m: the folder is one of a scene that starts lower."""
    q, p = np.array(short_plan.scene.posture), short_plan.task.path.position([0.0])[0]
    low = plan(short_scene(tool_path={"from": {"frame": "world", "xyz": (p - [0, 0, 0.05]).tolist()}}))
    assert np.abs(low.scene.posture - q).max() == 0
    folder = save(replace(low, options=replace(low.options, max_tool_deviation_m=0.1)), tmp_path / "low")
    edit(folder, lambda data: data["scene"]["tool_path"].pop("from"))
    for words in ((), ("--scene", asked)):
        refusal("verify", folder, *words)


@pytest.mark.parametrize(
    ("changes", "key", "values"),
    [
        ({"robot": {"tool_length_m": 0.37}}, "scene.robot.tool_length_m", "got 0.37, expected no such key"),
        ({"robot": {"payload_kg": -0.0 + 0.5}}, "scene.robot.payload_kg", "got 0.5, expected 0, as asked"),
        (
            {"tool_path": {"legs": [{"by": [0, -0.3, 0], "seconds": 5}]}},
            "scene.tool_path.legs[0].seconds",
            "got 5",
        ),
    ],
)
def test_a_plan_of_another_scene(
    changes: dict[str, Any], key: str, values: str, asked: Path, tmp_path: Path, saved_short: Path
) -> None:
    folder = save(plan(short_scene(**changes)), tmp_path / "other")
    error = refusal("verify", folder, "--scene", asked)
    assert error.startswith(f"error: {folder}/plan.json: {key}: {values}"), error
    assert error.endswith("as asked")
    # With the hash of the scene that was asked for copied into it.
    known = json.loads((saved_short / "plan.json").read_text(encoding="utf-8"))["hashes"]["scene"]
    edit(folder, lambda data: data["hashes"].update(scene=known))
    assert "plan.json: hashes.scene: got " in refusal("verify", folder)


@pytest.mark.parametrize(("number", "holds"), [(16, True), (17, True), (50, True), (8, True), (7, False)])
def test_via_points_that_were_not_asked(number: int, holds: bool) -> None:
    """Planning takes more where the tool strays or legs are short, and down to half where splines swing."""
    planned, asked = (short_scene(tool_path={"via_points": count}) for count in (number, 16))
    require_asked(planned, short_scene(tool_path={"via_points": "auto"}), "plan.json")
    if holds:
        require_asked(planned, asked, "plan.json")
        return
    with pytest.raises(ArchiveError, match=f"via_points: got {number}, expected 16, as asked"):
        require_asked(planned, asked, "plan.json")


def test_what_was_asked_by_set(short_folder: Path, asked: Path) -> None:
    """It is part of the question, beside the scene, which says otherwise."""
    promise(short_folder, "max_tool_deviation_m", 0.005)
    words = ("verify", short_folder, "--scene", asked)
    assert "max_tool_deviation_m 0.005 (asked 0.0002)" in refusal(*words)
    output(*words, "--set", "max_tool_deviation_m=0.005")
    assert "(asked 0.004)" in refusal(*words, "--set", "max_tool_deviation_m=0.004")
    assert "via_points: got 8, expected 17, as asked" in refusal(*words, "--set", "tool_path.via_points=17")
    told = json.loads(
        output(*words, "--set", "max_tool_deviation_m=0.005", "--set", "tool_path.via_points=7", "--json")
    )["other_options"]
    assert told == ["via_points of work 8 (asked 7)"]
    assert refusal("verify", words[1], "--set", "start=pinned").startswith("error: --set: got 0 of --scene")


def several(**changes: Any) -> Scene:
    scene = strokes_scene()
    entries = {**scene.as_data(), "planner": {"knots": "fixed", "path_step_s": 0.02, "baseline": "none"}}
    first, second = entries["tool_path"]["strokes"]
    begin = {"frame": "world", "xyz": [1.8154, 0.7796, -1.9628]}
    strokes = [{**first, "from": begin}, second]
    return load_scene({**entries, "tool_path": {"strokes": strokes, **changes}})


@pytest.mark.parametrize("changes", [{}, {"order": "best", "via_points": "auto"}])
def test_strokes_and_what_planning_decides_of_them(changes: dict[str, Any], tmp_path: Path) -> None:
    scene = several(**changes)
    folder = save(plan(scene), tmp_path / "strokes")
    told = verified_motions(folder, Asked(scenes=(scene,))).not_verified
    assert ("tool_path.order (that no other is better)" in told) == ("order" in changes)


def test_strokes_in_another_order(tmp_path: Path) -> None:
    scene = several()
    turned = scene.with_strokes(scene.strokes[::-1])
    with pytest.raises(
        ArchiveError, match=r"strokes\[0\]\.from\.xyz\[1\]: got 0.6796, expected 0.7796, as asked"
    ):
        require_asked(turned, scene, "plan.json")
    require_asked(turned, scene.with_strokes(scene.strokes, "best"), "plan.json")


def test_a_stroke_that_was_not_asked() -> None:
    scene = several()
    one = scene.with_strokes(scene.strokes[:1])
    with pytest.raises(ArchiveError, match="strokes: got 2 strokes, expected 1, as asked"):
        require_asked(scene, one, "plan.json")
    # As of a plan of those that can be planned.
    with pytest.raises(ArchiveError, match="got 1 stroke, back is missing, expected 2, as asked"):
        require_asked(one, scene, "plan.json")


def test_a_stroke_that_is_called_missing(short_folder: Path, asked: Path) -> None:
    edit(short_folder, lambda data: data.update(missing=["stroke_2"]))
    told = f"{short_folder}/plan.json: missing: got stroke_2, expected none: each stroke is there"
    assert refusal("verify", short_folder, "--scene", asked) == f"error: {told}"


def test_the_quickest_time_is_planned(tmp_path: Path) -> None:
    path = {"legs": [{"by": [0, -0.3, 0]}], "seconds": "auto", "via_points": 12}
    scene = load_scene({**SHORT, "tool_path": path})
    folder = save(plan(scene), tmp_path / "quick")
    file = write_scene(tmp_path / "quick.yaml", scene.as_data())
    told = output("verify", folder, "--scene", file, "--json")
    assert "seconds: auto (that no time is shorter)" in json.loads(told)["not_verified"]
    slower = load_scene({**SHORT, "tool_path": {**path, "max_base_torque_nm": 480.0}})
    with pytest.raises(ArchiveError, match="max_base_torque_nm: got nothing, expected 480"):
        load_plan(folder, verify=True, scene=slower)


def test_rows_that_nothing_reaches(tmp_path: Path) -> None:
    """They may be left out, unless all of them were asked for."""
    # With this law all via-points that are asked for can be kept.
    law = {"speed_m_s": 0.1, "speed_profile": {"kind": "jerk_limited", "ramp": 0.25}}
    scene, whole = (
        raster_scene(tmp_path, HOLE, law, cover=cover).with_options(baseline="none")
        for cover in (None, "all")
    )
    folder = save(plan(scene), tmp_path / "rows")
    (stroke,) = load_plan(folder).scene.strokes
    assert stroke.raster is not None
    assert stroke.raster.pieces is not None
    told = verified_motions(folder, Asked(scenes=(scene,))).not_verified
    assert any(re.match(r"raster work \(that nothing reaches .*, \d+ % of it\)", claim) for claim in told)
    with pytest.raises(ArchiveError, match=r"rows: got .* of work left away, .* expected 0 mm, as"):
        load_plan(folder, verify=True, scene=whole)
    # What is reached may not be left out.
    fewer = stroke.changed(raster=replace(stroke.raster, pieces=stroke.raster.pieces[:-1]))
    promised = scene.planner
    with pytest.raises(ArchiveError, match=r"rows: got .* mm of the rows of work left away, and"):
        require_asked(scene.with_strokes([fewer]), scene, "plan.json", promised, promised)
    # That is said first, though shorter rows have other ramps, too.
    quicker = fewer.changed(speed_profile=replace(fewer.speed_profile, ramp=0.2))
    with pytest.raises(ArchiveError, match=r"rows: got .* mm of the rows of work left away, and"):
        require_asked(scene.with_strokes([quicker]), scene, "plan.json", promised, promised)
    # Nor what rows are longer than the surface, on which the tool speeds up.
    over = raster_scene(tmp_path, HOLE, law, overscan_m=0.005)
    (reached,) = reached_scene(over, over.planner).strokes
    assert reached.raster is not None
    assert reached.raster.pieces is not None
    first, *others = reached.raster.pieces
    for begin, holds in ((first.begin_m, True), (first.begin_m + 1e-3, False)):
        pieces = (replace(first, begin_m=begin), *others)
        done = over.with_strokes([reached.changed(raster=replace(reached.raster, pieces=pieces))])
        with nullcontext() if holds else pytest.raises(ArchiveError, match="work left away"):
            require_asked(done, over, "plan.json", promised, promised)


def test_pinned_work_begins_where_the_arm_stands(triangle_plan: Plan, tmp_path: Path) -> None:
    assert triangle_plan.strokes[0].start.moved > 0
    asked = triangle_plan.scene.with_options(start="pinned")
    told = replace(triangle_plan, scene=asked, options=replace(triangle_plan.options, start="pinned"))
    with pytest.raises(ArchiveError, match=r"as planner\.start: pinned asks"):
        load_plan(save(told, tmp_path), verify=True, scene=asked)


def test_pinned_work_of_a_bent_arm_begins_as_far_as_it_sags(tmp_path: Path) -> None:
    options = {"start": "pinned", "baseline": "none", "compensate": True, "knots": "sliding"}
    scene = short_scene(robot={"joints": "elastic"}, planner=options)
    made = plan(scene)
    assert made.strokes[0].start.moved > 0.01
    load_plan(save(made, tmp_path), verify=True, scene=scene)
    work = made.job.strokes[0].trajectory
    request = build_request(scene, scene.planner)
    task = request.task
    along = null_space(request.cell.postures, task, work.q[:1])[0, 0]
    assert aside_at_start(request, work.q[0]) < 1e-3 + 0.1 * made.strokes[0].start.moved
    assert aside_at_start(request, work.q[0] + 0.02 * along) > 0.5 * 0.02 * np.abs(along).max()


def test_a_message_of_few_points_keeps_the_tool_on_its_path(short_plan: Plan, tmp_path: Path) -> None:
    folder, few = save(short_plan, tmp_path), tmp_path / "few.json"
    knots = len(short_plan.job.trajectory.t)
    for most in range(knots, 2, -1):
        message = export_ros(short_plan, few, max_points=most)
        if message.tool_deviation > short_plan.options.max_tool_deviation_m:
            break
    assert message.deviation < 1e-3
    with pytest.raises(ArchiveError, match=r"lead the tool [\d.]+ mm off, expected 0\.2 mm at most"):
        load_plan(folder, verify=True)
    words = ("export", folder, "--ros", few, "--force", "--max-points")
    told = run(*words, str(most)).err
    assert told.startswith(f"Warning: {few} leads the tool ")
    enough = told.split("--max-points ")[1].split()[0]
    assert most < int(enough) <= knots + 1
    assert run(*words, enough).err == ""
    load_plan(folder, verify=True)
    assert export_ros(short_plan, few, max_points=knots).tool_deviation < 1e-6
    load_plan(folder, verify=True)


def test_a_raster_in_parts(tmp_path: Path) -> None:
    scene = raster_scene(tmp_path, HOLE, spacing_m=0.02)
    X_WT = Kinematics(robot_of(scene)).tool_pose(np.array(scene.posture)).homogeneous
    parts = scene.in_cells(X_WT)
    assert len(parts.strokes) > 1
    require_asked(parts, scene, "plan.json")
    # Beside the rows of a raster a stroke of legs stays what it is.
    begin = {"frame": "bracket", "xyz": [0, 0, 0.1]}
    edge = {"name": "edge", "from": begin, "legs": [{"by": [0.1, 0, 0], "seconds": 2}], "via_points": 12}
    rows = scene.strokes[0].model_dump(mode="json", exclude_none=True) | {"name": "rows"}
    both = load_scene({**scene.as_data(), "tool_path": {"strokes": [rows, edge]}})
    X_WT = Kinematics(robot_of(both)).tool_pose(np.array(both.posture)).homogeneous
    require_asked(both.in_cells(X_WT), both, "plan.json")
    quicker = parts.with_path(speed_m_s=0.2)
    with pytest.raises(ArchiveError, match=r"strokes\[0\].speed_m_s: got 0.2, expected 0.1, as asked"):
        require_asked(quicker, scene, "plan.json")
    first, *others = parts.strokes
    assert first.raster is not None and first.raster.pieces is not None
    again = replace(first.raster, pieces=first.raster.pieces[:1])
    twice = parts.with_strokes([first, others[0].changed(raster=again), *others[1:]])
    with pytest.raises(ArchiveError, match=r"pieces: got row \d+ of .* m, done before, expected each place"):
        require_asked(twice, scene, "plan.json")


def test_work_that_begins_elsewhere_needs_an_approach(returning_plan: Plan, tmp_path: Path) -> None:
    """As fixed knots would not: they promise less."""
    alone = without_approach(returning_plan)
    whole = replace(alone, options=replace(alone.options, knots="fixed"))
    folder = save(whole, tmp_path / "plan")
    edit(folder, lambda data: data.update(floor=None, choice=None))
    assert "the scene's posture at first" in refusal("verify", folder)


def test_arguments(short_folder: Path) -> None:
    scene: Any = load_scene(SHORT)
    with pytest.raises(InputError, match="verify: got False, expected True, beside scene"):
        load_plan(short_folder, scene=scene)
    with pytest.raises(InputError, match="scene"):
        load_plan(short_folder, verify=True, scene=SHORT)  # type: ignore[arg-type]
    assert "--to: " in refusal("verify", short_folder, "--to", "triangle")
    twice = refusal("verify", short_folder, "--scene", "triangle", "--scene", "line")
    assert twice.endswith("--scene: got 2 scenes, expected one: only a tour is of several")


# What goes to the robot


@pytest.fixture(scope="module")
def sent(short_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every file that is sent to a robot."""
    folder = tmp_path_factory.mktemp("sent")
    export_ros(short_plan, folder / "job.ros.json")
    export_ros(short_plan, folder / "effort.ros.json", effort=True)
    export_csv(short_plan, folder / "work.csv", work=True)
    export_mcap(short_plan, folder / "job.mcap", effort=True)
    return folder


@pytest.fixture
def exported(sent: Path, short_folder: Path) -> Path:
    """A folder with them."""
    return shutil.copytree(sent, short_folder, dirs_exist_ok=True)


def differs(planned: Plan, folder: Path) -> str:
    """How files beside a plan's record differ from it, which ``cmbot verify`` tells as its error."""
    with pytest.raises(ArchiveError) as caught:
        compared_files(planned, folder)
    return str(caught.value)


def test_exported_files_hold(exported: Path) -> None:
    (exported / "notes.csv").write_text("what,when\nnozzle,monday\n", encoding="utf-8")
    data, sent = json.loads(output("verify", exported, "--json")), {"effort.ros.json", "work.csv", "job.mcap"}
    assert data["not_verified"][-1] == "notes.csv"
    assert {"job.csv", "job.ros.json", *sent} <= {*data["compared"]} and "notes.csv" not in data["compared"]
    assert not {*data["compared"]} & {*data["not_verified"]}


def ten_times_as_quick(points: list[Any]) -> list[Any]:
    for point in points:
        since = point["time_from_start"]
        nanoseconds = (since["sec"] * 10**9 + since["nanosec"]) // 10
        since["sec"], since["nanosec"] = divmod(nanoseconds, 10**9)
    return points


@pytest.mark.parametrize("change", [ten_times_as_quick, lambda points: points[: len(points) // 2]])
@pytest.mark.parametrize("listed", [False, True])
def test_a_message_of_another_motion(exported: Path, listed: bool, change: Any) -> None:
    path = exported / "job.ros.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    content = json.dumps(data | {"points": change(data["points"])}).encode()
    if listed:
        rewrite(exported, path.name, content)
    else:
        path.write_bytes(content)
    error = refusal("verify", exported)
    assert f"error: {path}: points: got " in error and " points, an end at " in error


def test_a_message_without_a_joint_that_moves(exported: Path, short_plan: Plan) -> None:
    export_ros(short_plan, exported / "job.ros.json", joints=short_plan.robot.joints[1:])
    assert compared_files(short_plan, exported).others == ("job.ros.json (lacks what moves: joint_1)",)


def test_a_message_with_other_points_before_its_own(exported: Path, short_plan: Plan) -> None:
    path = exported / "job.ros.json"
    path.write_text(path.read_text(encoding="utf-8").replace("{", '{"points": [], ', 1), encoding="utf-8")
    told = "points: got a key that is there twice, expected each key once"
    assert differs(short_plan, exported) == f"{path}: {told}"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda data: data.update(joint_names=["elbow"]), "joint_names: got ['elbow'], expected joints of"),
        (lambda data: data.update(joint_names=None), "joint_names: got None, expected joints of the arm"),
        (lambda data: data.update(points=[{}]), "points: got [{}], expected points with times"),
        (lambda data: data.pop("points"), "points: got None, expected points with times"),
    ],
)
def test_a_message_that_no_controller_takes(
    exported: Path, short_plan: Plan, change: Callable[[dict[str, Any]], object], told: str
) -> None:
    path = exported / "job.ros.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(ArchiveError, match=re.escape(f"{path}: {told}")):
        compared_files(short_plan, exported)


def test_files_of_something_else_are_named(
    exported: Path, short_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, content in (("notes.json", '{"nozzle": "monday"}'), ("list.json", "[1]"), ("cut.json", "{")):
        (exported / name).write_text(content, encoding="utf-8")
    files = compared_files(short_plan, exported)
    assert files.others == ("cut.json", "list.json", "notes.json")
    assert {"job.csv", "job.mcap", "job.ros.json"} <= {*files.compared}
    monkeypatch.setattr(exported_files, "find_spec", {"mcap_ros2": None}.get)
    assert "job.mcap" in compared_files(short_plan, exported).others


def test_the_work_alone_after_an_approach(returning_plan: Plan, tmp_path: Path) -> None:
    """It has fewer rows than the job, and is compared with the work."""
    folder = save(returning_plan, tmp_path / "plan")
    export_csv(returning_plan, folder / "work.csv", work=True)
    assert compared_files(returning_plan, folder).others == ()
    lines = (folder / "work.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) < (folder / "job.csv").read_bytes().count(b"\n")
    (folder / "work.csv").write_text("\n".join([*lines[:-2], lines[-1], ""]), encoding="utf-8")
    told = f"work.csv: got {len(lines) - 2} rows, expected {len(lines) - 1} rows, as the knots have them"
    with pytest.raises(ArchiveError, match=told):
        compared_files(returning_plan, folder)
    # A job that lacks a row is no work.
    (folder / "work.csv").unlink()
    lines = (folder / "job.csv").read_text(encoding="utf-8").splitlines()
    (folder / "whole.csv").write_text("\n".join([*lines[:-2], lines[-1], ""]), encoding="utf-8")
    with pytest.raises(
        ArchiveError, match=rf"whole.csv: got {len(lines) - 2} rows, expected {len(lines) - 1}"
    ):
        compared_files(returning_plan, folder)


@pytest.mark.parametrize("name", ["job.csv", "job.npz", "plan.json"])
def test_parts_that_only_cmbot_would_read(short_folder: Path, name: str) -> None:
    (short_folder / f".{name}.part").write_bytes((short_folder / name).read_bytes())
    load_plan(short_folder)
    assert f"/.{name}.part: got a part of what is being written" in refusal("verify", short_folder)
    with pytest.raises(ArchiveError, match="a part of what is being written"):
        load_plan(short_folder, verify=True)


@pytest.mark.parametrize("name", ["job.csv", "baseline.csv"])
def test_a_table_that_says_hello(short_folder: Path, name: str) -> None:
    rewrite(short_folder, name, b"hello")
    assert f"/{name}: line 1: got 'hello'" in refusal("verify", short_folder)


def test_a_row_that_lacks_a_cell(short_folder: Path, short_plan: Plan) -> None:
    lines = (short_folder / "job.csv").read_text(encoding="utf-8").splitlines()
    cells = lines[8].split(",")
    text = "\n".join([*lines[:8], ",".join(cells[:-1]), *lines[9:], ""])
    (short_folder / "job.csv").write_text(text, encoding="utf-8")
    told = f"job.csv: line 9: got {len(cells) - 1} cells, expected {len(cells)} cells"
    with pytest.raises(ArchiveError, match=told):
        compared_files(short_plan, short_folder)


def test_another_accuracy_than_the_motion_has(short_folder: Path) -> None:
    edit(short_folder, lambda data: data["accuracy"].update(within_mm=0.1))
    load_plan(short_folder)
    assert "plan.json: accuracy.within_mm: got 0.1, expected " in refusal("verify", short_folder)


@pytest.mark.parametrize("name", ["job.csv", "work.csv"])
@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        ("q2", "0.5", "line 9, q2: got '0.5', expected "),
        ("t", "0.008", "line 9, t: got '0.008', expected 0.07, as the knots have it"),
        ("guardrail_torque_x", "x", "line 9, guardrail_torque_x: got 'x', expected "),
        ("a1", "0_0.1", "line 9, a1: got '0_0.1', expected "),
        ("segment", "free_1", "line 9, segment: got 'free_1', expected work"),
    ],
)
def test_a_cell_of_a_table(
    exported: Path, short_plan: Plan, name: str, column: str, value: str, told: str
) -> None:
    lines = (exported / name).read_text(encoding="utf-8").splitlines()
    row = lines[8].split(",")
    row[lines[0].split(",").index(column)] = value
    (exported / name).write_text("\n".join([*lines[:8], ",".join(row), *lines[9:], ""]), encoding="utf-8")
    assert f"{name}: {told}" in differs(short_plan, exported)


def test_values_are_no_truth_values(exported: Path, short_plan: Plan) -> None:
    """In JSON false is no number, though Python's equals zero."""
    path = exported / "job.ros.json"
    data = json.loads(path.read_text())
    data["points"][0]["velocities"] = [False] * len(data["points"][0]["velocities"])
    path.write_text(json.dumps(data))
    assert "velocities[0]: got False" in differs(short_plan, exported)


@pytest.mark.parametrize("first", [True, False])
def test_another_array_between_the_knots(short_folder: Path, first: bool) -> None:
    """With a header of its own that the directory does not name: some read one after the other."""
    content = (short_folder / "job.npz").read_bytes()
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        directory = archive.start_dir
        members = archive.infolist()
    small = io.BytesIO()
    np.savez(small, t=np.zeros(2))
    with zipfile.ZipFile(io.BytesIO(small.getvalue())) as archive:
        hidden = small.getvalue()[: archive.start_dir]
    at = 0 if first else directory
    entry, end = bytearray(content[directory:-22]), bytearray(content[-22:])
    for member in members if first else ():
        where = entry.index(member.filename.encode()) - 4
        entry[where : where + 4] = struct.pack("<I", member.header_offset + len(hidden))
    end[16:20] = struct.pack("<I", directory + len(hidden))
    forged = content[:at] + hidden + content[at:directory] + bytes(entry) + bytes(end)
    with np.load(io.BytesIO(forged)) as read, np.load(io.BytesIO(content)) as honest:
        assert (read["t"] == honest["t"]).all()
    rewrite(short_folder, "job.npz", forged)
    assert "job.npz: got something between its arrays" in refusal("verify", short_folder)


def test_another_motion_before_the_knots(short_folder: Path, short_plan: Plan) -> None:
    """Whoever reads the file from its beginning finds that one."""
    trajectory = short_plan.job.strokes[0].trajectory
    other = replace(trajectory, q=trajectory.q + 0.1)
    rewrite(short_folder, "job.npz", knots_npz(other) + (short_folder / "job.npz").read_bytes())
    with np.load(short_folder / "job.npz") as read:
        assert (read["q"] == trajectory.q).all()
    assert re.search(r"job\.npz: got \d+ bytes beside its arrays", refusal("verify", short_folder))


def bag_with(content: bytes, add: Callable[[Writer, int], object], speed: int = 1) -> bytes:
    """A bag with the messages of another one and with what is added; its number is that of a channel."""
    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="ros2")
    numbers: dict[int, int] = {}
    for schema, channel, message in make_reader(io.BytesIO(content)).iter_messages():
        if channel.id not in numbers:
            kind = writer.register_schema(schema.name, schema.encoding, schema.data)
            numbers[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, kind)
        published = message.publish_time // speed
        writer.add_message(numbers[channel.id], message.log_time, message.data, published, message.sequence)
    add(writer, numbers[channel.id])
    writer.finish()
    return file.getvalue()


def test_a_bag_that_is_played_at_another_speed(exported: Path, short_plan: Plan) -> None:
    """By the times of publishing, which players may go by."""
    path = exported / "job.mcap"
    path.write_bytes(bag_with(path.read_bytes(), lambda *_: None, speed=2))
    told = differs(short_plan, exported)
    assert ": beside its index: got '[100000000, 50000000, 0]', expected " in told


def add_beside_the_index(writer: Writer, channel: int) -> None:
    writer._Writer__finalize_chunk()
    known = list(writer._Writer__chunk_indices)
    writer.add_message(channel, 0, b"\0" * 40, 0)
    writer._Writer__finalize_chunk()
    writer._Writer__chunk_indices[:] = known


@pytest.mark.parametrize(
    ("add", "told"),
    [
        (lambda *_: None, ""),
        (lambda writer, _: writer.add_attachment(0, 0, "job.csv", "text/csv", b"t,q1"), "Attachment: "),
        (lambda writer, _: writer.add_metadata("verified", {"by": "them"}), "Metadata: "),
        (lambda writer, _: writer.register_channel("/slower", "cdr", 1, {"by": "2"}), "Channel: "),
        (add_beside_the_index, r"\[0, 0, 0\]"),
    ],
)
def test_what_a_bag_has_beside_its_messages(
    exported: Path, short_plan: Plan, add: Callable[[Writer, int], object], told: str
) -> None:
    path = exported / "job.mcap"
    path.write_bytes(bag_with(path.read_bytes(), add))
    if not told:
        assert compared_files(short_plan, exported).others == ()
    else:
        assert re.search(f"beside its index: got .{told}", differs(short_plan, exported))


def test_a_recording_that_is_followed_by_another(exported: Path, short_plan: Plan) -> None:
    """Who reads the file from its beginning comes to both."""
    path = exported / "job.mcap"
    path.write_bytes(2 * path.read_bytes())
    assert "job.mcap: got more bytes than one recording" in differs(short_plan, exported)


def test_a_table_whose_last_digits_differ(short_folder: Path) -> None:
    """As another processor rounds them."""
    lines = (short_folder / "job.csv").read_text(encoding="utf-8").splitlines()
    names, row = lines[0].split(","), lines[8].split(",")
    k = names.index("tau2")
    row[k] = repr(float(row[k]) + 1e-9)
    rewrite(short_folder, "job.csv", "\n".join([*lines[:8], ",".join(row), *lines[9:], ""]).encode())
    load_plan(short_folder, verify=True)


def test_a_bag_of_another_motion(exported: Path, short_plan: Plan) -> None:
    trajectory = short_plan.job.strokes[0].trajectory
    lower = replace(trajectory, q=trajectory.q + 1e-3)
    export_mcap(changed(short_plan, "work", trajectory=lower), exported / "job.mcap")
    error = refusal("verify", exported)
    assert "job.mcap: /joint_trajectory at 0 s.points[0].positions[0]: got " in error
    # Of half the motion there are half the messages.
    half = len(trajectory.t) // 2 + 1
    states = {name: getattr(trajectory, name)[:half] for name in "tqva"}
    export_mcap(changed(short_plan, "work", trajectory=QuinticTrajectory(**states)), exported / "job.mcap")
    told = differs(short_plan, exported)
    assert re.search(r"job\.mcap: got \d+ messages, expected \d+, as the knots", told)
    (exported / "job.mcap").write_bytes(b"hello")
    assert "job.mcap: got a damaged file" in differs(short_plan, exported)


# Walks


@pytest.fixture
def walked(tmp_path: Path) -> Path:
    folder = tmp_path / "walk"
    write_results(folder, WALK_FILE, walk_data(one_step()), {"walk.csv": walk_csv(one_step()).encode()})
    return folder


def test_a_walk_that_was_asked_for(walked: Path, tmp_path: Path) -> None:
    walk = one_step()
    scene = write_scene(tmp_path / "here.yaml", walk.scene.as_data())
    there = walk.scene.as_data()
    there["guardrail"]["stance"] = walk.goal.stance.model_dump(mode="json")
    to = write_scene(tmp_path / "there.yaml", there)
    data = json.loads(output("verify", walked, "--scene", scene, "--to", to, "--json"))
    assert not data["looser"]
    assert data["not_verified"] == ["version, times of checks, that no way is shorter or has fewer steps"]
    assert "goal: got another stance or posture" in refusal("verify", walked, "--to", scene)
    there["robot"]["payload_kg"] = 3.0
    other = write_scene(tmp_path / "other.yaml", there)
    assert "walk.json: scene." in refusal("verify", walked, "--scene", other)
    slow = refusal("verify", walked, "--scene", scene, "--speed", "0.02")
    assert slow.endswith("walk.json: max_foot_speed: got 0.03, expected at most 0.02 m/s, as asked")


def test_a_table_of_a_walk(walked: Path) -> None:
    lines = (walked / "walk.csv").read_text(encoding="utf-8").splitlines()
    rewrite(walked, "walk.csv", "\n".join([lines[0], *lines[:0:-1], ""]).encode(), "walk.json")
    assert "walk.csv: line 2, t: got " in refusal("verify", walked)
    (walked / "walk.csv").unlink()
    assert "walk.csv (not there)" in json.loads(output("verify", walked, "--json"))["not_verified"]


def test_a_walk_beside_a_plan(walked: Path, short_folder: Path) -> None:
    (short_folder / WALK_FILE).write_bytes((walked / WALK_FILE).read_bytes())
    assert "got plan.json and walk.json, expected one of them" in refusal("verify", short_folder)


def test_a_foot_that_is_quicker_than_usual(walked: Path) -> None:
    path = walked / WALK_FILE
    text = path.read_text(encoding="utf-8").replace('"bound": 0.03,', '"bound": 0.05,')
    data = json.loads(text.replace("at most 0.03 m/s", "at most 0.05 m/s"))
    path.write_bytes(seal({**data, "max_foot_speed": 0.05}))
    told = output("verify", walked)
    assert told.startswith("Promised otherwise than the scene in the folder asks: max_foot_speed 0.05 m/s")


# Claims


def test_what_is_hidden_is_named(short_folder: Path) -> None:
    (short_folder / ".job.csv").write_bytes((short_folder / "job.csv").read_bytes())
    assert ".job.csv" in json.loads(output("verify", short_folder, "--json"))["not_verified"]


def test_claims_are_computed_again_or_named(triangle_folder: Path) -> None:
    data = json.loads(output("verify", triangle_folder, "--scene", "triangle", "--json"))
    claims = " ".join(data["not_verified"])
    for claim in (
        "torque_floor (",
        "gap_to_floor",
        "choice",
        "baseline",
        "no motion has a lower one",
        "quiet_modes: 2",
    ):
        assert claim in claims
    assert "tool_path.order" not in claims


@pytest.mark.parametrize(
    "key",
    [
        *("baseline.drift", "baseline.smallest_singular_value", "baseline.peak_guardrail_torque"),
        *("planned.min_clearance", "objective.planned_peak", "objective.baseline_peak"),
        *("segments.0.certificate.guardrail_torque_bound", "segments.0.certificate.clearance_bound"),
        *("segments.0.certificate.checks.0.value", "segments.0.certificate.checks.1.value"),
        *("accuracy.within_mm", "sway.sway_mm", "holding_joints.climb_1.peak_nm", "contact.0.area_cm2"),
    ],
)
def test_what_is_computed_again(short_folder: Path, key: str) -> None:
    def change(data: Any) -> None:
        *path, last = (int(name) if name.isdigit() else name for name in key.split("."))
        for name in path:
            data = data[name]
        data[last] *= 1.5

    edit(short_folder, change)
    assert "as computed again" in refusal("verify", short_folder)


@pytest.mark.parametrize("name", ["clearance_bound", "guardrail_torque_bound", "value", "bound"])
def test_what_a_certificate_says_is_computed_again_to_rounding(short_folder: Path, name: str) -> None:
    """By a hundredth of a percent the arm is made a little better than it is, wherever that is told."""
    quantity = "velocity"

    def change(data: Any) -> None:
        for entry in (data["certificate"], *(segment["certificate"] for segment in data["segments"])):
            checks = [check for check in entry["checks"] if check["quantity"].startswith(quantity)]
            assert checks
            for each in checks if name in checks[0] else [entry]:
                each[name] *= 1 + 1e-4 * (1 if name in ("clearance_bound", "bound") else -1)

    edit(short_folder, change)
    told = refusal("verify", short_folder)
    assert f".{name}: got " in told
    assert "as computed again" in told


@pytest.mark.parametrize("key", ["torque_floor", "gap_to_floor", "torque_floor_error", "floor.value"])
def test_claims_of_the_lower_bound_agree(triangle_folder: Path, key: str) -> None:
    """They are not verified, but not each may say something else."""

    def change(data: Any) -> None:
        at = data["floor"] if "." in key else data
        at[key.rpartition(".")[2]] *= 1.5

    edit(triangle_folder, change)
    assert ": got " in refusal("verify", triangle_folder, "--scene", "triangle")


@pytest.mark.parametrize("change", [{"safety_margin_m": 0.05}, {"objective": "sag"}])
def test_the_planner_of_its_scene_is_what_was_asked_or_used(
    short_plan: Plan, asked: Path, change: dict[str, Any], tmp_path: Path
) -> None:
    """Though the options beside it are as asked."""
    folder = save(replace(short_plan, scene=short_plan.scene.with_options(**change)), tmp_path / "plan")
    assert f"plan.json: scene.planner.{next(iter(change))}: got " in refusal(
        "verify", folder, "--scene", asked
    )


def test_names_of_files_are_told_apart_from_words(short_folder: Path) -> None:
    (short_folder / "a\nAll files hold the motion.bin").write_text("")
    told = json.loads(output("verify", short_folder, "--json"))["not_verified"]
    assert any("'a All files" in name or "'a\\nAll files" in name for name in told), told


def test_options_of_the_scene_and_of_set_are_alike(short_plan: Plan, asked: Path, tmp_path: Path) -> None:
    """A plan made by an option of the command line is one of the scene that says so, and the other way."""
    words = ("--set", "max_passes=81", "--set", "max_tool_lag_m=0.03")
    options = short_plan.scene.with_options(max_passes=81, max_tool_lag_m=0.03)
    by_scene = write_scene(tmp_path / "more.yaml", options.as_data())
    output("plan", asked, *words, "--output", tmp_path / "by_set")
    output("plan", by_scene, "--output", tmp_path / "by_scene")
    for of, scene in (("by_set", (by_scene,)), ("by_scene", (asked, *words))):
        data = json.loads(output("verify", tmp_path / of, "--scene", *scene, "--json"))
        assert data["looser"] == data["other_options"] == []
    told = json.loads(output("verify", tmp_path / "by_set", "--json"))
    assert told["looser"] == ["max_tool_lag_m 0.03 (asked 0.02)"]


def test_a_move_that_leads_nowhere(tmp_path: Path) -> None:
    """Pinned work begins where the arm stands: it does not wave first, and come back."""
    scene = short_scene(planner={"start": "pinned", "baseline": "none"})
    planned = plan(scene)
    work = planned.job.strokes[0]
    t, q = np.linspace(0, 4, 9), np.repeat(work.trajectory.q[:1], 9, axis=0)
    q[3:6, 0] += [0.05, 0.1, 0.05]
    wave = SplineSpace(t).trajectory(SplineSpace(t).least_jerk(q))
    folder = save(planned, tmp_path / "plan")
    seconds = np.concatenate([wave.t, work.trajectory.t[1:] + 4])
    states = {name: [*getattr(wave, name), *getattr(work.trajectory, name)[1:]] for name in "qva"}
    whole = QuinticTrajectory(t=seconds, **{name: np.array(rows) for name, rows in states.items()})
    rewrite(folder, "job.npz", knots_npz(whole))

    def waved(data: dict[str, Any]) -> None:
        data["segments"].insert(0, data["segments"][0] | {"kind": "free", "name": "approach", "seconds": 4.0})

    edit(folder, waved)
    assert "job.npz: q: got approach to where it begins, expected no such move" in refusal("verify", folder)


def test_fixed_knots_are_those_of_gradient_projection(tmp_path: Path) -> None:
    """A motion whose via-points slide, under the name of one in which they do not."""
    scene = short_scene(planner={"start": "pinned", "baseline": "none"})
    folder = save(replace(plan(scene.with_options(knots="sliding")), scene=scene), tmp_path / "plan")
    edit(folder, lambda data: data["options"].update(knots="fixed"))
    words = ("verify", folder, "--scene", write_scene(tmp_path / "fixed.yaml", scene.as_data()))
    assert re.search(r"got via-points 0\.\d+ rad \(or m\) aside, expected those of gradient", refusal(*words))
    with pytest.raises(ArchiveError, match="gradient projection"):
        load_plan(folder, verify=True)
    honest = plan(scene)
    output("verify", save(honest, tmp_path / "honest"), "--scene", words[-1])


@pytest.mark.parametrize("bends", [{}, {"robot": {"joints": "elastic"}, "planner": {"compensate": True}}])
def test_fixed_knots_are_those_of_the_options_asked(bends: dict[str, Any], tmp_path: Path) -> None:
    """By longer steps, or drawn to another place, the arm takes another path, by 0.1 to 2 mrad."""
    scene = short_scene(**bends).with_options(baseline="none")
    request = build_request(scene, scene.planner)
    for name, changes in enumerate(({}, {"path_step_s": 0.1}, {"centre_of_gravity_weight": 2e-3})):
        made = plan(scene.with_options(**changes))
        aside = np.abs(made.trajectory.evaluate(request.times) - fixed_knots(request)).max()
        told = replace(made.options, **{key: getattr(scene.planner, key) for key in changes})
        folder = save(replace(made, scene=scene, options=told), tmp_path / str(name))
        refuses = pytest.raises(ArchiveError, match=r"via-points [\d.e-]+ rad \(or m\) aside, expected those")
        assert aside < 1e-12 or 5e-5 < aside < 3e-3
        with refuses if changes else nullcontext():
            load_plan(folder, verify=True, scene=scene)


def test_fixed_knots_are_those_of_the_laws_that_were_chosen(tmp_path: Path) -> None:
    """Away from an obstacle gradient projection leads elsewhere in another time."""
    scene = short_scene(
        robot={"joints": "elastic"},
        planner={"baseline": "none", "avoidance_distance_m": 0.5, "avoidance_gain": 8},
        tool_path={"via_points": 12, "speed_profile": {"kind": "quiet"}},
        obstacles=[{"name": "ball", "sphere": 0.1, "xyz": [1.5, 0.2, -1.2]}],
    )
    made = plan(scene)
    timed, asked = (build_request(each, each.planner) for each in (made.scene, scene))
    assert np.abs(fixed_knots(timed) - fixed_knots(asked)).max() > 1e-3
    load_plan(save(made, tmp_path), verify=True, scene=scene)


def test_fixed_knots_may_differ_by_what_rounding_does(short_plan: Plan) -> None:
    """Where avoidance leads apart what begins together, processors end as far apart as that is."""
    scene = panda_scene(
        {
            "legs": [{"by": [0, 0.1, 0], "seconds": 6}, {"by": [0, 0, 0.08], "seconds": 2}],
            "speed_profile": {"kind": "trapezoidal"},
            "via_points": 14,
        },
        robot={"model": "panda", "base_frame": "panda_link0", "tool_frame": "panda_hand_tcp"},
        start={"posture_deg": [0, -45, 0, -135, 0, 90, 45]},
        obstacles=[{"name": "ball", "sphere": 0.05, "xyz": [0.1, -0.3, 0.6]}],
        planner={"knots": "fixed", "avoidance_gain": 1.0, "avoidance_distance_m": 0.4},
    )
    request = build_request(scene, scene.planner)
    form = parametrization_through(request, fixed_knots(request), sliding=False)
    (work,) = short_plan.job.strokes
    for aside, holds in ((1e-5, True), (2e-4, False)):
        moved = replace(form.trajectory, q=form.trajectory.q + aside)
        made = replace(short_plan, scene=scene, job=Job(segments=(replace(work, trajectory=moved),)))
        with nullcontext() if holds else pytest.raises(ArchiveError, match=r"via-points .* aside"):
            require_fixed(made, scene.planner, "plan.json")
