"""Speed profiles: share and rate belong together, start and end at rest, are bounded as promised."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cmbot.common.errors import InputError
from cmbot.scene.speed_profile import SpeedProfile

FloatArray = NDArray[np.float64]
KINDS = ("trapezoidal", "jerk_limited")

profiles = st.builds(
    lambda kind, ramp: SpeedProfile(kind=kind, ramp=ramp), st.sampled_from(KINDS), st.floats(0.01, 0.5)
)
several = pytest.mark.parametrize(
    "profile", [SpeedProfile(kind=kind, ramp=ramp) for kind in KINDS for ramp in (0.05, 0.2, 0.5)], ids=repr
)


def breaks(profile: SpeedProfile) -> FloatArray:
    """Shares of the duration between which the rate is one polynomial."""
    r = profile.ramp
    return np.unique([0.0, r / 2, r, 0.5, 1 - r, 1 - r / 2, 1.0])


def between_breaks(profile: SpeedProfile, margin: float) -> FloatArray:
    """Samples (pieces, 50) of every piece that keep `margin` off its ends."""
    edges = breaks(profile)
    edges = edges[np.concatenate([[True], np.diff(edges) > 4 * margin])]
    return np.linspace(edges[:-1] + margin, edges[1:] - margin, 50).T


@given(profiles)
def test_covers_the_leg_from_rest_to_rest(profile: SpeedProfile) -> None:
    ends = np.array([0.0, 1.0])
    np.testing.assert_array_equal(profile.share(ends), ends)
    np.testing.assert_array_equal(profile.rate(ends), [0.0, 0.0])


@given(profiles)
def test_the_rate_is_never_negative_and_peaks_at_the_cruising_speed(profile: SpeedProfile) -> None:
    u = np.linspace(0, 1, 2001)
    rate = profile.rate(u)
    assert np.all(rate >= 0)
    peak = 1 / (1 - profile.ramp)
    assert np.all(rate <= peak * (1 + 1e-15))
    cruise = (u >= profile.ramp) & (u <= 1 - profile.ramp)
    np.testing.assert_allclose(rate[cruise], peak, rtol=1e-13)
    assert profile.rate(np.array([0.5]))[0] == pytest.approx(peak, rel=1e-15)


@given(profiles)
def test_share_rises_and_is_symmetric(profile: SpeedProfile) -> None:
    u = np.linspace(0, 1, 2001)
    share = profile.share(u)
    assert np.all(np.diff(share) >= 0)
    np.testing.assert_allclose(share + profile.share(1 - u), 1.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(profile.rate(u), profile.rate(1 - u), rtol=0, atol=1e-14 / profile.ramp)
    assert profile.share(np.array([0.5]))[0] == pytest.approx(0.5, abs=1e-15)


@given(profiles)
def test_share_is_the_integral_of_the_rate(profile: SpeedProfile) -> None:
    x, w = np.polynomial.legendre.leggauss(4)
    edges = breaks(profile)
    h = np.diff(edges)
    integral = h / 2 * (profile.rate(edges[:-1, None] + h[:, None] * (1 + x) / 2) @ w)
    np.testing.assert_allclose(np.cumsum(integral), profile.share(edges[1:]), rtol=0, atol=1e-14)
    # From a break to anywhere within the piece after it.
    inside = between_breaks(profile, 0.0)
    start = inside[:, :1]
    length = inside - start
    points = start[..., None] + length[..., None] * (1 + x) / 2
    expected = profile.share(start) + length / 2 * (profile.rate(points) @ w)
    np.testing.assert_allclose(profile.share(inside), expected, rtol=0, atol=1e-14)


@several
def test_rate_is_the_derivative_of_share(profile: SpeedProfile) -> None:
    step = 1e-5
    u = between_breaks(profile, step)
    difference = (profile.share(u + step) - profile.share(u - step)) / (2 * step)
    np.testing.assert_allclose(difference, profile.rate(u), rtol=0, atol=1e-7)


@pytest.mark.parametrize("ramp", [0.05, 0.2, 0.5])
def test_trapezoidal_acceleration_is_constant_in_each_phase(ramp: float) -> None:
    profile = SpeedProfile(kind="trapezoidal", ramp=ramp)
    step = 1e-4
    a = 1 / (ramp * (1 - ramp))
    phases = [(0.0, ramp, a), (1 - ramp, 1.0, -a)] + ([(ramp, 1 - ramp, 0.0)] if ramp < 0.5 else [])
    for start, end, expected in phases:
        u = np.linspace(start + step, end - step, 101)
        difference = (profile.rate(u + step) - profile.rate(u - step)) / (2 * step)
        np.testing.assert_allclose(difference, expected, rtol=0, atol=1e-9)


def acceleration(profile: SpeedProfile, u: FloatArray, step: float) -> FloatArray:
    """Mean acceleration over 2 `step`: no smoother kink can hide in it, and no jump."""
    return (profile.rate(u + step) - profile.rate(u - step)) / (2 * step)


@pytest.mark.parametrize("ramp", [0.05, 0.2, 0.5])
def test_jerk_limited_acceleration_is_continuous_with_bounded_jerk(ramp: float) -> None:
    profile = SpeedProfile(kind="jerk_limited", ramp=ramp)
    step, spacing = 1e-6, 1e-4
    u = np.arange(2 * step, 1 - 2 * step, spacing)
    a = acceleration(profile, u, step)
    peak, jerk = 2 / (ramp * (1 - ramp)), 4 / (ramp**2 * (1 - ramp))
    noise = 1e-9
    assert np.abs(np.diff(a)).max() <= jerk * spacing + noise
    assert np.abs(np.diff(a)).max() >= 0.999 * jerk * spacing
    assert 0.99 * peak <= np.abs(a).max() <= peak + noise
    # It also starts and ends at zero, where the tool rests.
    assert abs(a[0]) <= jerk * 3 * step
    # The trapezoid does jump, so this test can tell them apart.
    trapezoid = acceleration(SpeedProfile(kind="trapezoidal", ramp=ramp), u, step)
    assert np.abs(np.diff(trapezoid)).max(initial=trapezoid[0]) > 3 * jerk * spacing * ramp


def test_the_whole_leg_may_be_ramps() -> None:
    u = np.linspace(0, 1, 101)
    triangle = SpeedProfile(kind="trapezoidal", ramp=0.5)
    np.testing.assert_allclose(triangle.rate(u), 4 * np.minimum(u, 1 - u), rtol=0, atol=1e-15)
    smooth = SpeedProfile(kind="jerk_limited", ramp=0.5)
    # Jerk +32, -32, -32, +32 on the four quarters.
    at_quarters = smooth.share(np.array([0.25, 0.5, 0.75]))
    np.testing.assert_allclose(at_quarters, [32 * 0.25**3 / 6, 0.5, 1 - 32 * 0.25**3 / 6], rtol=1e-14)


def test_the_paper_figure_for_the_shipped_ramp() -> None:
    profile = SpeedProfile()
    assert (profile.kind, profile.ramp) == ("trapezoidal", 0.2)
    np.testing.assert_allclose(profile.share(np.array([0.2, 0.8])), [0.125, 0.875], rtol=1e-15)


@pytest.mark.parametrize("ramp", [0.0, -0.1, 0.5000001, 1.0, np.nan, np.inf])
def test_a_ramp_out_of_range_is_refused(ramp: float) -> None:
    with pytest.raises(
        InputError, match=r"SpeedProfile: ramp: got .*, expected a share in \(0, 0.5\]"
    ) as caught:
        SpeedProfile(ramp=ramp)
    assert caught.value.got is ramp


@pytest.mark.parametrize("kind", ["sine", "", "Trapezoidal", None])
def test_an_unknown_kind_is_refused_and_the_known_ones_named(kind: Any) -> None:
    with pytest.raises(InputError, match="one of: trapezoidal, jerk_limited") as caught:
        SpeedProfile(kind=kind)
    assert caught.value.key == "kind"
