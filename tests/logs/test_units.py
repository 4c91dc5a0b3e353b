"""Units guessed from values just within and just beyond the limits of each guess."""

import numpy as np
import pytest

from fluxobs.logs.meaning.guess import TURNS, turn_of


@pytest.mark.parametrize(("turn", "unit"), TURNS.items())
@pytest.mark.parametrize("share", [0.01, 0.09, 0.15, 0.19])
def test_an_angle_wraps_at_its_turn(turn, unit, share):
    """Wraps are found at any speed below a fifth of a turn per sample."""
    assert turn_of(np.mod(share * turn * np.arange(200), turn)) == unit


@pytest.mark.parametrize("turn", TURNS)
def test_an_angle_that_turns_further_per_sample_has_no_unit(turn):
    assert turn_of(np.mod(0.21 * turn * np.arange(200), turn)) is None


@pytest.mark.parametrize("turn", TURNS)
def test_an_angle_without_wraps_has_no_unit(turn):
    assert turn_of(0.004 * turn * np.arange(200)) is None
    assert turn_of(np.zeros(200)) is None


@pytest.mark.parametrize("turn", TURNS)
def test_jumps_beyond_a_turn_are_no_wraps(turn):
    angle = np.mod(0.05 * turn * np.arange(200), turn)
    angle[110:] += 1.3 * turn  # not at a wrap
    assert turn_of(angle) is None
