"""Tasks that end well, raise, abort and hang; and what is run again."""

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from cmbot.campaigns import Task, TaskResult, TaskStatus, run_tasks
from cmbot.campaigns.child import run_in_child
from cmbot.common.errors import InputError, MissingExtra

CALLS = "campaign_calls"


def task(name: str, call: str = "", **arguments: object) -> Task:
    return Task(name=name, function=f"{CALLS}:{call or name}", arguments=arguments, time_limit=60)


TASKS = (
    task("add", x=1, y=2),
    task("abort"),
    replace(task("hang"), time_limit=0.5),
    task("refuse", reason="no such\nthing"),
    task("exhaust"),
    task("leave"),
    task("nonsense", "not_there"),
)
ENDS = {
    "add": ("done", ""),
    "abort": ("crashed", "signal SIGABRT"),
    "hang": ("timed out", "killed after 0.5 s"),
    "refuse": ("raised", "ValueError: no such thing"),
    "exhaust": ("raised", "MemoryError: all of it"),
    "leave": ("crashed", "exit status 0 without an answer"),
    "nonsense": ("raised", f"AttributeError: module '{CALLS}' has no attribute 'not_there'"),
}


@pytest.mark.parametrize("each", TASKS, ids=lambda each: each.name)
def test_a_task_that_fails_costs_itself_alone(each: Task) -> None:
    result = run_in_child(each)
    assert (result.status, result.error) == ENDS[each.name]
    assert result.key == each.key
    assert result.value == (3 if each.name == "add" else None)
    assert ("Traceback" in result.details) == (result.status == "raised")
    assert result.seconds > 0


def test_a_process_goes_on_until_a_task_fails_or_it_has_run_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cmbot.campaigns.child._TASKS", 3)
    monkeypatch.setattr("cmbot.campaigns.child._IDLE", [])
    each = task("own_process")
    first = run_in_child(each)
    assert [run_in_child(each).value for _ in range(3)].count(first.value) == 2
    before, _ = run_in_child(each).value
    for failing in TASKS[1:]:
        result = run_in_child(failing)
        assert (result.status, result.error) == ENDS[failing.name]
        # What a task says is told of that alone.
        assert "said" not in result.details
        after, _ = run_in_child(each).value
        assert after != before
        before = after


def test_memory_is_bounded_for_each_task_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cmbot.campaigns.child._IDLE", [])
    each, most = task("own_process"), 4_000_000_000
    process, limit = run_in_child(each).value
    assert run_in_child(replace(each, memory_limit=most)).value == [process, most]
    assert run_in_child(each).value == [process, limit]


def listening() -> set[tuple[int, str, int]]:
    """Where this process and those that it started listen: process, address and port."""
    psutil = importlib.import_module("psutil")
    own, found = psutil.Process(), set[tuple[int, str, int]]()
    for each in (own, *own.children(recursive=True)):
        # A task's process may have ended by now.
        with suppress(psutil.NoSuchProcess):
            sockets = each.net_connections("inet")
            found |= {(each.pid, *one.laddr) for one in sockets if one.status == psutil.CONN_LISTEN}
    return found


def test_tasks_on_dask_are_resumed(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    # Starting it takes seconds, so once for all.
    tasks, seen, addresses = (*TASKS[:4], task("end_worker")), list[TaskResult](), set[str]()
    # A browser of other tests may listen, too.
    before = listening()

    def note(result: TaskResult) -> None:
        seen.append(result)
        addresses.update(address for _, address, _ in listening() - before)

    first = run_tasks(tasks, tmp_path / "new", attempts=2, report=note)
    assert addresses == {"127.0.0.1"}
    assert [result.name for result in first] == [each.name for each in tasks]
    assert {result.name: (result.status, result.error) for result in first[:4]} == {
        each.name: ENDS[each.name] for each in tasks[:4]
    }
    # It costs its worker, and not the others.
    assert first[4].status == "crashed"
    assert first[4].error.startswith("no worker finished it")
    assert [result.attempts for result in first] == [1, 2, 2, 1, 2]
    assert sorted(result.name for result in seen) == sorted(each.name for each in tasks)
    assert not any(result.resumed for result in first)
    # No worker, and no dask, is needed where every result is there.
    again = run_tasks(tasks, tmp_path / "new")
    assert again == tuple(replace(result, resumed=True) for result in first)


def test_a_script_needs_no_guard(tmp_path: Path) -> None:
    """Processes of ``multiprocessing`` begin with the user's script, which begins with a campaign."""
    pytest.importorskip("distributed")
    script = tmp_path / "script.py"
    script.write_text(
        f"""from cmbot.campaigns import Task, run_tasks
print("begin")
tasks = [Task(name=f"t{{k}}", function="{CALLS}:add", arguments={{"x": 1, "y": k}}) for k in range(6)]
print([result.value for result in run_tasks(tasks, "out", workers=1)], __file__ == {str(script)!r})
""",
        encoding="utf-8",
    )
    there = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, script], cwd=tmp_path, env=there, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("begin\n[1, 2, 3, 4, 5, 6] True\n", "")


def test_only_a_result_of_the_same_inputs_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module("cmbot.campaigns.runner")
    ran = list[str]()

    def here(tasks: Iterable[Task], *_: object) -> Iterator[TaskResult]:
        for each in tasks:
            ran.append(each.name)
            yield TaskResult(name=each.name, key=each.key, status=TaskStatus.DONE, value=7)

    monkeypatch.setattr(module, "_run", here)
    one, other = task("one", "add", x=1, y=1), task("other", "add", x=1, y=1)
    run_tasks([one, other], tmp_path)
    assert ran == ["one", "other"]
    (tmp_path / "other.json").write_text("{", encoding="utf-8")
    changed = replace(one, inputs={"scene": "0123"})
    assert [result.resumed for result in run_tasks([changed, other], tmp_path)] == [False, False]
    assert json.loads((tmp_path / "one.json").read_text(encoding="utf-8"))["key"] == changed.key
    assert [result.resumed for result in run_tasks([changed, other], tmp_path)] == [True, True]
    assert [result.resumed for result in run_tasks([changed], tmp_path, fresh=True)] == [False]
    # How long a task may take does not decide what it returns, but may decide whether it does.
    assert replace(one, time_limit=1).key == one.key
    hung = TaskResult(name="one", key=one.key, status=TaskStatus.TIMED_OUT, error="killed after 1 s")
    monkeypatch.setattr(module, "_run", lambda *_: (each for each in [hung]))
    for limits, resumed in (
        ({"time_limit": 1}, False),
        ({"time_limit": 1}, True),
        ({"memory_limit": 9}, False),
    ):
        assert [result.resumed for result in run_tasks([replace(one, **limits)], tmp_path)] == [resumed]


def test_bad_tasks_and_a_missing_dask_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for key, value in (
        ("name", "../x"),
        ("function", "os.abort"),
        ("arguments", {"x": float("nan")}),
        ("time_limit", 0),
        ("memory_limit", 0),
    ):
        with pytest.raises(InputError, match=f"Task: {key}: got"):
            replace(TASKS[0], **{key: value})
    with pytest.raises(InputError, match="several tasks named 'add', expected a unique name"):
        run_tasks([TASKS[0], TASKS[0]], tmp_path)
    with pytest.raises(InputError, match="workers: got 0"):
        run_tasks(TASKS[:1], tmp_path, workers=0)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtra, match=r"dask.distributed is not installed; run: pip install .*campaign"):
        run_tasks(TASKS[:1], tmp_path)
