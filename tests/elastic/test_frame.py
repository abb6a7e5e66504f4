"""The frame against closed forms, and what must hold for any frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from guardrails import relative_difference
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from oracles.beams import angle_cantilever, cantilever
from scipy import linalg, sparse
from scipy.spatial.transform import Rotation

from cmbot.common.errors import InputError
from cmbot.elastic import AngleSection, GuardrailMaterial
from cmbot.elastic.beam import SectionConstants, section_constants
from cmbot.elastic.frame import Frame, Member, natural_frequencies

FloatArray = NDArray[np.float64]

STEEL = {"young": 206e9, "shear": 79e9, "density": 7850.0}
ANGLE = section_constants(AngleSection(leg=0.075, thickness=0.008))
# Three different stiffnesses in three directions.
PLATE = SectionConstants(area=3e-3, major=4e-6, minor=1e-6, torsion=2e-7, tilt=0.3)


def member(
    start: int,
    end: int,
    section: SectionConstants = PLATE,
    first_axis: tuple[float, float, float] = (0.0, 1.0, 0.0),
    **changes: float,
) -> Member:
    material = GuardrailMaterial(**{**STEEL, **changes})
    return Member(start=start, end=end, section=section, first_axis=first_axis, material=material)


def chain(points: Sequence[Sequence[float]], section: SectionConstants = PLATE, **changes: Any) -> Frame:
    """A line of members from point to point, clamped at the first."""
    members = tuple(member(k, k + 1, section, **changes) for k in range(len(points) - 1))
    return Frame(nodes=np.array(points, dtype=float), members=members, fixed=(0,))


def straight(length: float, count: int, section: SectionConstants = PLATE, **changes: Any) -> Frame:
    return chain([(x, 0, 0) for x in np.linspace(0, length, count + 1)], section, **changes)


def compliance(frame: Frame, node: int) -> FloatArray:
    return np.asarray(np.linalg.inv(frame.condense(node).stiffness))


def test_tip_of_a_cantilever_under_each_of_six_loads() -> None:
    L, E, G = 1.7, 206e9, 79e9
    section = replace(PLATE, tilt=0.0)  # the major axis along y
    moments = np.diag([0.0, section.minor, section.major])
    constants = {"young": E, "axial": E * section.area, "torsional": G * section.torsion}
    expected = cantilever(along=(L, 0, 0), moments=moments, **constants)
    assert relative_difference(compliance(straight(L, 1, section), 1), expected) < 1e-12


directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda p: math.hypot(*p) > 0.1)


@given(directions, st.floats(0.3, 3.0), st.floats(-7, 7), st.floats(0.02, 0.2), st.floats(0.05, 0.5))
def test_rolled_angle_in_space_against_its_own_polygon(
    direction: tuple[float, float, float], length: float, roll: float, leg: float, share: float
) -> None:
    """The sign of the roll: from the outline of the legs where they are, without principal axes."""
    e = np.array(direction) / math.hypot(*direction)
    y = np.linalg.svd(e[None])[2][1]
    z = np.cross(e, y)
    first, second = math.cos(roll) * y + math.sin(roll) * z, math.cos(roll) * z - math.sin(roll) * y
    section = section_constants(AngleSection(leg=leg, thickness=share * leg))
    frame = chain([(0, 0, 0), tuple(length * e)], section, first_axis=tuple(first))
    expected = angle_cantilever(length * e, leg, share * leg, [first, second])
    assert relative_difference(compliance(frame, 1), expected) < 1e-7


def test_first_axis_component_along_the_member_is_ignored() -> None:
    plain = straight(1.0, 1).condense(1).stiffness
    slanted = straight(1.0, 1, first_axis=(3.0, 2.0, 0.0)).condense(1).stiffness
    assert relative_difference(slanted, plain) < 1e-12


def test_a_lateral_force_bends_an_angle_sideways_too() -> None:
    """Unsymmetric bending: the cross term of an angle whose legs point along y and z."""
    C = compliance(straight(1.0, 1, ANGLE), 1)
    # A push along y on legs at +y and +z: the stiff direction is across the axis of symmetry.
    assert C[2, 1] == pytest.approx((1 / ANGLE.minor - 1 / ANGLE.major) / (6 * 206e9))
    assert C[2, 1] > 0.5 * C[1, 1]


def test_middle_of_a_beam_clamped_at_both_ends() -> None:
    L, E, G = 2.4, 206e9, 79e9
    section = replace(PLATE, tilt=0.0)
    frame = replace(straight(L, 8, section), fixed=(0, 8))
    bending = np.array([section.minor, section.major])
    linear = [4 * E * section.area / L, *(192 * E * bending / L**3)]
    angular = [4 * G * section.torsion / L, *(16 * E * bending[::-1] / L)]
    expected = np.diag([*linear, *angular])
    assert relative_difference(frame.condense(4).stiffness, expected) < 1e-11


@pytest.mark.parametrize("ratio", [0.01, 0.5, 1.0, 30.0])
def test_sway_of_a_portal_frame(ratio: float) -> None:
    """Two clamped columns and a beam, pushed along the beam; none of them stretches.

    Slope-deflection with k = (I_b / w) / (I_c / h): delta = F h^3 (2 + 3 k) / (12 E I_c (1 + 6 k)).
    """
    h, w, E, F = 2.0, 3.0, 206e9, 1.0
    column = SectionConstants(area=1e3, major=1e-6, minor=1e-6, torsion=1e-6, tilt=0.0)
    beam = replace(column, major=ratio * 1e-6, minor=ratio * 1e-6)
    frame = Frame(
        nodes=np.array([(0, 0, 0), (0, 0, h), (w, 0, h), (w, 0, 0)]),
        members=(member(0, 1, column), member(1, 2, beam), member(2, 3, column)),
        fixed=(0, 3),
    )
    k = ratio * h / w
    expected = F * h**3 * (2 + 3 * k) / (12 * E * 1e-6 * (1 + 6 * k))
    assert compliance(frame, 1)[0, 0] == pytest.approx(expected, rel=1e-6)


# Properties of any frame.

rotations = st.integers(0, 10**6).map(lambda seed: Rotation.random(rng=np.random.default_rng(seed)))


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """A tree of members in space with some more between, clamped at one to three nodes, not at the last."""
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    count = draw(st.integers(3, 7))
    grid = np.array(np.meshgrid(*[range(3)] * 3)).reshape(3, -1).T
    nodes = rng.permutation(grid)[:count] + rng.uniform(-0.2, 0.2, (count, 3))
    pairs = {(int(rng.integers(k)), k) for k in range(1, count)}
    pairs |= {tuple(sorted(rng.choice(count, 2, replace=False).tolist())) for _ in range(count)}
    members = tuple(
        member(a, b, section, first_axis=tuple(rng.normal(size=3)))
        for a, b in sorted(pairs)
        for section in [replace(PLATE, tilt=rng.uniform(-4, 4))]
    )
    fixed = tuple(range(draw(st.integers(1, min(3, count - 1)))))
    return Frame(nodes=nodes, members=members, fixed=fixed)


@given(frames())
def test_stiffness_and_mass_are_symmetric_and_positive_definite(frame: Frame) -> None:
    condensed = frame.condense(len(frame.nodes) - 1)
    for whole, seen in ((frame.stiffness, condensed.stiffness), (frame.mass, condensed.mass)):
        dense = whole.toarray()
        assert np.abs(dense - dense.T).max() <= 1e-12 * np.abs(dense).max()
        assert np.linalg.eigvalsh(dense)[0] > 0
        np.testing.assert_array_equal(seen, seen.T)
        assert np.linalg.eigvalsh(seen)[0] > 0


@given(frames())
def test_condensed_stiffness_and_mass_are_schur_complement_and_guyan(frame: Frame) -> None:
    """By the textbook's block matrices instead of by unit loads."""
    node = len(frame.nodes) - 1
    K, M = frame.stiffness.toarray(), frame.mass.toarray()
    kept = frame.coordinates(node)
    others = np.setdiff1d(np.arange(len(K)), kept)
    condensed = frame.condense(node)
    T = np.zeros((len(K), 6))
    T[kept] = np.eye(6)
    if len(others):
        T[others] = -np.linalg.solve(K[np.ix_(others, others)], K[np.ix_(others, kept)])
    assert relative_difference(condensed.stiffness, T.T @ K @ T) < 1e-8
    assert relative_difference(condensed.mass, T.T @ M @ T) < 1e-8


@given(frames(), rotations, st.sampled_from([1.0, -1.0]))
def test_a_frame_turned_or_mirrored_in_space_has_the_stiffness_turned_or_mirrored(
    frame: Frame, rotation: Rotation, side: float
) -> None:
    """A mirrored section turns the other way round, so its tilt changes sign."""
    R = rotation.as_matrix() @ np.diag([1.0, side, 1.0])
    members = tuple(
        replace(m, first_axis=tuple(R @ m.first_axis), section=replace(m.section, tilt=side * m.section.tilt))
        for m in frame.members
    )
    other = Frame(nodes=frame.nodes @ R.T + [1.0, -2.0, 3.0], members=members, fixed=frame.fixed)
    node = len(frame.nodes) - 1
    before, after = frame.condense(node), other.condense(node)
    T = linalg.block_diag(R, side * R)  # rotations are pseudo-vectors
    assert relative_difference(after.stiffness, T @ before.stiffness @ T.T) < 1e-8
    assert relative_difference(after.mass, T @ before.mass @ T.T) < 1e-8
    np.testing.assert_allclose(other.frequencies(4), frame.frequencies(4), rtol=1e-8)


@given(frames(), st.integers(2, 5))
def test_subdivision_changes_no_static_stiffness(frame: Frame, count: int) -> None:
    nodes = list(frame.nodes)
    members = []
    for m in frame.members:
        inner = range(len(nodes), len(nodes) + count - 1)
        nodes += list(np.linspace(frame.nodes[m.start], frame.nodes[m.end], count + 1)[1:-1])
        ends = [m.start, *inner, m.end]
        members += [replace(m, start=a, end=b) for a, b in pairwise(ends)]
    fine = Frame(nodes=np.array(nodes), members=tuple(members), fixed=frame.fixed)
    node = len(frame.nodes) - 1
    coarse, finer = frame.condense(node), fine.condense(node)
    assert relative_difference(finer.stiffness, coarse.stiffness) < 1e-8
    # Loads at the node bend beams into cubics, whose mass both meshes integrate exactly.
    assert relative_difference(finer.mass, coarse.mass) < 1e-8
    low, high = fine.frequencies(3), frame.frequencies(3)
    assert np.all(low <= high[: len(low)] * (1 + 1e-9))  # Rayleigh: more shapes, lower frequencies


@given(frames(), st.floats(0.1, 10))
def test_a_member_more_makes_no_direction_softer(frame: Frame, factor: float) -> None:
    node = len(frame.nodes) - 1
    added = member(0, node, replace(PLATE, area=factor * 1e-3), first_axis=(0.3, 1, 0.2))
    more = replace(frame, members=(*frame.members, added))
    before, after = frame.condense(node).stiffness, more.condense(node).stiffness
    scale = np.sqrt(np.diag(after))
    assert np.linalg.eigvalsh((after - before) / scale / scale[:, None])[0] > -1e-9


# The first roots of cos x cosh x = -1: clamped at one end, free at the other.
BENDING_ROOTS = (1.8751040687, 4.6940911330, 7.8547574382)


def test_frequencies_of_a_cantilever() -> None:
    L, E, G, rho = 1.7, 206e9, 79e9, 7850.0
    slim = SectionConstants(area=4e-4, major=2e-8, minor=1e-8, torsion=1e-9, tilt=0.0)
    moments = np.array([slim.major, slim.minor])
    bending = (
        np.square(BENDING_ROOTS)[:, None] / (2 * np.pi * L**2) * np.sqrt(E * moments / (rho * slim.area))
    )
    twisting = np.array([1, 3]) / (4 * L) * math.sqrt(G * slim.torsion / (rho * moments.sum()))
    stretching = 1 / (4 * L) * math.sqrt(E / rho)
    got = straight(L, 40, slim).frequencies(30)
    for value in (*bending.ravel(), *twisting, stretching):
        nearest = got[np.abs(got - value).argmin()]
        # A consistent mass errs upwards: of rods by (pi/2 / 40)^2 odd^2 / 24, of beams less.
        assert -1e-9 < nearest / value - 1 < 7e-4, value


def test_rod_frequencies_converge_with_the_square_of_the_mesh() -> None:
    L = 1.0
    exact = math.sqrt(206e9 / 7850.0) / (4 * L)
    stout = SectionConstants(area=1e-4, major=1.0, minor=1.0, torsion=10.0, tilt=0.0)  # bends at far more
    errors = [straight(L, count, stout).frequencies(1)[0] / exact - 1 for count in (4, 8, 16)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.02)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.02)


def test_large_and_small_frames_are_solved_alike() -> None:
    """Above a size the modes come from Lanczos iterations, below it from all of them."""
    frame = straight(1.0, 12)
    K, M = frame.stiffness, frame.mass
    dense = np.sqrt(linalg.eigh(K.toarray(), M.toarray(), eigvals_only=True)) / (2 * np.pi)
    np.testing.assert_allclose(frame.frequencies(5), dense[:5], rtol=1e-9)
    np.testing.assert_allclose(natural_frequencies(K, M, 5), dense[:5], rtol=1e-9)
    np.testing.assert_allclose(natural_frequencies(K, M, 30), dense[:30], rtol=1e-8)
    np.testing.assert_array_equal(frame.frequencies(5), straight(1.0, 12).frequencies(5))


def test_frequencies_of_what_has_little_or_no_mass() -> None:
    massless = straight(1.0, 2, density=0.0)
    assert massless.frequencies(3).shape == (0,)
    np.testing.assert_array_equal(massless.condense(2).mass, np.zeros((6, 6)))
    K = massless.stiffness
    M = sparse.csc_array(sparse.diags_array([0.0] * 6 + [2.0] * 3 + [0.0] * 3))
    expected = np.sqrt(np.linalg.eigvalsh(np.linalg.inv(compliance(massless, 2)[:3, :3])) / 2) / (2 * np.pi)
    np.testing.assert_allclose(natural_frequencies(K, M, 5), expected, rtol=1e-9)
    assert straight(1.0, 1).frequencies(0).shape == (0,)
    assert straight(1.0, 1).frequencies(100).shape == (6,)


LINE = np.array([(0.0, 0, 0), (1, 0, 0), (2, 0, 0)])
SECOND = member(1, 2)


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        ("nodes", {"nodes": np.zeros(3)}),
        ("nodes", {"nodes": np.zeros((3, 2))}),
        ("nodes", {"nodes": np.array([(0, 0, 0), (1, 0, 0), (np.nan, 0, 0)])}),
        ("fixed[0]", {"fixed": (-1,)}),
        ("fixed[0]", {"fixed": (3,)}),
        ("members[1]", {"members": (member(0, 1), member(1, -1))}),
        ("members[1]", {"members": (member(0, 1), member(1, 3))}),
        # A first axis along the member says nothing.
        ("members[0].first_axis", {"members": (member(0, 1, first_axis=(1.0, 0, 0)), SECOND)}),
        ("members[0].first_axis", {"members": (member(0, 1, first_axis=(0.0, 0, 0)), SECOND)}),
        ("members[0].first_axis", {"members": (member(0, 1, first_axis=(-2.0, 1e-9, 0)), SECOND)}),
        ("members[0].first_axis", {"members": (member(0, 1, first_axis=(np.nan, 1, 0)), SECOND)}),
        # A member has a length, and positive constants.
        ("members[1]", {"members": (member(0, 1), member(1, 1))}),
        ("members[1]", {"nodes": LINE[[0, 1, 1]]}),
        ("members[0]", {"members": (member(0, 1, young=0.0), SECOND)}),
        ("members[0]", {"members": (member(0, 1, shear=-1.0), SECOND)}),
        ("members[0]", {"members": (member(0, 1, density=-1.0), SECOND)}),
        ("members[0]", {"members": (member(0, 1, density=np.inf), SECOND)}),
        ("members[0]", {"members": (member(0, 1, young=np.nan), SECOND)}),
        ("members[0]", {"members": (member(0, 1, replace(PLATE, minor=0.0)), SECOND)}),
        ("members[0]", {"members": (member(0, 1, replace(PLATE, torsion=0.0)), SECOND)}),
        # Every part is held.
        ("fixed", {"fixed": ()}),
        ("fixed", {"members": (member(0, 1),)}),
        ("fixed", {"members": ()}),
    ],
)
def test_a_frame_that_is_none_is_refused(key: str, changes: dict[str, Any]) -> None:
    values: dict[str, Any] = {"nodes": LINE, "members": (member(0, 1), SECOND), "fixed": (0,)}
    Frame(**values)
    with pytest.raises(InputError, match="Frame") as caught:
        Frame(**(values | changes))
    assert caught.value.key == key


@pytest.mark.parametrize("node", [-1, 0, 3])
def test_only_a_free_node_can_be_loaded(node: int) -> None:
    with pytest.raises(InputError, match=f"node: got {node}, expected one of the 3 nodes that is not fixed"):
        straight(1.0, 2).condense(node)


def test_a_stiffness_that_vanishes_in_floating_point() -> None:
    weak = SectionConstants(area=1e-300, major=1e-300, minor=1e-300, torsion=1e-300, tilt=0.0)
    frame = straight(3.0, 3, weak, young=1e-200, shear=1e-200)
    with pytest.raises(InputError, match="comparable stiffness"):
        frame.condense(3)


@pytest.mark.parametrize("factor", [1e13, 1e20, 1e40])
def test_stiffnesses_of_too_different_magnitude(factor: float) -> None:
    """A soft beam below a row of hard ones, whose digits swallow its own."""
    hard = replace(PLATE, area=factor, major=factor, minor=factor, torsion=factor)
    frame = chain([(x, 0.3 * x, 0.1 * x) for x in range(7)], hard)
    frame = replace(frame, members=(member(0, 1), *frame.members[1:]))
    with pytest.raises(InputError, match="members: got stiffnesses or masses that floating-point numbers"):
        frame.condense(6)


@pytest.mark.parametrize("size", [8, 200])
def test_frequencies_need_a_positive_definite_stiffness(size: int) -> None:
    squares = np.arange(1.0, size + 1)
    K, M = sparse.csc_array(sparse.diags_array(squares)), sparse.csc_array(sparse.eye_array(size))
    np.testing.assert_allclose(2 * np.pi * natural_frequencies(K, M, 3), np.sqrt(squares[:3]))
    squares[4] = -0.5
    with pytest.raises(InputError, match="comparable stiffness"):
        natural_frequencies(sparse.csc_array(sparse.diags_array(squares)), M, 3)


def test_masses_that_vanish_beside_the_stiffness() -> None:
    K = sparse.csc_array(sparse.diags_array(np.linspace(1e8, 2e8, 400)))
    with pytest.raises(InputError, match="floating-point numbers cannot hold side by side"):
        natural_frequencies(K, sparse.csc_array(1e-300 * sparse.eye_array(400)), 3)
