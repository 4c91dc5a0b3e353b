"""The compiled observers in double precision (binding/core.cpp); checks of shapes are Python's."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Doubles = NDArray[np.float64]

#: (name, components) of what a run returns, in its order.
outputs: list[tuple[str, int]]
adaptive_outputs: list[tuple[str, int]]
#: Name -> meaning of every number that a step uses.
meanings: dict[str, str]
adaptive_meanings: dict[str, str]
#: Name -> value of the thresholds in firmware/fluxobs_internal.h.
thresholds: dict[str, float]
state_bytes: int
adaptive_state_bytes: int

class Core:
    def __init__(self, config: dict[str, Any]) -> None: ...
    def parameters(self) -> dict[str, Any]: ...
    def reset(self, lanes: int) -> Bytes: ...
    def run(
        self, states: Bytes, source: Doubles, current: Doubles, volt_seconds: bool, threads: int
    ) -> tuple[Bytes, Doubles, NDArray[np.bool_]]: ...
    @staticmethod
    def counters(states: Bytes, lane: int) -> tuple[int, int, int, int, int]: ...

class Adaptive:
    def __init__(self, core: Core, config: dict[str, Any]) -> None: ...
    def parameters(self) -> dict[str, Any]: ...
    def reset(self, lanes: int) -> Bytes: ...
    def run(
        self, states: Bytes, source: Doubles, current: Doubles, volt_seconds: bool, threads: int
    ) -> tuple[Bytes, Doubles, NDArray[np.bool_]]: ...
    @staticmethod
    def counters(states: Bytes, lane: int) -> tuple[int, int, int, int, int]: ...
    @staticmethod
    def filter(states: Bytes, lane: int) -> tuple[Any, ...]: ...
