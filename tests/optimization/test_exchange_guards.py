"""What the optimiser does when its solver misbehaves, and that the polish keeps what the charts gained."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cmbot.optimization.continuation import LIGHTER, Effort
from numpy.typing import NDArray
from small_scenes import problem_of, short_scene

from cmbot.common.errors import OptimisationFailed
from cmbot.optimization import exchange as optimiser
from cmbot.optimization.slsqp import Subproblem, solve_slsqp
from cmbot.planning import plan
from cmbot.planning.torque.problem import TorqueProblem

OUT_AND_BACK = [{"by": [0.1, 0, 0], "seconds": 2.5}, {"by": [-0.1, 0, 0], "seconds": 2.5}]


def demanding() -> TorqueProblem:
    """Its peak is in the motion, and nothing says that it is low enough."""
    scene = short_scene(
        tool_path={"legs": OUT_AND_BACK, "via_points": 7},
        planner={"smoothing_weight": 1e-2, "max_tool_deviation_m": 0.01, "solver": "slsqp"},
    )
    given, task, clearances = problem_of(scene)
    return TorqueProblem(given.robot, task, given.family, clearances, scene.planner, resting=(0, -1))


def peak(problem: TorqueProblem, found: optimiser.Optimised) -> float:
    t = np.linspace(0, problem.grid[-1], 3000)
    torque = problem.dynamics.efforts(*found.trajectory.states(t)).guardrail_torque
    return float(np.linalg.norm(torque, axis=1).max())


def test_a_step_for_the_worse_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = demanding()
    expected = optimiser.optimise(problem)
    calls = []

    def wild(subproblem: Subproblem, accuracy: float, max_iterations: int) -> tuple[NDArray[np.float64], int]:
        calls.append(subproblem)
        x, iterations = solve_slsqp(subproblem, accuracy, max_iterations)
        return (x + 100.0, iterations) if len(calls) % 2 else (x, iterations)

    monkeypatch.setattr(optimiser, "solve_slsqp", wild)
    found = optimiser.optimise(problem)
    assert len(calls) >= 2 * len(found.passes)
    assert found.passes[-1].worst.value <= problem.options.constraint_tolerance
    # More cautious steps smooth more: the peak is about as low, not lower.
    assert peak(problem, found) == pytest.approx(peak(problem, expected), rel=2e-3)


def test_sliding_alone_may_lead_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first pass only slides via-points; when that diverges all unknowns are tried at once."""
    refused = []

    def without_slides(
        subproblem: Subproblem, accuracy: float, max_iterations: int
    ) -> tuple[NDArray[np.float64], int]:
        if len(subproblem.start) == 8 + 1:  # one slide a via-point, and the bound
            refused.append(subproblem)
            return subproblem.start + 100.0, 1
        return solve_slsqp(subproblem, accuracy, max_iterations)

    monkeypatch.setattr(optimiser, "solve_slsqp", without_slides)
    planned = plan(short_scene(planner={"knots": "sliding", "solver": "slsqp"}))
    assert refused
    assert planned.certificate.holds


@pytest.mark.parametrize("answer", [np.nan, np.inf, 1e9])
def test_a_solver_that_always_diverges_is_given_up(monkeypatch: pytest.MonkeyPatch, answer: float) -> None:
    problem = demanding()

    def diverged(subproblem: Subproblem, *_: Any) -> tuple[NDArray[np.float64], int]:
        return np.full_like(subproblem.start, answer), 1

    monkeypatch.setattr(optimiser, "solve_slsqp", diverged)
    with np.errstate(all="ignore"), pytest.raises(OptimisationFailed):
        optimiser.optimise(problem)


def test_a_lighter_smoothing_that_fails_leaves_the_heavier_ones_result(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = demanding()
    heavier = []
    whole = optimiser._Run._passes

    def passes(run: Any, name: str, bound: float, effort: Effort) -> tuple[float, float]:
        if effort is LIGHTER[1]:
            heavier.append(problem.trajectory(run.family, run.x))
            whole(run, name, bound, effort)
            raise OptimisationFailed("no", constraint="none", violation=1.0)
        return whole(run, name, bound, effort)

    monkeypatch.setattr(optimiser._Run, "_passes", passes)
    found = optimiser.optimise(problem)
    assert len(heavier) == 1
    np.testing.assert_array_equal(found.trajectory.v, heavier[0].v)
    np.testing.assert_array_equal(found.trajectory.a, heavier[0].a)


@pytest.mark.parametrize("by", [[0, -0.3, 0], [0.2, -0.1, 0.1], [-0.15, 0.1, -0.1]])
def test_the_polish_keeps_what_the_charts_gained(by: list[float]) -> None:
    """Slowly enough that smoothness costs nothing."""
    scene = short_scene(
        tool_path={"legs": [{"by": by, "seconds": 8}], "via_points": 12}, planner={"knots": "sliding"}
    )
    planned = plan(scene)
    assert planned.choice is not None
    assert planned.choice.free is not None
    assert planned.choice.pinned is not None
    stays = planned.start.moved == 0
    chosen = planned.choice.pinned if stays else planned.choice.free
    assert planned.torque_floor is not None
    enough = planned.torque_floor * (1 + scene.planner.gap_target)
    assert planned.figures.peak_static_guardrail_torque <= max(chosen, enough) * (1 + 1e-4)
