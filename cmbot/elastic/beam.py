"""Stiffness and consistent mass of straight Euler-Bernoulli beams in space, many at a time.

A beam's 12 coordinates are displacement and rotation of its start, then of its end. Its own axes are x along
it and y, z along the principal axes of its section; there bending in the two planes, stretching and torsion
do not know each other. Shear deformation and the rotary inertia of bending are left out.

Source: J. S. Przemieniecki, Theory of Matrix Structural Analysis, 1968, without shear and rotary inertia.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray

__all__ = ["Beams"]

# Coordinates that take part in each kind of deformation.
_STRETCH = (0, 6)
_TORSION = (3, 9)
_BEND_XY = (1, 5, 7, 11)
_BEND_XZ = (2, 4, 8, 10)
# In the plane xz a positive turn about y lowers the beam where in the plane xy one about z lifts it.
_SIGNS_XZ = np.array([1.0, -1.0, 1.0, -1.0])

_ROD_STIFFNESS = np.array([[1.0, -1.0], [-1.0, 1.0]])
_ROD_MASS = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6
# In units of EI / L^3 and of the beam's mass, rotations counted as L times the angle.
_BEND_STIFFNESS = np.array(
    [[12.0, 6.0, -12.0, 6.0], [6.0, 4.0, -6.0, 2.0], [-12.0, -6.0, 12.0, -6.0], [6.0, 2.0, -6.0, 4.0]]
)
_BEND_MASS = (
    np.array(
        [
            [156.0, 22.0, 54.0, -13.0],
            [22.0, 4.0, 13.0, -3.0],
            [54.0, 13.0, 156.0, -22.0],
            [-13.0, -3.0, -22.0, 4.0],
        ]
    )
    / 420
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Beams:
    """A stack of m beams.

    Attributes
    ----------
    rotation : (m, 3, 3)
        Columns are a beam's own axes x, y, z in W.
    length : (m,), m
    stretch : (m,), N
        E A.
    bend_y, bend_z, twist : (m,), N m2
        E I about the beam's y and z axis, G J.
    line_mass : (m,), kg/m
    line_inertia : (m,), kg m
        About the beam's x axis, of a metre of beam.
    """

    rotation: FloatArray
    length: FloatArray
    stretch: FloatArray
    bend_y: FloatArray
    bend_z: FloatArray
    twist: FloatArray
    line_mass: FloatArray
    line_inertia: FloatArray

    def stiffness(self) -> FloatArray:
        """Stiffness matrices in W, (m, 12, 12), N/m, N, Nm; exact for loads at the ends."""
        L = self.length
        local = np.zeros((len(L), 12, 12))
        _add(local, _STRETCH, self.stretch / L, _ROD_STIFFNESS)
        _add(local, _TORSION, self.twist / L, _ROD_STIFFNESS)
        _add(local, _BEND_XY, self.bend_z / L**3, _bending(_BEND_STIFFNESS, L))
        _add(local, _BEND_XZ, self.bend_y / L**3, _bending(_BEND_STIFFNESS, L, _SIGNS_XZ))
        return self._turned(local)

    def mass(self) -> FloatArray:
        """Consistent mass matrices in W, (m, 12, 12), kg, kg m, kg m2."""
        L = self.length
        local = np.zeros((len(L), 12, 12))
        whole = self.line_mass * L
        _add(local, _STRETCH, whole, _ROD_MASS)
        _add(local, _TORSION, self.line_inertia * L, _ROD_MASS)
        _add(local, _BEND_XY, whole, _bending(_BEND_MASS, L))
        _add(local, _BEND_XZ, whole, _bending(_BEND_MASS, L, _SIGNS_XZ))
        return self._turned(local)

    def _turned(self, local: FloatArray) -> FloatArray:
        blocks = local.reshape(-1, 4, 3, 4, 3)
        R = self.rotation
        turned = np.einsum("mxi,maibj,myj->maxby", R, blocks, R, optimize=True)
        return np.asarray(turned.reshape(-1, 12, 12))


def _add(local: FloatArray, where: tuple[int, ...], factors: FloatArray, matrix: FloatArray) -> None:
    """Add `factors` (m,) times `matrix` (..., k, k) to the coordinates `where` of every beam."""
    index = np.array(where)
    local[:, index[:, None], index] += factors[:, None, None] * matrix


def _bending(matrix: FloatArray, length: FloatArray, signs: FloatArray | None = None) -> FloatArray:
    """Matrices (m, 4, 4) of bending beams in their true units."""
    scale = np.ones((len(length), 4))
    scale[:, 1::2] = length[:, None]
    if signs is not None:
        scale *= signs
    return np.asarray(scale[:, :, None] * matrix * scale[:, None, :])
