"""Tasks on the processes of dask, and their results on the disk."""

from __future__ import annotations

import atexit
import importlib
import json
import logging
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from threading import get_ident
from typing import Any

from cmbot.campaigns.task import Task, TaskResult, TaskStatus
from cmbot.common.errors import InputError, optional_module

_TASK_FORMAT = "cmbot-task/1"
# Tasks that dask has at a time; each takes tens of kilobytes there. For each worker of this process; and for
# a scheduler, whose workers may be many, or become more as its queue grows.
_AHEAD_HERE, _AHEAD_THERE = 4, 5000
_DASK_SETTINGS = {
    "distributed.scheduler.worker-saturation": 1.0,
    # It looks at every worker a hundred times a second, which only waits for its child.
    "distributed.worker.profile.enabled": False,
}
# Tasks that a child runs at most, and what its memory may grow by after the first of them, byte.
MOST_TASKS, MOST_GROWTH = 50, 200_000_000
# Characters of standard error that are kept.
_KEPT_STDERR_CHARACTERS = 4000
# Matrices are small, and there is a child for every processor: more threads only wait for each other.
_BLAS_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def run_tasks(
    tasks: Sequence[Task],
    directory: str | Path,
    *,
    report: Callable[[TaskResult], None] | None = None,
    **options: Any,
) -> tuple[TaskResult, ...]:
    """Run tasks on several processes, and return their results in the order of the tasks.

    `report` is called with each result, as the tasks end; the rest is that of `task_results`.
    """
    found: dict[str, TaskResult] = {}
    with closing(task_results(tasks, directory, **options)) as results:
        for result in results:
            found[result.name] = result
            if report is not None:
                report(result)
    return tuple(found[task.name] for task in tasks)


def task_results(
    tasks: Iterable[Task],
    directory: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    security: object | None = None,
    attempts: int = 1,
    fresh: bool = False,
    accept: Callable[[TaskResult], bool] | None = None,
) -> Generator[TaskResult]:
    """Run tasks on several processes; each result is written as ``NAME.json`` when its task ends.

    A task whose file is there and has its key is not run again, however it ended; where it did not return, as
    long as its limits are the same. One that crashes or hangs costs itself alone. Neither tasks nor results
    are held.

    Parameters
    ----------
    tasks : iterable of Task
    directory : str or Path
        Of the result files; made as needed.
    workers : int
        Processes on this machine, each with one task at a time.
    scheduler : str, optional
        Address of a running dask scheduler, whose workers are used instead; they see the same files.
    security : distributed.Security, optional
        How that scheduler is spoken to; left out: as dask is configured.
    attempts : int
        How often a task is tried that crashes, hangs or finds no memory.
    fresh : bool
        Run every task, whatever files are there.
    accept : callable, optional
        Whether a result that is there holds; left out: all do.

    Yields
    ------
    TaskResult
        As the tasks end; those that are not run come first.

    Raises
    ------
    InputError
        When two tasks have the same name, `workers` is not positive, or no scheduler answers at its address.
    ArchiveError
        When a result cannot be written.
    MissingExtra
        When tasks are to be run and dask is not installed.
    """
    directory = Path(directory)
    if not workers >= 1:
        raise InputError("run_tasks", "workers", workers, "a whole number from 1 on")
    left, limits = deque[Task](), dict[str, dict[str, float | None]]()
    for task in tasks:
        if task.name in limits:
            raise InputError(
                "run_tasks", "tasks", f"several tasks named {task.name!r}", "a unique name for each"
            )
        limits[task.name] = _limits(task)
        known = None if fresh else _known(directory, task)
        if known is None or (accept is not None and not accept(known)):
            left.append(task)
        else:
            yield known
    if left:
        with closing(_run(left, workers, (scheduler, security), attempts)) as results:
            for result in results:
                _store(directory, result, limits[result.name])
                yield result


def _run(
    left: deque[Task], workers: int, there: tuple[str | None, object], attempts: int
) -> Generator[TaskResult]:
    """Yield results as the tasks end; takes them from `left`."""
    distributed = require_dask()
    workers = min(workers, len(left))
    ahead = _AHEAD_HERE * workers if there[0] is None else _AHEAD_THERE
    with _client(distributed, workers, *there) as client:
        futures = dict[Any, tuple[Task, int]]()

        def submit(task: Task, attempt: int) -> Any:
            # One group of tasks, which the scheduler keeps to itself until a worker is free.
            key = ("task", task.name, task.key, attempt)
            # Of equal priorities the earlier is first.
            future = client.submit(run_in_child, task, key=key, pure=False, retries=0, priority=-attempt)
            futures[future] = task, attempt
            return future

        ends = distributed.as_completed([submit(left.popleft(), 1) for _ in range(min(ahead, len(left)))])
        for future in ends:
            task, attempt = futures.pop(future)
            if future.status == "finished":
                result = replace(future.result(), attempts=attempt)
            else:
                text = f"no worker finished it ({future.exception()})"
                result = TaskResult(
                    name=task.name, key=task.key, status=TaskStatus.CRASHED, error=text, attempts=attempt
                )
            if left:
                ends.add(submit(left.popleft(), 1))
            if result.worth_a_retry and attempt < attempts:
                ends.add(submit(task, attempt + 1))
            else:
                yield result


@contextmanager
def _client(distributed: Any, workers: int, scheduler: str | None, security: object) -> Iterator[Any]:
    if scheduler is not None:
        try:
            client = distributed.Client(scheduler, security=security)
        except (OSError, RuntimeError, ValueError, TypeError) as error:
            expected = f"the address of a dask scheduler that is running, tcp:// or tls://HOST:PORT ({error})"
            raise InputError("scheduler", "", repr(scheduler), expected) from error
        with client:
            yield client
        return
    # What goes wrong is in the results; tornado tells of callbacks that a cluster's end cuts short.
    for name in ("distributed", "distributed.client", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    # Workers only wait for their children: they are threads of this process. Their pages listen all the same.
    options = {"n_workers": workers, "threads_per_worker": 1, "processes": False, "memory_limit": 0}
    local = dict.fromkeys(("dashboard_address", "worker_dashboard_address"), "127.0.0.1:0")
    with (
        importlib.import_module("dask").config.set(_DASK_SETTINGS),
        distributed.LocalCluster(**local, **options) as cluster,
    ):
        try:
            with distributed.Client(cluster) as client:
                yield client
        finally:
            # Threads that wait for them would hold up the cluster's end.
            end_children()


class _Child:
    """A process that runs one task after the other; none of them can end or block this one."""

    def __init__(self) -> None:
        # Every write goes to its end, wherever it is read.
        self._log = tempfile.TemporaryFile("a+b")  # noqa: SIM115  it goes with this object
        self._process: Any = subprocess.Popen(
            [sys.executable, "-m", "cmbot.campaigns.child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env=os.environ | _BLAS_THREADS | {"PYTHONPATH": os.pathsep.join(sys.path)},
            # Ctrl-C of a terminal is for those who wait for it.
            start_new_session=True,
        )
        self._run, self._first, self.goes_on = 0, 0, True

    def run(self, task: Task) -> dict[str, Any]:
        """Run a task; return how it ended, as fields of a `TaskResult`."""
        self.goes_on = False
        self._log.truncate(0)
        asked = {name: getattr(task, name) for name in ("function", "time_limit", "memory_limit")}
        line = json.dumps(asked | {"arguments": {**task.arguments, **task.unkeyed}})
        answers = self._process.stdout
        # One that has ended breaks the pipe, and has no answer.
        with suppress(OSError):
            self._process.stdin.write(f"{line}\n".encode())
            self._process.stdin.flush()
        ready = select.poll()
        ready.register(answers)
        if not ready.poll(1e3 * task.time_limit):
            error = f"killed after {task.time_limit:g} s"
            return {"status": TaskStatus.TIMED_OUT, "error": error, "details": self._said()}
        line = answers.readline()
        # Of a process that ends while it answers there is no whole line.
        answer = json.loads(line) if line.endswith(b"\n") else {}
        resident = answer.pop("resident", 0)
        if "value" in answer:
            self._run, self._first = self._run + 1, self._first or resident
            self.goes_on = self._run < MOST_TASKS and resident - self._first < MOST_GROWTH
            return {"status": TaskStatus.DONE, **answer}
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(task.time_limit)
        if answer:
            return {"status": TaskStatus.RAISED, "details": self._said(), **answer}
        error = _end_of(self._process.returncode)
        return {"status": TaskStatus.CRASHED, "error": error, "details": self._said()}

    def end(self) -> None:
        """End the process with all that it has started."""
        self.goes_on = False
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        for file in (self._process.stdin, self._process.stdout, self._log):
            with suppress(OSError):
                file.close()

    def _said(self) -> str:
        """The end of what the process wrote to standard error."""
        self._log.seek(0)
        return self._log.read().decode("utf-8", errors="replace")[-_KEPT_STDERR_CHARACTERS:]


# By the thread that has it: of a worker, which has one task at a time.
_CHILDREN = dict[int, _Child]()


def run_in_child(task: Task) -> TaskResult:
    """Run one task in this thread's process for tasks, and wait for its end."""
    begin = time.perf_counter()
    child = _CHILDREN.pop(get_ident(), None) or _Child()
    _CHILDREN[get_ident()] = child
    try:
        ended = child.run(task)
    finally:
        if not child.goes_on:
            child.end()
            _CHILDREN.pop(get_ident(), None)
    return TaskResult(name=task.name, key=task.key, seconds=time.perf_counter() - begin, **ended)


@atexit.register
def end_children() -> None:
    """End all processes for tasks of this process."""
    while _CHILDREN:
        _CHILDREN.popitem()[1].end()


def _end_of(status: int | None) -> str:
    if status is None or status >= 0:
        return f"exit status {status} without an answer"
    known = {number.value: number.name for number in signal.Signals}
    return f"signal {known.get(-status, -status)}"


def require_dask() -> Any:
    """Return the module ``distributed``; a `MissingExtra` where it is not installed."""
    return optional_module("distributed", "dask.distributed", "campaign")


def _limits(task: Task) -> dict[str, float | None]:
    return {"time_limit": task.time_limit, "memory_limit": task.memory_limit}


def _known(directory: Path, task: Task) -> TaskResult | None:
    """The result on the disk that has a task's key; None where there is none, or it is damaged.

    One that did not return may do so with other limits.
    """
    try:
        data = json.loads((directory / f"{task.name}.json").read_text(encoding="utf-8"))
        limits = {name: data.pop(name, None) for name in _limits(task)}
        if data.pop("format") != _TASK_FORMAT or data["key"] != task.key:
            return None
        result = replace(TaskResult(**data), resumed=True)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None
    return result if result.status is TaskStatus.DONE or limits == _limits(task) else None


def _store(directory: Path, result: TaskResult, limits: Mapping[str, float | None]) -> None:
    # It brings the planner with it, which the tasks' processes may not need.
    from cmbot.archive import json_bytes, write_file

    data = {"format": _TASK_FORMAT, **asdict(result), **limits}
    del data["resumed"]
    write_file(directory / f"{result.name}.json", json_bytes(data, indent=1))
