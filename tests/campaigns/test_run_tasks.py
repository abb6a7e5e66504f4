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
from small_scenes import SHORT

from cmbot.campaigns import Task, TaskResult, TaskStatus, run_tasks, runner
from cmbot.campaigns.planned import PLAN_SCENE
from cmbot.campaigns.runner import task_results
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


@pytest.fixture(autouse=True)
def _own_children() -> Iterator[None]:
    yield
    runner.end_children()


@pytest.mark.parametrize("each", TASKS, ids=lambda each: each.name)
def test_a_task_that_fails_costs_itself_alone(each: Task) -> None:
    result = runner.run_in_child(each)
    assert (result.status, result.error) == ENDS[each.name]
    assert result.key == each.key
    assert result.value == (3 if each.name == "add" else None)
    assert ("Traceback" in result.details) == (result.status == "raised")
    assert result.seconds > 0


def test_a_process_goes_on_until_a_task_fails_or_it_has_run_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "MOST_TASKS", 3)
    each = task("own_process")
    first = runner.run_in_child(each)
    assert [runner.run_in_child(each).value for _ in range(3)].count(first.value) == 2
    before, _ = runner.run_in_child(each).value
    for failing in TASKS[1:]:
        result = runner.run_in_child(failing)
        assert (result.status, result.error) == ENDS[failing.name]
        # What a task says is told of that alone.
        assert "said" not in result.details
        after, _ = runner.run_in_child(each).value
        assert after != before
        before = after


def test_a_process_that_has_grown_is_replaced() -> None:
    sizes = (300, 1, 150, 100, 1)
    grown = [runner.run_in_child(task("grow", megabytes=size)).value for size in sizes]
    assert grown[0] == grown[1] == grown[2] == grown[3] != grown[4]


def test_memory_is_bounded_for_each_task_alone() -> None:
    each, most = task("own_process"), 4_000_000_000
    process, limit = runner.run_in_child(each).value
    assert runner.run_in_child(replace(each, memory_limit=most)).value == [process, most]
    assert runner.run_in_child(each).value == [process, limit]


def test_a_process_ends_with_the_one_that_started_it() -> None:
    psutil = importlib.import_module("psutil")
    code = f"""
from cmbot.campaigns import Task
from cmbot.campaigns.runner import run_in_child
print(run_in_child(Task(name="a", function="{CALLS}:own_process")).value[0], flush=True)
run_in_child(Task(name="b", function="{CALLS}:hang"))
"""
    there = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", code], env=there, stdout=-1, text=True) as process:
        assert process.stdout is not None
        child = psutil.Process(int(process.stdout.readline()))
        process.kill()
    _, alive = psutil.wait_procs([child], timeout=60)
    # Where nobody asks for the status of orphans, as in some containers, they stay as zombies.
    assert all(each.status() == psutil.STATUS_ZOMBIE for each in alive)


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
    tasks, seen, addresses = TASKS[:4], list[TaskResult](), set[tuple[int, str, int]]()
    # A browser of other tests may listen, too.
    before = listening()

    def note(result: TaskResult) -> None:
        seen.append(result)
        addresses.update(listening() - before)

    first = run_tasks(tasks, tmp_path / "new", workers=2, attempts=2, report=note)
    assert {address for _, address, _ in addresses} <= {"127.0.0.1"}
    assert {result.name: (result.status, result.error) for result in first} == {
        each.name: ENDS[each.name] for each in tasks
    }
    assert [result.attempts for result in first] == [1, 2, 2, 1]
    assert sorted(result.name for result in seen) == sorted(each.name for each in tasks)
    assert not any(result.resumed for result in first)
    # No worker, and no dask, is needed where every result is there.
    again = run_tasks(tasks, tmp_path / "new")
    assert again == tuple(replace(result, resumed=True) for result in first)


def test_a_task_that_ends_the_worker_of_a_scheduler_costs_itself_alone(tmp_path: Path) -> None:
    distributed, dask = pytest.importorskip("distributed"), importlib.import_module("dask")
    address = {"host": "127.0.0.1", "dashboard_address": None}
    tasks = (TASKS[0], task("end_worker"), task("more", "add", x=2, y=2))
    settings = {"allowed-failures": 0, "worker-saturation": 1.0}
    with (
        dask.config.set({f"distributed.scheduler.{name}": value for name, value in settings.items()}),
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, **address) as cluster,
    ):
        done = run_tasks(tasks, tmp_path, scheduler=cluster.scheduler_address, attempts=2)
    assert [result.value for result in done] == [3, None, 4]
    assert done[1].status == "crashed"
    assert done[1].error.startswith("no worker finished it")
    assert done[1].attempts == 2


def test_a_plan_is_the_same_as_the_first_and_as_the_last_of_a_process(tmp_path: Path) -> None:
    def planned(name: str, **changes: object) -> int:
        scene = json.dumps({**SHORT, **changes})
        arguments = {"scene": scene, "directory": str(tmp_path / name)}
        result = runner.run_in_child(Task(name=name, function=PLAN_SCENE, arguments=arguments))
        assert result.status == "done", result.details
        return int(runner.run_in_child(task("own_process")).value[0])

    first = planned("first")
    assert planned("heavy", robot={"payload_kg": 2.0}) == planned("last") == first
    for file in ("job.csv", "job.npz", "baseline.csv"):
        assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "last" / file).read_bytes()


def test_a_script_needs_no_guard(tmp_path: Path) -> None:
    """No process begins with the user's script, which begins with a campaign."""
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


def test_security_options_reach_dask(tmp_path: Path) -> None:
    """A scheduler without encryption is refused where that is required."""
    distributed = pytest.importorskip("distributed")
    security = distributed.Security(require_encryption=True)
    task = Task(name="one", function="tests.none:none", arguments={}, time_limit=60)
    with pytest.raises(InputError, match="encryption required"):
        list(task_results([task], tmp_path, scheduler="tcp://127.0.0.1:9", security=security))
