"""The page of `cmbot excite`: figures, the response over frequency and work, and trains over speeds."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.excitation import (
    PASSAGE_HEADINGS,
    Excitation,
    excitation_rows,
    excitation_sentences,
    passage_rows,
    random_inputs,
)
from cmbot.planning import Plan
from cmbot.views.page import still_page, table, ticks

EXCITATION = "excitation.html"

_WIDTH_PX, _HEIGHT_PX, _EDGE_PX = 900, 300, 60
_CURVE_COLOUR, _WARNING = "#2f6fb7", "#c8341f"
_TICK_COUNT, _TICKS_HZ = 5, (0.5, 1, 2, 5, 10, 20, 30)


def excitation_page(plan: Plan, excitation: Excitation) -> str:
    """Return an HTML page that opens no connection and runs no script.

    Parameters
    ----------
    plan : Plan
    excitation : Excitation
        Of that plan.
    """
    content = f"<section>{table(excitation_rows(excitation))}</section>"
    if excitation.passages:
        passages = sorted(excitation.passages, key=lambda passage: passage.speed_km_h)
        speeds = np.array([passage.speed_km_h for passage in passages])
        tool = np.array([passage.tool for passage in passages])
        left = np.array([each.kept is False for each in passages])
        title = "Trains: largest displacement of the tool, mm"
        title += "; red: it leaves its tolerance" if left.any() else ""
        content += _plot(title, "speed, km/h", speeds, 1e3 * tool, left)
        content += f"<section>{table(passage_rows(excitation), PASSAGE_HEADINGS)}</section>"
    content += _plot(
        "Tool by 1 m/s2 of the deck at one frequency, mm",
        "frequency, Hz (logarithmic)",
        excitation.curve_hz,
        1e3 * excitation.curve,
        logarithmic=True,
    )
    sway = excitation.sway or excitation.reference
    title = f"RMS of the tool over the work by {random_inputs(excitation)}, mm"
    content += _plot(title, "time, s", sway.t, 1e3 * sway.rms)
    return still_page(f"What shakes {plan.scene.name}", excitation_sentences(excitation), content)


def _plot(
    title: str,
    axis: str,
    x: FloatArray,
    y: FloatArray,
    warned: BoolArray | None = None,
    *,
    logarithmic: bool = False,
) -> str:
    """A curve with dots where there are few points, red where it warns."""
    along = np.log(x) if logarithmic else x
    low, high = float(along.min()), float(along.max())
    across = _EDGE_PX + (along - low) / max(high - low, 1e-9) * (_WIDTH_PX - 2 * _EDGE_PX)
    top = 1.1 * max(float(y.max()), 1e-9)
    up = _HEIGHT_PX - _EDGE_PX - y / top * (_HEIGHT_PX - 1.5 * _EDGE_PX)
    points = list(zip(across.tolist(), up.tolist(), strict=True))
    drawn = "".join(_scale(x, across, top, logarithmic=logarithmic))
    way = " ".join(f"{px:.1f},{py:.1f}" for px, py in points)
    drawn += f'<polyline points="{way}" fill="none" stroke="{_CURVE_COLOUR}" stroke-width="2"/>'
    for k, (px, py) in enumerate(points if len(points) <= 30 else ()):
        colour = _WARNING if warned is not None and warned[k] else _CURVE_COLOUR
        drawn += f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3.5" fill="{colour}"/>'
    drawn += f'<text x="{_WIDTH_PX // 2}" y="{_HEIGHT_PX - 12}" text-anchor="middle">{escape(axis)}</text>'
    svg = f'<svg viewBox="0 0 {_WIDTH_PX} {_HEIGHT_PX}" role="img" aria-label="{escape(title)}">{drawn}</svg>'
    return f'<h2>{escape(title)}</h2><section><div class="wide" tabindex="0">{svg}</div></section>'


def _scale(x: FloatArray, across: FloatArray, top: float, *, logarithmic: bool) -> Iterator[str]:
    """Lines and numbers."""
    for value in ticks(0.0, top, _TICK_COUNT):
        y = _HEIGHT_PX - _EDGE_PX - value / top * (_HEIGHT_PX - 1.5 * _EDGE_PX)
        yield f'<path d="M{_EDGE_PX} {y:.0f}H{_WIDTH_PX - _EDGE_PX}" stroke="#8a8f98" stroke-opacity="0.25"/>'
        yield f'<text x="{_EDGE_PX - 8}" y="{y + 4:.0f}" text-anchor="end">{value:.3g}</text>'
    low, high = float(x.min()), float(x.max())
    shown = ticks(low, high, _TICK_COUNT) if low < high else [low]
    for value in [hz for hz in _TICKS_HZ if low <= hz <= high] if logarithmic else shown:
        place = np.interp(value, x, across)
        yield f'<text x="{place:.0f}" y="{_HEIGHT_PX - 36}" text-anchor="middle">{value:g}</text>'
