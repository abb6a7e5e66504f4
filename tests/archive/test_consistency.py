"""Plan directories whose parts are each valid, but do not belong together."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from forgeries import changed_scene, put_job
from plan_folders import edit, npz, refused, rewrite
from small_scenes import short_scene

from cmbot.archive import load_plan, save
from cmbot.common.errors import ArchiveError, LimitViolation
from cmbot.planning import Plan, QuinticTrajectory, plan

pytestmark = pytest.mark.usefixtures("judged_once")


@pytest.fixture(scope="module")
def sliding_plan() -> Plan:
    return plan(short_scene(planner={"knots": "sliding"}))


@pytest.fixture(scope="module")
def sliding(sliding_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(sliding_plan, tmp_path_factory.mktemp("archive") / "sliding")


@pytest.fixture
def folder(sliding: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sliding, tmp_path / "plan"))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        # Wrong by itself.
        (lambda data: data["baseline"].pop("drift"), "baseline.drift"),
        (lambda data: data.update(status="hoped for"), "status"),
        (lambda data: data["seconds"].update(total=-1.0), "seconds.total"),
        (lambda data: data["passes"][0].update(iterations=-1), "passes[0].iterations"),
        (lambda data: data["scene"]["tool_path"].update(legs=[]), "scene.tool_path.legs"),
        (lambda data: data["options"].update(damping_max=-1), "options.damping_max"),
        (lambda data: data["hashes"].update(robot="0" * 64), "hashes.robot"),
        (lambda data: data["scene"].update(name="other"), "hashes.scene"),
        (lambda data: data["baseline"].update(min_clearance=1.7e308), "baseline.min_clearance"),
        (lambda data: data["floor"].update(kind="hoped for"), "floor.kind"),
        (lambda data: data["choice"].update(free=-1.0), "choice.free"),
        (lambda data: data["segments"][0].pop("limit_use"), "segments[0].limit_use"),
        (lambda data: data["segments"][0].update(along_self_motion=1), "segments[0].along_self_motion"),
        (lambda data: data["segments"][0].update(seconds=0.0), "segments[0].seconds"),
        # Not what the rest says.
        (lambda data: data.update(colour="red"), "colour"),
        (lambda data: data["passes"][0]["worst"].update(colour="red"), "passes[0].worst.colour"),
        (lambda data: data["planned"].update(peak_guardrail_torque="486"), "planned.peak_guardrail_torque"),
        (lambda data: data["planned"]["limit_use"].pop("jerk"), "planned.limit_use.jerk"),
        (lambda data: data["planned"]["job"].update(min_clearance=1.0), "planned.job.min_clearance"),
        (lambda data: data["certificate"].update(checks=[]), "certificate.checks"),
        (lambda data: data["certificate"]["checks"][3].update(holds=False), "certificate.checks[3].holds"),
        (lambda data: data["segments"][1]["certificate"]["checks"].pop(), "certificate.checks"),
        (
            lambda data: data["segments"][0]["certificate"]["checks"][2].update(value=1e9),
            "segments[0].certificate.checks[2]",
        ),
        (lambda data: data["start"]["posture_deg"].__setitem__(2, 1.0), "start.posture_deg[2]"),
        (lambda data: data["start"].update(moved_deg=0.0), "start.moved_deg"),
        (lambda data: data["segments"].reverse(), "segments"),
        (lambda data: data["segments"][1].update(kind="free"), "segments"),
        (lambda data: data["segments"][1].update(begin=0.0), "segments[1].begin"),
        (lambda data: data["segments"][1].update(max_tool_lag=1.0), "planned.max_tool_lag"),
        (lambda data: data.update(baseline=None), "baseline"),
        (lambda data: data["files"].pop("baseline.csv"), "files"),
        (lambda data: data.update(strokes=[{**data, "name": "other"}]), "strokes"),
        (lambda data: data.update(torque_floor=data["torque_floor"] + 1e-3), "torque_floor"),
        (lambda data: data.update(torque_floor_kind="estimated"), "torque_floor_kind"),
        (lambda data: data.update(gap_to_floor=data["gap_to_floor"] + 1e-6), "gap_to_floor"),
        (lambda data: data.update(floor=None), "objective.floor"),
        (lambda data: data["floor"].update(error=0.0), "torque_floor_error"),
        (lambda data: data["floor"]["each"].pop(), "floor.each"),
        (lambda data: data["floor"].update(via_point=8), "floor.value"),
        (lambda data: data["floor"].update(via_point=3), "floor.value"),
        (lambda data: data["objective"].update(name="sag"), "objective.name"),
        (lambda data: data["objective"].update(own=True), "objective.moment_about"),
        (lambda data: data["objective"].update(planned_peak=1.0), "objective.planned_peak"),
        (lambda data: data["objective"].update(baseline_peak=1.0), "objective.baseline_peak"),
    ],
)
def test_what_is_wrong_or_does_not_fit_is_named_by_its_key(folder, change, key):
    edit(folder, change)
    refused(folder, "plan.json", key)


def test_an_approach_that_is_denied(folder):
    edit(folder, lambda data: data["segments"].pop(0))
    refused(folder, "job.npz", "t")


def knots_of(trajectory: QuinticTrajectory, **changes: np.ndarray) -> bytes:
    return npz(**{name: changes.get(name, getattr(trajectory, name)) for name in "tqva"})


def nudged(q, k):
    q = q.copy()
    q[k, 3] += 1e-6
    return q


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        # An arm that drove the motions one after the other would jump.
        (lambda own: {"q": nudged(own.q, 0)}, "q", "the scene's posture"),
        (lambda own: {"t": own.t**1.01 * own.t[-1] ** -0.01}, "t", "knots at"),
        (lambda own: {"t": own.t + 1}, "t", "plan.json"),
        (lambda own: {"t": 2 * own.t}, "t", "plan.json"),
        (lambda own: {n: getattr(own, n)[:, :6] for n in "qva"}, "q", ""),
    ],
)
def test_knots_that_do_not_fit_the_rest(folder, sliding_plan, change, key, words):
    own = sliding_plan.job.trajectory
    rewrite(folder, "job.npz", knots_of(own, **change(own)))
    assert words in refused(folder, "job.npz", key).expected


def test_a_stroke_that_begins_elsewhere(folder, sliding_plan):
    own, first = sliding_plan.job.trajectory, len(sliding_plan.approach.trajectory.t) - 1
    rewrite(folder, "job.npz", knots_of(own, q=nudged(own.q, first)))
    refused(folder, "plan.json", "start.posture_deg[3]")


def test_a_baseline_without_the_rows_of_a_stroke(strokes_plan, tmp_path):
    """Its table has both strokes; where the second one begins is between two rows."""
    folder = save(strokes_plan, tmp_path / "plan")
    begin = json.loads((folder / "plan.json").read_text())["strokes"][1]["baseline"]["begin"]
    edit(folder, lambda data: data["strokes"][1]["baseline"].update(begin=begin + 1e-3))
    error = refused(folder, "baseline.csv", "t")
    assert error.got == "no row where a stroke begins or ends"
    assert error.expected == f"rows from {begin + 1e-3:g} to {begin + 3.001:g} s"


def test_via_points_that_are_left_open(folder):
    """A plan has a number of them: by ``auto`` less would be promised where the tool is."""
    edit(folder, lambda data: changed_scene(data, lambda s: s["tool_path"].update(via_points="auto"), folder))
    error = refused(folder, "plan.json", "scene.tool_path.via_points", lambda f: load_plan(f, verify=True))
    assert (error.got, error.expected) == ("auto", "a number, as plans have it")


def test_peaks_of_a_custom_objective_are_the_files_word(short_plan, tmp_path):
    """Of the function a file has the name only: they are not computed again, as all other figures are."""
    nothing = dict.fromkeys(("moment_about", "axis_weights", "floor"))
    own = replace(
        short_plan.objective, own=True, name="mine", unit="", planned_peak=1.0, baseline_peak=2.0, **nothing
    )
    folder = save(replace(short_plan, objective=own), tmp_path / "plan")
    assert load_plan(folder, verify=True).objective == own


def test_a_choice_without_a_way(sliding_plan, tmp_path):
    choice = replace(sliding_plan.choice, pinned=None)
    assert load_plan(save(replace(sliding_plan, choice=choice), tmp_path / "plan")).choice == choice


@pytest.mark.parametrize("motion", ["planned", "baseline", "segments[0]"])
def test_verify_notices_wrong_figures(folder, sliding_plan, motion):
    def change(data):
        wrong, job = {"mean_guardrail_torque": 1.0}, data["planned"]["job"]
        if motion == "baseline":
            data["baseline"].update(wrong)
            return
        k = int(motion == "planned")
        if k:
            data["planned"].update(wrong)
        segment, old = data["segments"][k], data["segments"][k]["mean_guardrail_torque"]
        integral = {"guardrail_torque_integral": segment["seconds"]}
        segment.update(wrong | integral)
        job["mean_guardrail_torque"] += (1.0 - old) * segment["seconds"] / sliding_plan.job.duration
        job["guardrail_torque_integral"] += (1.0 - old) * segment["seconds"]
        data["planned"].update(integral) if k else data["planned"]["free"].update(wrong | integral)

    edit(folder, change)
    assert load_plan(folder).start.moved > 0  # the file's word
    with pytest.raises(ArchiveError) as caught:
        load_plan(folder, verify=True)
    # The free moves' figures are those of the approach.
    first = motion.replace("segments[0]", "planned.free")
    assert caught.value.key == f"{first}.mean_guardrail_torque"
    assert caught.value.got == 1.0


@pytest.mark.parametrize("name", ["work", "approach"])
def test_verify_notices_a_broken_promise(folder, sliding_plan, name):
    knots = sliding_plan.job.segment(name).trajectory
    v = knots.v.copy()
    v[5] += 0.5
    put_job(folder, sliding_plan.job.changed(name, trajectory=replace(knots, v=v)))
    assert load_plan(folder).certificate.holds  # the file's word
    with pytest.raises(LimitViolation, match="of joint_"):
        load_plan(folder, verify=True)
