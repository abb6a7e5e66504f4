"""The replay as one HTML page that needs nothing but a browser."""

from __future__ import annotations

import html
from typing import Any

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views.page_parts import assembled
from cmbot.views.replay_data import replay_data

__all__ = ["STAGE_SCRIPTS", "replay_html", "replay_page"]

STAGE_SCRIPTS = ("stage.js", "marks.js", "motions.js", "player.js")
"""The 3-D view and the time: what the report shares with the replay."""


def replay_page(plan: Plan, tracking: Tracking | None = None) -> str:
    """Return an HTML page that shows a plan, its approach and its baseline moving, in 3-D.

    It holds meshcat's viewer and all data, opens no connection (its content security policy forbids any), and
    runs no script but its own two. The same plan gives the same page.

    Meshes with more than 24 000 triangles in all are simplified, and so are obstacles above 12 000: a page
    stays below 5 MB.

    Parameters
    ----------
    plan : Plan
    tracking : Tracking, optional
        Of that plan: where the bending arm carries the tool is then shown, too.

    Raises
    ------
    InputError
        When `tracking` is that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    return replay_html(plan, replay_data(plan, tracking))


def replay_html(plan: Plan, data: dict[str, Any]) -> str:
    """Return that page for a plan's `replay_data`."""
    return assembled(
        "replay.html",
        styles=("common.css", "replay.css"),
        scripts=(*STAGE_SCRIPTS, "plot.js", "replay.js"),
        data=data,
        texts={"title": html.escape(plan.scene.name)},
    )
