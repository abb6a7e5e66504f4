"""Matrices (6, 6) of stiffness and mass in files."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from cmbot.common.reading.validation import refusal, shown

# Their bounds keep every product finite.
Entry = Annotated[float, Field(ge=-1e15, le=1e15)]
Row6 = tuple[Entry, Entry, Entry, Entry, Entry, Entry]


def _six_rows(value: object, units: str, *, diagonal: bool = False) -> object:
    """Six rows of six numbers as pydantic takes them; `diagonal`: or the six of the diagonal."""
    lists = (list, tuple)
    rows = value if isinstance(value, lists) else ()
    if diagonal and len(rows) == 6 and all(isinstance(entry, int | float) for entry in rows):
        return tuple(tuple(entry if i == j else 0.0 for j in range(6)) for i, entry in enumerate(rows))
    if len(rows) != 6 or not all(isinstance(row, lists) and len(row) == 6 for row in rows):
        units = f"{units}), or the diagonal's 6" if diagonal else f"{units})"
        raise refusal(f"6 rows of 6 numbers, linear then angular ({units}", got=shown(value))
    # Past here pydantic no longer knows that it came from JSON, and wants tuples.
    return tuple(map(tuple, rows))


def _positive_definite(rows: tuple[Row6, ...]) -> tuple[Row6, ...]:
    """Refuse a matrix that is not symmetric positive definite."""
    matrix = np.array(rows)
    expected = "a symmetric positive definite matrix"
    scale = np.sqrt(np.abs(np.diag(matrix)))
    if not np.all(np.diag(matrix) > 0):
        raise refusal(expected, got=f"the diagonal {np.diag(matrix).tolist()}")
    with np.errstate(over="ignore"):
        scaled = matrix / scale[:, None] / scale  # newtons and newton metres on one scale
    # In a positive definite matrix scaled to a unit diagonal no entry exceeds 1.
    if not np.all(np.abs(scaled) <= 1 + 1e-9):
        raise refusal(expected, got="a matrix that is not positive definite")
    if not np.allclose(scaled, scaled.T, rtol=0, atol=1e-9):
        i, j = np.unravel_index(np.abs(scaled - scaled.T).argmax(), matrix.shape)
        got = f"a matrix that is not symmetric: [{i}][{j}] is {matrix[i, j]:g}, [{j}][{i}] {matrix[j, i]:g}"
        raise refusal(expected, got=got)
    if np.linalg.eigvalsh(scaled)[0] <= 1e-12:
        raise refusal(expected, got="a matrix that is not positive definite")
    return rows


Matrix6 = tuple[Row6, Row6, Row6, Row6, Row6, Row6]
"""Six rows of six numbers, linear then angular."""
PositiveDefinite6 = Annotated[Matrix6, AfterValidator(_positive_definite)]
Stiffness6 = Annotated[
    PositiveDefinite6, BeforeValidator(partial(_six_rows, units="N/m, N/rad, Nm/rad", diagonal=True))
]
"""A stiffness, or the six numbers of its diagonal."""
Mass6 = Annotated[PositiveDefinite6, BeforeValidator(partial(_six_rows, units="kg, kg m, kg m2"))]
