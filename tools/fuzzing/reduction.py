"""Smaller mutants with the same finding."""

from __future__ import annotations

import time
from pathlib import Path

from fuzzing.cases import Case
from fuzzing.trials import Verdict
from fuzzing.workers import run_all

__all__ = ["reduced"]

_MOST_TRIALS = 150
_MOST_SECONDS = 60.0


def reduced(case: Case, verdict: Verdict, folder: Path) -> Case:
    """Return the case with files shortened as long as the finding stays the same.

    Parameters
    ----------
    case : Case
    verdict : Verdict
    folder : Path
        For trials.
    """
    if verdict.outcome in ("hang", "slow"):
        return case
    trials = _Trials(verdict, folder)
    for name in sorted(case.files):
        smaller = case.with_files({each: content for each, content in case.files.items() if each != name})
        case = smaller if trials.alike(smaller) else case
    for name in sorted(case.files):
        lines = case.files[name].split(b"\n")
        step = max(len(lines) // 2, 1)
        while step >= 1 and trials.left():
            at = 0
            while at < len(lines) and trials.left():
                fewer = lines[:at] + lines[at + step :]
                smaller = case.with_files(case.files | {name: b"\n".join(fewer)})
                if trials.alike(smaller):
                    case, lines = smaller, fewer
                else:
                    at += step
            step //= 2
    return case


class _Trials:
    """Trials of smaller cases, up to a number and a time."""

    def __init__(self, verdict: Verdict, folder: Path) -> None:
        self._verdict, self._folder = verdict, folder
        self._number, self._until = 0, time.monotonic() + _MOST_SECONDS

    def left(self) -> bool:
        """Whether another one may be tried."""
        return self._number < _MOST_TRIALS and time.monotonic() < self._until

    def alike(self, case: Case) -> bool:
        """Whether a case has the finding."""
        if not self.left():
            return False
        self._number += 1
        ((_, verdict),) = run_all(lambda _: case, iter([0]), 1, self._folder, self._until + 1)
        return verdict.cause == self._verdict.cause
