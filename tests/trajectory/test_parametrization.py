"""Splines by their unknowns: exact derivatives, exact C3, via-points that stay on their manifolds."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pytest
from finite_differences import check_curvature, check_derivative
from quadrature import gauss_points

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError, OptimisationFailed
from cmbot.trajectory.local_basis import SparseSplines
from cmbot.trajectory.parametrization import Parametrization
from cmbot.trajectory.quintic import QuinticTrajectory
from cmbot.trajectory.spline_space import SplineSpace

N, D = 8, 3
BOUNDS = np.array([[1.0, 1.5, 2.0], [3.0, 2.0, 4.0], [6.0, 5.0, 4.0]])


@dataclass(frozen=True)
class Spheres:
    """Via-points (n, 3) on spheres of radius 1 around `centres` (n, 3)."""

    centres: FloatArray

    def tangents(self, q: FloatArray) -> FloatArray:
        return np.linalg.svd((q - self.centres)[:, None, :])[2][:, 1:]

    def retract(
        self, q: FloatArray, tangents: FloatArray, u: FloatArray, which: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        c = self.centres[which]
        normal = q[which] - c
        left = 1 - (u**2).sum(axis=1, keepdims=True)
        if (left <= 0).any():
            raise OptimisationFailed("off the sphere", constraint="sphere", violation=float(-left.min()))
        height = np.sqrt(left)
        moved = c + np.einsum("ka,kai->ki", u, tangents) + height * normal
        return moved, tangents - (u / height)[:, :, None] * normal[:, None, :]

    def part(self, first: int, last: int) -> Self:
        return replace(self, centres=self.centres[first : last + 1])

    def check(self, q: FloatArray) -> None:
        np.testing.assert_allclose(np.linalg.norm(q - self.centres, axis=1), 1.0, rtol=0, atol=1e-12)


def space_of(n: int, rng: np.random.Generator) -> SplineSpace:
    return SplineSpace(np.cumsum(rng.uniform(0.3, 0.6, n)))


def form_of(kind: str, n: int = N) -> Parametrization:
    """Splines that are not those of least jerk."""
    rng = np.random.default_rng(1)
    splines = SparseSplines(space_of(n, rng), BOUNDS)
    centres = rng.normal(size=(n, D))
    normal = np.array([0.0, 0.0, 1.0]) + 0.2 * rng.normal(size=(n, D))
    via_points = centres + normal / np.linalg.norm(normal, axis=1, keepdims=True)
    wild = 0.1 * splines.unit * rng.normal(size=splines.unit.shape)
    return Parametrization(
        splines,
        via_points,
        splines.least_jerk(via_points) + wild,
        retraction=None if kind == "fixed" else Spheres(centres),
        movable=np.arange(1, n) if kind == "pinned" else None,
    )


@pytest.fixture(scope="module", params=["fixed", "free", "pinned"])
def form(request: pytest.FixtureRequest) -> Parametrization:
    return form_of(request.param)


def step(form: Parametrization, rng: np.random.Generator, size: float = 1.0) -> FloatArray:
    return np.asarray(size * rng.normal(size=form.dimension))


def times_in(form: Parametrization, rng: np.random.Generator, number: int) -> FloatArray:
    return rng.uniform(form.space.t[0], form.space.t[-1], number)


def check_c3_at_rest(trajectory: QuinticTrajectory) -> None:
    for order in range(4):
        scale = np.abs(trajectory.extrema(order).value).max()
        assert np.abs(trajectory.jumps(order)).max() < 1e-11 * scale
        if order > 0:
            assert np.abs(trajectory.evaluate(trajectory.t[[0, -1]], order)).max() < 1e-11 * scale


@pytest.mark.parametrize("n", [5, 6, 9, 30])
def test_local_splines_reach_every_spline_once(n: int, rng: np.random.Generator) -> None:
    space = space_of(n, rng)
    splines = SparseSplines(space, BOUNDS)
    q = rng.normal(size=(n, D))
    least = space.least_jerk(q)
    z = splines.columns @ np.vstack([splines.least_jerk(q), q])
    np.testing.assert_allclose(z / space.unit[:, None], least / space.unit[:, None], rtol=0, atol=1e-10)
    assert np.linalg.matrix_rank(splines.columns.toarray() / space.unit[:, None]) == 2 * n - 4
    trajectory = space.trajectory(splines.columns @ np.vstack([rng.normal(size=(n - 4, D)), q]))
    np.testing.assert_array_equal(trajectory.q, q)
    check_c3_at_rest(trajectory)


def test_each_spline_lives_on_four_segments(rng: np.random.Generator) -> None:
    splines = SparseSplines(space_of(12, rng), BOUNDS)
    for column, spline in enumerate(splines.columns.toarray().T):
        segments = np.flatnonzero((splines.support == column).any(axis=1))
        assert np.ptp(np.unique(np.flatnonzero(spline) // 3)) <= 4
        assert np.ptp(segments) < 4


def test_rows_are_the_splines_and_their_derivatives(rng: np.random.Generator) -> None:
    space = space_of(9, rng)
    splines = SparseSplines(space, BOUNDS)
    times = np.append(rng.uniform(space.t[0], space.t[-1], 20), space.t)
    rows = splines.rows(times)
    for order in range(4):
        got = np.zeros((len(times), splines.columns.shape[1] + 1))
        # What fills up ends in the last column.
        np.add.at(got, (np.arange(len(times))[:, None], splines.support[rows.segment]), rows.weight[:, order])
        expected = (space.design(times, order) @ splines.columns).toarray()
        np.testing.assert_allclose(got[:, :-1], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
        assert not got[:, -1].any()


@pytest.mark.parametrize(("room", "accuracy"), [(1.0, 0.05), (1e6, 0.12)])
def test_a_unit_uses_up_a_bound(room: float, accuracy: float) -> None:
    """Or moves a joint by 0.02 rad, where bounds leave room for that."""
    splines = SparseSplines(SplineSpace(np.linspace(0, 5, 12)), room * BOUNDS)
    bounds = (np.full(D, 0.02), *room * BOUNDS)
    for number in range(splines.count):
        u = np.zeros((splines.columns.shape[1], D))
        u[number] = splines.unit[number]
        trajectory = splines.space.trajectory(splines.columns @ u)
        shares = [trajectory.extrema(k).largest()[0] / bound for k, bound in enumerate(bounds)]
        assert np.max(shares, axis=0) == pytest.approx(np.ones(D), rel=accuracy)


def test_least_jerk_and_its_adjoint(rng: np.random.Generator) -> None:
    splines = SparseSplines(space_of(9, rng), BOUNDS)
    q, g = rng.normal(size=(9, D)), rng.normal(size=(5, D))
    assert np.sum(splines.least_jerk(q) * g) == pytest.approx(np.sum(q * splines.least_jerk_adjoint(g)))


def test_steps_keep_the_smoothness_and_the_manifolds(form: Parametrization, rng: np.random.Generator) -> None:
    moved = form.step(step(form, rng, 0.5))
    check_c3_at_rest(moved.trajectory)
    np.testing.assert_array_equal(moved.trajectory.q, moved.via_points)
    still = (moved.via_points == form.via_points).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(~still), form.movable)
    if isinstance(form.retraction, Spheres):
        form.retraction.check(moved.via_points)
    assert form.displacements == 2 * len(form.movable)
    assert form.dimension == D * (N - 4) + form.displacements
    assert form.step(np.zeros(form.dimension)) is form


def test_a_manifold_that_ends_is_said(rng: np.random.Generator) -> None:
    form = form_of("free")
    with pytest.raises(OptimisationFailed, match="off the sphere"):
        form.step(np.full(form.dimension, 10.0))


def test_step_jacobian(form: Parametrization, rng: np.random.Generator) -> None:
    """Far from the tangents, and at zero, where it is the map."""

    def u(x: FloatArray) -> FloatArray:
        moved = form.step(x)
        return np.vstack([moved.coefficients, moved.via_points]).ravel()

    for x in (step(form, rng, 0.5), np.zeros(form.dimension)):
        check_derivative(u, x, form.step_jacobian(x), rtol=1e-8)
    np.testing.assert_array_equal(form.step_jacobian(0 * x), form.map.toarray())


def test_jacobians_and_gradients(form: Parametrization, rng: np.random.Generator) -> None:
    times = times_in(form, rng, 5)
    rows, weights = form.splines.rows(times), rng.normal(size=(4, 5, D))
    for orders in (1, 3, 4):

        def combined(x: FloatArray, orders: int = orders) -> FloatArray:
            derivatives = form.step(x).trajectory.derivatives(times, tuple(range(orders)))
            return np.sum(weights[:orders] * np.stack(derivatives), axis=(0, 2))

        got = form.jacobian(rows, weights[:orders])
        check_derivative(combined, np.zeros(form.dimension), got.toarray(), rtol=1e-7)
        pulled = form.map.T @ form.pullback(rows, weights[:orders])
        np.testing.assert_allclose(got.sum(axis=0), pulled, rtol=0, atol=1e-12 * np.abs(pulled).max())


def test_rows_of_one_joint_have_entries_for_that_joint_alone(rng: np.random.Generator) -> None:
    form = form_of("fixed")
    by_state = np.zeros((4, D, D))
    by_state[2, np.arange(D), np.arange(D)] = 1.0
    J = form.jacobian(form.splines.rows(times_in(form, rng, D)), by_state)
    row, column = J.tocoo().coords
    joint = np.nonzero(form.coefficient_index == np.arange(form.dimension)[:, None, None])[2]
    np.testing.assert_array_equal(joint[column], row)


def test_no_rows_make_an_empty_jacobian_and_no_curvature(form: Parametrization) -> None:
    rows = form.splines.rows(np.empty(0))
    assert form.jacobian(rows, np.empty((4, 0, D))).shape == (0, form.dimension)
    assert form.hessian(rows, np.empty((0, 3 * D, 3 * D))).nnz == 0


def test_curvatures_are_what_jacobians_make_of_them(form: Parametrization, rng: np.random.Generator) -> None:
    rows = form.splines.rows(times_in(form, rng, 3))
    M = rng.normal(size=(3, 3 * D, 3 * D))
    each = np.eye(3 * D).reshape(3 * D, 3, 1, D).repeat(3, 2)
    states = np.stack([form.jacobian(rows, by_state).toarray() for by_state in each], axis=1)
    expected = (states.transpose(0, 2, 1) @ M @ states).sum(axis=0)
    got = form.hessian(rows, M).toarray()
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_unknowns_are_sorted_along_the_path(form: Parametrization) -> None:
    index = np.sort(np.concatenate([form.coefficient_index.ravel(), form.displacement_index.ravel()]))
    np.testing.assert_array_equal(index, np.arange(form.dimension))
    block = np.searchsorted(form.block_ends, np.arange(form.dimension), side="right")
    assert form.block_ends[-1] == form.dimension
    number = np.broadcast_to(np.arange(N - 4)[:, None], form.coefficient_index.shape)
    np.testing.assert_array_equal(block[form.coefficient_index], number)
    H = form.smoothing_hessian.tocoo()
    assert np.abs(block[H.coords[0]] - block[H.coords[1]]).max() <= 3


def test_smoothing(form: Parametrization, rng: np.random.Generator) -> None:
    def smoothing(x: FloatArray) -> float:
        return form.step(x).smoothing()[0]

    value, gradient = form.smoothing()
    check_derivative(smoothing, np.zeros(form.dimension), form.map.T @ gradient, step=1e-2, rtol=1e-6)
    H = form.smoothing_hessian + form.bend_hessian(gradient)
    check_curvature(smoothing, H, rng.normal(size=(3, form.dimension)), step=1e-2, rtol=1e-4)
    times, share = gauss_points(form.space.t, 5)
    speed, jerk = (form.trajectory.evaluate(times, order) / BOUNDS[order - 1] for order in (1, 3))
    assert value == pytest.approx(0.5 * share @ (jerk**2 + speed**2).mean(axis=1), rel=1e-10)


def test_hessian_of_a_function_of_the_states(form: Parametrization, rng: np.random.Generator) -> None:
    """Of sums of sines of the states: curvature by the states, and what is due to bends."""
    times = times_in(form, rng, 4)
    w = rng.normal(size=(3, 4, D))

    def value(x: FloatArray) -> float:
        return float(np.sum(w * np.sin(form.step(x).trajectory.states(times))))

    rows, states = form.splines.rows(times), np.stack(form.trajectory.states(times))
    curvature = np.zeros((4, 3 * D, 3 * D))
    diagonal = np.arange(3 * D)
    curvature[:, diagonal, diagonal] = (-w * np.sin(states)).transpose(1, 0, 2).reshape(4, -1)
    gradient = form.pullback(rows, w * np.cos(states))
    H = form.hessian(rows, curvature) + form.bend_hessian(gradient)
    check_curvature(value, H, rng.normal(size=(3, form.dimension)), step=3e-3, rtol=1e-5)


def test_tangents_stay_what_they_were_as_far_as_they_can() -> None:
    form = form_of("free")
    x = np.zeros(form.dimension)
    x[form.displacement_index] = 0.1
    one = form.step(x)
    first, second = one.via_points - form.via_points, one.step(x).via_points - one.via_points
    cosine = np.sum(first * second, axis=1) / np.linalg.norm(first, axis=1) / np.linalg.norm(second, axis=1)
    assert cosine.min() > 0.99


@pytest.mark.parametrize(("first", "last"), [(0, 6), (4, 9), (3, 13), (0, 13)])
@pytest.mark.parametrize("kind", ["fixed", "free", "pinned"])
def test_segments(kind: str, first: int, last: int, rng: np.random.Generator) -> None:
    """Splines of least jerk between two via-points, of which those inside the path stay."""
    whole = form_of(kind, 14)
    segment = whole.segment(first, last)
    np.testing.assert_array_equal(segment.space.t, whole.space.t[first : last + 1])
    np.testing.assert_array_equal(segment.via_points, whole.via_points[first : last + 1])
    least = segment.space.trajectory(segment.space.least_jerk(segment.via_points))
    np.testing.assert_allclose(segment.trajectory.v, least.v, rtol=0, atol=1e-10)
    np.testing.assert_allclose(segment.trajectory.a, least.a, rtol=0, atol=1e-9)
    stays = {k for k in (first, last) if 0 < k < 13} | ({0} if kind == "pinned" else set())
    moves = [] if kind == "fixed" else [k - first for k in range(first, last + 1) if k not in stays]
    assert list(segment.movable) == moves
    moved = segment.step(step(segment, rng, 0.3))
    check_c3_at_rest(moved.trajectory)
    if isinstance(whole.retraction, Spheres):
        whole.retraction.part(first, last).check(moved.via_points)


def test_a_segment_has_five_knots() -> None:
    with pytest.raises(InputError, match="5 or more increasing times"):
        form_of("free").segment(0, 3)
