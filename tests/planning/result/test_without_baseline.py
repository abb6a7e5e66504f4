"""Without a baseline figures stand alone, in files, tables, sentences and pages."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plan_folders import edit, names, refused
from small_scenes import short_scene, strokes_scene

from cmbot.archive import Asked, load_plan, load_tracking, save, save_tracking, verified_motions
from cmbot.planning import Plan, baseline_faults, composition, plan, remarks, verdict
from cmbot.scene import PlannerOptions, load_scene
from cmbot.simulation import SimulationOptions, Tracking, simulate, tracking_remarks, tracking_summary
from cmbot.views import pages, replay_page, report_page
from cmbot.views.replay_data import replay_data

SECONDS = SimulationOptions(settle_s=0.2)


@pytest.fixture(scope="module")
def alone() -> Plan:
    return plan(strokes_scene(baseline="none"))


@pytest.fixture(scope="module")
def simulated(alone: Plan) -> Tracking:
    return simulate(alone, SECONDS)


def test_it_is_asked_for_where_the_paper_is_compared_with() -> None:
    asked = {name: load_scene(name).planner.baseline for name in ("triangle", "line", "gusset_plate", "pipe")}
    assert asked == {"triangle": "paper", "line": "paper", "gusset_plate": "none", "pipe": "none"}
    assert PlannerOptions().baseline == "none"


def test_none_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*args: Any, **options: Any) -> None:
        raise AssertionError("a baseline is computed")

    monkeypatch.setattr(composition, "follow_path", never)
    assert plan(short_scene(planner={"baseline": "none"})).baseline is None
    with pytest.raises(AssertionError, match="a baseline is computed"):
        plan(short_scene())


def test_the_planned_motion_is_the_same(alone: Plan, strokes_plan: Plan) -> None:
    np.testing.assert_array_equal(alone.job.trajectory.q, strokes_plan.job.trajectory.q)
    assert alone.job.figures == strokes_plan.job.figures


def test_the_plan_says_nothing_of_it(alone: Plan) -> None:
    assert alone.baseline is None and alone.objective.baseline_peak is None
    assert alone.largest_torque_difference is None and alone.peak_static_reduction is None
    assert baseline_faults(alone) == baseline_faults(alone, work=True) == ""
    assert {len(row) for row in alone.rows()} == {2}
    assert alone.summary().splitlines()[0].split() == ["planned"]
    for said in (*remarks(alone), verdict(alone), repr(alone), alone._repr_html_()):
        assert "baseline" not in said.lower()
    assert not re.search(r"% (less|more|higher|lower) than the", verdict(alone))


def test_its_folder_has_none(alone: Plan, simulated: Tracking, tmp_path: Path) -> None:
    folder = save(alone, tmp_path / "plan")
    assert names(folder) == {"plan.json", "job.csv", "job.npz"}
    data = json.loads((folder / "plan.json").read_text())
    assert data["baseline"] is None
    assert [stroke["baseline"] for stroke in data["strokes"]] == [None, None]
    told = verified_motions(folder, Asked(scenes=(alone.scene,)))
    assert told.not_verified and not any("baseline" in claim for claim in told.not_verified)
    read = load_plan(folder)
    assert read.baseline is None and read.job.figures == alone.job.figures
    assert save_tracking(simulated, folder)
    assert "tracking_baseline.csv" not in names(folder)
    again = load_tracking(read, folder)
    assert again is not None and again.baseline is None
    np.testing.assert_allclose(again.planned.error, simulated.planned.error, atol=1e-9)


def test_replacing_a_plan_with_one_takes_its_table_away(
    alone: Plan, strokes_plan: Plan, tmp_path: Path
) -> None:
    folder = save(strokes_plan, tmp_path / "plan")
    assert "baseline.csv" in names(folder)
    save(alone, folder, force=True)
    assert "baseline.csv" not in names(folder)
    assert load_plan(folder).baseline is None


def test_a_file_that_contradicts_its_options_is_refused(
    alone: Plan, strokes_plan: Plan, tmp_path: Path
) -> None:
    without, with_it = save(alone, tmp_path / "without"), save(strokes_plan, tmp_path / "with")
    edit(without, lambda data: data["options"].update(baseline="paper"))
    refused(without, "plan.json", "baseline")
    other = save(strokes_plan, tmp_path / "other")
    edit(other, lambda data: data["options"].update(baseline="none"))
    refused(other, "plan.json", "baseline")
    edit(with_it, lambda data: data["files"].pop("baseline.csv"))
    refused(with_it, "plan.json", "files")


def test_the_planned_motion_alone_is_simulated(
    simulated: Tracking, strokes_tracking: Tracking, alone: Plan
) -> None:
    assert simulated.baseline is None
    assert [name for name, _ in simulated.motions] == ["planned"]
    both = strokes_tracking.planned.error[: len(simulated.planned.error)]
    np.testing.assert_allclose(simulated.planned.error, both, atol=1e-9)
    assert {len(row) for row in tracking_summary(simulated, compensated=False)} == {2}
    assert "baseline" not in " ".join(tracking_remarks(simulated, compensated=True)).lower()
    interval = simulate(alone, SimulationOptions(settle_s=0.2, stiffness_share=0.1)).interval
    assert [len(case.off_path) for case in interval] == [1, 1]


def test_pages_show_the_planned_motion_alone(alone: Plan, simulated: Tracking) -> None:
    data = replay_data(alone, simulated)
    assert data["motions"] == ["planned"] and "baseline" not in data
    assert "baseline" not in data["approach"] and "baseline" not in data["return"]
    for page in (report_page(alone, simulated), replay_page(alone, simulated), *pages(alone).values()):
        text = page if isinstance(page, str) else page.decode()
        shown = re.sub(r"<script.*?</script>|<style.*?</style>", "", text, flags=re.DOTALL)
        assert "baseline:" not in shown and "<th>baseline" not in shown


def test_straight_steps_are_the_shortest_along_the_path() -> None:
    """Each step is the least-norm one: the paper's motion beside it, which avoids, travels further."""
    near = {"avoidance_distance_m": 0.5, "knots": "sliding"}
    made = {
        kind: plan(short_scene(planner={"baseline": kind, **near})).baseline for kind in ("paper", "straight")
    }
    travel = {
        kind: np.linalg.norm(np.diff(baseline.samples.q, axis=0), axis=1).sum()
        for kind, baseline in made.items()
        if baseline is not None
    }
    assert travel["straight"] < travel["paper"]
    for baseline in made.values():
        assert baseline is not None and baseline.drift < 1e-4
