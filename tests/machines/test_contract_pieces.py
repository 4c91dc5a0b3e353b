"""Compare functions of the machine interface with closed forms."""

import numpy as np

from fluxobs.machines.contract import angle_std


def test_the_direction_of_a_vector_has_the_std_of_one_component_over_its_length():
    std = np.array([[0.03, 0.04], [0.1, 0.1]])
    np.testing.assert_allclose(angle_std(std, np.array([2.0, 5.0])), [0.05 / np.sqrt(8), 0.02])
    assert np.isinf(angle_std(std[0], np.array(0.0)))
