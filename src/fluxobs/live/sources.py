"""Where a stream comes from: a port, a network, standard input, a file that grows, the demo."""

from __future__ import annotations

import os
import re
import socket
import stat
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from itertools import count, islice
from pathlib import Path
from typing import Any

from ..errors import FluxobsError, RecordError
from .frames import MARK

#: Bytes that are taken at once.
_CHUNK = 65536
#: Seconds between looks at a file that grows, and for which a port is asked.
_PAUSE, _LOOK = 0.02, 0.1
#: Where datagrams are taken from if no address says so: this computer alone.
_LOOPBACK = "127.0.0.1"
#: Datagrams that are taken at once.
_ATONCE = 4096
#: Seconds after which a sender that is silent may be one that starts again.
_SILENCE = 5.0
#: Rows that the demo sends at once.
_DEMO_ROWS = 50


class Source(ABC):
    """Bytes as they come.

    Attributes
    ----------
    name : str
    patient : bool
        Whether what is not read waits: nothing is lost before somebody looks.
    ignored : int
        Datagrams of other senders, which were left out.
    """

    name: str
    patient = False
    ignored = 0

    @abstractmethod
    def chunks(self) -> Iterator[bytes]:
        """Yield what has come, b"" now and then if nothing does, until the stream ends."""


class File(Source):
    """A file from its beginning on, and what is written to it later; a pipe until it is closed."""

    patient = True

    def __init__(self, path: Path, follow: bool = True) -> None:
        self.name, self.path, self.follow = path.name, path, follow

    def chunks(self) -> Iterator[bytes]:
        try:
            with self.path.open("rb", buffering=0) as file:
                pipe = stat.S_ISFIFO(os.fstat(file.fileno()).st_mode)
                while True:
                    data = file.read(_CHUNK) or b""
                    yield data
                    if data:
                        continue
                    if pipe or not self.follow:
                        return
                    now = self.path.stat()
                    if now.st_size < file.tell():
                        raise RecordError(f"{self.path}: the file became shorter while it was read")
                    if now.st_ino != os.fstat(file.fileno()).st_ino:
                        raise RecordError(f"{self.path}: another file has taken its place")
                    time.sleep(_PAUSE)
        except OSError as error:
            raise RecordError(f"{self.path}: cannot be read: {error.strerror}") from None


class Input(Source):
    """Standard input."""

    name, patient = "standard input", True

    def chunks(self) -> Iterator[bytes]:
        if sys.stdin is None:
            raise RecordError("standard input is closed")
        while data := os.read(sys.stdin.fileno(), _CHUNK):
            yield data


class Datagrams(Source):
    """UDP: whole lines or frames in each datagram; its end is a line's end too.

    It keeps to the sender of the first datagram. After a silence, another port of the same host
    takes over: a sender that starts again gets another one.
    """

    def __init__(self, host: str, port: int) -> None:
        self.name = f"udp:{host}:{port}"
        self._sender: tuple[str, int] | None = None
        self._heard = 0.0  # when it spoke last
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        try:
            self._socket.bind((host, port))
        except (OSError, UnicodeError) as error:  # the latter: no name of a host
            self._socket.close()
            raise _unopened(self.name, error) from None
        self._socket.settimeout(_LOOK)

    def chunks(self) -> Iterator[bytes]:
        with self._socket:
            while True:
                try:
                    data = self._received()
                except TimeoutError:
                    data = b""
                yield data + self._waiting() if data else data

    def _received(self) -> bytes:
        """The next datagram; nothing if it is of another sender."""
        data, sender = self._socket.recvfrom(_CHUNK)
        if not data:
            return data
        now, before = time.monotonic(), self._sender
        if before is None or (sender[0] == before[0] and now - self._heard > _SILENCE):
            self._sender = sender
        elif sender != before:
            self.ignored += 1
            return b""
        self._heard = now
        return _ended(data)

    def _waiting(self) -> bytes:
        """What else has come: many small pieces cost more than few large ones."""
        out = bytearray()
        self._socket.setblocking(False)
        try:
            for _ in range(_ATONCE):  # others may send without end
                out += self._received()
                if len(out) >= _CHUNK:
                    break
        except BlockingIOError:
            pass
        finally:
            self._socket.settimeout(_LOOK)
        return bytes(out)


def _ended(datagram: bytes) -> bytes:
    return datagram if datagram.startswith(MARK) or datagram.endswith(b"\n") else datagram + b"\n"


class Connection(Source):
    """A TCP connection, until the other side closes it."""

    def __init__(self, name: str, host: str, port: int) -> None:
        self.name = name
        try:
            self._socket = socket.create_connection((host, port), timeout=5)
        except (OSError, UnicodeError) as error:  # the latter: no name of a host
            raise _unopened(name, error) from None
        self._socket.settimeout(_LOOK)

    def chunks(self) -> Iterator[bytes]:
        with self._socket:
            while True:
                try:
                    data = self._socket.recv(_CHUNK)
                except TimeoutError:
                    yield b""
                    continue
                except OSError as error:
                    raise RecordError(
                        f"{self.name}: the connection broke: {error.strerror}"
                    ) from None
                if not data:
                    return
                yield data


class Serial(Source):
    """A serial port, or what else pyserial opens, as rfc2217://HOST:PORT."""

    def __init__(self, port: str, baud: int) -> None:
        try:
            import serial
        except ModuleNotFoundError:
            raise FluxobsError(
                f"{port}: serial ports need pyserial: pip install 'fluxobs[live]'"
            ) from None
        self.name = port
        self._failed: Any = serial.SerialException
        try:
            self._port: Any = serial.serial_for_url(port, baudrate=baud, timeout=_LOOK)
        except (serial.SerialException, ValueError) as error:
            raise RecordError(f"{port}: cannot be opened: {error}") from None

    def chunks(self) -> Iterator[bytes]:
        with self._port as port:
            while True:
                try:
                    yield port.read(max(1, min(port.in_waiting, _CHUNK)))
                except (self._failed, OSError):
                    raise RecordError(f"{self.name}: the port is gone") from None


class Demo(Source):
    """A simulated motor in real time."""

    name, patient = "demo", True

    def chunks(self) -> Iterator[bytes]:
        from ..simulation.closed_form.demo import SAMPLE_TIME
        from ..simulation.closed_form.endless import COLUMNS, endless

        yield (",".join(COLUMNS) + "\n").encode()
        began, rows = time.monotonic(), endless()
        for sent in count(1):
            some = islice(rows, _DEMO_ROWS)
            yield "".join([",".join([f"{v:.6g}" for v in row]) + "\n" for row in some]).encode()
            ahead = began + sent * _DEMO_ROWS * SAMPLE_TIME - time.monotonic()
            if ahead > 0:
                time.sleep(ahead)


def _unopened(name: str, error: Exception) -> RecordError:
    return RecordError(f"{name}: cannot be opened: {getattr(error, 'strerror', None) or error}")


def _port(text: str, number: str) -> int:
    if not 0 < int(number) < 65536:
        raise FluxobsError(f"{text}: a port lies between 1 and 65535")
    return int(number)


def open_source(text: str, baud: int) -> Source:
    """Open what a user names.

    Parameters
    ----------
    text : str
        "-", "udp:PORT" (of this computer's own programs), "udp:ADDRESS:PORT" (sent to one of its
        addresses; 0.0.0.0: to any), "socket://HOST:PORT", a serial port or a URL of pyserial, or
        a file.
    baud : int
        Of a serial port [1/s].

    Raises
    ------
    FluxobsError
        It is not there, or cannot be opened.
    """
    if text == "-":
        return Input()
    if found := re.fullmatch(r"udp:(?://)?(?:([^:]*):)?([0-9]{1,9})", text):
        return Datagrams(found[1] or _LOOPBACK, _port(text, found[2]))
    if found := re.fullmatch(r"socket://(.+):([0-9]{1,9})", text):
        return Connection(text, found[1], _port(text, found[2]))
    path = Path(text)
    if re.fullmatch(r"COM\d+|\w[\w+.-]*://.*", text) or path.is_char_device():
        return Serial(text, baud)
    if path.is_dir():
        raise RecordError(f"{text}: this is a folder")
    if not path.exists():
        raise RecordError(
            f"{text}: no such file or port. A stream is a serial port, udp:PORT, socket://HOST:PORT,"
            f" a file, or - for standard input"
        )
    return File(path)
