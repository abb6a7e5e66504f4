"""What the foot holds: the guardrail's stiffness and mass at the origin of W."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.elastic.guardrail import Guardrail
from cmbot.elastic.guardrail_frame import guardrail_frame

__all__ = ["ElasticBase", "elastic_base"]

_MODES = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticBase:
    """What the foot holds, at the origin of W, in W, linear then angular; the arrays are read-only.

    Attributes
    ----------
    stiffness : (6, 6), N/m, N/rad, Nm/rad
        Exactly symmetric.
    mass : (6, 6), kg, kg m, kg m2
        What of the guardrail moves with the foot; zero where a stiffness was given without it.
    frequencies : (k,), Hz
        Lowest ones of the whole frame with nothing on it, ascending; none where a stiffness was given or the
        material has no mass.
    """

    stiffness: FloatArray
    mass: FloatArray
    frequencies: FloatArray


def elastic_base(guardrail: Guardrail) -> ElasticBase | None:
    """Return what the foot holds: a given stiffness as it is, else that of the guardrail's frame.

    Parameters
    ----------
    guardrail : Guardrail

    Returns
    -------
    ElasticBase or None
        None: the hold is rigid, as there are neither posts nor a given stiffness.

    Raises
    ------
    InputError
        When no frame can be drawn, or its members are too unlike to compute with.
    """
    if guardrail.stiffness is not None:
        mass = np.zeros((6, 6)) if guardrail.mass is None else guardrail.mass
        return _base(guardrail.stiffness, mass, np.zeros(0))
    if not guardrail.post_positions:
        return None
    drawn = guardrail_frame(guardrail)
    condensed = drawn.frame.condense(drawn.foot)
    return _base(condensed.stiffness, condensed.mass, drawn.frame.frequencies(_MODES))


def _base(stiffness: FloatArray, mass: FloatArray, frequencies: FloatArray) -> ElasticBase:
    # Files may be asymmetric in the last digit. What is symmetric stays as it is.
    arrays = [(stiffness + stiffness.T) / 2, (mass + mass.T) / 2, frequencies.copy()]
    for array in arrays:
        array.setflags(write=False)
    return ElasticBase(stiffness=arrays[0], mass=arrays[1], frequencies=arrays[2])
