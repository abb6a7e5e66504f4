"""The table of attributes in docs/api.md, from the docstrings of the public classes."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from functools import cached_property

import cmbot

CLASSES = (
    *("Plan", "planning.Job", "planning.Segment", "planning.MotionMetrics", "planning.Samples"),
    *("QuinticTrajectory", "Tracking", "simulation.MotionTracking", "simulation.ErrorMetrics"),
    *("simulation.Statistics", "simulation.Residual", "Evaluation", "Excitation", "Campaign"),
    *("Identification", "Location", "Walk", "stances.walking.Step", "stances.walking.Move", "Tour", "Robot"),
)
_UNITS = re.compile(r"(?:(?:^|, )(?:rad|m|s|N|Nm|kg|Hz|mm)(?:/\w+)?)+$")


def attributes(kind: type) -> Iterator[tuple[str, str]]:
    """Yield the public attributes of a class, each with its unit, which may be empty."""
    section = (inspect.getdoc(kind) or "").partition("Attributes\n----------\n")[2]
    section = re.split(r"\n\n\w+\n-+\n", section)[0]
    told = set()
    for names, what in re.findall(r"^(\w[\w, ]*?) ?: ?(.*)$", section, flags=re.MULTILINE):
        several, last = names.split(", "), _UNITS.search(what)
        units = last[0].removeprefix(", ").split(", ") if last else [""]
        told.update(several)
        if len(units) != len(several):
            units = (units if len(units) == 1 else [""]) * len(several)
        yield from zip(several, units, strict=True)
    for name in dir(kind):
        value = inspect.getattr_static(kind, name)
        if isinstance(value, property | cached_property) and not name.startswith("_") and name not in told:
            yield name, ""


def table() -> str:
    """Return the table as Markdown."""
    lines = ["| of | attributes |", "|---|---|"]
    for dotted in CLASSES:
        kind: object = cmbot
        for part in dotted.split("."):
            kind = getattr(kind, part)
        told = ", ".join(f"`{name}`" + f" {unit}" * bool(unit) for name, unit in attributes(kind))
        lines.append(f"| `{dotted.rpartition('.')[2]}` | {told} |")
    return "\n".join(lines)


def page_text(page: str) -> str:
    """Return the text of docs/api.md with the table between its markers."""
    start, end = "<!-- attributes -->\n", "\n<!-- end of attributes -->"
    head, rest = page.split(start)
    return head + start + table() + end + rest.split(end)[1]
