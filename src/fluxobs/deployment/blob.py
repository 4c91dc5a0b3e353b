"""Parameters as bytes for fo_unpack, so that a drive changes its motor without reflashing."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

from .. import _core
from ..observers import AdaptiveObserver
from .header import Exported, plain, std_of

#: Kind of the observer, and flags of the features it needs, as in firmware/fluxobs_keep.c.
PLAIN, ADAPTIVE = 1, 2
ASYMMETRY, HELD, MAP = 1, 2, 4


def blob(observer: Exported) -> bytes:
    """Return the bytes that fo_pack or fo_adaptive_pack writes for an export of this observer.

    These bytes do not contain the flux map.
    """
    single = plain(observer).precision == "single"
    numbers = _flatten(plain(observer).parameters())
    kind = PLAIN
    needs = HELD * bool(plain(observer).held) | MAP * (plain(observer).flux_map is not None)
    if isinstance(observer, AdaptiveObserver):
        kind, needs = ADAPTIVE, needs | ASYMMETRY * (observer.asymmetry_std > 0)
        more = observer.parameters()
        numbers += _flatten(more | {"std": std_of(observer)})
    size = 4 if single else 8
    body = np.array(numbers, f"<f{size}").tobytes()
    length = 12 + len(body) + 4
    head = struct.pack("<2sHBBHI", b"FO", _core.layout, kind, size, needs, length)
    return head + body + struct.pack("<I", zlib.crc32(head + body))


def _flatten(parameters: dict[str, Any]) -> list[float]:
    return [float(x) for value in parameters.values() for x in np.ravel(value)]
