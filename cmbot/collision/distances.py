"""What is said about distances: of which two shapes, how small, between which points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray

__all__ = ["Nearest", "ShapePair", "Smallest"]


@dataclass(frozen=True, kw_only=True)
class ShapePair:
    """Two shapes whose distance counts.

    Attributes
    ----------
    link : str
        Link of the arm.
    other : str
        Obstacle, or second link of the robot.
    of_arm : bool
        Both belong to the robot.
    at_work : bool
        The tool, which is all that the last joint carries, and a workpiece: expected to be near each other.
    """

    link: str
    other: str
    of_arm: bool
    at_work: bool

    def too_near(self, distance: float, margin: float) -> str:
        """Say that a distance of the two, m, is below the safety margin, m."""
        if distance < 0:
            how = f"{self.link} reaches {-distance:.4f} m into {self.other}"
        else:
            how = f"{self.link} comes within {distance:.4f} m of {self.other}"
        return f"{how}, the safety margin is {margin:g} m"


@dataclass(frozen=True, kw_only=True)
class Smallest:
    """The smallest distance in each of N postures.

    Attributes
    ----------
    distance : (N,), m
        Negative where shapes overlap.
    pair : (N,)
        Index into `Clearances.pairs`; -1 where no pair counts (the distance is then infinite) or the posture
        is no number (the distance is then NaN).
    """

    distance: FloatArray
    pair: IntArray


@dataclass(frozen=True, kw_only=True)
class Nearest:
    """The nearest points of one pair in one posture.

    Attributes
    ----------
    distance : float, m
    point, other_point : (3,), m
        On the arm (C of Chang 2021, Eq. (17)) and on the other shape, in W.
    direction : (3,)
        u of Eq. (17): from the other shape to the arm, unit length, also where shapes touch or overlap.
    jacobian : (3, n), m/rad
        J_C of the point on the arm, less that of the other point where it moves with the arm.
    """

    distance: float
    point: FloatArray
    other_point: FloatArray
    direction: FloatArray
    jacobian: FloatArray

    @property
    def gradient(self) -> FloatArray:
        """Derivative of the distance with respect to the joints, (n,), m/rad."""
        return np.asarray(self.direction @ self.jacobian)
