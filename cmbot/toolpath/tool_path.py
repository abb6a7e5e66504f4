"""The tool path: legs from the initial tool pose, each from rest to rest and timed by a law."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from heapq import heapify, heapreplace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.common.poses import turned_pose
from cmbot.common.representation import ShortRepr
from cmbot.toolpath.curves import Curve, Line
from cmbot.toolpath.time_law import LegLaw, ProcessPart, TimeLaw
from cmbot.toolpath.tool_poses import ToolPoses

# Points by which a curve is shown.
_POINTS_PER_CURVE = 41
# Times nearer to each other than this share of the duration are the same.
_LEG_TIME_TOLERANCE = 1e-9
# Digits of the shares of the duration that legs have.
_LEG_SHARE_DIGITS = 9
# Bends count so many times as much as the time at most: what is rounded grows with the times' nearness.
_DENSEST = 7.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Segment(ShortRepr):
    """A leg of a path, from rest to rest.

    Attributes
    ----------
    curve : Curve
        Of the tool point: of a leg on which it stays a line without length.
    turn : (3,), rad
        Rotation vector in W by which the tool turns about a fixed axis, in proportion to the share of the leg
        that is covered, where the curve prescribes no orientation.
    seconds : float
        Duration, s.
    law : TimeLaw
    process : ProcessPart or None
        Of a leg that has a process speed between two leads.
    is_open : bool
        Whether its seconds are to be found: those here are a first guess.
    """

    curve: Curve
    seconds: float
    law: TimeLaw
    turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    process: ProcessPart | None = None
    is_open: bool = False

    @property
    def is_straight(self) -> bool:
        """Whether the tool point moves along a line, or stays."""
        return isinstance(self.curve, Line)

    def reversed(self) -> Segment:
        """Return the way back."""
        part = self.process
        return replace(
            self,
            curve=self.curve.reversed(),
            turn=-self.turn,
            law=self.law.reversed(),
            process=part and replace(part, begin=1 - part.end, end=1 - part.begin),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolPath(ShortRepr):
    """Segments one after the other, each from rest to rest.

    Attributes
    ----------
    segments : tuple of Segment
        L of them, called legs in what follows.
    orientation : (3, 3)
        R_WT at the start.
    """

    segments: tuple[Segment, ...]
    orientation: FloatArray

    @staticmethod
    def straight(corners: FloatArray, orientation: FloatArray, seconds: FloatArray, law: TimeLaw) -> ToolPath:
        """Return straight legs (L) between corners (L + 1, 3), m, in so many seconds (L,), s."""
        lines = zip(corners[:-1], corners[1:], seconds, strict=True)
        segments = (Segment(curve=Line(*ends), seconds=float(time), law=law) for *ends, time in lines)
        return ToolPath(segments=tuple(segments), orientation=orientation)

    @cached_property
    def seconds(self) -> FloatArray:
        """Durations (L,) of the legs, s."""
        return np.array([segment.seconds for segment in self.segments])

    @cached_property
    def corners(self) -> FloatArray:
        """The tool point's start and the ends of the legs (L + 1, 3), m, in W."""
        start, *ends = (
            self.segments[0].curve.position(np.zeros(1)),
            *(segment.curve.position(np.ones(1)) for segment in self.segments),
        )
        return np.vstack([start, *ends])

    @property
    def open_legs(self) -> frozenset[int]:
        """Legs whose seconds are to be found."""
        return frozenset(k for k, segment in enumerate(self.segments) if segment.is_open)

    @cached_property
    def leg_times(self) -> FloatArray:
        """Times (L + 1,) at which the tool rests at the corners, s."""
        return np.concatenate([[0.0], np.cumsum(self.seconds)])

    @property
    def duration(self) -> float:
        """Total time T_C (Chang 2021, Eq. (33)), s."""
        return float(self.leg_times[-1])

    @cached_property
    def lengths(self) -> FloatArray:
        """Lengths (L,) of the legs, m."""
        return np.array([segment.curve.length for segment in self.segments])

    @cached_property
    def turns(self) -> bool:
        """Whether the tool's orientation changes along the path."""
        return any(segment.turn.any() or segment.curve.turns for segment in self.segments)

    @cached_property
    def _turns(self) -> FloatArray:
        """Rotation vectors (L, 3), rad, of the legs."""
        return np.array([segment.turn for segment in self.segments])

    @cached_property
    def _corner_rotations(self) -> FloatArray:
        """R_WT (L + 1, 3, 3) at the corners."""
        R = np.empty((len(self.segments) + 1, 3, 3))
        R[:] = self.orientation
        for k, turn in enumerate(Rotation.from_rotvec(self._turns).as_matrix()):
            R[k + 1] = turn @ R[k]
        return R

    def position(self, times: ArrayLike) -> FloatArray:
        """Return the tool point p_WT (N, 3), m, at `times` (N,)."""
        return self._of_legs(times, lambda curve, share: curve.position(share))

    def poses(self, times: ArrayLike) -> ToolPoses:
        """Return the timed poses of the tool at `times` (N,)."""
        return ToolPoses(point=self.position(times), rotation=self.rotation(times))

    def rotation(self, times: ArrayLike) -> FloatArray:
        """Return the timed orientations R_WT (N, 3, 3) at `times` (N,); (1, 3, 3) where all are the same."""
        if not self.turns:
            return self.orientation[None]
        leg, share = self.leg_shares(times)
        turn = Rotation.from_rotvec(share[:, None] * self._turns[leg]).as_matrix()
        R = turn @ self._corner_rotations[leg]
        for which, segment in self._on_legs(leg):
            prescribed = segment.curve.rotation(share[which])
            if prescribed is not None:
                R[which] = prescribed
        return np.asarray(R)

    @property
    def end_pose(self) -> FloatArray:
        """Pose (4, 4) of the tool in W where the path ends."""
        return turned_pose(self.corners[-1], self.rotation([self.duration])[0])

    def velocity(self, times: ArrayLike) -> FloatArray:
        """Return the tool point's velocity (N, 3), m/s, at `times` (N,)."""
        leg, u = self._locate(times)
        velocity = np.empty((len(leg), 3))
        for which, segment in self._on_legs(leg):
            rate = segment.law.rate(u[which]) / segment.seconds
            velocity[which] = rate[:, None] * segment.curve.slope(segment.law.share(u[which]))
        return velocity

    @cached_property
    def bends_unevenly(self) -> bool:
        """Whether via-points follow the bends of some leg: `via_times`."""
        return any(segment.curve.bend_share(np.ones(1)).any() for segment in self.segments)

    @cached_property
    def breaks(self) -> FloatArray:
        """Times (B,), s, between which the timed pose is analytic: ends of legs, of ramps and of curves."""
        times = list[FloatArray]()
        for begin, segment in zip(self.leg_times[:-1], self.segments, strict=True):
            shares = (segment.law.breaks, segment.law.time_share(segment.curve.breaks))
            times += [begin + each * segment.seconds for each in shares]
        return np.unique(np.concatenate(times))

    @cached_property
    def process_parts(self) -> FloatArray:
        """Where the tool has its process speed: times (P, 3), s, of beginnings and ends, and speeds, m/s."""
        parts = [
            (
                self.leg_times[k] + part.begin * segment.seconds,
                self.leg_times[k] + part.end * segment.seconds,
                part.length / ((part.end - part.begin) * segment.seconds),
            )
            for k, segment in enumerate(self.segments)
            if (part := segment.process) is not None
        ]
        return np.array(parts).reshape(-1, 3)

    def process_speed(self, times: ArrayLike) -> FloatArray:
        """Return the speeds (N,), m/s, that the process has at `times` (N,); zero where there is none."""
        t, parts = np.asarray(times, dtype=np.float64), self.process_parts
        if not len(parts):
            return np.zeros(len(t))
        near = _LEG_TIME_TOLERANCE * self.duration
        k = np.clip(np.searchsorted(parts[:, 0] - near, t, side="right") - 1, 0, len(parts) - 1)
        inside = (t >= parts[k, 0] - near) & (t <= parts[k, 1] + near)
        return np.where(inside, parts[k, 2], 0.0)

    @cached_property
    def section_times(self) -> FloatArray:
        """Times (S + 1,), s, at which there is a via-point in any case: ends of legs and of leads."""
        if not len(self.process_parts):
            return self.leg_times
        inside = np.clip(self.process_parts[:, :2].ravel(), 0.0, self.duration)
        times = np.unique(np.concatenate([self.leg_times, inside]))
        # A process part without leads ends where its leg does, but for rounding.
        apart = np.append(np.diff(times) > _LEG_TIME_TOLERANCE * self.duration, True)
        return np.asarray(times[apart])

    def arc_angle(self, times: ArrayLike, at: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return angles (N,), rad, and radii (N,), m, of the arcs that the tool point is on.

        Between two breaks the angle is a polynomial in time; both are zero where the tool point is one. On
        legs with a `roll` they are those of the curve in the plane.
        `at` (N,) are times between the breaks: they say which piece is meant, as two meet at a break.
        """
        angle, radius = np.zeros((2, len(np.asarray(times))))
        for which, segment, share, piece in self._pieces(times, at):
            angle[which], radius[which] = segment.curve.arc_angle(share, piece)
        return angle, radius

    def turn(self, times: ArrayLike, at: ArrayLike) -> FloatArray:
        """Return rotation vectors (N, 3), rad, from where the piece of `at` (N,) begins: see `arc_angle`."""
        leg, _ = self._locate(at)
        if not self.turns:
            return np.zeros((len(leg), 3))
        turn = np.empty((len(leg), 3))
        for which, segment, share, piece in self._pieces(times, at):
            prescribed = segment.curve.turn(share, piece)
            turn[which] = share[:, None] * segment.turn if prescribed is None else prescribed
        return turn

    def roll(self, at: ArrayLike) -> FloatArray:
        """Return curvatures (N,), 1/m, of the cylinders on which legs are rolled: see `Curve.roll`."""
        leg, share = self.leg_shares(at)
        curvature = np.empty(len(leg))
        for which, segment in self._on_legs(leg):
            curvature[which] = segment.curve.roll(share[which])
        return curvature

    def bend(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return bounds (K,) on how far unit tangents between two times are from that in their middle."""
        middle = 0.5 * (start + end)
        bound, (leg, _) = np.empty(len(start)), self._locate(middle)
        for which, segment, share, _ in self._pieces(middle, middle):
            ends = (segment.law.share(self._share_of(t[which], leg[which])) for t in (start, end))
            turned = segment.curve.turned
            angle = np.max([np.abs(turned(end_share) - turned(share)) for end_share in ends], axis=0)
            bound[which] = 2 * np.sin(0.5 * np.minimum(angle, np.pi))
        return bound

    def progress(self, time: float) -> float:
        """Share of the path's length that is covered at `time`; of a path without length, of its time."""
        leg, share = self.leg_shares([time])
        if not self.lengths.sum() > 0:
            return float(np.clip(time / self.duration, 0.0, 1.0))
        covered = self.lengths[: leg[0]].sum() + share[0] * self.lengths[leg[0]]
        return float(covered / self.lengths.sum())

    def via_times(self, count: int) -> FloatArray:
        """Times t_j (count,) of the via-points: leg ends, and equal steps within each leg (Eq. (23)).

        The ends of leads are among them, and the steps are equal between these. On a spline, which bends
        unevenly, they are equal in the sum of the shares of the time and of the bend.

        Raises
        ------
        InputError
            When `count` cannot give every leg, or lead, a segment.
        """
        ends = self.section_times
        segments = share_out_segments(np.diff(ends) if len(self.process_parts) else self.seconds, count - 1)
        pieces = [
            self._even_times(start, end, m)[:-1]
            for start, end, m in zip(ends[:-1], ends[1:], segments, strict=True)
        ]
        return np.concatenate([*pieces, ends[-1:]])

    def _even_times(self, start: float, end: float, steps: int) -> FloatArray:
        """Times (steps + 1,) from one to another one on the same leg."""
        even = np.linspace(start, end, steps + 1)
        leg = int(self._locate([0.5 * (start + end)])[0][0])
        segment = self.segments[leg]
        shares = np.concatenate([[0.0], segment.curve.breaks, [1.0]])
        bend = segment.curve.bend_share(shares)
        if not bend.any():
            return even
        at = self.leg_times[leg] + segment.seconds * segment.law.time_share(shares)
        times = np.concatenate([[start], at[(at > start) & (at < end)], [end]])
        even_way = np.diff(times) / (end - start)
        bends = np.minimum(np.diff(np.interp(times, at, bend)), _DENSEST * even_way)
        way = np.append(0.0, np.cumsum(even_way + bends))
        return np.asarray(np.interp(way[-1] * np.linspace(0.0, 1.0, steps + 1), way, times))

    def leg_directions(self, times: ArrayLike) -> FloatArray:
        """Return unit vectors (N, 3) along the legs at `times`; zero for a leg of no length."""
        return self._of_legs(times, lambda curve, share: curve.tangent(share))

    def is_curved(self, times: ArrayLike) -> BoolArray:
        """Return which of `times` (N,) are on legs that are no straight lines."""
        curved = np.array([not segment.is_straight for segment in self.segments])
        return np.asarray(curved[self._locate(times)[0]])

    def leg_offset(self, times: ArrayLike, p: FloatArray) -> FloatArray:
        """Return the vector (N, 3), m, to each of `p` (N, 3) from the nearest point of the leg at `times`.

        On a curved leg it is that from the nearest point of the tangent at the timed place.
        """
        leg, share = self.leg_shares(times)
        offset = np.empty((len(leg), 3))
        for which, segment in self._on_legs(leg):
            offset[which] = segment.curve.offset(share[which], p[which])
        return offset

    def outline(self) -> FloatArray:
        """Return points (k, 3), m, whose straight connections show the path: its corners, more on curves."""
        shares = np.linspace(0.0, 1.0, _POINTS_PER_CURVE)[:-1]
        legs = [(segment.curve, shares[:1] if segment.is_straight else shares) for segment in self.segments]
        pieces = [curve.position(share) for curve, share in legs]
        return np.vstack([*pieces, self.corners[-1:]])

    def reversed(self) -> ToolPath:
        """Return the path from its end to its start."""
        segments = tuple(segment.reversed() for segment in self.segments[::-1])
        return replace(self, segments=segments, orientation=self._corner_rotations[-1])

    def repeated(self, passes: int) -> ToolPath:
        """Return the path followed so many times, to and fro, from rest to rest each time."""
        there, back = self.segments, self.reversed().segments if passes > 1 else ()
        return replace(self, segments=(there + back) * (passes // 2) + there * (passes % 2))

    def timed(self, laws: Sequence[LegLaw]) -> ToolPath:
        """Return the path with the legs' seconds as they were found."""
        segments = list(self.segments)
        for found in laws:
            segments[found.leg] = replace(
                segments[found.leg], seconds=found.duration, law=found.law, is_open=False
            )
        return replace(self, segments=tuple(segments))

    def with_law(self, law: TimeLaw, legs: Collection[int]) -> ToolPath:
        """Return the path with another law of some legs."""
        segments = enumerate(self.segments)
        changed = tuple(replace(leg, law=law) if k in legs else leg for k, leg in segments)
        return replace(self, segments=changed)

    def in_seconds(self, seconds: FloatArray) -> ToolPath:
        """Return the path with other durations (L,), s, of its legs."""
        legs = zip(self.segments, seconds, strict=True)
        return replace(self, segments=tuple(replace(leg, seconds=float(time)) for leg, time in legs))

    def leg_shares(self, times: ArrayLike) -> tuple[IntArray, FloatArray]:
        """Return the legs (N,) at `times` (N,), and the shares (N,) of their lengths that are covered."""
        leg, share = self._locate(times)
        for which, segment in self._on_legs(leg):
            share[which] = segment.law.share(share[which])
        return leg, share

    def times_at(self, legs: ArrayLike, shares: ArrayLike) -> FloatArray:
        """Return the times (N,), s, at which shares (N,) of the lengths of legs, (N,) or one, are covered."""
        leg, share = np.broadcast_arrays(np.asarray(legs, dtype=np.intp), np.asarray(shares, dtype=float))
        times = np.empty(len(share))
        for which, segment in self._on_legs(leg):
            times[which] = self.leg_times[leg[which]] + segment.law.time_share(share[which]) * segment.seconds
        return times

    def leg_to(self, time: float) -> int:
        """Return the leg that leads to a time, s: at the end of one, that one."""
        return int(np.clip(np.searchsorted(self.leg_times, time) - 1, 0, len(self.segments) - 1))

    def held(self) -> ToolPath:
        """Return the path of a tool that stays, for a second, where this one starts."""
        law, corners = self.segments[0].law, np.repeat(self.corners[:1], 2, axis=0)
        segment = Segment(curve=Line(*corners), seconds=1.0, law=law)
        return replace(self, segments=(segment,))

    def _locate(self, times: ArrayLike) -> tuple[IntArray, FloatArray]:
        """Leg (N,) and share of its duration (N,) at `times`; outside the path, its nearer end."""
        t: FloatArray = np.clip(np.asarray(times, dtype=np.float64), 0.0, self.duration)
        leg = np.clip(np.searchsorted(self.leg_times, t, side="right") - 1, 0, len(self.seconds) - 1)
        return leg, self._share_of(t, leg)

    def _share_of(self, times: ArrayLike, leg: IntArray) -> FloatArray:
        """Share of the legs' durations (N,) at `times`; outside them, their nearer end."""
        return np.clip((np.asarray(times) - self.leg_times[leg]) / self.seconds[leg], 0.0, 1.0)

    def _of_legs(self, times: ArrayLike, vectors: Callable[[Curve, FloatArray], FloatArray]) -> FloatArray:
        """What a function of curve and shares yields (N, 3) at `times` (N,)."""
        leg, share = self.leg_shares(times)
        values = np.empty((len(leg), 3))
        for which, segment in self._on_legs(leg):
            values[which] = vectors(segment.curve, share[which])
        return values

    def _on_legs(self, leg: IntArray) -> Iterator[tuple[IntArray, Segment]]:
        """Yield the segments that are some of the legs (N,), and which of these."""
        for k in np.unique(leg):
            yield np.flatnonzero(leg == k), self.segments[k]

    def _pieces(
        self, times: ArrayLike, at: ArrayLike
    ) -> Iterator[tuple[IntArray, Segment, FloatArray, FloatArray]]:
        """Yield of each segment which of the times (N,) `at` are on it, and the shares at both times."""
        leg, u = self._locate(at)
        now = self._share_of(times, leg)
        for which, segment in self._on_legs(leg):
            yield which, segment, segment.law.share(now[which]), segment.law.share(u[which])


def share_out_segments(seconds: Sequence[float] | FloatArray, segments: int) -> list[int]:
    """Distribute spline segments over legs by their durations (D'Hondt's method).

    Every leg has one; each further one goes to the leg, the earlier first, whose segments then are longest.

    Raises
    ------
    InputError
        When there are fewer segments than legs.
    """
    if segments < len(seconds):
        raise InputError("via_points", "", segments + 1, f"at least {len(seconds) + 1}, one per leg end")
    # Durations that only rounding tells apart, such as those of equal rows, are the same.
    seconds = np.round(np.asarray(seconds) / np.sum(seconds), _LEG_SHARE_DIGITS)
    shares = [1] * len(seconds)
    longest = [(-0.5 * float(duration), leg) for leg, duration in enumerate(seconds)]
    heapify(longest)
    for _ in range(segments - len(seconds)):
        leg = longest[0][1]
        shares[leg] += 1
        heapreplace(longest, (-float(seconds[leg]) / (shares[leg] + 1), leg))
    return shares
