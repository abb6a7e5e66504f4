"""How far an arm's shapes reach from its joints: none moves a point faster than its rate times that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray

__all__ = ["pair_reach", "shape_reach", "spread", "way_covered"]


def shape_reach(model: Any, shapes: Sequence[Any]) -> FloatArray:
    """Largest distance (S, n) that any point of a shape can have from each joint's origin, m.

    Zero where the joint does not move it.

    Parameters
    ----------
    model : pinocchio.Model
        A serial chain.
    shapes : S pinocchio.GeometryObject
    """
    offset = [float(np.linalg.norm(placement.translation)) for placement in model.jointPlacements]
    reach = np.zeros((len(shapes), model.nv))
    for k, shape in enumerate(shapes):
        joint = int(shape.parentJoint)
        if joint > 0:
            shape.geometry.computeLocalAABB()
            centre = shape.placement.act(shape.geometry.aabb_center)
            furthest = float(np.linalg.norm(centre)) + float(shape.geometry.aabb_radius)
            while joint > 0:
                reach[k, joint - 1] = furthest
                furthest += offset[joint]
                joint = int(model.parents[joint])
    return reach


def pair_reach(reach: FloatArray, joints: Sequence[int], pairs: Sequence[tuple[int, int]]) -> FloatArray:
    """Reach (P, n) of each joint in P pairs of shapes, m; zero where it moves both alike.

    No distance changes by more than the joints' moves times these.

    Parameters
    ----------
    reach : (S, n), m
        Of S shapes: `shape_reach`.
    joints : S int
        What carries each shape; 0: nothing.
    pairs : P pairs of int
        Indices of shapes: the second is carried by an earlier joint than the first, or does not move.
    """
    first = np.array([reach[i] for i, _ in pairs]).reshape(-1, reach.shape[1])
    still = np.array([joints[j] for _, j in pairs]).reshape(-1, 1)
    return np.where(np.arange(reach.shape[1]) >= still, first, 0.0)


def way_covered(q: FloatArray, reach: FloatArray) -> FloatArray:
    """Way (N,) from the first posture of a path to each, m: no distance changes by more between two of them.

    Parameters
    ----------
    q : (N, n), rad
    reach : (n,), m
        Of the joints, for all that counts.
    """
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)) @ reach)])


def spread(distance: FloatArray, measured: BoolArray, covered: FloatArray) -> None:
    """Raise lower bounds on distances along a path by what was measured beside them.

    Parameters
    ----------
    distance : (N,), m
        As measured, lower bounds elsewhere: these are raised.
    measured : (N,)
    covered : (N,), m
        See `way_covered`.
    """
    known = np.flatnonzero(measured)
    if len(known) == 0:
        return
    after = np.searchsorted(known, np.arange(len(distance)))
    for beside in (known[np.maximum(after - 1, 0)], known[np.minimum(after, len(known) - 1)]):
        lower = distance[beside] - np.abs(covered - covered[beside])
        np.maximum(distance, lower, out=distance, where=~measured)
