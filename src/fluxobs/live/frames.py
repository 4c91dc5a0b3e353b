"""The binary frame that an exported observer's telemetry sends (templates/telemetry.c).

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

The payload of H is text, ``SAMPLE_TIME,LAG,NAME,NAME,…`` in seconds and samples, as
``5e-05,1,u_alpha,u_beta,i_alpha,i_beta``; that of S is one or more samples, each a float of four
bytes, low byte first, per column. H comes first and again now and then, so that a reader may begin
anywhere.
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
#: Numbers of samples begin again here.
WRAP = 1 << 16
#: Samples from which a log is opened: its columns and sizes are guessed from them.
HEAD_ROWS = 2000


def frame(kind: int, number: int, payload: bytes) -> bytes:
    """A frame, as the sender makes it."""
    inner = bytes([kind, len(payload), number & 255, number >> 8 & 255]) + payload
    check = crc_hqx(inner, 0xFFFF)
    return MARK + inner + bytes([check & 255, check >> 8])


class Frames:
    """Rows from a stream of frames.

    Attributes
    ----------
    damaged : int
        Frames that were left out: their check failed, or their length.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self.names: list[str] = []
        self.sample_time = self.lag = 0.0
        self._rest = b""
        self._said = b""  # the header
        self._parts: list[StreamRows] = []
        self._counted = 0
        self._opened = False

    def feed(self, data: bytes, last: bool = False) -> list[StreamRows]:
        """Take bytes; return the rows that they complete, none before there are enough to begin, or
        the stream has ended."""
        samples: list[bytes] = []
        numbers: list[int] = []
        for kind, number, payload in self._frames(data):
            if kind == HEADER:
                self._name(payload)
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
            part = {"t": t, **{name: table[:, n] for n, name in enumerate(self.names)}}
            self._parts.append(StreamRows(part, b""))
            self._counted += len(t)
        if not self._opened and self._counted < HEAD_ROWS and not last:
            return []
        self._opened = True
        out, self._parts = self._parts, []
        return out

    def _frames(self, data: bytes) -> Iterator[tuple[int, int, bytes]]:
        """Kind, number and payload of the frames that are complete and whole."""
        data, at = self._rest + data, 0
        while True:
            found = data.find(MARK, at)
            if found < 0:
                at = max(at, len(data) - 1)  # the mark's first byte may be the last one here
                break
            at = found
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

    def _name(self, payload: bytes) -> None:
        if payload == self._said:
            return
        text = payload.decode("ascii", errors="replace")
        time, lag, *names = [*text.split(","), ""]
        names = names[:-1]
        if self.names:
            said = self._said.decode("ascii", errors="replace")
            raise RecordError(
                f"the header of the stream changed from {said} to {text}; begin again"
            )
        try:
            self.sample_time, self.lag = float(time), float(lag)
        except ValueError:
            raise RecordError(
                f"the stream's header must begin with the sample time in s and the lag, as "
                f"5e-05,1,u_alpha,…; got {time},{lag}"
            ) from None
        self.names, self._said = names, payload

    @property
    def waiting(self) -> str:
        """What is to come before there are rows."""
        if not self.names:
            return "a frame that names the columns"
        came = f", {self._counted} came" if self._counted else ""
        return f"the stream's first {HEAD_ROWS} rows{came}"

    @property
    def layout(self) -> dict[str, float]:
        """What the stream says of itself."""
        return {"sample_time": self.sample_time, "lag": self.lag}

    @property
    def wrap(self) -> float:
        """What the time of samples wraps at [s]."""
        return WRAP * self.sample_time

    def sources(self, parts: Sequence[StreamRows]) -> Iterator[Columns]:
        """What :func:`fluxobs.read_log` may open: all first rows, or pieces of them."""
        names = ("t", *self.names)
        whole = {name: np.concatenate([one.columns[name] for one in parts]) for name in names}
        t = whole["t"][:HEAD_ROWS]
        wraps = np.concatenate([[0], np.cumsum(np.diff(t) < -self.wrap / 2)])
        first = {name: values[:HEAD_ROWS] for name, values in whole.items()}
        first["t"] = t + self.wrap * wraps
        yield first
        for begin, end in pieces(len(t)):
            yield {name: values[begin:end] for name, values in first.items()}

    def recorded(self, rows: Ordered, time: str | None, first: bool) -> bytes:
        """Rows as lines of a recording, below their names if they are the first; nine digits are
        all that four bytes hold."""
        columns = [rows.part.columns[name].tolist() for name in self.names]
        table = zip(rows.t.tolist(), *columns, strict=True)
        lines = [
            ",".join([f"{t:.12g}", *[f"{value:.9g}" for value in values]]) for t, *values in table
        ]
        if first:
            lines.insert(0, ",".join(["t", *self.names]))
        return "".join([line + "\n" for line in lines]).encode("ascii")
