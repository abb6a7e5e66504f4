"""Families of splines: every derivative against finite differences; slides keep the tool task."""

from __future__ import annotations

import numpy as np
import pytest
from cmbot.planning.torque.families import FixedKnots, SlidingKnots, WhitenedSplines
from finite_differences import check_derivative
from small_scenes import parts, problem_of, short_scene

from cmbot.robot import Postures
from cmbot.trajectory.spline_space import SplineSpace

WEIGHT = 1e-3


def family_of(kind: str) -> FixedKnots:
    scene = short_scene()
    robot, task, _, _ = parts(scene)
    problem, _, _ = problem_of(scene)
    t, via_points = problem.space.t, problem.family.via_points
    splines = WhitenedSplines(SplineSpace(t), robot.limits)
    numbers = np.random.default_rng(1).normal(size=(splines.basis.shape[1], robot.dof))
    if kind == "fixed":
        return FixedKnots(splines, via_points, numbers, WEIGHT)
    return SlidingKnots(
        splines,
        via_points,
        numbers,
        WEIGHT,
        postures=Postures(robot),
        task=task,
        points=task.path.position(t),
        pinned=kind == "pinned",
    )


@pytest.mark.parametrize("kind", ["fixed", "free", "pinned"])
def test_derivatives(kind: str, rng: np.random.Generator) -> None:
    family = family_of(kind)
    x = family.start + 0.05 * rng.normal(size=family.dimension)
    space = family.splines.space
    times = rng.uniform(0, space.t[-1], 6)
    rows = family.splines.rows(times, sliding=family.sliding)
    weights = rng.normal(size=(3, 6, 7))

    def combined(x: np.ndarray) -> np.ndarray:
        z = family.knots(x)
        return sum(np.sum(w * (space.design(times, k) @ z), axis=1) for k, w in enumerate(weights))

    check_derivative(combined, x, family.chain(x, rows, *weights), step=1e-4, rtol=1e-6, atol=1e-6)
    joint, factor = rng.integers(0, 7, 6), rng.normal(size=6)
    for order in range(4):
        check_derivative(
            lambda x, order=order: (
                factor * (space.design(times, order) @ family.knots(x))[np.arange(6), joint]
            ),
            x,
            family.chain_one(x, rows, order, joint, factor),
            step=1e-4,
            rtol=1e-6,
            atol=1e-5,
        )
    check_derivative(
        lambda x: np.atleast_1d(family.smoothing(x)[0]),
        x,
        family.smoothing(x)[1][None],
        step=1e-4,
        rtol=1e-6,
        atol=1e-7,
    )


@pytest.mark.parametrize("kind", ["free", "pinned"])
def test_slid_via_points_hold_the_tool_task(kind: str, rng: np.random.Generator) -> None:
    family = family_of(kind)
    robot, task, _, _ = parts(short_scene())
    x = family.start
    x[: family.slides] += rng.normal(size=family.slides)
    q = family.via_points_at(x)
    at = Postures(robot).at(q)
    points = task.path.position(family.splines.space.t)
    assert np.abs(task.errors(at.tool_point, at.tool_rotation, points)).max() < 1e-10
    moved = np.abs(q - family.via_points).max(axis=1)
    assert (moved[1:] > 1e-3).all()
    assert (moved[0] == 0.0) == (kind == "pinned")


@pytest.mark.parametrize("kind", ["fixed", "free", "pinned"])
def test_a_family_built_anew_is_the_same_spline(kind: str, rng: np.random.Generator) -> None:
    family = family_of(kind)
    x = family.start + 0.1 * rng.normal(size=family.dimension)
    again = family.rebuilt(x, 7.0)
    np.testing.assert_allclose(again.knots(again.start), family.knots(x), atol=1e-9)


def test_the_smoothing_term_is_the_mean_squared_jerk() -> None:
    family = family_of("free")
    x = family.start
    trajectory = family.splines.space.trajectory(family.knots(x))
    nodes, weights = np.polynomial.legendre.leggauss(4)
    t = trajectory.t
    h = np.diff(t)[:, None]
    times = (t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
    jerk = trajectory.evaluate(times, 3) / family.splines.limits.jerk
    mean = (0.5 * h * weights).ravel() @ jerk**2 / (t[-1] - t[0])
    assert family.smoothing(x)[0] == pytest.approx(0.5 * WEIGHT * mean.mean(), rel=1e-9)
