"""Tours: work and walks on one clock, in one page; other stances where no walk leads on."""

import importlib
import json
from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene
from walks import one_step

from cmbot.archive import json_bytes
from cmbot.common.errors import PlanningError
from cmbot.planning import plan
from cmbot.stances import StanceRanking, StanceResult
from cmbot.stances.walking import Tour, stance_of, tour, tour_data
from cmbot.views import tour_page

MODULE = importlib.import_module("cmbot.stances.walking.tour")


@pytest.fixture(scope="module")
def works() -> tuple[StanceResult, ...]:
    """Two planned stances, the same one."""
    scene = short_scene()
    figures: Any = {"stage": "plan", "bound": 1.0, "value": 1.0}
    made = plan(scene)
    return tuple(StanceResult(candidate=stance_of(scene), plan=made, **figures) for _ in range(2))


@pytest.fixture(scope="module")
def standings(works: tuple[StanceResult, ...]) -> tuple[StanceRanking, ...]:
    return tuple(StanceRanking(scene=each.plan.scene, ranked=(each,)) for each in works)


def test_work_and_walks_are_on_one_clock(
    works: tuple[StanceResult, ...], standings: tuple[StanceRanking, ...]
) -> None:
    walked, job = one_step(), works[0].plan.job.duration
    made = Tour(name="both", standings=standings, works=works, walks=(walked,))
    assert [(name, begin) for name, begin, _ in made.parts] == [
        ("work_1", 0.0),
        ("walk_1", job),
        ("work_2", job + walked.seconds),
    ]
    assert made.seconds == pytest.approx(2 * job + walked.seconds)
    data = json.loads(json_bytes(tour_data(made)))
    assert [part["kind"] for part in data["parts"]] == ["work", "walk", "work"]
    needed = [part["adhesion_needed"] for part in data["parts"]]
    assert needed[1] is None  # it walks on clamps
    assert f"{max(needed[0], needed[2]) / 1e3:.2f} kN" in data["words"][3]
    page = tour_page(made)
    assert "<script" not in page.replace("<script></script>", "")
    assert [page.count(f'href="{part}"') for part in ("work_1/report.html", "walk_1/replay.html")] == [1, 1]
    # The ways of both feet in each move, and the tool path of each stroke.
    strokes = sum(len(plan.strokes) for plan in made.plans)
    assert page.count('class="way"') == 2 * len(walked.moves)
    assert page.count("<polyline") == 2 * len(walked.moves) + strokes


def test_where_no_walk_leads_on_another_stance_is_taken(
    works: tuple[StanceResult, ...], standings: tuple[StanceRanking, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    (first, second), walked = works, one_step()
    both = StanceRanking(scene=standings[0].scene, ranked=(first, second))
    tried = []

    def walk(*_: Any) -> Any:
        tried.append(_)
        if len(tried) < 4:
            raise PlanningError("no step holds")
        return walked

    monkeypatch.setattr(MODULE, "walk", walk)
    monkeypatch.setattr(MODULE, "stand", lambda *_: (both, both))
    monkeypatch.setattr(MODULE, "Balance", lambda *_: None)
    made = tour(standings[0].scene)
    assert made.works == (second, second)
    assert len(made.failures) == 3
    # Where the work ends is where the walk begins.
    np.testing.assert_allclose(tried[0][0].posture, first.plan.job.trajectory.q[-1], atol=1e-9)
    monkeypatch.setattr(MODULE, "walk", lambda *_: (_ for _ in ()).throw(PlanningError("no step holds")))
    with pytest.raises(PlanningError, match=r"no walk from one stance to the next: .* no step holds"):
        tour(standings[0].scene)
