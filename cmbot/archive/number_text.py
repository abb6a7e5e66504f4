"""Numbers as text: each as `repr` has it, the shortest that reads back as the same."""

from __future__ import annotations

import numpy as np
from pydantic_core import to_json

from cmbot.common.arrays import FloatArray

__all__ = ["number_rows"]

# Python writes sizes outside with an exponent.
_PLAIN = (1e-4, 1e16)


def number_rows(table: FloatArray) -> list[list[str]]:
    """Return the numbers of a table (N, k) as text, row by row.

    pydantic's writer finds the digits ten times as fast as Python does. What it would write otherwise is left
    to Python.
    """
    numbers, size, width = table.ravel().tolist(), np.abs(table.ravel()), table.shape[1]
    cells = to_json(numbers, inf_nan_mode="constants").decode("ascii")[1:-1].split(",")
    for k in np.flatnonzero(~((size >= _PLAIN[0]) & (size < _PLAIN[1]))).tolist():
        cells[k] = repr(numbers[k])
    return [cells[k : k + width] for k in range(0, table.size, width)]
