"""A stream for the page: it is served to this computer's browser, the stream over a WebSocket."""

from __future__ import annotations

import json
import queue
import re
import threading
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from ..errors import FluxobsError
from ..web import built

#: Pieces of the stream that may wait for a slow browser; one that is slower yet is let go.
_WAITING = 1000
#: What a row, or a frame, begins with.
_ROW = re.compile(rb"^[-+.0-9\xf1]", re.MULTILINE)
#: A preamble is shorter [bytes].
_PREAMBLE = 1 << 16
_CONNECT = "connect-src 'none'"
_SETTINGS = '<script type="application/json" id="live">null</script>'


class Server:
    """Serves the page and the stream on localhost; nobody else's page may read it.

    Parameters
    ----------
    port : int
        0: any that is free.
    settings : mapping
        What the page begins with: machine, options, name.
    patient : bool
        Whether the stream may wait until a browser takes it.

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
        self._head = b""  # lines above the first row, while it has not come all that was sent
        self._sent = self._rows = False
        self._browsers: set[_Browser] = set()
        self._lock = threading.Lock()
        try:
            self._server: Any = serve(
                self._stream, "localhost", port, process_request=self._page, compression=None
            )
        except OSError as error:
            raise FluxobsError(
                f"port {port} cannot be opened: {error.strerror}; give another one with --port"
            ) from None
        number = self._server.socket.getsockname()[1]
        self._hosts = [f"localhost:{number}", f"127.0.0.1:{number}"]
        self.url = f"http://localhost:{number}/"
        allowed = " ".join([f"ws://{host}" for host in self._hosts])
        data = json.dumps(dict(settings), ensure_ascii=False).replace("</", "<\\/")
        self._text = built("page.html").replace(_CONNECT, f"connect-src {allowed}", 1)
        self._text = self._text.replace(_SETTINGS, _SETTINGS.replace("null", data, 1), 1)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _page(self, connection: Any, request: Any) -> Any:
        """Answer what is no WebSocket; None if it is one."""
        if request.headers.get("Host") not in self._hosts:
            return connection.respond(HTTPStatus.FORBIDDEN, "localhost only\n")
        if request.path == "/stream":
            if request.headers.get("Origin") in [f"http://{host}" for host in self._hosts]:
                return None
            return connection.respond(HTTPStatus.FORBIDDEN, "only for the page served here\n")
        if request.path != "/":
            return connection.respond(HTTPStatus.NOT_FOUND, "not here\n")
        answer = connection.respond(HTTPStatus.OK, self._text)
        del answer.headers["Content-Type"]
        answer.headers["Content-Type"] = "text/html; charset=utf-8"
        return answer

    def _stream(self, connection: Any) -> None:
        """Send the stream to a browser until either ends."""
        from websockets.exceptions import ConnectionClosed

        with self._lock:
            one = _Browser(late=self._sent)
            if one.late:
                one.waiting.put(self._head)
            self._browsers.add(one)
        self.watched.set()
        try:
            while (data := one.waiting.get()) is not None:
                connection.send(data)
            connection.close()
        except ConnectionClosed:
            pass
        finally:
            with self._lock:
                self._browsers.discard(one)
            one.gone.set()

    def send(self, data: bytes) -> None:
        """Send what has come to all browsers."""
        with self._lock:
            self._sent = True
            if not self._rows:
                self._head, self._rows = _above(self._head + data)
            browsers = list(self._browsers)
        for one in browsers:
            one.take(data, self._patient)

    def end(self) -> None:
        """Send the rest: the stream has ended."""
        with self._lock:
            browsers = list(self._browsers)
        for one in browsers:
            one.waiting.put(None)
        for one in browsers:
            one.gone.wait(10)
        self._server.shutdown()


def _above(first: bytes) -> tuple[bytes, bool]:
    """Lines above the first row, which name the columns for a browser that comes late, and whether
    that row has come. In frames the names come again."""
    found = _ROW.search(first)
    if found is None and len(first) < _PREAMBLE:
        return first, False
    return first[: found.start() if found else 0], True


class _Browser:
    """What waits for a browser. One that looks late begins at a whole line."""

    def __init__(self, late: bool) -> None:
        self.late = late
        self.gone = threading.Event()
        self.waiting: queue.Queue[bytes | None] = queue.Queue()

    def take(self, data: bytes, patient: bool) -> None:
        if self.late:
            data = data[data.find(b"\n") + 1 :] if b"\n" in data else b""
            self.late = not data
        while patient and self.waiting.qsize() > _WAITING and not self.gone.wait(0.01):
            pass
        if self.waiting.qsize() > _WAITING:
            self.waiting.put(None)  # it is too slow: the page says that the stream has ended
        elif data:
            self.waiting.put(data)
