"""Which solver makes a plan, and what happens where one gives up."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import pytest
from small_scenes import short_scene
from urdf_arms import panda_scene

from cmbot.archive import load_plan, save
from cmbot.cli.inspection import examine
from cmbot.common.errors import MissingExtra, OptimisationFailed
from cmbot.optimization import exchange
from cmbot.planning import Plan, plan, remarks
from cmbot.planning.context import build_context
from cmbot.planning.initial_guess import InitialGuess, fixed_guess, sliding_guess
from cmbot.planning.precheck import solver_of
from cmbot.planning.torque.decomposition import optimise
from cmbot.scene import PlannerOptions, Scene


def guess_of(scene: Scene, solver: Literal["sqp", "slsqp"]) -> InitialGuess:
    context = build_context(scene, replace(scene.planner, solver=solver))
    return sliding_guess(context) if scene.planner.knots == "sliding" else fixed_guess(context)


def test_what_no_trajectory_can_keep_is_named() -> None:
    """A tool deviation that via-points so far apart cannot hold."""
    legs = [{"by": [0, -0.6, 0], "seconds": 4}]
    scene = short_scene(
        tool_path={"legs": legs, "via_points": 6}, planner={"max_tool_deviation_m": 1e-6, "solver": "sqp"}
    )
    with pytest.raises(OptimisationFailed) as caught:
        optimise(guess_of(scene, "sqp").problem)
    assert caught.value.constraint == "tool deviation"
    assert caught.value.violation > 1


def test_a_long_path_with_few_via_points_does_not_creep(tmp_path: Path) -> None:
    """The tool's deviation bends away from nearly every step; uncorrected this took hundreds of them."""
    legs = [
        {"by": [0, 0.1, 0], "seconds": 3},
        {"by": [0, 0, -0.1], "seconds": 3},
        {"by": [0, -0.1, 0.1], "seconds": 3},
    ]
    scene = panda_scene(tmp_path, legs=legs, via_points=12)
    guess = guess_of(
        replace(scene, planner=replace(scene.planner, chart_spacing=0.3, samples_per_segment=15)), "sqp"
    )
    found = optimise(guess.problem)
    assert sum(report.iterations for report in found.passes) <= 80
    assert found.passes[-1].worst.value <= scene.planner.constraint_tolerance
    assert found.passes[-1].peak_torque < guess.problem.scale


@pytest.mark.parametrize("undecided", [True, False])
def test_where_it_gives_up_auto_tries_slsqp_and_the_plan_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, undecided: bool
) -> None:
    def gives_up(*_: Any, **__: Any) -> Any:
        raise OptimisationFailed(
            "the steps became too small", constraint="none", violation=1.0, undecided=undecided
        )

    monkeypatch.setattr(exchange, "solve_sqp", gives_up)
    told: list[str] = []
    scene = short_scene(planner={"solver": "auto"})
    if undecided:
        planned = plan(scene, progress=lambda progress: told.append(progress.step))
        assert planned.options.solver == "slsqp"
        assert any("slsqp" in step for step in told)
        said = "The solver sqp gave up (the steps became too small): planned with slsqp instead."
        assert planned.fallbacks == (said,)
        assert said in list(remarks(planned))
        assert load_plan(save(planned, tmp_path / "plan")).fallbacks == (said,)
    else:
        with pytest.raises(OptimisationFailed):
            plan(scene)
    with pytest.raises(OptimisationFailed):
        plan(short_scene(planner={"solver": "sqp"}))


def test_the_plan_says_which_solver_made_it(short_plan: Plan, tmp_path: Path) -> None:
    """And, where nothing failed, nothing else."""
    assert plan(short_scene(planner={"solver": "auto"})).options.solver == "sqp"
    assert plan(short_scene(planner={"solver": "slsqp"})).options.solver == "slsqp"
    assert short_plan.fallbacks == () == load_plan(save(short_plan, tmp_path / "plan")).fallbacks
    assert not any("instead" in remark or "as a whole" in remark for remark in remarks(short_plan))


def test_without_piqp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "piqp", None)
    assert solver_of(PlannerOptions(solver="auto")) == "slsqp"
    assert solver_of(PlannerOptions(solver="slsqp")) == "slsqp"
    with pytest.raises(MissingExtra, match=r"piqp is not installed; run: pip install .*\[fast\]"):
        plan(short_scene(planner={"solver": "sqp"}))


def test_the_doctor_knows_piqp() -> None:
    found = {symptom.name: symptom for symptom in examine()}
    assert found["piqp"].healthy
