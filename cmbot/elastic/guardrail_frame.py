"""The guardrail as a frame: posts that stand clamped, rails through all of them, a node where the foot is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cmbot.common.errors import InputError
from cmbot.elastic.frame import Frame, Member
from cmbot.elastic.guardrail import Guardrail
from cmbot.elastic.sections import SectionConstants, section_constants

__all__ = ["GuardrailFrame", "guardrail_frame"]

# Joints nearer to each other than this are one, m: far below a section's width, and a beam much shorter than
# its neighbours would cost digits, as stiffness goes with the third power of length.
_SAME_PLACE = 1e-3

# The first six modes of the default guardrail are then within 0.01 % of those of a fine mesh.
_BEAMS_A_STRETCH = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class GuardrailFrame:
    """A guardrail's frame and where it is held.

    Attributes
    ----------
    frame : Frame
    foot : int
        The node at the origin of W.
    """

    frame: Frame
    foot: int


@dataclass(frozen=True, kw_only=True)
class _Stretch:
    """What lies between two neighbouring joints (x, z) of a member."""

    start: tuple[float, float]
    end: tuple[float, float]
    section: SectionConstants
    first_axis: tuple[float, float, float]

    @property
    def length(self) -> float:
        return math.dist(self.start, self.end)

    def points(self, count: int) -> list[tuple[float, float]]:
        """Ends of `count` beams of equal length."""
        x, z = (np.linspace(a, b, count + 1).tolist() for a, b in zip(self.start, self.end, strict=True))
        return list(zip(x, z, strict=True))


def guardrail_frame(guardrail: Guardrail, *, beams: int = _BEAMS_A_STRETCH) -> GuardrailFrame:
    """Draw the frame of a guardrail that has posts.

    Every member is drawn along the axis that the guardrail gives it, as the line of its centroids. Where axes
    cross they meet in a point and are stiffly joined. A post is rigid up to `clamp`. So these are left out:
    how far a rail lies beside the post, how far a section's shear centre lies from its centroid, the size of
    joints and what they give, and what the ground gives. Without rails the held post stands alone. Joints
    within a millimetre of each other are one.

    Parameters
    ----------
    guardrail : Guardrail
    beams : int
        Into how many beams the longest stretch between two joints is divided; a shorter one gets as many as
        make its beams no longer. The static stiffness does not depend on it, masses and frequencies do.

    Raises
    ------
    InputError
        When nothing that bends passes the origin of W, posts do not follow each other along x, or a rail
        misses the posts.
    """
    places = _places_along(guardrail)
    levels = _levels(guardrail, held=min(abs(x) for x in guardrail.post_positions) <= _SAME_PLACE)
    stretches = list(_stretches(guardrail, places, levels))
    longest = max(stretch.length for stretch in stretches) / beams
    numbers: dict[tuple[float, float], int] = {}
    members = []
    material = guardrail.material
    for stretch in stretches:
        points = stretch.points(math.ceil(stretch.length / longest - 1e-9))
        nodes = [numbers.setdefault(point, len(numbers)) for point in points]
        members += [
            Member(
                start=start,
                end=end,
                section=stretch.section,
                first_axis=stretch.first_axis,
                young=material.young,
                shear=material.shear,
                density=material.density,
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
            raise _refusal(
                f"rails[{index}].height", rail.height, f"a height from {low} to {high}, on the posts"
            )
    if not low + _SAME_PLACE < 0 <= high + _SAME_PLACE:
        raise _refusal("post", f"{low} to {high}", "posts that pass height 0, where the foot holds")
    if not held and all(abs(rail.height) > _SAME_PLACE for rail in rails):
        raise _refusal("rails", [rail.height for rail in rails], "a rail at height 0, or the foot at a post")
    levels = [low, 0.0]
    for height in (*(rail.height for rail in rails), high):
        if all(abs(height - level) > _SAME_PLACE for level in levels):
            levels.append(height)
    return tuple(sorted(levels))


def _stretches(
    guardrail: Guardrail, places: tuple[tuple[float, bool], ...], levels: tuple[float, ...]
) -> Iterator[_Stretch]:
    post = guardrail.post
    section, c, s = section_constants(post.section), math.cos(post.roll), math.sin(post.roll)
    for x in (x for x, has_post in places if has_post):
        for low, high in pairwise(levels):
            yield _Stretch(start=(x, low), end=(x, high), section=section, first_axis=(c, s, 0.0))
    for rail in guardrail.rails:
        section, c, s = section_constants(rail.section), math.cos(rail.roll), math.sin(rail.roll)
        z = min(levels, key=lambda level: abs(level - rail.height))
        for (left, _), (right, _) in pairwise(places):
            yield _Stretch(start=(left, z), end=(right, z), section=section, first_axis=(0.0, c, s))


def _refusal(key: str, got: object, expected: str) -> InputError:
    return InputError("guardrail", key, got, expected)
