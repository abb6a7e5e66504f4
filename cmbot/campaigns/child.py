"""The process of one task, ``python -m cmbot.campaigns TASK ANSWER``, and the call that runs it.

A task may hang or abort in compiled code, so nothing of it runs in the process that waits. TASK is a JSON file
with the task; ANSWER is written with what the function returns or raises.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from cmbot.campaigns.task import Task, TaskResult, TaskStatus

__all__ = ["answer_task", "run_in_child"]

# Matrices are small, and every worker has a task: more threads of linear algebra only wait for each other.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# Characters of standard error that are kept.
_DETAILS = 4000


def run_in_child(task: Task, path: Sequence[str] = ()) -> TaskResult:
    """Run one task in a fresh process, and wait for its end.

    Parameters
    ----------
    task : Task
    path : sequence of str
        Folders that the process imports from; left out: those of this one.
    """
    with tempfile.TemporaryDirectory(prefix="cmbot-task-") as folder:
        task, answer, log = (Path(folder, name) for name in ("task.json", "answer.json", "stderr"))
        content = {"function": task.function, "arguments": dict(task.arguments), "limit": task.time_limit}
        task.write_text(json.dumps(content), encoding="utf-8")
        begin = time.perf_counter()
        with log.open("wb") as errors:
            status, timed_out, usage = _waited_for(
                [sys.executable, "-m", "cmbot.campaigns", str(task), str(answer)],
                _ONE_THREAD | {"PYTHONPATH": os.pathsep.join(filter(None, path or sys.path))},
                errors,
                task.time_limit,
            )
        seconds = time.perf_counter() - begin
        details = log.read_text(encoding="utf-8", errors="replace")[-_DETAILS:]
        found = json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else {}
    ended: dict[str, Any]
    if timed_out:
        ended = {"status": TaskStatus.TIMED_OUT, "error": f"killed after {task.time_limit:g} s"}
    elif found and status == ("error" in found):
        ended = {"status": TaskStatus.RAISED if status else TaskStatus.DONE, **found}
    else:
        ended = {"status": TaskStatus.CRASHED, "error": _end_of(status)}
    return TaskResult(
        name=task.name,
        key=task.key,
        details=details if ended.get("error") else "",
        seconds=seconds,
        cpu_seconds=usage.ru_utime + usage.ru_stime,
        **ended,
    )


def _waited_for(
    command: list[str], environment: Mapping[str, str], errors: Any, limit: float
) -> tuple[int, bool, resource.struct_rusage]:
    """Exit status of a command (negative: a signal), whether it was killed at `limit`, s, what it used."""
    timed_out = threading.Event()
    # The pipe to its standard input closes when this process ends, however that happens.
    process = subprocess.Popen(
        command,
        env={**os.environ, **environment},
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=errors,
        start_new_session=True,
    )

    def kill() -> None:
        timed_out.set()
        os.killpg(process.pid, signal.SIGKILL)

    timer = threading.Timer(limit, kill)
    timer.start()
    try:
        # It keeps its process number until `wait4`: the timer cannot hit another process.
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    finally:
        timer.cancel()
        timer.join()
        if not timed_out.is_set():
            # What it has left behind in its session, and itself where the wait was interrupted.
            os.killpg(process.pid, signal.SIGKILL)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.stdin is not None:
            process.stdin.close()
    return process.returncode, timed_out.is_set(), usage


def _end_of(status: int) -> str:
    if status >= 0:
        return f"exit status {status} without an answer"
    known = {number.value: number.name for number in signal.Signals}
    return f"signal {known.get(-status, -status)}"


def answer_task(task: str, answer: str) -> None:
    """Run the task of the file `task` in this process, and write the file `answer`."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    task = json.loads(Path(task).read_text(encoding="utf-8"))
    # The system's own clock ends a task that hangs in compiled code, also where no parent is left to kill it.
    signal.alarm(math.ceil(task["limit"]) + 5)

    def record(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        sys.__excepthook__(kind, error, trace)
        _write(answer, {"error": f"{kind.__name__}: {error}"})

    sys.excepthook = record
    module, _, name = task["function"].partition(":")
    value = getattr(importlib.import_module(module), name)(**task["arguments"])
    _write(answer, {"value": value})


def _end_with_parent() -> None:
    # Not by sys.stdin, whose lock the interpreter wants when it ends.
    os.read(0, 1)
    os.kill(os.getpid(), signal.SIGKILL)


def _write(answer: str, content: Mapping[str, Any]) -> None:
    text = json.dumps(content, allow_nan=False)
    Path(answer).write_text(text, encoding="utf-8")
