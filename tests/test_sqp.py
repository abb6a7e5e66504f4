"""The sparse solver: the merit falls step by step, and the optimum is SLSQP's."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse
from small_scenes import short_scene

from cmbot.doctor import examine
from cmbot.errors import MissingExtra, OptimisationFailed
from cmbot.planning import plan, sqp
from cmbot.planning.certificate import certify
from cmbot.planning.optimiser import Optimised, optimise
from cmbot.planning.setting import prepare
from cmbot.planning.solvers import solver_of
from cmbot.planning.sparse_family import LocalKnots
from cmbot.planning.sparse_qp import LocalModel, solve_qp
from cmbot.planning.ways import Way, fixed_way, sliding_way
from cmbot.scene import PlannerOptions, Scene

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
            face_value=np.empty(0),
            face_jacobian=sparse.csr_array((0, n)),
        )

    def second(self, multipliers: FloatArray) -> LocalModel:
        curvature = 12 * (self.x - 1) ** 2 + 2 * multipliers.sum() + 1e-6
        return replace(self.first, hessian=sparse.csr_array(np.diag(curvature)))

    def moved(self, p: FloatArray) -> Ripples:
        return Ripples(self.x + p, self.steepness)


@settings(max_examples=30)
@given(
    x=st.lists(st.floats(-3, 3), min_size=2, max_size=5),
    steepness=st.floats(0, 8),
    penalty=st.sampled_from([0.1, 10.0]),
)
def test_every_step_lowers_the_merit(x: list[float], steepness: float, penalty: float) -> None:
    start = Ripples(np.array(x), steepness)
    ended = sqp.descend(
        start,
        np.zeros(len(start.first.value)),
        penalty=penalty,
        radius=1.0,
        accuracy=1e-9,
        tolerance=1e-7,
        max_iterations=200,
    )
    assert all(after < before for _, before, after in ended.merits)
    penalties = [penalty for penalty, _, _ in ended.merits]
    assert penalties == sorted(penalties)
    assert ended.iterations <= 200
    assert ended.settled <= (ended.place.first.violation <= 1e-7)
    assert ended.place.first.merit(ended.penalty) <= start.first.merit(ended.penalty)


def test_a_step_is_no_longer_than_the_radius() -> None:
    model = Ripples(np.array([2.0, -1.0]), 1.0).second(np.ones(4))
    for radius in (1e-3, 0.5):
        step = solve_qp(model, 1.0, radius)
        assert step.solved
        assert np.abs(step.p).max() == pytest.approx(radius)
        assert model.after(step.p, 1.0) < model.merit(1.0)


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
            )

        def moved(self, p: FloatArray) -> Torn:
            return Torn(self.x + p, self.steepness)

    start = Torn(np.array([1.0, 1.0]), 0.0)
    ended = sqp.descend(
        start,
        np.zeros(len(start.first.value)),
        penalty=0.1,
        radius=1.0,
        accuracy=1e-9,
        tolerance=1e-7,
        max_iterations=200,
    )
    assert ended.stuck
    assert not ended.settled
    assert ended.place.first.violation == pytest.approx(0.5, rel=0.12)


def way_of(scene: Scene, solver: str) -> Way:
    setting = prepare(scene, replace(scene.planner, solver=solver))
    return sliding_way(setting) if scene.planner.knots == "sliding" else fixed_way(setting, lambda _: None)


def objective(way: Way, optimised: Optimised, *, of_stage: str) -> float:
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
        return np.linalg.norm(efforts.guardrail_torque, axis=1)

    smoothing = 0.5 * 1000 * problem.options.smoothing_weight * float(share @ (jerk**2).mean(axis=1))
    if of_stage == "peak":
        return float(torque(problem.grid).max() / problem.scale) + smoothing
    return 0.5 * float(share @ (torque(times) / problem.scale) ** 2) + smoothing


@pytest.mark.parametrize("name", SCENES)
def test_the_optimum_is_that_of_slsqp(name: str) -> None:
    scene = short_scene(**SCENES[name])
    ways = {solver: way_of(scene, solver) for solver in ("sqp", "slsqp")}
    assert isinstance(ways["sqp"].problem.family, LocalKnots)
    assert not isinstance(ways["slsqp"].problem.family, LocalKnots)
    found = {solver: optimise(way.problem) for solver, way in ways.items()}
    stages = {solver: optimised.passes[-1].stage for solver, optimised in found.items()}
    assert stages["sqp"] == stages["slsqp"]
    got, expected = (
        objective(ways[solver], found[solver], of_stage=stages[solver]) for solver in ("sqp", "slsqp")
    )
    # Where a smoother way to the same peak is found, so much the better.
    assert got <= expected * (1 + 1e-4)
    setting = prepare(scene, scene.planner)
    certify(
        setting.robot,
        setting.task,
        found["sqp"].trajectory,
        found["sqp"].via_points,
        setting.clearances,
        setting.options,
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


def test_the_plan_says_which_solver_made_it() -> None:
    scene = short_scene(planner={"solver": "auto"})
    assert plan(scene).options.solver == "sqp"
    assert plan(short_scene(planner={"solver": "slsqp"})).options.solver == "slsqp"


def test_without_piqp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "piqp", None)
    assert solver_of(PlannerOptions(solver="auto")) == "slsqp"
    assert solver_of(PlannerOptions(solver="slsqp")) == "slsqp"
    with pytest.raises(MissingExtra, match=r'piqp is not installed; run: pip install "cmbot\[fast\]"'):
        plan(short_scene(planner={"solver": "sqp"}))


def test_the_doctor_knows_piqp() -> None:
    found = {symptom.name: symptom for symptom in examine()}
    assert found["piqp"].healthy
