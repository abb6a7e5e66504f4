"""The page of `cmbot walk`: the steps, and where the feet hold, coloured by what they bear."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from html import escape

import numpy as np

from cmbot.collision import extent_of
from cmbot.common.arrays import FloatArray
from cmbot.robot import Climber
from cmbot.scene import Box, Scene, guardrail_obstacles
from cmbot.siting import Candidate
from cmbot.views.page import still_page, table
from cmbot.walking import Walk, WalkSamples, walk_samples

__all__ = ["guardrail_map", "steps_table", "walk_page"]

_WIDTH, _EDGE = 900, 40
# Colours of feet from bearing nothing to bearing all that they can, and of one without bounds.
_LEAST, _MOST, _UNKNOWN = (26, 127, 55), (192, 57, 43), "#8a8f98"
_WORK, _IN_THE_WAY = "#b26a00", "#8a7a5c"
# Obstacles nearer than this to the plane of posts and rails are drawn, m.
_BESIDE = 0.1


def walk_page(walk: Walk) -> str:
    """Return an HTML page that opens no connection and runs no script.

    Parameters
    ----------
    walk : Walk
    """
    samples = list(walk_samples(walk))
    content = f"<section>{guardrail_map(walk.scene, samples)}</section>"
    content += f"<section>{steps_table(walk, samples)}</section>"
    return still_page(f"Walk: {walk.scene.name}", walk.in_words(), content)


def steps_table(walk: Walk, samples: Sequence[WalkSamples]) -> str:
    """Return a table of the steps of a walk, with its samples."""
    largest = {id(part.move): part.share for part in samples}
    rows, begins = [], iter(walk.begins)
    for number, step in enumerate(walk.steps, start=1):
        begin = [next(begins) for _ in step.moves]
        share = max(float(np.nanmax(largest[id(move)], initial=0.0)) for move in step.moves)
        used = f"{100 * share:.0f} %" if share > 0 else ""
        effort = max(move.segment.figures.limit_use.torque for move in step.moves)
        cells = (str(number), f"foot {step.foot}", *step.places, f"{begin[0]:.1f}", f"{step.seconds:.1f}")
        rows.append((*cells, f"{100 * effort:.0f} %", used))
    heads = ("", "moves", "from", "to", "begins, s", "seconds", "effort of joints", "share that a foot bears")
    return table(rows, heads, text_columns=4)


def guardrail_map(
    scene: Scene, samples: Sequence[WalkSamples], stances: Sequence[tuple[Candidate, str]] = ()
) -> str:
    """Return a drawing of the guardrail from outside.

    Parameters
    ----------
    scene : Scene
    samples : sequence of WalkSamples
        Of walks: the ways of both feet, circles where they hold.
    stances : sequence of (Candidate, str)
        Where work is done, and what: squares.
    """
    places = [_feet(candidate) for candidate, _ in stances]
    feet = np.vstack([*(part.feet.reshape(-1, 3) for part in samples), *places])
    low, high = feet[:, 0].min() - 0.4, feet[:, 0].max() + 0.4
    bottom, top = feet[:, 2].min() - 0.4, feet[:, 2].max() + 0.4
    scale = (_WIDTH - 2 * _EDGE) / (high - low)
    height = round(2 * _EDGE + scale * (top - bottom))

    def at(x: float, z: float) -> tuple[float, float]:
        return _EDGE + (x - low) * scale, _EDGE + (top - z) * scale

    window = low, high, bottom, top
    parts = [*_members(scene, at, window), *_obstacles(scene, at, window)]
    for part in samples:
        for foot, dash in ((0, ""), (1, ' stroke-dasharray="5 4"')):
            points = " ".join("{:.1f},{:.1f}".format(*at(p[0], p[2])) for p in part.feet[:, foot])
            parts.append(f'<polyline points="{points}" fill="none" stroke="#2f6fb7"{dash}/>')
    for part in samples:
        for foot in part.move.holds:
            x, y = at(*part.feet[-1, foot - 1, [0, 2]])
            share = part.share[:, foot - 1]
            colour = _UNKNOWN if np.isnan(share).all() else _colour(float(np.nanmax(share)))
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="9" fill="{colour}"/>')
            place = f'x="{x:.1f}" y="{y + 4:.1f}"'
            parts.append(f'<text class="on" {place} font-size="11" text-anchor="middle">{foot}</text>')
    for number, ((_, name), each) in enumerate(zip(stances, places, strict=True), start=1):
        for x, y in (at(*place[[0, 2]]) for place in each):
            square = f'x="{x - 11:.1f}" y="{y - 11:.1f}" width="22" height="22"'
            parts.append(f'<rect {square} fill="none" stroke="{_WORK}" stroke-width="3"/>')
        x, y = at(*each[0, [0, 2]])
        label = escape(f"{number}: {name}")
        parts.append(f'<text x="{x:.1f}" y="{y - 18:.1f}" font-size="13" text-anchor="middle">{label}</text>')
    said = (
        "Circles: where the feet hold, green to red by the share of their bounds that they use. "
        "Lines: the ways of foot 1 (full) and of foot 2 (broken)."
    )
    squares = " Squares: where work is done." if stances else ""
    drawn = f'<svg viewBox="0 0 {_WIDTH} {height}" role="img">{"".join(parts)}</svg>'
    return f'<div class="wide">{drawn}</div><p class="caption">{said}{squares}</p>'


def _feet(candidate: Candidate) -> FloatArray:
    """Where the feet hold, (k, 3), m."""
    places = [candidate.root[:3, 3]]
    if candidate.stance.foot_2 is not None:
        places.append((candidate.root @ Climber().poses(candidate.climber)[0])[:3, 3])
    return np.array(places)


def _members(
    scene: Scene, at: Callable[[float, float], tuple[float, float]], window: tuple[float, float, float, float]
) -> Iterator[str]:
    low, high, bottom, top = window
    for member in guardrail_obstacles(scene.guardrail):
        if not isinstance(member.shape, Box):
            continue
        (x, _, z), (width, _, height) = np.array(member.X_WO)[:3, 3], member.shape.size
        left, right = max(x - width / 2, low), min(x + width / 2, high)
        lower, upper = max(z - height / 2, bottom), min(z + height / 2, top)
        if left < right and lower < upper:
            (a, b), (c, d) = at(left, upper), at(right, lower)
            yield f'<rect x="{a:.1f}" y="{b:.1f}" width="{c - a:.1f}" height="{d - b:.1f}" fill="#c9ced6"/>'


def _obstacles(
    scene: Scene, at: Callable[[float, float], tuple[float, float]], window: tuple[float, float, float, float]
) -> Iterator[str]:
    """What is on posts and rails, such as lamps: no foot holds there."""
    low, high, bottom, top = window
    members = {member.name for member in guardrail_obstacles(scene.guardrail)}
    for obstacle in scene.obstacles:
        least, most = extent_of(obstacle)
        # Posts and rails are in the plane y = 0.
        apart = least[1] > _BESIDE or most[1] < -_BESIDE
        out = most[0] < low or least[0] > high or most[2] < bottom or least[2] > top
        if obstacle.name in members or apart or out:
            continue
        (left, upper), (right, lower) = at(least[0], most[2]), at(most[0], least[2])
        place = f'x="{left:.1f}" y="{upper:.1f}" width="{right - left:.1f}" height="{lower - upper:.1f}"'
        name = escape(obstacle.name)
        yield f'<rect {place} fill="{_IN_THE_WAY}"><title>{name}</title></rect>'
        yield (
            f'<text x="{(left + right) / 2:.1f}" y="{upper - 5:.1f}" font-size="11" '
            f'text-anchor="middle">{name}</text>'
        )


def _colour(share: float) -> str:
    mixed = (round(a + min(share, 1.0) * (b - a)) for a, b in zip(_LEAST, _MOST, strict=True))
    return "#" + "".join(f"{part:02x}" for part in mixed)
