"""Calls that compute tangents along equal numbers of directions."""

import numpy as np
import pytest

from calibration.model.compiled import by_directions


@pytest.mark.parametrize(
    ("k", "rows", "calls"), [(5, None, [8]), (70, None, [40, 40]), (9, 24, [24]), (9, 6, [6, 6])]
)
def test_each_call_has_the_same_number_of_directions(k, rows, calls):
    sizes = []

    def double(block):
        sizes.append(len(block))
        return 2.0 * block

    directions = np.arange(3.0 * k).reshape(k, 3)
    np.testing.assert_array_equal(by_directions(double, directions, rows), 2.0 * directions)
    assert sizes == calls
