"""Campaigns from the file to the table: what is planned, kept, planned again, and shown."""

import importlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from command_line import run
from page_data import data_of
from ruamel.yaml import YAML
from small_scenes import SHORT

import cmbot
from cmbot.campaigns import OVERVIEW, RESULTS, CampaignProgress, Task, TaskResult, TaskStatus
from cmbot.campaigns.overview import overview_page
from cmbot.campaigns.planned import plan_scene
from cmbot.campaigns.results import given_cells, parquet, result_row
from cmbot.common.errors import ArchiveError, InputError, ModelError

TEXT = """format: cmbot-campaign/1
name: span
scene: short.yaml
jobs:
  - {name: first, at_m: 1.0}
  - {name: heavy, at_m: 2.0, set: {robot.payload_kg: 2.0}}
  - {name: far, at_m: 3.0, set: {"tool_path.legs[0].by": [0, -9, 0]}}
"""
pyarrow = pytest.importorskip("pyarrow.parquet")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    with (tmp_path / "short.yaml").open("w", encoding="utf-8") as stream:
        YAML().dump(deepcopy(SHORT), stream)
    (tmp_path / "span.yaml").write_text(TEXT, encoding="utf-8")
    return tmp_path / "span.yaml"


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of what was run; tasks run here, without dask."""
    names = list[str]()

    def here(tasks: Sequence[Task], *_: object) -> Iterator[TaskResult]:
        for task in tasks:
            names.append(task.name)
            value = plan_scene(**task.arguments, **task.unkeyed)
            # As it comes from another process.
            value = json.loads(json.dumps(value, allow_nan=False))
            yield TaskResult(name=task.name, key=task.key, status=TaskStatus.DONE, value=value)

    monkeypatch.setattr("cmbot.campaigns.runner._run", here)
    return names


def table(folder: Path) -> dict[str, dict[str, Any]]:
    rows = pyarrow.read_table(folder / RESULTS).to_pylist()
    return {row["name"]: row for row in rows}


def test_what_shakes_a_job_is_in_the_table(file: Path, ran: list[str]) -> None:
    rows = (
        {"name": "still"},
        {"name": "windy", "set": {"excitation": {"wind": {"mean_m_s": 10, "gusts_m_s": 2}}}},
    )
    with file.open("w", encoding="utf-8") as stream:
        campaign = {"format": "cmbot-campaign/1", "scene": "short.yaml", "jobs": list(rows)}
        YAML().dump(campaign, stream)
    folder = file.parent / "out"
    cmbot.campaign(file, folder)
    still, windy = (table(folder)[row["name"]] for row in rows)
    assert still["excitation.rms_mm"] is None
    excitation = cmbot.load_excitation(folder / windy["plan"])
    assert excitation is not None
    assert excitation.accuracy is not None
    assert windy["excitation.rms_mm"] == pytest.approx(excitation.rms_mm)
    assert windy["excitation.within_mm"] == pytest.approx(excitation.accuracy.within_mm)


def test_a_campaign_plans_and_goes_on(file: Path, ran: list[str]) -> None:
    seen = list[CampaignProgress]()
    folder = file.parent / "out"
    done = cmbot.campaign(file, folder, progress=seen.append)
    assert (done.name, dict(done.ends)) == ("span", {"planned": 2, "no plan": 1})
    assert [(each.done, each.total) for each in seen] == [(1, 3), (2, 3), (3, 3)]
    rows = table(folder)
    assert rows["far"]["ended"] == "no plan"
    assert "out of reach" in rows["far"]["reason"]
    assert rows["heavy"]["set.robot.payload_kg"] == 2.0
    # The table has the figures of the plan directory, which is one like any other.
    plan = cmbot.load_plan(folder / rows["heavy"]["plan"], verify=True)
    assert rows["heavy"]["planned_job.peak_guardrail_torque"] == plan.job.figures.peak_guardrail_torque
    assert rows["heavy"]["baseline_work.limit_use.torque"] == plan.baseline.figures.limit_use.torque
    assert plan.robot.payload == 2.0
    # Nothing is planned again.
    again = cmbot.campaign(file, folder, progress=seen.append)
    assert ran == ["first", "heavy", "far"]
    assert [dict(row) for row in again.rows] == [dict(row) for row in done.rows]
    assert (seen[-1].done, seen[-1].resumed) == (3, 3)
    # But what has changed, what is gone, and on demand what failed.
    del ran[:]
    motion = (folder / rows["first"]["plan"] / "job.csv").read_bytes()
    shutil.rmtree(folder / rows["first"]["plan"])
    cmbot.campaign(file, folder)
    assert ran == ["first"]
    # It does not matter what a process has planned before.
    assert (folder / rows["first"]["plan"] / "job.csv").read_bytes() == motion
    file.write_text(TEXT.replace("2.0}}", "2.5}}"), encoding="utf-8")
    cmbot.campaign(file, folder)
    assert ran == ["first", "heavy"]
    assert table(folder)["heavy"]["set.robot.payload_kg"] == 2.5
    cmbot.campaign(file, folder, again=True)
    assert ran == ["first", "heavy", "far"]
    # Pages are added where they are missing, and stay.
    del ran[:]
    cmbot.campaign(file, folder, pages=True)
    assert ran == ["first", "heavy"]
    kept = cmbot.campaign(file, folder).kept
    assert (ran, kept) == (["first", "heavy"], {"planned": 2, "no plan": 1})
    for row in list(table(folder).values())[:2]:
        assert (folder / row["plan"] / "report.html").is_file()


def test_what_has_ended_is_in_the_table_of_an_interrupted_campaign(file: Path, ran: list[str]) -> None:
    folder = file.parent / "out"

    def stop(progress: CampaignProgress) -> None:
        if progress.done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cmbot.campaign(file, folder, progress=stop)
    assert list(table(folder)) == ["first", "heavy"]
    assert len(data_of((folder / OVERVIEW).read_text(encoding="utf-8"))["name"]) == 2
    assert [row["name"] for row in cmbot.campaign(file, folder).rows] == ["first", "heavy", "far"]
    assert ran == ["first", "heavy", "far"]
    with pytest.raises(KeyboardInterrupt):
        cmbot.campaign(file, folder, progress=stop)
    assert list(table(folder)) == ["first", "heavy", "far"]


def test_a_folder_holds_one_campaign(file: Path, ran: list[str]) -> None:
    folder = file.parent / "out"
    text = TEXT[: TEXT.index("jobs:")] + "jobs: [{name: far, set: {'tool_path.legs[0].by': [0, -9, 0]}}]\n"
    file.write_text(text, encoding="utf-8")
    cmbot.campaign(file, folder)
    written = (folder / RESULTS).read_bytes()
    file.write_text(text.replace("name: span", "name: other"), encoding="utf-8")
    with pytest.raises(
        ArchiveError, match=r"campaign.json: name: got 'span', expected 'other', whose results"
    ):
        cmbot.campaign(file, folder)
    (folder / "campaign.json").write_text("[]", encoding="utf-8")
    with pytest.raises(ArchiveError, match=r"campaign.json: name: got None, expected 'other'"):
        cmbot.campaign(file, folder)
    assert (folder / RESULTS).read_bytes() == written
    assert ran == ["far"]


def test_arguments_that_are_wrong_are_named(file: Path) -> None:
    for name, value in (("workers", "two"), ("workers", 0), ("scheduler", 5), ("scheduler", "nonsense")):
        with pytest.raises(InputError, match=f"{name}: got {value!r}, expected"):
            cmbot.campaign(file, file.parent / "out", **{name: value})


def test_the_command_line_says_what_failed(file: Path, ran: list[str]) -> None:
    folder = file.parent / "out"
    outcome = run("campaign", file, "-o", folder)
    assert outcome.status == 3
    assert "span: 3 jobs in " in outcome.out
    assert ": 2 planned, 1 no plan." in outcome.out
    assert "far: no plan: no path" in outcome.out
    assert (folder / OVERVIEW).is_file()
    outcome = run("campaign", file, "-o", folder, "--json")
    told = json.loads(outcome.out)
    assert told["ends"] == told["kept"] == {"planned": 2, "no plan": 1}
    assert [(each["name"], each["ended"]) for each in told["failed"]] == [("far", "no plan")]
    assert told["files"] == [str(folder / RESULTS), str(folder / OVERVIEW)]
    assert len(ran) == 3
    outcome = run("campaign", file, "-o", folder)
    assert " s, 3 of them before: 2 planned, 1 no plan." in outcome.out
    assert "1 of these ended so before; --again plans them again." in outcome.out
    (file.parent / "taken").mkdir()
    (file.parent / "taken" / "thesis.txt").touch()
    outcome = run("campaign", file, "-o", file.parent / "taken")
    assert (outcome.status, len(ran)) == (2, 3)
    assert "got a folder with other files in it, expected a new folder" in outcome.err
    assert run("campaign", file, "--workers", "0").status == 2


def test_a_robot_that_is_none_stops_it_before_anything_is_planned(file: Path, ran: list[str]) -> None:
    (file.parent / "arm.urdf").write_text("<robot name='arm'/>", encoding="utf-8")
    text = TEXT.replace("payload_kg: 2.0", "model: arm.urdf")
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match=r"arm\.urdf"):
        cmbot.campaign(file, file.parent / "out")
    assert not ran
    assert not (file.parent / "out").exists()


def test_results_of_every_kind_fit_into_a_row() -> None:
    ends = {
        "crashed": TaskResult(name="a", key="", status=TaskStatus.CRASHED, error="signal SIGSEGV"),
        "timed out": TaskResult(name="a", key="", status=TaskStatus.TIMED_OUT, error="killed after 3 s"),
        "out of memory": TaskResult(name="a", key="", status=TaskStatus.RAISED, error="MemoryError: x"),
        "failed": TaskResult(name="a", key="", status=TaskStatus.RAISED, error="KeyError: x"),
        "refused": TaskResult(
            name="a", key="", status=TaskStatus.DONE, value={"ended": "refused", "reason": "why"}
        ),
    }
    entry: Any = type("", (), {"name": "a", "at_m": None, "values": {"x": [1, 2], "y": 1}})
    rows = [result_row(given_cells(entry), result, "plans/aa/a") for result in ends.values()]
    assert [row["ended"] for row in rows] == list(ends)
    assert all(row["reason"] and row["plan"] is None for row in rows)
    assert rows[0]["set.x"] == "[1, 2]"
    assert [row["reason"] for row in rows[1:3]] == [
        "killed after 3 s (time_limit_s)",
        "MemoryError: x (memory_limit_mb)",
    ]
    # Columns of text and numbers become text; those of whole and other numbers, numbers.
    kinds = [{"a": 1, "b": 1}, {"a": 1.5, "b": "x"}, {"c": None}]
    read = pyarrow.read_table(io.BytesIO(parquet(kinds))).to_pylist()
    assert read == [
        {"a": 1.0, "b": "1", "c": None},
        {"a": 1.5, "b": "x", "c": None},
        {"a": None, "b": None, "c": None},
    ]


def test_the_overview_of_ten_thousand_jobs_is_small_and_safe(tmp_path: Path) -> None:
    row = {"at_m": 1.23456789, "ended": "planned", "reason": "", "plan": "plans/aa/x", "seconds": 1.0}
    figures = {f"{which}.peak_guardrail_torque": 400.123456789 for which in ("baseline_job", "planned_job")}
    bad = {
        "name": "<b>",
        "at_m": None,
        "ended": "no plan",
        "reason": "</script>" * 100,
        "plan": None,
        "seconds": 1,
    }
    rows = [{"name": f"bay_{k}_bracket", **row, **figures} for k in range(10_000)]
    page = overview_page("<i>span</i>", [*rows, bad], tmp_path)
    assert len(page) < 2_500_000
    assert "<i>span" not in page
    assert page.count("</script>") == 2
    columns = data_of(page)
    assert {len(column) for column in columns.values()} == {10_001}
    assert columns["baseline"][0] == 400.123
    assert (columns["plan"][0], columns["report"][0]) == ("plans/aa/x", None)
    assert len(columns["reason"][-1]) == 600


def test_processes_plan_as_one_does_and_ctrl_c_ends_them(file: Path, tmp_path: Path) -> None:
    """Starting dask takes seconds, so once for all."""
    psutil = importlib.import_module("psutil")
    out = tmp_path / "out"
    command = [sys.executable, "-m", "cmbot", "campaign", str(file), "-o", str(out), "--workers", "2"]
    # Many times as long as it takes to see that the first is planned, on any machine.
    slow = "".join(f"  - {{name: slow_{number}, scene: triangle}}\n" for number in range(12))
    file.write_text(TEXT + slow, encoding="utf-8")
    process = subprocess.Popen(command, stdout=-1, stderr=-1, text=True, start_new_session=True)
    planned = out / "jobs" / "first.json"
    while process.poll() is None and not planned.exists():
        time.sleep(0.05)
    assert process.poll() is None, process.communicate()
    started = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, signal.SIGINT)
    printed, errors = process.communicate(timeout=60)
    assert (process.returncode, printed) == (130, "")
    assert errors.splitlines()[-1] == "stopped; the same command goes on from here"
    assert "Traceback" not in errors
    _, alive = psutil.wait_procs(started, timeout=60)
    # Where nobody asks for the status of orphans, as in some containers, they stay as zombies.
    assert all(each.status() == psutil.STATUS_ZOMBIE for each in alive)
    # What was finished is there, whole, also in the table, and is what this process plans.
    assert "first" in table(out)
    result = json.loads(planned.read_text(encoding="utf-8"))["value"]
    scene = cmbot.load_scene({**deepcopy(SHORT), "name": "first"})
    here = cmbot.plan(scene)
    assert result["planned_job"]["peak_guardrail_torque"] == here.job.figures.peak_guardrail_torque
    (place,) = (out / "plans").glob("*/first")
    cmbot.save(here, tmp_path / "here")
    for name in ("job.csv", "job.npz"):
        assert (place / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
