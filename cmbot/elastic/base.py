"""The elastic base: the guardrail's frame of beams, condensed to the foot at the origin of W."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.errors import InputError
from cmbot.elastic.beam import SectionConstants, section_constants
from cmbot.elastic.frame import Frame, Member
from cmbot.elastic.guardrail import Guardrail

__all__ = ["ElasticBase", "GuardrailFrame", "elastic_base", "guardrail_frame"]

# Joints closer than this are merged, m: far below a section's width, and a beam much shorter than its
# neighbours would cost digits, as stiffness grows with the inverse third power of length.
_SAME_PLACE = 1e-3
# The first six modes of the default guardrail are then within 0.01 % of those of a fine mesh.
_BEAMS_PER_SEGMENT = 8
# Number of natural frequencies of the frame that are computed.
_MODES = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticBase:
    """Stiffness and mass at the foot: at the origin of W, in W, linear then angular; arrays are read-only.

    Attributes
    ----------
    stiffness : (6, 6), N/m, N/rad, Nm/rad
        Exactly symmetric.
    mass : (6, 6), kg, kg m, kg m2
        Mass of the guardrail that moves with the foot; zero for a given stiffness without a mass.
    frequencies : (k,), Hz
        Lowest natural frequencies of the whole frame without the robot, ascending; empty for a given
        stiffness or a material without mass.
    """

    stiffness: FloatArray
    mass: FloatArray
    frequencies: FloatArray


def elastic_base(guardrail: Guardrail) -> ElasticBase | None:
    """Return the stiffness at the foot: the given one, else that of the guardrail's frame.

    Returns
    -------
    ElasticBase or None
        None: the base is rigid, as there are neither posts nor a given stiffness.

    Raises
    ------
    InputError
        When there is no frame for the guardrail, or its stiffness is ill-conditioned.
    """
    if guardrail.stiffness is not None:
        mass = np.zeros((6, 6)) if guardrail.mass is None else guardrail.mass
        return _base(guardrail.stiffness, mass, np.zeros(0))
    if not guardrail.post_positions:
        return None
    made = guardrail_frame(guardrail)
    condensed = made.frame.condense(made.foot)
    return _base(condensed.stiffness, condensed.mass, made.frame.frequencies(_MODES))


def _base(stiffness: FloatArray, mass: FloatArray, frequencies: FloatArray) -> ElasticBase:
    # Matrices from files may be asymmetric in the last digit; symmetric ones are unchanged.
    return ElasticBase(
        stiffness=read_only((stiffness + stiffness.T) / 2),
        mass=read_only((mass + mass.T) / 2),
        frequencies=read_only(frequencies),
    )


class GuardrailFrame(NamedTuple):
    """The frame of a guardrail; `foot` is the node at the origin of W."""

    frame: Frame
    foot: int


class _Segment(NamedTuple):
    """Part of a post or rail between two neighbouring joints (x, z)."""

    start: tuple[float, float]
    end: tuple[float, float]
    section: SectionConstants
    first_axis: tuple[float, float, float]


def guardrail_frame(guardrail: Guardrail, *, beams: int = _BEAMS_PER_SEGMENT) -> GuardrailFrame:
    """Make the frame of a guardrail that has posts.

    The axis that the guardrail gives a member is its line of centroids. Axes that cross meet in a point and
    are rigidly joined. A post is rigid up to `clamp`. Neglected are the offset between rail and post, the
    distance from a section's shear centre to its centroid, the size and compliance of joints, and the
    compliance of the ground. Without rails the held post stands alone. Joints within a millimetre of each
    other are merged. `beams` is their number in the longest segment between two joints; a shorter one has as
    many as make its beams no longer. The static stiffness does not depend on it, mass and frequencies do.
    """
    places = _places_along(guardrail)
    levels = _levels(guardrail, held=min(abs(x) for x in guardrail.post_positions) <= _SAME_PLACE)
    segments = list(_segments(guardrail, places, levels))
    longest = max(math.dist(segment.start, segment.end) for segment in segments) / beams
    numbers: dict[tuple[float, float], int] = {}
    members = []
    for segment in segments:
        count = math.ceil(math.dist(segment.start, segment.end) / longest - 1e-9)
        ends = zip(segment.start, segment.end, strict=True)
        x, z = (np.linspace(start, end, count + 1).tolist() for start, end in ends)
        nodes = [numbers.setdefault(point, len(numbers)) for point in zip(x, z, strict=True)]
        members += [
            Member(
                start=start,
                end=end,
                section=segment.section,
                first_axis=segment.first_axis,
                material=guardrail.material,
            )
            for start, end in pairwise(nodes)
        ]
    frame = Frame(
        nodes=np.array([(x, 0.0, z) for x, z in numbers]),
        members=tuple(members),
        fixed=tuple(numbers[x, levels[0]] for x, has_post in places if has_post),
    )
    return GuardrailFrame(frame=frame, foot=numbers[0.0, 0.0])


def _places_along(guardrail: Guardrail) -> tuple[tuple[float, bool], ...]:
    """The x of posts and foot, ascending, each with whether a post stands there."""
    posts = guardrail.post_positions
    if not posts or any(not after - before > _SAME_PLACE for before, after in pairwise(posts)):
        expected = "one or more, ascending, more than a millimetre apart"
        raise _refusal("post_positions", posts, expected)
    if not posts[0] - _SAME_PLACE <= 0 <= posts[-1] + _SAME_PLACE:
        raise _refusal("post_positions", posts, "posts on both sides of the foot, or one at it")
    places = {(0.0 if abs(x) <= _SAME_PLACE else x): True for x in posts}
    places.setdefault(0.0, False)
    if guardrail.rails:
        return tuple(sorted(places.items()))
    return ((0.0, places[0.0]),)


def _levels(guardrail: Guardrail, *, held: bool) -> tuple[float, ...]:
    """The z of all joints, ascending: first the clamp, last the top."""
    post, rails = guardrail.post, guardrail.rails
    low, high = post.clamp, post.top
    for index, rail in enumerate(rails):
        if not low - _SAME_PLACE <= rail.height <= high + _SAME_PLACE:
            expected = f"a height from {low} to {high}, on the posts"
            raise _refusal(f"rails[{index}].height", rail.height, expected)
    if not low + _SAME_PLACE < 0 <= high + _SAME_PLACE:
        raise _refusal("post", f"{low} to {high}", "posts that pass height 0, where the foot holds")
    if not held and all(abs(rail.height) > _SAME_PLACE for rail in rails):
        raise _refusal("rails", [rail.height for rail in rails], "a rail at height 0, or the foot at a post")
    levels = [low, 0.0]
    for height in (*(rail.height for rail in rails), high):
        if all(abs(height - level) > _SAME_PLACE for level in levels):
            levels.append(height)
    return tuple(sorted(levels))


def _segments(
    guardrail: Guardrail, places: tuple[tuple[float, bool], ...], levels: tuple[float, ...]
) -> Iterator[_Segment]:
    post = guardrail.post
    section, c, s = section_constants(post.section), math.cos(post.roll), math.sin(post.roll)
    for x in (x for x, has_post in places if has_post):
        for low, high in pairwise(levels):
            yield _Segment(start=(x, low), end=(x, high), section=section, first_axis=(c, s, 0.0))
    for rail in guardrail.rails:
        section, c, s = section_constants(rail.section), math.cos(rail.roll), math.sin(rail.roll)
        z = min(levels, key=lambda level: abs(level - rail.height))
        for (left, _), (right, _) in pairwise(places):
            yield _Segment(start=(left, z), end=(right, z), section=section, first_axis=(0.0, c, s))


def _refusal(key: str, got: object, expected: str) -> InputError:
    return InputError("guardrail", key, got, expected)
