"""The benchmarks: one problem for every solver, goals and tables that follow from the results."""

import json
import re
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import measure
import numpy as np
import pytest
import run
from finite_differences import check_derivative
from report import document, goals, plot, tables
from scipy import sparse
from small_scenes import short_scene
from solvers import (
    cases,
    comparison,
    drake_sampled,
    formulations,
    ipopt,
    lagrangian,
    literal,
    sampled,
    symbolic_arm,
)
from threadpoolctl import threadpool_limits

from cmbot.common.errors import MissingExtra
from cmbot.robot import Dynamics, Robot

OUT_AND_BACK = [{"by": [0.1, 0, 0], "seconds": 2.5}, {"by": [-0.1, 0, 0], "seconds": 2.5}]
# The deviation of a tool that hangs on a via-point alone bends sharply.
_STEP = 1e-5


def small(*, sliding: bool, via_points: int = 7, samples_per_segment: int = 20) -> cases.Case:
    path = {"legs": OUT_AND_BACK, "via_points": via_points}
    # What keeps constraints at samples alone exceeds wide ones by a smaller share between them.
    planner = {
        "samples_per_segment": samples_per_segment,
        "smoothing_weight": 0.1,
        "max_tool_deviation_m": 1e-3,
    }
    scene = short_scene(tool_path=path, planner=planner)
    fixed = cases.case_of(scene, "fixed")
    return replace(fixed, sliding=True, pinned=True) if sliding else fixed


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    with threadpool_limits(limits=1):
        yield


@pytest.fixture(scope="module")
def case() -> cases.Case:
    return small(sliding=False)


@pytest.fixture(scope="module", params=["fixed", "sliding"])
def all_rows(request: pytest.FixtureRequest) -> sampled.SampledProblem:
    return sampled.SampledProblem(small(sliding=request.param == "sliding"))


def filled(pattern: sparse.csc_array, data: np.ndarray) -> np.ndarray:
    return np.asarray(sparse.csc_array((data, pattern.indices, pattern.indptr), pattern.shape).toarray())


def test_casadis_dynamics_are_pinocchios(cmbot_robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("casadi")
    assert isinstance(symbolic_arm.verified(cmbot_robot), symbolic_arm.SymbolicArm)
    turn = symbolic_arm.SymbolicArm._turn

    def longer(arm: symbolic_arm.SymbolicArm, i: int) -> Any:
        given = turn(arm, i)
        return symbolic_arm._Turn(given.R, given.p + 1e-6)

    monkeypatch.setattr(symbolic_arm.SymbolicArm, "_turn", longer)
    with pytest.raises(SystemExit, match="miss pinocchio's by"):
        symbolic_arm.verified(cmbot_robot)


def test_derivatives_with_all_rows(all_rows: sampled.SampledProblem, rng: np.random.Generator) -> None:
    x = all_rows.start + 0.02 * rng.normal(size=len(all_rows.start))
    check_derivative(lambda y: all_rows.objective(y)[0], x, all_rows.objective(x)[1], rtol=1e-7)
    J = filled(all_rows.pattern, all_rows.jacobian(x))
    check_derivative(all_rows.values, x, J, step=_STEP, rtol=1e-6)
    pytest.importorskip("casadi")
    hessian, multipliers = lagrangian.LagrangianHessian(all_rows), rng.normal(size=len(all_rows.low))

    def gradient(y: np.ndarray) -> np.ndarray:
        J = filled(all_rows.pattern, all_rows.jacobian(y))
        return np.asarray(0.7 * all_rows.objective(y)[1] + J.T @ multipliers)

    upper = filled(hessian.pattern, hessian(x, 0.7, multipliers))
    check_derivative(gradient, x, upper + np.triu(upper, 1).T, step=_STEP, rtol=1e-5)


def test_the_literal_problem_has_derivatives_and_is_stopped(
    case: cases.Case, rng: np.random.Generator
) -> None:
    problem = literal.LiteralProblem(case, per_segment=4)
    x = problem.start + 1e-3 * rng.normal(size=len(problem.start))
    for part in (problem.objective, problem.equalities, problem.rows):
        check_derivative(lambda y, part=part: part(y)[0], x, part(x)[1], rtol=1e-6)  # type: ignore[misc]
    ticks = map(float, range(100))
    answer = literal.solve_literal(case, seconds=1.5, per_segment=4, clock=lambda: next(ticks))
    assert answer.cut
    assert answer.iterations == 2


def test_the_random_problem_is_as_large_as_the_papers_and_peaks_on_the_way() -> None:
    case = cases.case_of(cases.random_scene(), "fixed")
    problem = literal.LiteralProblem(case)
    assert problem.size == 7 * 48 * 2
    value, jacobian = problem.equalities(problem.start)
    assert jacobian.shape == (7 * 50, problem.size + 1)
    assert np.abs(value).max() < 1e-9
    # Six bounds on derivatives and two on the torque a joint, the peak and the tool at 491 samples.
    assert len(problem.rows(problem.start)[0]) == 491 * (7 * 8 + 2)
    given = case.problem()
    trajectory = given.parametrization.trajectory
    ends = trajectory.states(trajectory.t[[0, -1]])
    torque = Dynamics(case.request.cell.robot).efforts(*ends).guardrail_torque
    assert given.scale > 1.01 * np.linalg.norm(torque, axis=1).max()


@pytest.fixture(scope="module")
def rows(case: cases.Case) -> list[comparison.Solved]:

    pytest.importorskip("casadi")
    found = [comparison.solved_by_cmbot(case, name, repeats=1) for name in ("sqp", "slsqp")]
    found += [
        comparison.solved_by_other(case, name, ipopt.solve_sampled(case, exact=exact))
        for name, exact in comparison.IPOPT.items()
    ]
    return [*found, comparison.to_the_letter(case, 60.0)]


def test_every_solver_ends_at_cmbots_optimum(case: cases.Case, rows: list[comparison.Solved]) -> None:
    problem = case.problem()
    start = cases.judged(case, problem, problem.parametrization.trajectory)
    best = rows[0]
    assert start.objective - best.objective > 5e-4
    for row in rows:
        assert row.objective == pytest.approx(best.objective, rel=1e-4), row.solver
        # The literal problem and Ipopt keep joint limits at samples only.
        assert row.violation < (1e-2 if row.solver == comparison.LITERAL else 1e-4), row
    assert {row.solver for row in rows} == set(plot.COLOURS)


def test_sliding_via_points_too() -> None:
    pytest.importorskip("casadi")
    case = small(sliding=True, via_points=6, samples_per_segment=5)
    own = comparison.solved_by_cmbot(case, "slsqp", repeats=1)
    found = comparison.solved_by_other(case, "ipopt, exact", ipopt.solve_sampled(case, exact=True))
    assert found.status == "Solve_Succeeded"
    assert found.objective == pytest.approx(own.objective, rel=1e-4)


def test_judging_finds_violations(case: cases.Case) -> None:
    problem, good = case.problem(), case.solve("slsqp").parametrization.trajectory
    assert cases.judged(case, problem, good).violation <= 1e-4
    v = good.v.copy()
    v[3] += 0.5
    assert cases.judged(case, problem, replace(good, v=v)).violation > 0.1
    q = good.q.copy()
    q[3] += 1e-3
    assert cases.judged(case, problem, replace(good, q=q)).violation >= 1e-3


def test_drakes_blocks_are_the_sampled_rows(
    all_rows: sampled.SampledProblem, rng: np.random.Generator
) -> None:
    x = all_rows.start + 0.02 * rng.normal(size=len(all_rows.start))
    program = drake_sampled.drake_program(all_rows, peak_alone=False)
    d, N = all_rows.robot.dof, len(all_rows.problem.grid)
    values = [block.rows(x[block.of]) for block in program.blocks]
    tasks = len(all_rows.case.via_points) if all_rows.case.sliding else 0
    of_state = np.concatenate(values[: len(values) - tasks]).reshape(N, d + 2)
    expected = all_rows.values(x)
    np.testing.assert_allclose(of_state[:, 0], expected[:N], atol=1e-12)
    np.testing.assert_allclose(of_state[:, 1:-1].ravel(), expected[N : N * (d + 1)], atol=1e-12)
    np.testing.assert_allclose(of_state[:, -1], expected[N * (d + 1) : N * (d + 2)], atol=1e-12)
    linear = np.concatenate([np.minimum(A @ x - low, high - A @ x) for A, low, high in program.linear])
    rest = slice(N * (d + 2), len(expected) - 6 * tasks)
    room = np.minimum(expected - all_rows.low, all_rows.high - expected)[rest]
    np.testing.assert_allclose(linear, room, rtol=1e-9, atol=1e-9)
    for block in (program.blocks[0], program.blocks[3], program.blocks[-1]):
        at = x[block.of]
        check_derivative(block.rows, at, block.jacobian(at)[1], step=_STEP, rtol=1e-6)
    Q, c = program.objective
    np.testing.assert_allclose(
        0.5 * x @ Q @ x + c @ x - c @ all_rows.start,
        all_rows.objective(x)[0] - all_rows.objective(all_rows.start)[0],
        atol=1e-12,
    )


def test_drakes_solvers_end_at_cmbots_optimum(case: cases.Case, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pydrake")
    monkeypatch.setattr(formulations, "_REPEATS", 1)
    ways = {
        (solver, rows, samples): (case, solver, rows, samples, way, 60.0)
        for solver, rows, samples, way in formulations._ways(case)
    }
    best = formulations.solved_in_time(*ways["sqp", "exchange", 20])
    assert best.objective is not None
    for key in (("snopt", "exchange", 20), ("snopt", "all", 10), ("ipopt", "all", 10)):
        found = formulations.solved_in_time(*ways[key])
        assert found.objective == pytest.approx(best.objective, rel=2e-4), found
        assert found.violation is not None
        assert found.violation < (1e-4 if key[1] == "exchange" else 1e-2)
    table = tables._formulations([asdict(best), asdict(found)])
    assert table.rows[0][:3] == ("sqp", "exchange", f"1 ({best.iterations})")


def test_what_was_cut_is_not_tried_with_more_rows(case: cases.Case, monkeypatch: pytest.MonkeyPatch) -> None:
    def cut(*given: Any) -> formulations.Formulated:
        found = formulations._unsolved(*given[:4])
        too_long = given[1] == "snopt" and given[2:4] == ("peak", 40)
        return replace(found, status="cut after 1 s" if too_long else "done")

    monkeypatch.setattr(formulations, "solved_in_time", cut)
    found = list(formulations.formulated_case(case, 1.0, lambda _: None))
    left = [(each.solver, each.rows, each.samples) for each in found if each.status == "cut with fewer rows"]
    assert left == [("snopt", "all", 40)]
    assert len(found) == 11


def test_what_takes_too_long_is_cut() -> None:
    def forever() -> None:
        while True:
            pass

    assert measure.in_a_child(lambda: 7, 5.0) == 7
    assert measure.in_a_child(forever, 0.5) is None


PLANNED = {
    "scene": "triangle",
    "solver": "sqp",
    "motion": 20.0,
    "command": 1.7,
    "plan": 1.0,
    "way": 0.4,
    "polish": 0.3,
    "polish_slsqp": 0.4,
    "peak": 383.8,
    "peak_slsqp": 383.8,
    "core": 0.1,
    "simulate": 0.5,
    "simulated": 45.0,
}
LARGEST = {
    "via_points": 5000,
    "global_stage": 50.0,
    "optimisation": 15.0,
    "certificate": 5.0,
    "memory": 1500.0,
}
KERNEL = {"what": "values", "way": "one", "number": 500, "microseconds": 2.0, "used": True}


def made_up(**times: float) -> dict[str, Any]:
    """Results in which every solver ends at the same optimum, in these times."""
    same = comparison.Solved(
        problem="random",
        knots="fixed",
        solver="",
        seconds=0.0,
        peak=390.8,
        objective=0.999,
        violation=0.0,
        iterations=9,
        rows=100,
        status="ended",
    )
    names = {"exact": "ipopt, exact", "lbfgs": "ipopt, l-bfgs", "literal_slsqp": "literal slsqp"}
    solved = [replace(same, solver=names.get(key, key), seconds=time) for key, time in times.items()]
    return {
        "solvers": [asdict(each) for each in solved],
        "planned": [PLANNED],
        "growth": [LARGEST | {"via_points": 50}, LARGEST],
        "start_up": {"python": 0.02, "import cmbot": 0.03},
        "kernels": [KERNEL, KERNEL | {"way": "other", "microseconds": 7.0, "used": False}],
        "machine": measure.machine(),
        "quick": False,
    }


def test_goals_follow_from_the_results() -> None:
    results = made_up(sqp=0.1, exact=9.0, lbfgs=6.0, literal_slsqp=90.0)
    found = {goal.what: goal for goal in goals.goals(results)}
    for what, measured, met in (
        ("quicker than Ipopt, fixed via-points", pytest.approx(60.0), True),
        ("quicker than the literal problem", pytest.approx(900.0), False),
        ("5,000 via-points", 65.0, False),
    ):
        assert (found[what].measured, found[what].met) == (measured, met)
    assert found["core problem, fixed via-points"].met
    assert found["sliding polish, as planned"].met
    assert found["whole `cmbot plan triangle`"].met
    assert found["5,000 via-points, memory"].met
    results = made_up(sqp=0.1) | {"growth": []}
    unmeasured = [goal for goal in goals.goals(results) if goal.measured is None]
    assert len(unmeasured) == 5
    assert {goal.met for goal in unmeasured} == {None}
    assert ("5,000 via-points", "below 60 s", "–", "–", "not measured") in tables.goal_sheet(unmeasured).rows


@pytest.mark.parametrize("solver", [0, 2])
def test_an_optimum_is_reached_only_as_good_as_the_best(solver: int) -> None:
    results = made_up(sqp=0.1, exact=9.0, lbfgs=6.0)
    results["solvers"][solver]["objective"] *= 1.001
    ipopts = next(goal for goal in goals.goals(results) if "Ipopt" in goal.what)
    if solver == 0:
        assert ipopts.met is False
        assert "worse" in ipopts.remark
    else:  # an Ipopt that did not get there does not count
        assert ipopts.measured == pytest.approx(90.0)


def test_results_survive_the_file_and_can_be_drawn(rows: list[comparison.Solved], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    results = made_up() | {"solvers": [asdict(row) for row in rows]}
    read = json.loads(json.dumps(results))
    plot.draw(read, tmp_path / "a.png")
    plot.draw(read, tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    plot.draw(read | {"growth": []}, tmp_path / "c.png")
    sheets = tables.sheets(read)
    assert [sheet.key for sheet in sheets] == [
        "solvers",
        "planning",
        "simulating",
        "start-up",
        "kernels",
        "growth",
    ]
    for sheet in sheets:
        assert {len(row) for row in sheet.rows} == {len(sheet.headings)}
    assert sheets[0].rows[0][2] == "1"


def test_the_machine_is_described_without_names_and_a_missing_package_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = json.dumps(measure.machine())
    assert "/" not in text.replace("n/a", "")
    assert re.search(r'"python": "3\.\d+', text)
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(MissingExtra, match=r"casadi is not installed; run: pip install .*\[bench\]"):
        measure.required("casadi")
    monkeypatch.setattr(run, "measured", lambda *_: measure.required("casadi"))
    monkeypatch.setattr(sys, "argv", ["run.py"])
    with pytest.raises(SystemExit, match="error: casadi is not installed"):
        run.main()
    capsys.readouterr()


def test_blocks_go_between_their_markers_as_on_the_page(tmp_path: Path) -> None:
    path = tmp_path / "some.md"
    path.write_text("a\n<!-- goals -->\nold\n<!-- end of goals -->\nb\n")
    new = document.page(path, {"goals": "new"})
    assert new == "a\n<!-- goals -->\nnew\n<!-- end of goals -->\nb\n"
    with pytest.raises(SystemExit, match=r"some\.md: no place marked growth"):
        document.page(path, {"growth": "new"})
    results = json.loads(document.REFERENCE.read_text(encoding="utf-8"))
    text = document.PAGE.read_text(encoding="utf-8")
    assert document.page(document.PAGE, document.blocks(results)) == text
    assert document.FIGURE.is_file()
    assert results["goals"] == [asdict(goal) for goal in goals.goals(results)]
