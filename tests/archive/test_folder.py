"""Plan directories appear whole or not at all, and replace nothing but plans."""

import os
import shutil
from pathlib import Path

import pytest

from cmbot.archive import add_file, require_free
from cmbot.archive.folder import APPROACH_FILES, SAVED_FILES, write_folder
from cmbot.common.errors import ArchiveError

CONTENTS = {"plan.json": b'{"format": "cmbot-plan/1"}', "a.csv": b"1,2\n", "b.npz": b"\0"}
FILES = set(CONTENTS)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A plan directory with a file that was added to it."""
    write_folder(CONTENTS, tmp_path / "plan", force=False)
    (tmp_path / "plan" / "old").touch()
    return tmp_path / "plan"


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def failing(function, at, error):
    """Stand-in for `function` whose call number `at` fails."""
    calls = []

    def stand_in(*args):
        calls.append(args)
        if len(calls) == at:
            raise error
        return function(*args)

    return stand_in


def test_folders_above_are_made(tmp_path):
    write_folder(CONTENTS, tmp_path / "a" / "b", force=False)
    assert {path.name: path.read_bytes() for path in (tmp_path / "a" / "b").iterdir()} == CONTENTS
    assert names(tmp_path / "a") == {"b"}


@pytest.mark.parametrize("call", range(1, 6))  # three files, the folder, the folder above
@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_nothing_behind(tmp_path, monkeypatch, call, force, error):
    target = tmp_path / "above" / "plan"
    if force:
        write_folder(CONTENTS, target, force=False)
        (target / "old").touch()
    monkeypatch.setattr(os, "fsync", failing(os.fsync, call, error))
    expected = ArchiveError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected):
        write_folder(CONTENTS, target, force=force)
    if call == 5:  # by then the plan is in place, and whole
        assert names(target) == FILES
        assert names(target.parent) == {"plan"}
    elif force:
        assert names(target) == FILES | {"old"}
        assert names(target.parent) == {"plan"}
    else:
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("call", [1, 2])
@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), KeyboardInterrupt()])
def test_a_failed_swap_keeps_the_old_plan(folder, monkeypatch, call, error):
    monkeypatch.setattr(Path, "rename", failing(Path.rename, call, error))
    with pytest.raises((ArchiveError, KeyboardInterrupt)):
        write_folder(CONTENTS, folder, force=True)
    assert names(folder) == FILES | {"old"}
    assert names(folder.parent) == {"plan"}


def test_an_old_plan_that_cannot_be_deleted_is_named(folder, monkeypatch):
    def refuse(path, ignore_errors=False):
        if not ignore_errors:
            raise OSError(13, "Permission denied")

    monkeypatch.setattr(shutil, "rmtree", refuse)
    with pytest.raises(ArchiveError, match="the new plan is in place") as caught:
        write_folder(CONTENTS, folder, force=True)
    assert names(folder) == FILES
    assert names(Path(caught.value.source)) == FILES | {"old"}


def test_a_place_that_cannot_be_written_to(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ArchiveError, match="a place that can be written to"):
        write_folder(CONTENTS, tmp_path / "file" / "plan", force=False)
    with pytest.raises(ArchiveError, match="the path of a folder"):
        write_folder(CONTENTS, tmp_path / "pl\0an", force=False)
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    with pytest.raises(ArchiveError):
        write_folder(CONTENTS, tmp_path / "circle" / "plan", force=False)
    assert names(tmp_path) == {"file", "circle"}


# What is in the way


def test_an_existing_folder_is_refused(folder):
    (folder.parent / "empty").mkdir()
    for directory in (folder, folder.parent / "empty"):
        for ask in (write_folder_without_force, require_free):
            with pytest.raises(ArchiveError, match=r"already there.*--force \(in Python force=True\)"):
                ask(directory)
    assert names(folder) == FILES | {"old"}


def write_folder_without_force(directory):
    write_folder(CONTENTS, directory, force=False)


def test_what_is_free(folder):
    require_free(folder.parent / "new")
    require_free(str(folder.parent / "new" / "below"), force=True)
    require_free(folder, force=True)


def test_where_nothing_can_be_made_is_said_before_the_work(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for below in ("plan.json/new", "plan.json/new/below"):
        with pytest.raises(ArchiveError, match=r"got a place below .*plan\.json, which is a file"):
            require_free(folder / below)
    looked: list[Path] = []

    def locked(place: Path, _: int) -> bool:
        looked.append(Path(place))
        return False

    monkeypatch.setattr(os, "access", locked)
    for directory, force in ((folder.parent / "new" / "below", False), (folder, True)):
        with pytest.raises(ArchiveError, match="which must not be written to, expected a place that can be"):
            require_free(directory, force=force)
    assert looked == [folder.parent, folder.parent]


def test_force_replaces_a_plan_and_what_was_added_to_it(folder):
    write_folder(CONTENTS, folder, force=True)
    assert names(folder) == FILES
    assert names(folder.parent) == {"plan"}


def test_force_replaces_a_plan_of_another_version(folder):
    (folder / "plan.json").write_text('{"format": "cmbot-plan/2"}')
    write_folder(CONTENTS, folder, force=True)
    assert names(folder) == FILES


def test_force_fills_a_new_and_an_empty_folder(tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new"):
        write_folder(CONTENTS, tmp_path / name, force=True)
        assert names(tmp_path / name) == FILES
    assert names(tmp_path) == {"empty", "new"}


def test_force_replaces_what_a_link_leads_to(folder):
    link = folder.parent / "link"
    link.symlink_to(folder)
    write_folder(CONTENTS, link, force=True)
    assert link.is_symlink()
    assert names(folder) == FILES


@pytest.mark.parametrize("plan_json", [None, "{}", '{"format": "another-plan/1"}', "[1]", '{"format": '])
def test_force_never_destroys_another_folder(tmp_path, plan_json):
    (tmp_path / "thesis.tex").write_text("years of work")
    if plan_json is not None:
        (tmp_path / "plan.json").write_text(plan_json)
    before = names(tmp_path)
    with pytest.raises(ArchiveError, match="something other than a plan"):
        write_folder(CONTENTS, tmp_path, force=True)
    with pytest.raises(ArchiveError, match="something other than a plan"):
        require_free(tmp_path, force=True)
    assert names(tmp_path) == before


def test_force_never_replaces_a_file(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ArchiveError, match="a file of that name"):
        write_folder(CONTENTS, tmp_path / "file", force=True)
    assert (tmp_path / "file").read_text() == "mine"


# Adding files


def test_files_are_added_and_replaced(folder):
    assert add_file(folder, "replay.html", "<p>ü</p>") == folder / "replay.html"
    assert (folder / "replay.html").read_bytes() == "<p>ü</p>".encode()
    add_file(str(folder), "replay.html", b"\x00")
    assert (folder / "replay.html").read_bytes() == b"\x00"
    assert names(folder) == FILES | {"old", "replay.html"}


@pytest.mark.parametrize("name", ["", ".", "..", "../x", "a/b", "/x", ".hidden", "a\0", "a\n", "x" * 300])
def test_names_that_lead_elsewhere_are_refused(folder, name):
    with pytest.raises(ArchiveError, match="add_file: name"):
        add_file(folder, name, "")
    assert names(folder) == FILES | {"old"}


@pytest.mark.parametrize("name", ["plan.json", *SAVED_FILES, *APPROACH_FILES])
def test_the_plan_itself_is_not_replaced(folder, name):
    with pytest.raises(ArchiveError, match="the plan's own files"):
        add_file(folder, name, "")
    assert (folder / "plan.json").read_bytes() == CONTENTS["plan.json"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failed_addition_leaves_the_earlier_file(folder, monkeypatch, error):
    add_file(folder, "report.html", "first")
    monkeypatch.setattr(os, "fsync", failing(os.fsync, 1, error))
    with pytest.raises((ArchiveError, KeyboardInterrupt)):
        add_file(folder, "report.html", "second")
    assert (folder / "report.html").read_text() == "first"
    assert names(folder) == FILES | {"old", "report.html"}


def test_a_folder_is_not_replaced_by_a_file(folder):
    (folder / "report.html").mkdir()
    with pytest.raises(ArchiveError):
        add_file(folder, "report.html", "")
    assert names(folder) == FILES | {"old", "report.html"}


def test_text_that_is_none_is_not_added(folder):
    with pytest.raises(ArchiveError, match="add_file: content"):
        add_file(folder, "report.html", "\ud800")


def test_files_are_added_to_plan_directories_only(tmp_path):
    for directory in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(ArchiveError, match="no plan directory"):
            add_file(directory, "report.html", "")
    assert not list(tmp_path.iterdir())
