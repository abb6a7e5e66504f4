"""The arm at rest and close to it: mass, stiffness and what the joints do to both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag

__all__ = ["Linearised", "linearised"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearised:
    """Small motions of an arm about its static equilibria in N postures.

    Attributes
    ----------
    u : (N, f), m and rad
        The equilibria.
    mass, stiffness : (N, f, f)
        Of the elastic coordinates, the guardrail's mass and the stiffness of turning weights included;
        symmetric.
    coupling : (N, f, n)
        Of the joint-space mass matrix: forces on the elastic coordinates by the joints' accelerations.
    weight : (N, f, n)
        Derivative of the weights' forces on the elastic coordinates with respect to the joint angles.
    """

    u: FloatArray
    mass: FloatArray
    stiffness: FloatArray
    coupling: FloatArray
    weight: FloatArray


def linearised(arm: ElasticArm, q: FloatArray) -> Linearised:
    """Linearise an arm about its equilibria in postures `q` (N, n), rad.

    Raises
    ------
    InputError
        When the arm is too soft to carry itself in one of them.
    """
    u, tangent, weight = Sag(arm).equilibria(q)
    data = arm.model.createData()
    M, coupling = np.empty_like(tangent), np.empty_like(weight)
    to_elastic, to_driven = np.ix_(arm.elastic, arm.elastic), np.ix_(arm.elastic, arm.driven)
    for k, configuration in enumerate(arm.configuration(q, u)):
        upper = np.triu(pin.crba(arm.model, data, configuration))
        whole = upper + np.triu(upper, 1).T
        M[k], coupling[k] = whole[to_elastic] + arm.added_mass, whole[to_driven]
    K = (tangent + tangent.transpose(0, 2, 1)) / 2
    return Linearised(u=u, mass=M, stiffness=K, coupling=coupling, weight=weight)
