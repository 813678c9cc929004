"""The search on models whose answer is known: sums of a few series."""

import numpy as np
import pytest

from calibration.discrepancy.selection import select_effects
from calibration.model.extended import Parameter
from slider_jax.effects import Prior
from tests.support.sums import Sums

NAMES = ("regulator_gain", "carried_mass", "tank_current", "force_gain")
"""Those of effects that exclude none; what they do here is `SHAPES`."""
ENTRIES = [Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", ""))] + [
    Parameter(name, "x", Prior(0.0, -50.0, 50.0, "-", "")) for name in NAMES
]


def searched(truth):
    return select_effects(Sums(truth), ENTRIES, np.zeros(5), base_names=("k",))


@pytest.mark.parametrize(
    ("truth", "effects"),
    [
        ((1.0, 0.0, 0.0, 0.0, 0.0), []),
        ((1.0, 0.5, 0.0, 0.0, 0.0), ["regulator_gain"]),
        ((1.0, 0.5, 0.0, 0.3, 0.0), ["regulator_gain", "tank_current"]),
    ],
)
def test_what_is_there_is_found_and_nothing_else(truth, effects):
    found = searched(truth)
    assert found.effects == effects
    np.testing.assert_allclose(found.final.theta, truth, atol=0.02)


def test_a_wrong_effect_that_came_first_is_taken_out_again():
    truth = (1.0, 0.0, 0.0, 0.4, 1.0)
    found = searched(truth)
    assert found.rounds[0].taken_out == "carried_mass" and found.rounds[0].chosen is None
    assert set(found.effects) == {"tank_current", "force_gain"}
    np.testing.assert_allclose(found.final.theta, truth, atol=0.02)
    assert found.final.theta[2] == 0.0 and 2 not in found.final.free
    assert not any(r.equivalent for r in found.rounds)


def test_an_effect_that_is_still_needed_stays():
    truth = (1.0, 0.0, 0.5, 0.4, 1.0)
    found = searched(truth)
    assert set(found.effects) == {"carried_mass", "tank_current", "force_gain"}
    assert not any(r.taken_out for r in found.rounds)
