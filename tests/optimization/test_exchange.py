"""The optimiser: the literal problem's optimum, no worse than its start, and said so when it cannot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from oracles.literal_problem import Literal
from small_scenes import problem_of, short_scene

from cmbot.common.errors import InputError, OptimisationFailed
from cmbot.optimization.exchange import Optimised, optimise
from cmbot.planning import ExchangeReport, QuinticTrajectory, plan
from cmbot.planning.path.task import ToolTask
from cmbot.planning.planner import checked
from cmbot.planning.torque.feasibility import check_feasible
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.scene import PlannerOptions

FloatArray = NDArray[np.float64]
OUT_AND_BACK = [{"by": [0.1, 0, 0], "seconds": 2.5}, {"by": [-0.1, 0, 0], "seconds": 2.5}]


def peak_of(problem: TorqueProblem, optimised: Optimised) -> float:
    states = optimised.trajectory.states(problem.grid)
    torque = problem.dynamics.efforts(*states).guardrail_torque
    return float(np.linalg.norm(torque, axis=1).max() / problem.scale)


def literal(problem: TorqueProblem, task: ToolTask, weight: float, *, per_segment: int) -> Literal:
    return Literal(
        robot=problem.robot,
        task=task,
        t=problem.space.t,
        via_points=problem.family.via_points,
        scale=problem.scale,
        smoothing_weight=weight,
        max_tool_deviation=(problem.functions[1].bound),
        per_segment=per_segment,
    )


def variables(optimised: Optimised) -> FloatArray:
    return variables_of(optimised.trajectory)


def variables_of(trajectory: QuinticTrajectory) -> FloatArray:
    """The paper's variables: velocities, then accelerations, at the inner knots."""
    return np.concatenate([trajectory.v[1:-1].ravel(), trajectory.a[1:-1].ravel()])


def keeps_joint_limits(problem: TorqueProblem, optimised: Optimised) -> bool:
    limits = problem.robot.limits
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    largest = [optimised.trajectory.extrema(order).largest()[0] for order in (1, 2, 3)]
    return all((value < 0.99 * bound).all() for value, bound in zip(largest, bounds, strict=True))


def test_peak_is_that_of_the_papers_own_formulation() -> None:
    """The tool's deviation is at its bound here; joint limits, which the oracle leaves out, are not."""
    scene = short_scene(
        tool_path={"legs": OUT_AND_BACK, "via_points": 7},
        planner={
            "smoothing_weight": 1e-2,
            "max_tool_deviation_m": 0.01,
            "samples_per_segment": 20,
            "solver": "slsqp",
        },
    )
    given, task, clearances = problem_of(scene)
    # Without a floor to be content with, the peak is lowered to the end.
    problem = TorqueProblem(given.robot, task, given.family, clearances, scene.planner, resting=(0, -1))
    optimised = optimise(problem)
    assert {report.stage for report in optimised.passes} == {"peak"}
    assert keeps_joint_limits(problem, optimised)
    # On 20 samples a segment the oracle gains 2e-6 between them.
    oracle = literal(problem, task, scene.planner.smoothing_weight, per_segment=80)
    best, z = oracle.solve()
    got = peak_of(problem, optimised) + oracle.smoothing(variables(optimised))[0]
    start = 1.0 + oracle.smoothing(variables_of(problem.trajectory(problem.family, problem.family.start)))[0]
    assert got == pytest.approx(best, rel=1e-6)
    # There was something to gain.
    assert best < start - 1e-3
    there, here = oracle.spline(z)(problem.grid), optimised.trajectory.evaluate(problem.grid)
    np.testing.assert_allclose(here, there, rtol=0, atol=1e-3)


def test_mean_square_is_that_of_the_papers_own_formulation() -> None:
    """Here the peak is the start's weight, which nothing can change; with fixed knots the mean hardly can.

    In this stage the smoothing weighs a thousand times what it does where a peak has to be lowered.
    """
    scene = short_scene(
        tool_path={"via_points": 6},
        planner={"smoothing_weight": 1e-5, "max_tool_deviation_m": 0.01, "solver": "slsqp"},
    )
    problem, task, _ = problem_of(scene)
    optimised = optimise(problem)
    assert {report.stage for report in optimised.passes} == {"mean square"}
    assert keeps_joint_limits(problem, optimised)
    oracle = literal(problem, task, 1000 * scene.planner.smoothing_weight, per_segment=8)
    best, _ = oracle.solve(peak=problem.peak_at_rest / problem.scale * (1 + 1e-6))
    start = problem.trajectory(problem.family, problem.family.start)
    got, before = (
        oracle.mean_square(z) + oracle.smoothing(z)[0] for z in (variables(optimised), variables_of(start))
    )
    assert got == pytest.approx(best, rel=1e-6)
    assert got - best < 0.25 * (before - best)


@pytest.fixture(scope="module", params=["there", "there and back", "payload"])
def solved(request: pytest.FixtureRequest) -> tuple[TorqueProblem, ToolTask, Optimised, list[ExchangeReport]]:
    changes: dict[str, Any] = {
        "there": {},
        "there and back": {"tool_path": {"legs": OUT_AND_BACK, "via_points": 9}},
        "payload": {"robot": {"payload_kg": 3.0}},
    }[request.param]
    problem, task, _ = problem_of(short_scene(**changes))
    reports: list[ExchangeReport] = []
    return problem, task, optimise(problem, reports.append), reports


Solved = tuple[TorqueProblem, ToolTask, Optimised, list[ExchangeReport]]


def test_never_worse_than_the_start(solved: Solved) -> None:
    """The starts here keep every bound, so neither peak nor mean may rise."""
    problem, _, optimised, _ = solved
    assert peak_of(problem, optimised) <= 1 + 2e-6

    def objective(trajectory: Any) -> float:
        states = trajectory.states(problem.grid)
        torque = problem.dynamics.efforts(*states).guardrail_torque
        return float(np.trapezoid((torque**2).sum(axis=1), problem.grid))

    start = problem.trajectory(problem.family, problem.family.start)
    if optimised.passes[-1].stage == "mean square":
        assert objective(optimised.trajectory) <= objective(start) * (1 + 1e-6)


def test_bounds_are_kept_between_the_samples(solved: Solved) -> None:
    problem, task, optimised, _ = solved
    trajectory, limits = optimised.trajectory, problem.robot.limits
    fine = np.linspace(0, trajectory.t[-1], 3001)
    for order, bound in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        assert (np.abs(trajectory.evaluate(fine, order)) <= bound).all()
    away = task.path.offset(np.array([_tool_point(problem, q) for q in trajectory.evaluate(fine[::10])]))
    assert np.linalg.norm(away, axis=1).max() <= problem.options.max_tool_deviation_m
    np.testing.assert_array_equal(optimised.via_points, problem.family.via_points)
    np.testing.assert_allclose(trajectory.evaluate(trajectory.t), optimised.via_points, rtol=0, atol=1e-12)


def _tool_point(problem: TorqueProblem, q: FloatArray) -> FloatArray:
    model = problem.robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return np.array(data.oMf[problem.robot.tool_frame_id].translation)


def test_progress_is_told_pass_by_pass(solved: Solved) -> None:
    problem, _, optimised, told = solved
    assert tuple(told) == optimised.passes
    assert [report.number for report in told] == list(range(1, len(told) + 1))
    stages = [report.stage for report in told]
    assert stages == sorted(stages, key=["peak", "mean square"].index)
    assert all(report.iterations >= 1 for report in told)
    constraints = [report.constraints for report in told]
    assert constraints == sorted(constraints)
    assert told[-1].worst.value <= problem.options.constraint_tolerance
    # The peak that is told lies between the samples, where it is largest.
    on_grid = peak_of(problem, optimised) * problem.scale
    times = np.linspace(0, problem.grid[-1], 20 * len(problem.grid))
    torque = problem.dynamics.efforts(*optimised.trajectory.states(times)).guardrail_torque
    everywhere = np.linalg.norm(torque, axis=1).max()
    assert on_grid <= told[-1].peak_torque * (1 + 1e-12)
    assert told[-1].peak_torque <= everywhere * (1 + 1e-9)


@pytest.mark.parametrize("seconds", [0.3, 1.0])
def test_legs_that_are_too_fast_are_refused_at_once(seconds: float) -> None:
    legs = [{"by": [0, -0.1, 0], "seconds": seconds}]
    problem, _, _ = problem_of(short_scene(tool_path={"legs": legs}, planner={"path_step_s": 0.002}))
    told: list[ExchangeReport] = []
    with pytest.raises(OptimisationFailed, match="give the legs more seconds") as caught:
        optimise(problem, told.append)
    assert told == []
    joint = caught.value.constraint.removeprefix("velocity, acceleration or jerk of ")
    assert joint in problem.robot.joints
    assert caught.value.violation > 0.1


def test_feasibility_is_exact_to_its_samples() -> None:
    """Scaling time by c scales jerk by 1/c^3: the share that is needed tells how long a leg has to be."""

    def needed(seconds: float) -> float:
        legs = [{"by": [0, -0.1, 0], "seconds": seconds}]
        problem, _, _ = problem_of(short_scene(tool_path={"legs": legs}, planner={"path_step_s": 0.002}))
        with pytest.raises(OptimisationFailed) as caught:
            check_feasible(problem)
        return caught.value.violation + 1

    assert needed(0.6) == pytest.approx(needed(1.2) * 8, rel=0.02)


def test_passes_run_out() -> None:
    problem, _, _ = problem_of(short_scene(planner={"max_passes": 1, "solver": "slsqp"}))
    with pytest.raises(OptimisationFailed, match="no solution in 1 pass, and planner") as caught:
        optimise(problem)
    assert caught.value.constraint
    assert "% beyond its bound" in str(caught.value)


def test_a_margin_that_the_via_points_break_is_refused_at_once() -> None:
    scene = short_scene(obstacles=[{"name": "plate", "box": [0.5, 0.02, 0.5], "xyz": [2.3, 0.6, -2.06]}])
    problem, task, clearances = problem_of(scene)
    distance = clearances.smallest(problem.family.via_points).distance.min()
    options = replace(scene.planner, safety_margin_m=float(distance) + 0.01)
    stricter = TorqueProblem(problem.robot, task, problem.family, clearances, options, resting=(0, -1))
    told: list[ExchangeReport] = []
    with pytest.raises(OptimisationFailed, match="a via-point of the path breaks a bound") as caught:
        optimise(stricter, told.append)
    assert told == []
    assert caught.value.constraint == "clearance"
    assert caught.value.violation == pytest.approx(0.1, rel=0.05)


def test_a_load_that_is_too_heavy_at_rest_is_refused_at_once() -> None:
    problem, _, _ = problem_of(short_scene(robot={"payload_kg": 20.0}))
    with pytest.raises(OptimisationFailed, match="a via-point of the path breaks a bound") as caught:
        optimise(problem)
    assert caught.value.constraint == "joint torque"
    static = problem.dynamics.static_efforts(problem.family.via_points[[0, -1]]).joint_torque
    share = np.abs(static / problem.robot.limits.torque).max()
    assert caught.value.violation == pytest.approx(share - 1, abs=0.02)


WRONG = [
    ("knots", "loose"),
    ("avoidance", "soft"),
    ("avoidance_distance_m", 0.0),
    ("avoidance_gain", -1.0),
    ("centre_of_gravity_weight", -1e-3),
    ("damping_max", float("nan")),
    ("damping_threshold", float("inf")),
    ("drift_gain", -1.0),
    ("path_step_s", 0.2),
    ("other_starts", -1),
    ("safety_margin_m", -0.01),
    ("max_tool_deviation_m", 0.0),
    ("solver", "ipopt"),
    ("samples_per_segment", 3),
    ("samples_per_segment", 40.5),
    ("smoothing_weight", 0.0),
    ("constraint_tolerance", 1e-3),
    ("max_passes", 0),
    ("max_iterations", 0),
]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_wrong_options_are_named(name: str, value: Any) -> None:
    wrong = replace(PlannerOptions(), **{name: value})
    with pytest.raises(InputError, match=f"PlannerOptions: {name}: got") as caught:
        plan(short_scene(), options=wrong)
    assert caught.value.key == name


def test_right_options_pass_unchanged() -> None:
    options = PlannerOptions(avoidance="switch", samples_per_segment=400, safety_margin_m=0.0)
    assert checked(options) == options
