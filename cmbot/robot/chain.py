"""A serial chain of revolute joints, walked along for many postures at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.arrays import FloatArray

__all__ = ["Chain"]


class Chain:
    """Vectors that are fixed to the joints of an arm, turned to W in N postures.

    Parameters
    ----------
    model : pinocchio.Model
        A serial chain of revolute joints, as `load_robot` makes sure.
    vectors : n arrays (k, 3)
        In the frame of each joint; every joint may have another number k of them.
    """

    def __init__(self, model: Any, vectors: Sequence[FloatArray]) -> None:
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        self._steps = []
        for i, fixed in enumerate(vectors, start=1):
            axis = pin.getJointJacobian(model, data, i, pin.ReferenceFrame.LOCAL)[3:, i - 1]
            self._steps.append(_step(model.jointPlacements[i], axis, fixed))

    def walk(self, q: FloatArray) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
        """Go from joint to joint.

        Parameters
        ----------
        q : (n, N), rad
            Components lead and postures trail, here and below, so that every operation runs along postures.

        Yields
        ------
        origin : (3, N), m
            Of the joint.
        axis : (3, N)
            Of the joint.
        turned : (3 + k, 3, N)
            The three axes of the joint's frame, then its vectors.
        """
        N = q.shape[1]
        sine, cosine = np.sin(q), np.cos(q)
        # Columns of the rotation to the frame before the joint, one after the other, (3, 3 N).
        columns = np.repeat(np.eye(3)[:, :, None], N, axis=2).reshape(3, -1)
        origin = np.zeros((3, N))
        for i, step in enumerate(self._steps):
            moved = (step @ columns).reshape(-1, 3, N)
            origin = origin + moved[0]
            constant, with_sine, with_cosine = moved[2:].reshape(3, -1, 3, N)
            turned = constant + sine[i] * with_sine + cosine[i] * with_cosine
            yield origin, moved[1], turned
            columns = turned[:3].reshape(3, -1)


def _step(placement: Any, axis: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (2 + 3 (3 + k), 3) of one joint in the frame of the one before.

    Its origin, its axis, and then what is constant, what goes with the sine and what with the cosine in
    Rodrigues' formula I + sin K + (1 - cos) K^2: the joint's three axes and the k `vectors`.
    """
    R, K = placement.rotation, pin.skew(axis)
    body = np.vstack([np.eye(3), vectors]).T
    parts = [R @ M @ body for M in (np.eye(3) + K @ K, K, -K @ K)]
    return np.column_stack([placement.translation, R @ axis, *parts]).T
