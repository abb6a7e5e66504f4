"""The SQP on made-up programs: the merit falls step by step, and the end is stationary."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from scipy import sparse

from cmbot.common.arrays import FloatArray
from cmbot.optimization import sqp
from cmbot.optimization.qp import NlpModel, NlpValues, solve_qp
from cmbot.optimization.sqp import SqpOptions, SqpStatus

ENDED = (SqpStatus.CONVERGED, SqpStatus.STALLED)
starts = st.lists(st.floats(-3, 3), min_size=2, max_size=5)


@dataclass(frozen=True)
class Ripples:
    """A made-up problem with curved constraints: ``min max_k c_k + f, d(x) <= 0``."""

    x: FloatArray
    steepness: float

    @cached_property
    def model(self) -> NlpModel:
        x, n = self.x, len(self.x)
        value = np.concatenate([np.cos(self.steepness * x) + x**2, [x @ x - 4.0, 0.2 - x[0]]])
        slopes = np.diag(2 * x - self.steepness * np.sin(self.steepness * x))
        jacobian = np.vstack([slopes, 2 * x, -np.eye(n)[0]])
        return NlpModel(
            objective=float(np.sum((x - 1) ** 4)),
            gradient=4 * (x - 1) ** 3,
            hessian=sparse.csr_array((n, n)),
            value=value,
            jacobian=sparse.csr_array(jacobian),
            family=np.append(np.zeros(n, dtype=np.intp), [1, 1]),
            epigraph=True,
            cut_value=np.empty(0),
            cut_jacobian=sparse.csr_array((0, n)),
            cut_family=np.empty(0, dtype=np.intp),
        )

    @property
    def values(self) -> NlpValues:
        return self.model

    def hessian(self, multipliers: FloatArray) -> sparse.csr_array:
        curvature = 12 * (self.x - 1) ** 2 + 2 * multipliers.sum() + 1e-6
        return sparse.csr_array(np.diag(curvature))

    def displaced(self, p: FloatArray) -> Self:
        return replace(self, x=self.x + p)

    def separated(self) -> Self:
        return self

    def refresh(self, other: Self) -> Self:
        return self

    def drop_constraints(self, multipliers: FloatArray) -> tuple[Self, FloatArray]:
        return self, multipliers


def solve_sqp(start: Ripples, penalty: float = 0.1, max_iterations: int = 200) -> sqp.SqpResult[Any]:
    options = SqpOptions(
        initial_penalty=penalty,
        optimality_tolerance=1e-9,
        feasibility_tolerance=1e-7,
        max_iterations=max_iterations,
    )
    return sqp.solve_sqp(start, 2, options)


@settings(max_examples=30)
@given(x=starts, steepness=st.floats(0, 8), penalty=st.sampled_from([0.1, 10.0]))
def test_every_step_lowers_the_merit(x: list[float], steepness: float, penalty: float) -> None:
    start = Ripples(np.array(x), steepness)
    ended = solve_sqp(start, penalty)
    assert all(after < before for _, before, after in ended.merits)
    penalties = [float(penalty[1]) for penalty, _, _ in ended.merits]
    assert penalties == sorted(penalties)
    assert ended.iterations <= 200
    assert ended.status not in ENDED or ended.iterate.model.violation <= 1e-7
    assert ended.iterate.model.merit(ended.penalty) <= start.model.merit(ended.penalty)


@settings(max_examples=20)
@given(x=starts, steepness=st.floats(0, 4))
@example(x=[1.0, -3.0], steepness=3.31640625)  # ends where no short step is accepted
def test_the_end_is_stationary(x: list[float], steepness: float) -> None:
    """Karush-Kuhn-Tucker, with the multipliers that it ended with."""
    ended = solve_sqp(Ripples(np.array(x), steepness))
    if ended.status is not SqpStatus.CONVERGED:
        return
    first, z = ended.iterate.model, ended.multipliers
    assert z.min() >= 0
    assert z[first.in_epigraph].sum() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(first.gradient + first.jacobian.T @ z, 0, rtol=0, atol=1e-3)
    slack = first.value - np.where(first.in_epigraph, first.peak, 0.0)
    np.testing.assert_allclose(z * slack, 0, rtol=0, atol=1e-4)


@settings(max_examples=20)
@given(x=starts, steepness=st.floats(0, 4))
@example(x=[3.0, 3.0], steepness=0.0)
def test_where_feasible_is_enough_it_ends_at_the_first_such_iterate(x: list[float], steepness: float) -> None:
    start = Ripples(np.array(x), steepness)
    whole, options = solve_sqp(start), SqpOptions(feasibility_tolerance=1e-7, feasible_only=True)
    ended = sqp.solve_sqp(start, 2, options)
    if start.model.violation <= 1e-7:
        assert (ended.status, ended.iterations) == (SqpStatus.FEASIBLE, 0)
    elif ended.status is SqpStatus.FEASIBLE:
        assert ended.iterate.model.violation <= 1e-7 and ended.iterations > 0
        short = sqp.solve_sqp(start, 2, replace(options, max_iterations=ended.iterations - 1))
        assert short.iterate.model.violation > 1e-7
    else:
        assert whole.status not in ENDED


def test_a_step_is_no_longer_than_the_radius_and_shorter_with_damping() -> None:
    start = Ripples(np.array([2.0, -1.0]), 1.0)
    model = replace(start.model, hessian=start.hessian(np.ones(4)))
    penalty = np.ones(2)
    for radius in (1e-3, 0.5):
        step = solve_qp(model, penalty, radius)
        assert step.solved
        assert np.abs(step.p).max() == pytest.approx(radius)
        assert model.after(step.p, penalty) < model.merit(penalty)
    lengths = [np.linalg.norm(solve_qp(model, penalty, 10.0, damping).p) for damping in (0.0, 10.0, 1e3)]
    assert lengths[0] > lengths[1] > lengths[2] > 0


@dataclass(frozen=True)
class Veiled(Ripples):
    """Only some of the constraints are known: those that some point so far violated."""

    known: tuple[int, ...] = field(default=())

    @cached_property
    def model(self) -> NlpModel:
        given, rows = super().model, [*range(len(self.x)), *self.known]
        return replace(
            given, value=given.value[rows], jacobian=given.jacobian[rows], family=given.family[rows]
        )

    @property
    def all_of_it(self) -> NlpModel:
        return Ripples(self.x, self.steepness).model

    def separated(self) -> Self:
        value = self.all_of_it.value
        new = [k for k in range(len(self.x), len(value)) if value[k] > 0 and k not in self.known]
        return replace(self, known=(*self.known, *new))

    def refresh(self, other: Self) -> Self:
        return self if other.known == self.known else replace(self, known=other.known)


@settings(max_examples=30)
@given(x=starts, steepness=st.floats(0, 4))
def test_what_comes_into_view_on_the_way_counts(x: list[float], steepness: float) -> None:
    ended = solve_sqp(Veiled(np.array(x), steepness))
    assert all(after < before for _, before, after in ended.merits)
    if ended.status is SqpStatus.CONVERGED and ended.merits:
        assert ended.iterate.all_of_it.violation <= 1e-7


def test_what_is_promised_again_and_again_is_not_waited_for() -> None:
    options = SqpOptions(stall_tolerance=1e-3)
    state = sqp._SqpState(Ripples(np.array([1.0, 1.0]), 0.0), 2, options, None, lambda: False)
    for number in range(1, 40):
        state._gained.append(1e-5)
        for promised, steps in ((0.0, options.stall_steps), (1.0, 3 * options.stall_steps)):
            state._promised = promised
            assert (state.status is SqpStatus.STALLED) == (number >= steps)
    state._gained[-1] = 1e-2
    assert state.status is SqpStatus.ITERATION_LIMIT


@dataclass(frozen=True)
class Rim(Ripples):
    """A way along the rim of a disc: ``min x_1, |x| <= 1``, which bends away from every straight step."""

    @cached_property
    def model(self) -> NlpModel:
        norm = float(np.linalg.norm(self.x))
        return replace(
            super().model,
            objective=float(self.x[0]),
            gradient=np.array([1.0, 0.0]),
            value=np.array([norm - 1.0]),
            jacobian=sparse.csr_array(self.x[None] / norm),
            family=np.ones(1, dtype=np.intp),
            epigraph=False,
        )

    def hessian(self, multipliers: FloatArray) -> sparse.csr_array:
        """Nothing of what bends: corrections have to do."""
        return sparse.csr_array(1e-3 * np.eye(2))


def test_a_step_along_a_curved_bound_is_corrected_not_crept() -> None:
    ended = solve_sqp(Rim(np.array([0.6, 0.8]), 0.0), penalty=10.0, max_iterations=8)
    assert ended.iterate.x[0] == pytest.approx(-1.0, abs=1e-3)
    assert ended.iterate.model.violation <= 1e-6


@pytest.mark.parametrize("angle", [0.1, 0.5, 2.0])
def test_where_only_violations_are_left_steps_are_shortened(angle: float) -> None:
    """Of what bends a step misses its square. Nothing is corrected here, and every step accepted."""
    lax = {"max_corrections": 0, "accept": -1e6, "shrink": -1e6, "initial_radius": 0.3, "expand": np.inf}
    little = SqpOptions(stall_steps=3, stall_tolerance=10.0, stall_promise=10.0, max_iterations=12, **lax)
    start = Rim(np.array([np.cos(angle), np.sin(angle)]), 0.0)
    ended = sqp.solve_sqp(start, 2, little)
    assert ended.status is SqpStatus.STALLED
    assert ended.iterate.model.violation <= little.feasibility_tolerance
    much = sqp.solve_sqp(start, 2, replace(little, stall_tolerance=0.0))
    assert much.iterate.model.violation > 1e3 * little.feasibility_tolerance


def test_a_step_that_lowers_violations_is_feasible(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever comes of the program that weighs nothing else: it may stay unsolved."""
    start = Ripples(np.array([3.0, -3.0]), 1.0)
    state = sqp._SqpState(start, 2, SqpOptions(), None, lambda: False)
    model = replace(start.model, hessian=state.hessian)
    step = state.steered(model)
    none = replace(step, p=np.zeros(2), solved=False)
    monkeypatch.setattr(sqp, "solve_qp", lambda *_, **__: none)
    assert not state._is_infeasible(model, step)
    assert state._is_infeasible(model, none)


def test_what_cannot_be_met_is_said() -> None:
    """Both d(x) <= 0 and -d(x) <= -1: no penalty helps."""

    @dataclass(frozen=True)
    class Torn(Ripples):
        @cached_property
        def model(self) -> NlpModel:
            given = super().model
            last = sparse.csr_array(given.jacobian[-1:] * -1)
            return replace(
                given,
                value=np.append(given.value, 1.0 - given.value[-1]),
                jacobian=sparse.csr_array(sparse.vstack([given.jacobian, last])),
                family=np.append(given.family, 1),
            )

    ended = solve_sqp(Torn(np.array([1.0, 1.0]), 0.0))
    assert ended.status is SqpStatus.INFEASIBLE
    assert ended.iterate.model.violation == pytest.approx(0.5, rel=0.12)
    # As soon as so many steps have not lowered it.
    start = Torn(np.array([2.0, -1.0]), 0.0)
    few, many = (sqp.solve_sqp(start, 2, SqpOptions(stay_steps=n, max_penalty=1e12)) for n in (2, 5))
    assert few.status is many.status is SqpStatus.INFEASIBLE
    assert many.iterations - few.iterations == 3
    assert few.iterate.model.violation == pytest.approx(0.5, rel=1e-6)


def test_a_warm_start_goes_on_where_the_last_run_ended() -> None:
    start = Ripples(np.array([2.0, -1.0]), 1.0)
    first = solve_sqp(start)
    assert first.status is SqpStatus.CONVERGED
    again = sqp.solve_sqp(first.iterate, 2, SqpOptions(optimality_tolerance=1e-9), first)
    assert again.status is SqpStatus.CONVERGED
    assert again.iterations < first.iterations
    assert (again.penalty <= first.penalty).all()


def test_the_iteration_limit_is_said() -> None:
    assert solve_sqp(Ripples(np.array([2.0, -1.0]), 3.0), max_iterations=1).status is (
        SqpStatus.ITERATION_LIMIT
    )
