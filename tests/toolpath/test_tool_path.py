"""The tool path: position, velocity, via-times, the way back to the legs; and the speed profile of a leg."""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from small_scenes import SHORT

from cmbot.common.errors import InputError, SceneError
from cmbot.planning import robot_of, strokes_of
from cmbot.scene import load_scene
from cmbot.toolpath import Segment, SpeedProfile, Spline, ToolPath, share_out_segments

FloatArray = NDArray[np.float64]
KINDS = ("trapezoidal", "jerk_limited", "quiet")


def triangle(kind: str = "trapezoidal") -> ToolPath:
    """Three legs of 10, 2 and 8 s."""
    corners = np.array([[0.5, 1.0, 0.2], [1.5, 1.0, 0.2], [1.5, 1.3, 0.2], [0.5, 1.0, 0.2]])
    return ToolPath.straight(
        corners, np.eye(3), np.array([10.0, 2.0, 8.0]), SpeedProfile(kind=kind, ramp=0.2).law
    )


def random_path(seed: int, legs: int, kind: str) -> ToolPath:
    rng = np.random.default_rng(seed)
    return ToolPath.straight(
        rng.normal(size=(legs + 1, 3)),
        np.eye(3),
        rng.uniform(0.5, 10, size=legs),
        SpeedProfile(kind=kind, ramp=rng.uniform(0.05, 0.5)).law,
    )


paths = st.builds(random_path, st.integers(0, 2**32 - 1), st.integers(1, 5), st.sampled_from(KINDS))
durations = st.lists(st.floats(0.1, 100), min_size=1, max_size=6)


def test_times_and_lengths_of_the_triangle() -> None:
    path = triangle()
    np.testing.assert_array_equal(path.leg_times, [0, 10, 12, 20])
    assert path.duration == 20.0
    np.testing.assert_allclose(path.lengths, [1.0, 0.3, np.hypot(1.0, 0.3)])
    t = path.via_times(50)
    assert len(t) == 50
    np.testing.assert_array_equal(t[[0, 25, 30, 49]], path.leg_times)
    np.testing.assert_array_equal(path.via_times(4), path.leg_times)


@given(paths)
def test_velocity_is_the_derivative_of_position(path: ToolPath) -> None:
    step = 1e-5
    times = np.linspace(step, path.duration - step, 500)
    # A kink of the speed within a step costs half a step times its acceleration.
    u_kinks = path.segments[0].law.breaks
    kinks = (path.leg_times[:-1, None] + u_kinks * path.seconds[:, None]).ravel()
    times = times[np.abs(times[:, None] - kinks).min(axis=1) > step]
    difference = (path.position(times + step) - path.position(times - step)) / (2 * step)
    np.testing.assert_allclose(difference, path.velocity(times), rtol=0, atol=1e-6)


@given(paths)
def test_the_tool_moves_along_the_leg_of_its_time_and_rests_at_every_corner(path: ToolPath) -> None:
    for leg, (start, end) in enumerate(pairwise(path.leg_times)):
        p = path.position(np.linspace(start, end, 21)[1:-1])
        edge = np.diff(path.corners, axis=0)[leg]
        along = (p - path.corners[leg]) @ edge / path.lengths[leg] ** 2
        np.testing.assert_allclose(p, path.corners[leg] + along[:, None] * edge, rtol=0, atol=1e-13)
        assert np.all(np.diff(along) > 0)
        assert along.min() > 0
        assert along.max() < 1
    np.testing.assert_allclose(path.position(path.leg_times), path.corners, rtol=0, atol=1e-14)
    # Next to a corner, on either side of it, the speed is small too.
    for times in (path.leg_times, path.leg_times - 1e-9, path.leg_times + 1e-9):
        assert np.abs(path.velocity(times)).max() < 1e-6
    times = np.linspace(0, path.duration, 101)
    np.testing.assert_allclose(path.leg_offset(times, path.position(times)), 0.0, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_times_outside_count_as_the_nearer_end(kind: str) -> None:
    path = triangle(kind)
    outside = [-np.inf, -3.0, 25.0, np.inf]
    np.testing.assert_allclose(path.position(outside), path.corners[[0, 0, -1, -1]], rtol=0, atol=1e-15)
    assert not path.velocity(outside).any()
    assert path.progress(-3.0) == 0.0
    assert path.progress(25.0) == 1.0


@given(paths)
def test_progress_is_the_covered_share_of_the_length(path: ToolPath) -> None:
    times = np.linspace(0, path.duration, 101)
    progress = np.array([path.progress(float(time)) for time in times])
    assert progress[0] == 0.0
    assert progress[-1] == pytest.approx(1.0, abs=1e-15)
    assert np.all(np.diff(progress) >= -1e-15)
    assert np.all((progress >= 0) & (progress <= 1 + 1e-15))
    at_corners = [path.progress(float(time)) for time in path.leg_times]
    expected = np.concatenate([[0.0], np.cumsum(path.lengths)]) / path.lengths.sum()
    np.testing.assert_allclose(at_corners, expected, rtol=0, atol=1e-14)
    # Length travelled, summed from small steps.
    fine = path.position(np.union1d(np.linspace(0, path.duration, 1001), path.leg_times))
    assert np.linalg.norm(np.diff(fine, axis=0), axis=1).sum() == pytest.approx(path.lengths.sum(), rel=1e-12)


@settings(max_examples=30)
@given(paths, st.integers(0, 2**32 - 1))
def test_leg_offset_is_from_the_nearest_point_of_the_leg_of_that_time(path: ToolPath, seed: int) -> None:
    rng = np.random.default_rng(seed)
    legs = len(path.seconds)
    p = rng.normal(scale=1.5, size=(legs, 3))
    times = path.leg_times[:-1] + rng.uniform(0.01, 0.99, size=legs) * path.seconds
    offset = path.leg_offset(times, p)
    s = np.linspace(0, 1, 801)[:, None, None]
    samples = path.corners[:-1] + s * np.diff(path.corners, axis=0)
    squares = ((p - samples) ** 2).sum(axis=2).min(axis=0)
    # The nearest sample is at most half a step beside the nearest point.
    slack = (path.lengths / 800 / 2) ** 2
    distance = (offset**2).sum(axis=1)
    assert np.all(distance <= squares + 1e-13)
    assert np.all(squares <= distance + slack + 1e-13)
    # What the offset leads back to is itself on the leg.
    np.testing.assert_allclose(path.leg_offset(times, p - offset), 0.0, rtol=0, atol=1e-13)


@given(paths, st.integers(0, 60))
def test_via_times_hold_the_leg_ends_and_equal_steps_within_a_leg(path: ToolPath, more: int) -> None:
    legs = len(path.seconds)
    t = path.via_times(legs + 1 + more)
    assert t.shape == (legs + 1 + more,)
    assert np.all(np.diff(t) > 0)
    assert np.isin(path.leg_times, t).all()
    shares = share_out_segments(path.seconds, legs + more)
    index = np.searchsorted(t, path.leg_times)
    np.testing.assert_array_equal(np.diff(index), shares)
    for leg, (start, end) in enumerate(pairwise(index)):
        steps = np.diff(t[start : end + 1])
        np.testing.assert_allclose(steps, path.seconds[leg] / shares[leg], rtol=0, atol=1e-14 * path.duration)


def test_shares_of_segments() -> None:
    """Of the paper's triangle, of its line; of equal legs the earlier has the odd segment."""
    for seconds, shares in (([10, 2, 8], [25, 5, 19]), ([20], [49]), ([3, 3, 3], [2, 2, 1])):
        assert share_out_segments(np.array(seconds, dtype=float), sum(shares)) == shares


@given(durations, st.integers(0, 80))
def test_shares_add_up_and_follow_dhondt(seconds: list[float], more: int) -> None:
    shares = share_out_segments(seconds, len(seconds) + more)
    assert sum(shares) == len(seconds) + more
    assert min(shares) >= 1
    # No segment is better placed elsewhere: where it went, the step is at least what it would be there. So
    # the shortest step is the longest of all shares, and a leg that lasts longer has no fewer segments.
    # (It does not make the longest step shortest: long legs win.)
    for given_up, gaining in product(range(len(seconds)), repeat=2):
        if shares[given_up] > 1:
            shortest = seconds[given_up] / shares[given_up]
            # Durations that only rounding tells apart are the same.
            assert shortest >= seconds[gaining] / (shares[gaining] + 1) * (1 - 1e-8)


@given(durations, st.integers(0, 60))
def test_one_more_segment_takes_none_away(seconds: list[float], more: int) -> None:
    fewer = share_out_segments(seconds, len(seconds) + more)
    gained = np.subtract(share_out_segments(seconds, len(seconds) + more + 1), fewer)
    assert sorted(gained) == [0] * (len(seconds) - 1) + [1]


@pytest.mark.parametrize("count", [-1, 0, 1, 2, 3])
def test_fewer_via_points_than_corners_are_refused(count: int) -> None:
    with pytest.raises(InputError, match="at least 4, one per leg end") as caught:
        triangle().via_times(count)
    assert caught.value.got == count


profiles = st.builds(
    lambda kind, ramp: SpeedProfile(kind=kind, ramp=ramp), st.sampled_from(KINDS), st.floats(0.01, 0.5)
)


def breaks(profile: SpeedProfile) -> FloatArray:
    """Shares of the duration between which the rate is one polynomial."""
    r = profile.ramp
    return np.unique([*(r * np.arange(5) / 4), 0.5, *(1 - r * np.arange(5) / 4)])


@given(profiles)
def test_shape_of_a_profile(profile: SpeedProfile) -> None:
    """From rest to rest, symmetric, never back, and with the cruising speed as its peak."""
    ends = np.array([0.0, 1.0])
    np.testing.assert_array_equal(profile.law.share(ends), ends)
    np.testing.assert_array_equal(profile.law.rate(ends), [0.0, 0.0])
    u = np.linspace(0, 1, 2001)
    rate, share = profile.law.rate(u), profile.law.share(u)
    assert np.all(rate >= 0)
    assert np.all(np.diff(share) >= 0)
    np.testing.assert_allclose(share + profile.law.share(1 - u), 1.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(rate, profile.law.rate(1 - u), rtol=0, atol=1e-14 / profile.ramp)
    assert profile.law.share(np.array([0.5]))[0] == pytest.approx(0.5, abs=1e-15)
    peak = 1 / (1 - profile.ramp)
    assert np.all(rate <= peak * (1 + 1e-15))
    cruise = (u >= profile.ramp) & (u <= 1 - profile.ramp)
    np.testing.assert_allclose(rate[cruise], peak, rtol=1e-13)
    assert profile.law.rate(np.array([0.5]))[0] == pytest.approx(peak, rel=1e-15)


@given(profiles)
def test_share_is_the_integral_of_the_rate(profile: SpeedProfile) -> None:
    x, w = np.polynomial.legendre.leggauss(4)
    edges = breaks(profile)
    h = np.diff(edges)
    integral = h / 2 * (profile.law.rate(edges[:-1, None] + h[:, None] * (1 + x) / 2) @ w)
    np.testing.assert_allclose(np.cumsum(integral), profile.law.share(edges[1:]), rtol=0, atol=1e-14)
    # From a break to anywhere within the piece after it.
    inside = np.linspace(edges[:-1], edges[1:], 50).T
    start = inside[:, :1]
    length = inside - start
    points = start[..., None] + length[..., None] * (1 + x) / 2
    expected = profile.law.share(start) + length / 2 * (profile.law.rate(points) @ w)
    np.testing.assert_allclose(profile.law.share(inside), expected, rtol=0, atol=1e-14)


def acceleration(profile: SpeedProfile, u: FloatArray, step: float) -> FloatArray:
    """Mean acceleration over 2 `step`: no smoother kink can hide in it, and no jump."""
    return (profile.law.rate(u + step) - profile.law.rate(u - step)) / (2 * step)


@pytest.mark.parametrize("ramp", [0.05, 0.2, 0.5])
def test_trapezoidal_acceleration_is_constant_in_each_phase(ramp: float) -> None:
    profile = SpeedProfile(kind="trapezoidal", ramp=ramp)
    step = 1e-4
    a = 1 / (ramp * (1 - ramp))
    phases = [(0.0, ramp, a), (1 - ramp, 1.0, -a)] + ([(ramp, 1 - ramp, 0.0)] if ramp < 0.5 else [])
    for start, end, expected in phases:
        u = np.linspace(start + step, end - step, 101)
        np.testing.assert_allclose(acceleration(profile, u, step), expected, rtol=0, atol=1e-9)


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


def test_known_shares_and_rates() -> None:
    shipped = SpeedProfile()
    assert (shipped.kind, shipped.ramp) == ("trapezoidal", 0.2)
    np.testing.assert_allclose(shipped.law.share(np.array([0.2, 0.8])), [0.125, 0.875], rtol=1e-15)
    # The whole leg may be ramps.
    u = np.linspace(0, 1, 101)
    triangle = SpeedProfile(kind="trapezoidal", ramp=0.5)
    np.testing.assert_allclose(triangle.law.rate(u), 4 * np.minimum(u, 1 - u), rtol=0, atol=1e-15)
    smooth = SpeedProfile(kind="jerk_limited", ramp=0.5)
    # Jerk +32, -32, -32, +32 on the four quarters.
    at_quarters = smooth.law.share(np.array([0.25, 0.5, 0.75]))
    np.testing.assert_allclose(at_quarters, [32 * 0.25**3 / 6, 0.5, 1 - 32 * 0.25**3 / 6], rtol=1e-14)


@pytest.mark.parametrize(
    ("ramp", "expected"),
    [
        *((ramp, "at least 0.001") for ramp in (0.0, -0.1)),
        *((ramp, "at most 0.5") for ramp in (0.5000001, 1.0)),
        *((ramp, "a finite number") for ramp in (np.nan, np.inf)),
    ],
)
def test_a_ramp_out_of_range_is_refused(ramp: float, expected: str) -> None:
    with pytest.raises(InputError, match=rf"^SpeedProfile: ramp: got {ramp}, expected {expected}$"):
        SpeedProfile(ramp=ramp)


@pytest.mark.parametrize("kind", ["sine", "", "Trapezoidal", None])
def test_an_unknown_kind_is_refused_and_the_known_ones_named(kind: Any) -> None:
    with pytest.raises(InputError, match="one of: trapezoidal, jerk_limited") as caught:
        SpeedProfile(kind=kind)
    assert caught.value.key == "kind"


def test_fewer_via_points_than_a_rasters_rows_name_the_key() -> None:
    raster = {"origin": [1.8, 0.6, -1.9], "u": [0, 0.2, 0], "v": [0, 0, -0.2], "spacing_m": 0.005}
    path = {"raster": {**raster, "stand_off_m": 0.0}, "speed_m_s": 0.1}
    scene = load_scene({**SHORT, "tool_path": path})
    with pytest.raises(SceneError, match=r"via_points: got 50, expected at least \d+, .* or auto") as caught:
        strokes_of(scene, robot_of(scene))
    assert caught.value.key == "tool_path.via_points"


@settings(max_examples=30)
@given(radius=st.floats(0.002, 0.05), count=st.integers(24, 200), law=st.booleans())
def test_via_points_of_a_spline_are_dense_where_it_bends(radius: float, count: int, law: bool) -> None:
    """Two straight ways of 0.5 m and half a turn between them, with 15 points."""
    angle = np.linspace(0.0, np.pi, 15)
    bend = radius * np.stack([np.sin(angle), 1 - np.cos(angle), 0 * angle], axis=1)
    x = np.linspace(-0.5, 0.0, 26)[:-1, None] * [1.0, 0, 0]
    points = np.concatenate([x, bend, x[::-1] + np.array([0.0, 2 * radius, 0.0])])
    own = SpeedProfile(kind="quiet" if law else "jerk_limited", ramp=0.2 if law else 0.4).law
    segment = Segment(curve=Spline(points), seconds=10.0, law=own)
    path = ToolPath(orientation=np.eye(3), segments=(segment,))
    t = path.via_times(count)
    assert (t[0], t[-1], len(t)) == (0.0, 10.0, count)
    assert (np.diff(t) > 0).all()
    # Half of them are for the time, and the others mostly for the bend, but where that takes no time.
    assert np.diff(t).max() <= 2 * 10.0 / (count - 1) * 1.01
    assert np.diff(t).min() >= 10.0 / (count - 1) / 8 * 0.99
    p = path.position(t)
    in_bend = ((p[:, 0] > 0) & (t > 0) & (t < 10.0)).sum()
    even = path.position(np.linspace(0, 10.0, count))
    assert in_bend >= 2 * (even[:, 0] > 0).sum()
