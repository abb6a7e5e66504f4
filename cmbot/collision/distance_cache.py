"""What is known of the distances in one posture from those in another one: next to nothing has moved far."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray

__all__ = ["DistanceMemory"]

# When some point of the arm may have moved further than this, m, all pairs are looked at again.
_LOOK_AGAIN = 0.1
# So many postures are compared with one that was looked at in one call, at most. Where one look serves fewer
# than _WORTH, it is not worth its while.
_STRETCH, _WORTH = 64, 12


class DistanceMemory:
    """All distances at a posture that was looked at, for bounds in postures near it.

    Parameters
    ----------
    model : pinocchio.Model
    geometry : pinocchio.GeometryModel
        With P collision pairs.
    data : pinocchio.GeometryData
        Its distance requests say how distances are worked out.
    reach : (P, n), m
        Of each joint in each pair.
    """

    def __init__(self, model: Any, geometry: Any, data: Any, reach: FloatArray) -> None:
        self._all = (model, model.createData(), geometry, data)
        self._reach, self._furthest = reach, reach.max(axis=0, initial=0.0)
        # The list of references is read much faster than the results' own container.
        self._results = list(data.distanceResults)
        # Nowhere yet.
        self._seen_at, self._seen = np.full(model.nv, np.nan), np.empty(len(reach))

    def lower_bounds(self, q: FloatArray) -> FloatArray:
        """Return what no distance is below, (P,), m, in posture `q` (n,), rad.

        No point of the arm moves further than the joints' moves times their reach.
        """
        move = np.abs(q - self._seen_at)
        if not move @ self._furthest <= _LOOK_AGAIN:
            pin.computeDistances(*self._all, q)
            self._seen_at = q.copy()
            self._seen = np.array([result.min_distance for result in self._results])
            return self._seen.copy()
        return np.asarray(self._seen - self._reach @ move)

    def serves(self, q: FloatArray) -> bool:
        """Whether postures `q` (N, n) follow each other closely enough for a few looks to serve them all."""
        moved = float((np.abs(np.diff(q, axis=0)) @ self._furthest).sum())
        return moved * _WORTH <= _LOOK_AGAIN * len(q)

    def stretches(self, q: FloatArray) -> Iterator[tuple[slice, FloatArray, FloatArray]]:
        """Go through postures `q` (N, n) in stretches, with lower and upper bounds (N', P) of distances."""
        first = 0
        while first < len(q):
            self.lower_bounds(q[first])
            move = np.abs(q[first : first + _STRETCH] - self._seen_at)
            far = np.flatnonzero(move @ self._furthest > _LOOK_AGAIN)
            last = first + (int(far[0]) if len(far) else len(move))
            moved = move[: last - first] @ self._reach.T
            yield slice(first, last), self._seen - moved, self._seen + moved
            first = last
