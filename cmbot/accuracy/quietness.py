"""How quiet a work is: how far the tool sways at work, and swings after the stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cmbot.accuracy.sway import Sway
from cmbot.common.reading.file_types import NonNegative


@dataclass(frozen=True, kw_only=True)
class Quietness:
    """Sway at work and swing after the stop: the largest over the interval of the stiffness, and of strokes.

    Attributes
    ----------
    stiffness_share : float
        By which all stiffness may differ from the modelled one.
    sway_mm : float
        Largest distance of the tool from its place at rest, at work.
    swing_mm : float
        Largest distance between two positions of the tool in the 2 s after a stroke.
    unshaped_sway_mm, unshaped_swing_mm : float or None
        Of the same joint path in the same time by the law of the speed profile alone, without an input shaper
        and a ramp of its own; None where no law was chosen.
    """

    stiffness_share: NonNegative
    sway_mm: NonNegative
    swing_mm: NonNegative
    unshaped_sway_mm: NonNegative | None
    unshaped_swing_mm: NonNegative | None


def quietness_of(share: float, planned: Sequence[Sway], unshaped: Sequence[Sway | None]) -> Quietness:
    """Return how quiet strokes are.

    Parameters
    ----------
    share : float
        By which all stiffness may differ.
    planned, unshaped : sequences of Sway
        Of each stroke, `stroke_sway`, as planned, and without a law that was chosen; None where none was.
    """
    own = np.array([stroke.largest for stroke in planned])
    chosen = any(stroke is not None for stroke in unshaped)
    plain = np.array(
        [known if stroke is None else stroke.largest for known, stroke in zip(own, unshaped, strict=True)]
        if chosen
        else own
    )
    (sway, swing), (plain_sway, plain_swing) = own.max(axis=0).tolist(), plain.max(axis=0).tolist()
    return Quietness(
        stiffness_share=share,
        sway_mm=1e3 * sway,
        swing_mm=1e3 * swing,
        unshaped_sway_mm=1e3 * plain_sway if chosen else None,
        unshaped_swing_mm=1e3 * plain_swing if chosen else None,
    )
