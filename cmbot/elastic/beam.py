"""Beams: section constants of angle steel and bars, stiffness, consistent mass and strain in space.

A beam's 12 coordinates are displacement and rotation of its start, then of its end. Its own axes are x along
it and y, z along the principal axes of its section; there stretching, torsion and bending in the two planes
are uncoupled. Shear deformation and the rotary inertia of bending are left out.

Source: J. S. Przemieniecki, Theory of Matrix Structural Analysis, 1968, without shear and rotary inertia.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.elastic.guardrail import AngleSection, BarSection, FlatSection, Section

# The coordinates of stretching, torsion, bending in the plane xy and bending in the plane xz.
_COORDINATES = (np.array([0, 6]), np.array([3, 9]), np.array([1, 5, 7, 11]), np.array([2, 4, 8, 10]))
# A positive rotation about y lowers the beam in the plane xz; one about z lifts it in the plane xy.
_SIGNS_XZ = np.array([1.0, -1.0, 1.0, -1.0])

_ROD_STIFFNESS = np.array([[1.0, -1.0], [-1.0, 1.0]])
_ROD_MASS = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6
# In units of EI / L^3 and of the beam's mass, with L times the angle as rotation.
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


# Second derivatives of a cubic at both ends, in units of 1 / L^2, with L times the slope.
_CURVATURE = np.array([[-6.0, -4.0, 6.0, -2.0], [6.0, 2.0, -6.0, 4.0]])


class Outline(NamedTuple):
    """Where the outer fibres of a section are: within `radius`, m, of its `corners`, (y, z), m.

    Both from the centroid along the beam's own axes. An angle has corners without a radius, a round section a
    radius about its centroid.
    """

    corners: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    radius: float = 0.0


_AXIS_OUTLINE = Outline()


@dataclass(frozen=True, kw_only=True)
class SectionConstants:
    """Constants of a cross-section about its centroid.

    Area, m2; principal second moments of area, the larger one first, m4; torsion constant J, m4; `tilt`: the
    angle of the axis that `major` is about from the section's first axis, towards the second, rad; `outline`:
    its outer fibres, the axis alone where it is left out.
    """

    area: float
    major: float
    minor: float
    torsion: float
    tilt: float
    outline: Outline = _AXIS_OUTLINE


def section_constants(section: Section) -> SectionConstants:
    """Return the constants of a section; the legs of an angle point along its first and second axis.

    An angle is two rectangles, without the fillets of rolled steel: area and second moments are exact for
    that shape. Its torsion constant is that of thin walls, the sum of b t^3 / 3 over the two centre lines;
    warping is free. That of a flat bar is Saint-Venant's series.
    """
    if isinstance(section, AngleSection):
        return _angle(section.leg, section.thickness)
    if isinstance(section, FlatSection):
        return _flat(section.width, section.thickness)
    area = math.pi * section.diameter**2 / 4
    moment = area * section.diameter**2 / 16
    return SectionConstants(
        area=area,
        major=moment,
        minor=moment,
        torsion=2 * moment,
        tilt=0.0,
        outline=Outline(radius=section.diameter / 2),
    )


@lru_cache
def yield_moments(section: Section, stress: float) -> tuple[float, float]:
    """Return the moments, Nm, at which a section's outer fibres yield, so much as `stress`, Pa, in tension.

    About the member and about the axis of the larger second moment of area. By von Mises the shear stress is
    the tensile one over the root of 3. Torsion of an open section is not judged, infinity: where warping is
    held, it bears more than Saint-Venant's torsion says.

    Parameters
    ----------
    section : Section
    stress : float, Pa
    """
    constants, twist = section_constants(section), math.inf
    if isinstance(section, BarSection):
        twist = stress / math.sqrt(3) * constants.torsion / (section.diameter / 2)
    reach = max(abs(z) for _, z in constants.outline.corners) + constants.outline.radius
    return twist, stress * constants.major / reach


def _angle(a: float, t: float) -> SectionConstants:
    # (width, height, y, z of the centre) from the corner: one whole leg, and the rest of the other.
    # By symmetry both second moments are the same.
    rectangles = ((a, t, a / 2, t / 2), (t, a - t, t / 2, (a + t) / 2))
    area = sum(b * h for b, h, _, _ in rectangles)
    centre = sum(b * h * y for b, h, y, _ in rectangles) / area
    moment = sum(b**3 * h / 12 + b * h * (y - centre) ** 2 for b, h, y, _ in rectangles)
    product = sum(b * h * (y - centre) * (z - centre) for b, h, y, z in rectangles)
    # The convex hull of the two legs, turned into the principal axes.
    hull = np.array([(0.0, 0.0), (a, 0.0), (a, t), (t, a), (0.0, a)]) - centre
    corners = hull @ np.array([[1.0, -1.0], [1.0, 1.0]]) / math.sqrt(2)
    return SectionConstants(
        area=area,
        major=moment - product,  # the product is negative
        minor=moment + product,
        torsion=area * t**2 / 3,
        tilt=math.pi / 4,
        outline=Outline(corners=tuple((y, z) for y, z in corners.tolist())),
    )


def _flat(b: float, t: float) -> SectionConstants:
    # Its fifth powers fall so quickly that three terms are exact to 1e-5.
    series = sum(math.tanh(n * math.pi * b / (2 * t)) / n**5 for n in (1, 3, 5))
    return SectionConstants(
        area=b * t,
        major=t * b**3 / 12,
        minor=b * t**3 / 12,
        torsion=b * t**3 / 3 * (1 - 192 / math.pi**5 * t / b * series),
        tilt=math.pi / 2,
        outline=Outline(corners=tuple((y, z) for y in (-t / 2, t / 2) for z in (-b / 2, b / 2))),
    )


def beam_stiffness(
    R: FloatArray, L: FloatArray, axial: FloatArray, twist: FloatArray, bend_y: FloatArray, bend_z: FloatArray
) -> FloatArray:
    """Stiffness matrices of m beams in W, (m, 12, 12), N/m, N, Nm; exact for loads at the ends.

    The columns of `R` (m, 3, 3) are a beam's own axes, `L` (m,), m, is its length. The rigidities (m,) are
    E A, N, then G J and E I about the beam's y and z axis, N m2.
    """
    factors = (axial / L, twist / L, bend_z / L**3, bend_y / L**3)
    return _assembled(R, L, factors, _ROD_STIFFNESS, _BEND_STIFFNESS)


def beam_mass(R: FloatArray, L: FloatArray, mass: FloatArray, inertia: FloatArray) -> FloatArray:
    """Consistent mass matrices (m, 12, 12) in W, from masses, kg, and inertias about the beams' x, kg m2."""
    return _assembled(R, L, (mass, inertia, mass, mass), _ROD_MASS, _BEND_MASS)


def beam_strain(R: FloatArray, L: FloatArray) -> FloatArray:
    """Strains of m beams at both ends by their coordinates in W, (m, 2, 3, 12), 1/m and 1/m2.

    The three are the stretch of the axis and the second derivatives v'' and w'' of the deflection along the
    beam's y and z: the fibre at (y, z) has the strain of the axis less y v'' + z w''. Between the ends they
    are linear, for loads at the ends. `R` and `L` are those of `beam_stiffness`.
    """
    local = np.zeros((len(L), 2, 3, 12))
    stretch, _, xy, xz = _COORDINATES
    local[:, :, 0, stretch] = (np.array([-1.0, 1.0]) / L[:, None])[:, None]
    scale = np.array([1.0, 0.0, 1.0, 0.0]) / L[:, None] ** 2 + np.array([0.0, 1.0, 0.0, 1.0]) / L[:, None]
    local[:, :, 1, xy] = _CURVATURE * scale[:, None]
    local[:, :, 2, xz] = _CURVATURE * (_SIGNS_XZ * scale)[:, None]
    turned = np.einsum("mecbi,mxi->mecbx", local.reshape(-1, 2, 3, 4, 3), R)
    return np.asarray(turned.reshape(-1, 2, 3, 12))


def _assembled(
    R: FloatArray, L: FloatArray, factors: Sequence[FloatArray], rod: FloatArray, bending: FloatArray
) -> FloatArray:
    """Matrices in W from the factors (m,) of the four uncoupled deformations and their unit matrices."""
    scale = np.ones((len(L), 4))
    scale[:, 1::2] = L[:, None]
    xy, xz = (s[:, :, None] * bending * s[:, None, :] for s in (scale, scale * _SIGNS_XZ))
    local = np.zeros((len(L), 12, 12))
    for index, factor, matrix in zip(_COORDINATES, factors, (rod, rod, xy, xz), strict=True):
        local[:, index[:, None], index] = factor[:, None, None] * matrix
    blocks = local.reshape(-1, 4, 3, 4, 3)
    turned = np.einsum("mxi,maibj,myj->maxby", R, blocks, R, optimize=True)
    return np.asarray(turned.reshape(-1, 12, 12))
