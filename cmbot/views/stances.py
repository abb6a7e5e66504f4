"""The page of `cmbot stand`: a map of the stances along the guardrail, and the ranked table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from cmbot.siting import Standing, Stood, in_words, shared_out
from cmbot.views.page import still_page, table

__all__ = ["stances_page"]

_WIDTH, _HEIGHT, _EDGE = 900, 360, 50
_COLOURS = {
    "planned": "#1a7f37",
    "screened": "#2f6fb7",
    "failed": "#c0392b",
    "blocked": "#b26a00",
    "no posture": "#8a8f98",
    "out of reach": "#c9ced6",
}
# Rows of the table.
_ROWS = 60


def stances_page(standings: Sequence[Standing]) -> str:
    """Return an HTML page that opens no connection and runs no script.

    Parameters
    ----------
    standings : sequence of Standing
        As `cmbot.siting.stand` returns them.
    """
    name, several = standings[0].scene.name, len(standings) > 1
    content = ""
    for number, standing in enumerate(standings, start=1):
        if several:
            content += f"<h2>Stance {number}: {escape(', '.join(standing.strokes))}</h2>"
            content += "".join(f"<p>{escape(sentence)}</p>" for sentence in in_words(standing))
        content += f"<section>{_map(standing)}</section><section>{_table(standing)}</section>"
    said = shared_out(standings) if several else in_words(standings[0])
    return still_page(f"Where to stand: {name}", said, content)


def _table(standing: Standing) -> str:
    unit = standing.unit
    figures = (f"bound, {unit}", f"planned, {unit}", "torque at rest, Nm", "adhesion, kN")
    rows = (_row(rank, each) for rank, each in enumerate(standing.ranked[:_ROWS], start=1))
    return table(rows, ("", "stance", "status", "judged by", *figures), text_columns=4)


def _row(rank: int, each: Stood) -> tuple[str, ...]:
    planned = "" if each.plan is None else f"{each.plan.objective.planned_peak:.1f}"
    bound, torque, adhesion = ("", "", "")
    if np.isfinite(each.bound):
        bound, torque, adhesion = f"{each.bound:.1f}", f"{each.torque:.1f}", f"{each.adhesion / 1e3:.2f}"
    return (str(rank), each.place, each.status, each.judged, bound, planned, torque, adhesion)


def _map(standing: Standing) -> str:
    """Position of foot 1 along the guardrail against the bound; those without one along the upper edge."""
    finite = [each.bound for each in standing.ranked if np.isfinite(each.bound)]
    xs = [float(each.candidate.root[0, 3]) for each in standing.ranked]
    if not finite or not xs:
        return ""
    low, high = min(xs), max(max(xs), min(xs) + 1e-3)
    top = float(np.quantile(finite, 0.98)) * 1.1
    marks = "".join(_marks(standing, low, high, top))
    labels = "".join(
        f'<text x="{_EDGE + share * (_WIDTH - 2 * _EDGE):.0f}" y="{_HEIGHT - 15}" font-size="13" '
        f'text-anchor="middle">x = {low + share * (high - low):.1f} m</text>'
        for share in (0.0, 0.5, 1.0)
    )
    legend = "".join(
        f'<circle cx="{_EDGE + 120 * k}" cy="12" r="4" fill="{colour}"/>'
        f'<text x="{_EDGE + 120 * k + 8}" y="16" font-size="13">{name}</text>'
        for k, (name, colour) in enumerate(_COLOURS.items())
    )
    scale = (
        f'<text x="4" y="{_y(top, top):.0f}" font-size="13">{top:.3g} {escape(standing.unit)}</text>'
        f'<text x="4" y="{_y(0, top):.0f}" font-size="13">0</text>'
    )
    drawn = f"{legend}{scale}{labels}{marks}"
    return f'<div class="wide"><svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img">{drawn}</svg></div>'


def _marks(standing: Standing, low: float, high: float, top: float) -> Iterator[str]:
    # The best last, above the others.
    for each in reversed(standing.ranked):
        x = _EDGE + (float(each.candidate.root[0, 3]) - low) / (high - low) * (_WIDTH - 2 * _EDGE)
        y = _y(min(each.bound, top), top) if np.isfinite(each.bound) else 34.0
        radius = 5 if each.status == "planned" else 2.5
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{_COLOURS[each.status]}"/>'


def _y(value: float, top: float) -> float:
    return 50 + (1 - value / top) * (_HEIGHT - 100)
