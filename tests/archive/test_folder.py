"""Folders appear whole or not at all, whatever stops a call, and replace nothing but what a record names."""

import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import FrameType

import pytest
from command_line import ROOT, environment
from killed_calls import dies_at, fails_at
from plan_folders import edit, names, seal

from cmbot.archive import (
    STANCES_FILE,
    add_file,
    claim,
    folder as folder_module,
    new_folder,
    record_of,
    require_absent,
    require_free,
    write_file,
    write_results,
)
from cmbot.archive.folder import read_folder, read_record
from cmbot.common.errors import ArchiveError

pytestmark = pytest.mark.usefixtures("judged_once")

OLD = {"stances.csv": b"old", "index.html": b"old", "best_1.yaml": b"old", "best_2.yaml": b"old"}
NEW = {"stances.csv": b"new", "index.html": b"old", "best.yaml": b"new"}
FULL = OSError(28, "No space left on device")


def write(folder: Path, contents: dict[str, bytes], *, force: bool = False) -> None:
    write_results(folder, STANCES_FILE, {"best": list(contents)[-1]}, contents, force=force)


def read(folder: Path) -> dict[str, bytes] | None:
    """What a reader finds."""
    try:
        record, contents = read_folder(folder, STANCES_FILE, lambda files: files)
    except ArchiveError:
        return None
    assert record["best"] in contents
    return contents


def on_disk(folder: Path) -> dict[str, bytes]:
    """All files of a folder but its record."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != STANCES_FILE}


def write_tour(folder: Path) -> None:
    with new_folder(folder) as draft:
        write(draft / "1_work", OLD)
        write(draft, NEW)


CALLS: dict[str, tuple[Callable[[Path], object], dict[str, bytes] | None, dict[str, bytes]]] = {
    "new": (partial(write, contents=NEW), None, NEW),
    "force": (partial(write, contents=NEW, force=True), OLD, NEW),
    "add": (lambda folder: add_file(folder, "replay.html", b"new"), OLD, OLD | {"replay.html": b"new"}),
    "replace": (lambda folder: add_file(folder, "index.html", b"new"), OLD, OLD | {"index.html": b"new"}),
    "tour": (write_tour, None, NEW),
}
DIES: dict[str, Callable[[int, Callable[[], object]], bool]] = {
    "kill": dies_at,
    "full": lambda step, call: fails_at(step, call, FULL),
    "Ctrl-C": lambda step, call: fails_at(step, call, KeyboardInterrupt()),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a record and a file that is not of it, in a folder of its own."""
    write(tmp_path / "work" / "stood", OLD)
    (tmp_path / "work" / "stood" / "notes.txt").write_bytes(b"mine")
    return tmp_path / "work" / "stood"


@pytest.mark.parametrize("how", DIES)
@pytest.mark.parametrize("name", CALLS)
def test_whatever_stops_a_call_the_old_or_the_new_is_there(tmp_path: Path, name: str, how: str) -> None:
    call, old, new = CALLS[name]
    mine = {} if old is None else {"notes.txt": b"mine"}
    before, work, seen = tmp_path / "before", tmp_path / "work", list[dict[str, bytes] | None]()
    before.mkdir()
    if old is not None:
        write(before / "stood", old)
        (before / "stood" / "notes.txt").write_bytes(b"mine")
    target = work / "stood"
    for step in itertools.count(1):
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(before, work)
        died = DIES[how](step, lambda: call(target))
        found = read(target)
        assert found in (old, new), step
        seen.append(found)
        if not died:
            break
        with claim(target):
            # What was begun is finished or removed; nothing else has changed.
            assert read(target) == found
            if found is not None and name != "tour":
                assert on_disk(target) == found | mine
        assert names(work) <= {"stood"}
        assert found is not None or not target.exists() or not names(target)
        if found == old:
            call(target)
        assert read(target) == new
        # A lock that the system does not let us remove stays.
        assert names(target) - {"1_work", ".1_work.lock"} == {*new, *mine, STANCES_FILE}
    assert seen[-1] == new
    assert seen.count(old) > 4
    if how == "kill":
        assert seen == sorted(seen, key=lambda state: state == new)


@pytest.mark.parametrize("how", DIES)
def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path, how: str) -> None:
    path = tmp_path / "work" / "table"
    for step in itertools.count(1):
        shutil.rmtree(tmp_path / "work", ignore_errors=True)
        write_file(path, b"old")
        died = DIES[how](step, lambda: write_file(path, b"new"))
        assert path.read_bytes() in (b"old", b"new")
        if not died:
            break
        write_file(path, b"newest")
        assert (names(path.parent), path.read_bytes()) == ({"table"}, b"newest")
    assert step > 6


def test_readers_beside_a_writer_find_one_of_both(folder: Path) -> None:
    """They take no lock, and never see a mixture."""
    end, found = threading.Event(), []

    def look() -> None:
        while not end.is_set():
            found.append(read(folder))

    with ThreadPoolExecutor() as threads:
        looking = [threads.submit(look) for _ in range(2)]
        try:
            for number in range(60):
                write(folder, (NEW, OLD)[number % 2], force=True)
        finally:
            end.set()
        for each in looking:
            each.result()
    assert all(each in (OLD, NEW) for each in found)


def test_a_reader_changes_nothing(folder: Path) -> None:
    """Also where a call was killed in between, in a folder that may not be written to."""
    step = next(
        step
        for step in itertools.count(1)
        if not _is_between(folder, step, partial(write, folder, NEW, force=True))
    )
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    folder.chmod(0o555)
    try:
        assert read(folder) == NEW, step
        assert record_of(folder) == STANCES_FILE
    finally:
        folder.chmod(0o755)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def _is_between(folder: Path, step: int, call: Callable[[], object]) -> bool:
    """Kill a call at a step of it; whether the old state still counts after it."""
    assert dies_at(step, call)
    return read(folder) == OLD


def test_a_changed_or_missing_file_is_named(folder: Path) -> None:
    (folder / "best_1.yaml").write_bytes(b"edited")
    with pytest.raises(ArchiveError, match=r"best_1\.yaml: got other content") as caught:
        read_folder(folder, STANCES_FILE, lambda files: files)
    assert caught.value.expected == "the file that was saved with stances.json"
    (folder / "best_1.yaml").unlink()
    with pytest.raises(ArchiveError, match=r"best_1\.yaml: no such file"):
        read_folder(folder, STANCES_FILE, lambda files: files)
    with pytest.raises(ArchiveError, match=r"stances\.json: files: got no other\.csv"):
        read_folder(folder, STANCES_FILE, lambda files: ["other.csv"])
    assert read_folder(folder, STANCES_FILE, lambda files: ["index.html"])[1] == {"index.html": b"old"}


def test_a_changed_record_and_those_of_other_versions_are_refused(folder: Path) -> None:
    record = folder / STANCES_FILE
    record.write_bytes(record.read_bytes().replace(b"best_2.yaml", b"best_3.yaml"))
    with pytest.raises(ArchiveError, match=r"stances\.json: content: got another hash"):
        read_record(folder, STANCES_FILE)
    older = "format: .*'cmbot-stances/1'"
    for change, told in (
        (
            lambda data: data.pop("content"),
            "content: no such key, expected hashes, as every stances.json has",
        ),
        (lambda data: data.pop("files"), "files: no such key, expected hashes, as every stances.json has"),
        (lambda data: data.update(format="cmbot-stances/0"), older),
        (lambda data: data.update(format="cmbot-stances/7"), older),
    ):
        data = json.loads(record.read_bytes())
        change(data)
        record.write_text(json.dumps(data))
        with pytest.raises(
            ArchiveError, match=f"{told}: written by a development version; cmbot stand SCENE makes"
        ):
            read_record(folder, STANCES_FILE)
    edit(folder, lambda data: data.update(format="another/1"), STANCES_FILE)
    with pytest.raises(ArchiveError, match=r"format: got 'another/1', expected 'cmbot-stances/1'$"):
        read_record(folder, STANCES_FILE)


def test_what_a_record_does_not_name_stays(folder: Path) -> None:
    for name in (".hidden", "best_9.yaml"):
        (folder / name).write_bytes(b"mine")
    (folder / "photos").mkdir()
    (folder / ".photos.part").mkdir()
    before = folder.stat()
    write(folder, NEW, force=True)
    mine = {".hidden", "best_9.yaml", "photos", ".photos.part", "notes.txt"}
    assert names(folder) == {*NEW, *mine, STANCES_FILE}
    # A shell that stands in it stays there.
    assert os.path.samestat(folder.stat(), before)


@pytest.mark.parametrize("name", ["../outside", "/outside", "a/b", "", ".."])
def test_a_record_that_names_what_is_elsewhere_removes_nothing(folder: Path, name: str) -> None:
    outside = folder.parent / "outside"
    outside.write_bytes(b"mine")
    edit(folder, lambda data: data["files"].update({name: "0" * 64}), STANCES_FILE)
    write(folder, NEW, force=True)
    assert outside.read_bytes() == b"mine"


def test_a_record_whose_hashes_are_none_is_replaced(folder: Path) -> None:
    (folder / STANCES_FILE).write_bytes(seal({"format": "cmbot-stances/1", "files": [1]}))
    write(folder, NEW, force=True)
    assert read(folder) == NEW


def test_names_that_are_there_are_refused_without_force(folder: Path) -> None:
    with pytest.raises(ArchiveError, match="a folder without these files, or --force") as caught:
        write(folder, NEW)
    assert caught.value.got == "stances.csv, index.html, stances.json, already there"
    with pytest.raises(ArchiveError):
        require_absent(folder, ["index.html"])
    require_absent(folder, ["best.yaml"])
    require_absent(folder.parent / "new", ["best.yaml"])
    (folder / "best.yaml").mkdir()
    for force in (False, True):
        with pytest.raises(ArchiveError, match=r"best\.yaml: got a folder"):
            write(folder, NEW, force=force)
    (folder / "best.yaml").rmdir()
    (folder / "best_2.yaml").unlink()
    (folder / "best_2.yaml").mkdir()
    with pytest.raises(ArchiveError, match=r"best_2\.yaml: got a folder"):
        write(folder, {"stances.csv": b"new"}, force=True)
    (folder / "best_2.yaml").rmdir()
    (folder / "best_2.yaml").write_bytes(b"old")
    with pytest.raises(ArchiveError, match="a file of that name"):
        write(folder / "notes.txt", NEW)
    assert read(folder) == OLD


def test_folders_above_are_made_and_removed_again(tmp_path: Path) -> None:
    with claim(tmp_path / "above" / "below" / "plan"):
        assert names(tmp_path / "above" / "below") == {".plan.lock"}
    assert not names(tmp_path)
    write(tmp_path / "above" / "below" / "plan", NEW)
    assert names(tmp_path / "above" / "below") == {"plan"}
    with claim(tmp_path / "above" / "other"):
        pass
    assert names(tmp_path / "above") == {"below"}


def test_a_new_folder_is_new_or_empty(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new"):
        write_tour(tmp_path / name)
        assert read(tmp_path / name) == NEW
        assert read(tmp_path / name / "1_work") == OLD
        with pytest.raises(ArchiveError, match="a new or empty folder"):
            require_free(tmp_path / name)
    (tmp_path / "file").touch()
    with pytest.raises(ArchiveError, match="a file of that name"):
        write_tour(tmp_path / "file")
    with pytest.raises(ZeroDivisionError), new_folder(tmp_path / "failed") as draft:
        write(draft, OLD)
        raise ZeroDivisionError
    assert names(tmp_path) == {"empty", "new", "file"}


def test_a_link_is_followed_and_stays(folder: Path) -> None:
    link = folder.parent / "link"
    link.symlink_to(folder)
    write(link, NEW, force=True)
    write_file(link / "notes.txt", b"ours")
    assert link.is_symlink()
    assert read(folder) == NEW
    assert (folder / "notes.txt").read_bytes() == b"ours"


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("file/plan", "a place below .*file, which is a file"),
        ("file/below/plan", "a place below .*file, which is a file"),
        ("pl\0an", "the path of a folder"),
        ("circle/plan", "the path of a folder"),
        ("x" * 300, "a refusal of the system"),
        ("/", "the root of all folders"),
        ("/proc/new/plan", "a place where no file can be made, expected a place that can be written to"),
    ],
)
def test_places_where_nothing_can_be_made(tmp_path: Path, path: str, words: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    with pytest.raises(ArchiveError, match=words), claim(tmp_path / path):
        pass
    with pytest.raises(ArchiveError):
        write_file(tmp_path / path, b"")
    assert names(tmp_path) == {"file", "circle"}


def test_where_this_user_may_not_write(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def access(place: Path, mode: int) -> bool:
        asked.append((Path(place), mode))
        return Path(place) != folder

    monkeypatch.setattr(os, "access", access)
    with pytest.raises(ArchiveError, match="a folder in which this user may not write"), claim(folder):
        pass
    with pytest.raises(ArchiveError, match=f"a place in {folder}, where this user may not write"):
        require_free(folder / "new" / "below")
    with claim(folder.parent / "new"):
        pass
    assert {mode for _, mode in asked} == {os.W_OK | os.X_OK}


def test_what_is_no_file_is_not_replaced_by_one(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ArchiveError, match="not a regular file"):
        write_file(tmp_path / "pipe", b"")
    with pytest.raises(ArchiveError, match="a refusal of the system"):
        write_file(tmp_path, b"")
    assert names(tmp_path) == {"pipe"}


HOLDER = """
import sys
from pathlib import Path
from cmbot.archive import claim
with claim(Path(sys.argv[1])):
    print("claimed", flush=True)
    sys.stdin.readline()
"""


def test_one_process_at_a_time_and_a_dead_one_blocks_nobody(folder: Path) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)],
        env=environment(),
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline()
        with pytest.raises(ArchiveError, match=f"{folder}: got a place where another process is writing"):
            write(folder, NEW, force=True)
        assert read(folder) == OLD
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        assert names(folder.parent) == {"stood", ".stood.lock"}
        write(folder, NEW, force=True)
    assert names(folder.parent) == {"stood"}


def test_threads_exclude_each_other_but_calls_inside_do_not(folder: Path) -> None:
    with claim(folder), ThreadPoolExecutor() as threads:
        write(folder, NEW, force=True)
        with pytest.raises(ArchiveError, match="another process is writing"):
            threads.submit(write, folder, OLD, force=True).result()
        threads.submit(write, folder.parent / "other", OLD).result()
    assert read(folder) == NEW
    assert names(folder.parent) == {"stood", "other"}


def test_a_lock_that_is_removed_while_it_is_taken_is_taken_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The call before ends between opening and locking: its file is no lock any more."""
    import fcntl

    lock, flock, calls = folder.parent / ".stood.lock", fcntl.flock, itertools.count()

    def late(file: object, operation: int) -> None:
        number = next(calls)
        if number == 0:
            lock.unlink()
        elif number == 1:
            lock.unlink()
            lock.touch()
        flock(file, operation)  # type: ignore[arg-type]

    monkeypatch.setattr(fcntl, "flock", late)
    with claim(folder):
        assert next(calls) == 3
    assert names(folder.parent) == {"stood"}


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # files that nothing closes
def test_a_signal_at_any_line_before_a_place_is_claimed_leaves_nothing(tmp_path: Path) -> None:
    """Python runs the handler of a signal between any two lines of Python."""
    sources, traced = {folder_module.__file__, contextlib.__file__}, sys.gettrace()

    def claimed(stop: int) -> bool:
        lines = itertools.count()

        def interrupt(frame: FrameType, event: str, _: object) -> Callable[..., object] | None:
            if frame.f_code.co_filename not in sources:
                return None
            if event == "line" and next(lines) == stop:
                sys.settrace(None)
                raise KeyboardInterrupt
            return interrupt

        sys.settrace(interrupt)
        try:
            with claim(tmp_path / "above" / "place"):
                sys.settrace(None)
                return True
        except KeyboardInterrupt:
            return False
        finally:
            sys.settrace(traced)

    stops = 0
    while not claimed(stops):
        assert not names(tmp_path)
        stops += 1
    assert stops > 40


ELSEWHERE = ("", ".", "..", "../x", "a/b", "/x", ".hidden", "a\0", "a\n", "x" * 300)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        *((name, "", "add_file: name") for name in ELSEWHERE),
        *((name, "", "the plan's own files") for name in ("plan.json", "job.csv", "job.npz", "baseline.csv")),
    ],
)
def test_what_must_not_be_added(folder: Path, name: str, content: str, words: str) -> None:
    before = on_disk(folder)
    with pytest.raises(ArchiveError, match=words):
        add_file(folder, name, content)
    with pytest.raises(ArchiveError, match=r"notes\.txt: got no plan directory|add_file"):
        add_file(folder / "notes.txt", name, content)
    assert on_disk(folder) == before
    assert read(folder) == OLD


def test_a_file_is_added_as_text_or_bytes(folder: Path) -> None:
    assert add_file(str(folder), "replay.html", "<p>ü</p>") == folder / "replay.html"
    assert read(folder) == OLD | {"replay.html": "<p>ü</p>".encode()}
    add_file(folder, "replay.html", b"\x00")
    assert read(folder) == OLD | {"replay.html": b"\x00"}
    (folder / "report.html").mkdir()
    with pytest.raises(ArchiveError, match=r"report\.html: got a folder"):
        add_file(folder, "report.html", "")
    for directory in (folder.parent, folder.parent / "nowhere"):
        with pytest.raises(ArchiveError, match="no plan directory"):
            add_file(directory, "replay.html", "")
