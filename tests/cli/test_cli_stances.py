"""``cmbot stand``: what it writes, prints and refuses."""

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import Outcome, one_line, run, run_apart, write_scene
from small_scenes import short_scene

import cmbot
from cmbot.archive import STANCES_FILE, write_results
from cmbot.planning import robot_of
from cmbot.stances import StanceRanking
from cmbot.stances.search import Rejection

FILES = {"stances.csv", "stances.json", "best.yaml", "index.html"}


def named(folder: Path) -> set[str]:
    """Names of what was written but scenes of further rows."""
    return {path.name for path in folder.iterdir() if not path.name.startswith("stance_")}


@pytest.fixture(scope="module")
def stood(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """A folder after ``cmbot stand`` of few places and no plan, and what that said."""
    folder = tmp_path_factory.mktemp("stood")
    (folder / "short.yaml").write_text(json.dumps(short_scene().as_data()))
    words = ("--one-foot", "--spacing", "1.5", "--plans", "0", "--objective", "hold")
    return folder, run("stand", folder / "short.yaml", *words, "-o", folder / "out")


def test_it_writes_the_table_the_page_and_the_scene(stood: tuple[Path, Outcome]) -> None:
    folder, outcome = stood
    assert outcome.status == 0, outcome.err
    assert named(folder / "out") == FILES
    rows = [*csv.DictReader((folder / "out" / "stances.csv").read_text().splitlines())]
    assert f"{len(rows)} stances: " in outcome.out
    best = cmbot.load_scene(folder / "out" / "best.yaml")
    first, _, *blocks = (folder / "out" / "best.yaml").read_text().splitlines()
    unplanned = "not planned, so that cmbot plan may fail."
    assert first == f"# Written by cmbot stand: the scene in a stance that was {unplanned}"
    assert f"Stances, {unplanned.removesuffix('.')}: bounds (estimates)\n" in outcome.out
    assert {"name: short_stance", "planner:", "  objective: hold"} <= {*blocks}
    assert best.planner.objective == "hold"
    figures = json.loads((folder / "out" / "stances.json").read_text())["figures"]
    assert {"adhesion", "job_adhesion", "stop_adhesion"} < {*figures}
    assert best.stance.foot == pytest.approx([float(rows[0][axis]) for axis in "xyz"], abs=1e-4)


def test_every_row_that_is_printed_and_may_be_stowed_is_a_scene(job: Path) -> None:
    """Planned, it has the figures of its row; the others begin where they were judged from."""
    out = job.parent / "out"
    outcome = run("stand", job, *COARSE, "--objective", "hold", "-o", out, "--quiet")
    assert outcome.status == 0, outcome.err
    rows = [*csv.DictReader((out / "stances.csv").read_text().splitlines())]
    files = {1: "best.yaml"} | {rank: f"stance_{rank}.yaml" for rank in range(2, 11)}
    for rank, row in enumerate(rows[:10], start=1):
        judged = row["bound"] != "" and (rank == 1 or row["judged_by"] in cmbot.stances.CHARTED)
        assert (out / files[rank]).is_file() == judged
        if not judged:
            continue
        was = "planned" if row["status"] == "planned" else "not planned, so that cmbot plan may fail"
        first = (out / files[rank]).read_text().partition("\n")[0]
        assert first == f"# Written by cmbot stand: the scene in a stance that was {was}."
        scene = cmbot.load_scene(out / files[rank])
        if scene.stance is not None:  # else that of the scene, at the origin
            climbing = [float(row[f"climb_{k}_deg"]) for k in range(1, 6)]
            np.testing.assert_allclose(np.degrees(scene.stance.climber), climbing, atol=1e-3)
        if row["status"] == "planned":
            made = cmbot.plan(scene)
            assert made.job.figures.adhesion_needed.peak == pytest.approx(
                float(row["job_adhesion"]), rel=1e-4
            )
            assert made.job.duration == pytest.approx(float(row["seconds"]), rel=1e-4)
        else:
            stow = robot_of(scene).group_states["stow"]
            np.testing.assert_allclose(scene.posture, stow, atol=1e-9)
            assert scene.return_to == "stow"


def test_scenes_are_changed_as_for_a_plan(stood: tuple[Path, Outcome]) -> None:
    folder, words = stood[0], ("--one-foot", "--spacing", "1.5", "--plans", "0")
    changes = ("--set", "objective=hold", "--set", "robot.payload_kg=1.5")
    assert run("stand", folder / "short.yaml", *words, *changes, "-o", folder / "changed").status == 0
    best = cmbot.load_scene(folder / "changed" / "best.yaml")
    assert (best.planner.objective, best.robot.payload_kg) == ("hold", 1.5)
    wrong = run("stand", folder / "short.yaml", "--set", "robot.payload=1", "-o", folder / "wrong")
    assert (wrong.status, (folder / "wrong").exists()) == (2, False)
    assert "--set: robot.payload: got" in wrong.err and "payload_kg" in wrong.err


def test_it_replaces_nothing_unasked(stood: tuple[Path, Outcome]) -> None:
    folder, _ = stood
    again = run("stand", folder / "short.yaml", "-o", folder / "out")
    assert again.status == 2
    assert "expected a folder without these files, or --force" in again.err


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """A scene in a folder that has the best scene of an earlier search."""
    write_results(tmp_path / "out", STANCES_FILE, {}, {"best.yaml": b"name: best"})
    return write_scene(tmp_path / "short.yaml", short_scene().as_data())


COARSE = ("--one-foot", "--spacing", "1.5", "--plans", "1", "--force")


def test_where_nothing_is_planned_the_status_is_3_and_the_table_says_why(job: Path) -> None:
    out = job.parent / "out"
    outcome = run("stand", job, *COARSE, "--max-seconds", "1", "-o", out, "--json", "--quiet")
    assert outcome.status == 3
    error = one_line(outcome)
    assert re.search(r"short.yaml: no stance of \d+ was planned, most often for: ", error)
    assert f"; {out / 'stances.csv'} has the reason of each; " in error
    assert error.endswith("; cmbot plan of the scene judges its own stance alone, --on MEMBER seeks on fewer")
    assert error.count("(") >= 3
    assert named(out) == FILES - {"best.yaml"}
    rows = [*csv.DictReader((out / "stances.csv").read_text().splitlines())]
    assert {"beyond a bound", "out of reach"} <= {row["status"] for row in rows}
    assert next(row["reason"] for row in rows if row["status"] == "beyond a bound").endswith(
        "1 s are allowed"
    )


def test_time_that_is_over_at_once(job: Path) -> None:
    outcome = run("stand", job, *COARSE, "--time-limit", "0", "-o", job.parent / "out", "--quiet")
    assert outcome.status == 3
    said = (
        r"planned; the time was over \(--time-limit\): not judged to the end for want of time: (\d+), \1 of "
    )
    assert re.search(f"{said}them only screened; ", outcome.err)
    assert "judges the first" not in outcome.err


def test_where_the_time_is_over_the_error_has_the_next_command(
    job: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The screening ends in its time, nothing else: the file that is named is the first of them."""
    monkeypatch.setattr(
        "cmbot.stances.search.Ending.is_due", lambda ending: setattr(ending, "by", "time") or True
    )
    out = job.parent / "out"
    outcome = run("stand", job, *COARSE, "-o", out, "--quiet")
    assert outcome.status == 3
    rows = [*csv.DictReader((out / "stances.csv").read_text().splitlines())]
    waiting = sum(row["status"] == "screened" for row in rows)
    assert f"for want of time: {waiting}, {waiting} of them only screened; first " in outcome.err
    assert f"cmbot plan {out / 'stance_1.yaml'} --set time_limit_s=600 judges the first" in outcome.err
    assert cmbot.load_scene(out / "stance_1.yaml").robot == cmbot.load_scene(job).robot


def test_of_a_stance_without_time_the_file_is_named_that_judges_it(
    job: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here the first of those that are left is the second one of the table."""
    stand = cmbot.stances.stand

    def late(*arguments: Any) -> tuple[StanceRanking, ...]:
        (found,) = stand(*arguments)
        first = replace(found.ranked[0], rejection=Rejection(kind="blocked", reason="", cause=""))
        return (replace(found, ended_by="time", ranked=(first, *found.ranked[1:])),)

    monkeypatch.setattr(cmbot.stances, "stand", late)
    out, words = job.parent / "out", ("--one-foot", "--spacing", "1.5", "--plans", "0", "--force")
    outcome = run("stand", job, *words, "-o", out)
    assert (
        f"cmbot plan {out / 'stance_2.yaml'} --set time_limit_s=600 judges stance 2 to the end."
        in outcome.out
    )
    rows = [*csv.DictReader((out / "stances.csv").read_text().splitlines())]
    foot = cmbot.load_scene(out / "stance_2.yaml").stance.foot
    assert foot == pytest.approx([float(rows[1][axis]) for axis in "xyz"], abs=1e-4)


STOPS = """
import os, signal
import cmbot.common.workers as workers
import cmbot.stances.stages as stages
from cmbot.stances.search import StanceResult
def stopped(*_):
    os.kill(os.getpid(), signal.SIGINT)
result = workers._result
def judged(called):
    found = result(called)
    return stopped() if isinstance(found, StanceResult) else found
stages.bounded_quickly, workers._result = stopped, judged
from cmbot.cli import take_signals
take_signals()
"""


def test_ctrl_c_keeps_the_best_so_far(job: Path) -> None:
    """The scene's own stance, which is planned first; the page says that the search was stopped."""
    out = job.parent / "out"
    outcome = run_apart("stand", job, *COARSE, "--jobs", "2", "-o", out, before=STOPS)
    assert outcome.status == 130, outcome.err
    said = "The search ended early, as it was stopped: what was planned until then is kept"
    assert said in outcome.out
    assert named(out) == FILES
    assert said in (out / "index.html").read_text()
    best = cmbot.load_scene(out / "best.yaml")
    assert best.robot == cmbot.load_scene(job).robot
    assert "Traceback" not in outcome.err


def test_an_objective_that_cannot_be_screened(stood: tuple[Path, Outcome]) -> None:
    folder, _ = stood
    refused = run("stand", folder / "short.yaml", "--objective", "travel")
    assert refused.status == 2
    assert "--objective: got travel, expected a known value (one of: torque, hold, sag, sway)" in refused.err


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """A folder after ``cmbot stand`` of two jobs at the ends of a guardrail, and what that said."""
    folder = tmp_path_factory.mktemp("both")
    for name, x in (("left", -3.2), ("right", 3.2)):
        begin = {"frame": "world", "xyz": [x, 0.78, -1.96], "rpy_deg": [0, 180, 0]}
        job = short_scene(name=name, tool_path={"from": begin})
        (folder / f"{name}.yaml").write_text(json.dumps(job.as_data()))
    words = ("--one-foot", "--spacing", "0.8", "--plans", "0", "-o", folder / "out")
    (folder / "out").mkdir()
    (folder / "out" / "notes.txt").write_text("mine")
    return folder, run("stand", folder / "left.yaml", folder / "right.yaml", *words)


def test_jobs_that_no_stance_reaches_are_done_from_two(both: tuple[Path, Outcome]) -> None:
    folder, outcome = both
    assert outcome.status == 0, outcome.err
    assert "2 strokes from 2 stances: no fewer were found to be enough." in outcome.out
    names = {path.name for path in (folder / "out").iterdir()}
    rows = {name for name in names if re.fullmatch(r"stance_[12]_\d+\.yaml", name)}
    files = {"stances.csv", "index.html", "best_1.yaml", "best_2.yaml", "stances.json", "notes.txt"}
    assert rows
    assert names - rows == files
    scenes = [cmbot.load_scene(folder / "out" / f"best_{k}.yaml") for k in (1, 2)]
    assert [scene.strokes[0].name for scene in scenes] == ["left", "right"]
    assert scenes[0].stance.foot[0] < scenes[1].stance.foot[0]
    for scene, x in zip(scenes, (-3.2, 3.2), strict=True):
        assert scene.strokes[0].start_pose.xyz[0] == pytest.approx(x)
    rows = [*csv.DictReader((folder / "out" / "stances.csv").read_text().splitlines())]
    assert {(row["group"], row["strokes"]) for row in rows} == {("1", "left"), ("2", "right")}
    page = (folder / "out" / "index.html").read_text()
    assert "<h1>Where to stand: left_right</h1>" in page
    assert f"Look at it: open {folder / 'out' / 'index.html'}" in outcome.out
    assert "<h2>Stance 1: left</h2>" in page
    assert page.count("<svg") == 4  # each on the guardrail, and among the others


def test_scenes_of_an_earlier_search_do_not_stay(both: tuple[Path, Outcome], tmp_path: Path) -> None:
    folder, _ = both
    out = shutil.copytree(folder / "out", tmp_path / "out")
    words = ("--one-foot", "--spacing", "1.5", "--plans", "0", "-o", out, "--force", "--quiet")
    again = run("stand", folder / "left.yaml", *words)
    assert again.status == 0, again.err
    names = {path.name for path in out.iterdir()}
    names -= {name for name in names if re.fullmatch(r"stance_\d+\.yaml", name)}
    assert names == {"stances.csv", "index.html", "best.yaml", "stances.json", "notes.txt"}


@pytest.mark.parametrize("verb", ["stand", "tour"])
def test_a_member_that_there_is_not(both: tuple[Path, Outcome], verb: str) -> None:
    folder, _ = both
    refused = run(verb, folder / "left.yaml", "--on", "top-rail", "-o", folder / "new")
    assert refused.status == 2
    assert refused.err.startswith(
        "error: members (--on): got 'top-rail', expected a member of the guardrail of "
    )
    assert not (folder / "new").exists()


def test_only_on_some_members(both: tuple[Path, Outcome]) -> None:
    folder, _ = both
    words = ("--one-foot", "--spacing", "1.5", "--plans", "0", "--on", "top_rail", "--on", "post_2")
    done = run("stand", folder / "left.yaml", *words, "-o", folder / "some", "--quiet")
    assert done.status == 0, done.err
    rows = csv.DictReader((folder / "some" / "stances.csv").read_text().splitlines())
    assert {row["foot_1_member"] for row in rows} == {"top_rail", "post_2"}


def test_jobs_of_other_bridges_are_refused(both: tuple[Path, Outcome]) -> None:
    folder, _ = both
    other = short_scene(name="other", guardrail={"bays": 6})
    (folder / "other.yaml").write_text(json.dumps(other.as_data()))
    refused = run("stand", folder / "left.yaml", folder / "other.yaml", "-o", folder / "new")
    assert refused.status == 2
    assert "guardrail: got another one, expected the same guardrail in all scenes of a bridge" in refused.err
    assert not (folder / "new").exists()


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc")
@pytest.mark.parametrize(
    ("verb", "words", "search"),
    [
        ("stand", (), "cmbot.stances.stand"),
        ("walk", ("--to", "line"), "cmbot.stances.walking.walk"),
        ("tour", (), "cmbot.stances.walking.tour"),
        ("reproduce", (), "chang2021.reproduce"),
    ],
)
def test_a_place_that_cannot_be_written_to_is_refused_before_the_search(
    verb: str, words: tuple[str, ...], search: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search, Mock(side_effect=pytest.fail.Exception("searched first")))
    scene = () if verb == "reproduce" else ("triangle",)
    refused = run(verb, *scene, *words, "-o", "/proc/x")
    assert refused.status == 2
    assert refused.err.startswith("error: /proc/x: got a place ")
    assert refused.err.endswith(", expected a place that can be written to\n")
