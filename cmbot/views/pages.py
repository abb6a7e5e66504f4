"""The pages of a plan directory."""

from __future__ import annotations

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views.replay_page import replay_page
from cmbot.views.report_page import report_page

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
    texts = {REPLAY: replay_page(plan, tracking), REPORT: report_page(plan, tracking)}
    return {name: text.encode("utf-8", "replace") for name, text in texts.items()}
