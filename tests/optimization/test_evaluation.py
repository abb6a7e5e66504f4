"""Iterates of a solver: exact derivatives, constraints that follow a step, and sets that drop constraints."""

from functools import cache

import numpy as np
import pytest
from finite_differences import check_curvature, check_derivative
from quadrature import gauss_points
from small_scenes import torque_problem

from cmbot.common.arrays import FloatArray
from cmbot.optimization import evaluation
from cmbot.optimization.constraint_set import OBJECTIVE, ConstraintSet
from cmbot.optimization.evaluation import NlpEvaluation, Stage
from cmbot.optimization.linearization import families_of, linearize
from cmbot.optimization.program import StateSamples
from cmbot.optimization.separation import find_violations
from cmbot.planning.torque.problem import TorqueProblem

PEAK = Stage(smoothing=0.1, tolerance=1e-5)
MEAN = Stage(smoothing=0.1, bound=0.9, tolerance=1e-5)
# Families of the torque problem: objective, three functions of the state, four bounds.
TORQUE, DEVIATION, CLEARANCE, LAG, ROTATION, JERK = 1, 2, 3, 4, 5, 9
TIMES = np.array([0.4, 1.7, 3.1])


@pytest.fixture(scope="module", params=["fixed", "free", "pinned"])
def problem(request: pytest.FixtureRequest) -> TorqueProblem:
    return torque_problem(request.param)


def step_of(problem: TorqueProblem, rng: np.random.Generator, size: float = 1.0, *number: int) -> FloatArray:
    return size * rng.normal(size=(*number, problem.parametrization.dimension))


def constraints_of(problem: TorqueProblem) -> ConstraintSet:
    """Some of every family."""
    joints = np.array([2, 5, 9])
    some = ConstraintSet(step=0.01).at_all([OBJECTIVE, DEVIATION, LAG, ROTATION], TIMES)
    for family in (TORQUE, *range(6, 10)):
        some = some.extended(np.full(3, family), joints, TIMES)
    tool = next(k for k, pair in enumerate(problem.request.cell.clearances.pairs) if pair.link == "tool")
    return some.extended(np.full(3, CLEARANCE), np.full(3, tool), TIMES)


def iterate(problem: TorqueProblem, stage: Stage, rng: np.random.Generator) -> NlpEvaluation:
    """Beside the initial guess, where the tool is off its path."""
    form = problem.parametrization.step(step_of(problem, rng, 0.1))
    return NlpEvaluation.around(problem, stage, form, constraints_of(problem))


@pytest.mark.parametrize("stage", [PEAK, MEAN], ids=lambda stage: stage.name)
def test_derivatives(problem: TorqueProblem, stage: Stage, rng: np.random.Generator) -> None:
    at = iterate(problem, stage, rng)
    model, x = at.model, np.zeros(problem.parametrization.dimension)
    off = step_of(problem, rng, 0.1)
    displaced = cache(lambda step: at.displaced(np.frombuffer(step)))
    gradient, jacobian, residuals = at.displaced(off).dense(at.parametrization.step_jacobian(off))
    for point, f, c in ((x, model.gradient, model.jacobian.toarray()), (off, gradient, jacobian)):
        check_derivative(lambda y: displaced(y.tobytes()).values.objective, point, f, rtol=1e-6, atol=1e-9)
        # Torques and polynomials are smooth; the clearance's rounding bounds the rest.
        check_derivative(lambda y: displaced(y.tobytes()).values.value, point, c, rtol=1e-5, atol=1e-6)
    same = at.dense(at.parametrization.map.toarray())
    np.testing.assert_allclose(same[0], model.gradient, rtol=0, atol=1e-12)
    np.testing.assert_allclose(same[1], model.jacobian.toarray(), rtol=0, atol=1e-12)
    if stage.bound is None:
        assert residuals.shape == (0, len(x))
        return

    def all_residuals(y: FloatArray) -> FloatArray:
        parts = problem.mean_residuals(displaced(y.tobytes()).parametrization.trajectory)
        return np.concatenate([part.value for part in parts])

    check_derivative(all_residuals, off, residuals, rtol=1e-6)


def test_values_are_those_of_their_definitions(problem: TorqueProblem, rng: np.random.Generator) -> None:
    peak, mean = (iterate(problem, stage, np.random.default_rng(1)) for stage in (PEAK, MEAN))
    trajectory = peak.parametrization.trajectory
    torque = problem.request.cell.objective.values(StateSamples.along(trajectory, TIMES)) / problem.scale
    np.testing.assert_allclose(peak.values.value[:3], torque, rtol=1e-10)
    assert peak.peak == mean.peak == peak.values.peak == pytest.approx(torque.max())
    # Where the mean square is minimised the peak is one of the constraints.
    np.testing.assert_allclose(mean.values.value[:3], peak.values.value[:3] - 0.9, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(mean.values.value[3:], peak.values.value[3:])
    assert mean.values.peak == 0.0
    assert mean.values.violation == mean.values.value.max() > 0
    assert peak.values.violation == peak.values.value[3:].max(initial=0.0)
    times, share = gauss_points(problem.space.t, 3)
    np.testing.assert_allclose(problem.mean_times, times, rtol=1e-14)
    f = problem.request.cell.objective.values(StateSamples.along(trajectory, times)) / problem.scale
    smoothing = 0.1 * peak.parametrization.smoothing()[0]
    assert peak.values.objective == pytest.approx(smoothing)
    assert mean.values.objective == pytest.approx(smoothing + 0.5 * share @ f**2)
    target = Stage(smoothing=0.1, target=5.0, tolerance=1e-5)
    assert NlpEvaluation.around(problem, target, peak.parametrization, peak.constraints).values.peak == 5.0


@pytest.mark.parametrize("family", [OBJECTIVE, TORQUE, DEVIATION, JERK])
def test_hessian_of_the_constraints(
    problem: TorqueProblem, family: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluation, "convexified", lambda H, ends: H)
    start = iterate(problem, Stage(smoothing=0.0, tolerance=1e-5), rng)
    component = np.full(3, 0 if family in (OBJECTIVE, DEVIATION) else 5)
    times = TIMES
    if family == DEVIATION:
        # A distance bends without bound where it is nearly zero.
        states = StateSamples.along(start.parametrization.trajectory, problem.grid)
        times = problem.grid[np.argsort(-problem.constraints[1].sample(states)[0][:, 0])[[0, 5, 10]]]
    some = ConstraintSet(step=0.01).extended(np.full(3, family), component, times)
    at = NlpEvaluation.around(problem, start.stage, start.parametrization, some)
    multipliers = np.array([1.0, 2.0, 0.5])
    check_curvature(
        lambda x: float(multipliers @ at.displaced(x).values.value),
        at.hessian(multipliers),
        step_of(problem, rng, 0.1, 3),
        # The tool's deviation magnifies what Newton's method leaves of the task.
        step=4e-2 if family == DEVIATION else 1e-2,
        rtol=2e-3,
        atol=1e-6,
    )


@pytest.mark.parametrize("stage", [PEAK, MEAN], ids=lambda stage: stage.name)
def test_hessian_of_the_objective(
    problem: TorqueProblem, stage: Stage, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exact for the smoothing; of the mean square but for what Gauss and Newton leave out."""
    at = iterate(problem, stage, rng)
    multipliers = np.arange(1.0, len(at.constraints) + 1)
    H = at.hessian(multipliers).toarray()
    np.testing.assert_allclose(H, H.T, rtol=0, atol=1e-10 * np.abs(H).max())
    assert np.linalg.eigvalsh(H).min() > 0
    monkeypatch.setattr(evaluation, "convexified", lambda H, ends: H)
    check_curvature(
        lambda x: at.displaced(x).values.objective,
        at.hessian(np.zeros(len(multipliers))),
        step_of(problem, rng, 1.0, 3),
        step=1e-3,
        rtol=1e-4 if stage is PEAK else 0.05,
    )


def test_cuts_never_exceed_their_function(problem: TorqueProblem, rng: np.random.Generator) -> None:
    """And go with the constraints that they belong to."""
    at = iterate(problem, PEAK, rng)
    model, cuts = at.model, at.at.cut_of
    assert len(cuts) == 7 * 3
    assert (model.cut_family == DEVIATION).all()
    assert (model.family[cuts] == DEVIATION).all()
    assert (model.cut_value <= model.value[cuts] + 1e-12).all()
    for _ in range(5):
        p = step_of(problem, rng)
        there = at.displaced(p)
        assert (there.at.cut_value <= there.at.value[cuts] + 1e-12).all()
    which = rng.random(len(at.constraints)) < 0.6
    kept, again = (
        at.at.kept(which),
        linearize(problem, at.constraints.kept(which), at.parametrization.trajectory),
    )
    for name in ("value", "derivative", "cut_value", "cut_derivative"):
        np.testing.assert_allclose(getattr(kept, name), getattr(again, name), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(np.sort(kept.cut_of), np.sort(again.cut_of))


def test_a_step_adds_what_it_violates(problem: TorqueProblem) -> None:
    """Behind the constraints that were there, whose multipliers so stay the first."""
    some = ConstraintSet(step=0.01).at_all([OBJECTIVE, DEVIATION], TIMES)
    at = NlpEvaluation.around(problem, PEAK, problem.parametrization, some)
    trial = at.displaced(np.full(problem.parametrization.dimension, 0.5)).separated()
    K = len(at.constraints)
    assert len(trial.constraints) == len(trial.values.value) > K
    for name in ("family", "component", "time"):
        np.testing.assert_array_equal(getattr(trial.constraints, name)[:K], getattr(at.constraints, name))
    alone = at.displaced(np.full(problem.parametrization.dimension, 0.5))
    np.testing.assert_array_equal(trial.at.value[:K], alone.at.value)
    everything = linearize(problem, trial.constraints, trial.parametrization.trajectory)
    np.testing.assert_allclose(trial.at.value, everything.value, rtol=0, atol=1e-12)
    np.testing.assert_allclose(trial.at.derivative, everything.derivative, rtol=0, atol=1e-12)
    # Cuts that were there come first, so of the whole they are another order.
    assert (trial.constraints.family[K:] == DEVIATION).any()
    cuts = [np.lexsort((each.cut_value, each.cut_of)) for each in (trial.at, everything)]
    for name in ("cut_of", "cut_value"):
        got, expected = (getattr(e, name)[c] for e, c in zip((trial.at, everything), cuts, strict=True))
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)
    # All that a whole separation finds is known already, but for times that count as the same.
    trajectory = trial.parametrization.trajectory
    found = find_violations(problem, trajectory, trial.values.peak, 1e-5, 40)
    assert found.worst.value == pytest.approx(trial.values.violation, rel=1e-2)
    # The point before the step knows of them, too.
    back = at.refresh(trial)
    assert back.constraints is trial.constraints
    np.testing.assert_array_equal(back.at.value[:K], at.at.value)
    penalty = np.ones(len(families_of(problem)))
    assert back.values.merit(penalty) >= at.values.merit(penalty)
    assert back.refresh(trial) is back


def test_thinning_keeps_multipliers_and_the_worst(problem: TorqueProblem) -> None:
    dense = ConstraintSet(step=0.01).at_all([OBJECTIVE, DEVIATION], np.linspace(0.5, 3.5, 400))
    at = NlpEvaluation.around(problem, PEAK, problem.parametrization, dense)
    multipliers = np.zeros(len(dense))
    multipliers[[7, 8, 430]] = [1.0, 2.0, 3.0]
    thinner, left = at.drop_constraints(multipliers)
    assert len(left) == len(thinner.constraints) == len(thinner.values.value) < len(multipliers)
    assert sorted(left[left > 0]) == [1.0, 2.0, 3.0]
    assert thinner.values.peak == at.values.peak
    assert thinner.values.violation == at.values.violation
    again = linearize(problem, thinner.constraints, at.parametrization.trajectory)
    np.testing.assert_allclose(thinner.at.value, again.value, rtol=0, atol=1e-12)
    # Few are left alone.
    same, untouched = thinner.drop_constraints(left)
    assert same is thinner
    assert untouched is left
