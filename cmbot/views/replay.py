"""The motions of a plan in a browser: one page in 3-D, written to a file or served to this computer."""

from __future__ import annotations

import re
from html import escape
from http import HTTPStatus
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Self

from cmbot.common.errors import InputError
from cmbot.common.reading.validation import given_path
from cmbot.planning import Plan, require_plan
from cmbot.simulation import Tracking
from cmbot.views.page import STAGE_SCRIPTS, assemble, write_page
from cmbot.views.replay_data import replay_data

# http.server imports OpenSSL, which takes time: it is imported only to serve.
if TYPE_CHECKING:
    from http.server import BaseHTTPRequestHandler

LOOPBACK = "127.0.0.1"
_HOST = re.compile(rf"({re.escape(LOOPBACK)}|localhost)(:\d{{1,5}})?")


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
        File for one self-contained page; it appears whole or not at all.
    serve : bool
        Serve the same page on 127.0.0.1; nothing is printed, and no browser opened.
    port : int
        To serve on; 0: any free one.
    tracking : Tracking, optional
        Of that plan: the tool of the elastic arm is then shown, too.

    Returns
    -------
    ReplayServer or None
        With `serve`: running, with its `url`; the caller closes it.

    Raises
    ------
    InputError
        When `plan` is none, neither `html` nor `serve` is given, the file cannot be written, the port is
        taken, or `tracking` is that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.

    Examples
    --------
    >>> cmbot.replay(plan, "replay.html", tracking=tracking)
    >>> with cmbot.replay(plan, serve=True) as server:
    ...     server.url
    'http://127.0.0.1:...'
    """
    require_plan(plan, "cmbot.replay")
    if html is None and not serve:
        raise InputError("replay", "html, serve", "neither", "a file to write, or serve=True")
    path = None if html is None else given_path(html, "cmbot.replay", "html", "the path of a file to write")
    page = replay_page(plan, tracking)
    if path is not None:
        write_page(path, page)
    return ReplayServer(page, port) if serve else None


def replay_page(plan: Plan, tracking: Tracking | None = None) -> str:
    """Return an HTML page that shows a plan, its approach and its baseline moving, in 3-D.

    It contains meshcat's viewer and all data; its content security policy forbids every connection and every
    script but its own two. The same plan gives the same page. Surfaces are simplified to 24 000
    triangles of the robot and 12 000 of the obstacles, so a page stays below 5 MB; only meshes of very many
    loose parts keep more.

    Parameters
    ----------
    plan : Plan
    tracking : Tracking, optional
        Of that plan: the tool of the elastic arm is then shown, too.

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
    return assemble(
        "replay.html",
        styles=("common.css", "replay.css"),
        scripts=(*STAGE_SCRIPTS, "downloads.js", "plot.js", "replay.js"),
        data=data,
        texts={"title": escape(plan.scene.name), "base": escape(plan.scene.base_name)},
    )


class ReplayServer:
    """One page, served on 127.0.0.1 from a thread until closed. A context manager.

    meshcat's own server listens on every interface, so it is not used. Requests with another host's name are
    refused: a web page elsewhere cannot read this one by resolving its name to 127.0.0.1.

    Parameters
    ----------
    page : str
        HTML.
    port : int
        0: any free one.

    Raises
    ------
    InputError
        When the port is taken or out of range.
    """

    def __init__(self, page: str, port: int = 0) -> None:
        from http.server import ThreadingHTTPServer

        try:
            self._server = ThreadingHTTPServer((LOOPBACK, port), _handler(page.encode("utf-8", "replace")))
        except (OSError, OverflowError, TypeError) as error:
            raise InputError("replay", "port", port, f"a free port ({error})") from error
        self._server.daemon_threads = True
        self._thread = Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return int(self._server.server_address[1])

    @property
    def url(self) -> str:
        """Address to open in a browser."""
        return f"http://{LOOPBACK}:{self.port}/"

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it is closed, at most `timeout` seconds; return whether it is."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def close(self) -> None:
        """Stop listening; a second call does nothing."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _handler(page: bytes) -> type[BaseHTTPRequestHandler]:
    from http.server import BaseHTTPRequestHandler

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:  # the base class requires this name
            if not _HOST.fullmatch(self.headers.get("Host", "")):
                self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
            elif self.path.partition("?")[0] != "/":
                self.send_error(HTTPStatus.NOT_FOUND)
            else:
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", "text/html; charset=utf-8")
                self.send_header("Content-Length", str(len(page)))
                self.send_header("Cache-Control", "no-store")
                self.send_header("X-Content-Type-Options", "nosniff")
                self.end_headers()
                self.wfile.write(page)

        def log_message(self, format: str, *args: object) -> None:
            """Print nothing: only the command line prints."""

    return Handler
