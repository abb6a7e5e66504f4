"""The pages of a plan directory."""

from __future__ import annotations

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views.replay_data import replay_data
from cmbot.views.replay_page import replay_html
from cmbot.views.report_page import report_html

__all__ = ["REPLAY", "REPORT", "pages"]

REPLAY, REPORT = "replay.html", "report.html"


def pages(plan: Plan, tracking: Tracking | None = None) -> dict[str, bytes]:
    """Return what `replay` and `report` write, by the names that they have in a plan directory.

    Raises
    ------
    InputError
        When `tracking` is that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    data = replay_data(plan, tracking)
    texts = {REPLAY: replay_html(plan, data), REPORT: report_html(plan, tracking, data)}
    return {name: text.encode("utf-8", "replace") for name, text in texts.items()}
