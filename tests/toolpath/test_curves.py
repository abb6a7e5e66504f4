"""Curved legs: by what a curve is (distance from the centre, length, points), not by its formulas."""

from typing import Any

import numpy as np
import pytest
from finite_differences import finite_difference
from hypothesis import example, given, settings, strategies as st
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.planning.certification.norm_bounds import timed_pose_bounds
from cmbot.toolpath.curves import Arc, Blend, Curve, CylinderCurve, Line, Spline
from cmbot.toolpath.time_law import SpeedProfile
from cmbot.toolpath.tool_path import Segment, ToolPath
from cmbot.trajectory import Pieces, QuinticTrajectory

seeds = st.integers(0, 2**32 - 1)
FINE = np.linspace(0, 1, 4001)


def arc(rng: np.random.Generator) -> Arc:
    while True:
        found = Arc.through(*rng.normal(size=(3, 3)))
        if found is not None and found.radius < 100:
            return found


def spline(rng: np.random.Generator, uneven: float = 0.4) -> Spline:
    steps = uneven * rng.normal(size=(7, 3)) + np.array([2.0, 0, 0])
    orientations = Rotation.from_rotvec(np.cumsum(rng.normal(size=(7, 3)) * 0.3, axis=0)).as_matrix()
    return Spline(np.cumsum(steps, axis=0), orientations)


def blend(rng: np.random.Generator) -> Blend:
    return Blend(np.cumsum(rng.normal(size=(5, 3)), axis=0), float(rng.uniform(0.01, 0.5)))


def rolled(rng: np.random.Generator) -> CylinderCurve:
    corners = np.cumsum(rng.normal(size=(5, 3)) * [1, 1, 0], axis=0)
    X_WC = np.eye(4)
    X_WC[:3, :3], X_WC[:3, 3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.normal(size=3)
    orientation = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    return CylinderCurve(
        Blend(corners, float(rng.uniform(0.01, 0.5))), X_WC, float(rng.uniform(0.2, 2.0)), orientation
    )


CURVES = pytest.mark.parametrize("make", [arc, spline, blend, rolled])
FLAT = pytest.mark.parametrize("make", [arc, spline, blend])


def path_of(curve: Curve, kind: str = "jerk_limited", turn: FloatArray | None = None) -> ToolPath:
    """A straight leg, the curve, and a straight leg again."""
    ends = curve.position(np.array([0.0, 1.0]))
    corners = np.vstack([ends[0] - [0.2, 0, 0], ends, ends[1] + [0, 0.3, 0]])
    orientation, turns = np.eye(3), np.zeros((3, 3)) if turn is None else np.array([turn, -turn, 0.5 * turn])
    given = curve.rotation(np.array([0.0, 1.0]))
    if given is not None:
        orientation = given[0]
        turns[0], turns[1] = 0.0, Rotation.from_matrix(given[1] @ given[0].T).as_rotvec()
    law = SpeedProfile(kind=kind, ramp=0.3).law
    curves = (Line(*corners[:2]), curve, Line(*corners[2:]))
    legs = zip(curves, turns, (1.0, 3.0, 1.5), strict=True)
    segments = tuple(Segment(curve=c, turn=turn, seconds=seconds, law=law) for c, turn, seconds in legs)
    return ToolPath(segments=segments, orientation=orientation)


@given(seeds)
def test_an_arc_passes_its_three_points_on_a_circle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, via, end = rng.normal(size=(3, 3))
    found = Arc.through(start, via, end)
    if found is None or found.radius > 100:
        return
    p = found.position(FINE)
    scale = found.radius
    np.testing.assert_allclose(p[[0, -1]], [start, end], atol=1e-9 * scale)
    assert np.linalg.norm(p - via, axis=1).min() < found.length / 4000
    np.testing.assert_allclose(np.linalg.norm(p - found.centre, axis=1), scale, rtol=1e-9)
    normal = np.cross(via - start, end - start)
    np.testing.assert_allclose((p - start) @ normal / np.linalg.norm(normal), 0.0, atol=1e-9 * scale)


def test_points_on_a_line_have_no_arc() -> None:
    assert Arc.through(np.zeros(3), np.ones(3), 2.5 * np.ones(3)) is None
    assert Arc.through(np.zeros(3), np.ones(3), np.zeros(3)) is None


@CURVES
@settings(max_examples=20)
@example(seed=474)
@given(seed=seeds)
def test_lengths_slopes_and_curvature(make: type, seed: int) -> None:
    curve = make(np.random.default_rng(seed))
    # Chords are shorter than tight corners.
    chords = np.diff(curve.position(np.linspace(0, 1, 40_001)), axis=0)
    assert np.linalg.norm(chords, axis=1).sum() == pytest.approx(curve.length, rel=1e-4)
    tangent = curve.tangent(FINE)
    for share in (0.123, 0.4567, 0.9):
        slope = finite_difference(lambda s: curve.position(s)[0], np.array([share]), step=1e-7)[:, 0]
        np.testing.assert_allclose(curve.slope(np.array([share]))[0], slope, atol=1e-4 * curve.length)
    turned = np.linalg.norm(np.diff(tangent, axis=0), axis=1)
    assert turned.max() <= curve.curvature * curve.length / 4000 * (1 + 1e-3) * 1.05 + 1e-12


@CURVES
@settings(max_examples=20)
@given(seed=seeds)
def test_the_share_is_one_of_the_length(make: type, seed: int) -> None:
    """Exactly on arcs and lines; at the points of a spline nearly, where their distances are alike."""
    rng = np.random.default_rng(seed)
    curve = spline(rng, uneven=0.1) if make is spline else make(rng)
    shares = np.concatenate([curve.breaks, [1.0]]) if make is spline else FINE[1:]
    # Chords are shorter than tight corners.
    fine = np.unique(np.concatenate([np.linspace(0, 1, 100_001), shares]))
    covered = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve.position(fine), axis=0), axis=1)))
    at = np.searchsorted(fine, shares)
    atol = {spline: 5e-3, rolled: 1e-5}.get(make, 1e-6)
    np.testing.assert_allclose(covered[at] / covered[-1], shares, atol=atol)


@settings(max_examples=20)
@given(seed=seeds)
def test_a_spline_passes_its_points_and_orientations(seed: int) -> None:
    curve = spline(np.random.default_rng(seed))
    at = np.concatenate([[0.0], curve.breaks, [1.0]])
    np.testing.assert_allclose(curve.position(at), curve.points, atol=1e-12)
    np.testing.assert_allclose(curve.rotation(at), curve.orientations, atol=1e-12)


@settings(max_examples=20)
@given(seed=seeds)
def test_a_blend_leaves_its_corners_by_no_more_than_the_radius_asks(seed: int) -> None:
    curve = blend(np.random.default_rng(seed))
    p = curve.position(FINE)
    np.testing.assert_allclose(p[[0, -1]], curve.corners[[0, -1]], atol=1e-12)
    edges = np.diff(curve.corners, axis=0)
    s = np.clip(
        np.einsum("nkd,kd->nk", p[:, None] - curve.corners[:-1], edges) / (edges**2).sum(axis=1), 0, 1
    )
    away = np.linalg.norm(p[:, None] - curve.corners[:-1] - s[..., None] * edges, axis=2).min(axis=1)
    assert away.max() <= curve.radius
    # No jump of the direction.
    tangent = curve.tangent(FINE)
    assert (
        np.linalg.norm(np.diff(tangent, axis=0), axis=1).max() <= curve.length / 4000 * curve.curvature * 1.01
    )


@CURVES
@pytest.mark.parametrize("kind", ["trapezoidal", "jerk_limited"])
def test_velocities_are_derivatives_of_positions(make: type, kind: str, rng: np.random.Generator) -> None:
    path = path_of(make(rng), kind)
    for t in rng.uniform(0, path.duration, 20):
        expected = finite_difference(lambda x: path.position(x)[0], np.array([t]), step=1e-6)[:, 0]
        np.testing.assert_allclose(path.velocity([t])[0], expected, atol=1e-5 * path.lengths.sum())
        speed = np.linalg.norm(path.velocity([t])[0])
        np.testing.assert_allclose(path.velocity([t])[0], speed * path.leg_directions([t])[0], atol=1e-12)


@CURVES
def test_orientations_are_continuous_and_end_where_they_should(make: type, rng: np.random.Generator) -> None:
    turn = np.array([0.4, -0.8, 0.3])
    path = path_of(make(rng), turn=turn)
    t = np.linspace(0, path.duration, 2001)
    R = path.poses(t).rotation
    steps = Rotation.from_matrix(R[1:] @ R[:-1].transpose(0, 2, 1)).magnitude()
    assert steps.max() < 0.02
    corners = path.poses(path.leg_times).rotation
    between = Rotation.from_matrix(corners[1:] @ corners[:-1].transpose(0, 2, 1)).as_rotvec()
    np.testing.assert_allclose(between, [segment.turn for segment in path.segments], atol=1e-9)
    assert path.turns
    held = path.held()
    assert not held.turns
    np.testing.assert_array_equal(held.position([0.0, 0.5]), np.tile(path.corners[0], (2, 1)))


@settings(max_examples=20)
@given(seed=seeds)
def test_a_rolled_curve_is_on_its_cylinder_and_turns_with_it(seed: int) -> None:
    curve = rolled(np.random.default_rng(seed))
    local = (curve.position(FINE) - curve.X_WC[:3, 3]) @ curve.X_WC[:3, :3]
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), curve.radius, rtol=1e-12)
    flat = curve.plane.position(FINE)
    np.testing.assert_allclose(local[:, 2], flat[:, 1], atol=1e-12)
    around = np.unwrap(np.arctan2(local[:, 1], local[:, 0]))
    np.testing.assert_allclose((around - around[0]) * curve.radius, flat[:, 0] - flat[0, 0], atol=1e-9)
    # What points outwards at the start does so everywhere.
    R, normals = curve.rotation(FINE), local * [1, 1, 0] @ curve.X_WC[:3, :3].T / curve.radius
    in_tool = np.einsum("nji,nj->ni", R, normals)
    np.testing.assert_allclose(in_tool, np.tile(in_tool[0], (len(R), 1)), atol=1e-12)
    along = R.transpose(0, 2, 1) @ curve.X_WC[:3, 2]
    np.testing.assert_allclose(along, np.tile(along[0], (len(R), 1)), atol=1e-12)


@CURVES
@pytest.mark.parametrize("halvings", [0, 2])
def test_what_interpolation_misses_of_the_timed_pose_is_bounded(
    make: type, halvings: int, rng: np.random.Generator
) -> None:
    """Also where it misses much."""
    path = path_of(make(rng), turn=np.array([0.2, 0.1, -0.5]))
    whole = np.array([0.0, path.duration])
    at_rest = QuinticTrajectory(t=whole, q=np.zeros((2, 1)), v=np.zeros((2, 1)), a=np.zeros((2, 1)))
    breaks = path.breaks
    for _ in range(halvings):
        breaks = np.sort(np.concatenate([breaks, 0.5 * (breaks[1:] + breaks[:-1])]))
    pieces = Pieces.between(at_rest, breaks)
    missed, size = timed_pose_bounds(path, pieces)
    turned = pieces.remainder(size)
    nodes = np.cos(np.pi * np.arange(13)[::-1] / 12)
    fine = np.linspace(-1, 1, 101)
    between = np.polynomial.chebyshev.chebvander(fine, 12) @ np.linalg.inv(
        np.polynomial.chebyshev.chebvander(nodes, 12)
    )
    for k, (start, end) in enumerate(zip(pieces.start, pieces.end, strict=True)):
        times = np.clip(start + 0.5 * (fine + 1) * (end - start), start + 1e-12, end - 1e-12)
        at, now = path.poses(np.clip(pieces.times[k], start + 1e-12, end - 1e-12)), path.poses(times)
        off = np.linalg.norm(between @ at.point - now.point, axis=1)
        assert off.max() <= missed[k] + 1e-9
        apart = between @ at.rotation.reshape(13, 9) - now.rotation.reshape(-1, 9)
        assert np.linalg.norm(apart.reshape(-1, 3, 3), ord=2, axis=(1, 2)).max() <= turned[k] + 1e-9


@FLAT
def test_between_breaks_angles_and_turns_are_polynomials_that_say_where_the_tool_is(
    make: type, rng: np.random.Generator
) -> None:
    """What the enclosures of a certificate rest on."""
    path = path_of(make(rng), turn=np.array([0.2, 0.1, -0.5]))
    whole = np.array([0.0, path.duration])
    at_rest = QuinticTrajectory(t=whole, q=np.zeros((2, 1)), v=np.zeros((2, 1)), a=np.zeros((2, 1)))
    pieces = Pieces.between(at_rest, path.breaks)
    assert len(pieces.start) > 12
    times, at = pieces.times.ravel(), np.repeat(pieces.middle, pieces.times.shape[1])
    turn = path.turn(times, at)
    angle, radius = path.arc_angle(times, at)
    for values in (turn, angle[:, None], np.where(radius > 0, 0.0, path.position(times).T).T):
        # Of degree 9 at most: the last of the 13 Chebyshev coefficients are nothing.
        k = pieces.times.shape[1]
        by_piece = values.reshape(len(pieces.start), k, -1)
        x = np.cos(np.pi * np.arange(k)[::-1] / (k - 1))
        fit = np.polynomial.chebyshev.chebvander(x, 9)
        for piece in by_piece:
            left = piece - fit @ np.linalg.lstsq(fit, piece, rcond=None)[0]
            np.testing.assert_allclose(left, 0.0, atol=1e-9)
    R = path.poses(times).rotation.reshape(len(pieces.start), -1, 3, 3)
    turned = Rotation.from_rotvec(turn).as_matrix().reshape(R.shape)
    between = R[:, [0]].transpose(0, 1, 3, 2) @ R
    angles = Rotation.from_matrix(between.reshape(-1, 3, 3)).magnitude()
    own = turned[:, [0]].transpose(0, 1, 3, 2) @ turned
    np.testing.assert_allclose(angles, Rotation.from_matrix(own.reshape(-1, 3, 3)).magnitude(), atol=1e-7)


@CURVES
def test_tangents_bend_no_more_than_they_say(make: type, rng: np.random.Generator) -> None:
    path = path_of(make(rng))
    t = np.sort(np.concatenate([path.breaks, rng.uniform(0, path.duration, 30)]))
    t = t[np.append(np.diff(t) > 1e-6, True)]
    start, end = t[:-1], t[1:]
    bound = path.bend(start, end)
    middle = path.leg_directions(0.5 * (start + end))
    for share in np.linspace(1e-6, 1 - 1e-6, 21):
        now = path.leg_directions(start + share * (end - start))
        assert (np.linalg.norm(now - middle, axis=1) <= bound + 1e-6).all()


@CURVES
def test_offsets_are_across_the_timed_tangent(make: type, rng: np.random.Generator) -> None:
    path = path_of(make(rng))
    t = rng.uniform(1.01, 3.99, 40)
    p = path.position(t) + 1e-3 * rng.normal(size=(40, 3))
    offset, along = path.leg_offset(t, p), path.leg_directions(t)
    np.testing.assert_allclose(np.einsum("nd,nd->n", offset, along), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.cross(offset, along), np.cross(p - path.position(t), along), atol=1e-15)
    assert path.is_curved(t).all()
    assert not path.is_curved([0.5, 4.5]).any()


def test_wild_points_have_a_spline_too(rng: np.random.Generator) -> None:
    curve = Spline(rng.normal(size=(7, 3)))
    at = np.concatenate([[0.0], curve.breaks, [1.0]])
    np.testing.assert_allclose(curve.position(at), curve.points, atol=1e-12)
    assert np.isfinite(curve.length)


@settings(max_examples=30)
@given(
    seed=seeds, make=st.sampled_from([arc, spline, blend, rolled]), uneven=st.sampled_from([0.1, 0.4, 1.0])
)
def test_tangents_turn_by_no_more_than_is_said(seed: int, make: Any, uneven: float) -> None:
    """Between any two shares; along an arc by exactly that, and along a smooth spline by nearly."""
    rng = np.random.default_rng(seed)
    curve = make(rng, uneven) if make is spline else make(rng)
    tangent, said = curve.tangent(FINE), curve.turned(FINE)
    for step in (1, 7, 100, 2000):
        chord = np.linalg.norm(tangent[step:] - tangent[:-step], axis=1)
        turned = 2 * np.arcsin(np.minimum(0.5 * chord, 1.0))
        assert (turned <= said[step:] - said[:-step] + 1e-7).all()
    path = 2 * np.arcsin(0.5 * np.linalg.norm(np.diff(tangent, axis=0), axis=1)).sum()
    if make is arc:
        assert said[-1] == pytest.approx(path, rel=1e-6)
    if make is spline and uneven == 0.1:
        assert said[-1] <= 3 * path


@settings(max_examples=50)
@given(seed=seeds)
def test_a_spline_stays_near_its_points(seed: int) -> None:
    """Also where their distances differ several times over."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(0.03 * rng.normal(size=(7, 3)) + [0.1, 0, 0], axis=0)
    p = Spline(points).position(FINE)
    away = np.linalg.norm(p[::20, None] - points, axis=2).min(axis=1)
    assert away.max() <= np.linalg.norm(np.diff(points, axis=0), axis=1).max()
