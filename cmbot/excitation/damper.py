"""The best tuned damper for a work: frequency and damping of a mass on springs.

The springs are alike in all directions. It minimises the largest RMS of the tool over the work's postures
and the stiffness interval. The search begins at Den Hartog's tuning (*Mechanical vibrations*, 1956) for the
mode that moves most, whose effective mass at the damper's place is ``1 / |P phi|^2``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from cmbot.common.arrays import FloatArray
from cmbot.common.representation import ShortRepr
from cmbot.excitation.response import AXES, ModalResponse, Spectrum, TunedDamper

STIFFNESS_FACTORS = (0.7, 1.0, 1.3)
"""On all stiffness, between which a damper of `cmbot.excite` is the best one."""

# Evaluations at most; the optimum is flat, so that more gain nothing that could be built.
_MOST_EVALUATIONS, _FLAT_OPTIMUM = 60, 1e-3


@dataclass(frozen=True, kw_only=True)
class DamperGain(ShortRepr):
    """A damper, and the RMS of the tool with it and without.

    Attributes
    ----------
    damper : TunedDamper
    at : str
        Where it is.
    rms_with, rms_without : float, m
        The largest over postures and stiffnesses.
    each_with, each_without : (R,), m
        Of each posture, for one stiffness after the other.
    """

    damper: TunedDamper
    at: str
    rms_with: float
    rms_without: float
    each_with: tuple[float, ...]
    each_without: tuple[float, ...]


def den_hartog(response: ModalResponse, mass: float) -> TunedDamper:
    """Return Den Hartog's damper of a mass, kg, for the mode that moves the tool most."""
    per_mode = (response.tool**2).sum(axis=0) * (response.gain[:, :3] ** 2).sum(axis=1)
    k = int(np.argmax(per_mode / response.frequencies**3 / response.damping))
    ratio = mass * float((response.place[:, k] ** 2).sum())
    return TunedDamper(
        mass=mass,
        frequency=float(response.frequencies[k]) / (1 + ratio),
        damping=float(np.sqrt(3 * ratio / (8 * (1 + ratio)))),
    )


def best_damper(
    responses: Sequence[ModalResponse],
    spectrum: Spectrum,
    band: tuple[float, float],
    mass: float,
    at: str,
    *,
    frequency: float | None = None,
    damping: float | None = None,
) -> DamperGain:
    """Return the best damper of a mass for some responses, postures and stiffnesses.

    Parameters
    ----------
    responses : sequence of ModalResponse
        With `at` as their damper's place.
    spectrum, band
        Of the inputs.
    mass : float, kg
    at : str
        Where it is.
    frequency : float, Hz, optional
    damping : float, optional
        Where they are given they are taken as they are.
    """
    prepared = []
    for response in responses:
        f, weight = response.quadrature(band)
        prepared.append((response.undamped(f, AXES), spectrum(f) * weight[:, None]))

    def each(damper: TunedDamper | None) -> tuple[float, ...]:
        squares = [((np.abs(part.damped(damper)) ** 2).sum(axis=1) * S).sum() for part, S in prepared]
        return tuple(np.sqrt(squares).tolist())

    def worst(damper: TunedDamper) -> float:
        return max(each(damper))

    without = each(None)
    start = den_hartog(responses[int(np.argmax(without))], mass)
    start = replace(start, frequency=frequency or start.frequency, damping=damping or start.damping)
    free = [name for name, given in (("frequency", frequency), ("damping", damping)) if given is None]

    def tuned(x: FloatArray) -> TunedDamper:
        factors = dict(zip(free, np.exp(x), strict=True))
        return replace(
            start, **{name: float(getattr(start, name) * factor) for name, factor in factors.items()}
        )

    damper = start
    if free:
        simplex = np.vstack([np.zeros(len(free)), np.eye(len(free)) * [0.15, 0.4][: len(free)]])
        options = {
            "maxfev": _MOST_EVALUATIONS,
            "xatol": _FLAT_OPTIMUM,
            "fatol": 0.0,
            "initial_simplex": simplex,
        }
        options["fatol"] = _FLAT_OPTIMUM * worst(start)
        found = minimize(
            lambda x: worst(tuned(x)), np.zeros(len(free)), method="Nelder-Mead", options=options
        )
        damper = tuned(found.x)
    left = each(damper)
    return DamperGain(
        damper=damper,
        at=at,
        rms_with=max(left),
        rms_without=max(without),
        each_with=left,
        each_without=without,
    )
