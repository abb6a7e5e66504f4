"""Tracking errors read back: the same as were saved, or the file and key for which they are not."""

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, fields, replace
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


def test_tables_have_how_far_the_tool_is_off_its_path(
    saved: Path, short_tracking: Tracking, strokes_plan: Plan, strokes_tracking: Tracking, tmp_path: Path
) -> None:
    """Against the legs themselves, and nothing between strokes."""
    save(strokes_plan, tmp_path / "strokes")
    save_tracking(strokes_tracking, tmp_path / "strokes")
    for folder, tracking in ((saved, short_tracking), (tmp_path / "strokes", strokes_tracking)):
        table = np.genfromtxt(folder / "tracking.csv", delimiter=",", names=True)
        away = np.column_stack([table[f"off_path_{axis}"] for axis in "xyz"])
        np.testing.assert_allclose(table["off_path"], np.linalg.norm(away, axis=1), atol=1e-12)
        assert np.nanmax(table["off_path"]) == pytest.approx(tracking.planned.largest_off_path, abs=1e-9)
        between = np.isnan(table["off_path"])
        assert between.any() == (tracking is strokes_tracking)
        plan = load_plan(folder)
        for segment in plan.job.strokes:
            begin = segment.begin - plan.job.strokes[0].begin
            own = (table["t"] > begin + 1e-9) & (table["t"] < begin + segment.duration - 1e-9)
            assert not between[own].any()


def test_a_distance_from_the_path_that_the_rest_denies_is_an_error(folder: Path, short_plan: Plan) -> None:
    header, first, *rest = (folder / "tracking.csv").read_text(encoding="ascii").splitlines()
    cells = first.split(",")
    cells[header.split(",").index("off_path")] = "0.0"
    rewrite(folder, "tracking.csv", "\n".join([header, ",".join(cells), *rest, ""]).encode())
    refused(short_plan, folder, "tracking.csv", "line 2, off_path")


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


def test_what_the_plan_does_not_name_is_not_read(
    saved: Path, saved_short: Path, short_plan: Plan, tmp_path: Path
) -> None:
    """Tracking errors that were copied from another plan's directory."""
    other = Path(shutil.copytree(saved_short, tmp_path / "other"))
    for name in (*TABLES, "tracking.json"):
        shutil.copy(saved / name, other)
    assert load_tracking(short_plan, other) is None


def test_a_table_that_the_plan_does_not_name(folder: Path, short_plan: Plan) -> None:
    """The metrics are those of two motions: a table of one is not all."""
    edit(folder, lambda data: data["files"].pop("tracking_baseline.csv"))
    error = refused(short_plan, folder, "tracking.json", "baseline")
    assert error.got == "tracking.csv, tracking.json"


def test_it_is_saved_beside_a_plan_only(short_tracking: Tracking, tmp_path: Path) -> None:
    with pytest.raises(
        ArchiveError, match="got no plan directory, expected a folder that a plan was saved in"
    ):
        save_tracking(short_tracking, tmp_path)
    assert not list(tmp_path.iterdir())


def test_on_a_rigid_base_tables_have_no_column_of_it(
    short_plan: Plan, saved_short: Path, short_tracking: Tracking, tmp_path: Path
) -> None:
    assert short_tracking.baseline is not None and short_tracking.planned.base is not None
    motions = {name: replace(getattr(short_tracking, name), base=None) for name in ("baseline", "planned")}
    folder = Path(shutil.copytree(saved_short, tmp_path / "short"))
    save_tracking(replace(short_tracking, **motions), folder)
    header = (folder / "tracking.csv").read_text(encoding="ascii").partition("\n")[0]
    assert not [name for name in header.split(",") if name.startswith("base")]
    read = load_tracking(short_plan, folder)
    assert read is not None and read.planned.base is None and read.planned.largest_base_displacement == 0.0
    np.testing.assert_allclose(read.planned.error, short_tracking.planned.error, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda data: data.update(format="cmbot-tracking/2"), "format"),
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
    data = json.loads((folder / "tracking.json").read_bytes())
    change(data)
    rewrite(folder, "tracking.json", json.dumps(data).encode())
    refused(short_plan, folder, "tracking.json", key)


@pytest.mark.parametrize(
    "table", ["t,error_x,error_y,error_z,static_x,static_y,static_z\n0,0,0,0,0,0,0\n", "t\n0\n", "é"]
)
def test_a_strange_table_is_an_error(folder: Path, short_plan: Plan, table: str) -> None:
    rewrite(folder, "tracking.csv", table.encode())
    with pytest.raises(ArchiveError) as caught:
        load_tracking(short_plan, folder)
    assert caught.value.source == str(folder / "tracking.csv")
