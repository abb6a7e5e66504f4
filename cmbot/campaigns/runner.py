"""Tasks on the processes of dask, and their results on the disk."""

from __future__ import annotations

import importlib
import json
import logging
import signal
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, replace
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from cmbot.campaigns.child import run_in_child
from cmbot.campaigns.task import Task, TaskResult, TaskStatus
from cmbot.common.errors import CmbotError, InputError, MissingExtra
from cmbot.common.validation import shown

_FORMAT = "cmbot-task/1"
# Tasks that dask has at a time; each takes tens of kilobytes there. For each process of this machine; and for
# a scheduler, whose workers may be many, or become more as its queue grows.
_AHEAD_HERE, _AHEAD_THERE = 4, 5000
_SETTINGS = {
    # Workers start processes of their own.
    "distributed.worker.daemon": False,
    # A task whose worker dies is tried again by `run_tasks`, which counts.
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    # It looks at every worker a hundred times a second, which only waits for its child.
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ": {
        "DASK_LOGGING__DISTRIBUTED": "critical",
        # Matrices are small, and every worker has a task: more threads only wait for each other.
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    },
}


def run_tasks(
    tasks: Sequence[Task],
    directory: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    attempts: int = 1,
    fresh: bool = False,
    accept: Callable[[TaskResult], bool] | None = None,
    report: Callable[[TaskResult], None] | None = None,
) -> tuple[TaskResult, ...]:
    """Run tasks on several processes; each writes its result as ``NAME.json`` when it ends.

    A task whose file is there and has its key is not run again, however it ended; where it did not return, as
    long as its limits are the same. One that crashes or hangs costs itself alone.

    Parameters
    ----------
    tasks : sequence of Task
    directory : str or Path
        Of the result files; made as needed.
    workers : int
        Processes on this machine, each with one task at a time. They and their scheduler listen on 127.0.0.1.
    scheduler : str, optional
        Address of a running dask scheduler, whose workers are used instead; they see the same files.
    attempts : int
        How often a task is tried that crashes, hangs or finds no memory.
    fresh : bool
        Run every task, whatever files are there.
    accept : callable, optional
        Whether a result that is there holds; left out: all do.
    report : callable, optional
        Called with each result, as the tasks end; those that are not run come first.

    Returns
    -------
    tuple of TaskResult
        In the order of `tasks`.

    Raises
    ------
    InputError
        When two tasks have the same name, `workers` is not positive, or no scheduler answers at its address.
    ArchiveError
        When a result cannot be written.
    MissingExtra
        When tasks are to be run and dask is not installed.
    """
    results = task_results(
        tasks,
        directory,
        workers=workers,
        scheduler=scheduler,
        attempts=attempts,
        fresh=fresh,
        accept=accept,
    )
    found: dict[str, TaskResult] = {}
    with closing(results):
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
    attempts: int = 1,
    fresh: bool = False,
    accept: Callable[[TaskResult], bool] | None = None,
) -> Generator[TaskResult]:
    """Yield results as the tasks end, first those that are there; neither tasks nor results are held.

    `run_tasks` says what the parameters mean, and returns all results.
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
        with closing(_run(left, workers, scheduler, attempts)) as results:
            for result in results:
                _store(directory, result, limits[result.name])
                yield result


def _run(left: deque[Task], workers: int, scheduler: str | None, attempts: int) -> Generator[TaskResult]:
    """Yield results as the tasks end; takes them from `left`."""
    distributed = require_dask()
    workers = min(workers, len(left))
    ahead = _AHEAD_HERE * workers if scheduler is None else _AHEAD_THERE
    with _client(distributed, workers, scheduler) as client:
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
            elif isinstance(error := future.exception(), CmbotError):
                raise error
            else:
                text = f"no worker finished it ({error})"
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
def _client(distributed: Any, workers: int, scheduler: str | None) -> Iterator[Any]:
    if scheduler is not None:
        try:
            client = distributed.Client(scheduler)
        except (OSError, ValueError, TypeError) as error:
            expected = f"the address of a dask scheduler that is running, tcp://HOST:PORT ({error})"
            raise InputError("scheduler", "", shown(scheduler), expected) from error
        with client:
            yield client
        return
    # Without an address the dashboard's server takes a fixed port, which a second campaign finds taken.
    local = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    # A task's memory is its child's, which the worker does not see.
    options = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "memory_limit": 0}
    with ExitStack() as ends:
        with _ctrl_c_later():
            ends.enter_context(importlib.import_module("dask").config.set(_SETTINGS))
            # What goes wrong is in the results; tornado tells of callbacks that a cluster's end cuts short.
            for name in ("distributed", "distributed.client", "tornado"):
                logging.getLogger(name).setLevel(logging.CRITICAL)
            ends.enter_context(_script_unread())
            cluster = ends.enter_context(distributed.LocalCluster(**local, **options))
            client = ends.enter_context(distributed.Client(cluster))
        yield client


@contextmanager
def _script_unread() -> Iterator[None]:
    """Keep processes that ``multiprocessing`` starts from running the user's script first, as it has them do.

    No task needs it, and where it calls `run_tasks` outside of ``if __name__ == "__main__"`` they would, too.
    """
    main = sys.modules["__main__"]
    file, spec = vars(main).pop("__file__", None), main.__spec__
    main.__spec__ = None
    try:
        yield
    finally:
        main.__spec__ = spec
        if file is not None:
            main.__file__ = file


@contextmanager
def _ctrl_c_later() -> Iterator[None]:
    """Hold Ctrl-C back; threads and processes that are started in the meantime never see it.

    A terminal sends it to the workers, too, each of which would print a traceback.
    """
    # When it starts, it lets the signal through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def require_dask() -> Any:
    """Return the module ``distributed``; a `MissingExtra` where it is not installed."""
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise MissingExtra("dask.distributed", "campaign") from error


def _limits(task: Task) -> dict[str, float | None]:
    return {"time_limit": task.time_limit, "memory_limit": task.memory_limit}


def _known(directory: Path, task: Task) -> TaskResult | None:
    """The result on the disk that has a task's key; None where there is none, or it is damaged.

    One that did not return may do so with other limits.
    """
    try:
        data = json.loads((directory / f"{task.name}.json").read_text(encoding="utf-8"))
        limits = {name: data.pop(name, None) for name in _limits(task)}
        if data.pop("format") != _FORMAT or data["key"] != task.key:
            return None
        result = replace(TaskResult(**data), resumed=True)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None
    return result if result.status is TaskStatus.DONE or limits == _limits(task) else None


def _store(directory: Path, result: TaskResult, limits: Mapping[str, float | None]) -> None:
    # It brings the planner with it, which the tasks' processes may not need.
    from cmbot.archive import json_bytes, write_file

    data = {"format": _FORMAT, **asdict(result), **limits}
    del data["resumed"]
    write_file(directory / f"{result.name}.json", json_bytes(data, indent=1))
