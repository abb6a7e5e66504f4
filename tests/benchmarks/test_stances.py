"""What another stance saves: goals that follow from the figures, tables that are those of the page."""

import json
from typing import Any

import pytest
import stances
from report.document import page
from small_scenes import short_scene

from cmbot.planning import plan
from cmbot.stances import Standing, StandOptions, Stood
from cmbot.stances.walking import stance_of


def row(**changes: Any) -> dict[str, Any]:
    figures = {"torque": 200.0, "own_torque": 400.0, "adhesion": 4000.0, "own_adhesion": 1e4, "peak": 200.0}
    counts = {"stances": 1739, "planned": 3, "failed": 0, "seconds": 20.0, "processor_seconds": 10.0}
    told = {"scene": "a", "by": "torque", "place": "post_3 at 1.00 m (outer)", "least_bound": 199.0}
    return told | counts | figures | changes


def goals(*rows: dict[str, Any]) -> list[tuple[str, ...]]:
    screened = {"scene": "a", "stances": 2400, "within_reach": 9, "bounded": 9, "processor_seconds": 30.0}
    made = stances.sheets({"found": rows, "screened": [screened | {"seconds": 90.0}], "compared": []})
    return [cells[1:] for sheet in made if sheet.key == "goals of stances" for cells in sheet.rows]


def test_goals_follow_from_the_figures() -> None:
    assert goals(row()) == [("0.40", "met"), ("25.0 s", "met"), ("0.5 %", "met")]
    # What asks more torque than the scene's own stance does not count, of the others the best one does.
    heavy = row(torque=500.0, adhesion=1000.0)
    assert goals(heavy, row(adhesion=6000.0))[0] == ("0.60", "missed")
    assert goals(row(least_bound=190.0))[2] == ("5.0 %", "missed")


def test_the_search_is_measured_beside_the_scenes_own_stance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the others the smallest bound counts, but not of those that load the guardrail too much."""
    scene = short_scene()
    own, place = plan(scene), stance_of(scene)
    peak = own.objective.planned_peak
    figures: Any = {"torque": 1.0, "adhesion": 1.0, "judged": "plan"}
    ranked = [Stood(candidate=place, status="planned", plan=own, bound=peak, **figures)]
    for status, share in (("screened", 0.99), ("failed", 0.95), ("too much torque", 0.5), ("blocked", 0.1)):
        ranked.append(Stood(candidate=place, status=status, bound=share * peak, **figures))
    standing = Standing(scene=scene, unit="Nm", ranked=tuple(ranked))
    monkeypatch.setattr(stances, "stand", lambda *_: (standing,))
    found = stances.found(scene, own, "hold", StandOptions(max_torque=300.0))
    assert found.by == "adhesion, 300 Nm at most"
    assert found.torque == found.own_torque == own.figures.peak_guardrail_torque
    assert found.may_be_better == pytest.approx(0.05)


def test_the_page_is_that_of_the_results() -> None:
    text = stances.DOCUMENT.read_text(encoding="utf-8")
    results = json.loads(stances.REFERENCE.read_text(encoding="utf-8"))
    assert page(stances.DOCUMENT, stances.blocks(results)) == text
