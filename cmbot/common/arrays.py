"""Names for the arrays of annotations, whose shapes and units stand in the docstrings; vector products."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]
_Array = TypeVar("_Array", bound=NDArray[np.generic])


def read_only(array: _Array) -> _Array:
    """Return the array itself, from now on read-only."""
    array.setflags(write=False)
    return array


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return vector products (..., 3); NumPy's own function spends its time on the arguments."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(a[..., j] * b[..., k], a[..., k] * b[..., j], out=product[..., i])
    return product
