"""What did not work and was done in another way is said of the plan, and kept with it."""

from pathlib import Path
from typing import Any

import pytest
from small_scenes import short_scene

from cmbot.archive import load_plan, save
from cmbot.common.errors import OptimisationFailed
from cmbot.optimization import exchange
from cmbot.planning import Plan, plan, remarks
from cmbot.planning.torque import decomposition
from cmbot.planning.torque.problem import TorqueProblem

LEGS = [{"by": [0, side * 0.1, 0], "seconds": 3.0} for side in (-1, 1)]


def fails(*_: Any, **__: Any) -> Any:
    raise OptimisationFailed("the steps became too small", constraint="none", violation=1.0, undecided=True)


def kept(made: Plan, folder: Path) -> tuple[str, ...]:
    save(made, folder)
    return load_plan(folder).fallbacks


def test_where_nothing_failed_nothing_is_said(short_plan: Plan, tmp_path: Path) -> None:
    assert short_plan.fallbacks == () == kept(short_plan, tmp_path / "plan")
    assert not any("instead" in remark or "as a whole" in remark for remark in remarks(short_plan))


def test_another_solver_is_named_and_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(exchange, "solve_sqp", fails)
    made = plan(short_scene(planner={"solver": "auto"}))
    said = "The solver sqp gave up (the steps became too small): planned with slsqp instead."
    assert made.fallbacks == (said,) == kept(made, tmp_path / "plan")
    assert said in list(remarks(made))


def test_a_path_that_could_not_be_parted_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(decomposition, "LONGEST_WHOLE", 10)
    monkeypatch.setattr(decomposition, "_LEAST", 6)
    monkeypatch.setattr(decomposition, "_MOST", 10)
    scene = short_scene(tool_path={"legs": LEGS, "via_points": 17}, planner={"solver": "sqp"})
    assert plan(scene).fallbacks == ()
    monkeypatch.setattr(TorqueProblem, "segment", fails)
    made = plan(scene)
    (said,) = made.fallbacks
    assert said.startswith("The path was optimised as a whole, as a segment failed (the")
    assert said in list(remarks(made))
    assert kept(made, tmp_path / "plan") == (said,)
