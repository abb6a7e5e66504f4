"""Section constants against the polygon of the same shape, sums over a fine grid and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from oracles.beams import angle_outline, polygon

from cmbot.elastic import AngleSection, BarSection, FlatSection
from cmbot.elastic.beam import section_constants, yield_moments

legs = st.floats(0.01, 0.5)
shares = st.floats(0.001, 0.999)


@given(legs, shares)
def test_angle_is_its_polygon(leg: float, share: float) -> None:
    t = share * leg
    constants = section_constants(AngleSection(leg=leg, thickness=t))
    area, _, moments = polygon(angle_outline(leg, t))
    assert constants.area == pytest.approx(area, rel=1e-9)
    # ∫ r r^T dA has the moment about an axis across it: the smaller one lies along the axis of `major`.
    values = np.linalg.eigvalsh(moments)
    assert constants.major == pytest.approx(values[1], rel=1e-9)
    assert constants.minor == pytest.approx(values[0], rel=1e-7)
    axis = np.array([math.cos(constants.tilt), math.sin(constants.tilt)])
    assert axis @ moments @ axis == pytest.approx(constants.minor, rel=1e-7)
    across = np.array([-axis[1], axis[0]])
    assert across @ moments @ across == pytest.approx(constants.major, rel=1e-9)
    # Torsion is that of two thin walls.
    assert constants.torsion == pytest.approx(2 * (leg - t / 2) * t**3 / 3, rel=1e-9)


def test_angle_is_the_sum_over_a_fine_grid() -> None:
    """The polygon above could share a mistake of thought; small squares share none."""
    leg, thickness, cells = 0.075, 0.008, 3000  # cells end at the thickness: 320 of them
    h = leg / cells
    y = (np.arange(cells) + 0.5) * h
    inside = (y[:, None] < thickness) | (y < thickness)
    area = inside.sum() * h**2
    centre = (inside.sum(axis=1) @ y) * h**2 / area
    moment = (inside.sum(axis=1) @ (y - centre) ** 2) * h**2 + area * h**2 / 12
    product = ((y - centre) @ inside @ (y - centre)) * h**2
    constants = section_constants(AngleSection(leg=leg, thickness=thickness))
    assert constants.area == pytest.approx(area, rel=1e-9)
    assert constants.major == pytest.approx(moment - product, rel=1e-9)
    assert constants.minor == pytest.approx(moment + product, rel=1e-9)


def test_thin_angle_against_the_line_integral() -> None:
    """As the walls vanish: two lines of length a, their middles a / 2 from the corner."""
    a, t = 0.1, 1e-7
    constants = section_constants(AngleSection(leg=a, thickness=t))
    assert constants.major == pytest.approx(t * a**3 / 3, rel=1e-5)
    assert constants.minor == pytest.approx(t * a**3 / 12, rel=1e-5)


@given(legs, shares)
def test_flat_bar_is_its_rectangle(width: float, share: float) -> None:
    t = share * width
    constants = section_constants(FlatSection(width=width, thickness=t))
    area, _, moments = polygon(np.array([(0, 0), (width, 0), (width, t), (0, t)]))
    assert constants.area == pytest.approx(area)
    assert constants.major == pytest.approx(moments[0, 0], rel=1e-7)
    assert constants.minor == pytest.approx(moments[1, 1], rel=1e-7, abs=1e-20)
    axis = np.array([math.cos(constants.tilt), math.sin(constants.tilt)])
    assert axis @ moments @ axis == pytest.approx(constants.minor, rel=1e-7, abs=1e-20)
    # Of the outer fibres y is along that axis.
    corners = np.array(constants.outline.corners)
    np.testing.assert_allclose(np.ptp(corners, axis=0), [t, width])


@pytest.mark.parametrize(
    ("ratio", "share"), [(1.0001, 0.1406), (1.5, 0.1958), (2, 0.2287), (4, 0.2808), (10, 0.3123)]
)
def test_torsion_of_a_flat_bar_is_that_of_the_textbook(ratio: float, share: float) -> None:
    """Timoshenko and Goodier, Theory of Elasticity, table of rectangular bars: J = k b t^3."""
    constants = section_constants(FlatSection(width=0.01 * ratio, thickness=0.01))
    assert constants.torsion == pytest.approx(share * ratio * 1e-8, rel=1e-3)


@given(st.floats(0.001, 1.0))
def test_bar(diameter: float) -> None:
    constants = section_constants(BarSection(diameter=diameter))
    radius = diameter / 2
    assert constants.area == pytest.approx(math.pi * radius**2)
    assert constants.major == constants.minor == pytest.approx(math.pi * radius**4 / 4)
    assert constants.torsion == pytest.approx(math.pi * radius**4 / 2)


def test_moments_at_yield_are_sums_of_stress_over_a_fine_grid() -> None:
    """Stress in proportion to the distance from the axis, with the yield stress at the outer fibre."""
    stress, n = 235e6, 2000
    d = 0.02
    y, z = np.meshgrid(*[(np.arange(n) + 0.5) / n * d - d / 2] * 2)
    r, cell = np.hypot(y, z), (d / n) ** 2
    inside = r < d / 2
    bending = cell * (stress * z**2 / (d / 2))[inside].sum()
    torsion = cell * (stress / math.sqrt(3) * r**2 / (d / 2))[inside].sum()
    assert yield_moments(BarSection(diameter=d), stress) == pytest.approx((torsion, bending), rel=1e-3)
    # Of an angle about its axis of symmetry: the outer fibres are the ends of the legs.
    leg, t = 0.075, 0.008
    y, z = np.meshgrid(*[(np.arange(n) + 0.5) / n * leg] * 2)
    steel, away = (y < t) | (z < t), (y - z) / math.sqrt(2)
    bending = (leg / n) ** 2 * (stress * away**2 / (leg / math.sqrt(2)))[steel].sum()
    assert yield_moments(AngleSection(leg=leg, thickness=t), stress)[1] == pytest.approx(bending, rel=2e-3)
