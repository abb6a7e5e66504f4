"""What a family of splines offers the torque problem, dense or sparse."""

from __future__ import annotations

from typing import Any, Protocol, Self

from cmbot.arrays import FloatArray, IntArray
from cmbot.planning.spline_space import SplineSpace

__all__ = ["Family"]


class Family(Protocol):
    """C3 splines as functions of a vector x of unknowns, built around one of them.

    Derivatives are matrices, dense or sparse, of a width of the family's own.
    """

    @property
    def space(self) -> SplineSpace:
        """Where the splines live."""

    @property
    def via_points(self) -> FloatArray:
        """Via-points (n, d), rad, of the spline that the family was built around."""

    @property
    def sliding(self) -> bool:
        """Whether via-points may slide along the self-motion."""

    @property
    def slides(self) -> int:
        """Number of unknowns that slide via-points."""

    @property
    def dimension(self) -> int:
        """Number of unknowns."""

    @property
    def start(self) -> FloatArray:
        """Unknowns (dimension,) of the spline that the family was built around."""

    def via_points_at(self, x: FloatArray) -> FloatArray:
        """Via-points (n, d)."""

    def knots(self, x: FloatArray) -> FloatArray:
        """Knot vectors (3n, d)."""

    def rebuilt(self, x: FloatArray, weight: float) -> Self:
        """Build the family anew around `x`, with another weight of the smoothing term."""

    def rows(self, times: FloatArray) -> Any:
        """Splines at `times`, for `chain`."""

    def stacked(self, jacobians: list[Any]) -> Any:
        """Put derivatives one below the other."""

    def chain(self, x: FloatArray, rows: Any, d_q: FloatArray, d_v: FloatArray, d_a: FloatArray) -> Any:
        """Take derivatives (N, d) by the states to those of the family's own."""

    def chain_one(self, x: FloatArray, rows: Any, order: int, joint: IntArray, factor: FloatArray) -> Any:
        """Derivatives of ``factor`` times derivative `order` of one `joint` each."""
