"""Server of the live page for a browser on this computer; the stream goes over a WebSocket."""

from __future__ import annotations

import contextlib
import queue
import re
import socket
import threading
import time
from collections.abc import Callable, Mapping
from http import HTTPStatus
from typing import Any

from ..errors import FluxobsError
from ..page import built, in_script
from .frames import MARK

#: Chunks that may wait for a slow browser; with more chunks, the browser is disconnected.
_WAITING = 1000
#: Seconds within which a browser must accept a chunk.
_PATIENCE = 3.0
#: First characters of a row or a frame.
_ROW = re.compile(rb"^[ \t]*[-+.0-9\xf1]", re.MULTILINE)
#: Every preamble is shorter than this [bytes].
_PREAMBLE = 1 << 16
_CONNECT = "connect-src 'none'"
_SETTINGS = '<script type="application/json" id="live">null</script>'


class Server:
    """Server of the page and the stream on localhost; pages of other origins cannot read them.

    Parameters
    ----------
    port : int
        Port of the server; 0 chooses any free port.
    settings : mapping
        Initial settings of the page: machine, options, name.
    patient : bool
        Whether the stream may wait for a slow browser.

    Attributes
    ----------
    url : str
    watched : threading.Event
        Set once a browser has asked for the stream.
    """

    def __init__(self, port: int, settings: Mapping[str, Any], patient: bool) -> None:
        try:
            from websockets.sync.server import serve
        except ModuleNotFoundError:
            raise FluxobsError(
                "the live page needs websockets: pip install 'fluxobs[live]'; --text shows the "
                "stream in the terminal without it"
            ) from None
        self.watched = threading.Event()
        self._patient = patient
        self._head = b""  # lines above the first row; before the first row, all bytes sent
        self._sent = self._rows = False
        self._whole = True  # whether the last line sent is complete
        self._browsers: set[_Browser] = set()
        self._lock = threading.Lock()
        try:
            self._server: Any = serve(
                self._stream, "localhost", port, process_request=self._page, compression=None
            )
        except OSError as error:
            raise FluxobsError(
                f"port {port} cannot be opened: {error.strerror}; choose another port (--port)"
            ) from None
        number = self._server.socket.getsockname()[1]
        self._hosts = [f"localhost:{number}", f"127.0.0.1:{number}"]
        self.url = f"http://localhost:{number}/"
        allowed = " ".join([f"ws://{host}" for host in self._hosts])
        data = in_script(dict(settings))
        self._text = built("page.html").replace(_CONNECT, f"connect-src {allowed}", 1)
        self._text = self._text.replace(_SETTINGS, _SETTINGS.replace("null", data, 1), 1)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _page(self, connection: Any, request: Any) -> Any:
        """Answer a request; return None to accept a WebSocket."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if len(hosts) != 1 or len(origins) > 1:
            return connection.respond(HTTPStatus.BAD_REQUEST, "one Host and at most one Origin\n")
        if hosts[0] not in self._hosts:
            return connection.respond(HTTPStatus.FORBIDDEN, "localhost only\n")
        if request.path == "/stream":
            if origins and origins[0] in [f"http://{host}" for host in self._hosts]:
                return None
            return connection.respond(HTTPStatus.FORBIDDEN, "only the page served here\n")
        if request.path != "/":
            return connection.respond(HTTPStatus.NOT_FOUND, "not found\n")
        answer = connection.respond(HTTPStatus.OK, self._text)
        del answer.headers["Content-Type"]
        answer.headers["Content-Type"] = "text/html; charset=utf-8"
        return answer

    def _stream(self, connection: Any) -> None:
        """Send the stream to a browser until the stream ends or the browser disconnects."""
        from websockets.exceptions import ConnectionClosed

        with self._lock:
            browser = _Browser(connection, late=not self._whole)
            if self._sent:
                browser.waiting.put(self._head)
            self._browsers.add(browser)
        self.watched.set()
        try:
            while (data := browser.waiting.get()) is not None:
                connection.send(data)
                browser.taken += 1
            connection.close()
        except (ConnectionClosed, OSError):
            pass
        finally:
            with self._lock:
                self._browsers.discard(browser)
            browser.gone.set()

    def send(self, data: bytes) -> None:
        """Send received bytes to all browsers."""
        with self._lock:
            self._sent = True
            if not self._rows:
                self._head, self._rows = _above(self._head + data)
            browsers = list(self._browsers)
            self._whole = data.endswith(b"\n") or data.startswith(MARK)
        for browser in browsers:
            browser.take(data, self._patient)

    def end(self, now: bool = False) -> None:
        """End the stream once the browsers have received the rest, or at once if `now`."""
        with self._lock:
            browsers = list(self._browsers)
        for browser in browsers:
            browser.end()
            if now or not browser.moves_on(browser.gone.is_set):
                browser.drop()
        self._server.shutdown()


def _above(first: bytes) -> tuple[bytes, bool]:
    """Return the lines above the first row, and whether the first row has arrived.

    These lines name the columns for a browser that connects late. Frames repeat the names.
    """
    row = _ROW.search(first)
    if row is None and len(first) < _PREAMBLE:
        return first, False
    return first[: row.start() if row else 0], True


class _Browser:
    """Queue of a browser. A browser that connects within a line starts at the next line."""

    def __init__(self, connection: Any, late: bool) -> None:
        self.connection, self.late = connection, late
        self.taken, self.ended = 0, False
        self.gone = threading.Event()
        self.waiting: queue.Queue[bytes | None] = queue.Queue()

    def take(self, data: bytes, patient: bool) -> None:
        """Queue data; disconnect a browser that is too slow (the page shows a message)."""
        if self.ended:
            return
        if self.late:
            at = data.find(b"\n") + 1
            self.late = at == 0
            data = data[at:] if at else b""
        if self.waiting.qsize() > _WAITING and not (
            patient and self.moves_on(lambda: self.waiting.qsize() <= _WAITING)
        ):
            self.end()
        elif data:
            self.waiting.put(data)

    def end(self) -> None:
        """Disconnect once the queue is empty."""
        self.ended = True
        self.waiting.put(None)

    def moves_on(self, enough: Callable[[], bool]) -> bool:
        """Wait until `enough()` or the browser is gone; return False if the browser stalls."""
        taken, since = self.taken, time.monotonic()
        while not enough() and not self.gone.wait(0.01):
            if self.taken != taken:
                taken, since = self.taken, time.monotonic()
            elif time.monotonic() - since > _PATIENCE:
                return False
        return True

    def drop(self) -> None:
        """Close the connection at once."""
        self.gone.set()
        with contextlib.suppress(OSError):
            self.connection.socket.shutdown(socket.SHUT_RDWR)
