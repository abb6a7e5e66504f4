"""The elastic base: posts and rails in closed form, mirrors, the mesh, the foot; given, framed or rigid."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from guardrails import guardrail, relative_difference
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from oracles.beams import angle_cantilever, angle_outline, polygon
from scipy import linalg, sparse

from cmbot.common.errors import InputError
from cmbot.elastic import ElasticBase, Guardrail, SharedFrame, elastic_base
from cmbot.elastic.base import guardrail_frame, motion_of_feet, shares
from cmbot.elastic.beam import section_constants
from cmbot.elastic.frame import Condensed, natural_frequencies
from cmbot.scene import load_scene

FloatArray = NDArray[np.float64]

BAR = {"bar": 0.03}


def condensed(rail: Guardrail, **options: Any) -> Condensed:
    drawn = guardrail_frame(rail, **options)
    return drawn.frame.condense(drawn.foot)


def stiffness(rail: Guardrail, **options: Any) -> FloatArray:
    return condensed(rail, **options).stiffness


def rail(name: str = "rail", **keys: Any) -> dict[str, Any]:
    return {"name": name, "section": BAR, "height_m": 0.0, "box_m": (0.06, 0.06), **keys}


guardrails = st.builds(
    lambda bays, spacing, roll, rail_roll, foot, offset, height: guardrail(
        bays=bays,
        post_spacing_m=spacing,
        post={"roll_deg": roll},
        rails=(
            rail(section={"angle": (0.063, 0.006)}, roll_deg=rail_roll),
            rail("low", height_m=height),
        ),
        foot={"post": 1 + foot % bays, "offset_m": offset * spacing},
    ),
    st.integers(1, 5),
    st.floats(0.5, 3),
    st.floats(-360, 360),
    st.floats(-360, 360),
    st.integers(0, 4),
    st.sampled_from([0.0, 0.25, 0.5]),
    st.floats(-1.0, -0.1),
)


@pytest.mark.parametrize("roll", [-90.0, 0.0, 30.0, 200.0])
def test_a_post_without_rails_is_a_cantilever(roll: float) -> None:
    """The roll as the scene file means it: the legs' outline, turned about z."""
    found = guardrail(rails=(), post={"roll_deg": roll, "top_m": 0.3})
    c, s = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    expected = angle_cantilever((0, 0, 1.05), 0.075, 0.008, [(c, s, 0), (-s, c, 0)])
    assert relative_difference(np.linalg.inv(stiffness(found)), expected) < 1e-8


@pytest.mark.parametrize("roll", [0.0, 180.0, 250.0])
def test_a_rail_between_rigid_posts_is_a_beam_clamped_at_both_ends(roll: float) -> None:
    """The roll of a rail: its legs' outline, turned about x; the foot at the middle of a single bay."""
    found = guardrail(
        bays=1,
        post_spacing_m=2.0,
        post={"section": {"bar": 3.0}, "clamp_m": -0.01, "bottom_m": -0.01},
        rails=(rail(section={"angle": (0.063, 0.006)}, roll_deg=roll),),
        foot={"post": 1, "offset_m": 1.0},
    )
    area, _, moments = polygon(angle_outline(0.063, 0.006))
    c, s = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    R = np.array([(c, -s), (s, c)])
    S = R @ moments @ R.T
    # Each half takes half the load; at its middle a beam clamped at both ends neither turns for a force
    # across it nor moves for a moment. A moment about y bends it in z: m x e turns the moments' axes.
    turn = np.array([(0.0, -1.0), (1.0, 0.0)])
    J = section_constants(found.rails[0].section).torsion
    expected = np.zeros((6, 6))
    expected[0, 0], expected[3, 3] = 2 * 206e9 * area, 2 * 79e9 * J
    expected[1:3, 1:3] = 2 * 12 * 206e9 * S
    expected[4:, 4:] = 2 * 4 * 206e9 * turn @ S @ turn.T
    assert relative_difference(stiffness(found), expected) < 1e-5  # posts of 3 m are not quite rigid


def test_the_part_of_a_post_below_its_clamp_is_rigid() -> None:
    deep = guardrail(post={"bottom_m": -3.0})
    np.testing.assert_array_equal(stiffness(deep), stiffness(guardrail()))
    assert stiffness(guardrail(post={"clamp_m": -0.95}))[0, 0] > 1.2 * stiffness(guardrail())[0, 0]


def test_the_mass_of_the_frame_is_that_of_its_members() -> None:
    found = guardrail()
    frame = guardrail_frame(found).frame
    post, top, bar, _ = (
        section_constants(section).area
        for section in (found.post.section, *(each.section for each in found.rails))
    )
    expected = 7850 * (5 * 1.1 * post + 7.0 * (top + 2 * bar))
    # A shift of everything that is free, and of the clamped ends' share in the lowest beams.
    shift = np.zeros(frame.mass.shape[0])
    shift[1::6] = 1.0
    lowest = 5 * 7850 * post * 0.25 / 2  # beams of 0.25 m or less
    assert expected - 2 * lowest < shift @ (frame.mass @ shift) < expected


OUTWARDS = np.diag([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
ALONG_THE_TRACK = np.diag([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0])


@given(guardrails)
def test_mirrors_and_half_a_turn_of_the_posts(found: Guardrail) -> None:
    K, roll = stiffness(found), found.post.roll
    # In the plane y = 0: legs at roll and roll + 90 deg are then at -roll and -roll - 90 deg.
    outwards = replace(
        found,
        post=replace(found.post, roll=-roll - math.pi / 2),
        rails=tuple(replace(each, roll=math.pi / 2 - each.roll) for each in found.rails),
    )
    assert relative_difference(stiffness(outwards), OUTWARDS @ K @ OUTWARDS) < 1e-8
    # In the plane x = 0: legs at roll and roll + 90 deg are then at 180 deg - roll and 90 deg - roll.
    along = replace(
        found,
        post_positions=tuple(-x for x in reversed(found.post_positions)),
        post=replace(found.post, roll=math.pi / 2 - roll),
    )
    assert relative_difference(stiffness(along), ALONG_THE_TRACK @ K @ ALONG_THE_TRACK) < 1e-8
    # Second moments do not know front from back, which is why a wrong sign of the roll can hide.
    half, quarter = (replace(found, post=replace(found.post, roll=roll + math.pi / n)) for n in (1, 2))
    assert relative_difference(stiffness(half), K) < 1e-9
    assert relative_difference(stiffness(quarter), K) > 1e-6


@given(guardrails, st.integers(1, 9))
@settings(max_examples=40)
def test_stiffness_and_mass_at_the_foot_do_not_depend_on_the_mesh(found: Guardrail, beams: int) -> None:
    coarse, fine = condensed(found), condensed(found, beams=beams)
    assert relative_difference(fine.stiffness, coarse.stiffness) < 1e-8
    assert relative_difference(fine.mass, coarse.mass) < 1e-7
    for matrix in (coarse.stiffness, coarse.mass):
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix)[0] > 0


def test_the_mesh_is_fine_enough() -> None:
    found = guardrail()
    exact = guardrail_frame(found, beams=40).frame.frequencies(6)
    errors = guardrail_frame(found).frame.frequencies(6) / exact - 1
    assert np.all(errors >= -1e-9)
    assert errors.max() < 1e-4
    assert (guardrail_frame(found, beams=4).frame.frequencies(6) / exact - 1).max() > 8 * errors.max()


def test_the_foot_belongs_at_a_post() -> None:
    """From the post to the middle of the rail the hold becomes softer, without a jump."""
    offsets = (0.0, 0.002, 0.02, 0.2, 0.8, 0.875)
    post, *others = (np.linalg.inv(stiffness(guardrail(foot={"offset_m": x}))) for x in offsets)
    about_x = np.array([C[3, 3] for C in (post, *others)])
    assert np.all(np.diff(about_x) > 0)
    assert about_x[1] < 1.5 * about_x[0]
    assert 1 / about_x[0] == pytest.approx(1.3e5, rel=0.03)  # Nm/rad about the guardrail
    assert about_x[-1] / about_x[0] == pytest.approx(85, rel=0.03)
    assert others[-1][2, 2] > 100 * post[2, 2]


@pytest.mark.parametrize("tiny", [1e-15, -3e-9, 9e-4])
def test_foot_within_a_millimetre_of_a_post_is_at_the_post(tiny: float) -> None:
    found = guardrail()
    moved = replace(found, post_positions=tuple(x - tiny for x in found.post_positions))
    assert relative_difference(stiffness(moved), stiffness(found)) < 2 * abs(tiny) + 1e-10


def test_rail_within_a_millimetre_of_the_foot_meets_it() -> None:
    rails = (rail(height_m=-0.0005), rail("low", height_m=-1.0499))
    found = guardrail(post={"top_m": 0.0004}, rails=rails)
    exact = guardrail(post={"top_m": 0.0}, rails=(rail(), rail("low", height_m=-1.04)))
    heights = guardrail_frame(found).frame.nodes[:, 2]
    assert set(np.round(heights, 12)) >= {0.0, -1.05}
    assert heights.max() == 0.0
    assert relative_difference(stiffness(found), stiffness(exact)) < 1e-2


def test_members_at_the_same_height_share_nodes() -> None:
    once, twice = guardrail(rails=(rail(),)), guardrail(rails=(rail(), rail("again")))
    assert len(guardrail_frame(once).frame.nodes) == len(guardrail_frame(twice).frame.nodes)
    assert np.linalg.eigvalsh(stiffness(twice) - stiffness(once))[0] > -1e-6


@given(guardrails, st.floats(0.2, 5))
def test_stiffness_scales_with_moduli_and_mass_with_density(found: Guardrail, factor: float) -> None:
    material, before = found.material, condensed(found)
    stiffer = replace(material, young=factor * material.young, shear=factor * material.shear)
    assert relative_difference(stiffness(replace(found, material=stiffer)), factor * before.stiffness) < 1e-9
    after = condensed(replace(found, material=replace(material, density=factor * material.density)))
    np.testing.assert_array_equal(after.stiffness, before.stiffness)
    assert relative_difference(after.mass, factor * before.mass) < 1e-12


def test_six_coordinates_keep_the_first_modes_of_a_robot_on_the_guardrail() -> None:
    """A rigid robot of 68 kg, its centre of mass 0.5 m out and 0.6 m below the foot."""
    drawn = guardrail_frame(guardrail())
    seen = drawn.frame.condense(drawn.foot)
    m, c = 68.0, np.array([0.0, 0.5, -0.6])
    cross = np.cross(np.eye(3), c)  # rows e_i x c: what a turn about e_i moves c by
    robot = np.block([[m * np.eye(3), m * cross.T], [m * cross, m * cross @ cross.T + 8.0 * np.eye(3)]])
    six = np.sqrt(linalg.eigh(seen.stiffness, seen.mass + robot, eigvals_only=True)) / (2 * np.pi)
    where = drawn.frame.coordinates(drawn.foot)
    rows, columns = np.repeat(where, 6), np.tile(where, 6)
    whole = sparse.coo_array((robot.ravel(), (rows, columns)), shape=drawn.frame.mass.shape)
    full = natural_frequencies(drawn.frame.stiffness, sparse.csc_array(drawn.frame.mass + whole), 3)
    assert np.all(six[:3] >= full * (1 - 1e-9))  # Guyan's frequencies are never too low
    np.testing.assert_allclose(six[:2], full[:2], rtol=0.005)
    np.testing.assert_allclose(six[2], full[2], rtol=0.05)


def refused(key: str, found: Guardrail, **changes: Any) -> str:
    guardrail_frame(found)
    with pytest.raises(InputError) as caught:
        guardrail_frame(replace(found, **changes))
    assert (caught.value.source, caught.value.key) == ("guardrail", key)
    return str(caught.value)


@pytest.mark.parametrize(
    "posts", [(), (0.0, 0.0), (0.0, 1e-4), (1.0, 0.0), (0.5, 1.0), (-1.0, -0.5), (0.0, math.nan)]
)
def test_posts_follow_each_other_and_pass_the_foot(posts: tuple[float, ...]) -> None:
    refused("post_positions", guardrail(), post_positions=posts)


@pytest.mark.parametrize("height", [-1.2, 0.06, math.nan])
def test_rails_meet_the_posts(height: float) -> None:
    found = guardrail()
    rails = (found.rails[0], replace(found.rails[1], height=height))
    assert "expected a height from -1.05 to 0.05" in refused("rails[1].height", found, rails=rails)


@pytest.mark.parametrize(("clamp", "top"), [(-1.05, -0.1), (0.0, 0.5), (-0.0005, 0.5)])
def test_the_held_post_passes_the_foot(clamp: float, top: float) -> None:
    found = guardrail(rails=())
    refused("post", found, post=replace(found.post, clamp=clamp, top=top))


def test_between_posts_the_foot_holds_a_rail() -> None:
    found = guardrail(foot={"offset_m": 0.5})
    refused("rails", found, rails=found.rails[1:])
    refused("rails", found, rails=())


@pytest.mark.parametrize("lever", [0.35, 1.75])
def test_two_alike_feet_share_alike(lever: float) -> None:
    """Two posts without rails: each bears half of a force in the middle, and what rigid bars would."""
    posts = (-lever, lever)
    feet = tuple((x, 0.0, 0.0) for x in posts)
    found = replace(guardrail(rails=()), post_positions=posts, footholds=feet)
    first, second = shares(found)
    np.testing.assert_allclose(first + second, np.eye(6), atol=1e-9)
    np.testing.assert_allclose(np.diag(first[:3, :3]), 0.5, atol=1e-9)
    # Far apart they bear a moment about y as a couple of vertical forces; a post is stiff along itself.
    couple = first[2, 4] * -lever * -2
    assert 0.9 < couple < 1.0 + 1e-9


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_legs_give_way_between_feet_and_the_arm(rng: np.random.Generator, factor: float) -> None:
    """Two feet, with unknowns of their own: feet, turns of two joints each, and what joins both sides."""
    feet = ((-0.3, 0.0, 0.0), (0.35, 0.0, 0.0))
    found = replace(guardrail(stiffness_factor=factor), footholds=feet)
    joints = [rng.normal(size=(6, 2)) for _ in feet]  # motions about O0 by a turn of each joint
    k = rng.uniform(1e4, 1e5, (2, 2))
    legs = np.array([T @ np.diag(1 / each) @ T.T for T, each in zip(joints, k, strict=True)])
    held = replace(found, leg_compliance=legs)
    made = guardrail_frame(found)
    K, M = made.frame.condense(*made.feet)
    G = [np.eye(6), np.eye(6)]
    for part, (x, y, z) in zip(G, feet, strict=True):
        part[:3, 3:] = np.cross([x, y, z], np.eye(3))
    # Least energy of feet d (12) and turns (4), with d_i + G_i T_i turn_i = G_i x for motions x of the arm.
    H = linalg.block_diag(factor * K, np.diag(k.ravel()))
    A = np.hstack([np.eye(12), linalg.block_diag(*(part @ T for part, T in zip(G, joints, strict=True)))])
    kkt = np.block([[H, A.T], [A, np.zeros((12, 12))]])
    right = np.vstack([np.zeros((16, 6)), np.vstack(G)])
    answer = np.linalg.solve(kkt, right)
    d, borne = answer[:12], -answer[16:]
    base = elastic_base(held)
    np.testing.assert_allclose(base.stiffness, np.vstack(G).T @ borne, rtol=1e-6, atol=1e-6 * K.max())
    np.testing.assert_allclose(motion_of_feet(held), d, atol=1e-6)
    np.testing.assert_allclose(base.mass, d.T @ M @ d, atol=1e-6)
    per_wrench = borne @ np.linalg.inv(np.vstack(G).T @ borne)
    for k, share in enumerate(shares(held)):
        np.testing.assert_allclose(share, G[k].T @ per_wrench[6 * k : 6 * k + 6], atol=1e-6)
    with_frame = SharedFrame(found, np.array(feet))
    np.testing.assert_allclose(
        with_frame.stiffness([0, 1], np.zeros(3), legs), base.stiffness, rtol=1e-6, atol=1
    )
    np.testing.assert_allclose(with_frame.shares([0, 1], np.zeros(3), legs), shares(held), atol=1e-6)


def test_a_given_stiffness_and_legs_are_springs_in_a_row() -> None:
    K, M, C = positive_definite(1), positive_definite(2), positive_definite(3)
    base = elastic_base(replace(guardrail(stiffness=rows(K), mass=rows(M)), leg_compliance=C[None]))
    np.testing.assert_allclose(np.linalg.inv(base.stiffness), np.linalg.inv(K) + C, rtol=1e-9)
    moved = np.linalg.inv(K) @ base.stiffness
    np.testing.assert_allclose(base.mass, moved.T @ M @ moved, rtol=1e-9, atol=1e-12)
    alone = elastic_base(replace(guardrail(bays=0), leg_compliance=C[None]))
    np.testing.assert_allclose(alone.stiffness, np.linalg.inv(C), rtol=1e-6)


def test_a_foot_on_next_to_nothing_bears_nothing() -> None:
    thread = rail("thread", section={"bar": 1e-4}, height_m=-0.5)
    feet = ((0.0, 0.0, 0.0), (0.5, 0.0, -0.5))
    first, second = shares(replace(guardrail(rails=(thread,)), footholds=feet))
    np.testing.assert_allclose(first, np.eye(6), atol=1e-2)
    np.testing.assert_allclose(second, np.zeros((6, 6)), atol=1e-2)


def positive_definite(seed: int) -> FloatArray:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return root @ root.T + np.eye(6)


def rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


def assert_read_only(base: ElasticBase) -> None:
    assert not any(array.flags.writeable for array in (base.stiffness, base.mass, base.frequencies))


@pytest.mark.parametrize("bays", [0, 4])
@pytest.mark.parametrize("mass", [None, positive_definite(2)])
def test_a_given_stiffness_is_taken_as_it_is(bays: int, mass: FloatArray | None) -> None:
    K = positive_definite(1)
    given_mass = {} if mass is None else {"mass": rows(mass)}
    found = guardrail(bays=bays, stiffness=rows(K), **given_mass)
    base = elastic_base(found)
    np.testing.assert_array_equal(base.stiffness, K)
    np.testing.assert_array_equal(base.mass, np.zeros((6, 6)) if mass is None else mass)
    assert base.frequencies.shape == (0,)
    assert base.stiffness is not found.stiffness
    assert_read_only(base)
    # It is symmetric to the last digit.
    K[0, 1] *= 1 + 1e-12
    base = elastic_base(guardrail(stiffness=rows(K)))
    np.testing.assert_array_equal(base.stiffness, base.stiffness.T)
    np.testing.assert_allclose(base.stiffness, K, rtol=1e-12)


def test_the_shipped_scenes_hold_the_default_guardrail() -> None:
    expected, base = condensed(guardrail()), elastic_base(load_scene("triangle").elastic_guardrail)
    np.testing.assert_array_equal(base.stiffness, expected.stiffness)
    np.testing.assert_array_equal(base.mass, expected.mass)
    assert base.frequencies.shape == (6,)
    assert np.all(np.diff(base.frequencies) > 0)
    assert_read_only(base)
    # Six coordinates are never slower than the whole frame; the same guardrail gives the same base.
    six = np.sqrt(linalg.eigh(base.stiffness, base.mass, eigvals_only=True)) / (2 * np.pi)
    assert np.all(six >= base.frequencies)
    np.testing.assert_array_equal(elastic_base(guardrail()).frequencies, base.frequencies)


def test_equal_guardrails_have_one_base() -> None:
    K, M = rows(positive_definite(1)), rows(positive_definite(2))
    blocks = ({}, {"stiffness_factor": 1.5}, {"stiffness": K}, {"stiffness": K, "mass": M})
    for block in blocks:
        assert guardrail(**block) == guardrail(**block)
        assert elastic_base(guardrail(**block)) is elastic_base(guardrail(**block))
    assert len({guardrail(**block) for block in blocks}) == len(blocks)
    assert guardrail() != "a guardrail"


def powers(least: float, most: float = 3.0) -> st.SearchStrategy[float]:
    return st.floats(least, most).map(lambda power: 10.0**power)


# Scenes refuse what looks like millimetres or N/mm2, and walls below 1e-5 m.
thick = powers(-4, 0.6)
sections = st.one_of(
    st.builds(lambda d: {"bar": d}, thick),
    st.builds(lambda a, share: {"angle": (a, max(a * 10.0**share, 1e-5))}, thick, st.floats(-6, -0.1)),
)


@given(
    st.lists(sections, min_size=2, max_size=4),
    *(powers(-5, 1.6), powers(-5), powers(-3), powers(-3)),
    st.floats(0.01, 1),
)
@settings(max_examples=60)
def test_any_guardrail_gives_a_valid_base_or_an_error(
    members: list[dict[str, float]], spacing: float, depth: float, young: float, shear: float, share: float
) -> None:
    rails = tuple(
        {"name": f"rail_{k}", "section": section, "height_m": (share**k - 1) * depth, "box_m": (0.1, 0.1)}
        for k, section in enumerate(members[1:])
    )
    found = guardrail(
        bays=2,
        post_spacing_m=spacing,
        post={"section": members[0], "bottom_m": -depth, "clamp_m": -depth, "top_m": 0.0},
        rails=rails,
        material={"young_pa": 1e9 * young, "shear_pa": 1e9 * shear},
    )
    try:
        base = elastic_base(found)
        frequencies = base.frequencies
    except InputError:
        return
    for matrix in (base.stiffness, base.mass):
        scale = 1 / np.sqrt(np.diag(matrix))
        assert np.linalg.eigvalsh(matrix * scale * scale[:, None])[0] > -1e-9
    assert np.all(frequencies > 0)


def test_guardrails_without_mass_and_without_posts() -> None:
    base = elastic_base(guardrail(material={"density_kg_m3": 0.0}))
    np.testing.assert_array_equal(base.mass, np.zeros((6, 6)))
    assert base.frequencies.shape == (0,)
    assert elastic_base(guardrail(bays=0)) is None  # rigid
