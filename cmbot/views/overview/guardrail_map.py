"""A map of the guardrail from outside: where feet hold and go, and what is worked on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import NamedTuple

import numpy as np

from cmbot.collision import Box, Obstacle, extent_of
from cmbot.common.arrays import FloatArray
from cmbot.robot import Climber
from cmbot.scene import PLATE_OFFSET_M, Scene, guardrail_obstacles
from cmbot.stances import Candidate
from cmbot.stances.walking import WalkSamples

_MAP_PX, _EDGE = 900, 40
# Colours of feet from bearing nothing to bearing all that they can, and of one without bounds.
_IDLE_COLOUR, _FULL_COLOUR, _UNKNOWN = (26, 127, 55), (192, 57, 43), "#5d6670"
_WORK, _IN_THE_WAY, _WORKED_ON, _PATH = "#b26a00", "#8a7a5c", "#2f9e8f", "#8b4fd0"
# Obstacles nearer than this to the plane of posts and rails are drawn, m.
_SHOWN_DISTANCE_M = 0.1
# Shown along a guardrail that is as long, m.
_LEAST_WIDTH = 6.0
# Shown beside feet and paths, m, half of it below; edges above and below, px.
_ROOM, _ABOVE, _BELOW = 0.4, 4.0, 12.0
# Points of a way that are nearer to each other are one, px.
_SAME_POINT_PX = 1.0


class Stand(NamedTuple):
    """Where work is done: what is said of it, and its tool paths (K, 3) in W, m."""

    candidate: Candidate
    label: str
    paths: Sequence[FloatArray] = ()


@dataclass(frozen=True)
class _Window:
    """What is shown of the plane y = 0, m."""

    low: float
    high: float
    bottom: float
    top: float
    scale: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale", (_MAP_PX - 2 * _EDGE) / (self.high - self.low))

    @property
    def height(self) -> float:
        return _ABOVE + _BELOW + self.scale * (self.top - self.bottom)

    def at(self, points: FloatArray) -> FloatArray:
        """Places (..., 2) in the drawing of points (..., 3) in W, px."""
        x, z = points[..., 0], points[..., 2]
        return np.stack([_EDGE + (x - self.low) * self.scale, _ABOVE + (self.top - z) * self.scale], axis=-1)

    def box(self, least: FloatArray, most: FloatArray) -> tuple[float, float, float, float] | None:
        """Left, top, width and height, px, of what is shown of a box between points (3,) in W; or None."""
        low = np.maximum(least, [self.low, -np.inf, self.bottom])
        high = np.minimum(most, [self.high, np.inf, self.top])
        if (low >= high)[[0, 2]].any():
            return None
        (left, lower), (right, upper) = self.at(np.stack([low, high]))
        return float(left), float(upper), float(right - left), float(lower - upper)


def guardrail_map(scene: Scene, samples: Sequence[WalkSamples], stands: Sequence[Stand] = ()) -> str:
    """Return a drawing of the guardrail from outside.

    Parameters
    ----------
    scene : Scene
    samples : sequence of WalkSamples
        Of walks: the ways of both feet, circles where they hold.
    stands : sequence of Stand
        Where work is done: squares, and the tool's paths.
    """
    places = [_feet(each.candidate) for each in stands]
    paths = [path for each in stands for path in each.paths]
    shown = np.vstack([*(part.feet.reshape(-1, 3) for part in samples), *places, *paths])
    low, high = shown.min(axis=0), shown.max(axis=0)
    left, right = _widened(low[0] - _ROOM, high[0] + _ROOM, scene.elastic_guardrail.post_positions)
    window = _Window(left, right, low[2] - _ROOM / 2, high[2] + _ROOM)
    parts = [*_members(scene, window), *_obstacles(scene, window, bool(paths))]
    parts += [_line(window, path, f'stroke="{_PATH}" stroke-width="2"') for path in paths]
    for part in samples:
        parts += [
            _line(window, part.feet[:, foot], f'class="way"{dash}')
            for foot, dash in ((0, ""), (1, ' stroke-dasharray="5 4"'))
        ]
    for part in samples:
        for foot in part.move.holds:
            share = part.share[:, foot - 1]
            colour = _UNKNOWN if np.isnan(share).all() else _colour(float(np.nanmax(share)))
            parts.append(_foot(window.at(part.feet[-1, foot - 1]), foot, colour))
    for number, (stand, feet) in enumerate(zip(stands, places, strict=True), start=1):
        for which, at in enumerate(window.at(feet), start=1):
            if not samples:
                parts.append(_foot(at, which, _UNKNOWN))
            x, y = at
            square = f'x="{x - 11:.1f}" y="{y - 11:.1f}" width="22" height="22"'
            parts.append(f'<rect {square} fill="none" stroke="{_WORK}" stroke-width="3"/>')
        # Ways go below the feet, too; without them only the names of what is on the rail are above.
        x, y = window.at(feet[0])
        y = y - 18 if samples else window.at(feet)[:, 1].max() + 32
        label = f"{number}: {stand.label}" if len(stands) > 1 else stand.label
        parts.append(_text(x, y, label, 13))
    drawn = (
        f'<svg viewBox="0 0 {_MAP_PX} {window.height:.0f}" role="img" aria-label="Map">{"".join(parts)}</svg>'
    )
    kind = "wide" if samples else "map"
    key = " ".join(_key(scene.base_name, samples, stands))
    return f'<div class="{kind}" tabindex="0">{drawn}</div><p class="caption">{key}</p>'


def _widened(low: float, high: float, posts: Sequence[float]) -> tuple[float, float]:
    """Both ends of what is shown along the guardrail, m, so that some of its posts are."""
    first, last = min(low, *posts), max(high, *posts)
    room = (min(_LEAST_WIDTH, last - first) - (high - low)) / 2
    if room <= 0:
        return low, high
    left = float(np.clip(low - room, first, last - _LEAST_WIDTH if last - first > _LEAST_WIDTH else first))
    return left, left + min(_LEAST_WIDTH, last - first)


def _key(base: str, samples: Sequence[WalkSamples], stands: Sequence[Stand]) -> Iterator[str]:
    yield f"The {base} from outside."
    if samples:
        yield "Circles: where the feet hold, green to red by the share of their bounds that they use."
        yield "Lines: the ways of foot 1 (full) and of foot 2 (broken)."
    if stands:
        yield "Squares: where the feet hold at work."
    if any(each.paths for each in stands):
        yield "Violet: the tool's paths; green blocks: what is worked on."


def _feet(candidate: Candidate) -> FloatArray:
    """Where the plates of the feet are, (k, 3), m: their frames may be on the other side of the steel."""
    poses = [candidate.root]
    if candidate.stance.foot_2 is not None:
        poses.append(candidate.root @ Climber().poses(candidate.climber)[0])
    return np.array([X[:3, 3] + PLATE_OFFSET_M * X[:3, 1] for X in poses])


def _line(window: _Window, points: FloatArray, style: str) -> str:
    """A line through points (N, 3) in W, without those that are as good as the one before."""
    at = window.at(points)
    along = np.append(0.0, np.linalg.norm(np.diff(at, axis=0), axis=1).cumsum())
    kept = np.unique(np.searchsorted(along, np.append(np.arange(0.0, along[-1], _SAME_POINT_PX), along[-1])))
    words = " ".join(f"{x:.1f},{y:.1f}" for x, y in at[kept])
    return f'<polyline points="{words}" fill="none" {style}/>'


def _foot(at: FloatArray, number: int, colour: str) -> str:
    x, y = at
    circle = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="9" fill="{colour}"/>'
    place = f'x="{x:.1f}" y="{y + 4:.1f}"'
    return f'{circle}<text class="on" {place} font-size="11" text-anchor="middle">{number}</text>'


def _text(x: float, y: float, words: str, size: int) -> str:
    """Words in the middle at `x`, px, but not beyond the drawing's edges."""
    half = 0.3 * size * len(words)
    x = float(np.clip(x, half, _MAP_PX - half)) if 2 * half < _MAP_PX else _MAP_PX / 2
    place = f'x="{x:.1f}" y="{y:.1f}" font-size="{size}" text-anchor="middle"'
    return f'<text class="label" {place}>{escape(words)}</text>'


def _members(scene: Scene, window: _Window) -> Iterator[str]:
    for member in guardrail_obstacles(scene.elastic_guardrail):
        if isinstance(member.shape, Box):
            middle, half = np.array(member.X_WO)[:3, 3], np.array(member.shape.size) / 2
            yield from _rectangle(window.box(middle - half, middle + half), "#c9ced6")


def _obstacles(scene: Scene, window: _Window, with_workpieces: bool) -> Iterator[str]:
    """What is on posts and rails, such as lamps: no foot holds there; and what is worked on."""
    members = {member.name for member in guardrail_obstacles(scene.elastic_guardrail)}
    for obstacle in scene.all_obstacles:
        if obstacle.name in members:
            continue
        least, most = extent_of(obstacle)
        # Posts and rails are in the plane y = 0.
        on_rail = least[1] <= _SHOWN_DISTANCE_M and most[1] >= -_SHOWN_DISTANCE_M
        worked_on = obstacle.workpiece and with_workpieces
        if (box := window.box(least, most)) is not None and (worked_on or on_rail):
            yield from _rectangle(box, _WORKED_ON if worked_on else _IN_THE_WAY, obstacle)
            if not worked_on:
                yield _text(box[0] + box[2] / 2, box[1] - 5, obstacle.name, 11)


def _rectangle(
    box: tuple[float, float, float, float] | None, colour: str, obstacle: Obstacle | None = None
) -> Iterator[str]:
    if box is not None:
        place = 'x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}"'.format(*box)
        title = "" if obstacle is None else f"<title>{escape(obstacle.name)}</title>"
        yield f'<rect {place} fill="{colour}">{title}</rect>'


def _colour(share: float) -> str:
    mixed = (round(a + min(share, 1.0) * (b - a)) for a, b in zip(_IDLE_COLOUR, _FULL_COLOUR, strict=True))
    return "#" + "".join(f"{part:02x}" for part in mixed)
