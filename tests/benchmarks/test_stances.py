"""Where to stand: goals that follow from the figures, tables that are those of the page."""

import json
from typing import Any

import pytest
import stances
from report.document import page
from small_scenes import short_scene

from cmbot.planning import plan
from cmbot.stances import StanceFigures, StanceRanking, StanceResult
from cmbot.stances.search import Rejection, Status
from cmbot.stances.walking import stance_of


def row(**changes: Any) -> dict[str, Any]:
    figures = {"sag_mm": 2.5, "first_hz": 5.5, "job_torque": 350.0}
    counts = {"stances": 1739, "planned": 3, "proven": 0, "failed": 0}
    costs = {"seconds": 20.0, "processor_seconds": 10.0}
    told = {"scene": "a", "by": "torque", "unit": "Nm", "place": "here", "value": 200.0, "own_value": 400.0}
    both = {"figures": figures, "own_figures": figures, "least_bound": 199.0}
    return told | counts | costs | both | changes


def goals(*rows: dict[str, Any]) -> dict[str, tuple[str, ...]]:
    screened = {"scene": "a", "stances": 2400, "bounded": 9, "processor_seconds": 30.0}
    made = stances.sheets({"found": dict(enumerate(rows)), "screened": [screened]})
    cells = [cells for sheet in made if sheet.key == "goals of stances" for cells in sheet.rows]
    return {goal: rest for goal, *rest in cells}


def test_goals_follow_from_the_figures() -> None:
    assert [*goals(row()).values()] == [["0.5 %", "met"], ["25.0 s", "missed"], ["20 s at most", "met"]]
    (better, *_) = goals(row(least_bound=180.0)).values()
    assert better == ["10.0 %", "missed"]
    *_, command = goals(row(seconds=61.0)).values()
    assert command == ["61 s at most", "missed"]


def test_what_is_kept_is_kept_together() -> None:
    kept = stances._kept_in_words()
    _, together, *_ = goals(row(by=kept)).values()
    assert together == ["2.50 mm, 5.50 Hz, 350 Nm", "met"]
    for name, value in (("sag_mm", 3.1), ("first_hz", 4.9), ("job_torque", 356.0)):
        figures = row()["figures"] | {name: value}
        _, together, *_ = goals(row(by=kept, figures=figures)).values()
        assert together[-1] == "missed"


def test_where_no_stance_keeps_the_bounds_the_nearest_is_told() -> None:
    none = row(
        by=stances._kept_in_words(), place="", nearest="there: sag 3.2 mm, 3 mm are allowed", value=0.0
    )
    together, *others = goals(none).values()
    assert together == ["none; there: sag 3.2 mm, 3 mm are allowed", "missed"]
    assert len(others) == 2
    (table,) = stances.blocks({"found": {"kept": none}, "screened": []}).values()
    assert "none; there: sag 3.2 mm" in table


def test_half_of_the_sway_counts_with_no_more_sag() -> None:
    own = {"sag_mm": 12.0, "sway_mm": 10.0}
    for sway, sag, met in ((4.9, 12.0, "met"), (5.1, 11.0, "missed"), (4.0, 12.1, "missed")):
        calm = row(by="sway", figures=row()["figures"] | {"sag_mm": sag, "sway_mm": sway}, own_figures=own)
        assert [*goals(calm).values()][1][-1] == met


def test_the_smallest_bound_that_counts() -> None:
    """Of the others, those of which planning failed too, but not those that exceed a bound."""
    scene = short_scene()
    own, place = plan(scene), stance_of(scene)
    peak, known = own.objective.planned_peak, StanceFigures(torque=1.0)
    ranked = [
        StanceResult(
            candidate=place, stage="plan", bound=peak, value=peak, figures=known, plan=own, own=True
        ),
        StanceResult(candidate=place, stage="charts", bound=0.99 * peak),
    ]
    kinds: tuple[tuple[Status, float], ...] = (
        ("failed", 0.95),
        ("beyond a bound", 0.5),
        ("blocked", 0.1),
    )
    for kind, share in kinds:
        why = Rejection(kind=kind, reason="", cause="")
        ranked.append(StanceResult(candidate=place, stage="plan", bound=share * peak, rejection=why))
    found = stances.Found.of(StanceRanking(scene=scene, ranked=tuple(ranked)), "torque", 1.0, 1.0)
    assert found.own_value == found.value == peak
    assert found.may_be_better == pytest.approx(0.05)


def test_the_page_is_that_of_the_results() -> None:
    text = stances.DOCUMENT.read_text(encoding="utf-8")
    results = json.loads(stances.REFERENCE.read_text(encoding="utf-8"))
    assert page(stances.DOCUMENT, stances.blocks(results)) == text
