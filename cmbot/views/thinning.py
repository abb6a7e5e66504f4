"""Curves with fewer points that look the same: what sticks out of a stretch is kept."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray

__all__ = ["thinned"]


def thinned(t: FloatArray, y: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """Return the points of a curve that are needed to see it.

    The curve is cut into stretches of equally many points; the ends of the curve and the smallest and the
    largest value of each stretch stay.

    Parameters
    ----------
    t, y : (N,)
    most : int
        Number of points that may be left, 4 or more; with no more than that the curve is returned unchanged.

    Returns
    -------
    t, y : (M,)
        In the order of time.
    """
    if len(t) <= most:
        return t, y
    ends = np.linspace(0, len(t), (most - 2) // 2 + 1).astype(np.intp)
    first, last = ends[:-1], ends[1:]
    # A shorter stretch repeats its last point.
    stretches = y[np.minimum(first[:, None] + np.arange((last - first).max()), last[:, None] - 1)]
    extremes = first + stretches.argmin(axis=1), first + stretches.argmax(axis=1)
    kept = np.unique([0, *extremes[0], *extremes[1], len(t) - 1])
    return t[kept], y[kept]
