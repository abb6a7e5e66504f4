"""What the feet bear at all times: enclosures of functions of the wrench."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.limit import Limit
from cmbot.hold import ADHESION, CLAMP_LOAD, AdhesionPeak, Holding
from cmbot.planning.certification.check import Check
from cmbot.planning.certification.norm_bounds import NormBounds
from cmbot.trajectory import Peak, Pieces, highest


@dataclass(frozen=True, eq=False)
class EnclosedHold:
    """What the feet bear along a trajectory.

    Attributes
    ----------
    holding : Holding
    pieces : Pieces
        K of the trajectory.
    bounds : NormBounds
    wrench : (K (d + 1), 6), N and Nm
        Of the moving arm on the guardrail, about O0 in W, at the Chebyshev points.
    resolution : float
        How far bounds may lie above what was found, as a share of the largest value of all feet.
    """

    holding: Holding
    pieces: Pieces
    bounds: NormBounds
    wrench: FloatArray
    resolution: float

    @cached_property
    def _adhesion(self) -> dict[int, Peak]:
        """Of each foot that holds by adhesion, by its number, the adhesion that it needs, N."""
        holding, beyond = self.holding, np.where(self._bounded, 0.0, np.inf)
        needed = {number: partial(holding.needed, number) for number in holding.adhesive}
        size = max(map(self._size, needed.values()), default=0.0)
        return {
            number: self._enclosed(each, size, beyond, partial(holding.needed_between, number))
            for number, each in needed.items()
        }

    @property
    def needed(self) -> AdhesionPeak | None:
        """The largest adhesion that a foot needs; None where none holds by it."""
        if not self._adhesion:
            return None
        # Of values that are no numbers the first counts as the largest.
        which = int(np.argmax([peak.value for peak in self._adhesion.values()]))
        number, peak = list(self._adhesion.items())[which]
        return self.holding.peak(number, peak.value, peak.time, self._at(peak.time), self.wrench)

    @property
    def needed_bound(self) -> float:
        """No foot needs more adhesion at any time, N; infinite where none holds by it."""
        bounds = [peak.bound for peak in self._adhesion.values()]
        return float(np.max(bounds, initial=0.0)) if bounds else np.inf

    def checks(self) -> Iterator[Check]:
        """Yield what each foot bears against what is known of it."""
        for number, foot in enumerate(self.holding.feet):
            if foot.adhesion is not None:
                peak = self._adhesion[number]
                yield Check(
                    quantity=self.holding.named(ADHESION, number),
                    time=peak.time,
                    value=max(peak.bound, 0.0),
                    bound=foot.adhesion / foot.safety,
                    unit="N",
                    limit=Limit.HOLD,
                )
            if foot.force is not None:
                remainder = self.holding.use_remainder(number, *self._remainders)
                use = partial(self.holding.use, number)
                peak = self._enclosed(use, self._size(use), remainder)
                yield Check(
                    quantity=self.holding.named(CLAMP_LOAD, number),
                    time=peak.time,
                    value=peak.bound,
                    bound=1.0,
                    unit="of its bounds",
                    limit=Limit.HOLD,
                )

    @cached_property
    def _remainders(self) -> tuple[FloatArray, FloatArray]:
        """What interpolation may miss of force and torque, (K,) each, N and Nm."""
        pieces, of = self.pieces, self.bounds
        return pieces.remainder(of.guardrail_force), pieces.remainder(of.guardrail_torque)

    @property
    def _bounded(self) -> BoolArray:
        """Of which pieces that is bounded, (K,)."""
        return np.isfinite(sum(self._remainders))

    def _at(self, time: float) -> FloatArray:
        """The wrench (6,) at a Chebyshev point near a time: where the peak is, up to the resolution."""
        return np.asarray(self.wrench[int(np.abs(self.pieces.times.ravel() - time).argmin())])

    def _size(self, function: Callable[[FloatArray], FloatArray]) -> float:
        """How large a function of wrenches (N, 6) is, from one for each piece."""
        return float(np.abs(function(self.wrench[:: len(self.wrench) // len(self.pieces.start)])).max())

    def _enclosed(
        self,
        function: Callable[[FloatArray], FloatArray],
        size: float,
        remainder: FloatArray,
        between: Callable[[FloatArray, FloatArray, FloatArray], FloatArray] | None = None,
    ) -> Peak:
        """Enclose a function of wrenches (N, 6): a convex one, or one with bounds `between` (N, K, 6)."""
        off = [np.where(self._bounded, part, 0.0) for part in self._remainders]

        def values(points: FloatArray, piece: IntArray) -> FloatArray:
            wrench = np.swapaxes(points, 1, 2)
            return function(wrench.reshape(-1, 6)).reshape(wrench.shape[:2])

        def bounds(points: FloatArray, piece: IntArray) -> FloatArray:
            if between is None:
                return values(points, piece)
            found = between(np.swapaxes(points, 1, 2), *(part[piece] for part in off))
            return np.repeat(found[:, None], points.shape[2], axis=1)

        control = self.pieces.control_points(self.wrench)
        return highest(self.pieces, control, bounds, remainder, self.resolution * size, values)
