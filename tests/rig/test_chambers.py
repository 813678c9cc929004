"""Names of the chambers, and the conversion between chamber pressures and signed pressures."""

import numpy as np
import pytest

from rig.chambers import SLIDER, ChamberLayout, PneumaticActuator

MIXED = ChamberLayout(
    (
        PneumaticActuator("head"),
        PneumaticActuator("fin", "left", column="P2_Pa"),
        PneumaticActuator("belly", "right"),
    )
)


def test_chambers_and_columns_have_the_names_of_the_actuators():
    assert SLIDER.names == ("front_left", "front_right", "rear_left", "rear_right")
    assert SLIDER.columns == ("p_front_Pa", "p_rear_Pa")
    assert MIXED.names == ("head_left", "head_right", "fin", "belly")
    assert MIXED.columns == ("p_head_Pa", "P2_Pa", "p_belly_Pa")
    assert MIXED.set_columns == ("set_head_Pa", "set_fin_Pa", "set_belly_Pa")


def test_a_signed_pressure_is_left_minus_right():
    channels = (7, 3, 5, 2, 600, 0, 0, 0)
    assert MIXED.signed(channels) == (4, 5, -2)
    series = np.outer(channels, [1.0, 10.0])
    np.testing.assert_array_equal(MIXED.signed(series), [[4, 40], [5, 50], [-2, -20]])


@pytest.mark.parametrize(
    ("signed", "chambers"),
    [
        ((4.0, 5.0, -2.0), (4.0, 0.0, 5.0, 2.0)),
        ((-4.0, -5.0, 2.0), (0.0, 4.0, 0.0, 0.0)),  # single chambers ignore the other side
    ],
)
def test_only_one_chamber_of_a_pair_is_pressurised(signed, chambers):
    assert MIXED.split(signed) == chambers
