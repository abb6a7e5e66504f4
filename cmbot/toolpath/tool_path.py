"""The tool path: legs from the initial tool pose, each from rest to rest and timed by a law."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from heapq import heapify, heapreplace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.common.representation import short_repr
from cmbot.toolpath.curves import Curve
from cmbot.toolpath.time_law import LegLaw, ProcessPart, SpeedProfile, TimeLaw
from cmbot.toolpath.tool_poses import ToolPoses

_NO_LENGTH = 1e-300
# Points by which a curve is shown.
_SHOWN = 41
# Times nearer to each other than this share of the duration are the same.
_SAME_TIME = 1e-9
# Digits of the shares of the duration that legs have.
_DIGITS = 9


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolPath:
    """Legs, each from rest to rest, with one speed profile: straight lines, or the curves that are given.

    Attributes
    ----------
    corners : (L + 1, 3), m
        The tool point's start and the ends of the L legs, in W.
    orientation : (3, 3)
        R_WT at the start.
    seconds : (L,), s
        Durations of the legs.
    profile : SpeedProfile
    rotations : (L, 3), rad, or None
        Rotation vectors in W by which the tool turns along each leg, about a fixed axis and in proportion to
        the share of the leg that is covered. None: it keeps its orientation.
    curves : mapping of int to Curve
        Those of the legs that are no straight lines.
    laws : mapping of int to TimeLaw
        Those of the legs that are not timed by `profile`.
    process : mapping of int to ProcessPart
        Of the legs that have a process speed between two leads.
    open_legs : frozenset of int
        Legs whose seconds are to be found: those here are a first guess.
    """

    corners: FloatArray
    orientation: FloatArray
    seconds: FloatArray
    profile: SpeedProfile
    rotations: FloatArray | None = None
    curves: Mapping[int, Curve] = field(default_factory=dict)
    laws: Mapping[int, TimeLaw] = field(default_factory=dict)
    process: Mapping[int, ProcessPart] = field(default_factory=dict)
    open_legs: frozenset[int] = frozenset()

    __repr__ = short_repr

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
        lengths = np.linalg.norm(self._edges, axis=1)
        for k, curve in self.curves.items():
            lengths[k] = curve.length
        return np.asarray(lengths)

    @cached_property
    def _edges(self) -> FloatArray:
        return np.diff(self.corners, axis=0)

    @cached_property
    def turns(self) -> bool:
        """Whether the tool's orientation changes along the path."""
        return bool(self._rotation_vectors.any()) or any(curve.turns for curve in self.curves.values())

    @cached_property
    def _rotation_vectors(self) -> FloatArray:
        return np.zeros((len(self.seconds), 3)) if self.rotations is None else self.rotations

    @cached_property
    def _corner_rotations(self) -> FloatArray:
        """R_WT (L + 1, 3, 3) at the corners."""
        R = np.empty((len(self.corners), 3, 3))
        R[:] = self.orientation
        for k, turn in enumerate(Rotation.from_rotvec(self._rotation_vectors).as_matrix()):
            R[k + 1] = turn @ R[k]
        return R

    def position(self, times: ArrayLike) -> FloatArray:
        """Return the tool point p_WT (N, 3), m, at `times` (N,)."""
        leg, u = self._locate(times)
        share = self._share(leg, u)
        p = self.corners[leg] + share[:, None] * self._edges[leg]
        for which, curve in self._on_curves(leg):
            p[which] = curve.position(share[which])
        return p

    def poses(self, times: ArrayLike) -> ToolPoses:
        """Return the timed poses of the tool at `times` (N,)."""
        return ToolPoses(point=self.position(times), rotation=self.rotation(times))

    def rotation(self, times: ArrayLike) -> FloatArray:
        """Return the timed orientations R_WT (N, 3, 3) at `times` (N,); (1, 3, 3) where all are the same."""
        if not self.turns:
            return self.orientation[None]
        leg, u = self._locate(times)
        share = self._share(leg, u)
        turn = Rotation.from_rotvec(share[:, None] * self._rotation_vectors[leg]).as_matrix()
        R = turn @ self._corner_rotations[leg]
        for which, curve in self._on_curves(leg):
            prescribed = curve.rotation(share[which])
            if prescribed is not None:
                R[which] = prescribed
        return np.asarray(R)

    @property
    def end_pose(self) -> FloatArray:
        """Pose (4, 4) of the tool in W where the path ends."""
        X_WT = np.eye(4)
        X_WT[:3, 3], X_WT[:3, :3] = self.corners[-1], self.rotation([self.duration])[0]
        return X_WT

    def velocity(self, times: ArrayLike) -> FloatArray:
        """Return the tool point's velocity (N, 3), m/s, at `times` (N,)."""
        leg, u = self._locate(times)
        slope, share, rate = self._edges[leg], self._share(leg, u), self.profile.rate(u)
        for which, curve in self._on_curves(leg):
            slope[which] = curve.slope(share[which])
        for which, law in self._by_laws(leg):
            rate[which] = law.rate(u[which])
        return np.asarray((rate / self.seconds[leg])[:, None] * slope)

    @cached_property
    def breaks(self) -> FloatArray:
        """Times (B,), s, between which the timed pose is analytic: ends of legs, of ramps and of curves."""
        times = list[FloatArray]()
        for k, seconds in enumerate(self.seconds):
            law = self._law(k)
            shares = [law.breaks]
            if k in self.curves:
                shares.append(law.time_share(self.curves[k].breaks))
            times += [self.leg_times[k] + each * seconds for each in shares]
        return np.unique(np.concatenate(times))

    @cached_property
    def process_parts(self) -> FloatArray:
        """Where the tool has its process speed: times (P, 3), s, of beginnings and ends, and speeds, m/s."""
        parts = [
            (
                self.leg_times[k] + part.begin * self.seconds[k],
                self.leg_times[k] + part.end * self.seconds[k],
                part.length / ((part.end - part.begin) * self.seconds[k]),
            )
            for k, part in sorted(self.process.items())
        ]
        return np.array(parts).reshape(-1, 3)

    def process_speed(self, times: ArrayLike) -> FloatArray:
        """Return the speeds (N,), m/s, that the process has at `times` (N,); zero where there is none."""
        t, parts = np.asarray(times, dtype=np.float64), self.process_parts
        if not len(parts):
            return np.zeros(len(t))
        near = _SAME_TIME * self.duration
        k = np.clip(np.searchsorted(parts[:, 0] - near, t, side="right") - 1, 0, len(parts) - 1)
        inside = (t >= parts[k, 0] - near) & (t <= parts[k, 1] + near)
        return np.where(inside, parts[k, 2], 0.0)

    @cached_property
    def section_times(self) -> FloatArray:
        """Times (S + 1,), s, at which there is a via-point in any case: ends of legs and of leads."""
        if not self.process:
            return self.leg_times
        inside = np.clip(self.process_parts[:, :2].ravel(), 0.0, self.duration)
        times = np.unique(np.concatenate([self.leg_times, inside]))
        # A process part without leads ends where its leg does, but for rounding.
        apart = np.append(np.diff(times) > _SAME_TIME * self.duration, True)
        return np.asarray(times[apart])

    def arc_angle(self, times: ArrayLike, at: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return angles (N,), rad, and radii (N,), m, of the arcs that the tool point is on.

        Between two breaks the angle is a polynomial in time; both are zero where the tool point is one. On
        legs with a `roll` they are those of the curve in the plane.
        `at` (N,) are times between the breaks: they say which piece is meant, as two meet at a break.
        """
        angle, radius = np.zeros((2, len(np.asarray(times))))
        for which, curve, share, piece in self._curved(times, at):
            angle[which], radius[which] = curve.arc_angle(share, piece)
        return angle, radius

    def turn(self, times: ArrayLike, at: ArrayLike) -> FloatArray:
        """Return rotation vectors (N, 3), rad, from where the piece of `at` (N,) begins: see `arc_angle`."""
        leg, _ = self._locate(at)
        if not self.turns:
            return np.zeros((len(leg), 3))
        turn = np.asarray(self._share(leg, self._share_of(times, leg))[:, None] * self._rotation_vectors[leg])
        for which, curve, share, piece in self._curved(times, at):
            prescribed = curve.turn(share, piece)
            if prescribed is not None:
                turn[which] = prescribed
        return turn

    def roll(self, at: ArrayLike) -> FloatArray:
        """Return curvatures (N,), 1/m, of the cylinders on which legs are rolled: see `Curve.roll`."""
        leg, u = self._locate(at)
        curvature, share = np.zeros(len(leg)), self._share(leg, u)
        for which, curve in self._on_curves(leg):
            curvature[which] = curve.roll(share[which])
        return curvature

    def bend(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return bounds (K,) on how far unit tangents between two times are from that in their middle.

        A curve's curvature times its length bounds how fast its tangent turns by the share.
        """
        middle = 0.5 * (start + end)
        bound = np.zeros(len(start))
        for which, curve, share, _ in self._curved(middle, middle):
            leg, _ = self._locate(middle[which])
            ends = (self._share(leg, self._share_of(t[which], leg)) for t in (start, end))
            furthest = np.max([np.abs(each - share) for each in ends], axis=0)
            angle = np.minimum(curve.curvature * curve.length * furthest, np.pi)
            bound[which] = 2 * np.sin(0.5 * angle)
        return bound

    def progress(self, time: float) -> float:
        """Share of the path's length that is covered at `time`; of a path without length, of its time."""
        leg, u = self._locate([time])
        if not self.lengths.sum() > 0:
            return float(np.clip(time / self.duration, 0.0, 1.0))
        covered = self.lengths[: leg[0]].sum() + self._share(leg, u)[0] * self.lengths[leg[0]]
        return float(covered / self.lengths.sum())

    def via_times(self, count: int) -> FloatArray:
        """Times t_j (count,) of the via-points: leg ends, and equal steps within each leg (Eq. (23)).

        The ends of leads are among them, and the steps are equal between these.

        Raises
        ------
        InputError
            When `count` cannot give every leg, or lead, a segment.
        """
        ends = self.section_times
        segments = share_out_segments(np.diff(ends) if self.process else self.seconds, count - 1)
        pieces = [
            np.linspace(start, end, m, endpoint=False)
            for start, end, m in zip(ends[:-1], ends[1:], segments, strict=True)
        ]
        return np.concatenate([*pieces, ends[-1:]])

    def leg_directions(self, times: ArrayLike) -> FloatArray:
        """Return unit vectors (N, 3) along the legs at `times`; zero for a leg of no length."""
        leg, u = self._locate(times)
        along = self._edges[leg] / np.maximum(self.lengths[leg], _NO_LENGTH)[:, None]
        share = self._share(leg, u)
        for which, curve in self._on_curves(leg):
            along[which] = curve.tangent(share[which])
        return np.asarray(along)

    def is_curved(self, times: ArrayLike) -> BoolArray:
        """Return which of `times` (N,) are on legs that are no straight lines."""
        curved = np.zeros(len(self.seconds), dtype=np.bool_)
        curved[list(self.curves)] = True
        return curved[self._locate(times)[0]]

    def leg_offset(self, times: ArrayLike, p: FloatArray) -> FloatArray:
        """Return the vector (N, 3), m, to each of `p` (N, 3) from the nearest point of the leg at `times`.

        On a curved leg it is that from the nearest point of the tangent at the timed place.
        """
        leg, u = self._locate(times)
        edge, away = self._edges[leg], p - self.corners[leg]
        along = np.einsum("nd,nd->n", away, edge) / np.maximum(self.lengths[leg] ** 2, _NO_LENGTH)
        offset, shares = away - np.clip(along, 0.0, 1.0)[:, None] * edge, self._share(leg, u)
        for which, curve in self._on_curves(leg):
            share = shares[which]
            away, tangent = p[which] - curve.position(share), curve.tangent(share)
            offset[which] = away - np.einsum("nd,nd->n", away, tangent)[:, None] * tangent
        return np.asarray(offset)

    def outline(self) -> FloatArray:
        """Return points (k, 3), m, whose straight connections show the path: its corners, more on curves."""
        shares = np.linspace(0.0, 1.0, _SHOWN)[:-1]
        pieces = [
            self.curves[k].position(shares) if k in self.curves else self.corners[k : k + 1]
            for k in range(len(self.seconds))
        ]
        return np.vstack([*pieces, self.corners[-1:]])

    def reversed(self) -> ToolPath:
        """Return the path from its end to its start."""
        last = len(self.seconds) - 1
        return replace(
            self,
            corners=self.corners[::-1],
            orientation=self._corner_rotations[-1],
            seconds=self.seconds[::-1],
            rotations=None if self.rotations is None else -self.rotations[::-1],
            curves={last - k: curve.reversed() for k, curve in self.curves.items()},
            laws={last - k: law.reversed() for k, law in self.laws.items()},
            process={
                last - k: replace(part, begin=1 - part.end, end=1 - part.begin)
                for k, part in self.process.items()
            },
            open_legs=frozenset(last - k for k in self.open_legs),
        )

    def repeated(self, passes: int) -> ToolPath:
        """Return the path followed so many times, to and fro, from rest to rest each time."""
        each = [self if k % 2 == 0 else self.reversed() for k in range(passes)]
        legs = len(self.seconds)

        def of_all(name: str) -> dict[int, Any]:
            return {n * legs + k: x for n, path in enumerate(each) for k, x in getattr(path, name).items()}

        return replace(
            self,
            corners=np.vstack([self.corners[:1], *(path.corners[1:] for path in each)]),
            seconds=np.concatenate([path.seconds for path in each]),
            rotations=None
            if self.rotations is None
            else np.concatenate([path.rotations for path in each if path.rotations is not None]),
            curves=of_all("curves"),
            laws=of_all("laws"),
            process=of_all("process"),
            open_legs=frozenset(n * legs + k for n, path in enumerate(each) for k in path.open_legs),
        )

    def timed(self, laws: Sequence[LegLaw]) -> ToolPath:
        """Return the path with the legs' seconds as they were found."""
        seconds = self.seconds.copy()
        for each in laws:
            seconds[each.leg] = each.duration
        return replace(
            self,
            seconds=seconds,
            laws={**self.laws, **{each.leg: each.law for each in laws}},
            open_legs=self.open_legs - {each.leg for each in laws},
        )

    def leg_shares(self, times: ArrayLike) -> tuple[IntArray, FloatArray]:
        """Return the legs (N,) at `times` (N,), and the shares (N,) of their lengths that are covered."""
        leg, u = self._locate(times)
        return leg, self._share(leg, u)

    def times_at(self, leg: int, shares: FloatArray) -> FloatArray:
        """Return the times (N,), s, at which shares (N,) of a leg's length are covered."""
        times = self.leg_times[leg] + self._law(leg).time_share(shares) * self.seconds[leg]
        return np.asarray(times)

    def held(self) -> ToolPath:
        """Return the path of a tool that stays, for a second, where this one starts."""
        corners = np.repeat(self.corners[:1], 2, axis=0)
        plain = replace(self, laws={}, process={}, open_legs=frozenset())
        return replace(plain, corners=corners, seconds=np.ones(1), rotations=None, curves={})

    def _locate(self, times: ArrayLike) -> tuple[IntArray, FloatArray]:
        """Leg (N,) and share of its duration (N,) at `times`; outside the path, its nearer end."""
        t: FloatArray = np.clip(np.asarray(times, dtype=np.float64), 0.0, self.duration)
        leg = np.clip(np.searchsorted(self.leg_times, t, side="right") - 1, 0, len(self.seconds) - 1)
        return leg, self._share_of(t, leg)

    def _share_of(self, times: ArrayLike, leg: IntArray) -> FloatArray:
        """Share of the legs' durations (N,) at `times`; outside them, their nearer end."""
        return np.clip((np.asarray(times) - self.leg_times[leg]) / self.seconds[leg], 0.0, 1.0)

    def _law(self, leg: int) -> TimeLaw:
        """What a leg is timed by."""
        return self.laws.get(leg, self.profile)

    def _share(self, leg: IntArray, u: FloatArray) -> FloatArray:
        """Shares of the legs' lengths (N,) at shares `u` (N,) of their durations."""
        share = self.profile.share(u)
        for which, law in self._by_laws(leg):
            share[which] = law.share(u[which])
        return share

    def _by_laws(self, leg: IntArray) -> Iterator[tuple[IntArray, TimeLaw]]:
        """Yield the laws by which some of the legs (N,) are timed, and which of these."""
        for k, law in self.laws.items():
            which = np.flatnonzero(leg == k)
            if len(which):
                yield which, law

    def _on_curves(self, leg: IntArray) -> Iterator[tuple[IntArray, Curve]]:
        """Yield the curves that some of the legs (N,) follow, and which of these."""
        for k, curve in self.curves.items():
            which = np.flatnonzero(leg == k)
            if len(which):
                yield which, curve

    def _curved(
        self, times: ArrayLike, at: ArrayLike
    ) -> Iterator[tuple[IntArray, Curve, FloatArray, FloatArray]]:
        """Yield which of the times (N,) `at` are on curved legs, the curve, and shares at both times."""
        leg, u = self._locate(at)
        share, there = self._share(leg, self._share_of(times, leg)), self._share(leg, u)
        for which, curve in self._on_curves(leg):
            yield which, curve, share[which], there[which]


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
    seconds = np.round(np.asarray(seconds) / np.sum(seconds), _DIGITS)
    shares = [1] * len(seconds)
    longest = [(-0.5 * float(duration), leg) for leg, duration in enumerate(seconds)]
    heapify(longest)
    for _ in range(segments - len(seconds)):
        leg = longest[0][1]
        shares[leg] += 1
        heapreplace(longest, (-float(seconds[leg]) / (shares[leg] + 1), leg))
    return shares
