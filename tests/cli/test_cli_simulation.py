"""``cmbot simulate``: what it writes, prints and refuses."""

import csv
import hashlib
import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import Outcome, on_a_terminal, refusal, run, without_colours
from plan_folders import names

import cmbot
from cmbot.archive import save_tracking
from cmbot.common.errors import ArchiveError
from cmbot.planning import Plan
from cmbot.simulation import (
    Tracking,
    base_movement,
    interval_rows,
    tracking_remarks,
    tracking_rows,
    tracking_summary,
    tracking_verdict,
)

TABLES = ("tracking.csv", "tracking_baseline.csv")
FILES = {*TABLES, "tracking.json"}
PAGES = ("replay.html", "report.html")
WRITTEN = (*TABLES, "tracking.json", *PAGES)
COLUMNS = ["t", "error_x", "error_y", "error_z", "static_x", "static_y", "static_z"]
COLUMNS += ["off_path_x", "off_path_y", "off_path_z", "off_path"]
COLUMNS += [f"base{part}_{axis}" for part in ("", "_rotation", "_torque") for axis in "xyz"]


@pytest.fixture(scope="module")
def simulated(saved_short: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """A directory after ``cmbot simulate``, and what that said."""
    folder = Path(shutil.copytree(saved_short, tmp_path_factory.mktemp("simulated") / "plan"))
    return folder, run("simulate", folder)


def rows_of(path: Path) -> tuple[list[str], np.ndarray]:
    with path.open(encoding="ascii", newline="") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float)


def test_it_adds_tables_of_the_errors_and_changes_no_other(
    simulated: tuple[Path, Outcome], saved_short: Path, short_tracking: Tracking
) -> None:
    folder, outcome = simulated
    assert outcome.status == 0, outcome.err
    before = {path.name: path.read_bytes() for path in saved_short.iterdir()}
    after = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert after.keys() - before.keys() == FILES | set(PAGES)
    # The plan's record names the new files, too.
    assert {name for name in before if after[name] != before[name]} == {"plan.json"}
    cmbot.load_plan(folder)
    for name, motion in zip(TABLES, (short_tracking.planned, short_tracking.baseline), strict=True):
        header, table = rows_of(folder / name)
        assert header == COLUMNS
        np.testing.assert_array_equal(table[:, 0], motion.t)
        np.testing.assert_allclose(np.diff(table[:, 0]), 0.005, atol=1e-12)
        np.testing.assert_allclose(table[:, 1:4], motion.error, atol=1e-12)
        off = np.column_stack([motion.path_error, motion.off_path])
        np.testing.assert_allclose(table[:, 4:], np.hstack([motion.static, off, motion.base]), atol=1e-12)


def test_the_figures_are_those_of_the_tables(simulated: tuple[Path, Outcome], saved_short: Path) -> None:
    folder = simulated[0]
    data = json.loads((folder / "tracking.json").read_text(encoding="utf-8"))
    assert data["format"] == "cmbot-tracking/1"
    assert (data["options"]["damping"], data["options"]["initial"]) == (0.01, "equilibrium")
    listed = json.loads((folder / "plan.json").read_text(encoding="utf-8"))["files"]
    for name in (*TABLES, "tracking.json", *PAGES):
        assert listed[name] == hashlib.sha256((folder / name).read_bytes()).hexdigest()
    for name, motion in zip(TABLES, ("planned", "baseline"), strict=True):
        _, table = rows_of(folder / name)
        moving = table[table[:, 0] <= data[motion]["stop"] + 1e-9]
        error = moving[:, 1:4]
        weight = np.ones(len(error))
        weight[[0, -1]] = 0.5
        mean = np.average(error, axis=0, weights=weight)
        figures = data[motion]["total"]
        assert [figures["mean"][axis] for axis in "xyz"] == pytest.approx(mean, abs=1e-12)
        deviation = np.sqrt(np.average((error - mean) ** 2, axis=0, weights=weight))
        assert [figures["standard_deviation"][axis] for axis in "xyz"] == pytest.approx(deviation, abs=1e-12)
        rest = table[table[:, 0] >= data[motion]["stop"] - 1e-9]
        dynamic = rest[:, 1:4] - rest[:, 4:7]
        residual = data[motion]["residual"]
        assert [residual["peak_to_peak"][axis] for axis in "xyz"] == pytest.approx(
            np.ptp(dynamic, axis=0), abs=1e-12
        )
        assert len(data[motion]["modes"]) == 4


def test_it_prints_a_summary_and_with_details_all_figures(
    simulated: tuple[Path, Outcome], short_folder: Path, short_plan: Plan, short_tracking: Tracking
) -> None:
    folder, outcome = simulated
    lines = outcome.out.splitlines()
    rows = list(tracking_summary(short_tracking, compensated=False))
    assert lines[0] == "short, simulated, mm"
    assert lines[1].split() == ["baseline", "planned"]
    assert [line.split() for line in lines[2 : 2 + len(rows)]] == [" ".join(row).split() for row in rows]
    others = list(interval_rows(short_tracking))
    rest = lines[2 + len(rows) :]
    assert rest[0] == "With another stiffness"
    assert [line.split() for line in rest[2 : 2 + len(others)]] == [" ".join(row).split() for row in others]
    assert rest[2 + len(others) :] == [
        tracking_verdict(short_plan, short_tracking),
        base_movement(short_plan, short_tracking),
        f"Written to {', '.join(str(folder / name) for name in WRITTEN)}.",
        f"All figures: {folder / 'report.html'}, under Simulation; --details --force prints them.",
    ]
    assert outcome.err == ""
    lines = run("simulate", short_folder, "--details").out.splitlines()
    lines = lines[lines.index("short, mm", 1) :]
    assert lines[1].split() == ["x", "y", "z", "norm"]
    rows = list(tracking_rows(short_tracking))
    assert [line.split() for line in lines[2 : 2 + len(rows)]] == [" ".join(row).split() for row in rows]
    *told, time, written = lines[2 + len(rows) :]
    assert told == list(tracking_remarks(short_tracking))[:-1]
    assert re.fullmatch(r"Time: \d+\.\d\d s for 12 s of motion\.", time)
    assert written == f"Written to {', '.join(str(short_folder / name) for name in WRITTEN)}."


def test_the_answer_is_what_was_measured(short_tracking: Tracking) -> None:
    rows = {
        name: [float(x) for x in pair] for name, *pair in tracking_summary(short_tracking, compensated=False)
    }
    motions = (short_tracking.baseline, short_tracking.planned)
    norms = {
        part: [1e3 * np.linalg.norm(getattr(m, part)[m.t <= m.stop + 1e-9], axis=1) for m in motions]
        for part in ("static", "dynamic", "path_error")
    }
    swings = []
    for motion in motions:
        moving = motion.dynamic[motion.t >= motion.stop - 1e-9]
        swings.append(1e3 * np.linalg.norm(moving[:, None] - moving[None], axis=2).max())
    assert rows == {
        "tool sags, mean": pytest.approx([x.mean() for x in norms["static"]], abs=1e-3),
        "tool sways beside its sag, at most": pytest.approx([x.max() for x in norms["dynamic"]], abs=1e-3),
        "tool off its path as simulated, at most": pytest.approx(
            [x.max() for x in norms["path_error"]], abs=1e-3
        ),
        "tool swings after the work": pytest.approx(swings, abs=1e-3),
    }
    (first, *_), *_ = tracking_summary(short_tracking, compensated=True)
    assert first == "tool sags beyond what was foreseen, mean"


def test_the_verdict_follows_the_margin(saved_short: Path, short_tracking: Tracking) -> None:
    def verdict(allowed_mm: float, *, compensate: bool = False) -> str:
        options = replace(plan.options, max_tool_deviation_m=1e-3 * allowed_mm, compensate=compensate)
        return tracking_verdict(replace(plan, options=options), short_tracking)

    plan: Plan = cmbot.load_plan(saved_short)
    rows = {name: float(planned) for name, _, planned in tracking_summary(short_tracking, compensated=False)}
    off, sways = (
        rows["tool off its path as simulated, at most"],
        rows["tool sways beside its sag, at most"],
    )
    assert verdict(1.01 * off).startswith("Within the margin: bent as it is, the tool stays within ")
    assert "compensate: true the plan makes up for it." in verdict(0.5 * (off + sways))
    assert "makes up for the sag, not for the swaying." in verdict(0.9 * sways)
    missed = verdict(0.9 * off, compensate=True)
    assert missed.startswith(
        f"Not within the margin: bent as it is, the tool leaves its path by more than {0.9 * off:g}"
    )
    assert "what bends here is not what was planned with. What the plan certifies, " in missed


def test_on_a_terminal_it_draws_a_table(short_folder: Path) -> None:
    text = without_colours(on_a_terminal("simulate", short_folder, "--details", columns=80))
    assert re.search(r"│ tool off its path as simulated, at most +│ +\d+\.\d{3} │", text)
    assert re.search(r"│ error, mean +│ baseline │ +-?\d+\.\d{3} │", text)


def test_options_reach_the_simulation(short_folder: Path) -> None:
    words = ("--damping", "0.02", "--initial", "undeformed", "--stiffness", "0.8", "--segments", "2")
    outcome = run("simulate", short_folder, "--details", *words)
    assert outcome.status == 0, outcome.err
    options = json.loads((short_folder / "tracking.json").read_text(encoding="utf-8"))["options"]
    changed = {"damping": 0.02, "initial": "undeformed", "segments": 2}
    factors = {"guardrail_factor": 0.8, "link_factor": 0.8, "joint_factor": 0.8}
    assert options | changed | factors == options
    assert "Starts undeformed" in outcome.out
    _, table = rows_of(short_folder / "tracking.csv")
    assert np.abs(table[0, 1:4]).max() < 1e-12


@pytest.mark.parametrize("name", sorted(FILES))
def test_it_replaces_nothing_without_force(
    short_folder: Path, short_tracking: Tracking, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(cmbot, "simulate", lambda plan, options, progress: short_tracking)
    (short_folder / name).write_text("mine", encoding="utf-8")
    line = refusal("simulate", short_folder)
    assert line.startswith(f"error: {short_folder}: got {name}, already there")
    assert "--force" in line
    assert (short_folder / name).read_text(encoding="utf-8") == "mine"
    assert not (FILES - {name}) & {path.name for path in short_folder.iterdir()}
    assert run("simulate", short_folder, "--force").status == 0
    assert (short_folder / name).read_text(encoding="utf-8") != "mine"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--damping", "-1"], "cmbot simulate: --damping: got -1.0, expected at least 0"),
        (["--damping", "nan"], "cmbot simulate: "),
        (["--initial", "relaxed"], "cmbot simulate: --initial: got 'relaxed'"),
        (["--stiffness", "0"], "cmbot simulate: --stiffness: got 0.0, expected at least 1e-06"),
        (["--segments", "0"], "cmbot simulate: --segments: got 0, expected at least 1"),
        (["--segments", "two"], "See: cmbot simulate --help"),
        (["--stiffness", "1e-5"], "stiff enough"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(short_folder: Path, words: list[str], message: str) -> None:
    outcome = run("simulate", short_folder, *words)
    assert (outcome.status, outcome.out) == (2, "")
    error = outcome.err.splitlines()[-1]
    assert error.startswith("error: ")
    assert message in error
    assert not FILES & names(short_folder)


def test_options_are_checked_before_the_folder(short_folder: Path, tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "nosuch"):
        assert run("simulate", place).status == 2
    (short_folder / "tracking.json").write_text("mine", encoding="utf-8")
    assert "--stiffness: got 0.0" in run("simulate", short_folder, "--stiffness", "0").err


def test_divergence_is_told_with_its_time(short_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    diverged = cmbot.SimulationDiverged(time=1.5, state=[0.1, math.nan])
    monkeypatch.setattr(cmbot, "simulate", Mock(side_effect=diverged))
    outcome = run("simulate", short_folder)
    assert outcome.status == 1
    assert "diverges at t = 1.5000 s: the largest elastic coordinate is 0.1" in outcome.err
    assert "1 of 2 are not finite" in outcome.err


def test_it_is_saved_from_python_too_and_a_number_that_is_none_is_not(
    short_folder: Path, short_tracking: Tracking
) -> None:
    planned = short_tracking.planned
    for name, column in (("error", "error_y"), ("static", "static_y")):
        array = getattr(planned, name).copy()
        array[7, 1] = np.nan
        broken = replace(short_tracking, planned=replace(planned, **{name: array}))
        with pytest.raises(ArchiveError, match=rf"tracking\.csv: line 9, {column}: got nan"):
            save_tracking(broken, short_folder)
    assert not FILES & names(short_folder)
    paths = cmbot.save_tracking(short_tracking, short_folder)
    assert {path.name for path in paths} == FILES
    with pytest.raises(ArchiveError, match="already there"):
        cmbot.save_tracking(short_tracking, short_folder)
    assert cmbot.save_tracking(short_tracking, short_folder, force=True) == paths


def test_how_joints_are_driven_is_an_option(saved_short: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(saved_short, tmp_path / "plan"))
    refused = run("simulate", folder, "--rate", "125")
    assert refused.status == 2
    assert "--servo: got nothing, expected a number beside --rate" in refused.err
    weak = run("simulate", folder, "--servo", "0")
    assert weak.status == 2
    assert "--servo: got 0.0, expected at least 0.1" in weak.err
    driven = run(
        "simulate", folder, "--rate", "125", "--set-points", "held", "--servo", "8", "--delay", "0.01"
    )
    assert driven.status == 0, driven.err
    assert "tool off by how joints are driven, at most" in driven.out
    options = json.loads((folder / "tracking.json").read_text())["options"]
    assert options["servo_bandwidth_hz"] == [8.0]
