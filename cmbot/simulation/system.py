"""What moves when some joints are driven and the others are springs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.elastic.arm import ElasticArm

__all__ = ["ElasticSystem"]


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticSystem:
    """A mechanism of d driven and f elastic coordinates.

    Its equation of motion, with q_a prescribed, is that of the elastic coordinates alone::

        (M_ff + added_mass) qdd_f = - stiffness q_f - damping qd_f - h_f(q, qd) - M_fa qdd_a

    Attributes
    ----------
    model : pinocchio.Model
        Of which every coordinate is a driven or an elastic one; configurations are vectors.
    driven : (d,)
        Indices of the driven coordinates.
    elastic : (f,)
        Indices of the elastic coordinates.
    stiffness, damping, added_mass : (f, f)
        Symmetric. `added_mass` is what the model does not know of, such as the guardrail's own.
    """

    model: Any
    driven: IntArray
    elastic: IntArray
    stiffness: FloatArray
    damping: FloatArray
    added_mass: FloatArray

    @classmethod
    def of(cls, arm: ElasticArm, damping: FloatArray) -> ElasticSystem:
        """Return the system of an arm with a damping matrix (f, f)."""
        return cls(
            model=arm.model,
            driven=arm.driven,
            elastic=arm.elastic,
            stiffness=arm.stiffness,
            damping=damping,
            added_mass=arm.added_mass,
        )
