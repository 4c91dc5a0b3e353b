"""Thresholds of the plain observer that Python code shares with it.

firmware/fluxobs_internal.h states the reasons for these values.
"""

from __future__ import annotations

from .. import _core

#: Largest share of noise in the flux information for which the flux counts as known.
NOISE_SHARE_LIMIT: float = _core.thresholds["SHARE_LIMIT"]
#: Upper limit of the correlation of successive innovations.
CORRELATION_LIMIT: float = _core.thresholds["CORRELATION_LIMIT"]
#: Bad samples in a row that lead to a restart.
MISSING: int = int(_core.thresholds["MAX_CONSECUTIVE_BAD"]) + 1
#: Angle by which a voltage error of the drift's prior standard deviation may turn a valid flux
#: [rad].
VOLTAGE_LIMIT: float = _core.thresholds["VOLTAGE_LIMIT"]
