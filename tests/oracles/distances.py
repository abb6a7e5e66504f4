"""Signed distances from closed forms and plain minimisation: no GJK, no coal."""

from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

FloatArray = NDArray[np.float64]


def capsule_of(robot: Any, q: FloatArray, link: str) -> tuple[FloatArray, FloatArray, float]:
    """Ends of the axis (3,) and radius of the one capsule of a link, in W at posture `q`."""
    (shape,) = (s for s in robot.collision_model.geometryObjects if s.name == f"{link}_0")
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    X_WS = data.oMi[shape.parentJoint] * shape.placement
    half = np.array([0, 0, shape.geometry.halfLength])
    return X_WS.act(-half), X_WS.act(half), shape.geometry.radius


def from_capsule(
    robot: Any, q: FloatArray, link: str, geometry: Any, X_WO: Any, *, clear: float = 1e-6
) -> float:
    """Signed distance of a link's capsule to a primitive at `X_WO`.

    NaN where the capsule's axis itself comes nearer than `clear`: there it is no longer its radius less.
    """
    start, end, radius = capsule_of(robot, q, link)
    a, b = X_WO.actInv(start), X_WO.actInv(end)
    # The distance to a convex shape is a convex function along a segment.
    best = minimize_scalar(
        lambda s: from_point(geometry, a + s * (b - a)),
        bounds=(0, 1),
        method="bounded",
        options={"xatol": 1e-12},
    ).fun
    best = min(best, from_point(geometry, a), from_point(geometry, b))
    return float(best - radius) if best > clear else np.nan


def from_point(geometry: Any, p: FloatArray) -> float:
    """Distance of a point outside a primitive, in the primitive's frame; 0 in a box or cylinder."""
    match geometry:
        case coal.Box():
            return float(np.linalg.norm(np.maximum(np.abs(p) - geometry.halfSide, 0)))
        case coal.Cylinder():
            across = np.hypot(p[0], p[1]) - geometry.radius
            along = abs(p[2]) - geometry.halfLength
            return float(np.hypot(max(across, 0), max(along, 0)))
        case coal.Capsule():
            along = np.clip(p[2], -geometry.halfLength, geometry.halfLength)
            return float(np.linalg.norm(p - [0, 0, along]) - geometry.radius)
        case coal.Sphere():
            return float(np.linalg.norm(p) - geometry.radius)
    raise NotImplementedError


def between_hulls(A: FloatArray, B: FloatArray) -> float:
    """Distance between the convex hulls of points (N, 3) and (M, 3): a small quadratic program."""
    P = np.vstack([A, -B])
    weights = np.concatenate([np.full(len(A), 1 / len(A)), np.full(len(B), 1 / len(B))])
    which = np.repeat(np.eye(2), [len(A), len(B)], axis=1)
    result = minimize(
        lambda w: 0.5 * float((P.T @ w) @ (P.T @ w)),
        weights,
        jac=lambda w: P @ (P.T @ w),
        bounds=[(0, 1)] * len(weights),
        constraints={"type": "eq", "fun": lambda w: which @ w - 1, "jac": lambda w: which},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-15},
    )
    return float(np.linalg.norm(P.T @ result.x))
