"""The process that runs tasks: ``python -m cmbot.campaigns.child``.

It reads a task a line from standard input, as JSON, and answers with a line on standard output. A task that
raises ends it. So does the end of its input, whatever it is doing: whoever started it is gone then.
"""

from __future__ import annotations

import gc
import json
import math
import os
import resource
import signal
import sys
import traceback
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any, TextIO

# Objects that are made between two searches for reference cycles.
_CHILD_OBJECTS_PER_COLLECTION = 50_000


def main() -> None:
    """Run tasks as they come."""
    # What a task prints is lost; what it says of errors is kept by whoever started this process.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    gc.set_threshold(_CHILD_OBJECTS_PER_COLLECTION)
    lines = SimpleQueue[str]()
    Thread(target=_read, args=(lines,), daemon=True).start()
    while True:
        _run(json.loads(lines.get()), answers)


def _read(lines: SimpleQueue[str]) -> None:
    for line in sys.stdin:
        lines.put(line)
    os.killpg(0, signal.SIGKILL)


def _run(task: dict[str, Any], answers: TextIO) -> None:
    # The system's own clock ends a task that hangs in compiled code, also where nobody is left to kill it.
    signal.alarm(math.ceil(task["time_limit"]) + 5)
    most = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (task["memory_limit"] or most, most))
    began = _cpu_seconds()

    def answer(**content: Any) -> None:
        told = {**content, "cpu_seconds": _cpu_seconds() - began, "resident": _resident()}
        answers.write(json.dumps(told, allow_nan=False) + "\n")

    def end(kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if kind is not None:
            traceback.print_exception(error)
            sys.stderr.flush()
            answer(error=f"{kind.__name__}: {error}")
            os._exit(1)

    module, _, name = task["function"].partition(":")
    with ExitStack() as stack:
        stack.push(end)
        value = getattr(import_module(module), name)(**task["arguments"])
        # The next task's log begins empty.
        sys.stderr.flush()
        answer(value=value)
    signal.alarm(0)


def _cpu_seconds() -> float:
    use = resource.getrusage(resource.RUSAGE_SELF)
    return use.ru_utime + use.ru_stime


def _resident() -> int:
    """Memory of this process now, byte."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


if __name__ == "__main__":
    main()
