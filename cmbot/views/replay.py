"""Shows how a plan moves: in a page of its own, or served to the browsers of this computer."""

from __future__ import annotations

from pathlib import Path

from cmbot.common.arguments import given_path
from cmbot.common.errors import InputError
from cmbot.planning import Plan, require_plan
from cmbot.simulation import Tracking
from cmbot.views.page_file import write_page
from cmbot.views.replay_page import replay_page
from cmbot.views.replay_server import ReplayServer

__all__ = ["replay", "serve_replay"]


def replay(
    plan: Plan,
    html: str | Path | None = None,
    serve: bool = False,
    *,
    port: int = 0,
    tracking: Tracking | None = None,
) -> ReplayServer | None:
    """Write a replay of a plan, or serve it, or both.

    Parameters
    ----------
    plan : Plan
    html : str or Path, optional
        Write one self-contained page there: it appears whole or not at all.
    serve : bool
        Serve the same page on 127.0.0.1; nothing is printed, and no browser opened.
    port : int
        To serve on; 0: any that is free.
    tracking : Tracking, optional
        Of that plan: where the bending arm carries the tool is then shown, too.

    Returns
    -------
    ReplayServer or None
        With `serve`: running, with its `url`; to be closed.

    Raises
    ------
    InputError
        When `plan` is none, neither `html` nor `serve` is given, the file cannot be written, the port is
        taken, or `tracking` is that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    require_plan(plan, "cmbot.replay")
    if html is None and not serve:
        raise InputError("replay", "html, serve", "neither", "a file to write, or serve=True")
    path = None if html is None else given_path(html, "cmbot.replay", "html", "the path of a file to write")
    page = replay_page(plan, tracking)
    if path is not None:
        write_page(path, page)
    return ReplayServer(page, port) if serve else None


def serve_replay(plan: Plan, port: int = 0, tracking: Tracking | None = None) -> ReplayServer:
    """Serve the replay of a plan on 127.0.0.1, as ``replay(plan, serve=True)``.

    Raises
    ------
    InputError
        When the port is taken, or `tracking` is that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    return ReplayServer(replay_page(plan, tracking), port)
