"""How an arm at rest vibrates: natural frequencies, mode shapes and modal damping."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.linearised import linearised

__all__ = ["ArmModes", "arm_modes"]

# Below this share of the largest, the square of a period is rounding: that coordinate has no mass.
_MASSLESS = 1e-13


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmModes:
    """Small vibrations of an arm about its static equilibrium, the joints held still.

    Attributes
    ----------
    frequencies : (k,), Hz
        Ascending; fewer than f where some elastic coordinates move no mass.
    shapes : (f, k)
        Column i is mode i in the elastic coordinates, m and rad, of modal mass 1 kg m2.
    u : (f,), m and rad
        The equilibrium.
    mass, stiffness : (f, f)
        Of the vibration, the guardrail's mass and the stiffness of turning weights included.
    """

    frequencies: FloatArray
    shapes: FloatArray
    u: FloatArray
    mass: FloatArray
    stiffness: FloatArray

    def damping(self, ratio: float) -> FloatArray:
        """Return the damping matrix (f, f) that gives every mode the same damping ratio.

        ``D = M Phi diag(2 ratio omega) Phi' M`` with the shapes Phi and the angular frequencies omega.

        Raises
        ------
        InputError
            When the ratio is negative or not finite.
        """
        if not (math.isfinite(ratio) and ratio >= 0):
            raise InputError("ArmModes.damping", "ratio", ratio, "a number that is not negative")
        momenta = self.mass @ self.shapes
        return np.asarray((momenta * (4 * np.pi * ratio * self.frequencies)) @ momenta.T)


def arm_modes(arm: ElasticArm, q: FloatArray) -> ArmModes:
    """Find the modes of an arm in posture `q` (n,), rad.

    Raises
    ------
    InputError
        When the arm is too soft to carry itself there.
    """
    at = linearised(arm, q[None])
    M, K = at.mass[0], at.stiffness[0]
    # With the roles exchanged a mass that is only semi-definite is no trouble: the eigenvalues are 1/omega^2.
    squares, X = linalg.eigh(M, K)
    squares, X = squares[::-1], X[:, ::-1]
    moving = squares > _MASSLESS * squares.max(initial=0.0)
    squares, X = squares[moving], X[:, moving]
    return ArmModes(
        frequencies=1 / (2 * np.pi * np.sqrt(squares)),
        shapes=X / np.sqrt(squares),
        u=at.u[0],
        mass=M,
        stiffness=K,
    )
