"""Compiled programs, and calls that compute tangents along equal numbers of directions."""

import numpy as np
import pytest

from calibration.model.compiled import MOST_VALUES, by_directions, slices


@pytest.mark.parametrize(
    ("k", "rows", "calls"), [(5, None, [8]), (70, None, [40, 40]), (9, 24, [24]), (9, 6, [6, 6])]
)
def test_each_call_has_the_same_number_of_directions(k, rows, calls):
    sizes = []

    def double(block):
        sizes.append(len(block))
        return 2.0 * block

    directions = np.arange(3.0 * k).reshape(k, 3)
    found = np.full_like(directions, np.nan)
    for here, block in by_directions(double, directions, rows):
        found[here] = block
    np.testing.assert_array_equal(found, 2.0 * directions)
    assert sizes == calls


def test_slices_of_long_rows_have_whole_multiples_of_rows():
    assert slices(10, 5) == [slice(0, 10)]
    assert slices(3, MOST_VALUES // 2) == [slice(0, 2), slice(2, 3)]
    assert slices(20, MOST_VALUES // 9, 8) == [slice(0, 8), slice(8, 16), slice(16, 20)]
    assert slices(2, 2 * MOST_VALUES) == [slice(0, 1), slice(1, 2)]
    assert slices(0, 5) == []
