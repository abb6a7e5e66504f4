"""Calls that are made on other processors, each of them by a process of its own."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache, partial
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Any, Generic, ParamSpec, Self, TypeVar

from threadpoolctl import threadpool_limits

from cmbot.common.errors import CmbotError

P = ParamSpec("P")
T = TypeVar("T")


class Call(Generic[T]):
    """A call whose result is wanted later.

    Parameters
    ----------
    result : callable
        Makes it, or waits for it.
    has_begun : callable
        Whether a process is at it, or was.
    """

    def __init__(self, result: Callable[[], T], has_begun: Callable[[], bool]) -> None:
        self.result, self.has_begun = result, has_begun


class Workers:
    """Processes that make calls beside each other; the calling one alone makes each when it is asked for.

    Functions, arguments and results have to be picklable. Each process reads the modules anew, so a script
    that uses some has to call from below ``if __name__ == "__main__"``. They end with the context, whatever
    they are at.

    Parameters
    ----------
    number : int
        Of processes; with 1 there is no other one. They begin where calls wait for them.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._pool: ProcessPoolExecutor | None = None
        self._functions = dict[Callable[..., Any], bytes]()
        self._lasts: Connection | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None and self._lasts is not None:
            self._lasts.close()
            self._pool.shutdown(cancel_futures=True)

    def call(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Call[T]:
        """Have a function called by the next process that is free.

        Where that is ended before, the result is a `CmbotError`.
        """
        if self._number == 1:
            return Call(lambda: function(*args, **kwargs), lambda: False)
        if self._pool is None:
            # What is forked from a process with threads may hang.
            context = multiprocessing.get_context("spawn")
            closes, self._lasts = context.Pipe(duplex=False)
            self._pool = ProcessPoolExecutor(self._number, context, initializer=_begin, initargs=(closes,))
        # What a function is bound to may be large: it is pickled once. And arguments here and now: what a
        # thread of the pool would pickle may change meanwhile.
        if function not in self._functions:
            self._functions[function] = pickle.dumps(function)
        called: Future[T] = self._pool.submit(_alone, self._functions[function], pickle.dumps((args, kwargs)))
        return Call(partial(_result, called), lambda: called.running() or called.done())


def processors() -> int:
    """Return how many processors this process may use."""
    of_process: Callable[[int], Any] | None = getattr(os, "sched_getaffinity", None)
    return (os.cpu_count() or 1) if of_process is None else len(of_process(0))


def _result(called: Future[T]) -> T:
    try:
        return called.result()
    except BrokenProcessPool as error:
        why = "a process has ended before its call was done, as where memory is short; fewer need less: jobs"
        raise CmbotError(why) from error


_unpickled = lru_cache(maxsize=8)(pickle.loads)


def _alone(function: bytes, pickled: bytes) -> Any:
    args, kwargs = pickle.loads(pickled)
    # As many threads of linear algebra as there are processors would wait for each other in each process.
    with threadpool_limits(limits=1, user_api="blas"):
        return _unpickled(function)(*args, **kwargs)


def _begin(closes: Connection) -> None:
    """Leave Ctrl-C to the process that waits, and end as soon as it does or its context does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end() -> None:
        wait([closes])
        os._exit(0)

    threading.Thread(target=end, daemon=True).start()
