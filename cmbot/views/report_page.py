"""The report as one HTML page that needs nothing but a browser: the replay, plots and tables."""

from __future__ import annotations

from html import escape
from typing import Any

from cmbot.planning import Plan, remarks
from cmbot.simulation import Tracking
from cmbot.version import __version__
from cmbot.views.charts import MOST_SMALL_POINTS, charts, joint_charts
from cmbot.views.headlines import headlines
from cmbot.views.page_parts import assembled
from cmbot.views.replay_data import replay_data
from cmbot.views.replay_page import STAGE_SCRIPTS
from cmbot.views.report_tables import cards, sections

__all__ = ["report_html", "report_page"]


def report_page(plan: Plan, tracking: Tracking | None = None) -> str:
    """Return an HTML page that says what a plan gains and what it keeps, and shows it moving.

    It holds meshcat's viewer and all data, opens no connection (its content security policy forbids any), and
    runs no script but its own two. It stays below 6 MB, and prints.

    Parameters
    ----------
    plan : Plan
    tracking : Tracking, optional
        Of that plan: its plots and figures are then on the page, too.

    Raises
    ------
    InputError
        When `tracking` is that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    return report_html(plan, tracking, replay_data(plan, tracking))


def report_html(plan: Plan, tracking: Tracking | None, data: dict[str, Any]) -> str:
    """Return that page for a plan's `replay_data`."""
    plots = {
        "charts": [chart.data() for chart in charts(plan, tracking)],
        "jointCharts": [chart.data(MOST_SMALL_POINTS) for chart in joint_charts(plan)],
        "joints": list(plan.robot.joints),
    }
    return assembled(
        "report.html",
        styles=("common.css", "report.css"),
        scripts=(*STAGE_SCRIPTS, "chart.js", "report.js"),
        data=data | plots,
        texts={
            "title": escape(plan.scene.name),
            "made": escape(f"Written by cmbot {__version__}."),
            "cards": cards(headlines(plan, tracking)),
            "bending": "" if tracking is not None else " hidden",
            "sections": sections(plan, tracking, remarks(plan)),
        },
    )
