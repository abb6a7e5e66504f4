"""Records: JSON of bounded size, whose entries are what is computed again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, TypeGuard

from pydantic import ConfigDict
from pydantic_core import from_json

from cmbot.common.errors import ArchiveError
from cmbot.common.reading.validation import FileModel, counted, require_unique_keys, shown

PLAN_FILE, WALK_FILE, TOUR_FILE, STANCES_FILE = "plan.json", "walk.json", "tour.json", "stances.json"
EVALUATION_FILE = "evaluation.json"
FORMATS = {
    PLAN_FILE: "cmbot-plan/2",
    WALK_FILE: "cmbot-walk/1",
    TOUR_FILE: "cmbot-tour/1",
    STANCES_FILE: "cmbot-stances/1",
    EVALUATION_FILE: "cmbot-evaluation/1",
}
"""The records of folders, which name all other files there, and their formats."""
JOB_FILES = ("job.csv", "job.npz")
"""The whole job on one clock."""
BASELINE_FILE = "baseline.csv"
"""The baseline's work, where one is asked for."""
PLAN_FILES = (*JOB_FILES, BASELINE_FILE)
"""What a plan is read from, beside its record."""
TRACKING_FILES = ("tracking.csv", "tracking_baseline.csv", "tracking.json")
"""Those of a plan that has been simulated: the tables of both motions, and the metrics."""
EXCITATION_FILE = "excitation.json"
"""That of a plan that has been shaken."""

_PLOT_FILES = (
    *("guardrail_torque", "joints", "clearance", "tool_deviation"),
    *("tracking_error", "tracking_dynamic", "tracking_path", "tracking_residual"),
)
SHOWN_FILES = (
    "replay.html",
    "report.html",
    "excitation.html",
    *(f"{plot}.{kind}" for plot in _PLOT_FILES for kind in ("png", "svg", "pdf")),
)
"""Pages and plots."""
OWN_FILES = frozenset({PLAN_FILE, *PLAN_FILES, *TRACKING_FILES, EXCITATION_FILE, *SHOWN_FILES})
"""All files that belong to a plan."""


# By how much numbers may differ, as a share and at least.
_RECORD_TOLERANCE = 1e-9
# No plan has as many: 20,000 via-points make 20,000 numbers, 2,000 legs and 1,000 obstacles some ten each.
_MAX_RECORD_VALUES = 200_000


def read_json(content: bytes, source: str) -> dict[str, Any]:
    """Return the JSON object in a file's `content`; errors name `source` as the file.

    Refused is what is no JSON in UTF-8 or no object, has a number that is none, a key twice in one object, or
    brackets deeper than 200. So is JSON of more than 200,000 values, counted before anything is made of it.
    """
    # Each value comes after a comma or an opening bracket.
    if sum(map(content.count, (b",", b"[", b"{"))) > _MAX_RECORD_VALUES:
        raise ArchiveError(source, "", "more values", f"at most {_MAX_RECORD_VALUES}")
    try:
        data = from_json(content, allow_inf_nan=False)
    except ValueError as error:
        got = f"text that is no JSON ({error})"
        with suppress(ValueError):
            from_json(content)  # which takes NaN
            got = f"NaN or Infinity{str(error)[str(error).find(' at line') :]}"
        raise ArchiveError(source, "", got, "valid JSON in UTF-8, its numbers finite") from error
    require_unique_keys(content, source, ArchiveError)
    if not isinstance(data, dict):
        raise ArchiveError(source, "", shown(data), "a JSON object")
    return data


def json_bytes(data: object, *, indent: int | None = None) -> bytes:
    """Return `data` as JSON; its keys keep their order. A number that is not finite is a ValueError."""
    text = json.dumps(data, indent=indent, ensure_ascii=False, allow_nan=False)
    return f"{text}\n".encode()


class Entry(FileModel):
    """What is read of an entry; all else in it is computed again."""

    model_config = ConfigDict(extra="ignore")


def require_same(
    got: object,
    expected: object,
    source: str,
    key: str,
    tolerance: float = _RECORD_TOLERANCE,
    zero: float = _RECORD_TOLERANCE,
    why: str = "computed again",
) -> None:
    """Refuse an entry that differs from what the other entries, or what is computed again, make of it.

    Numbers may differ by `tolerance` as a share, or by `zero`. Where a peak is reached twice, its time is not
    determined.
    """
    if isinstance(got, Mapping) and isinstance(expected, Mapping):
        for name in (*expected, *(got.keys() - expected.keys())):
            where = f"{key}.{name}" if key else str(name)
            if name not in got:
                raise ArchiveError(source, where, "nothing", f"{shown(expected[name])}, as {why}")
            if name not in expected:
                raise ArchiveError(source, where, shown(got[name]), f"no such key, as {why}")
            if name != "time":
                require_same(got[name], expected[name], source, where, tolerance, zero, why)
    elif isinstance(got, list | tuple) and isinstance(expected, list | tuple):
        if len(got) != len(expected):
            raise ArchiveError(
                source, key, counted(len(got), "entry", "entries"), f"{len(expected)}, as {why}"
            )
        for k, (one, other) in enumerate(zip(got, expected, strict=True)):
            require_same(one, other, source, f"{key}[{k}]", tolerance, zero, why)
    elif _is_number(got) and _is_number(expected):
        if got != expected and not abs(got - expected) <= zero + tolerance * abs(expected):
            alike = f"{got:g}" == f"{expected:g}"
            raise ArchiveError(source, key, got, f"{expected:{'.12g' if alike else 'g'}}, as {why}")
    elif got != expected or isinstance(got, bool) != isinstance(expected, bool):
        given, wanted = ("null" if value is None else shown(value) for value in (got, expected))
        raise ArchiveError(source, key, given, f"{wanted}, as {why}")


def _is_number(value: object) -> TypeGuard[float]:
    """Whether it is one in JSON, where true is none."""
    return isinstance(value, int | float) and not isinstance(value, bool)
