"""Binary frames sent by the telemetry of an exported observer (templates/telemetry.c).

=======  ==========================================================================
bytes    content
=======  ==========================================================================
0, 1     0xF1, 0x0B
2        kind: "H" names the columns, "S" holds samples
3        n, the length of the payload, 1 to 255
4, 5     number of the first sample, modulo 65536, low byte first
6 …      payload, n bytes
then     CRC-16 of bytes 2 to 5 + n: polynomial 0x1021, start 0xFFFF, low byte first
=======  ==========================================================================

The payload of H is text, ``SAMPLE_TIME,LAG,NAME,NAME,…`` in seconds and samples, for example
``5e-05,1,u_alpha,u_beta,i_alpha,i_beta``. The payload of S is one or more samples: for each column
a float of four bytes, low byte first. H comes first and is repeated, so a reader may start at any
frame.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import RecordError
from ..logs.formats.table import Columns
from .lines import pieces
from .rows import StreamRows

if TYPE_CHECKING:
    from .reorder import Ordered

MARK = b"\xf1\x0b"
HEADER, SAMPLES = ord("H"), ord("S")
_FRAMING = 8  # bytes of a frame besides its payload
#: Modulus of the sample numbers.
WRAP = 1 << 16
#: Samples from which a log is opened; they determine the log's columns and scales.
HEAD_ROWS = 2000


def frame(kind: int, number: int, payload: bytes) -> bytes:
    """Return a frame as the sender builds it."""
    inner = bytes([kind, len(payload), number & 255, number >> 8 & 255]) + payload
    check = crc_hqx(inner, 0xFFFF)
    return MARK + inner + bytes([check & 255, check >> 8])


class Frames:
    """Rows from a stream of frames.

    Attributes
    ----------
    damaged : int
        Frames left out because of a wrong checksum or length.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self.names: list[str] = []
        self.sample_time = self.lag = 0.0
        self._rest = b""
        self._header = b""
        self._pending: list[StreamRows] = []
        self._count = 0
        self._opened = False

    def feed(self, data: bytes, last: bool = False) -> list[StreamRows]:
        """Add received bytes; return the rows that they complete.

        Rows are held back until there are HEAD_ROWS rows or the stream ends.
        """
        samples: list[bytes] = []
        numbers: list[int] = []
        for kind, number, payload in self._frames(data):
            if kind == HEADER:
                self._read_header(payload)
            elif kind == SAMPLES and self.names:
                if len(payload) % (4 * len(self.names)):
                    self.damaged += 1
                    continue
                rows = len(payload) // (4 * len(self.names))
                numbers += [(number + k) % WRAP for k in range(rows)]
                samples.append(payload)
        if samples:
            values = np.frombuffer(b"".join(samples), "<f4").astype(float)
            table = values.reshape(-1, len(self.names))
            t = self.sample_time * np.array(numbers, dtype=float)
            columns = {"t": t, **{name: table[:, n] for n, name in enumerate(self.names)}}
            self._pending.append(StreamRows(columns, b""))
            self._count += len(t)
        if not self._opened and self._count < HEAD_ROWS and not last:
            return []
        self._opened = True
        batches, self._pending = self._pending, []
        return batches

    def _frames(self, data: bytes) -> Iterator[tuple[int, int, bytes]]:
        """Yield kind, number and payload of each complete frame with a valid checksum."""
        data, at = self._rest + data, 0
        while True:
            mark = data.find(MARK, at)
            if mark < 0:
                at = max(at, len(data) - 1)  # the last byte may be the first byte of MARK
                break
            at = mark
            if len(data) < at + 4:
                break
            end = at + _FRAMING + data[at + 3]
            if len(data) < end:
                break
            inner = data[at + 2 : end - 2]
            if crc_hqx(inner, 0xFFFF) != data[end - 2] + 256 * data[end - 1]:
                self.damaged += 1
                at += 1
                continue
            yield inner[0], inner[2] + 256 * inner[3], inner[4:]
            at = end
        self._rest = data[at:]

    def _read_header(self, payload: bytes) -> None:
        if payload == self._header:
            return
        text = payload.decode("ascii", errors="replace")
        time, lag, *names = [*text.split(","), ""]
        names = names[:-1]
        if self.names:
            before = self._header.decode("ascii", errors="replace")
            raise RecordError(
                f"the header of the stream changed from {before} to {text}; start again"
            )
        try:
            self.sample_time, self.lag = float(time), float(lag)
        except ValueError:
            raise RecordError(
                f"the header of the stream must begin with the sample time in s and the lag, as in "
                f"5e-05,1,u_alpha,…; got {time},{lag}"
            ) from None
        self.names, self._header = names, payload

    @property
    def waiting(self) -> str:
        """Input that the stream still lacks before the first row, in words."""
        if not self.names:
            return "a frame that names the columns"
        received = f", {self._count} received" if self._count else ""
        return f"the stream's first {HEAD_ROWS} rows{received}"

    @property
    def layout(self) -> dict[str, float]:
        """Layout that the header states."""
        return {"sample_time": self.sample_time, "lag": self.lag}

    @property
    def wrap(self) -> float:
        """Time at which the sample numbers wrap [s]."""
        return WRAP * self.sample_time

    def sources(self, batches: Sequence[StreamRows]) -> Iterator[Columns]:
        """Yield inputs for :func:`fluxobs.read_log`: all first rows, then parts of them."""
        names = ("t", *self.names)
        whole = {name: np.concatenate([rows.columns[name] for rows in batches]) for name in names}
        t = whole["t"][:HEAD_ROWS]
        wraps = np.concatenate([[0], np.cumsum(np.diff(t) < -self.wrap / 2)])
        first = {name: values[:HEAD_ROWS] for name, values in whole.items()}
        first["t"] = t + self.wrap * wraps
        yield first
        for begin, end in pieces(len(t)):
            yield {name: values[begin:end] for name, values in first.items()}

    def recorded(self, rows: Ordered, time: str | None, first: bool) -> bytes:
        """Return rows as lines of a recording; above the first rows, add the names.

        Nine digits hold a four-byte float exactly.
        """
        columns = [rows.received.columns[name].tolist() for name in self.names]
        table = zip(rows.t.tolist(), *columns, strict=True)
        lines = [
            ",".join([f"{t:.12g}", *[f"{value:.9g}" for value in values]]) for t, *values in table
        ]
        if first:
            lines.insert(0, ",".join(["t", *self.names]))
        return "".join([line + "\n" for line in lines]).encode("ascii")
