"""``cmbot stand``: what it writes, prints and refuses."""

import csv
import json
from pathlib import Path

import pytest
from command_line import Outcome, run
from small_scenes import short_scene

import cmbot

FILES = {"stances.csv", "best.yaml", "index.html"}


@pytest.fixture(scope="module")
def stood(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """A folder after ``cmbot stand`` of few places and no plan, and what that said."""
    folder = tmp_path_factory.mktemp("stood")
    (folder / "short.yaml").write_text(json.dumps(short_scene().file.as_data()))
    words = ("--one-foot", "--spacing", "1.5", "--plans", "0", "--objective", "hold")
    return folder, run("stand", folder / "short.yaml", *words, "-o", folder / "out")


def test_it_writes_the_table_the_page_and_the_scene(stood: tuple[Path, Outcome]) -> None:
    folder, outcome = stood
    assert outcome.status == 0, outcome.err
    assert {path.name for path in (folder / "out").iterdir()} == FILES
    rows = [*csv.DictReader((folder / "out" / "stances.csv").read_text().splitlines())]
    assert f"{len(rows)} stances: " in outcome.out
    best = cmbot.load_scene(folder / "out" / "best.yaml")
    assert best.planner.objective == "hold"
    assert best.robot.stance.foot == pytest.approx([float(rows[0][axis]) for axis in "xyz"], abs=1e-4)


def test_it_replaces_nothing_unasked(stood: tuple[Path, Outcome]) -> None:
    folder, _ = stood
    again = run("stand", folder / "short.yaml", "-o", folder / "out")
    assert again.status == 2
    assert "expected a folder without these files, or --force" in again.err


def test_an_objective_that_cannot_be_screened(stood: tuple[Path, Outcome]) -> None:
    folder, _ = stood
    refused = run("stand", folder / "short.yaml", "--objective", "sag")
    assert refused.status == 2
    assert "--objective: got sag, expected a known value (one of: torque, hold)" in refused.err
