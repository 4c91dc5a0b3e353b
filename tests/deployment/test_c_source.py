"""Numbers and names in C syntax."""

import numpy as np
import pytest

from fluxobs.deployment.c_source import hex_float, identifier


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, -1.5, 0.1, 1e-300, 5e-324, 1.7e308, 3e38])
def test_hex_floats_are_exact(value):
    assert float.fromhex(hex_float(value)) == value
    if abs(value) < 3.4e38:
        single = float(np.float32(value))
        assert float.fromhex(hex_float(single, "single").removesuffix("f")) == single


def test_identifiers():
    assert identifier("servo-400w") == "servo_400w"
    assert identifier("2kW2 pump!") == "motor_2kW2_pump"
    assert identifier("") == "motor"
