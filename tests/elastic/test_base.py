"""What the foot holds: given, drawn, or rigid."""

from __future__ import annotations

import numpy as np
import pytest
from guardrails import guardrail
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from cmbot.common.errors import InputError
from cmbot.elastic import elastic_base
from cmbot.elastic.base import guardrail_frame
from cmbot.scene import load_scene


def positive_definite(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return root @ root.T + np.eye(6)


def rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


@pytest.mark.parametrize("bays", [0, 4])
def test_a_given_stiffness_is_taken_as_it_is(bays: int) -> None:
    K, M = positive_definite(1), positive_definite(2)
    base = elastic_base(guardrail(bays=bays, stiffness=rows(K), mass=rows(M)))
    assert base is not None
    np.testing.assert_array_equal(base.stiffness, K)
    np.testing.assert_array_equal(base.mass, M)
    assert base.frequencies.shape == (0,)


def test_a_given_stiffness_without_mass_moves_none() -> None:
    base = elastic_base(guardrail(stiffness=rows(positive_definite(1))))
    assert base is not None
    np.testing.assert_array_equal(base.mass, np.zeros((6, 6)))


def test_a_given_stiffness_is_symmetric_to_the_last_digit() -> None:
    K = positive_definite(1)
    K[0, 1] *= 1 + 1e-12
    base = elastic_base(guardrail(stiffness=rows(K)))
    assert base is not None
    np.testing.assert_array_equal(base.stiffness, base.stiffness.T)
    np.testing.assert_allclose(base.stiffness, K, rtol=1e-12)


def test_without_posts_and_stiffness_the_hold_is_rigid() -> None:
    assert elastic_base(guardrail(bays=0)) is None


def test_the_shipped_scenes_hold_the_default_guardrail() -> None:
    drawn = guardrail_frame(guardrail())
    expected = drawn.frame.condense(drawn.foot)
    base = elastic_base(load_scene("triangle").guardrail)
    assert base is not None
    np.testing.assert_array_equal(base.stiffness, expected.stiffness)
    np.testing.assert_array_equal(base.mass, expected.mass)
    assert base.frequencies.shape == (6,)
    assert np.all(np.diff(base.frequencies) > 0)


def test_six_coordinates_are_never_slower_than_the_whole_frame() -> None:
    base = elastic_base(guardrail())
    assert base is not None
    six = np.sqrt(linalg.eigh(base.stiffness, base.mass, eigvals_only=True)) / (2 * np.pi)
    assert np.all(six >= base.frequencies)


def test_nothing_can_be_changed_and_nothing_is_shared() -> None:
    found = guardrail(stiffness=rows(positive_definite(1)), mass=rows(positive_definite(2)))
    for base in (elastic_base(found), elastic_base(guardrail())):
        assert base is not None
        assert not any(array.flags.writeable for array in (base.stiffness, base.mass, base.frequencies))
        assert base.stiffness is not found.stiffness


powers = st.floats(-5, 3).map(lambda power: 10.0**power)
sections = st.one_of(
    st.builds(lambda d: {"bar": d}, powers),
    st.builds(lambda a, share: {"angle": (a, a * 10.0**share)}, powers, st.floats(-6, -0.1)),
)


@given(st.lists(sections, min_size=2, max_size=4), powers, powers, powers, powers, st.floats(0.01, 1))
@settings(max_examples=60)
def test_of_whatever_a_file_describes_comes_a_sound_base_or_an_error(
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
    except InputError:
        return
    assert base is not None
    for matrix in (base.stiffness, base.mass):
        scale = 1 / np.sqrt(np.diag(matrix))
        assert np.linalg.eigvalsh(matrix * scale * scale[:, None])[0] > -1e-9
    assert np.all(base.frequencies > 0)


def test_the_same_guardrail_gives_the_same_base() -> None:
    one, two = elastic_base(guardrail()), elastic_base(guardrail())
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.stiffness, two.stiffness)
    np.testing.assert_array_equal(one.mass, two.mass)
    np.testing.assert_array_equal(one.frequencies, two.frequencies)


def test_a_guardrail_without_mass_still_has_a_stiffness() -> None:
    base = elastic_base(guardrail(material={"density_kg_m3": 0.0}))
    assert base is not None
    np.testing.assert_array_equal(base.mass, np.zeros((6, 6)))
    assert base.frequencies.shape == (0,)
