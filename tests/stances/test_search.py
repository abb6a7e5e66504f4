"""The search among stances: who is judged when, and what is said where the time was over."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cmbot.common.errors import PathNotFound, PlanningError
from cmbot.common.workers import Workers
from cmbot.stances import StanceRanking, StandOptions, in_words, require_planned
from cmbot.stances.search import Ending, Rejection, Stage, StanceResult, evaluate_stances


def searched(
    needs: list[float],
    limit: float,
    monkeypatch: pytest.MonkeyPatch,
    plans: int = 1,
    plan_needs: float = 0.0,
) -> tuple[StanceRanking, list[tuple[int, float]]]:
    """Stances that need so many seconds to be charted and planned, the best first; and who had how many."""
    now, had = [0.0], list[tuple[int, float]]()
    monkeypatch.setattr("cmbot.stances.search.monotonic", lambda: now[0])
    ending = Ending(limit=limit, _began=0.0)

    def late(result: StanceResult, stage: Any, needed: float) -> StanceResult | None:
        part = ending.part(stage)
        had.append((result.number, part))
        now[0] += min(part, needed)
        if part >= needed:
            return None
        error = PathNotFound("late", time=0.0, progress=0.0, smallest_singular_value=1.0, stopped=True)
        return result.rejected(stage, Rejection.of("blocked", error))

    def judge(result: StanceResult, ending: Ending) -> StanceResult:
        return late(result, "charts", needs[result.number]) or replace(result, stage="charts")

    def planned(result: StanceResult, ending: Ending) -> StanceResult:
        return late(result, "plan", plan_needs) or replace(
            result, stage="plan", plan=plan, value=result.bound
        )

    plan: Any = SimpleNamespace(job=SimpleNamespace(figures=SimpleNamespace(adhesion_needed=None)))
    plan.robot = SimpleNamespace(holding=None)
    results = []
    for number in range(len(needs)):
        base = np.eye(4)
        base[0, 3] = number
        candidate: Any = SimpleNamespace(base=base, place=f"place {number}")
        results.append(
            StanceResult(candidate=candidate, number=number, stage="postures", bound=100.0 + number)
        )
    charts = Stage(name="charts", judge=judge, most=20, step="charting")
    plans_ = Stage(name="plan", judge=planned, most=20, step="planning")
    options = StandOptions(plans=plans)
    found = evaluate_stances(results, (charts, plans_), options, ending)
    ranked = tuple(sorted(found, key=lambda each: each.order))
    scene: Any = None
    return StanceRanking(scene=scene, ranked=ranked, plans=plans, ended_by=ending.by), had


def test_what_was_not_charted_in_its_time_has_more_in_the_next_round(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ranking, had = searched([35.0, 10.0, 35.0, 10.0], 200.0, monkeypatch, plans=2)
    assert [number for number, _ in had] == [0, 1, 1, 2, 0, 0]
    first, _, _, third, again, _ = (part for _, part in had)
    assert first == 0.15 * 200
    assert third == pytest.approx(0.15 * (200 - 30 - 10))
    assert again == pytest.approx(2 * 0.15 * (200 - 30 - 10 - third))
    assert [each.number for each in ranking.ranked if each.status == "planned"] == [0, 1]


def test_stances_without_time_are_named_first(monkeypatch: pytest.MonkeyPatch) -> None:
    ranking, had = searched([900.0, 900.0, 900.0], 100.0, monkeypatch, plans=2, plan_needs=900.0)
    assert sum(part for _, part in had) <= 100.1
    assert ranking.ended_by == "time"
    assert [each.status for each in ranking.ranked] == ["not judged"] * 2 + ["screened"]
    assert ranking.best_unplanned == 100.0
    closest = (
        "not judged to the end for want of time: 3, 1 of them only screened; first place 0, by its bound "
        "100 Nm; a longer --time-limit with planner.time_limit_s as long judges it"
    )
    said = [*in_words(ranking)]
    assert f"N{closest[1:]}." in said
    assert "3 stances: 2 not judged, 1 screened." in said
    with pytest.raises(
        PlanningError, match=re.escape(f"of 3 was planned; the time was over (--time-limit): {closest}")
    ):
        require_planned([ranking])


def test_without_a_limit_nothing_is_late(monkeypatch: pytest.MonkeyPatch) -> None:
    ranking, had = searched([900.0, 1.0], np.inf, monkeypatch)
    # The second one is charted beside the first one, before that is known to be the best.
    assert had == [(0, np.inf), (1, np.inf), (0, np.inf)]
    assert ranking.best is not None and not ranking.ended_by


def test_a_share_of_the_time_is_for_plans(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the charts would take: from 60 % on, and what one chart takes then, the rest is for plans."""
    ranking, _ = searched([900.0] * 20, 100.0, monkeypatch, plans=2, plan_needs=0.85 * 40.0 / 2)
    assert [each.number for each in ranking.ranked if each.status == "planned"] == [0, 1]


@pytest.mark.parametrize(("needs", "parts"), [(10.0, [25.0, 50.0, 40.0]), (30.0, [25.0, 25.0, 10.0])])
def test_without_a_plan_of_the_own_stance_the_first_one_comes_before_better_ones(
    needs: float, parts: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """None is charted before; each has little time, so that a minute is enough for several."""
    now, had = [0.0], list[tuple[int, float]]()
    monkeypatch.setattr("cmbot.stances.search.monotonic", lambda: now[0])
    ending = Ending(limit=np.inf, _began=0.0)

    def plan(result: StanceResult, ending: Ending) -> StanceResult:
        if result.own:
            return result.rejected("plan", Rejection(kind="failed", reason="none", cause="none"))
        part = ending.part("plan")
        had.append((result.number, part))
        now[0] += min(part, needs)
        if part >= needs:
            made: Any = SimpleNamespace()
            return replace(result, stage="plan", plan=made, value=result.bound)
        return result.rejected("plan", Rejection(kind="not judged", reason="time", cause="time"))

    def never(result: StanceResult, ending: Ending) -> StanceResult:
        raise AssertionError("charted before there is a plan")

    results = []
    for number in range(4):
        base = np.eye(4)
        base[0, 3] = number
        candidate: Any = SimpleNamespace(base=base, place=f"place {number}")
        results.append(
            StanceResult(
                candidate=candidate, number=number, stage="postures", bound=100.0 + number, own=number == 0
            )
        )
    checks = Stage(
        name="obstacles", judge=lambda result, _: replace(result, stage="obstacles"), most=20, step="checking"
    )
    stages = (
        checks,
        Stage(name="charts", judge=never, most=20, step=""),
        Stage(name="plan", judge=plan, most=8, step=""),
    )
    found = evaluate_stances(results, stages, StandOptions(plans=3), ending, alone=True)
    assert had == [*zip((3, 1, 2), parts, strict=True)]
    assert [each.status == "planned" for each in found[1:]] == [part >= needs for part in parts]
    assert now[0] <= 60.0


@pytest.mark.parametrize(("proves", "planned"), [(False, [0, 1]), (True, [0, 1, 2, 3])])
def test_where_bounds_are_proven_all_that_a_proof_leaves_open_are_planned(
    proves: bool, planned: list[int]
) -> None:
    """Bounds of 100 to 106 of which plans reach 104 and more: by the others 4, 3 and 1 % may be gained."""

    def plan(result: StanceResult, ending: Ending) -> StanceResult:
        made: Any = SimpleNamespace()
        return replace(result, stage="plan", plan=made, value=104.0 + result.number)

    results = []
    for number, bound in enumerate((100.0, 100.5, 101.0, 101.5, 103.0, 106.0)):
        base = np.eye(4)
        base[0, 3] = number
        candidate: Any = SimpleNamespace(base=base, place=f"place {number}")
        results.append(StanceResult(candidate=candidate, number=number, stage="charts", bound=bound))
    stages = (Stage(name="plan", judge=plan, most=8, step=""),)
    options, ending = StandOptions(plans=2), Ending(limit=np.inf)
    found = evaluate_stances(results, stages, options, ending, proves=proves)
    assert [each.number for each in found if each.status == "planned"] == planned


@pytest.mark.parametrize("fails", [False, True])
def test_stances_beside_each_other_are_planned_at_once_where_no_others_are_left(fails: bool) -> None:
    """Where the first one fails the other one is planned after all others, for the same reason."""
    had, beside = list[str](), Workers(1)

    def plan(result: StanceResult, ending: Ending) -> StanceResult:
        had.append(f"planned {result.number}")
        if fails and result.number == 0:
            return result.rejected("plan", Rejection(kind="failed", reason="none", cause="none"))
        made: Any = SimpleNamespace()
        return replace(result, stage="plan", plan=made, value=200.0)

    class Recorded(Workers):
        def call(self, function: Any, /, *args: Any, **kwargs: Any) -> Any:
            had.append(f"sent {args[0].number}")
            return beside.call(function, *args, **kwargs)

    results = []
    for number in range(2):
        base = np.eye(4)
        base[0, 3] = 0.1 * number
        candidate: Any = SimpleNamespace(base=base, place=f"place {number}")
        results.append(StanceResult(candidate=candidate, number=number, stage="charts", bound=100.0))
    stages = (Stage(name="plan", judge=plan, most=8, step=""),)
    evaluate_stances(results, stages, StandOptions(plans=2), Ending(limit=np.inf), workers=Recorded(1))
    assert had == ["sent 0", "sent 1", "planned 0", *(["sent 1"] if fails else []), "planned 1"]


def test_what_rules_out_those_judged_with_obstacles_is_told_beside_what_rules_out_more() -> None:
    def rejected(stage: Any, cause: str) -> StanceResult:
        candidate: Any = SimpleNamespace(place="", base=np.eye(4))
        one = StanceResult(candidate=candidate, stage="postures", bound=np.inf)
        return one.rejected(stage, Rejection(kind="blocked", reason=cause, cause=cause))

    many = [rejected("postures", cause) for cause in ("one", "two", "three") for _ in range(3)]
    scene: Any = None
    ranking = StanceRanking(
        scene=scene, ranked=(*many, rejected("obstacles", "web"), rejected("charts", "web"))
    )
    assert ranking.reasons_in_words == "one (3), two (3), three (3); of 2 with obstacles web (2)"
    late = replace(ranking, ended_by="time")
    with pytest.raises(PlanningError, match=r"of 11 was planned, most often for: one .* web \(2\); the time"):
        require_planned([late])
    assert replace(ranking, ranked=tuple(many)).reasons_in_words == "one (3), two (3), three (3)"
