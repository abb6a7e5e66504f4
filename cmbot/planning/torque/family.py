"""What every family of splines offers the torque problem."""

from __future__ import annotations

from typing import Protocol, Self

from cmbot.common.arrays import FloatArray
from cmbot.trajectory.spline_space import SplineSpace

__all__ = ["Family"]


class Family(Protocol):
    """C3 splines as functions of a vector x of unknowns, built around one of them."""

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
