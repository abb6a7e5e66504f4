"""The elastic base: the guardrail's frame of beams, condensed to the feet, and the robot's legs on it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.errors import InputError
from cmbot.common.representation import short_repr
from cmbot.elastic.beam import SectionConstants, section_constants
from cmbot.elastic.frame import Frame, Member
from cmbot.elastic.guardrail import Guardrail

# Joints closer than this are merged, m: far below a section's width, and a beam much shorter than its
# neighbours would cost digits, as stiffness grows with the inverse third power of length.
_MERGE_DISTANCE_M = 1e-3
# The first six modes of the default guardrail are then within 0.01 % of those of a fine mesh.
_BEAMS_PER_SEGMENT = 8
# Compliance of what is rigid where legs alone bend, m/N and rad/Nm.
_RIGID = 1e-12 * np.eye(6)
# Number of natural frequencies of the frame that are computed.
_MODE_COUNT = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticBase:
    """Stiffness and mass that the robot feels at O0, in W, linear then angular; arrays are read-only.

    Attributes
    ----------
    stiffness : (6, 6), N/m, N/rad, Nm/rad
        Exactly symmetric.
    mass : (6, 6), kg, kg m, kg m2
        Mass of the guardrail that moves with the foot; zero for a given stiffness without a mass.
    damping : (6, 6), Ns/m, Ns, Nms
        Of its own; zero but for a given stiffness with a damping.
    guardrail : Guardrail, optional
        Whose frame it is.
    """

    stiffness: FloatArray
    mass: FloatArray
    damping: FloatArray
    guardrail: Guardrail | None = None

    __repr__ = short_repr

    @cached_property
    def frequencies(self) -> FloatArray:
        """Lowest natural frequencies (k,), Hz, of the whole frame without the robot, ascending.

        Empty for a given stiffness or a material without mass.
        """
        if self.guardrail is None:
            return read_only(np.zeros(0))
        found = guardrail_frame(self.guardrail).frame.frequencies(_MODE_COUNT)
        return read_only(np.sqrt(self.guardrail.stiffness_factor) * found)


# Several parts of a plan ask for that of one guardrail, and so do the jobs of a campaign.
@lru_cache(maxsize=4)
def elastic_base(guardrail: Guardrail) -> ElasticBase | None:
    """Return the stiffness at O0: the given one, else that of the guardrail's frame under the feet.

    Returns
    -------
    ElasticBase or None
        None: the base is rigid, as there are neither posts nor a given stiffness.

    Raises
    ------
    InputError
        When there is no frame for the guardrail, or its stiffness is ill-conditioned.
    """
    legs, none = guardrail.leg_compliance, np.zeros((6, 6))
    if guardrail.stiffness is not None:
        own = np.array(guardrail.stiffness)
        mass, damping = (none if part is None else part for part in (guardrail.mass, guardrail.damping))
        K, moved = _with_legs(own, np.eye(6), legs)
        return _base(None, K, moved.T @ mass @ moved, moved.T @ damping @ moved)
    if not guardrail.post_positions:
        return None if legs is None else _base(None, np.linalg.inv(legs[0] + _RIGID), none, none)
    own, mass = _at_nodes(guardrail)
    K, moved = _with_legs(own, _motion_of_feet(guardrail), legs)
    return _base(guardrail, K, moved.T @ mass @ moved, none)


@lru_cache(maxsize=4)
def _at_nodes(guardrail: Guardrail) -> tuple[FloatArray, FloatArray]:
    """Stiffness and mass (6 k, 6 k) of a frame at the feet's nodes, read-only."""
    frame, feet = guardrail_frame(guardrail)
    condensed = frame.condense(*feet)
    return read_only(guardrail.stiffness_factor * condensed.stiffness), read_only(condensed.mass)


def shares(guardrail: Guardrail) -> tuple[FloatArray, ...]:
    """Return what of a wrench of the robot each foot bears: (6, 6) each, both wrenches about O0 in W.

    The robot was put there without preload. The motion of the arm's base minimises the elastic energy of
    frame and legs; what the feet bear is linear in the wrench, and adds up to it.

    Parameters
    ----------
    guardrail : Guardrail
        That has posts, where there are two feet.

    Raises
    ------
    InputError
        When there is no frame for the guardrail, or its stiffness is ill-conditioned.
    """
    if len(guardrail.footholds) == 1:
        return (np.eye(6),)
    own, G = _at_nodes(guardrail)[0], _motion_of_feet(guardrail)
    K, moved = _with_legs(own, G, guardrail.leg_compliance)
    borne = own @ moved @ np.linalg.inv(K)
    parts = (slice(6 * k, 6 * k + 6) for k in range(len(guardrail.footholds)))
    return tuple(G[part].T @ borne[part] for part in parts)


class SharedFrame:
    """What feet bear and how a guardrail bends wherever they hold it, from one frame for all places.

    Parameters
    ----------
    guardrail : Guardrail
    points : (P, 3), m
        On the axes of members, in W, more than a millimetre apart.
    """

    def __init__(self, guardrail: Guardrail, points: FloatArray) -> None:
        self._points = points
        footholds = tuple(tuple(point) for point in points.tolist())
        # The static stiffness does not depend on how fine the beams are.
        made = guardrail_frame(replace(guardrail, footholds=footholds), beams=1)
        self._compliance = made.frame.compliance(*made.feet) / guardrail.stiffness_factor

    def shares(
        self, numbers: Sequence[int], foot_point: FloatArray, legs: FloatArray | None = None
    ) -> tuple[FloatArray, ...]:
        """Return the shares (6, 6) of feet at some of the points, by their numbers: `shares`.

        Parameters
        ----------
        numbers : sequence of int
        foot_point : (3,), m
            O0 in W.
        legs : (k, 6, 6), optional
            `Guardrail.leg_compliance`.
        """
        if len(numbers) == 1:
            return (np.eye(6),)
        G, borne = self._held(numbers, foot_point, legs)
        borne = borne @ np.linalg.inv(G.T @ borne)
        parts = (slice(6 * k, 6 * k + 6) for k in range(len(numbers)))
        return tuple(G[part].T @ borne[part] for part in parts)

    def stiffness(
        self, numbers: Sequence[int], foot_point: FloatArray, legs: FloatArray | None = None
    ) -> FloatArray:
        """Return the stiffness (6, 6) at O0 of a robot with feet at some of the points: as `shares`."""
        G, borne = self._held(numbers, foot_point, legs)
        K = G.T @ borne
        return np.asarray((K + K.T) / 2)

    def _held(
        self, numbers: Sequence[int], foot_point: FloatArray, legs: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Motion (6 k, 6) of the points by that of `foot_point`, and what they bear of it."""
        G = _motion(self._points[list(numbers)], foot_point)
        index = (6 * np.array(numbers)[:, None] + np.arange(6)).ravel()
        compliance = self._compliance[np.ix_(index, index)]
        if legs is not None:
            compliance = compliance + _at_feet(legs, G)
        return G, np.asarray(np.linalg.solve(compliance, G))


def with_legs(stiffness: FloatArray, legs: FloatArray | None) -> FloatArray:
    """Return a stiffness (6, 6) at O0 with the leg (1, 6, 6) between it and the arm's base."""
    return _with_legs(stiffness, np.eye(6), legs)[0]


def motion_of_feet(guardrail: Guardrail) -> FloatArray:
    """Return the displacements (6 k, 6) of the feet's nodes by the motion of the arm's base at O0."""
    G, legs = _motion_of_feet(guardrail), guardrail.leg_compliance
    return G if legs is None else _with_legs(_at_nodes(guardrail)[0], G, legs)[1]


def _motion_of_feet(guardrail: Guardrail) -> FloatArray:
    """As `motion_of_feet`, of a rigid robot."""
    return _motion(np.array(guardrail.footholds), np.array(guardrail.foot_point))


def _with_legs(
    stiffness: FloatArray, G: FloatArray, legs: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Stiffness (6, 6) of the arm's base at O0, and motion (6 k, 6) of the feet by its.

    Feet and legs are springs in a row: what one bears the other does. Without legs the feet move with the
    base, by `G`.
    """
    if legs is None:
        return G.T @ stiffness @ G, G
    compliance = np.linalg.inv(stiffness)
    borne = np.linalg.solve(compliance + _at_feet(legs, G), G)
    return G.T @ borne, compliance @ borne


def _at_feet(legs: FloatArray, G: FloatArray) -> FloatArray:
    """Compliance (6 k, 6 k) of legs (k, 6, 6) about O0, by wrenches at the feet that `G` moves."""
    blocks = (part @ leg @ part.T for part, leg in zip(G.reshape(-1, 6, 6), legs, strict=True))
    return np.asarray(block_diag(*blocks))


def _motion(points: FloatArray, foot_point: FloatArray) -> FloatArray:
    rows = []
    for point in points:
        x, y, z = point - foot_point
        G = np.eye(6)
        # A rotation moves a point by its cross product with the lever.
        G[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        rows.append(G)
    return np.vstack(rows)


def _base(guardrail: Guardrail | None, *parts: FloatArray) -> ElasticBase:
    # Matrices from files may be asymmetric in the last digit; symmetric ones are unchanged.
    stiffness, mass, damping = (read_only((part + part.T) / 2) for part in parts)
    return ElasticBase(stiffness=stiffness, mass=mass, damping=damping, guardrail=guardrail)


class GuardrailFrame(NamedTuple):
    """The frame of a guardrail; `feet` are the nodes that the feet hold, foot 1 first."""

    frame: Frame
    feet: tuple[int, ...]

    @property
    def foot(self) -> int:
        """The node that foot 1 holds."""
        return self.feet[0]


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
    levels = _levels(guardrail)
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
    feet = tuple(numbers[x, _nearest(levels, z)] for x, _, z in guardrail.footholds)
    return GuardrailFrame(frame=frame, feet=feet)


def _places_along(guardrail: Guardrail) -> tuple[tuple[float, bool], ...]:
    """The x of posts and foot, ascending, each with whether a post stands there."""
    posts = guardrail.post_positions
    if not posts or any(not after - before > _MERGE_DISTANCE_M for before, after in pairwise(posts)):
        expected = "one or more, ascending, more than a millimetre apart"
        raise _refusal("post_positions", posts, expected)
    held = [x for x, _, _ in guardrail.footholds]
    if not all(posts[0] - _MERGE_DISTANCE_M <= x <= posts[-1] + _MERGE_DISTANCE_M for x in held):
        raise _refusal("post_positions", posts, "posts on both sides of the foot, or one at it")
    places = {next((h for h in held if abs(x - h) <= _MERGE_DISTANCE_M), x): True for x in posts}
    for x in held:
        places.setdefault(x, False)
    if guardrail.rails:
        return tuple(sorted(places.items()))
    return tuple(sorted((x, places[x]) for x in set(held)))


def _levels(guardrail: Guardrail) -> tuple[float, ...]:
    """The z of all joints, ascending: first the clamp, last the top."""
    post, rails = guardrail.post, guardrail.rails
    low, high = post.clamp, post.top
    for index, rail in enumerate(rails):
        if not low - _MERGE_DISTANCE_M <= rail.height <= high + _MERGE_DISTANCE_M:
            expected = f"a height from {low} to {high}, on the posts"
            raise _refusal(f"rails[{index}].height", rail.height, expected)
    for x, _, z in guardrail.footholds:
        if not low + _MERGE_DISTANCE_M < z <= high + _MERGE_DISTANCE_M:
            raise _refusal("post", f"{low} to {high}", f"posts that pass height {z:g}, where the foot holds")
        at_post = any(abs(x - post) <= _MERGE_DISTANCE_M for post in guardrail.post_positions)
        heights = [rail.height for rail in rails]
        if not at_post and all(abs(height - z) > _MERGE_DISTANCE_M for height in heights):
            expected = f"a rail at height {z:g}, or the foot at a post"
            raise _refusal("rails", heights, expected)
    levels = [low]
    for z in (z for _, _, z in guardrail.footholds):
        if all(abs(z - level) > _MERGE_DISTANCE_M for level in levels):
            levels.append(z)
    for height in (*(rail.height for rail in rails), high):
        if all(abs(height - level) > _MERGE_DISTANCE_M for level in levels):
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
        z = _nearest(levels, rail.height)
        for (left, _), (right, _) in pairwise(places):
            yield _Segment(start=(left, z), end=(right, z), section=section, first_axis=(0.0, c, s))


def _nearest(levels: tuple[float, ...], height: float) -> float:
    return min(levels, key=lambda level: abs(level - height))


def _refusal(key: str, got: object, expected: str) -> InputError:
    return InputError("guardrail", key, got, expected)
