"""Writes what a plan gains, what it keeps and how it moves into one page."""

from __future__ import annotations

from pathlib import Path

from cmbot.common.arguments import given_path
from cmbot.planning import Plan, require_plan
from cmbot.simulation import Tracking
from cmbot.views.page_file import write_page
from cmbot.views.report_page import report_page

__all__ = ["report"]


def report(plan: Plan, html: str | Path, *, tracking: Tracking | None = None) -> None:
    """Write a report of a plan: one self-contained page with its replay, plots and tables.

    Parameters
    ----------
    plan : Plan
    html : str or Path
        It appears whole or not at all; an earlier file of that name is replaced.
    tracking : Tracking, optional
        Of that plan, from `cmbot.simulate`: its plots and figures are then in the report, too.

    Raises
    ------
    InputError
        When `plan` is none, the file cannot be written, or `tracking` is that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    require_plan(plan, "cmbot.report")
    path = given_path(html, "cmbot.report", "html", "the path of a file to write")
    write_page(path, report_page(plan, tracking))
