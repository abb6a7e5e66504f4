"""Worker processes that try mutants: one that crashes or hangs is replaced, and its mutant is a finding."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import resource
import signal
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import psutil

from fuzzing.cases import Case
from fuzzing.trials import Verdict, fresh_folder, time_limit, try_case

__all__ = ["Worker", "run_all"]

_MOST_MEMORY = 4 << 30
# A worker is ended when a mutant has taken this many times its processor time by the clock: the machine may
# be busy with other things.
_PATIENCE = 8.0
# Mutants after which a worker is replaced, so that memory that is never freed does not add up.
_LIFETIME = 5000

Make = Callable[[int], Case]


class Worker:
    """A process, forked from this one, that tries one mutant after another.

    Parameters
    ----------
    number : int
    folder : Path
        For its files.
    """

    def __init__(self, number: int, folder: Path) -> None:
        self._number, self._folder = number, folder
        self._log = folder / f"worker-{number}.log"
        self.current: Case | None = None
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("fork")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, self._folder / f"mutant-{self._number}", self._log), daemon=True
        )
        self._process.start()
        theirs.close()
        self._done = 0

    def give(self, case: Case) -> None:
        """Have it try a mutant."""
        if self._done >= _LIFETIME:
            self.stop()
            self._start()
        self.current, self._began = case, time.monotonic()
        self._done += 1
        self.connection.send(case)

    def overdue(self) -> bool:
        """Whether its mutant has taken too long."""
        if self.current is None:
            return False
        return time.monotonic() - self._began > _PATIENCE * time_limit(self.current)

    def result(self) -> Verdict:
        """Return the verdict on its mutant, once it has come; a process that has died is replaced."""
        try:
            verdict: Verdict = self.connection.recv()
        except (EOFError, ConnectionResetError):
            self._process.join()
            verdict = Verdict("crash", f"exit status {self._process.exitcode}", self._last_place())
            self._start()
        self.current = None
        return verdict

    def end_hanging(self) -> Verdict:
        """End the process, which is replaced, and return the verdict on its mutant."""
        assert self.current is not None  # noqa: S101
        os.kill(self._process.pid or 0, signal.SIGABRT)
        self._process.join(5)
        self.stop()
        verdict = Verdict("hang", f"for {time.monotonic() - self._began:.0f} s", self._last_place())
        self._start()
        self.current = None
        return verdict

    def stop(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self.connection.close()

    def _last_place(self) -> str:
        """The innermost line of cmbot in the traceback that the dying process has left."""
        lines = self._log.read_text("utf-8", "replace").splitlines()
        return next((line.strip()[:120] for line in lines if "/cmbot/" in line), "?")


def _serve(connection: Connection, folder: Path, log: Path) -> None:
    """Try the mutants that come through a connection, until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with log.open("w") as file:
        faulthandler.enable(file)
        # What libraries print is no message of cmbot's.
        os.dup2(os.open(os.devnull, os.O_RDWR), 0)
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        # Beside what the process has by then: with many cores, threads of libraries have reserved much.
        most = _MOST_MEMORY + psutil.Process().memory_info().vms
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        while True:
            try:
                case = connection.recv()
            except EOFError:
                return
            os.chdir(fresh_folder(folder))
            file.truncate(0)
            connection.send(try_case(case, folder))


def run_all(
    make: Make, indices: Iterator[int], workers: int, folder: Path, until: float
) -> Iterator[tuple[Case, Verdict]]:
    """Try mutants, until they or the time are used up.

    Parameters
    ----------
    make : callable
        From an index to its mutant.
    indices : iterator of int
    workers : int
        Number of processes.
    folder : Path
        For their files.
    until : float
        By the monotonic clock.
    """
    free = [Worker(number, folder) for number in range(workers)]
    busy: dict[Any, Worker] = {}
    left = True
    try:
        while True:
            while free and left:
                index = next(indices, None) if time.monotonic() < until else None
                if index is None:
                    left = False
                    break
                worker = free.pop()
                worker.give(make(index))
                busy[worker.connection] = worker
            if not busy:
                return
            ready = wait(list(busy), timeout=1.0)
            hanging = [connection for connection, worker in busy.items() if worker.overdue()]
            for connection in {*ready, *hanging}:
                worker = busy.pop(connection)
                case = worker.current
                verdict = worker.result() if connection in ready else worker.end_hanging()
                free.append(worker)
                yield case, verdict
    finally:
        for worker in [*free, *busy.values()]:
            worker.stop()
