"""Shows a page to browsers on this computer only."""

from __future__ import annotations

from http import HTTPStatus
from threading import Event, Thread
from types import TracebackType
from typing import TYPE_CHECKING, Self

from cmbot.common.errors import InputError

# Who only writes pages shall not wait for http.server, which brings OpenSSL: it is imported where it is used.
if TYPE_CHECKING:
    from http.server import BaseHTTPRequestHandler

__all__ = ["ReplayServer"]

LOOPBACK = "127.0.0.1"


class ReplayServer:
    """One page, served on 127.0.0.1 from a thread until closed. A context manager.

    meshcat's own server listens on every interface, so it is not used. Requests that were sent to another
    host's name are refused: a web page elsewhere cannot read this one by pointing its name at 127.0.0.1.

    Parameters
    ----------
    page : str
        HTML.
    port : int
        0: any that is free.

    Raises
    ------
    InputError
        When the port is taken or is none.
    """

    def __init__(self, page: str, port: int = 0) -> None:
        from http.server import ThreadingHTTPServer

        try:
            self._server = ThreadingHTTPServer((LOOPBACK, port), _handler(page.encode("utf-8", "replace")))
        except (OSError, OverflowError, TypeError) as error:
            raise InputError("replay", "port", port, f"a free port ({error})") from error
        self._server.daemon_threads = True
        self._closed = Event()
        self._thread = Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self._server.server_address[1])

    @property
    def url(self) -> str:
        """Address to open in a browser."""
        return f"http://{LOOPBACK}:{self.port}/"

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it is closed, at most `timeout` seconds; return whether it is."""
        return self._closed.wait(timeout)

    def close(self) -> None:
        """Stop listening; a second call does nothing."""
        if not self._closed.is_set():
            self._server.shutdown()
            self._thread.join()
            self._server.server_close()
            self._closed.set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _handler(page: bytes) -> type[BaseHTTPRequestHandler]:
    from http.server import BaseHTTPRequestHandler

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:  # the base class asks for this name
            name, _, _ = self.headers.get("Host", "").partition(":")
            if name not in (LOOPBACK, "localhost"):
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
            """Say nothing: only the command line prints."""

    return Handler
