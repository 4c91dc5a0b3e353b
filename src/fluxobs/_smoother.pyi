"""The compiled smoother (binding/smoother.cpp); Python checks the shapes."""

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]

#: Number of states.
states: int

def smooth(
    blocks: Doubles, measured: Doubles, start: Doubles
) -> tuple[Doubles, Doubles, Doubles, Doubles]: ...
