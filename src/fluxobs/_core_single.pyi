"""The same in single precision, as a microcontroller computes."""

from ._core import Adaptive as Adaptive
from ._core import Core as Core
from ._core import adaptive_meanings as adaptive_meanings
from ._core import adaptive_outputs as adaptive_outputs
from ._core import adaptive_state_bytes as adaptive_state_bytes
from ._core import meanings as meanings
from ._core import outputs as outputs
from ._core import state_bytes as state_bytes
from ._core import thresholds as thresholds
