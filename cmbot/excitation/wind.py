"""Air on the links: drag of wind and of what passes, as loads on the elastic coordinates.

Of every collision shape of the moving arm the face of its bounding box that is turned to the wind is taken
as its
area: exact for boxes, too large by up to 4/pi for round ones. ``F = q c A`` acts at the middle of the shape.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.excitation.response import Loads
from cmbot.robot import box_about

AIR_KG_M3 = 1.25
"""Density of the air: EN 1991-1-4, 4.5."""
DRAG = 1.2
"""Of a tube: EN 1991-1-4, 7.9."""

# Length of the gusts, m: EN 1991-1-4, Annex B, about 15 m above open ground.
_GUST_LENGTH_M = 100.0


def gust_spectrum(f: FloatArray, mean: float, deviation: float) -> FloatArray:
    """Return the one-sided spectral density of the wind's speed (F,), (m/s)^2/Hz, at `f` (F,), Hz.

    EN 1991-1-4, Equation (B.2): ``f S / sigma^2 = 6.8 n / (1 + 10.2 n)^(5/3)``, ``n = f L / mean``.
    """
    n = np.maximum(f, 1e-9) * _GUST_LENGTH_M / mean
    return np.asarray(deviation**2 / np.maximum(f, 1e-9) * 6.8 * n / (1 + 10.2 * n) ** (5 / 3))


def link_loads(direction: FloatArray, factor: float = 1.0) -> Loads:
    """Return what a pressure of 1 Pa from one side does to an arm: see `modal_response`.

    Parameters
    ----------
    direction : (3,)
        Unit vector in W, along which it pushes.
    factor : float
        On the area.
    """

    def loads(arm: ElasticArm, configuration: FloatArray) -> FloatArray:
        model, data = arm.model, arm.model.createData()
        pin.computeJointJacobians(model, data, configuration)
        out, foot = np.zeros(model.nv + 6), np.array(arm.robot.foot_point)
        # Of each link the joint before it, and the last one within it: half of the load moves with either.
        first = (arm.driven + 1).tolist()
        last = [*(joint - 1 for joint in first[1:]), model.njoints - 1]
        for shape in arm.robot.collision_model.geometryObjects:
            link = shape.parentJoint - 1
            if link < 0:
                continue
            place = data.oMi[first[link]] * shape.placement
            low, high = box_about(shape.geometry)
            size, middle = high - low, place.act((high + low) / 2)
            area = float(np.abs(place.rotation.T @ direction) @ (size[[1, 2, 0]] * size[[2, 0, 1]]))
            force = factor * area * direction
            for joint in (first[link], last[link]):
                J = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED)
                turning = np.cross(middle - data.oMi[joint].translation, force)
                out[: model.nv] += (J[:3].T @ force + J[3:].T @ turning) / 2
            out[model.nv :] += [*force, *np.cross(middle - foot, force)]
        return out

    return loads
