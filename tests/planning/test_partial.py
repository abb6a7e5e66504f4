"""Jobs of which not every stroke can be planned: the others are, and what is missing is said."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import output, refusal
from small_scenes import strokes_scene

from cmbot.archive import load_plan, save
from cmbot.common.errors import PathNotFound, PlanningError
from cmbot.planning import Plan, plan, robot_of, strokes_of
from cmbot.scene import Scene
from cmbot.toolpath import Goal


def with_lost(*numbers: int) -> Scene:
    """The two strokes, before, between or behind them others that nothing reaches, or that are too quick."""
    scene = strokes_scene()
    there, back = scene.strokes
    far = there.changed(name="far", start_pose=Goal(xyz=(9.0, 0.0, 0.0)))
    # It begins where the one before ends, and so does what follows on it.
    quick = there.changed(name="quick", legs=({"by": [0, 0.1, 0.0], "seconds": 0.01},), via_points=12)
    lost = {0: far, 1: quick, 2: far.changed(name="also_far")}
    strokes = [there, back]
    for number in sorted(numbers, reverse=True):
        strokes.insert(number, lost[number])
    return scene.with_strokes(strokes)


@pytest.fixture(scope="module")
def partial_plan() -> Plan:
    return plan(with_lost(1, 2), partial=True, progress=False)


def test_what_can_be_planned_is_and_the_rest_is_named(partial_plan: Plan, strokes_plan: Plan) -> None:
    assert sorted(partial_plan.missing) == ["also_far", "quick"]
    assert [stroke.name for stroke in partial_plan.strokes] == ["there", "back"]
    told = " ".join(partial_plan.fallbacks)
    assert "Not planned: quick: " in told and "Not planned: also_far: " in told
    assert partial_plan.job.certificate.holds
    # As if the others had never been there.
    np.testing.assert_allclose(partial_plan.job.trajectory.q, strokes_plan.job.trajectory.q, atol=1e-6)


def test_without_it_the_first_failure_is_an_error() -> None:
    with pytest.raises(PathNotFound, match="9"):
        plan(with_lost(0), progress=False)


def test_where_no_stroke_can_be_planned_there_is_no_plan() -> None:
    scene = with_lost(0, 2)
    scene = scene.with_strokes([scene.strokes[0], scene.strokes[-1]])
    with pytest.raises(PlanningError):
        plan(scene, partial=True, progress=False)


def test_a_stroke_behind_a_missing_one_begins_where_that_ended() -> None:
    scene = with_lost(0)
    there, back = scene.strokes[1], scene.strokes[2]
    follows = there.changed(name="follows", start_pose=None)
    quick = back.changed(name="quick", legs=({"by": [0, -0.05, 0], "seconds": 0.01},))
    made = plan(scene.with_strokes([there, quick, follows]), partial=True, progress=False)
    assert made.missing == ("quick",)
    wanted = strokes_of(scene.with_strokes([there, quick, follows]), robot_of(scene))[2].path
    got = made.strokes[-1].task.path
    for time in (0.0, got.duration):
        np.testing.assert_allclose(got.position([time]), wanted.position([time]), atol=1e-9)


def test_a_folder_keeps_what_is_missing(partial_plan: Plan, tmp_path: Path) -> None:
    save(partial_plan, tmp_path / "plan")
    again = load_plan(tmp_path / "plan", verify=True)
    assert again.missing == partial_plan.missing and again.fallbacks == partial_plan.fallbacks


def test_the_command_line(tmp_path: Path) -> None:
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps(with_lost(2).as_data()), encoding="utf-8")
    assert "also_far" in refusal("plan", scene, "-o", tmp_path / "plan", status=3)
    assert not (tmp_path / "plan").exists()
    told = json.loads(output("plan", scene, "-o", tmp_path / "plan", "--partial", "--json"))
    assert told["missing"] == ["also_far"]
