"""Every figure that is said of a job is the worst of its segments, as certificates and figures have it.

The other shipped jobs are judged where they are planned: `tests/planning/test_pipe.py` and the like.
"""

from dataclasses import replace

import pytest
from clamped import HOLDS, clamped_plan
from told import not_found, require_told

from cmbot.planning import Plan


@pytest.mark.parametrize(
    "name",
    ["triangle_plan", "line_plan", "strokes_plan", "returning_plan", "short_plan", "fixed_line_plan"],
)
def test_jobs_that_others_plan(request: pytest.FixtureRequest, name: str) -> None:
    require_told(request.getfixturevalue(name))


@pytest.mark.parametrize("hold", HOLDS)
def test_jobs_of_several_strokes_on_a_foot(hold: str) -> None:
    require_told(clamped_plan(hold))


@pytest.mark.parametrize("change", [{"peak_guardrail_torque": 123.4}, {"min_clearance": 0.0123}])
def test_a_figure_that_no_segment_has_is_found_out(strokes_plan: Plan, change: dict[str, float]) -> None:
    """Else the tests above could not fail."""
    wrong = replace(strokes_plan, job=replace(strokes_plan.job))
    wrong.job.__dict__["figures"] = replace(strokes_plan.job.figures, **change)
    assert not_found(wrong)
