"""The process of one task, and the call that waits for it.

A task may hang or abort in compiled code, so nothing of it runs in the process that waits. Its process is
forked from a server that has imported what the task's function needs (``multiprocessing``'s ``forkserver``):
a task does not pay for imports.
"""

from __future__ import annotations

import gc
import importlib
import json
import math
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from cmbot.campaigns.task import Task, TaskResult, TaskStatus
from cmbot.common.errors import CmbotError

__all__ = ["run_in_child"]

_CONTEXT = multiprocessing.get_context("forkserver")
# Characters of standard error that are kept.
_DETAILS = 4000


def run_in_child(task: Task) -> TaskResult:
    """Run one task in a process of its own, and wait for its end.

    Raises
    ------
    CmbotError
        In a daemonic process, which may start no other: of dask, whose worker is then to be configured.
    """
    if multiprocessing.current_process().daemon:
        expected = "False: set DASK_DISTRIBUTED__WORKER__DAEMON=False where the worker is started"
        raise CmbotError(f"dask: distributed.worker.daemon: got True, expected {expected}")
    # The first task of a worker starts its server, and those of a campaign have one function.
    _CONTEXT.set_forkserver_preload(["__main__", __name__, task.function.partition(":")[0]])
    with tempfile.TemporaryDirectory(prefix="cmbot-task-") as folder:
        answer, log = Path(folder, "answer.json"), Path(folder, "stderr")
        begin = time.perf_counter()
        process = _CONTEXT.Process(target=_answer, args=(task, str(answer), str(log)))
        process.start()
        timed_out = _waited_for(process, task.time_limit)
        seconds = time.perf_counter() - begin
        status = process.exitcode
        details = log.read_text(encoding="utf-8", errors="replace")[-_DETAILS:] if log.exists() else ""
        found = json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else {}
    ended: dict[str, Any]
    if timed_out:
        ended = {"status": TaskStatus.TIMED_OUT, "error": f"killed after {task.time_limit:g} s"}
    elif found and bool(status) == ("error" in found):
        ended = {"status": TaskStatus.RAISED if status else TaskStatus.DONE, **found}
    else:
        ended = {"status": TaskStatus.CRASHED, "error": _end_of(status)}
    return TaskResult(
        name=task.name,
        key=task.key,
        details=details if ended.get("error") else "",
        seconds=seconds,
        **ended,
    )


def _waited_for(process: BaseProcess, limit: float) -> bool:
    """Whether a process was killed, with all that it has started, at its time limit, s."""
    try:
        process.join(limit)
        return process.is_alive()
    finally:
        if process.pid is not None and process.is_alive():
            # Its group is there when it has begun; before that there is nothing but itself.
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except ProcessLookupError:
                process.kill()
        process.join()


def _end_of(status: int | None) -> str:
    if status is None or status >= 0:
        return f"exit status {status} without an answer"
    known = {number.value: number.name for number in signal.Signals}
    return f"signal {known.get(-status, -status)}"


def _answer(task: Task, answer: str, log: str) -> None:
    """Run a task in this process, and write the file `answer`, and to `log` what it says of errors."""
    os.setsid()
    # What the server has imported is not looked through again and again: that would copy its pages, too.
    gc.freeze()
    errors = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno() if sys.__stdout__ else 1)
    os.dup2(errors, 2)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # The system's own clock ends a task that hangs in compiled code, also where no parent is left to kill it.
    signal.alarm(math.ceil(task.time_limit) + 5)
    if task.memory_limit is not None:
        resource.setrlimit(resource.RLIMIT_AS, (task.memory_limit, task.memory_limit))

    def record(kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if kind is not None:
            _write(answer, {"error": f"{kind.__name__}: {error}"})

    module, _, name = task.function.partition(":")
    with ExitStack() as end:
        end.push(record)
        value = getattr(importlib.import_module(module), name)(**task.arguments, **task.unkeyed)
    _write(answer, {"value": value})


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.killpg(0, signal.SIGKILL)


def _write(answer: str, content: Mapping[str, Any]) -> None:
    use = resource.getrusage(resource.RUSAGE_SELF)
    text = json.dumps({**content, "cpu_seconds": use.ru_utime + use.ru_stime}, allow_nan=False)
    Path(answer).write_text(text, encoding="utf-8")
