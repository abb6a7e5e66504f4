"""Tracking errors read back: the same as were saved, or the file and key for which they are not."""

import re
import shutil
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import plan_folders
import pytest
from plan_folders import edit, rewrite

import cmbot
from cmbot.archive import load_plan, load_tracking, save, save_tracking
from cmbot.common.errors import ArchiveError
from cmbot.planning import Plan
from cmbot.simulation import Tracking, tracking_rows


@pytest.fixture(scope="module")
def saved(saved_short: Path, short_tracking: Tracking, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = Path(shutil.copytree(saved_short, tmp_path_factory.mktemp("tracking") / "short"))
    save_tracking(short_tracking, folder)
    return folder


@pytest.fixture
def folder(saved: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(saved, tmp_path / "short"))


def test_what_was_saved_is_read(
    saved: Path, short_tracking: Tracking, compensated_short: tuple[Plan, Tracking], tmp_path: Path
) -> None:
    """Also with the expected tool of a compensated plan."""
    compensated, foreseen = compensated_short
    save(compensated, tmp_path / "short")
    save_tracking(foreseen, tmp_path / "short")
    for folder, tracking in ((saved, short_tracking), (tmp_path / "short", foreseen)):
        require_read(folder, tracking)


def test_of_several_strokes_too(strokes_plan: Plan, strokes_tracking: Tracking, tmp_path: Path) -> None:
    save(strokes_plan, tmp_path / "strokes")
    save_tracking(strokes_tracking, tmp_path / "strokes")
    require_read(tmp_path / "strokes", strokes_tracking)


def require_read(folder: Path, tracking: Tracking) -> None:
    found = cmbot.load_tracking(load_plan(folder), folder)
    assert (found.options, found.seconds) == (tracking.options, tracking.seconds)
    assert found.interval == tracking.interval
    assert list(tracking_rows(found)) == list(tracking_rows(tracking))
    for name in ("baseline", "planned"):
        ours, theirs = getattr(found, name), getattr(tracking, name)
        assert ours.stop == pytest.approx(theirs.stop, rel=1e-14)
        for field in fields(ours):
            if field.name not in ("stop", "metrics", "execution"):
                left, right = getattr(ours, field.name), getattr(theirs, field.name)
                np.testing.assert_allclose(left, right, atol=1e-12)
        for key, value in asdict(ours.metrics).items():
            if isinstance(value, np.ndarray):
                expected = getattr(theirs.metrics, key)
                np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-18)


def refused(plan: Plan, folder: Path, file: str, key: str) -> ArchiveError:
    return plan_folders.refused(folder, file, key, lambda directory: load_tracking(plan, directory))


TABLES = ("tracking.csv", "tracking_baseline.csv")


def test_tables_without_the_base_are_read_too(folder: Path, short_plan: Plan) -> None:
    for name in TABLES:
        lines = (folder / name).read_text("ascii").splitlines()
        rewrite(
            folder,
            name,
            "\n".join(line.rsplit(",", 6)[0] for line in lines).encode(),
            listed_in="tracking.json",
        )
    read = load_tracking(short_plan, folder)
    assert read is not None
    assert read.planned.base is None
    assert read.planned.largest_off_path > 0


@pytest.mark.parametrize("name", [*TABLES, "tracking.json"])
def test_a_missing_file_is_an_error(folder: Path, short_plan: Plan, name: str) -> None:
    (folder / name).unlink()
    assert "no such file" in str(refused(short_plan, folder, name, ""))
    for other in {*TABLES, "tracking.json"} - {name}:
        (folder / other).unlink()
    assert load_tracking(short_plan, folder) is None


@pytest.mark.parametrize("name", [*TABLES, "plan.json"])
def test_a_changed_file_is_an_error(folder: Path, short_plan: Plan, name: str) -> None:
    with (folder / name).open("a", encoding="utf-8") as file:
        file.write("\n")
    said = str(refused(short_plan, folder, "tracking.json", f"files.{name}"))
    assert re.search(r", expected [0-9a-f]{16}…: \S+ has changed since the simulation; simulate again$", said)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda data: data.update(format="cmbot-tracking/2"), "format"),
        (lambda data: data.pop("files"), "files"),
        (lambda data: data.pop("options"), "options"),
        (lambda data: data["options"].update(damping=2.0), "options.damping"),
        (lambda data: data.update(seconds="long"), "seconds"),
        (lambda data: data.update(planned=[]), "planned"),
        (lambda data: data["planned"].update(modes={}), "planned.modes"),
        (lambda data: data["interval"][0].update(stiffness=0.0), "interval[0].stiffness"),
        (lambda data: data["interval"][1].update(off_path=[1e-3, -1e-3]), "interval[1].off_path[1]"),
        (lambda data: data["baseline"]["modes"][0].pop("frequency"), "baseline.modes[0].frequency"),
        (lambda data: data["baseline"]["modes"][1].update(frequency=True), "baseline.modes[1].frequency"),
    ],
)
def test_a_strange_entry_is_an_error(
    folder: Path, short_plan: Plan, change: Callable[[dict[str, Any]], object], key: str
) -> None:
    edit(folder, change, "tracking.json")
    refused(short_plan, folder, "tracking.json", key)


@pytest.mark.parametrize(
    "table", ["t,error_x,error_y,error_z,static_x,static_y,static_z\n0,0,0,0,0,0,0\n", "t\n0\n", "é"]
)
def test_a_strange_table_is_an_error(folder: Path, short_plan: Plan, table: str) -> None:
    rewrite(folder, "tracking.csv", table.encode(), listed_in="tracking.json")
    with pytest.raises(ArchiveError) as caught:
        load_tracking(short_plan, folder)
    assert caught.value.source == str(folder / "tracking.csv")
