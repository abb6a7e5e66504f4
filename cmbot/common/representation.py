"""How objects are shown: a short repr for dataclasses of arrays, and a card of HTML in a notebook."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields
from html import escape
from typing import Any

LONGEST_REPR = 300
"""Characters of a short repr at most."""

# Characters of a field's value at most.
_MAX_VALUE_CHARACTERS = 60
# Readable on light and on dark ground: no colours but the text's own.
_BOX_STYLE = "border:1px solid rgba(128,128,128,.5);border-radius:8px;padding:8px 14px;display:inline-block"
_CELL_STYLE = "padding:1px 14px 1px 0;border:0"


def short_repr(self: Any) -> str:
    """Return a dataclass's name and its fields but those at their defaults: scalars, of the rest their size.

    To be its `__repr__`; cut at `LONGEST_REPR` characters.

    Examples
    --------
    >>> cmbot.PlannerOptions(solver="slsqp")
    PlannerOptions(solver='slsqp')
    """
    changed = {
        field.name: getattr(self, field.name)
        for field in fields(self)
        if field.repr and not _is_default(getattr(self, field.name), field.default)
    }
    return fields_repr(type(self).__name__, changed)


class ShortRepr:
    """Base of dataclasses whose repr is `short_repr`, but for those that have another one."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # In each class itself: a dataclass without one of its own gets a long one.
        if "__repr__" not in vars(cls):
            cls.__repr__ = short_repr  # type: ignore[method-assign]


def fields_repr(name: str, values: Mapping[str, object]) -> str:
    """Return the short repr of a class of that name with these fields."""
    room, shown = LONGEST_REPR - len(name) - len("(...)"), list[str]()
    for key, value in values.items():
        part = f"{key}={_short(value)}"
        room -= len(part) + len(", ")
        if room < 0:
            shown.append("...")
            break
        shown.append(part)
    return f"{name}({', '.join(shown)})"


def aligned(rows: Sequence[Sequence[str]], text_columns: int = 1, least: int = 12) -> str:
    """Return rows as an aligned table of plain text: names, then values in columns of a `least` width."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    formats = [f"<{w}" if k < text_columns else f">{max(w, least)}" for k, w in enumerate(widths)]
    return "\n".join("  ".join(map(format, cells, formats)).rstrip() for cells in rows)


def card(
    title: str, sentence: str = "", rows: Iterable[Sequence[str]] = (), headings: Sequence[str] = ()
) -> str:
    """Return a card as HTML; all that is given is text, and stays text.

    Parameters
    ----------
    title, sentence : str
    rows : iterable of sequences of str
        Of a table: names, then values.
    headings : sequence of str, optional
    """
    head = _row("th", headings)
    body = "".join(_row("td", row) for row in rows)
    table = f'<table style="margin:6px 0 0;border-collapse:collapse">{head}{body}</table>'
    return (
        f'<div style="{_BOX_STYLE}"><strong>{escape(title)}</strong>'
        f"{f'<div>{escape(sentence)}</div>' if sentence else ''}{table if body else ''}</div>"
    )


def _is_default(value: object, default: object) -> bool:
    if default is MISSING or hasattr(value, "shape"):
        return False
    return value is default or (type(value) is type(default) and value == default)


def _short(value: object) -> str:
    # NumPy need not be loaded for it.
    if hasattr(value, "shape"):
        return f"<array {'x'.join(map(str, value.shape))}>"
    if isinstance(value, float):
        return f"{value:.6g}"
    if value is None or isinstance(value, (str, bool, int)):
        text = repr(value)
    elif isinstance(value, (tuple, list, set, frozenset, dict)):
        plain = all(each is None or isinstance(each, (str, bool, int, float)) for each in value)
        text = repr(value) if plain and not isinstance(value, dict) else ""
        return text if text and len(text) <= _MAX_VALUE_CHARACTERS else f"<{len(value)} items>"
    else:
        return f"<{type(value).__name__}>"
    return text if len(text) <= _MAX_VALUE_CHARACTERS else f"{text[: _MAX_VALUE_CHARACTERS - 1]}…"


def _row(tag: str, texts: Sequence[str]) -> str:
    # A single column beside the names has words, several have numbers.
    side = "right" if len(texts) > 2 else "left"
    cells = (
        f'<{tag} style="{_CELL_STYLE};text-align:{side if number else "left"}">{escape(text)}</{tag}>'
        for number, text in enumerate(texts)
    )
    return f"<tr>{''.join(cells)}</tr>" if texts else ""
