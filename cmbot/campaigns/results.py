"""The results of a campaign as one table: a row for each job, a column for each figure."""

from __future__ import annotations

import hashlib
import io
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from cmbot.campaigns.campaign_file import Entry
from cmbot.campaigns.task import TaskResult, TaskStatus
from cmbot.common.errors import optional_module

PLANS = "plans"
"""Folder of the plan directories: in 256 folders, so that none has too many."""

# Of entries of a result: texts that the table has whole, or that are no figures.
_ENTRIES_NOT_SHOWN = ("ended", "reason", "remarks")
# The keys of limits, by how jobs end that would need more.
_LIMIT_KEYS = {"timed out": "time_limit_s", "out of memory": "memory_limit_mb"}


def plan_place(name: str) -> str:
    """Return where in the campaign's folder the plan of a job is: ``plans/3f/NAME``."""
    return f"{PLANS}/{hashlib.sha256(name.encode()).hexdigest()[:2]}/{name}"


def given_cells(entry: Entry) -> dict[str, Any]:
    """Return what is known of a job beforehand, by the names of columns."""
    values = {sys.intern(f"set.{key}"): _cell(given) for key, given in entry.values.items()}
    return {"name": entry.name, "at_m": entry.at_m, **values}


def result_row(given: Mapping[str, Any], result: TaskResult, place: str) -> dict[str, Any]:
    """Return what became of a job: text, numbers and None by the names of columns.

    ``ended`` is ``planned``, ``no plan``, ``refused``, ``crashed``, ``timed out``, ``out of memory``, or
    ``failed``: an error in cmbot. ``reason`` says why in a line, and is empty where it is planned.

    Parameters
    ----------
    given : mapping
        As `given_cells` returns them.
    result : TaskResult
    place : str
        Of the plan directory in the campaign's folder.
    """
    value: Mapping[str, Any] = result.value if isinstance(result.value, dict) else {}
    planned = value.get("ended") == "planned"
    return {
        **given,
        "ended": value.get("ended") or _end(result),
        "reason": _reason(result) or value.get("reason", ""),
        "plan": place if planned else None,
        "attempts": result.attempts,
        "seconds": result.seconds,
        "cpu_seconds": result.cpu_seconds,
        **_flat({name: each for name, each in value.items() if name not in _ENTRIES_NOT_SHOWN}),
    }


def _reason(result: TaskResult) -> str:
    key = _LIMIT_KEYS.get(_end(result))
    return f"{result.error} ({key})" if key else result.error


def _end(result: TaskResult) -> str:
    if result.status is TaskStatus.RAISED:
        return "out of memory" if result.error.startswith("MemoryError") else "failed"
    return str(result.status)


def _flat(value: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found = dict[str, Any]()
    for name, each in value.items():
        if isinstance(each, Mapping):
            found |= _flat(each, f"{prefix}{name}.")
        else:
            # Rows have the same names of columns, which take more memory than the figures.
            found[sys.intern(f"{prefix}{name}")] = each
    return found


def _cell(value: Any) -> Any:
    return value if isinstance(value, int | float | str | bool | None) else str(value)


def parquet(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Return a table as a Parquet file; a column that has text and numbers becomes one of text.

    Raises
    ------
    MissingExtra
        When pyarrow is not installed.
    """
    pyarrow = require_pyarrow()
    columns = dict[str, list[Any]]()
    for name in dict.fromkeys(name for row in rows for name in row):
        column = [row.get(name) for row in rows]
        kinds = {type(value) for value in column if value is not None}
        if len(kinds) > 1:
            to = float if kinds == {int, float} else str
            column = [None if value is None else to(value) for value in column]
        columns[name] = column
    stream = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(columns), stream)
    return stream.getvalue()


def require_pyarrow() -> Any:
    """Return the module ``pyarrow``; a `MissingExtra` where it is not installed."""
    optional_module("pyarrow.parquet", "pyarrow", "campaign")
    return optional_module("pyarrow", "pyarrow", "campaign")
