"""The compiled observers in double precision (binding/core.cpp); Python checks the shapes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Doubles = NDArray[np.float64]

#: (name, components) of each output of a run, in order.
outputs: list[tuple[str, int]]
adaptive_outputs: list[tuple[str, int]]
#: Name -> meaning of every number that a step uses.
meanings: dict[str, str]
adaptive_meanings: dict[str, str]
#: Name -> value of the thresholds in firmware/fluxobs_internal.h.
thresholds: dict[str, float]
#: Name -> value of the usual settings in firmware/fluxobs_config.h.
usual: dict[str, float]
#: Number of the order of the numbers that firmware/fluxobs_keep.h packs.
layout: int
#: Words of why a position is not valid, by number.
reasons: list[str]
state_bytes: int
adaptive_state_bytes: int

def choose(
    sizes: dict[str, float],
    sample_time: float,
    memory: float = 0.0,
    current_noise: float = 0.0,
    drift_prior: float = 0.0,
) -> dict[str, float]: ...
def kink_weights(share: float) -> tuple[float, float]: ...

class Core:
    def __init__(self, config: dict[str, Any]) -> None: ...
    def parameters(self) -> dict[str, Any]: ...
    def reset(self, lanes: int) -> Bytes: ...
    def seed(self, given: dict[str, float], current: Doubles) -> Bytes: ...
    def run(
        self, states: Bytes, source: Doubles, current: Doubles, volt_seconds: bool, threads: int
    ) -> tuple[Bytes, Doubles, NDArray[np.bool_]]: ...
    @staticmethod
    def counters(states: Bytes, lane: int) -> tuple[int, int, int, int, int]: ...

class Adaptive:
    def __init__(self, core: Core, config: dict[str, Any]) -> None: ...
    def parameters(self) -> dict[str, Any]: ...
    def reset(self, lanes: int) -> Bytes: ...
    def seed(self, given: dict[str, float], current: Doubles, states: Bytes) -> Bytes: ...
    def run(
        self, states: Bytes, source: Doubles, current: Doubles, volt_seconds: bool, threads: int
    ) -> tuple[Bytes, Doubles, NDArray[np.bool_]]: ...
    @staticmethod
    def counters(states: Bytes, lane: int) -> tuple[int, int, int, int, int]: ...
    @staticmethod
    def filter(states: Bytes, lane: int) -> tuple[Any, ...]: ...
