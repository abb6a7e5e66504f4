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

_OfWrenches = Callable[[FloatArray, IntArray], FloatArray]


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
        some = {number: holding.needed(number, self._some) for number in holding.adhesive}
        size = max((float(np.abs(needed).max()) for needed in some.values()), default=0.0)
        return {number: self._needed(number, float(some[number].max()), size, beyond) for number in some}

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
                peak = self._enclosed(use, float(np.abs(use(self._some)).max()), remainder)
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

    @property
    def _some(self) -> FloatArray:
        """One wrench (6,) of each piece, (K, 6)."""
        return self.wrench[:: len(self.wrench) // len(self.pieces.start)]

    def _needed(self, number: int, found: float, size: float, beyond: FloatArray) -> Peak:
        """The adhesion that a foot needs: it is `found`, N, at one of the times."""
        off = [np.where(self._bounded, part, 0.0) for part in self._remainders]
        near = self.resolution * size

        # Of what is lower than what was found nothing more need be known, which is quicker.
        def values(wrench: FloatArray, piece: IntArray) -> FloatArray:
            nonlocal found
            needed = self.holding.needed(number, wrench.reshape(-1, 6), found - near)
            found = max(found, float(needed.max()))
            return needed.reshape(wrench.shape[:2])

        def bounds(wrench: FloatArray, piece: IntArray) -> FloatArray:
            force, torque = (part[piece] for part in off)
            between = self.holding.needed_between(number, wrench, force, torque, found - near)
            return np.repeat(between[:, None], wrench.shape[1], axis=1)

        return self._highest(bounds, size, beyond, values)

    def _enclosed(
        self, function: Callable[[FloatArray], FloatArray], size: float, remainder: FloatArray
    ) -> Peak:
        """Enclose a convex function of wrenches (N, 6)."""

        def values(wrench: FloatArray, piece: IntArray) -> FloatArray:
            return function(wrench.reshape(-1, 6)).reshape(wrench.shape[:2])

        return self._highest(values, size, remainder)

    def _highest(
        self, bounds: _OfWrenches, size: float, remainder: FloatArray, values: _OfWrenches | None = None
    ) -> Peak:
        """Enclose by functions of wrenches (L, m, 6) of pieces (L,), to (L, m)."""

        def of(function: _OfWrenches) -> _OfWrenches:
            return lambda points, piece: function(np.swapaxes(points, 1, 2), piece)

        control = self.pieces.control_points(self.wrench)
        exact = None if values is None else of(values)
        return highest(self.pieces, control, of(bounds), remainder, self.resolution * size, exact)
