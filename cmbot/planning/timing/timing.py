"""The time laws that an attempt has, and the motion along whose joint path they are the shortest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning.request import StrokeRequest
from cmbot.toolpath import LegLaw
from cmbot.trajectory import QuinticTrajectory

# Legs of so few periods of the slowest mode are short. Via-points of quiet strokes, where these are no more
# than so many; strokes with short legs have so many at most.
_SHORT_LEG_PERIODS, _VIA_POINTS_PER_PERIOD, _MOST_FOR_PERIODS = 6.0, 4, 100

if TYPE_CHECKING:
    # It loads SciPy's splines, which only times that are sought need.
    from cmbot.planning.timing.leg_paths import LegPath


@dataclass(frozen=True, kw_only=True, eq=False)
class Timing:
    """Laws along a joint path, and by how much they are stretched.

    Attributes
    ----------
    request : StrokeRequest
        In which `trajectory` was planned.
    trajectory : QuinticTrajectory
    paths : sequence of LegPath
        Of the L legs whose time is sought.
    laws : tuple of LegLaw
        The shortest along them.
    factors : (L,)
        By which each law is stretched.
    at_fault : (L,)
        Legs on which motions in less time failed.
    reason : str
        Why the first of these failed.
    rough : float
        What laws of fewer phases take along the paths, s: by that paths compare.
    both : two floats, optional
        Of times that are sought: the shortest within the limits, and the shortest that is quiet, s.
    """

    request: StrokeRequest
    trajectory: QuinticTrajectory
    paths: Sequence[LegPath]
    laws: tuple[LegLaw, ...]
    factors: FloatArray
    at_fault: BoolArray
    reason: str = ""
    rough: float = np.inf
    both: tuple[float, float] | None = None

    @staticmethod
    def along(
        request: StrokeRequest,
        trajectory: QuinticTrajectory,
        paths: Sequence[LegPath],
        laws: tuple[LegLaw, ...],
    ) -> Timing:
        """Return laws as they are, along a trajectory's joint path; `paths` stand for it on their legs."""
        return Timing(
            request=request,
            trajectory=trajectory,
            paths=paths,
            laws=laws,
            factors=np.ones(len(laws)),
            at_fault=np.zeros(len(laws), dtype=np.bool_),
        )

    @property
    def seconds(self) -> float:
        """Of the laws together, as they are before they are stretched."""
        return sum(law.duration for law in self.laws)

    @property
    def timed(self) -> StrokeRequest:
        """The request in which the legs have the stretched laws."""
        pairs = zip(self.laws, self.factors, strict=True)
        return in_time(self.request, [law.slowed(float(factor)) for law, factor in pairs])

    def stretched(self, factors: FloatArray, at_fault: BoolArray, reason: str) -> Timing:
        """Return the same laws stretched by other factors."""
        return replace(self, factors=factors, at_fault=at_fault, reason=self.reason or reason)

    def via_points(self, timed: StrokeRequest) -> FloatArray:
        """Postures (k, n) of the joint path at the via-points of a request in another time."""
        leg, share = timed.task.path.leg_shares(timed.times)
        q = self.trajectory.evaluate(self.request.task.path.times_at(leg, share))
        for path in self.paths:
            q[leg == path.leg] = path.q(share[leg == path.leg])
        # The arm starts where it did.
        q[0] = self.trajectory.q[0]
        return q


def with_enough_via_points(request: StrokeRequest) -> StrokeRequest:
    """Return the request of a quiet stroke with more via-points, if splines follow its laws by that.

    Between fewer than four a period of the slowest mode the motion is what the optimum makes of it, not what
    the law asks for: that swings up to five times as much. Where that are too many, half of them still pay.
    """
    path, file, is_fixed = request.task.path, request.stroke.file, request.cell.options.knots == "fixed"
    is_chosen = file.speed_profile.kind == "quiet" and not (file.time_laws or path.open_legs or is_fixed)
    if not is_chosen or (frequency := request.cell.lowest_frequency(request.first)) is None:
        return request
    number = _enough(request, frequency)
    shortest = min((leg.seconds for leg in path.segments if leg.curve.length > 0), default=np.inf)
    if number > 2 * _MOST_FOR_PERIODS and shortest * frequency > _SHORT_LEG_PERIODS:
        return request
    return replace(request, times=path.via_times(max(min(number, _MOST_FOR_PERIODS), len(request.times))))


def is_coarse(request: StrokeRequest) -> bool:
    """Return whether a stroke that bends something has too few via-points for splines to follow its laws."""
    frequency = request.cell.lowest_frequency(request.first)
    return frequency is not None and len(request.times) < _enough(request, frequency)


def _enough(request: StrokeRequest, frequency: float) -> int:
    return 1 + int(np.ceil(_VIA_POINTS_PER_PERIOD * frequency * request.task.path.duration))


def in_time(request: StrokeRequest, laws: Sequence[LegLaw]) -> StrokeRequest:
    """Return the request of a stroke whose open legs have these laws."""
    path = request.task.path.timed(laws)
    file = request.stroke.file.changed(time_laws=tuple(laws))
    stroke = replace(request.stroke, path=path, file=file)
    strokes = (*request.strokes[: request.number], stroke, *request.strokes[request.number + 1 :])
    times = path.via_times(len(request.times))
    return replace(request, task=replace(request.task, path=path), strokes=strokes, times=times)
