"""The compiled smoother (binding/smoother.cpp); Python checks the shapes."""

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]

#: Numbers of states, and of measurements of a block at most.
states: int
measurements: int

def smooth(
    blocks: Doubles, measured: Doubles, start: Doubles
) -> tuple[Doubles, Doubles, Doubles, Doubles]: ...

#: Names separated by spaces, in the order of the C code.
assumptions: str
model_fields: str
map_fields: str
outputs: str

def stop() -> None:
    """End the estimates of all threads, now and later, by RuntimeError."""

def rows_per_block(sample_time: float, speed: float) -> int: ...
def estimate(
    numbers: NDArray[np.float64],
    std: NDArray[np.float64],
    kind: int,
    map: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    voltage: NDArray[np.float64],
    current: NDArray[np.float64],
    row_flags: NDArray[np.int64],
    angle: NDArray[np.float64],
    angle_std: NDArray[np.float64],
    start: NDArray[np.float64],
    covariance: NDArray[np.float64],
    filter_scale: float,
    learning: bool,
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.uint8],
    NDArray[np.float64],
]: ...
