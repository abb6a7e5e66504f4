"""Section constants of angle steel and round bars."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cmbot.elastic.guardrail import AngleSection, Section

__all__ = ["SectionConstants", "section_constants"]


@dataclass(frozen=True, kw_only=True)
class SectionConstants:
    """What a beam needs to know of its cross-section, about the centroid.

    Attributes
    ----------
    area : float
        m2.
    major, minor : float
        Principal second moments of area, the larger one first, m4.
    torsion : float
        Torsion constant J, m4.
    tilt : float
        Angle of the axis that `major` is about from the section's first axis, towards the second, rad.
    """

    area: float
    major: float
    minor: float
    torsion: float
    tilt: float


def section_constants(section: Section) -> SectionConstants:
    """Return the constants of a section whose legs, if it has any, point along its first and second axis.

    The angle is two rectangles, without the fillets of rolled steel: area and second moments are exact for
    that shape. Its torsion constant is that of thin walls, the sum of b t^3 / 3 over the two centre lines;
    the free warping of an angle about its corner makes no further resistance.

    Parameters
    ----------
    section : AngleSection or BarSection

    Returns
    -------
    SectionConstants
    """
    if isinstance(section, AngleSection):
        return _angle(section.leg, section.thickness)
    area = math.pi * section.diameter**2 / 4
    moment = area * section.diameter**2 / 16
    return SectionConstants(area=area, major=moment, minor=moment, torsion=2 * moment, tilt=0.0)


def _angle(a: float, t: float) -> SectionConstants:
    # Two rectangles, (width, height, y, z of the centre) from the corner: a whole leg, and what is left of
    # the other. Both second moments are the same, as the shape is its own mirror image.
    rectangles = ((a, t, a / 2, t / 2), (t, a - t, t / 2, (a + t) / 2))
    area = sum(b * h for b, h, _, _ in rectangles)
    centre = sum(b * h * y for b, h, y, _ in rectangles) / area
    moment = sum(b**3 * h / 12 + b * h * (y - centre) ** 2 for b, h, y, _ in rectangles)
    product = sum(b * h * (y - centre) * (z - centre) for b, h, y, z in rectangles)
    return SectionConstants(
        area=area,
        major=moment - product,  # the product is negative
        minor=moment + product,
        torsion=area * t**2 / 3,
        tilt=math.pi / 4,
    )
