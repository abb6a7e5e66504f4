"""The tool path: straight legs from the initial tool pose, each timed by a speed profile."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heapify, heapreplace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.common.validation import CheckedFields, refusal
from cmbot.scene.fields import Vector

__all__ = ["Leg", "ShiftedToolPath", "SpeedProfile", "ToolPath", "ToolPoses", "share_out_segments"]

_SHORTEST_LEG = 1e-6  # m
_NO_LENGTH = 1e-300
# Corners that agree to this many digits after the point, m, are one: the rest is rounding of the legs' sum.
_DIGITS = 12
# Points whose nearest legs are sought in one call.
_BLOCK = 512


def _long_enough(by: Vector) -> Vector:
    if max(map(abs, by)) < _SHORTEST_LEG:
        raise refusal("a leg longer than a micrometre", got=by)
    return by


@dataclass(frozen=True, kw_only=True)
class SpeedProfile(CheckedFields):
    """How the tool speeds up and slows down along a leg: from rest to rest, symmetric in time.

    Attributes
    ----------
    kind : str
        ``trapezoidal``: constant acceleration in the ramps, as in the paper.
        ``jerk_limited``: acceleration rises and falls linearly in the ramps, so jerk is bounded.
    ramp : float
        Share of a leg's duration spent speeding up, and again slowing down, 0.001 to 0.5.

    Raises
    ------
    InputError
        When `kind` is unknown or `ramp` is out of range.
    """

    kind: Literal["trapezoidal", "jerk_limited"] = "trapezoidal"
    ramp: Annotated[float, Field(ge=1e-3, le=0.5)] = 0.2

    def share(self, u: FloatArray) -> FloatArray:
        """Share of the length covered at share `u` of the duration, both in [0, 1]."""
        late = u > 0.5
        x = np.where(late, 1 - u, u)
        ramp = self.ramp * self._ramp_integral(np.minimum(x / self.ramp, 1.0))
        covered = (ramp + np.maximum(x - self.ramp, 0.0)) / (1 - self.ramp)
        return np.where(late, 1 - covered, covered)

    def rate(self, u: FloatArray) -> FloatArray:
        """Derivative of `share`: speed in units of length over duration."""
        x = np.minimum(np.minimum(u, 1 - u) / self.ramp, 1.0)
        return self._ramp(x) / (1 - self.ramp)

    def _ramp(self, x: FloatArray) -> FloatArray:
        """Share of the cruising speed reached at share x of a ramp."""
        if self.kind == "trapezoidal":
            return x
        return np.where(x < 0.5, 2 * x**2, 1 - 2 * (1 - x) ** 2)

    def _ramp_integral(self, x: FloatArray) -> FloatArray:
        if self.kind == "trapezoidal":
            return x**2 / 2
        return np.where(x < 0.5, 2 * x**3 / 3, x - 0.5 + 2 * (1 - x) ** 3 / 3)


@dataclass(frozen=True, kw_only=True)
class Leg(CheckedFields):
    """A straight leg of the tool's path.

    Attributes
    ----------
    by : tuple of float
        Displacement in W, m.
    seconds : float
        Duration, s.

    Raises
    ------
    InputError
        When a field is out of its bounds, or the leg shorter than a micrometre.
    """

    by: Annotated[Vector, AfterValidator(_long_enough)]
    seconds: Annotated[float, Field(ge=1e-3, le=36_000)]


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolPoses:
    """Poses of the tool in W.

    Attributes
    ----------
    point : (N, 3), m
    rotation : (N, 3, 3), or (1, 3, 3) where all have the same
        R_WT.
    """

    point: FloatArray
    rotation: FloatArray

    def __len__(self) -> int:
        return len(self.point)

    def __getitem__(self, which: IntArray | BoolArray | slice | int) -> ToolPoses:
        """Return some of the poses; of one index, that one."""
        chosen = slice(which, which + 1 or None) if isinstance(which, int | np.integer) else which
        rotation = self.rotation if len(self.rotation) == 1 else self.rotation[chosen]
        return ToolPoses(point=self.point[chosen], rotation=rotation)

    def __iter__(self) -> Iterator[ToolPoses]:
        """Yield the poses one by one."""
        return (self[k] for k in range(len(self)))


@dataclass(frozen=True, kw_only=True)
class ToolPath:
    """Straight legs, each from rest to rest, with one speed profile.

    Attributes
    ----------
    corners : (L + 1, 3), m
        The tool point's start and the ends of the L legs, in W.
    orientation : (3, 3)
        R_WT, kept all along.
    seconds : (L,), s
        Durations of the legs.
    profile : SpeedProfile
    """

    corners: FloatArray
    orientation: FloatArray
    seconds: FloatArray
    profile: SpeedProfile

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
        return np.asarray(np.linalg.norm(self._edges, axis=1))

    @cached_property
    def _edges(self) -> FloatArray:
        return np.diff(self.corners, axis=0)

    def position(self, times: ArrayLike) -> FloatArray:
        """Return the tool point p_WT (N, 3), m, at `times` (N,)."""
        leg, u = self._locate(times)
        return self.corners[leg] + self.profile.share(u)[:, None] * self._edges[leg]

    def poses(self, times: ArrayLike) -> ToolPoses:
        """Return the timed poses of the tool at `times` (N,)."""
        return ToolPoses(point=self.position(times), rotation=self.orientation[None])

    @property
    def turns(self) -> bool:
        """Whether the tool's orientation changes along the path."""
        return False

    def velocity(self, times: ArrayLike) -> FloatArray:
        """Return the tool point's velocity (N, 3), m/s, at `times` (N,)."""
        leg, u = self._locate(times)
        return np.asarray((self.profile.rate(u) / self.seconds[leg])[:, None] * self._edges[leg])

    @cached_property
    def breaks(self) -> FloatArray:
        """Times (B,), s, between which the timed position is a polynomial: ends of legs and of ramps."""
        ramp = self.profile.ramp
        shares = [0.0, ramp, 1 - ramp, 1.0]
        if self.profile.kind == "jerk_limited":
            shares += [0.5 * ramp, 1 - 0.5 * ramp]
        return np.unique(self.leg_times[:-1, None] + np.array(shares) * self.seconds[:, None])

    def progress(self, time: float) -> float:
        """Share of the path's length that is covered at `time`."""
        leg, u = self._locate([time])
        covered = self.lengths[: leg[0]].sum() + self.profile.share(u)[0] * self.lengths[leg[0]]
        return float(covered / self.lengths.sum())

    def via_times(self, count: int) -> FloatArray:
        """Times t_j (count,) of the via-points: leg ends, and equal steps within each leg (Eq. (23)).

        Raises
        ------
        InputError
            When `count` cannot give every leg a segment.
        """
        segments = share_out_segments(self.seconds, count - 1)
        pieces = [
            np.linspace(start, end, m, endpoint=False)
            for start, end, m in zip(self.leg_times[:-1], self.leg_times[1:], segments, strict=True)
        ]
        return np.concatenate([*pieces, self.leg_times[-1:]])

    def leg_directions(self, times: ArrayLike) -> FloatArray:
        """Return unit vectors (N, 3) along the legs at `times`; zero for a leg of no length."""
        leg, _ = self._locate(times)
        return np.asarray(self._edges[leg] / np.maximum(self.lengths[leg], _NO_LENGTH)[:, None])

    def leg_offset(self, times: ArrayLike, p: FloatArray) -> FloatArray:
        """Return the vector (N, 3), m, to each of `p` (N, 3) from the nearest point of the leg at `times`."""
        return self._offset_from(self._locate(times)[0], p)

    def offset(self, p: FloatArray) -> FloatArray:
        """Return the vector from the nearest point of the legs to each of `p` (N, 3), (N, 3), m."""
        blocks = [self._nearest_offset(p[k : k + _BLOCK]) for k in range(0, len(p), _BLOCK)]
        return np.concatenate([np.empty((0, 3)), *blocks])

    def _nearest_offset(self, p: FloatArray) -> FloatArray:
        """`offset` of points near each other: most legs are then too far from all of them."""
        legs = self._distinct_legs
        centre = p.mean(axis=0)
        radius = np.linalg.norm(p - centre, axis=1).max()
        away = np.linalg.norm(self._offset_from(legs, np.tile(centre, (len(legs), 1))), axis=1)
        # Not "<=": points that are not finite leave no leg out.
        near = legs[~(away - radius > away.min() + radius)]
        offsets = self._offset_from(near, p[:, None])
        nearest = np.einsum("nld,nld->nl", offsets, offsets).argmin(axis=1)
        return np.asarray(offsets[np.arange(len(p)), nearest])

    @cached_property
    def _distinct_legs(self) -> IntArray:
        """Legs without those between the same corners as an earlier one, such as strokes to and fro."""
        corner = np.unique(np.round(self.corners, _DIGITS), axis=0, return_inverse=True)[1].ravel()
        ends = np.sort(np.stack([corner[:-1], corner[1:]], axis=1), axis=1)
        return np.sort(np.unique(ends, axis=0, return_index=True)[1])

    def _offset_from(self, leg: IntArray, p: FloatArray) -> FloatArray:
        """Vectors (..., 3) from the nearest points of legs (...) to points (..., 3)."""
        edge, away = self._edges[leg], p - self.corners[leg]
        along = np.einsum("...d,...d->...", away, edge) / np.maximum(self.lengths[leg] ** 2, _NO_LENGTH)
        return np.asarray(away - np.clip(along, 0.0, 1.0)[..., None] * edge)

    def _locate(self, times: ArrayLike) -> tuple[IntArray, FloatArray]:
        """Leg (N,) and share of its duration (N,) at `times`; outside the path, its nearer end."""
        t: FloatArray = np.clip(np.asarray(times, dtype=np.float64), 0.0, self.duration)
        leg = np.clip(np.searchsorted(self.leg_times, t, side="right") - 1, 0, len(self.seconds) - 1)
        return leg, np.clip((t - self.leg_times[leg]) / self.seconds[leg], 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class ShiftedToolPath(ToolPath):
    """A tool path that is displaced over time; `offset` is measured from the path without displacement.

    Attributes
    ----------
    shift : callable
        From times (N,), s, to displacements (N, 3), m; smooth.
    """

    shift: Callable[[FloatArray], FloatArray]

    def position(self, times: ArrayLike) -> FloatArray:
        """Return the displaced tool point (N, 3), m, at `times` (N,)."""
        return super().position(times) + self._shift(times)

    def leg_offset(self, times: ArrayLike, p: FloatArray) -> FloatArray:
        """Return the vector (N, 3), m, to each of `p` (N, 3) from the nearest point of the displaced leg."""
        return super().leg_offset(times, p - self._shift(times))

    def _shift(self, times: ArrayLike) -> FloatArray:
        return np.asarray(self.shift(np.clip(np.asarray(times, dtype=np.float64), 0.0, self.duration)))


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
    shares = [1] * len(seconds)
    longest = [(-0.5 * float(duration), leg) for leg, duration in enumerate(seconds)]
    heapify(longest)
    for _ in range(segments - len(seconds)):
        leg = longest[0][1]
        shares[leg] += 1
        heapreplace(longest, (-float(seconds[leg]) / (shares[leg] + 1), leg))
    return shares
