"""A mast, column or boom that the robot stands on: a tube that is clamped at one end."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.reading.fields import Modulus, OneOf, Thickness, Vector, require_tube
from cmbot.common.reading.validation import refusal
from cmbot.elastic import beam_mass, beam_stiffness

# No material of a mast is as light, kg/m3.
_LIGHTEST_MATERIAL = 30.0


def _in_kilograms(density: float) -> float:
    if 0 < density < _LIGHTEST_MATERIAL:
        raise refusal(f"kg/m3: g/cm3? then {1000 * density:g}", got=density)
    return density


Density = Annotated[float, Field(ge=0, le=1e5), AfterValidator(_in_kilograms)]


class TubeFile(OneOf):
    """What the robot stands on, as a round or rectangular tube that is clamped at its start.

    An Euler-Bernoulli beam with its consistent mass, in place of the guardrail's stiffness and mass.
    """

    one_of = ("outer_diameter_m", "outer_m")

    start_m: Vector
    """Where it is clamped, m, in W."""
    end_m: Vector = (0.0, 0.0, 0.0)
    """Where it holds the arm, m, in W; left out: the origin of W."""
    outer_diameter_m: Thickness | None = None
    """Of a round tube."""
    outer_m: tuple[Thickness, Thickness] | None = None
    """Sides of an upright box along x and y of W; of another one, turned with its axis the shortest way."""
    wall_m: Thickness
    """Its wall; half the diameter: a solid bar; of a box at most a quarter of a side."""
    young_pa: Modulus
    """Young's modulus, Pa: aluminium 70e9, steel 206e9."""
    shear_pa: Modulus
    """Shear modulus, Pa: aluminium 26e9, steel 79e9."""
    density_kg_m3: Density
    """Of its material: aluminium 2700, steel 7850."""

    def _check(self) -> None:
        super()._check()
        outer = min(self.outer_m or (self.outer_diameter_m or 0.0,))
        if math.dist(self.start_m, self.end_m) < max(self.outer_m or (outer,)):
            # Either may be the wrong one.
            got = f"start_m {self.start_m} and end_m {self.end_m}"
            raise refusal(f"ends farther apart than {self.given}", got=got)
        if self.outer_m and self.wall_m > outer / 4:
            expected = "at most a quarter of a side of outer_m: torsion is that of a thin wall"
            raise refusal(expected, got=self.wall_m, key=("wall_m",))
        require_tube(self.start_m, self.end_m, outer, self.wall_m)

    @property
    def _section(self) -> tuple[float, float, float, float]:
        """Area, m2, torsion constant and second moments about x and y of the upright tube, m4."""
        wall = self.wall_m
        if self.outer_m is None:
            outer = self.outer_diameter_m or 0.0
            inner = outer - 2 * wall
            second = math.pi / 64 * (outer**4 - inner**4)
            return math.pi / 4 * (outer**2 - inner**2), 2 * second, second, second
        a, b = self.outer_m
        inner_a, inner_b = a - 2 * wall, b - 2 * wall
        # Bredt: four times the square of the area within the wall's middle, over its length by the wall.
        twist = 2 * wall * ((a - wall) * (b - wall)) ** 2 / (a + b - 2 * wall)
        about_x, about_y = (a * b**3 - inner_a * inner_b**3) / 12, (b * a**3 - inner_b * inner_a**3) / 12
        return a * b - inner_a * inner_b, twist, about_x, about_y

    def matrices(self) -> tuple[FloatArray, FloatArray]:
        """Return stiffness and mass (6, 6) about the origin of W, linear then angular, SI."""
        end = np.array(self.end_m)
        along = end - self.start_m
        L = np.array([np.linalg.norm(along)])
        area, twist, *second = (np.array([each]) for each in self._section)
        # A box is the same upside down.
        turn = Rotation.align_vectors(along if along[2] >= 0 else -along, [0.0, 0.0, 1.0])[0].as_matrix()
        axes = np.column_stack([along / L, turn[:, 0], np.cross(along / L, turn[:, 0])])[None]
        E, m = self.young_pa, self.density_kg_m3 * area * L
        stiffness = beam_stiffness(axes, L, E * area, self.shear_pa * twist, E * second[0], E * second[1])
        mass = beam_mass(axes, L, m, sum(second) / area * m)
        moved = np.eye(6)
        moved[:3, 3:] = np.cross(end, np.eye(3))
        of_end = (matrix[0, 6:, 6:] for matrix in (stiffness, mass))
        K, M = (read_only(moved.T @ matrix @ moved) for matrix in of_end)
        return K, M
