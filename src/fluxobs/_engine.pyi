"""The compiled estimate of a log (binding/engine.cpp); Python checks the shapes."""

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]

#: Names separated by spaces, in the order of the C code: parameters, fields of a machine file and
#: of a flux map, numbers of a row and of a log; and orders of the harmonics.
parameters: str
file_fields: str
map_fields: str
row_numbers: str
log_numbers: str
orders: str
#: Number of the first parameters, which change covariances only.
levels: int

def stop() -> None:
    """End the estimates of all threads, now and later, by RuntimeError."""

def estimate(
    file: Doubles,
    kind: int,
    magnets: bool,
    map: Doubles,
    coefficients: Doubles,
    voltage: Doubles,
    current: Doubles,
    sample_time: float,
    hints: Doubles,
    sure: bool,
    start: Doubles,
    stride: int,
) -> tuple[bool, Doubles, Doubles, Doubles, Doubles, Doubles]: ...
