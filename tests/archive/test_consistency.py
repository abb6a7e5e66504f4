"""Plan directories whose parts are each valid, but do not belong together."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plan_folders import edit, npz, refused, rewrite
from small_scenes import short_scene

from cmbot.archive import load_plan, save
from cmbot.common.errors import ArchiveError, LimitViolation
from cmbot.planning import Plan, QuinticTrajectory, plan

GLOBAL = ("floor", "choice", "torque_floor", "gap_to_floor")


@pytest.fixture(scope="module")
def sliding_plan() -> Plan:
    """A small plan with an approach."""
    return plan(short_scene(planner={"knots": "sliding"}))


@pytest.fixture(scope="module")
def sliding(sliding_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(sliding_plan, tmp_path_factory.mktemp("archive") / "sliding")


@pytest.fixture(scope="module")
def fixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(plan(short_scene()), tmp_path_factory.mktemp("archive") / "fixed")


@pytest.fixture
def folder(sliding: Path, tmp_path: Path) -> Path:
    """A plan directory to be changed."""
    return Path(shutil.copytree(sliding, tmp_path / "plan"))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda data: data.pop("approach"), "approach"),
        (lambda data: data.update(floor=None), "floor"),
        (lambda data: data.update(choice=None), "choice"),
        (lambda data: data.update(torque_floor=None), "torque_floor"),
        (lambda data: data.update(torque_floor=data["torque_floor"] + 1e-3), "torque_floor"),
        (lambda data: data.update(gap_to_floor=None), "gap_to_floor"),
        (lambda data: data.update(gap_to_floor=data["gap_to_floor"] + 1e-6), "gap_to_floor"),
        (lambda data: data["planned"].update(peak_guardrail_torque=1.0), "objective.planned_peak"),
        (lambda data: data["floor"].update(value=-1.0), "floor.value"),
        (lambda data: data["floor"].update(value=1.0), "torque_floor"),
        (lambda data: data["floor"]["each"].pop(), "floor.each"),
        (lambda data: data["floor"].update(each=[]), "floor.each"),
        (lambda data: data["floor"].update(via_point=8), "floor.via_point"),
        (lambda data: data["floor"].update(via_point=3), "floor.value"),
        (lambda data: data["objective"].update(name="sag"), "objective.name"),
        (lambda data: data["objective"].update(moment_about="base"), "objective.moment_about"),
        (lambda data: data["objective"].update(own=True), "objective.moment_about"),
        (lambda data: data["objective"].update(planned_peak=1.0), "objective.planned_peak"),
        (lambda data: data["objective"].update(baseline_peak=1.0), "objective.baseline_peak"),
        (lambda data: data["objective"].update(floor=1.0), "objective.floor"),
        (lambda data: data["objective"].update(gap=None), "objective.gap"),
        (lambda data: data["floor"].update(via_point=-1), "floor.via_point"),
        (lambda data: data["choice"].update(free=-1.0), "choice.free"),
        (lambda data: data["choice"].pop("pinned"), "choice.pinned"),
        (lambda data: data["approach"].pop("limit_use"), "approach.limit_use"),
        (lambda data: data["approach"].update(along_self_motion=1), "approach.along_self_motion"),
        (lambda data: data["approach"].update(seconds=0.0), "approach.seconds"),
        (
            lambda data: data["approach"]["certificate"]["checks"][2].update(value=1e9),
            "approach.certificate.checks[2]",
        ),
        (lambda data: data["files"].update({"other.csv": "0" * 64}), "files"),
        (lambda data: data["start"].update(moved_deg=0.0), "approach"),
        (lambda data: data["options"].update(knots="fixed"), "approach"),
    ],
)
def test_what_does_not_fit_is_named_by_its_key(folder, change, key):
    edit(folder, change)
    refused(folder, "plan.json", key)


def test_an_approach_that_is_denied(folder):
    edit(folder, lambda data: data.update(approach=None))
    assert "approach.csv" in refused(folder, "plan.json", "files").got
    edit(folder, lambda data: [data["files"].pop(f"approach.{end}") for end in ("csv", "npz", "ros.json")])
    assert refused(folder, "plan.json", "approach").got == "null"


@pytest.mark.parametrize("key", GLOBAL)
def test_with_fixed_knots_nothing_is_known_of_the_floor(sliding, fixed, tmp_path, key):
    folder = Path(shutil.copytree(fixed, tmp_path / "plan"))
    other = {}
    edit(Path(shutil.copytree(sliding, tmp_path / "other")), other.update)
    edit(folder, lambda data: data.update({key: other[key]}))
    refused(folder, "plan.json", key)


def knots_of(trajectory: QuinticTrajectory, **changes: np.ndarray) -> bytes:
    return npz(**{name: changes.get(name, getattr(trajectory, name)) for name in ("t", "q", "v", "a")})


@pytest.mark.parametrize(("end", "words"), [(0, "the scene's posture"), (-1, "where the work starts")])
def test_motions_that_do_not_join(folder, sliding_plan, end, words):
    """An arm that drove them one after the other would jump."""
    trajectory = sliding_plan.approach.trajectory
    q = trajectory.q.copy()
    q[end, 3] += 1e-6
    rewrite(folder, "approach.npz", knots_of(trajectory, q=q))
    assert words in refused(folder, "approach.npz", "q").expected


def test_a_start_that_is_not_where_the_motion_begins(folder, sliding_plan):
    trajectory = sliding_plan.trajectory
    rewrite(folder, "trajectory.npz", knots_of(trajectory, q=trajectory.q + 1e-6))
    refused(folder, "plan.json", "start.posture_deg")


@pytest.mark.parametrize("change", [lambda t: t + 1, lambda t: 2 * t])
def test_an_approach_of_other_times(folder, sliding_plan, change):
    trajectory = sliding_plan.approach.trajectory
    rewrite(folder, "approach.npz", knots_of(trajectory, t=change(trajectory.t)))
    assert "plan.json" in refused(folder, "approach.npz", "t").expected


def test_an_approach_of_another_arm(folder, sliding_plan):
    trajectory = sliding_plan.approach.trajectory
    fewer = {name: getattr(trajectory, name)[:, :6] for name in ("q", "v", "a")}
    rewrite(folder, "approach.npz", knots_of(trajectory, **fewer))
    refused(folder, "approach.npz", "q")


def test_a_choice_without_a_way(sliding_plan, tmp_path):
    choice = replace(sliding_plan.choice, pinned=None)
    assert load_plan(save(replace(sliding_plan, choice=choice), tmp_path / "plan")).choice == choice


# Verifying


@pytest.mark.parametrize("motion", ["planned", "baseline", "approach"])
def test_verify_notices_wrong_figures(folder, motion):
    edit(folder, lambda data: data[motion].update(mean_guardrail_torque=1.0))
    assert load_plan(folder).start.moved > 0  # the file's word
    with pytest.raises(ArchiveError) as caught:
        load_plan(folder, verify=True)
    assert caught.value.key == f"{motion}.mean_guardrail_torque"
    assert caught.value.got == 1.0


@pytest.mark.parametrize("name", ["trajectory", "approach"])
def test_verify_notices_a_broken_promise(folder, sliding_plan, name):
    knots = (sliding_plan.approach if name == "approach" else sliding_plan).trajectory
    v = knots.v.copy()
    v[5] += 0.5
    rewrite(folder, f"{name}.npz", knots_of(knots, v=v))
    assert load_plan(folder).certificate.holds  # the file's word
    with pytest.raises(LimitViolation, match="of joint_"):
        load_plan(folder, verify=True)
