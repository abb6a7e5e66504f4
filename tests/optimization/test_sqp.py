"""The sparse solver: the merit falls step by step, and the optimum is SLSQP's."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import pytest
from cmbot.optimization.sparse_passes import SparsePasses
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse
from seven_joint_arms import panda_scene
from small_scenes import short_scene

from cmbot.cli.doctor import examine
from cmbot.common.errors import MissingExtra, OptimisationFailed
from cmbot.optimization import sqp
from cmbot.optimization.exchange import Optimised, optimise
from cmbot.optimization.qp import LocalModel, LocalValues, solve_qp
from cmbot.planning import plan
from cmbot.planning.context import build_context
from cmbot.planning.initial_guess import InitialGuess, fixed_guess, sliding_guess
from cmbot.planning.solvers import solver_of
from cmbot.planning.verification.certificate import certify
from cmbot.scene import PlannerOptions, Scene
from cmbot.trajectory.parametrization import Parametrization

FloatArray = NDArray[np.float64]
OUT_AND_BACK = [{"by": [0.1, 0, 0], "seconds": 2.5}, {"by": [-0.1, 0, 0], "seconds": 2.5}]
TIGHT = {"smoothing_weight": 1e-2, "max_tool_deviation_m": 0.01, "samples_per_segment": 20}
SLIDING = {"knots": "sliding", "chart_spacing": 0.3}
SCENES: dict[str, dict[str, Any]] = {
    "there": {},
    "there and back": {"tool_path": {"legs": OUT_AND_BACK, "via_points": 9}},
    "tight": {"tool_path": {"legs": OUT_AND_BACK, "via_points": 7}, "planner": TIGHT},
    "payload": {"robot": {"payload_kg": 3.0}},
    "sliding": {"planner": SLIDING},
    "sliding, pinned": {"planner": SLIDING | {"start": "pinned"}},
}


@dataclass(frozen=True)
class Ripples:
    """A made-up problem with curved constraints: ``min max_k c_k + f, d(x) <= 0``."""

    x: FloatArray
    steepness: float

    @cached_property
    def first(self) -> LocalModel:
        x, n = self.x, len(self.x)
        value = np.concatenate([np.cos(self.steepness * x) + x**2, [x @ x - 4.0, 0.2 - x[0]]])
        slopes = np.diag(2 * x - self.steepness * np.sin(self.steepness * x))
        jacobian = np.vstack([slopes, 2 * x, -np.eye(n)[0]])
        return LocalModel(
            objective=float(np.sum((x - 1) ** 4)),
            gradient=4 * (x - 1) ** 3,
            hessian=sparse.csr_array((n, n)),
            value=value,
            jacobian=sparse.csr_array(jacobian),
            peaks=n,
            kind=np.zeros(len(value), dtype=np.intp),
            face_value=np.empty(0),
            face_jacobian=sparse.csr_array((0, n)),
            face_kind=np.empty(0, dtype=np.intp),
        )

    @property
    def values(self) -> LocalValues:
        return self.first

    def curvature(self, multipliers: FloatArray) -> sparse.csr_array:
        curvature = 12 * (self.x - 1) ** 2 + 2 * multipliers.sum() + 1e-6
        return sparse.csr_array(np.diag(curvature))

    def moved(self, p: FloatArray) -> Self:
        return replace(self, x=self.x + p)

    def renewed(self) -> Self:
        return self

    def lifted(self, multipliers: FloatArray) -> FloatArray:
        return multipliers

    def thinned(self, multipliers: FloatArray) -> tuple[Self, FloatArray]:
        return self, multipliers


def solve_sqp(start: Ripples, penalty: float = 0.1, max_iterations: int = 200) -> sqp.Descent[Any]:
    return sqp.solve_sqp(
        start,
        np.zeros(len(start.first.value)),
        penalty=np.array([penalty]),
        damping=1e-4,
        accuracy=1e-9,
        tolerance=1e-7,
        max_iterations=max_iterations,
    )


@settings(max_examples=30)
@given(
    x=st.lists(st.floats(-3, 3), min_size=2, max_size=5),
    steepness=st.floats(0, 8),
    penalty=st.sampled_from([0.1, 10.0]),
)
def test_every_step_lowers_the_merit(x: list[float], steepness: float, penalty: float) -> None:
    start = Ripples(np.array(x), steepness)
    ended = solve_sqp(start, penalty)
    assert all(after < before for _, before, after in ended.merits)
    penalties = [float(penalty[0]) for penalty, _, _ in ended.merits]
    assert penalties == sorted(penalties)
    assert ended.iterations <= 200
    assert ended.settled <= (ended.place.first.violation <= 1e-7)
    assert ended.place.first.merit(ended.penalty) <= start.first.merit(ended.penalty)


@settings(max_examples=20)
@given(x=st.lists(st.floats(-3, 3), min_size=2, max_size=5), steepness=st.floats(0, 4))
def test_the_end_is_stationary(x: list[float], steepness: float) -> None:
    """Karush-Kuhn-Tucker, with the multipliers that it ended with."""
    ended = solve_sqp(Ripples(np.array(x), steepness))
    if not ended.settled:
        return
    first = ended.place.first
    model = replace(first, hessian=ended.place.curvature(ended.multipliers))
    z = solve_qp(model, ended.penalty, 1.0).multipliers
    assert z.min() >= 0
    assert z[: first.peaks].sum() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(first.gradient + first.jacobian.T @ z, 0, rtol=0, atol=1e-3)
    slack = np.concatenate([first.value[: first.peaks] - first.peak, first.value[first.peaks :]])
    np.testing.assert_allclose(z * slack, 0, rtol=0, atol=1e-4)


def test_a_step_is_no_longer_than_the_radius_and_shorter_with_damping() -> None:
    start = Ripples(np.array([2.0, -1.0]), 1.0)
    model = replace(start.first, hessian=start.curvature(np.ones(4)))
    penalty = np.ones(1)
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

    seen: list[int] = field(default_factory=list)
    count: int = 0

    @cached_property
    def first(self) -> LocalModel:
        given, rows = super().first, [*range(len(self.x)), *self.seen[: self.count]]
        return replace(
            given,
            value=given.value[rows],
            jacobian=given.jacobian[rows],
            kind=np.zeros(len(rows), dtype=np.intp),
        )

    @property
    def all_of_it(self) -> LocalModel:
        return Ripples(self.x, self.steepness).first

    def moved(self, p: FloatArray) -> Self:
        trial = replace(self, x=self.x + p)
        value = trial.all_of_it.value
        self.seen.extend(k for k in range(len(self.x), len(value)) if value[k] > 0 and k not in self.seen)
        return trial.renewed()

    def renewed(self) -> Self:
        return self if self.count == len(self.seen) else replace(self, count=len(self.seen))

    def lifted(self, multipliers: FloatArray) -> FloatArray:
        return np.append(multipliers, np.zeros(len(self.x) + len(self.seen) - len(multipliers)))


@settings(max_examples=30)
@given(x=st.lists(st.floats(-3, 3), min_size=2, max_size=5), steepness=st.floats(0, 4))
def test_what_comes_into_view_on_the_way_counts(x: list[float], steepness: float) -> None:
    """The merit falls with every step, whatever was overlooked; in the end nothing is violated."""
    ended = solve_sqp(Veiled(np.array(x), steepness))
    assert all(after < before for _, before, after in ended.merits)
    assert ended.place.renewed() is ended.place
    if ended.settled and ended.merits:
        assert ended.place.all_of_it.violation <= 1e-7


@dataclass(frozen=True)
class Rim(Ripples):
    """A way along the rim of a disc: ``min x_1, |x| <= 1``, which bends away from every straight step."""

    @cached_property
    def first(self) -> LocalModel:
        norm = float(np.linalg.norm(self.x))
        return LocalModel(
            objective=float(self.x[0]),
            gradient=np.array([1.0, 0.0]),
            hessian=sparse.csr_array((2, 2)),
            value=np.array([norm - 1.0]),
            jacobian=sparse.csr_array(self.x[None] / norm),
            peaks=0,
            kind=np.zeros(1, dtype=np.intp),
            face_value=np.empty(0),
            face_jacobian=sparse.csr_array((0, 2)),
            face_kind=np.empty(0, dtype=np.intp),
        )

    def curvature(self, multipliers: FloatArray) -> sparse.csr_array:
        """Nothing of what bends: corrections have to do."""
        return sparse.csr_array(1e-3 * np.eye(2))


def test_a_step_along_a_curved_bound_is_corrected_not_crept() -> None:
    ended = solve_sqp(Rim(np.array([0.6, 0.8]), 0.0), penalty=10.0, max_iterations=8)
    assert ended.place.x[0] == pytest.approx(-1.0, abs=1e-3)
    assert ended.place.first.violation <= 1e-6


def test_what_cannot_be_met_is_said() -> None:
    """Both d(x) <= 0 and -d(x) <= -1: no penalty helps."""

    @dataclass(frozen=True)
    class Torn(Ripples):
        @cached_property
        def first(self) -> LocalModel:
            given = super().first
            last = sparse.csr_array(given.jacobian[-1:] * -1)
            return replace(
                given,
                value=np.append(given.value, 1.0 - given.value[-1]),
                jacobian=sparse.csr_array(sparse.vstack([given.jacobian, last])),
                kind=np.zeros(len(given.value) + 1, dtype=np.intp),
            )

    ended = solve_sqp(Torn(np.array([1.0, 1.0]), 0.0))
    assert ended.stuck
    assert not ended.settled
    assert ended.place.first.violation == pytest.approx(0.5, rel=0.12)


def way_of(scene: Scene, solver: Literal["sqp", "slsqp"]) -> InitialGuess:
    context = build_context(scene, replace(scene.planner, solver=solver))
    return sliding_guess(context) if scene.planner.knots == "sliding" else fixed_guess(context)


def objective(way: InitialGuess, optimised: Optimised, *, of_stage: str) -> float:
    """What both solvers make small, from the trajectory alone: smoothing a thousand times the option's."""
    problem, trajectory = way.problem, optimised.trajectory
    t = problem.space.t
    nodes, weights = np.polynomial.legendre.leggauss(4)
    h = np.diff(t)[:, None]
    times = (t[:-1, None] + 0.5 * h * (1 + nodes)).ravel()
    share = (0.5 * h * weights).ravel() / (t[-1] - t[0])
    jerk = trajectory.evaluate(times, 3) / problem.robot.limits.jerk

    def torque(times: FloatArray) -> FloatArray:
        efforts = problem.dynamics.efforts(*trajectory.states(times))
        return np.asarray(np.linalg.norm(efforts.guardrail_torque, axis=1))

    smoothing = 0.5 * 1000 * problem.options.smoothing_weight * float(share @ (jerk**2).mean(axis=1))
    if of_stage == "peak":
        return float(torque(problem.grid).max() / problem.scale) + smoothing
    return 0.5 * float(share @ (torque(times) / problem.scale) ** 2) + smoothing


@pytest.mark.parametrize("name", SCENES)
def test_the_optimum_is_that_of_slsqp(name: str) -> None:
    scene = short_scene(**SCENES[name])
    ways = {solver: way_of(scene, solver) for solver in ("sqp", "slsqp")}
    assert isinstance(ways["sqp"].problem.family, Parametrization)
    assert not isinstance(ways["slsqp"].problem.family, Parametrization)
    found = {solver: optimise(way.problem) for solver, way in ways.items()}
    stages = {solver: optimised.passes[-1].stage for solver, optimised in found.items()}
    assert stages["sqp"] == stages["slsqp"]
    got, expected = (
        objective(ways[solver], found[solver], of_stage=stages[solver]) for solver in ("sqp", "slsqp")
    )
    # Where a smoother way to the same peak is found, so much the better.
    assert got <= expected * (1 + 1e-4)
    context = build_context(scene, scene.planner)
    certify(
        context.robot,
        context.task,
        found["sqp"].trajectory,
        found["sqp"].via_points,
        context.clearances,
        context.options,
    ).require()


def test_what_no_trajectory_can_keep_is_named() -> None:
    """A tool deviation that via-points so far apart cannot hold."""
    legs = [{"by": [0, -0.6, 0], "seconds": 4}]
    scene = short_scene(
        tool_path={"legs": legs, "via_points": 6}, planner={"max_tool_deviation_m": 1e-6, "solver": "sqp"}
    )
    with pytest.raises(OptimisationFailed) as caught:
        optimise(way_of(scene, "sqp").problem)
    assert caught.value.constraint == "tool deviation"
    assert caught.value.violation > 1


def test_a_long_way_with_few_via_points_does_not_creep(tmp_path: Path) -> None:
    """The tool's deviation bends away from nearly every step; uncorrected this took hundreds of them."""
    legs = [
        {"by": [0, 0.1, 0], "seconds": 3},
        {"by": [0, 0, -0.1], "seconds": 3},
        {"by": [0, -0.1, 0.1], "seconds": 3},
    ]
    scene = panda_scene(tmp_path, legs=legs, via_points=12)
    way = way_of(
        replace(scene, planner=replace(scene.planner, chart_spacing=0.3, samples_per_segment=15)), "sqp"
    )
    found = optimise(way.problem)
    assert sum(report.iterations for report in found.passes) <= 80
    assert found.passes[-1].worst.value <= scene.planner.constraint_tolerance
    assert found.passes[-1].peak_torque < way.problem.scale


@pytest.mark.parametrize("undecided", [True, False])
def test_where_it_gives_up_auto_tries_slsqp(monkeypatch: pytest.MonkeyPatch, undecided: bool) -> None:
    def gives_up(*_: Any, **__: Any) -> Any:
        raise OptimisationFailed("no", constraint="none", violation=1.0, undecided=undecided)

    monkeypatch.setattr(SparsePasses, "solve", gives_up)
    told: list[str] = []
    scene = short_scene(planner={"solver": "auto"})
    if undecided:
        planned = plan(scene, progress=lambda progress: told.append(progress.step))
        assert planned.options.solver == "slsqp"
        assert any("slsqp" in step for step in told)
    else:
        with pytest.raises(OptimisationFailed):
            plan(scene)
    with pytest.raises(OptimisationFailed):
        plan(short_scene(planner={"solver": "sqp"}))


def test_the_plan_says_which_solver_made_it() -> None:
    scene = short_scene(planner={"solver": "auto"})
    assert plan(scene).options.solver == "sqp"
    assert plan(short_scene(planner={"solver": "slsqp"})).options.solver == "slsqp"


def test_without_piqp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "piqp", None)
    assert solver_of(PlannerOptions(solver="auto")) == "slsqp"
    assert solver_of(PlannerOptions(solver="slsqp")) == "slsqp"
    with pytest.raises(MissingExtra, match=r"piqp is not installed; run: pip install .*\[fast\]"):
        plan(short_scene(planner={"solver": "sqp"}))


def test_the_doctor_knows_piqp() -> None:
    found = {symptom.name: symptom for symptom in examine()}
    assert found["piqp"].healthy
