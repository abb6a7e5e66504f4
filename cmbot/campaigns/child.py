"""The processes of tasks, and the call that runs one and waits for its end.

A task may hang or abort in compiled code, so nothing of it runs in the process that waits. Its process is
forked from a server that has imported what the task's function needs (``multiprocessing``'s ``forkserver``),
and goes on with the next task: so imports, and what only a first call costs, are paid for once. One that
fails takes its process with it. After a number of tasks a process ends anyway, which bounds its memory.
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
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from typing import IO, Any

from cmbot.campaigns.task import Task, TaskResult, TaskStatus
from cmbot.common.errors import CmbotError

_CONTEXT = multiprocessing.get_context("forkserver")
# Characters of standard error that are kept.
_DETAILS = 4000
# Tasks that a process runs at most, and how many objects they make between two searches for reference cycles.
_TASKS, _BETWEEN_SEARCHES = 100, 50_000


def run_in_child(task: Task) -> TaskResult:
    """Run one task in a process apart from this one, and wait for its end.

    Raises
    ------
    CmbotError
        In a daemonic process, which may start no other: of dask, whose worker is then to be configured.
    """
    if multiprocessing.current_process().daemon:
        expected = "False: set DASK_DISTRIBUTED__WORKER__DAEMON=False where the worker is started"
        raise CmbotError(f"dask: distributed.worker.daemon: got True, expected {expected}")
    begin = time.perf_counter()
    child = _taken() or _Child(task)
    try:
        ended = child.run(task)
    finally:
        if child.goes_on:
            _IDLE.append(child)
        else:
            child.close()
    return TaskResult(name=task.name, key=task.key, seconds=time.perf_counter() - begin, **ended)


class _Child:
    """A process that runs one task after the other, begun for a `task`."""

    def __init__(self, task: Task) -> None:
        # The first task of a worker starts its server, and those of a campaign have one function.
        _CONTEXT.set_forkserver_preload(["__main__", __name__, task.function.partition(":")[0]])
        self._log = tempfile.NamedTemporaryFile(prefix="cmbot-task-")  # noqa: SIM115  `close` does
        self._connection, other = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_serve, args=(other, self._log.name))
        self._process.start()
        other.close()
        self._left, self._failed = _TASKS, False
        # Called at the latest when this process ends, before that waits for the other.
        self.close = Finalize(self, _end, (self._process, self._connection, self._log), exitpriority=1)

    @property
    def goes_on(self) -> bool:
        """Whether it takes another task."""
        return self._left > 0 and not self._failed and self._process.is_alive()

    def run(self, task: Task) -> dict[str, Any]:
        """Run a task; return how it ended, as fields of a `TaskResult`."""
        self._left, self._failed = self._left - 1, True
        self._log.truncate(0)
        found: dict[str, Any] = {}
        # A process that ends breaks the connection.
        with suppress(EOFError, OSError):
            self._connection.send(task)
            if not self._connection.poll(task.time_limit):
                error = f"killed after {task.time_limit:g} s"
                return {"status": TaskStatus.TIMED_OUT, "error": error, "details": self._said()}
            found = json.loads(self._connection.recv_bytes())
        if "value" in found:
            self._failed = False
            return {"status": TaskStatus.DONE, **found}
        self._process.join(task.time_limit)
        status = self._process.exitcode
        if found and status:
            return {"status": TaskStatus.RAISED, "details": self._said(), **found}
        return {"status": TaskStatus.CRASHED, "error": _end_of(status), "details": self._said()}

    def _said(self) -> str:
        """The end of what the process wrote to standard error."""
        self._log.seek(0)
        return self._log.read().decode("utf-8", errors="replace")[-_DETAILS:]


_IDLE = list[_Child]()


def _taken() -> _Child | None:
    """A process that has nothing to do, for this thread alone; None where there is none."""
    with suppress(IndexError):
        while not (child := _IDLE.pop()).goes_on:
            child.close()
        return child
    return None


def _end(process: BaseProcess, connection: Connection, log: IO[bytes]) -> None:
    """End a process with all that it has started."""
    if process.pid is not None and process.is_alive():
        # Its group is there when it has begun; before that there is nothing but itself.
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            process.kill()
    process.join()
    connection.close()
    log.close()


def _end_of(status: int | None) -> str:
    if status is None or status >= 0:
        return f"exit status {status} without an answer"
    known = {number.value: number.name for number in signal.Signals}
    return f"signal {known.get(-status, -status)}"


def _serve(connection: Connection, log: str) -> None:
    """Run tasks in this process as they come; what it says of errors goes to `log`."""
    os.setsid()
    # What the server has imported is not looked through again and again: that would copy its pages, too.
    gc.freeze()
    gc.set_threshold(_BETWEEN_SEARCHES)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno() if sys.__stdout__ else 1)
    os.dup2(os.open(log, os.O_WRONLY | os.O_APPEND), 2)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError):
        while True:
            _answer(connection.recv(), connection)


def _answer(task: Task, connection: Connection) -> None:
    # The system's own clock ends a task that hangs in compiled code, also where no parent is left to kill it.
    signal.alarm(math.ceil(task.time_limit) + 5)
    most = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (task.memory_limit or most, most))
    before = _cpu_seconds()

    def send(**content: Any) -> None:
        text = json.dumps({**content, "cpu_seconds": _cpu_seconds() - before}, allow_nan=False)
        connection.send_bytes(text.encode())

    def record(kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if kind is not None:
            send(error=f"{kind.__name__}: {error}")

    module, _, name = task.function.partition(":")
    with ExitStack() as end:
        end.push(record)
        value = getattr(importlib.import_module(module), name)(**task.arguments, **task.unkeyed)
        # The next task's log begins empty.
        sys.stderr.flush()
        send(value=value)
    signal.alarm(0)


def _cpu_seconds() -> float:
    use = resource.getrusage(resource.RUSAGE_SELF)
    return use.ru_utime + use.ru_stime


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.killpg(0, signal.SIGKILL)
