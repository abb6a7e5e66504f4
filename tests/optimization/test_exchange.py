"""The exchange: the literal problem's optimum, lexicographic, and said so when there is none."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from literal_problem import Literal
from scipy import optimize
from small_scenes import problem_of, short_scene, tool_points, torque_along

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, OptimisationFailed
from cmbot.common.limit import Limit
from cmbot.common.reading.validation import checked_options
from cmbot.optimization import exchange
from cmbot.optimization.evaluation import NlpEvaluation
from cmbot.optimization.exchange import ExchangeOptions, meet_constraints, minimize_peak
from cmbot.optimization.separation import find_violations
from cmbot.optimization.sqp import SqpOptions
from cmbot.planning import ExchangeReport, QuinticTrajectory, plan
from cmbot.planning.torque.decomposition import Optimised, exchange_options, optimise
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.scene import PlannerOptions

OUT_AND_BACK = [{"by": [0.1, 0, 0], "seconds": 2.5}, {"by": [-0.1, 0, 0], "seconds": 2.5}]
SOLVERS = ("sqp", "slsqp")
# So little smoothing that the peak decides.
LIGHT = {"smoothing_weight": 0.1}
both_solvers = pytest.mark.parametrize("solver", SOLVERS)


def literal(problem: TorqueProblem, *, per_segment: int) -> Literal:
    return Literal(
        robot=problem.request.cell.robot,
        task=problem.request.task,
        t=problem.space.t,
        via_points=problem.parametrization.via_points,
        scale=problem.scale,
        smoothing_weight=problem.request.cell.options.smoothing_weight,
        max_tool_deviation=problem.constraints[1].bound,
        per_segment=per_segment,
    )


def variables_of(trajectory: QuinticTrajectory) -> FloatArray:
    """The paper's variables: velocities, then accelerations, at the inner knots."""
    return np.concatenate([trajectory.v[1:-1].ravel(), trajectory.a[1:-1].ravel()])


def keeps_joint_limits(problem: TorqueProblem, trajectory: QuinticTrajectory) -> bool:
    limits = problem.request.cell.robot.limits
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    largest = [trajectory.extrema(order).largest()[0] for order in (1, 2, 3)]
    return all((value < 0.99 * bound).all() for value, bound in zip(largest, bounds, strict=True))


def unattainable(**planner: Any) -> TorqueProblem:
    """Nothing is known of the peak but what the ends ask at rest, and on the way out more is asked."""
    scene = short_scene(
        tool_path={"legs": OUT_AND_BACK, "via_points": 9},
        planner={"max_tool_deviation_m": 0.01, **LIGHT} | planner,
    )
    given = problem_of(scene)
    return TorqueProblem(given.request, given.parametrization, 0.0)


def precise(problem: TorqueProblem) -> ExchangeOptions:
    """Options that lead as near to the optimum as the solver comes."""
    options = exchange_options(problem)
    tight = replace(options.sqp, optimality_tolerance=1e-7, stall_steps=8, stall_tolerance=1e-5)
    held = {"held_gain": tight.stall_tolerance, "held_promise": tight.stall_promise}
    return replace(options, sqp=tight, least_peak_tolerance=1e-4, **held)


@both_solvers
def test_peak_is_that_of_the_papers_own_formulation(solver: str) -> None:
    """The tool's deviation is at its bound here; joint limits, which the oracle leaves out, are not."""
    scene = short_scene(
        tool_path={"legs": OUT_AND_BACK, "via_points": 7},
        planner={"smoothing_weight": 1e-2, "max_tool_deviation_m": 0.01, "samples_per_segment": 20},
    )
    problem = problem_of(scene)
    run = exchange._Exchange(problem, replace(precise(problem), solver=solver), None)
    peak = run.run(scene.planner.smoothing_weight)
    trajectory = run.form.trajectory
    assert keeps_joint_limits(problem, trajectory)
    # On 20 samples a segment the oracle gains 2e-6 between them.
    oracle = literal(problem, per_segment=80)
    best, z = oracle.solve()
    start = 1.0 + oracle.smoothing(variables_of(problem.parametrization.trajectory))[0]
    assert peak + oracle.smoothing(variables_of(trajectory))[0] == pytest.approx(best, rel=1e-6)
    # There was something to gain.
    assert best < start - 1e-3
    np.testing.assert_allclose(
        trajectory.evaluate(problem.grid), oracle.spline(z)(problem.grid), rtol=0, atol=1e-3
    )


@both_solvers
def test_mean_square_is_that_of_the_papers_own_formulation(solver: str) -> None:
    scene = short_scene(
        tool_path={"via_points": 6},
        planner={"smoothing_weight": 1e-2, "max_tool_deviation_m": 0.01, "solver": solver},
    )
    problem = problem_of(scene)
    found = minimize_peak(problem, precise(problem))
    trajectory = found.parametrization.trajectory
    assert {report.stage for report in found.passes} == {"mean square"}
    assert keeps_joint_limits(problem, trajectory)
    oracle = literal(problem, per_segment=8)
    best, _ = oracle.solve(peak=found.peak_bound)
    start = problem.parametrization.trajectory
    got, before = (
        oracle.mean_square(z) + oracle.smoothing(z)[0] for z in map(variables_of, (trajectory, start))
    )
    assert got == pytest.approx(best, rel=1e-6)
    assert got - best < 0.25 * (before - best)


@both_solvers
def test_constraints_are_met_near_the_start_and_no_optimum_is_sought(solver: str) -> None:
    options = {"solver": solver, "max_tool_deviation_m": 4e-4}
    problem = problem_of(short_scene(tool_path={"via_points": 6}, planner=options))
    exchanged = exchange_options(problem)
    start = find_violations(problem, problem.parametrization.trajectory, np.inf, 1e-5, 400)
    assert start.worst.value > 0.1
    found, optimum = meet_constraints(problem, exchanged), minimize_peak(problem, exchanged)
    end = find_violations(problem, found.parametrization.trajectory, found.peak_bound, 1e-5, 400)
    assert end.worst.value <= exchanged.feasibility_tolerance
    assert end.peak <= 1.05 * start.peak * (1 + 1e-4)
    # Nothing pulls it towards the optimum.
    along = [each.parametrization.trajectory for each in (problem, found, optimum)]
    before, *after = [x.evaluate(np.linspace(0, x.duration, 500), 2) for x in along]
    moved = [np.linalg.norm(each - before) for each in after]
    assert moved[0] < 0.5 * moved[1]
    if solver == "sqp":
        steps = [sum(report.iterations for report in each.passes) for each in (found, optimum)]
        assert 0 < steps[0] < steps[1]


@both_solvers
def test_a_lower_bound_that_cannot_be_attained_is_left_for_the_lowest_peak(solver: str) -> None:
    problem = unattainable(solver=solver)
    options = replace(exchange_options(problem), least_peak_tolerance=1e-4)
    found = minimize_peak(problem, options)
    stages = [report.stage for report in found.passes]
    assert "peak" in stages and stages[-1] == "mean square"
    assert found.peak_bound > problem.lower_bound * (1 + 2e-4)
    fine = np.linspace(*problem.space.t[[0, -1]], 4001)
    peak = torque_along(problem, found.parametrization.trajectory, fine).max()
    assert found.peak_bound * (1 - 1e-3) < peak <= found.peak_bound * (1 + 2e-6)
    # Nothing lower was overlooked: below it there is no motion.
    lower = exchange._Exchange(problem, options, None)
    with pytest.raises(OptimisationFailed):
        lower.run(problem.request.cell.options.smoothing_weight, bound=0.999 * found.peak_bound, attempt=True)


def test_the_last_thousandths_of_a_peak_are_left_for_less_jerk() -> None:
    """Where the lower bound is missed: there the peak falls on as long as any limit is left."""
    problem = unattainable(solver="sqp")
    options = exchange_options(problem)
    lowest, found = (
        minimize_peak(problem, replace(options, least_peak_tolerance=share))
        for share in (1e-4, options.least_peak_tolerance)
    )
    rise = found.peak_bound / lowest.peak_bound - 1
    # A quarter of it is what lighter smoothing has to be worth.
    assert 1e-4 < rise < 1.25 * options.least_peak_tolerance + options.peak_tolerance
    jerks = [each.parametrization.smoothing()[0] for each in (found, lowest)]
    assert jerks[0] < 0.97 * jerks[1]


def test_below_a_held_peak_little_gain_is_not_crept_after(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = unattainable(solver="sqp")
    options = exchange_options(problem)
    ends: dict[bool, set[tuple[float, float]]] = {False: set(), True: set()}
    whole = exchange.solve_sqp

    def seen(start: Any, families: int, sqp: SqpOptions, *others: Any) -> Any:
        ends[start.stage.bound is not None].add((sqp.stall_tolerance, sqp.stall_promise))
        return whole(start, families, sqp, *others)

    monkeypatch.setattr(exchange, "solve_sqp", seen)
    minimize_peak(problem, options)
    assert ends[True] == {(options.held_gain, options.held_promise)}
    assert ends[False] == {(options.sqp.stall_tolerance, options.sqp.stall_promise)} != ends[True]


def test_when_the_time_is_over_the_best_feasible_trajectory_is_the_result() -> None:
    problem = unattainable(solver="sqp")
    options = exchange_options(problem)
    whole = minimize_peak(problem, options)
    assert whole.complete
    ends = set()
    for most in {1, len(whole.passes) // 2, len(whole.passes) - 1}:
        reports: list[ExchangeReport] = []
        timed = replace(options, stop=lambda reports=reports, most=most: len(reports) >= most)
        try:
            found = minimize_peak(problem, timed, reports.append)
        except OptimisationFailed as failure:
            assert "the time was over" in failure.reason
            assert min(report.worst.value for report in reports) > options.feasibility_tolerance
            ends.add("failure")
        else:
            trajectory = found.parametrization.trajectory
            left = find_violations(problem, trajectory, found.peak_bound, options.feasibility_tolerance, 1)
            assert left.worst.value <= options.feasibility_tolerance
            ends.add("whole" if found.complete else "feasible")
        # The stage after the one that was stopped begins, and is stopped.
        assert len(reports) <= most + 2
    assert "feasible" in ends


def test_where_the_time_ends_an_attempt_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not that the attempt failed, nor the bound of the peak that it tried: what is left is any other one."""
    given = unattainable(solver="sqp", max_tool_deviation_m=1e-6)
    problem = TorqueProblem(given.request, given.parametrization, 1e-3 * given.scale)
    solves, whole = list[int](), exchange.solve_sqp

    def at_the_start(start: NlpEvaluation, *others: Any) -> Any:
        solves.append(1)
        return replace(whole(start, *others), status=exchange.SqpStatus.INFEASIBLE, iterate=start)

    monkeypatch.setattr(exchange, "solve_sqp", at_the_start)
    options = replace(exchange_options(problem), stop=lambda: bool(solves), far_off=np.inf)
    with pytest.raises(OptimisationFailed, match=r"was over after .*, before the optimisation") as caught:
        minimize_peak(problem, options)
    assert caught.value.stopped
    assert caught.value.limit is not Limit.PEAK


Solved = tuple[TorqueProblem, Optimised, list[ExchangeReport]]


@pytest.fixture(scope="module", params=["there", "there and back", "payload"])
def solved(request: pytest.FixtureRequest) -> Solved:
    changes: dict[str, Any] = {
        "there": {},
        "there and back": {"tool_path": {"legs": OUT_AND_BACK, "via_points": 9}},
        "payload": {"robot": {"payload_kg": 2.0}},
    }[request.param]
    problem = problem_of(short_scene(planner=LIGHT, **changes))
    reports: list[ExchangeReport] = []
    return problem, optimise(problem, reports.append), reports


def test_never_worse_than_the_start(solved: Solved) -> None:
    """The starts here keep every bound, so neither peak nor mean may rise."""
    problem, optimised, _ = solved
    start = problem.parametrization.trajectory
    before, after = (torque_along(problem, each, problem.grid) for each in (start, optimised.trajectory))
    assert after.max() <= max(before.max(), problem.lower_bound * (1 + 1e-4)) * (1 + 1e-4)
    jerk = problem.request.cell.robot.limits.jerk

    def objective(each: QuinticTrajectory, torque: FloatArray) -> float:
        smooth = ((each.evaluate(problem.grid, 3) / jerk) ** 2).mean(axis=1)
        weight = problem.request.cell.options.smoothing_weight
        return float(np.trapezoid(torque**2 + weight * smooth, problem.grid))

    assert objective(optimised.trajectory, after) <= objective(start, before) * (1 + 1e-6)


def test_bounds_are_kept_between_the_samples(solved: Solved) -> None:
    problem, optimised, _ = solved
    task, limits = problem.request.task, problem.request.cell.robot.limits
    trajectory = optimised.trajectory
    fine = np.linspace(0, trajectory.t[-1], 3001)
    for order, bound in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        assert (np.abs(trajectory.evaluate(fine, order)) <= bound).all()
    some = fine[::10]
    away = task.path.leg_offset(some, tool_points(problem.request.cell.robot, trajectory.evaluate(some)))
    assert np.linalg.norm(away, axis=1).max() <= problem.request.cell.options.max_tool_deviation_m
    np.testing.assert_array_equal(optimised.via_points, problem.parametrization.via_points)
    np.testing.assert_allclose(trajectory.evaluate(trajectory.t), optimised.via_points, rtol=0, atol=1e-12)


def test_progress_is_reported_pass_by_pass(solved: Solved) -> None:
    problem, optimised, told = solved
    assert tuple(told) == optimised.passes
    assert [report.number for report in told] == list(range(1, len(told) + 1))
    assert all(report.iterations >= 1 for report in told)
    assert told[-1].stage == "mean square"
    assert told[-1].worst.value <= problem.request.cell.options.constraint_tolerance
    # The peak that is reported lies between the samples, where it is largest.
    fine = np.linspace(0, problem.grid[-1], 100 * len(problem.grid))
    on_grid, everywhere = (
        torque_along(problem, optimised.trajectory, times).max() * problem.scale
        for times in (problem.grid, fine)
    )
    assert on_grid * (1 - 1e-12) <= told[-1].peak_torque <= everywhere * (1 + 1e-9)


def test_passes_run_out() -> None:
    problem = unattainable(max_passes=1, solver="slsqp")
    with pytest.raises(OptimisationFailed, match="no solution in 1 pass; max_passes") as caught:
        optimise(problem)
    assert caught.value.constraint


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the stages that are solved, in their order."""
    solve, names = exchange.solve_sqp, list[str]()

    def noted(start: NlpEvaluation, *rest: Any) -> Any:
        names.append(start.stage.name)
        return solve(start, *rest)

    monkeypatch.setattr(exchange, "solve_sqp", noted)
    return names


def test_far_from_the_constraints_the_lower_bound_is_not_attempted(stages: list[str]) -> None:
    """A leg in a tenth of the time: no motion keeps the jerk's bounds, whatever its peak."""
    leg = {"by": [0.1, 0, 0], "seconds": 0.25}
    problem = problem_of(short_scene(tool_path={"legs": [leg]}, planner={"solver": "sqp"}))
    for far_off, expected in ((4.0, ["peak"]), (np.inf, ["mean square", "peak"])):
        stages.clear()
        with pytest.raises(OptimisationFailed) as caught:
            minimize_peak(problem, replace(exchange_options(problem), far_off=far_off))
        assert stages == expected
        assert caught.value.constraint.startswith("jerk") and caught.value.violation > 4.0


def test_a_lower_bound_that_is_not_attempted_is_attained_all_the_same(stages: list[str]) -> None:
    """The peak is then minimised as far as the bound, and held there."""
    problem = problem_of(short_scene(planner={"solver": "sqp", "knots": "sliding", **LIGHT}))
    options = exchange_options(problem)
    attempted = minimize_peak(problem, options)
    assert stages == ["mean square"]
    found = minimize_peak(problem, replace(options, far_off=-1.0))
    assert list(dict.fromkeys(stages[1:])) == ["peak", "mean square"]
    assert found.peak_bound == attempted.peak_bound == problem.lower_bound * (1 + options.peak_tolerance)
    fine = np.linspace(*problem.space.t[[0, -1]], 2001)
    means = [
        np.mean(torque_along(problem, each.parametrization.trajectory, fine) ** 2)
        for each in (attempted, found)
    ]
    assert means[1] == pytest.approx(means[0], rel=5e-3)


def test_how_far_above_the_least_peak_a_motion_may_be_is_an_option() -> None:
    problem = unattainable(least_peak_tolerance=0.01, peak_tolerance=0.02)
    options = exchange_options(problem)
    assert (options.least_peak_tolerance, options.peak_tolerance) == (0.01, 0.02)


def failing(*_: Any, **__: Any) -> Any:
    raise OptimisationFailed("no", constraint="none", violation=1.0)


def test_a_lighter_smoothing_that_fails_leaves_the_heavier_ones_result(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = unattainable()
    # So that a lighter smoothing is worth trying.
    run = exchange._Exchange(problem, replace(exchange_options(problem), least_peak_tolerance=1e-4), None)
    heavier: list[QuinticTrajectory] = []
    whole = exchange._Exchange.run

    def lighter_fails(self: Any, smoothing: float, **target: Any) -> float:
        if smoothing < problem.request.cell.options.smoothing_weight:
            heavier.append(self.form.trajectory)
            whole(self, smoothing, **target)
            failing()
        return whole(self, smoothing, **target)

    monkeypatch.setattr(exchange._Exchange, "run", lighter_fails)
    run.lowest_peak(0.0)
    assert len(heavier) == 1
    assert run.form.trajectory is heavier[0]


@pytest.mark.parametrize("answer", [np.nan, np.inf])
def test_slsqp_that_diverges_is_given_up(monkeypatch: pytest.MonkeyPatch, answer: float) -> None:
    problem = problem_of(short_scene(planner={"solver": "slsqp"}))

    class Diverged:
        x, nit = np.full(problem.parametrization.dimension, answer), 1

    monkeypatch.setattr(optimize, "minimize", lambda *_, **__: Diverged)
    with pytest.raises(OptimisationFailed, match="solver diverged"):
        optimise(problem)


def test_slsqp_turns_back_where_the_task_cannot_be_held() -> None:
    """A step far beyond what the arm reaches costs more than any other, and is evaluated without an error."""
    problem = problem_of(short_scene(planner={"knots": "sliding", "chart_spacing": 0.3}))
    run = exchange._Exchange(problem, ExchangeOptions(), None)
    stage = exchange.Stage(smoothing=0.1, bound=1.0, tolerance=1e-5)
    start = NlpEvaluation.around(problem, stage, problem.parametrization, run._constraints)
    dense = exchange.solve_slsqp.__globals__["DenseProgram"](start)
    here, far = dense.at(np.zeros(dense.n)), dense.at(np.full(dense.n, 1e4))
    assert far.objective > 100 * here.objective
    assert np.isfinite(far.gradient).all() and np.isfinite(far.jacobian).all()


@pytest.mark.parametrize("by", [[0, -0.3, 0], [0.2, -0.1, 0.1], [-0.15, 0.1, -0.1]])
def test_the_optimum_keeps_what_the_global_search_gained(by: list[float]) -> None:
    """Slowly enough that smoothness costs nothing."""
    scene = short_scene(
        tool_path={"legs": [{"by": by, "seconds": 8}], "via_points": 12}, planner={"knots": "sliding"}
    )
    planned = plan(scene)
    assert None not in (planned.choice.free, planned.choice.pinned)
    stays = planned.start.moved == 0
    chosen = planned.choice.pinned if stays else planned.choice.free
    enough = planned.torque_floor * (1 + scene.planner.peak_tolerance)
    assert planned.figures.peak_static_guardrail_torque <= max(chosen, enough) * (1 + 1e-4)


WRONG = [
    ("knots", "loose"),
    ("axis_weights", (0.0, 0.0, 0.0)),
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
    ("peak_tolerance", 0.0),
    ("least_peak_tolerance", 0.0),
    ("constraint_tolerance", 1e-3),
    ("max_passes", 0),
    ("max_iterations", 0),
]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_wrong_options_are_named(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"PlannerOptions: {name}: got") as caught:
        replace(PlannerOptions(), **{name: value})
    assert caught.value.key == name


def test_right_options_pass_unchanged() -> None:
    options = PlannerOptions(avoidance="switch", samples_per_segment=400, safety_margin_m=0.0)
    assert checked_options(PlannerOptions, options, "PlannerOptions") == options
