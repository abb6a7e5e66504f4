"""One process at a time writes to a target, and what a killed one leaves is put back."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path
from types import FrameType, SimpleNamespace

import pytest
from command_line import ROOT, environment
from plan_folders import names

from cmbot.archive import atomic, claim
from cmbot.archive.atomic import exclusive, recover, replace_folder
from cmbot.archive.folder import write_folder
from cmbot.common.errors import ArchiveError

WORK = ".plan.cmbot-part"
CONTENTS = {"plan.json": b'{"format": "cmbot-plan/1"}', "trajectory.csv": b"1\n"}

# Waits for a line on standard input, then tries to write plan directories that name its process, those that
# are there already with force.
RACER = """
import os
import sys
from pathlib import Path
from cmbot.archive.folder import write_folder
from cmbot.common.errors import ArchiveError
targets = [Path(word) for word in sys.argv[1:]]
there = [target.exists() for target in targets]
print("ready", flush=True)
sys.stdin.readline()
for target, force in zip(targets, there):
    contents = {"plan.json": b'{"format": "cmbot-plan/1"}'}
    contents |= {f"trajectory.{suffix}": str(os.getpid()).encode() for suffix in ("csv", "npz", "ros.json")}
    try:
        write_folder(contents, target, force=force)
    except ArchiveError as error:
        print(error)
    else:
        print("written", os.getpid())
"""
HOLDER = """
import sys
from pathlib import Path
from cmbot.archive import claim
with claim(Path(sys.argv[1])):
    print("claimed", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    write_folder(CONTENTS, tmp_path / "plan", force=False)
    return tmp_path / "plan"


def apart(program: str, *words: str | Path) -> subprocess.Popen[str]:
    """A process that runs a program; its first line has been read."""
    process = subprocess.Popen(
        [sys.executable, "-c", program, *map(str, words)],
        env=environment(),
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline()
    return process


def test_of_two_processes_one_wins_and_the_other_says_so(tmp_path: Path) -> None:
    """With force and without: starting processes takes longest."""
    targets = [tmp_path / f"plan_{number}" for number in range(80)]
    for target in targets[40:]:
        write_folder(CONTENTS, target, force=False)
    with apart(RACER, *targets) as one, apart(RACER, *targets) as other:
        for process in (one, other):
            assert process.stdin is not None
            process.stdin.write("\n")
            process.stdin.flush()
        said = [process.communicate()[0].splitlines() for process in (one, other)]
    for number, (target, *lines) in enumerate(zip(targets, *said, strict=True)):
        force = number >= 40
        written = [line.split()[1] for line in lines if line.startswith("written ")]
        refused = [line for line in lines if not line.startswith("written ")]
        # With force the second may come when the first has ended.
        assert len(written) == 1 or (force and len(written) == 2)
        for line in refused:
            assert "another process is writing" in line or (not force and "already there" in line)
        contents = {path.read_text() for path in target.glob("trajectory.*")}
        assert len(contents) == 1
        assert contents <= set(written)
    assert names(tmp_path) == {target.name for target in targets}


def test_a_dead_process_blocks_nobody(plan: Path) -> None:
    with apart(HOLDER, plan) as holder:
        with pytest.raises(ArchiveError, match=rf"{plan}: got a place where another process is writing"):
            write_folder(CONTENTS, plan, force=True)
        recover(plan)
        assert names(plan.parent) == {"plan", WORK}
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        assert names(plan.parent) == {"plan", WORK}
        write_folder(CONTENTS, plan, force=True)
    assert names(plan.parent) == {"plan"}


def test_threads_exclude_each_other_but_calls_inside_do_not(plan: Path) -> None:
    with claim(plan), ThreadPoolExecutor() as threads:
        write_folder(CONTENTS, plan, force=True)
        with pytest.raises(ArchiveError, match="another process is writing"):
            threads.submit(write_folder, CONTENTS, plan, force=True).result()
        threads.submit(write_folder, CONTENTS, plan.parent / "other", force=False).result()
    assert names(plan.parent) == {"plan", "other"}


@pytest.mark.parametrize("path", ["/", "nowhere/plan", "pl\0an", "x" * 300])
def test_nothing_is_recovered_where_nothing_can_be(tmp_path: Path, path: str) -> None:
    recover(tmp_path / path)
    assert not list(tmp_path.iterdir())


def test_the_root_is_no_place_for_a_plan() -> None:
    with pytest.raises(ArchiveError, match="the root of all folders"), claim("/"):
        pass


def test_a_lock_that_vanishes_again_and_again_is_given_up(
    plan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other calls may remove it at that moment."""
    monkeypatch.setattr(os.path, "samestat", lambda one, other: False)
    with pytest.raises(ArchiveError, match="another process is writing"), claim(plan):
        pass


class Interruption:
    """Raises KeyboardInterrupt before a line of taking a lock, counted from 1; `done` says whether it did."""

    def __init__(self, line: int) -> None:
        self.left, self.done = line, False

    def __call__(self, frame: FrameType, event: str, _: object) -> Interruption | None:
        if frame.f_code.co_filename != atomic.__file__ or frame.f_code.co_name not in ("acquire", "_take"):
            return None
        if event == "line" and not self.done:
            self.left -= 1
            if self.left == 0:
                self.done = True
                raise KeyboardInterrupt
        return self


def test_a_lock_that_is_interrupted_leaves_nothing(tmp_path: Path) -> None:
    """Wherever the signal comes: the folder may have been made by then, and the lock."""
    before = sys.gettrace()
    for line in count(1):
        interruption = Interruption(line)
        try:
            sys.settrace(interruption)
            with claim(tmp_path / "folder" / "plan"):
                sys.settrace(before)
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(before)
        assert not list(tmp_path.iterdir()), line
        if not interruption.done:
            break
    assert line > 8


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc")
def test_where_nothing_can_be_made_that_is_said() -> None:
    expected = r"^/proc/plan: got a place where no file can be made, expected a place that can be written to$"
    with pytest.raises(ArchiveError, match=expected), claim("/proc/plan"):
        pass


# What killed calls leave


def leave(plan: Path, **folders: dict[str, str]) -> None:
    """Leave a work folder with folders of files."""
    for folder, contents in folders.items():
        (plan.parent / WORK / folder).mkdir(parents=True)
        for name, text in contents.items():
            (plan.parent / WORK / folder / name).write_text(text)


def test_the_plan_between_two_renames_is_put_back(plan: Path) -> None:
    leave(plan, new={"plan.json": "half"})
    plan.rename(plan.parent / WORK / "old")
    with pytest.warns(UserWarning, match=rf"{plan}: a call was interrupted .*; put back: the plan"):
        recover(plan)
    assert {path.name: path.read_bytes() for path in plan.iterdir()} == CONTENTS
    assert names(plan.parent) == {"plan"}


def test_what_is_not_the_plans_is_put_back_beside_what_is_there(plan: Path) -> None:
    for name in ("notes.txt", "notes.txt.1"):
        (plan / name).write_text("there")
    leave(plan, new={"plan.json": "old", "report.html": "old", "notes.txt": "mine", "photo.png": "mine"})
    (plan.parent / WORK / "new" / "joints.png").mkdir()
    (plan.parent / WORK / "file").write_text("half")
    with pytest.warns(UserWarning, match=r"put back: joints\.png, notes\.txt\.2, photo\.png"):
        recover(plan)
    assert names(plan) == {*CONTENTS, "joints.png", "notes.txt", "notes.txt.1", "notes.txt.2", "photo.png"}
    assert (plan / "notes.txt.2").read_text() == "mine"
    assert names(plan.parent) == {"plan"}


def test_files_that_are_no_plan_are_cleared_where_they_were_being_written(plan: Path) -> None:
    leave(plan, new={"stances.csv": "half", "notes.txt": "mine"})
    (plan.parent / WORK / "names").write_text("best.yaml\nstances.csv")
    with pytest.warns(UserWarning, match=r"put back: notes\.txt"):
        recover(plan)
    assert names(plan) == {*CONTENTS, "notes.txt"}
    assert names(plan.parent) == {"plan"}


def test_what_is_not_a_lost_plans_is_never_deleted(tmp_path: Path) -> None:
    leave(tmp_path / "plan", new={"plan.json": "old", "notes.txt": "mine"})
    notes = tmp_path / WORK / "new" / "notes.txt"
    for _ in range(2):
        recover(tmp_path / "plan")
        with pytest.raises(ArchiveError, match="not the plan's") as caught, claim(tmp_path / "plan"):
            pass
        assert caught.value.source == str(notes)
        assert notes.read_text() == "mine"


def test_remains_that_cannot_be_cleared_are_named(plan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EACCES, "Permission denied", str(path))

    leave(plan, new={"plan.json": "old"})
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(ArchiveError, match="remains of a call that cannot be cleared"), claim(plan):
        pass


# The swap


def test_two_folders_are_swapped_where_the_system_can(tmp_path: Path) -> None:
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"of_{name}").touch()
    atomic._swap(tmp_path / "one", tmp_path / "other", tmp_path / "spare")
    assert [names(tmp_path / name) for name in ("one", "other")] == [{"of_other"}, {"of_one"}]
    with pytest.raises(FileNotFoundError):
        atomic._swap_at_once(tmp_path / "one", tmp_path / "nowhere")


@pytest.mark.parametrize("error", [None, errno.ENOSYS, errno.EINVAL, errno.EPERM, errno.EOPNOTSUPP])
def test_without_a_swap_two_renames_do_it(
    plan: Path, monkeypatch: pytest.MonkeyPatch, error: int | None
) -> None:
    """Without the function in the C library, or where system or file system refuse it."""
    library = SimpleNamespace() if error is None else SimpleNamespace(renameat2=lambda *_: -1)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: library)
    monkeypatch.setattr(ctypes, "get_errno", lambda: error)
    with exclusive(plan):
        replace_folder({"report.html": b"new"}, plan, list(CONTENTS))
    assert {path.name: path.read_bytes() for path in plan.iterdir()} == CONTENTS | {"report.html": b"new"}
    assert names(plan.parent) == {"plan"}
