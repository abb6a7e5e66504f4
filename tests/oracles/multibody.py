"""An arm as bodies on joints, and its equations of motion, apart from the package's model of it.

The package's dynamics are pinocchio's: one recursion in the joints' frames over links whose inertias were
joined. Here Newton's and Euler's equations are written out in W for every body by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cmbot.common.arrays import BoolArray, FloatArray
from oracles.convex_distance import ConvexShape

__all__ = ["Body", "JointBounds", "Multibody", "PlacedShape", "turn"]

_GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """A rigid body, in the frame of the joint that carries it.

    Attributes
    ----------
    joint : int
        From 1; 0: carried by none, the frame is W.
    mass : float, kg
    centre : (3,), m
        Of mass.
    inertia : (3, 3), kg m2
        About the centre.
    """

    joint: int
    mass: float
    centre: FloatArray
    inertia: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedShape:
    """A collision shape of a link.

    Attributes
    ----------
    link : str
    joint : int
        From 1; 0: carried by none, the frame is W.
    X_JS : (4, 4)
        Pose in the frame of that joint.
    shape : ConvexShape
    """

    link: str
    joint: int
    X_JS: FloatArray
    shape: ConvexShape


@dataclass(frozen=True, kw_only=True, eq=False)
class JointBounds:
    """Bounds of n joints, as `cmbot.robot.JointLimits` has them: each (n,), rad, s and Nm, or m, s and N."""

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    torque: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Multibody:
    """An arm of n joints that turn or slide, base to tool, and everything that is fixed to W.

    Its equations also hold for complex states.

    Attributes
    ----------
    joints : tuple of str
    step : (n, 4, 4)
        Pose of each joint's frame, at zero, in that of the one before; of the first one in W.
    axis : (n, 3)
        Unit vectors in the joints' frames.
    slides : (n,)
        Which joints move along their axes; the others turn about them.
    bodies : tuple of Body
    shapes : tuple of PlacedShape
    pairs : tuple of (int, int)
        Shapes that may collide.
    X_JT : (4, 4)
        Pose of the tool in the last joint's frame.
    bounds : JointBounds
    """

    joints: tuple[str, ...]
    step: FloatArray
    axis: FloatArray
    slides: BoolArray
    bodies: tuple[Body, ...]
    shapes: tuple[PlacedShape, ...]
    pairs: tuple[tuple[int, int], ...]
    X_JT: FloatArray
    bounds: JointBounds

    def frames(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Orientations (n + 1, N, 3, 3) and origins (n + 1, N, 3), m, of W and the joints' frames in W."""
        N, n = q.shape
        R, p = (np.empty((n + 1, N, *shape), dtype=q.dtype) for shape in ((3, 3), (3,)))
        R[0], p[0] = np.eye(3), 0.0
        for i, (X, axis) in enumerate(zip(self.step, self.axis, strict=True)):
            R[i + 1] = R[i] @ X[:3, :3]
            p[i + 1] = p[i] + R[i] @ X[:3, 3]
            if self.slides[i]:
                p[i + 1] += q[:, i, None] * (R[i + 1] @ axis)
            else:
                R[i + 1] = R[i + 1] @ turn(axis, q[:, i])
        return R, p

    def tool_poses(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tool points (N, 3), m, and orientations (N, 3, 3) in W at postures `q` (N, n)."""
        R, p = self.frames(q)
        return p[-1] + R[-1] @ self.X_JT[:3, 3], R[-1] @ self.X_JT[:3, :3]

    def tool_velocities(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Velocities (N, 3) of the tool point in W, m/s, at postures `q` and rates `v` (N, n)."""
        R, p = self.frames(q)
        tool, velocity = p[-1] + R[-1] @ self.X_JT[:3, 3], np.zeros((len(q), 3))
        for i, axis in enumerate(self.axis):
            z = R[i + 1] @ axis
            velocity += v[:, i, None] * (z if self.slides[i] else np.cross(z, tool - p[i + 1]))
        return velocity

    def efforts(
        self,
        q: FloatArray,
        v: FloatArray,
        a: FloatArray,
        tool_force: Sequence[float] = (0.0, 0.0, 0.0),
        base_acceleration: ArrayLike = (0.0, 0.0, 0.0),
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint torques (N, n), Nm (of joints that slide forces, N), and the arm's wrench on the guardrail.

        That is the force and the torque (N, 3) of what moves, about the origin of W, N and Nm. Newton's and
        Euler's equations give each body's force and moment about it; a joint bears the sum over all bodies
        from it on, the guardrail the sum over all that move. What acts on the tool takes its share off.

        Parameters
        ----------
        q, v, a : (N, n), rad, rad/s, rad/s2, or m, m/s, m/s2
        tool_force : (3,), N
            That acts on the tool, along its axes.
        base_acceleration : (N, 3) or (3,), m/s2
            Of what the arm stands on, which does not turn.
        """
        R, p = self.frames(q)
        z = np.stack([R_i @ u for R_i, u in zip(R[1:], self.axis, strict=True)])
        N, n = q.shape
        # Angular velocity and acceleration of the frames, and acceleration of their origins.
        w, w_dot, acc = (np.zeros((n + 1, N, 3), dtype=q.dtype) for _ in range(3))
        # Gravity as an acceleration of the base.
        acc[0] = np.asarray(base_acceleration) - _GRAVITY
        for i in range(n):
            acc[i + 1] = acc[i] + _relative_acceleration(w[i], w_dot[i], p[i + 1] - p[i])
            if self.slides[i]:
                # Coriolis's acceleration and that along the axis.
                acc[i + 1] += 2 * np.cross(w[i], v[:, i, None] * z[i]) + a[:, i, None] * z[i]
                w[i + 1], w_dot[i + 1] = w[i], w_dot[i]
                continue
            spin = v[:, i, None] * z[i]
            w_dot[i + 1] = w_dot[i] + a[:, i, None] * z[i] + np.cross(w[i], spin)
            w[i + 1] = w[i] + spin
        force, moment = (np.zeros((n + 1, N, 3), dtype=q.dtype) for _ in range(2))
        for body in self.bodies:
            i = body.joint
            lever = R[i] @ body.centre
            F = body.mass * (acc[i] + _relative_acceleration(w[i], w_dot[i], lever))
            inertia = R[i] @ body.inertia @ R[i].transpose(0, 2, 1)
            force[i] += F
            moment[i] += np.cross(p[i] + lever, F) + _times(inertia, w_dot[i])
            moment[i] += np.cross(w[i], _times(inertia, w[i]))
        push = R[-1] @ (self.X_JT[:3, :3] @ np.array(tool_force))
        force[-1] -= push
        moment[-1] -= np.cross(p[-1] + R[-1] @ self.X_JT[:3, 3], push)
        # Of all bodies from a joint on.
        force, moment = (np.cumsum(x[:0:-1], axis=0)[::-1] for x in (force, moment))
        borne = np.where(self.slides[:, None, None], force, moment - np.cross(p[1:], force))
        tau = np.einsum("ikd,ikd->ki", z, borne)
        return tau, -force[0], -moment[0]


def _relative_acceleration(w: FloatArray, w_dot: FloatArray, lever: FloatArray) -> FloatArray:
    """Acceleration (N, 3) of the end of a lever (N, 3) from its beginning's."""
    return np.asarray(np.cross(w_dot, lever) + np.cross(w, np.cross(w, lever)))


def _times(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("kij,kj->ki", matrix, vector))


def turn(axis: FloatArray, angle: ArrayLike) -> FloatArray:
    """Return rotations (..., 3, 3) about the unit vector `axis` (3,) by angles (...), rad: Rodrigues."""
    angle = np.asarray(angle)[..., None, None]
    along, K = np.outer(axis, axis), np.cross(axis, np.eye(3)).T
    return np.asarray(along + np.cos(angle) * (np.eye(3) - along) + np.sin(angle) * K)
