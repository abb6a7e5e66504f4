"""A serial chain of revolute joints, walked along for many postures at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray

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
        # In a frame whose z axis is the joint's, turning mixes the two others and nothing else.
        self._steps, before = [], np.eye(3)
        for i, fixed in enumerate(vectors, start=1):
            own = _frame_about(pin.getJointJacobian(model, data, i, pin.ReferenceFrame.LOCAL)[3:, i - 1])
            X = model.jointPlacements[i]
            step = np.column_stack([X.translation, X.rotation @ own])
            self._steps.append((step.T @ before, fixed @ own))
            before = own

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
        turned : (k, 3, N)
            Its vectors.
        """
        N = q.shape[1]
        cosines, sines = np.cos(q), np.sin(q)
        # The first axis goes towards the second as that goes away from the first.
        sines = np.stack([sines, -sines], axis=1)
        # The axes of the frame that is turned, one after the other.
        axes = np.repeat(np.eye(3)[:, :, None], N, axis=2)
        origin = np.zeros((3, N))
        for (step, fixed), sine, cosine in zip(self._steps, sines, cosines, strict=True):
            moved = (step @ axes.reshape(3, -1)).reshape(4, 3, N)
            origin = origin + moved[0]
            axes = moved[1:]
            crossed = sine[:, None] * axes[1::-1]
            axes[:2] *= cosine
            axes[:2] += crossed
            turned = (fixed @ axes.reshape(3, -1)).reshape(-1, 3, N) if len(fixed) else axes[:0]
            yield origin, axes[2], turned


def _frame_about(axis: FloatArray) -> FloatArray:
    """Rotation (3, 3) whose third column is the unit vector `axis` (3,)."""
    k = np.abs(axis).argmin()
    x = np.eye(3)[k] - axis[k] * axis
    x /= np.sqrt(x @ x)
    return np.column_stack([x, pin.skew(axis) @ x, axis])
