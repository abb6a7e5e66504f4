"""Plan directories appear whole or not at all, and replace nothing but plans."""

import os
from functools import partial
from itertools import count, product
from pathlib import Path
from unittest.mock import Mock

import pytest
from plan_folders import names

from cmbot.archive import add_file, atomic, require_free, write_files
from cmbot.archive.folder import add_files, write_folder
from cmbot.archive.names import EARLIER_FILES, JOB_FILES, SAVED_FILES
from cmbot.common.errors import ArchiveError

CONTENTS = {"plan.json": b'{"format": "cmbot-plan/1"}', "trajectory.csv": b"1,2\n", "trajectory.npz": b"\0"}
CHANGED = CONTENTS | {"trajectory.csv": b"3,4\n"}
FILES = set(CONTENTS)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A plan directory with a file that is not the plan's."""
    write_folder(CONTENTS, tmp_path / "plan", force=False)
    (tmp_path / "plan" / "old").touch()
    return tmp_path / "plan"


ALWAYS = 0


def failing(function, at, error):
    """Stand-in for `function` whose call number `at` fails."""
    calls = count(1)

    def stand_in(*args):
        if next(calls) == at or at == ALWAYS:
            raise error
        return function(*args)

    return stand_in


# Three files, the folder, the folder above; with force again the folder and the one above.
@pytest.mark.parametrize("call", range(1, 8))
@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_nothing_behind(tmp_path, monkeypatch, call, force, error):
    target = tmp_path / "above" / "plan"
    if force:
        write_folder(CONTENTS, target, force=False)
        (target / "old").touch()
    monkeypatch.setattr(os, "fsync", failing(os.fsync, call, error))
    if force or call <= 5:
        with pytest.raises(ArchiveError if isinstance(error, OSError) else KeyboardInterrupt):
            write_folder(CHANGED, target, force=force)
    if call < 5 and not force:
        assert not list(tmp_path.iterdir())
        return
    if force:
        assert names(target) == FILES | {"old"}
        expected = CONTENTS if call < 5 else CHANGED
        assert (target / "trajectory.csv").read_bytes() == expected["trajectory.csv"]
        assert names(target.parent) == {"plan"}


@pytest.mark.parametrize("call", range(1, 7))  # three for each of two swaps
@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), KeyboardInterrupt()])
def test_a_failed_rename_leaves_a_whole_plan(folder, monkeypatch, call, error):
    monkeypatch.setattr(atomic, "_swap_at_once", lambda one, other: False)
    monkeypatch.setattr(Path, "rename", failing(Path.rename, call, error))
    with pytest.raises((ArchiveError, KeyboardInterrupt)):
        write_folder(CHANGED, folder, force=True)
    assert names(folder) == FILES | {"old"}
    expected = CONTENTS if call < 3 else CHANGED
    assert (folder / "trajectory.csv").read_bytes() == expected["trajectory.csv"]
    assert names(folder.parent) == {"plan"}


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


def test_an_existing_folder_is_refused(folder):
    (folder.parent / "empty").mkdir()
    write = partial(write_folder, CONTENTS, force=False)
    for directory, ask in product((folder, folder.parent / "empty"), (write, require_free)):
        with pytest.raises(ArchiveError, match=r"already there.*--force \(in Python force=True\)"):
            ask(directory)
    assert names(folder) == FILES | {"old"}


def test_what_is_free_and_where_nothing_can_be_made_is_said_before_the_work(folder, monkeypatch):
    require_free(folder.parent / "new")
    require_free(str(folder.parent / "new" / "below"), force=True)
    require_free(folder, force=True)
    for below in ("plan.json/new", "plan.json/new/below"):
        with pytest.raises(ArchiveError, match=r"got a place below .*plan\.json, which is a file"):
            require_free(folder / below)
    access = Mock(return_value=False)
    monkeypatch.setattr(os, "access", access)
    for directory, force in ((folder.parent / "new" / "below", False), (folder, True)):
        with pytest.raises(ArchiveError, match="where this user may not write, expected a place that can be"):
            require_free(directory, force=force)
    assert [Path(place) for (place, _), _ in access.call_args_list] == [folder.parent, folder.parent]


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("place", ["plan", "link"])
def test_force_replaces_a_plan_of_any_version_and_its_pages_alone(folder, version, place):
    (folder.parent / "link").symlink_to(folder)
    (folder / "plan.json").write_text(f'{{"format": "cmbot-plan/{version}"}}')
    add_files(folder, {"tracking.csv": b"", "report.html": b""})
    (folder / "photos").mkdir()
    (folder / "photos" / "report.html").touch()
    before = folder.stat()
    write_folder(CONTENTS, folder.parent / place, force=True)
    assert names(folder) == FILES | {"old", "photos"}
    assert names(folder / "photos") == {"report.html"}
    # A shell that stands in it stays there.
    assert os.path.samestat(folder.stat(), before)
    assert names(folder.parent) == {"plan", "link"}
    assert (folder.parent / "link").is_symlink()


def test_a_new_and_with_force_an_empty_folder_are_filled(tmp_path):
    (tmp_path / "empty").mkdir()
    for name, force in (("empty", True), ("new", True), ("above/below", False)):
        write_folder(CONTENTS, tmp_path / name, force=force)
        assert {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} == CONTENTS
    assert (names(tmp_path), names(tmp_path / "above")) == ({"empty", "new", "above"}, {"below"})


@pytest.mark.parametrize("plan_json", [None, "{}", '{"format": "another-plan/1"}', "[1]", '{"format": '])
@pytest.mark.parametrize("ask", [partial(write_folder, CONTENTS), require_free])
def test_force_never_destroys_another_folder(tmp_path, plan_json, ask):
    (tmp_path / "thesis.tex").write_text("years of work")
    if plan_json is not None:
        (tmp_path / "plan.json").write_text(plan_json)
    before = names(tmp_path)
    with pytest.raises(ArchiveError, match="something other than a plan"):
        ask(tmp_path, force=True)
    assert names(tmp_path) == before


@pytest.mark.parametrize("swaps", [True, False])
@pytest.mark.parametrize("links", [True, False])
def test_on_any_file_system_all_files_change_at_once(folder, monkeypatch, swaps, links):
    if not swaps:
        monkeypatch.setattr(atomic, "_swap_at_once", lambda one, other: False)
    if not links:
        monkeypatch.setattr(Path, "hardlink_to", failing(Path.hardlink_to, ALWAYS, OSError(1, "no")))
    pages = {"replay.html": b"1", "report.html": b"2"}
    assert add_files(folder, pages) == (folder / "replay.html", folder / "report.html")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == CONTENTS | pages | {"old": b""}
    assert all(path.stat().st_nlink == 1 for path in folder.iterdir())
    assert names(folder.parent) == {"plan"}


@pytest.mark.parametrize("call", range(1, 10))
def test_files_that_are_no_plan_are_written_all_or_none(tmp_path, monkeypatch, call):
    target, others = tmp_path / "stood", {"notes.txt": b"mine", "plan.json": b"{}"}
    before = {"stances.csv": b"1", "best.yaml": b"1"}
    write_files(target, {**before, **others})
    after = dict.fromkeys(before, b"2")
    with pytest.raises(ArchiveError, match="a folder without these files, or --force"):
        write_files(target, after)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", failing(os.fsync, call, OSError(28, "No space left on device")))
        try:
            write_files(target, after, force=True)
        except ArchiveError:
            assert call <= 7
    there = {path.name: path.read_bytes() for path in target.iterdir()}
    assert there in ({**before, **others}, {**after, **others})
    assert names(tmp_path) == {"stood"}


def test_folders_with_names_of_files_are_in_the_way(folder):
    (folder / "report.html").mkdir()
    for ask in (partial(require_free, force=True), partial(write_folder, CONTENTS, force=True)):
        with pytest.raises(ArchiveError, match=r"report\.html: got a folder"):
            ask(folder)
    with pytest.raises(ArchiveError, match=r"report\.html: got a folder"):
        add_files(folder, {"report.html": b""})
    assert names(folder) == FILES | {"old", "report.html"}


def test_only_names_of_a_plans_files_are_written(tmp_path):
    with pytest.raises(ArchiveError, match=r"got a file 'thesis\.tex'"):
        write_folder(CONTENTS | {"thesis.tex": b""}, tmp_path / "plan", force=False)
    assert not list(tmp_path.iterdir())


def test_force_never_replaces_a_file(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ArchiveError, match="a file of that name"):
        write_folder(CONTENTS, tmp_path / "file", force=True)
    assert (tmp_path / "file").read_text() == "mine"


def test_files_are_added_to_plan_directories_and_replaced(folder):
    assert add_file(folder, "replay.html", "<p>ü</p>") == folder / "replay.html"
    assert (folder / "replay.html").read_bytes() == "<p>ü</p>".encode()
    add_file(str(folder), "replay.html", b"\x00")
    assert (folder / "replay.html").read_bytes() == b"\x00"
    assert names(folder) == FILES | {"old", "replay.html"}
    for directory in (folder.parent, folder.parent / "nowhere"):
        with pytest.raises(ArchiveError, match="no plan directory"):
            add_file(directory, "report.html", "")
    assert names(folder.parent) == {"plan"}


ELSEWHERE = ("", ".", "..", "../x", "a/b", "/x", ".hidden", "a\0", "a\n", "x" * 300)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        *((name, "", "add_file: name") for name in ELSEWHERE),
        *(
            (name, "", "the plan's own files")
            for name in ("plan.json", *SAVED_FILES, *JOB_FILES, *EARLIER_FILES)
        ),
        ("report.html", "\ud800", "add_file: content"),
    ],
)
def test_what_must_not_be_added(folder, name, content, words):
    with pytest.raises(ArchiveError, match=words):
        add_file(folder, name, content)
    assert names(folder) == FILES | {"old"}
    assert (folder / "plan.json").read_bytes() == CONTENTS["plan.json"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failed_addition_leaves_what_was_there(folder, monkeypatch, error):
    add_file(folder, "report.html", "first")
    (folder / "folder").mkdir()
    with pytest.raises(ArchiveError):
        add_file(folder, "folder", "")
    monkeypatch.setattr(os, "fsync", failing(os.fsync, 1, error))
    with pytest.raises((ArchiveError, KeyboardInterrupt)):
        add_file(folder, "report.html", "second")
    assert (folder / "report.html").read_text() == "first"
    assert names(folder) == FILES | {"old", "report.html", "folder"}
