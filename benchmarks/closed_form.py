"""The derivatives of inverse dynamics in closed form, all in W about O0: over NumPy arrays, and compiled.

With a joint's axis s, its rate of change and the composite inertia Ic, its companion 2 Bc and the force fc of
all that it carries (Singh, Russell and Wensing, 2022):

    dW/da = Ic s,  dW/dv = 2 Bc s + 2 Ic s',  dW/dq = 2 Bc s' + Ic s'' + s x* fc

and a joint torque is the part along its own axis. Not used by cmbot: `kernels.py` says why.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from cmbot.robot import Robot

__all__ = ["Arm", "arm_of", "batched", "compiled"]

FloatArray = NDArray[np.float64]
Answer = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class Arm(NamedTuple):
    """A serial chain of n revolute joints as arrays, each in the joint's own frame.

    Placements of the joints in the frame before, (n, 3, 3) and (n, 3); axes (n, 3); masses (n,), levers
    (n, 3), rotational inertias (n, 3, 3) about the centres of mass; gravity (3,).
    """

    rotation: FloatArray
    translation: FloatArray
    axis: FloatArray
    mass: FloatArray
    lever: FloatArray
    inertia: FloatArray
    gravity: FloatArray


def arm_of(robot: Robot) -> Arm:
    """Return a robot's arm as arrays."""
    model = robot.model
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    joints = range(1, robot.dof + 1)
    bodies = [model.inertias[i] for i in joints]
    return Arm(
        rotation=np.array([model.jointPlacements[i].rotation for i in joints]),
        translation=np.array([model.jointPlacements[i].translation for i in joints]),
        axis=np.array([pin.getJointJacobian(model, data, i, pin.LOCAL)[3:, i - 1] for i in joints]),
        mass=np.array([body.mass for body in bodies]),
        lever=np.array([body.lever for body in bodies]),
        inertia=np.array([body.inertia for body in bodies]),
        gravity=np.array(model.gravity.linear),
    )


def batched(arm: Arm, q: FloatArray, v: FloatArray, a: FloatArray) -> Answer:
    """Wrench of the base on the arm and joint torques (N, 6 + n), and their derivatives (N, 6 + n, n)."""
    N, n = q.shape
    R, p = np.broadcast_to(np.eye(3), (N, 3, 3)), np.zeros((N, 3))
    V, A = np.zeros((N, 6)), np.zeros((N, 6))
    A[:, :3] = -arm.gravity
    s, s1, s2, f = (np.empty((n, N, 6)) for _ in range(4))
    inertia, B = np.empty((n, N, 6, 6)), np.empty((n, N, 6, 6))
    for i in range(n):
        p = p + R @ arm.translation[i]
        K = _skew(arm.axis[i])
        turn = np.eye(3) + np.sin(q[:, i, None, None]) * K + (1 - np.cos(q[:, i, None, None])) * (K @ K)
        R = R @ arm.rotation[i] @ turn
        axis = R @ arm.axis[i]
        s[i] = np.hstack([np.cross(p, axis), axis])
        s1[i] = _motion_cross(V, s[i])
        s2[i] = _motion_cross(A, s[i]) + _motion_cross(V, s1[i])
        V = V + s[i] * v[:, i, None]
        A = A + s[i] * a[:, i, None] + s1[i] * v[:, i, None]
        inertia[i] = _inertia(arm.mass[i], p + R @ arm.lever[i], R @ arm.inertia[i] @ R.transpose(0, 2, 1))
        momentum = _times(inertia[i], V)
        f[i] = _times(inertia[i], A) + _force_cross(V, momentum)
        X = _motion_matrix(V)
        B[i] = -X.transpose(0, 2, 1) @ inertia[i] - inertia[i] @ X + _bar(momentum)
    for i in range(n - 1, 0, -1):
        inertia[i - 1] += inertia[i]
        B[i - 1] += B[i]
        f[i - 1] += f[i]
    value, d_q, d_v, d_a = np.empty((N, 6 + n)), *(np.zeros((N, 6 + n, n)) for _ in range(3))
    value[:, :6] = f[0]
    for j in range(n):
        d_a[:, :6, j] = _times(inertia[j], s[j])
        d_v[:, :6, j] = _times(B[j], s[j]) + 2 * _times(inertia[j], s1[j])
        d_q[:, :6, j] = _times(B[j], s1[j]) + _times(inertia[j], s2[j]) + _force_cross(s[j], f[j])
        value[:, 6 + j] = (s[j] * f[j]).sum(axis=1)
        left = np.einsum("kx,kxy->ky", s[j], inertia[j]), np.einsum("kx,kxy->ky", s[j], B[j])
        for i in range(j):
            for d in (d_a, d_v, d_q):
                d[:, 6 + i, j] = (s[i] * d[:, :6, j]).sum(axis=1)
            d_a[:, 6 + j, i] = (left[0] * s[i]).sum(axis=1)
            d_v[:, 6 + j, i] = (left[1] * s[i] + 2 * left[0] * s1[i]).sum(axis=1)
            d_q[:, 6 + j, i] = (left[1] * s1[i] + left[0] * s2[i]).sum(axis=1)
        for d in (d_a, d_v, d_q):
            d[:, 6 + j, j] = (s[j] * d[:, :6, j]).sum(axis=1)
    return value, d_q, d_v, d_a


def _skew(x: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) of the cross products with vectors (..., 3)."""
    K = np.zeros((*x.shape, 3))
    K[..., 2, 1], K[..., 0, 2], K[..., 1, 0] = x[..., 0], x[..., 1], x[..., 2]
    return K - np.swapaxes(K, -1, -2)


def _times(M: FloatArray, x: FloatArray) -> FloatArray:
    return np.asarray((M @ x[..., None])[..., 0])


def _motion_cross(V: FloatArray, m: FloatArray) -> FloatArray:
    linear = np.cross(V[:, 3:], m[:, :3]) + np.cross(V[:, :3], m[:, 3:])
    return np.hstack([linear, np.cross(V[:, 3:], m[:, 3:])])


def _force_cross(V: FloatArray, f: FloatArray) -> FloatArray:
    angular = np.cross(V[:, :3], f[:, :3]) + np.cross(V[:, 3:], f[:, 3:])
    return np.hstack([np.cross(V[:, 3:], f[:, :3]), angular])


def _motion_matrix(V: FloatArray) -> FloatArray:
    linear, angular = _skew(V[:, :3]), _skew(V[:, 3:])
    return np.block([[angular, linear], [np.zeros_like(linear), angular]])


def _bar(h: FloatArray) -> FloatArray:
    """Matrices (N, 6, 6) that take a motion m to m x* h."""
    force, torque = _skew(h[:, :3]), _skew(h[:, 3:])
    return -np.block([[np.zeros_like(force), force], [force, torque]])


def _inertia(mass: float, centre: FloatArray, about: FloatArray) -> FloatArray:
    C = mass * _skew(centre)
    M = np.broadcast_to(mass * np.eye(3), C.shape)
    return np.block([[M, -C], [C, about - C @ _skew(centre)]])


def compiled() -> Callable[[Arm, FloatArray, FloatArray, FloatArray], Answer]:
    """Return `batched`, compiled: a loop over states. The compiled code is kept for the next time.

    Raises
    ------
    ImportError
        Without numba.
    """
    os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(tempfile.gettempdir()) / "cmbot-benchmarks"))
    from compiled_form import derivatives

    def run(arm: Arm, q: FloatArray, v: FloatArray, a: FloatArray) -> Answer:
        answer: Any = derivatives(*arm, q, v, a)
        value, d_q, d_v, d_a = answer
        return value, d_q, d_v, d_a

    return run
