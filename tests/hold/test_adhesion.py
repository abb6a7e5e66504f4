"""Adhesion of a foot: closed forms, derivatives, and slipping under a linear pressure."""

from dataclasses import replace

import numpy as np
import pytest
from finite_differences import finite_difference
from numpy.typing import NDArray
from oracles.contact_pressure import PressedPlate

from cmbot.hold import Foot, Holding, mean_distance

FloatArray = NDArray[np.float64]

FOOT = Foot(
    kind="magnet",
    centre=np.array([0.0, 0.0375, 0.0]),
    axes=np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    half=(0.065, 0.0375),
    friction=0.4,
    safety=2.0,
    adhesion=5000.0,
    share=np.eye(6),
)
PLAIN = replace(FOOT, centre=np.zeros(3), axes=np.eye(3))


def needed(load: list[float], foot: Foot = PLAIN) -> list[float]:
    """What a foot needs against pull, tip and slip by a load."""
    values: list[float] = Holding([foot], np.zeros(6)).modes(0, np.array([load]))[0].tolist()
    return values


@pytest.mark.parametrize("half", [(0.065, 0.075), (0.01, 0.3), (1.0, 1.0)])
def test_the_mean_distance_is_that_of_random_points(half: tuple[float, float], rng) -> None:
    points = rng.uniform(-1, 1, (200_000, 2)) * half
    assert mean_distance(*half) == pytest.approx(np.hypot(*points.T).mean(), rel=5e-3)


def test_a_plain_pull_needs_itself() -> None:
    assert needed([0, 0, 700, 0, 0, 0]) == pytest.approx([700, 700, 700])
    assert Holding([PLAIN], np.zeros(6)).each(np.array([[0, 0, -700.0, 0, 0, 0]])) == 0


def test_tipping_is_about_the_nearer_edge() -> None:
    assert needed([0, 0, 100, 30, 0, 0])[1] == pytest.approx(100 + 30 / 0.0375)
    assert needed([0, 0, 100, 30, 65, 0])[1] == pytest.approx(100 + 65 / 0.065)


def test_slipping_along_and_turning() -> None:
    assert needed([300, 400, 100, 0, 0, 0])[2] == pytest.approx(100 + 500 / 0.4)
    radius = mean_distance(0.065, 0.0375)
    assert needed([0, 0, 0, 0, 0, -20])[2] == pytest.approx(20 / (0.4 * radius))


def test_the_load_is_about_the_centre_of_the_contact() -> None:
    # 100 N downwards, 0.5 m before the face: it tips about the x axis, across the member.
    wrench = np.array([[0, 0, -100.0, -100.0 * 0.5375, 0, 0]])
    load = Holding([FOOT], np.zeros(6)).load(0, wrench)[0]
    np.testing.assert_allclose(load, [-100, 0, 0, 0, -50, 0], atol=1e-12)


def test_what_does_not_move_counts() -> None:
    weight = np.array([0, 0, -300.0, 0, 10, 0])
    arm = np.array([[1.0, 2, 3, 4, 5, 6]])
    both = Holding([FOOT], np.zeros(6)).load(0, arm + weight)
    np.testing.assert_allclose(Holding([FOOT], weight).load(0, arm), both)


@pytest.mark.parametrize("foot", [FOOT, replace(FOOT, adhesion=None, force=(1e3,) * 3, moment=(50.0,) * 3)])
def test_gradients(foot: Foot, rng) -> None:
    other = replace(foot, centre=np.array([0.2, 0.1, -0.4]), share=rng.normal(size=(6, 6)))
    holding = Holding([foot, other], rng.normal(size=6))
    scale = np.array([500, 500, 500, 50, 50, 50])
    for function in (holding, holding.share):
        wrench = rng.normal(size=(8, 6)) * scale
        value, gradient = function(wrench)
        assert (value > 0).any()
        for k in range(len(wrench)):
            expected = finite_difference(lambda w, f=function: f(w[None])[0][0], wrench[k], 1e-3)
            np.testing.assert_allclose(gradient[k], expected, rtol=1e-5, atol=1e-4)


def test_a_remainder_bounds_the_change(rng) -> None:
    clamp = replace(FOOT, adhesion=None, force=(1e3, 2e3, 3e3), moment=(50.0, 60.0, 70.0))
    holding = Holding([FOOT, clamp], np.zeros(6))
    wrench = rng.normal(size=(500, 6)) * 300
    change = rng.normal(size=wrench.shape)
    sizes = (np.linalg.norm(part, axis=1) for part in (change[:, :3], change[:, 3:]))
    force, torque = sizes
    moved = np.abs(holding.needed(0, wrench + change) - holding.needed(0, wrench))
    assert (moved <= holding.remainder(0, force, torque)).all()
    moved = np.abs(holding.use(1, wrench + change) - holding.use(1, wrench))
    assert (moved <= holding.use_remainder(1, force, torque)).all()


@pytest.mark.parametrize("axis", [0, 1, 3, 4, 5])
def test_a_remainder_bounds_a_change_along_one_axis(axis: int) -> None:
    """Where a plate slips the adhesion changes by more than the force: by its share of the friction."""
    holding, change = Holding([PLAIN], np.zeros(6)), np.zeros((1, 6))
    change[0, axis] = 1.0
    moved = holding.needed(0, 100 * change) - holding.needed(0, 99 * change)
    force, torque = (np.linalg.norm(part, axis=1) for part in (change[:, :3], change[:, 3:]))
    assert 0 < moved <= holding.remainder(0, force, torque)


@pytest.mark.parametrize("moment", [None, (1e3, 1e3, 1e3)])
def test_what_is_beyond_all_bounds_loads_without_bound(moment: tuple[float, float, float] | None) -> None:
    """Never a number that compares with nothing: a promise would seem kept."""
    clamp = replace(PLAIN, kind="clamp", adhesion=None, force=(1e3, 1e3, 1e3), moment=moment)
    beyond = np.array([np.inf, 1.0])
    found = Holding([clamp], np.zeros(6)).use_remainder(0, beyond, beyond)
    assert found[0] == np.inf
    assert np.isfinite(found[1])


def test_it_is_convex(rng) -> None:
    holding = Holding([FOOT], np.zeros(6))
    first, second = rng.normal(size=(2, 500, 6)) * [500, 500, 500, 50, 50, 50]
    middle = holding.needed(0, 0.5 * (first + second))
    assert (middle <= 0.5 * (holding.needed(0, first) + holding.needed(0, second)) + 1e-9).all()


@pytest.mark.parametrize("half", [(0.065, 0.075), (0.065, 0.0375), (0.075, 0.0315)])
def test_with_what_it_needs_no_plate_slips(half: tuple[float, float], rng) -> None:
    foot = replace(PLAIN, half=half)
    plate = PressedPlate(*half, foot.friction)
    # Forces and moments of all proportions: friction, tipping and torsion about as large, or one alone.
    sizes = 10 ** rng.uniform(-2, 0, (25, 6)) * rng.choice([-1, 1], (25, 6)) * [300, 300, 200, 30, 30, 15]
    values = Holding([foot], np.zeros(6)).needed(0, sizes)
    for load, value in zip(sizes, values, strict=True):
        assert not plate.slips(load, 1.02 * value), load  # by the grid's points


def test_the_ellipse_of_uniform_pressure_is_not_on_the_safe_side() -> None:
    # The line's planned motion: what friction and torsion need as if the pressure were uniform.
    load = np.array([-667.1, 0, 0, 0, -422.7, 188.0])
    half = (0.075, 0.065)
    ellipse = np.hypot(667.1, 188.0 / mean_distance(*half)) / 0.4
    value = Holding([replace(PLAIN, half=half)], np.zeros(6)).needed(0, load[None])[0]
    exact = PressedPlate(*half, 0.4).needed(load, 1e5)
    assert 1.2 * ellipse < exact < value < 1.3 * exact
