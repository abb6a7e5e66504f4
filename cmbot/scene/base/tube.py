"""A mast, column or boom that the robot stands on: a round tube that is clamped at one end."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.reading.fields import Modulus, Thickness, Vector, require_tube
from cmbot.common.reading.validation import FileModel, refusal
from cmbot.elastic import beam_mass, beam_stiffness

# No material of a mast is as light, kg/m3.
_LIGHTEST_MATERIAL = 30.0


def _in_kilograms(density: float) -> float:
    if 0 < density < _LIGHTEST_MATERIAL:
        raise refusal(f"kg/m3: g/cm3? then {1000 * density:g}", got=density)
    return density


Density = Annotated[float, Field(ge=0, le=1e5), AfterValidator(_in_kilograms)]


class TubeFile(FileModel):
    """What the robot stands on, as a round tube that is clamped at its start.

    An Euler-Bernoulli beam with its consistent mass, in place of the guardrail's stiffness and mass.
    """

    start_m: Vector
    """Where it is clamped, m, in W."""
    end_m: Vector = (0.0, 0.0, 0.0)
    """Where it holds the arm, m, in W; left out: the origin of W."""
    outer_diameter_m: Thickness
    """Of the tube."""
    wall_m: Thickness
    """Its wall; half the diameter: a solid bar."""
    young_pa: Modulus
    """Young's modulus, Pa: aluminium 70e9, steel 206e9."""
    shear_pa: Modulus
    """Shear modulus, Pa: aluminium 26e9, steel 79e9."""
    density_kg_m3: Density
    """Of its material: aluminium 2700, steel 7850."""

    def _check(self) -> None:
        if math.dist(self.start_m, self.end_m) < self.outer_diameter_m:
            expected = "an end farther from start_m than outer_diameter_m"
            raise refusal(expected, got=self.end_m, key=("end_m",))
        require_tube(self.start_m, self.end_m, self.outer_diameter_m, self.wall_m)

    def matrices(self) -> tuple[FloatArray, FloatArray]:
        """Return stiffness and mass (6, 6) about the origin of W, linear then angular, SI."""
        outer, end, E = self.outer_diameter_m, np.array(self.end_m), self.young_pa
        L, inner = np.array([math.dist(self.start_m, end)]), outer - 2 * self.wall_m
        area, second = math.pi / 4 * (outer**2 - inner**2), math.pi / 64 * (outer**4 - inner**4)
        m, EI = self.density_kg_m3 * area * L, np.array([E * second])
        # Any two axes across a round tube's own are principal.
        axes = Rotation.align_vectors(end - self.start_m, [1.0, 0.0, 0.0])[0].as_matrix()[None]
        EA, GJ = np.array([E * area]), np.array([2 * self.shear_pa * second])
        stiffness = beam_stiffness(axes, L, EA, GJ, EI, EI)
        mass = beam_mass(axes, L, m, 2 * second / area * m)
        moved = np.eye(6)
        moved[:3, 3:] = np.cross(end, np.eye(3))
        of_end = (matrix[0, 6:, 6:] for matrix in (stiffness, mass))
        K, M = (read_only(moved.T @ matrix @ moved) for matrix in of_end)
        return K, M
