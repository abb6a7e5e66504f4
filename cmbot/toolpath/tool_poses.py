"""Poses of the tool, and shortest turns between directions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray, cross

# Sines of angles below which a turn is none, and two unit vectors are parallel or opposite.
_ZERO_ANGLE_SINE, _OPPOSITE = 1e-300, 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolPoses:
    """Poses of the tool in W.

    Attributes
    ----------
    point : (N, 3), m
    rotation : (N, 3, 3), or (1, 3, 3) where all have the same
        R_WT.
    """

    point: FloatArray
    rotation: FloatArray

    def __len__(self) -> int:
        return len(self.point)

    def __getitem__(self, which: IntArray | BoolArray | slice | int) -> ToolPoses:
        """Return some of the poses; of one index, that one."""
        chosen = slice(which, which + 1 or None) if isinstance(which, int | np.integer) else which
        rotation = self.rotation if len(self.rotation) == 1 else self.rotation[chosen]
        return ToolPoses(point=self.point[chosen], rotation=rotation)

    def __iter__(self) -> Iterator[ToolPoses]:
        """Yield the poses one by one."""
        return (self[k] for k in range(len(self)))


def shortest_turns(z: FloatArray, z_goal: FloatArray) -> FloatArray:
    """Return shortest rotation vectors (N, 3) from unit vectors `z` (N, 3) to others, (N, 3) or (1, 3)."""
    product, cosine = cross(z, z_goal), (z * z_goal).sum(axis=1)
    sine = np.linalg.norm(product, axis=1)
    vectors = product * (np.arctan2(sine, cosine) / np.maximum(sine, _ZERO_ANGLE_SINE))[:, None]
    for k in np.flatnonzero((sine < _OPPOSITE) & (cosine < 0)):
        # Half a turn about an axis across z, which rounding does not choose.
        across = cross(z[k], np.eye(3)[np.abs(z[k]).round(9).argmin()])
        vectors[k] = np.pi * across / np.linalg.norm(across)
    return np.asarray(vectors)
