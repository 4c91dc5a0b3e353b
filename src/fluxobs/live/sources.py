"""Sources of a stream: serial port, network, standard input, growing file, demo."""

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

#: Bytes read at once.
_CHUNK = 65536
#: Seconds between reads of a growing file, and timeout of a port.
_PAUSE, _TIMEOUT = 0.02, 0.1
#: Default address for datagrams; only programs of this computer can send to it.
_LOOPBACK = "127.0.0.1"
#: Datagrams read at once.
_DATAGRAMS = 4096
#: Seconds of silence after which another port may take over, in case the sender restarted.
_SILENCE = 5.0
#: Rows sent at once by the demo.
_DEMO_ROWS = 50


class Source(ABC):
    """Bytes of a stream.

    Attributes
    ----------
    name : str
    patient : bool
        Whether unread bytes are kept, so that no byte is lost before the first read.
    ignored : int
        Datagrams left out because they came from other senders.
    """

    name: str
    patient = False
    ignored = 0

    @abstractmethod
    def chunks(self) -> Iterator[bytes]:
        """Yield received bytes until the stream ends; while none arrive, yield b"" at times."""


class File(Source):
    """A file, read from its beginning and while it grows, or a pipe, read until it is closed."""

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
                        raise RecordError(f"{self.path}: the file was replaced while it was read")
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
    """UDP datagrams of whole lines or frames; the end of a datagram is the end of a line.

    Only the sender of the first datagram is read. After a silence, another port of the same host
    may take over, because a sender that restarts gets another port.
    """

    def __init__(self, host: str, port: int) -> None:
        self.name = f"udp:{host}:{port}"
        self._sender: tuple[str, int] | None = None
        self._heard = 0.0  # time of the sender's last datagram [s]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        try:
            self._socket.bind((host, port))
        except (OSError, UnicodeError) as error:  # UnicodeError: malformed host name
            self._socket.close()
            raise _unopened(self.name, error) from None
        self._socket.settimeout(_TIMEOUT)

    def chunks(self) -> Iterator[bytes]:
        with self._socket:
            while True:
                try:
                    data = self._receive()
                except TimeoutError:
                    data = b""
                yield data + self._receive_waiting() if data else data

    def _receive(self) -> bytes:
        """Return the next datagram, or b"" if it came from another sender."""
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
        return _end_line(data)

    def _receive_waiting(self) -> bytes:
        """Return the waiting datagrams in one chunk, because many small chunks cost more time."""
        data = bytearray()
        self._socket.setblocking(False)
        try:
            for _ in range(_DATAGRAMS):  # bounded, because another sender may never stop
                data += self._receive()
                if len(data) >= _CHUNK:
                    break
        except BlockingIOError:
            pass
        finally:
            self._socket.settimeout(_TIMEOUT)
        return bytes(data)


def _end_line(datagram: bytes) -> bytes:
    return datagram if datagram.startswith(MARK) or datagram.endswith(b"\n") else datagram + b"\n"


class Connection(Source):
    """A TCP connection, read until the other side closes it."""

    def __init__(self, name: str, host: str, port: int) -> None:
        self.name = name
        try:
            self._socket = socket.create_connection((host, port), timeout=5)
        except (OSError, UnicodeError) as error:  # UnicodeError: malformed host name
            raise _unopened(name, error) from None
        self._socket.settimeout(_TIMEOUT)

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
    """A serial port, or a URL that pyserial opens, such as rfc2217://HOST:PORT."""

    def __init__(self, port: str, baud: int) -> None:
        try:
            import serial
        except ModuleNotFoundError:
            raise FluxobsError(
                f"{port}: serial ports need pyserial: pip install 'fluxobs[live]'"
            ) from None
        self.name = port
        self._error: Any = serial.SerialException
        try:
            self._port: Any = serial.serial_for_url(port, baudrate=baud, timeout=_TIMEOUT)
        except (serial.SerialException, ValueError) as error:
            raise RecordError(f"{port}: cannot be opened: {error}") from None

    def chunks(self) -> Iterator[bytes]:
        with self._port as port:
            while True:
                try:
                    yield port.read(max(1, min(port.in_waiting, _CHUNK)))
                except (self._error, OSError):
                    raise RecordError(f"{self.name}: the port was disconnected") from None


class Demo(Source):
    """A simulated motor in real time."""

    name, patient = "demo", True

    def chunks(self) -> Iterator[bytes]:
        from ..simulation.closed_form.demo import SAMPLE_TIME
        from ..simulation.closed_form.endless import COLUMNS, endless

        yield (",".join(COLUMNS) + "\n").encode()
        start, rows = time.monotonic(), endless()
        for sent in count(1):
            batch = islice(rows, _DEMO_ROWS)
            yield "".join([",".join([f"{v:.6g}" for v in row]) + "\n" for row in batch]).encode()
            ahead = start + sent * _DEMO_ROWS * SAMPLE_TIME - time.monotonic()
            if ahead > 0:
                time.sleep(ahead)


def _unopened(name: str, error: Exception) -> RecordError:
    return RecordError(f"{name}: cannot be opened: {getattr(error, 'strerror', None) or error}")


def _port(text: str, number: str) -> int:
    if not 0 < int(number) < 65536:
        raise FluxobsError(f"{text}: the port must be between 1 and 65535")
    return int(number)


def open_source(text: str, baud: int) -> Source:
    """Open the source that a user names.

    Parameters
    ----------
    text : str
        "-", "udp:PORT" (from programs of this computer), "udp:ADDRESS:PORT" (sent to this address
        of the computer; 0.0.0.0: to any), "socket://HOST:PORT", a serial port, a URL of pyserial,
        or a file.
    baud : int
        Bit rate of a serial port [1/s].

    Raises
    ------
    FluxobsError
        The source does not exist or cannot be opened.
    """
    if text == "-":
        return Input()
    if match := re.fullmatch(r"udp:(?://)?(?:([^:]*):)?([0-9]{1,9})", text):
        return Datagrams(match[1] or _LOOPBACK, _port(text, match[2]))
    if match := re.fullmatch(r"socket://(.+):([0-9]{1,9})", text):
        return Connection(text, match[1], _port(text, match[2]))
    path = Path(text)
    if re.fullmatch(r"COM\d+|\w[\w+.-]*://.*", text) or path.is_char_device():
        return Serial(text, baud)
    if path.is_dir():
        raise RecordError(f"{text}: is a folder; give a file or port")
    if not path.exists():
        raise RecordError(
            f"{text}: no such file or port. Give a serial port, udp:PORT, socket://HOST:PORT, a "
            f"file, or - for standard input"
        )
    return File(path)
