"""Tasks on the processes of dask, and their results on the disk."""

from __future__ import annotations

import importlib
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from cmbot.campaigns.child import run_in_child
from cmbot.campaigns.task import Task, TaskResult, TaskStatus
from cmbot.common.errors import InputError, MissingExtra

__all__ = ["run_tasks"]

_FORMAT = "cmbot-task/1"


def run_tasks(
    tasks: Sequence[Task],
    directory: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    fresh: bool = False,
    report: Callable[[TaskResult], None] | None = None,
) -> tuple[TaskResult, ...]:
    """Run tasks on several processes; each writes its result as ``NAME.json`` when it ends.

    A task whose file is there and has its key is not run again, however it ended. One that crashes or hangs
    costs itself alone.

    Parameters
    ----------
    tasks : sequence of Task
    directory : str or Path
        Of the result files; made as needed.
    workers : int
        Processes on this machine, each with one task at a time. They and their scheduler listen on 127.0.0.1.
    scheduler : str, optional
        Address of a running dask scheduler, whose workers are used instead; they see the same files.
    fresh : bool
        Run every task, whatever files are there.
    report : callable, optional
        Called with each result, as the tasks end; those that are not run come first.

    Returns
    -------
    tuple of TaskResult
        In the order of `tasks`.

    Raises
    ------
    InputError
        When two tasks have the same name, or `workers` is not positive.
    ArchiveError
        When a result cannot be written.
    MissingExtra
        When tasks are to be run and dask is not installed.
    """
    directory = Path(directory)
    if twice := [name for name, number in Counter(task.name for task in tasks).items() if number > 1]:
        raise InputError("run_tasks", "tasks", f"several tasks named {twice[0]!r}", "a unique name for each")
    if not workers >= 1:
        raise InputError("run_tasks", "workers", workers, "a whole number from 1 on")
    found: dict[str, TaskResult] = {}

    def ended(result: TaskResult) -> None:
        found[result.name] = result
        if report is not None:
            report(result)

    left = []
    for task in tasks:
        known = None if fresh else _known(directory, task)
        if known is None:
            left.append(task)
        else:
            ended(known)
    if left:
        for result in _run(left, workers, scheduler):
            _store(directory, result)
            ended(result)
    return tuple(found[task.name] for task in tasks)


def _run(tasks: Sequence[Task], workers: int, scheduler: str | None) -> Iterator[TaskResult]:
    """Yield results as the tasks end."""
    distributed = _distributed()
    with _client(distributed, min(workers, len(tasks)), scheduler) as client:
        path = [str(Path(folder).resolve()) for folder in sys.path]
        # Earlier tasks first; a worker that dies with a task is not tried again.
        futures = {
            client.submit(
                run_in_child, task, path, key=f"{task.name}-{task.key}", pure=False, retries=0
            ): task
            for task in tasks
        }
        for future in distributed.as_completed(futures):
            task = futures[future]
            if future.status == "finished":
                yield future.result()
            else:
                error = f"no worker finished it ({future.exception()})"
                yield TaskResult(name=task.name, key=task.key, status=TaskStatus.CRASHED, error=error)


@contextmanager
def _client(distributed: Any, workers: int, scheduler: str | None) -> Iterator[Any]:
    if scheduler is not None:
        with distributed.Client(scheduler) as client:
            yield client
        return
    # Without an address the dashboard's server takes a fixed port, which a second campaign finds taken.
    local = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    # A task's memory is its child's, which the worker does not see.
    options = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "memory_limit": 0}
    with distributed.LocalCluster(**local, **options) as cluster, distributed.Client(cluster) as client:
        yield client


def _distributed() -> Any:
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise MissingExtra("dask.distributed", "campaign") from error


def _known(directory: Path, task: Task) -> TaskResult | None:
    """The result on the disk that has a task's key; None where there is none, or it is damaged."""
    try:
        data = json.loads((directory / f"{task.name}.json").read_text(encoding="utf-8"))
        if data.pop("format") != _FORMAT or data["key"] != task.key:
            return None
        return replace(TaskResult(**data), resumed=True)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None


def _store(directory: Path, result: TaskResult) -> None:
    # It brings the planner with it, which the tasks' processes may not need.
    from cmbot.archive import json_bytes, write_file

    data = {"format": _FORMAT, **asdict(result)}
    del data["resumed"]
    write_file(directory / f"{result.name}.json", json_bytes(data, indent=1))
