"""Shows how a plan moves: in a page of its own, or served to the browsers of this computer."""

from __future__ import annotations

import contextlib
import uuid
from pathlib import Path

from cmbot.errors import InputError
from cmbot.planning import Plan
from cmbot.views.replay_page import replay_page
from cmbot.views.replay_server import ReplayServer

__all__ = ["replay", "serve_replay"]


def replay(
    plan: Plan, html: str | Path | None = None, serve: bool = False, *, port: int = 0
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

    Returns
    -------
    ReplayServer or None
        With `serve`: running, with its `url`; to be closed.

    Raises
    ------
    InputError
        When neither `html` nor `serve` is given, the file cannot be written or the port is taken.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    if html is None and not serve:
        raise InputError("replay", "html, serve", "neither", "a file to write, or serve=True")
    page = replay_page(plan)
    if html is not None:
        _write(Path(html), page)
    return ReplayServer(page, port) if serve else None


def serve_replay(plan: Plan, port: int = 0) -> ReplayServer:
    """Serve the replay of a plan on 127.0.0.1, as ``replay(plan, serve=True)``.

    Raises
    ------
    InputError
        When the port is taken.
    ModelError, SceneError
        When a shape cannot be drawn.
    """
    return ReplayServer(replay_page(plan), port)


def _write(path: Path, text: str) -> None:
    """Write a file beside its place, then move it there."""
    draft = path.parent / f".{uuid.uuid4().hex}.html"
    try:
        draft.write_text(text, encoding="utf-8", errors="replace", newline="\n")
        draft.replace(path)
    except (OSError, ValueError) as error:
        with contextlib.suppress(OSError, ValueError):
            draft.unlink(missing_ok=True)
        got = f"a file that cannot be written ({getattr(error, 'strerror', None) or error})"
        raise InputError(str(path), "", got, "a path where a file can be written") from error
