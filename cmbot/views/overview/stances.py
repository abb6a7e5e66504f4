"""The page of `cmbot stand`: a map of the stances along the guardrail, and the ranked table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from cmbot.planning import robot_of, strokes_of
from cmbot.stances import Candidate, StanceRanking, bounds_table, in_words, planned_table, shared_out
from cmbot.views.overview.guardrail_map import Stand, guardrail_map
from cmbot.views.page import still_page, table, ticks

_WIDTH_PX, _SVG_HEIGHT, _EDGE_PX = 900, 380, 60
_LABEL = (18.0, 13.0)  # room for a number beside a dot, px
# Where stances without a bound are drawn.
_UNBOUNDED_ROW_PX = 42.0
_DOT_COLOURS = {
    "planned": "#1a7f37",
    "not judged": "#0f766e",
    "screened": "#2f6fb7",
    "failed": "#c0392b",
    "beyond a bound": "#8e44ad",
    "blocked": "#b26a00",
    "no posture": "#8a8f98",
    "out of reach": "#c9ced6",
}
# Rows of the table, and those of them that are open.
_ROWS, _OPEN = 60, 10
# Sentences above the map; the others follow the tables.
_FIRST = 3
_MEANINGS = {
    "torque": "peak torque on the base at work",
    "hold": "adhesion needed over the job",
    "sag": "sag of the tool at work",
    "sway": "sway of the tool on a shaken deck",
}
_PLANNED_LEGEND = "Numbered: the peak that was planned. Others: an"
_CAPTION = (
    " estimate of a stance's lower bound; along the upper edge those without one. Pointing at a dot tells "
    "its stance."
)


def stances_page(rankings: Sequence[StanceRanking], name: str | None = None) -> str:
    """Return an HTML page that opens no connection and runs no script.

    Parameters
    ----------
    rankings : sequence of StanceRanking
        As `cmbot.stances.stand` returns them.
    name : str, optional
        What they are for; the name of the first one's scene if left out.
    """
    several, said = len(rankings) > 1, list(shared_out(rankings))
    content = ""
    for number, ranking in enumerate(rankings, start=1):
        sentences = list(in_words(ranking))
        first, others = sentences[:_FIRST], sentences[_FIRST:]
        if several:
            content += f"<h2>Stance {number}: {escape(', '.join(ranking.strokes))}</h2>{_paragraphs(first)}"
        else:
            said = first
        content += _where(ranking) + _tables(ranking) + _map(ranking)
        content += f"<h2>Remarks</h2><section>{_paragraphs(others)}</section>" if others else ""
    return still_page(f"Where to stand: {name or rankings[0].scene.name}", said, content)


def _paragraphs(sentences: Sequence[str]) -> str:
    return "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)


def _where(ranking: StanceRanking) -> str:
    """Where the feet of the first stance hold, on the guardrail."""
    first = next((each for each in ranking.ranked if each.rejection is None), None)
    if first is None or not isinstance(first.candidate, Candidate):
        return ""  # mounts are on no guardrail
    paths = [stroke.path.outline() for stroke in strokes_of(ranking.scene, robot_of(ranking.scene))]
    names = ("the most promising stance", "the only stance planned", "the best stance")
    name = names[min(ranking.count("planned"), 2)]
    drawn = guardrail_map(ranking.scene, [], [Stand(first.candidate, name, paths)])
    return f"<section>{drawn}</section>"


def _tables(ranking: StanceRanking) -> str:
    """What was planned, and apart from it the others, of which only bounds are known."""
    content = ""
    headings, rows = planned_table(ranking)
    if rows:
        content += f"<h2>Planned</h2><section>{table(rows, headings, text_columns=2)}</section>"
    headings, rows = bounds_table(ranking, _ROWS)
    if rows:
        said = "Not planned: bounds, estimates by which the search proceeds"
        shown = table(rows[:_OPEN], headings, text_columns=4)
        if more := rows[_OPEN:]:
            words = f"{len(more)} more"
            shown += f"<details><summary>{words}</summary>{table(more, headings, text_columns=4)}</details>"
        content += f"<h2>{said}</h2><section>{shown}</section>"
    return content


def _map(ranking: StanceRanking) -> str:
    """Position of foot 1 against what is planned or the bound; those without one along the upper edge."""
    # Where the time was over before any was known they are zero.
    finite = [each.bound for each in ranking.ranked if 0 < each.bound < np.inf]
    xs = [float(each.candidate.root[0, 3]) for each in ranking.ranked]
    if not finite or not xs:
        return ""
    low, high = min(xs), max(max(xs), min(xs) + 1e-3)
    top = float(np.quantile(finite, 0.98)) * 1.1
    marks = "".join(_marks(ranking, low, high, top))
    legend, x = "", _EDGE_PX
    for name, colour in _DOT_COLOURS.items():
        if ranking.count(name):
            legend += (
                f'<circle cx="{x}" cy="12" r="4" fill="{colour}"/><text x="{x + 8}" y="16">{name}</text>'
            )
            x += 40 + 8 * len(name)
    drawn = f'<g font-size="13">{legend}{"".join(_axes(low, high, top, ranking.unit))}</g>{marks}'
    where = "foot 1 holds" if ranking.scene.on_guardrail else "the base frame is"
    said = f"All stances, by where {where} and by the {_MEANINGS[ranking.objective]}"
    svg = f'<svg viewBox="0 0 {_WIDTH_PX} {_SVG_HEIGHT}" role="img" aria-label="{said}">{drawn}</svg>'
    svg = f'<div class="wide" tabindex="0">{svg}</div>'
    caption = (_PLANNED_LEGEND if ranking.count("planned") else "An") + _CAPTION
    return f'<h2>{said}</h2><section>{svg}<p class="caption">{caption}</p></section>'


def _axes(low: float, high: float, top: float, unit: str) -> Iterator[str]:
    """Lines and numbers."""
    for value in ticks(0.0, top, 5):
        y = _y(value, top)
        yield f'<path d="M{_EDGE_PX} {y:.0f}H{_WIDTH_PX - _EDGE_PX}" stroke="#8a8f98" stroke-opacity="0.25"/>'
        yield f'<text x="{_EDGE_PX - 8}" y="{y + 4:.0f}" text-anchor="end">{value:g}</text>'
    yield f'<text x="4" y="38">{escape(unit)}</text>'
    for value in ticks(low, high, 8):
        x = _x(value, low, high)
        yield f'<text x="{x:.0f}" y="{_SVG_HEIGHT - 28}" text-anchor="middle">{value:g}</text>'
    said = "x, m"
    yield f'<text x="{_WIDTH_PX // 2}" y="{_SVG_HEIGHT - 8}" text-anchor="middle">{said}</text>'


def _marks(ranking: StanceRanking, low: float, high: float, top: float) -> Iterator[str]:
    labels = list[tuple[float, float, int]]()
    # The best last, above the others.
    for rank, each in reversed([*enumerate(ranking.ranked, start=1)]):
        x = _x(float(each.candidate.root[0, 3]), low, high)
        value = each.value if each.status == "planned" else each.bound
        known = np.isfinite(value)
        y = _y(min(value, top), top) if known else _UNBOUNDED_ROW_PX
        radius = 5 if each.status == "planned" else 2.5
        figure = f", {value:.4g} {ranking.unit}" if known else ""
        said = escape(f"{rank}: {each.place}, {each.status}{figure}")
        circle = f'cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{_DOT_COLOURS[each.status]}"'
        yield f"<circle {circle}><title>{said}</title></circle>" if known else f"<circle {circle}/>"
        if each.status == "planned":
            labels.append((x + 8, y + 4, rank))
    for x, y, rank in _apart(labels):
        yield f'<text class="label" x="{x:.1f}" y="{y:.1f}" font-size="13">{rank}</text>'


def _apart(labels: Sequence[tuple[float, float, int]]) -> Iterator[tuple[float, float, int]]:
    """Labels at x, y, px, the best below: those that would be drawn over each other are moved up."""
    placed = list[tuple[float, float]]()
    for x, y, rank in sorted(labels, key=lambda label: -label[1]):
        above = [other for left, other in placed if abs(x - left) < _LABEL[0] and other - y < _LABEL[1]]
        at = min([y, *(other - _LABEL[1] for other in above)])
        placed.append((x, at))
        yield x, at, rank


def _x(value: float, low: float, high: float) -> float:
    return _EDGE_PX + (value - low) / (high - low) * (_WIDTH_PX - 2 * _EDGE_PX)


def _y(value: float, top: float) -> float:
    return 60 + (1 - value / top) * (_SVG_HEIGHT - 110)
