"""Names for the arrays of annotations, whose shapes and units stand in the docstrings; batches; products."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]
_Array = TypeVar("_Array", bound=NDArray[np.generic])


class Batch:
    """Base of dataclasses of arrays that have their first axis in common."""

    def __len__(self) -> int:
        return len(self._arrays[0])

    def __getitem__(self, index: BoolArray | IntArray | slice) -> Self:
        return type(self)(*(array[index] for array in self._arrays))

    @property
    def _arrays(self) -> list[Any]:
        return [getattr(self, each.name) for each in fields(self)]  # type: ignore[arg-type]

    @classmethod
    def joined(cls, *some: Self) -> Self:
        """Return all of them in one."""
        return cls(*map(np.concatenate, zip(*(each._arrays for each in some), strict=True)))


def read_only(array: _Array) -> _Array:
    """Return the array itself, from now on read-only."""
    array.setflags(write=False)
    return array


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return the first and last indices of the stretches in which all of `flags` (N,) are set."""
    edges = np.flatnonzero(np.diff(flags.astype(np.intp), prepend=0, append=0))
    return [(first, behind - 1) for first, behind in edges.reshape(-1, 2).tolist()]


def interpolated(at: FloatArray, t: FloatArray, rows: FloatArray) -> FloatArray:
    """Return rows (N, d) of the times `t` (N,) as they are `at` others (M,): linear in between, (M, d)."""
    return np.stack([np.interp(at, t, column) for column in rows.T], axis=1)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return vector products (..., 3); NumPy's own function spends its time on the arguments."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(a[..., j] * b[..., k], a[..., k] * b[..., j], out=product[..., i])
    return product
