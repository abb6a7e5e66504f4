"""The tables of assumptions, from the page that is their one source."""

from __future__ import annotations

import re
from dataclasses import dataclass

from cmbot.common.resources import assumptions_file

__all__ = ["AssumptionTable", "assumption_tables"]

_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")


@dataclass(frozen=True, kw_only=True)
class AssumptionTable:
    """One section of the page.

    Attributes
    ----------
    heading : str
    columns : tuple of str
        What, value, provenance, and in most of them why.
    rows : tuple of tuple of str
    """

    heading: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def assumption_tables() -> tuple[AssumptionTable, ...]:
    """Read every table of ``docs/assumptions.md`` that names provenances; links keep their text alone."""
    heading, table, tables = "", [], []
    for line in [*assumptions_file().read_text(encoding="utf-8").splitlines(), ""]:
        if line.startswith("|"):
            table.append(tuple(cell.strip() for cell in _LINK.sub(r"\1", line).strip("|").split("|")))
            continue
        if table and "provenance" in table[0]:
            tables.append(AssumptionTable(heading=heading, columns=table[0], rows=tuple(table[2:])))
        table = []
        if line.startswith("## "):
            heading = line[3:]
    return tuple(tables)
