"""Tours read back and verified: each part where the one before ends, on one bridge, each stroke once."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import output, refusal, write_scene
from plan_folders import edit, promise
from small_scenes import SHORT, short_scene, strokes_scene
from walks import CLAMP, COUNTERWEIGHT_DEG, feet, one_step, tour_record

from cmbot.archive import TOUR_FILE, WALK_FILE, load_tour, save, write_results
from cmbot.common.errors import ArchiveError
from cmbot.planning import Plan, plan
from cmbot.stances import in_world
from cmbot.stances.walking import Walk, walk_data

RETURNS = {"format": "cmbot-scene/2", "return": "start"}


pytestmark = pytest.mark.usefixtures("judged_once")


def write_tour(folder: Path, **parts: Plan | Walk) -> Path:
    for name, part in parts.items():
        if isinstance(part, Plan):
            save(part, folder / name)
        else:
            write_results(folder / name, WALK_FILE, walk_data(part), {})
    write_results(folder, TOUR_FILE, tour_record(parts), {})
    return folder


@pytest.fixture
def walked(tmp_path: Path) -> Path:
    """A tour of a walk alone."""
    return write_tour(tmp_path / "tour", walk_1=one_step())


@pytest.fixture(scope="module")
def work() -> Plan:
    """Of a job that ends where it begins."""
    return plan(in_world(short_scene(**RETURNS)))


def test_what_was_written_is_read_and_holds(walked: Path) -> None:
    (part,) = load_tour(walked)
    assert (part.name, part.begin, part.motion.seconds) == ("walk_1", 0.0, one_step().seconds)
    data = json.loads(output("verify", walked, "--json"))
    assert {motion["part"] for motion in data["motions"]} == {"walk_1"}
    assert "version, words, where its work begins" in data["not_verified"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"begin": 1.0}, "parts[0].begin: got 1.0, expected 0, as its folder says"),
        ({"seconds": 1.0}, "parts[0].seconds: got 1.0, expected"),
        ({"kind": "work"}, "parts[0].kind: got 'work', expected 'walk'"),
        ({"steps": 2}, "parts[0].steps: got 2, expected 1"),
        ({"adhesion_needed": 9.0}, "parts[0].adhesion_needed: got 9"),
        ({"peak_torque": 1.0}, "parts[0].peak_torque: got 1"),
        ({"name": "../walk_1"}, "parts[0].name"),
        ({"name": "walk_2"}, "walk_2"),
    ],
)
def test_a_part_is_said_to_be_something_else(walked: Path, changes: dict[str, Any], words: str) -> None:
    edit(walked, lambda data: data["parts"][0].update(changes), TOUR_FILE)
    with pytest.raises(ArchiveError, match=re.escape(words)):
        load_tour(walked)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tour: tour.update(seconds=1.0), "seconds: got 1.0, expected"),
        (lambda tour: tour.update(parts=[]), "parts"),
        (lambda tour: tour.update(format="cmbot-tour/2"), "format"),
    ],
)
def test_the_whole_is_said_to_be_something_else(
    walked: Path, change: Callable[[dict[str, Any]], object], words: str
) -> None:
    edit(walked, change, TOUR_FILE)
    assert words in refusal("verify", walked)


def test_parts_follow_on_each_other(walked: Path) -> None:
    """The same walk twice does not begin where it ends."""

    def twice(tour: dict[str, Any]) -> None:
        (part,) = tour["parts"]
        tour["parts"] = [part, {**part, "begin": part["seconds"]}]
        tour["seconds"] *= 2

    edit(walked, twice, TOUR_FILE)
    assert "parts[1].name: got walk_1: another stance or posture" in refusal("verify", walked)


def test_work_that_ends_where_the_next_begins(work: Plan, tmp_path: Path) -> None:
    folder, asked = (
        write_tour(tmp_path / "tour", work_1=work),
        write_scene(tmp_path / "s.yaml", SHORT | RETURNS),
    )
    data = json.loads(output("verify", folder, "--scene", asked, "--json"))
    assert [motion["name"] for motion in data["motions"]] == [segment.name for segment in work.job.segments]
    (part,) = load_tour(folder, verify=True)
    np.testing.assert_array_equal(part.motion.job.trajectory.q, work.job.trajectory.q)
    changed = ("verify", folder, "--scene", asked, "--set")
    assert "scene.robot.payload_kg: got 0.0, expected 0.5" in refusal(*changed, "robot.payload_kg=0.5")
    assert "safety_margin_m 0.02 (asked 0.03)" in refusal(*changed, "safety_margin_m=0.03")
    assert "via_points: got 8, expected 20" in refusal(*changed, "tool_path.via_points=20")


@pytest.mark.parametrize("change", [{"proven_fewest_stances": True}, {"seconds": True}])
def test_what_a_tour_claims_beside_its_parts(walked: Path, change: dict[str, Any]) -> None:
    edit(walked, lambda data: data.update(change), "tour.json")
    refusal("verify", walked)


def test_truth_values_in_place_of_numbers(walked: Path) -> None:
    edit(walked, lambda data: data["parts"][0].update(steps=True), "tour.json")
    assert "parts[0].steps: got True, expected 1" in refusal("verify", walked)


def test_a_file_that_is_listed_and_not_there(walked: Path) -> None:
    edit(walked, lambda data: data["files"].update({"plan.pdf": "0" * 64}), "tour.json")
    told = json.loads(output("verify", walked, "--json"))["not_verified"]
    assert "plan.pdf (listed, but not there)" in told


def test_a_part_that_is_a_link(walked: Path, tmp_path: Path) -> None:
    (walked / "walk_1").rename(tmp_path / "elsewhere")
    (walked / "walk_1").symlink_to(tmp_path / "elsewhere")
    assert "walk_1 (a link)" in json.loads(output("verify", walked, "--json"))["not_verified"]


def test_a_part_that_promises_less(work: Plan, tmp_path: Path) -> None:
    asked = write_scene(tmp_path / "s.yaml", SHORT | RETURNS)
    folder = write_tour(tmp_path / "tour", work_1=work)
    promise(folder / "work_1", "safety_margin_m", 0.0)
    told = "Promised otherwise than the scene in the folder asks: work_1: safety_margin_m 0.0 (asked 0.02)."
    assert output("verify", folder).startswith(told)
    refused = refusal("verify", folder, "--scene", asked)
    assert "options: got safety_margin_m 0.0 (asked 0.02), expected" in refused


def test_a_tour_without_its_work(walked: Path, tmp_path: Path) -> None:
    asked = write_scene(tmp_path / "s.yaml", one_step().scene.as_data())
    refused = refusal("verify", walked, "--scene", asked)
    assert "parts: got none, expected each stroke once, as asked: work" in refused


def test_a_foot_of_a_tour_is_quicker_than_asked(walked: Path, tmp_path: Path) -> None:
    asked = write_scene(tmp_path / "s.yaml", one_step().scene.as_data())
    refused = refusal("verify", walked, "--scene", asked, "--speed", "0.02")
    assert "walk_1/walk.json: max_foot_speed: got 0.03, expected at most 0.02" in refused


def test_a_tour_ends_at_its_goal(work: Plan, walked: Path, tmp_path: Path) -> None:
    start = write_scene(tmp_path / "start.yaml", one_step().scene.as_data())
    assert "walk_1/walk.json: goal: got another stance or posture" in refusal("verify", walked, "--to", start)
    folder = write_tour(tmp_path / "works", work_1=work)
    refused = refusal("verify", folder, "--to", start)
    assert "parts: got work_1, expected a walk to the goal at last" in refused


def test_a_stroke_is_done_twice(work: Plan, tmp_path: Path) -> None:
    folder, asked = (
        write_tour(tmp_path / "tour", work_1=work, work_2=work),
        write_scene(tmp_path / "s.yaml", SHORT | RETURNS),
    )
    assert len(load_tour(folder)) == 2
    output("verify", folder)
    assert "parts: got work, work, expected each stroke once, as asked" in refusal(
        "verify", folder, "--scene", asked
    )


def test_strokes_of_a_stance_are_done_in_the_order_that_is_asked(tmp_path: Path) -> None:
    scene = in_world(strokes_scene(baseline="none"))
    folder = write_tour(tmp_path / "tour", work_1=plan(scene))
    output("verify", folder, "--scene", write_scene(tmp_path / "asked.yaml", scene.as_data()))
    data = scene.as_data()
    data["tool_path"]["strokes"].reverse()
    other = write_scene(tmp_path / "other.yaml", data)
    refused = refusal("verify", folder, "--scene", other)
    assert "parts: got tool_path.order: there, back, expected the order that is asked: back, there" in refused


def test_no_walk_leads_on_after_the_work_without_a_goal(tmp_path: Path) -> None:
    walk = replace(one_step(), scene=one_step().scene.with_values({"return": "start"}))
    path = {"legs": [{"by": [0, 0, 0.05], "seconds": 4}], "keep": "position"}
    guardrail = {"hold": CLAMP, "stance": feet(4.04, 4.44)}
    posture = list(COUNTERWEIGHT_DEG)
    scene = in_world(short_scene(posture_deg=posture, tool_path=path, guardrail=guardrail, **RETURNS))
    folder = write_tour(tmp_path / "tour", work_1=plan(scene), walk_1=walk)
    asked = write_scene(tmp_path / "asked.yaml", scene.as_data())
    assert "parts: got walk_1, expected work at last, or --to and where" in refusal(
        "verify", folder, "--scene", asked, "--speed", "0.03"
    )


def test_parts_are_on_one_bridge(work: Plan, tmp_path: Path) -> None:
    """Without the payload the second part is another robot's."""
    heavy = plan(short_scene(**RETURNS, robot={"payload_kg": 0.5}))
    folder = write_tour(tmp_path / "tour", work_1=heavy, work_2=work)
    assert "work_2/plan.json: scene.robot.payload_kg: got 0.0, expected 0.5, as in work_1" in refusal(
        "verify", folder
    )
