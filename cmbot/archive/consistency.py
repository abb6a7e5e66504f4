"""Consistency of records: what one says of a thing is what is computed of it again."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import ConfigDict

from cmbot.common.errors import ArchiveError
from cmbot.common.validation import FileModel, shown

# By how much numbers may differ, as a share and at least.
_SAME = 1e-9


class Entry(FileModel):
    """What is read of an entry; all else in it is computed again."""

    model_config = ConfigDict(extra="ignore")


def require_same(
    got: object,
    expected: object,
    source: str,
    key: str,
    tolerance: float = _SAME,
    zero: float = _SAME,
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
    elif isinstance(got, list | tuple) and isinstance(expected, list | tuple) and len(got) == len(expected):
        for k, (one, other) in enumerate(zip(got, expected, strict=True)):
            require_same(one, other, source, f"{key}[{k}]", tolerance, zero, why)
    elif not isinstance(got, bool) and isinstance(got, int | float) and isinstance(expected, int | float):
        if got != expected and not abs(got - expected) <= zero + tolerance * abs(expected):
            raise ArchiveError(source, key, got, f"{expected:g}, as {why}")
    elif got != expected:
        given, wanted = ("null" if value is None else shown(value) for value in (got, expected))
        raise ArchiveError(source, key, given, f"{wanted}, as {why}")
