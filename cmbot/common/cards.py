"""What a notebook shows of an object: a card of HTML with a title, a sentence and a table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

__all__ = ["card"]

# Readable on light and on dark ground: no colours but the text's own.
_BOX = "border:1px solid rgba(128,128,128,.5);border-radius:8px;padding:8px 14px;display:inline-block"
_CELL = "padding:1px 14px 1px 0;border:0"


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
        f'<div style="{_BOX}"><strong>{escape(title)}</strong>'
        f"{f'<div>{escape(sentence)}</div>' if sentence else ''}{table if body else ''}</div>"
    )


def _row(tag: str, texts: Sequence[str]) -> str:
    # A single column beside the names has words, several have numbers.
    side = "right" if len(texts) > 2 else "left"
    cells = (
        f'<{tag} style="{_CELL};text-align:{side if number else "left"}">{escape(text)}</{tag}>'
        for number, text in enumerate(texts)
    )
    return f"<tr>{''.join(cells)}</tr>" if texts else ""
