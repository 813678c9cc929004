"""The selection on sums of known series."""

import numpy as np
import pytest

from calibration.discrepancy.selection import select_effects
from calibration.model.extended import Parameter
from slider_jax.effects import Prior
from tests.support.sums import Sums

NAMES = ("regulator_gain", "carried_mass", "tank_current", "force_gain")
"""Effects that do not exclude each other; `SHAPES` replaces their readings."""
ENTRIES = [Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", ""))] + [
    Parameter(name, "x", Prior(0.0, -50.0, 50.0, "-", "")) for name in NAMES
]


def select(truth):
    return select_effects(Sums(truth), ENTRIES, np.zeros(5), base_names=("k",))


@pytest.mark.parametrize(
    ("truth", "effects"),
    [
        ((1.0, 0.0, 0.0, 0.0, 0.0), []),
        ((1.0, 0.5, 0.0, 0.0, 0.0), ["regulator_gain"]),
        ((1.0, 0.5, 0.0, 0.3, 0.0), ["regulator_gain", "tank_current"]),
    ],
)
def test_the_selection_finds_exactly_the_true_effects(truth, effects):
    found = select(truth)
    assert found.effects == effects
    np.testing.assert_allclose(found.final.theta, truth, atol=0.02)


def test_tangents_that_are_too_large_to_keep_change_no_result(monkeypatch):
    """They are whitened in place, and the predicted changes need other derivatives."""
    truth = (1.0, 0.5, 0.0, 0.3, 0.0)
    kept = select(truth)
    monkeypatch.setattr("calibration.discrepancy.refits.MOST_KEPT", 0)
    large = select(truth)
    assert large.effects == kept.effects == ["regulator_gain", "tank_current"]
    assert [[t.name for t in r.refitted] for r in large.rounds] == [
        [t.name for t in r.refitted] for r in kept.rounds
    ]
    np.testing.assert_allclose(large.final.theta, kept.final.theta, rtol=1e-4, atol=1e-4)


def test_a_wrong_effect_that_was_chosen_first_is_removed():
    truth = (1.0, 0.0, 0.0, 0.4, 1.0)
    found = select(truth)
    assert found.rounds[0].taken_out == "carried_mass" and found.rounds[0].chosen is None
    assert set(found.effects) == {"tank_current", "force_gain"}
    np.testing.assert_allclose(found.final.theta, truth, atol=0.02)
    assert found.final.theta[2] == 0.0 and 2 not in found.final.free
    assert not any(r.equivalent for r in found.rounds)


def test_a_necessary_effect_is_not_removed():
    truth = (1.0, 0.0, 0.5, 0.4, 1.0)
    found = select(truth)
    assert set(found.effects) == {"carried_mass", "tank_current", "force_gain"}
    assert not any(r.taken_out for r in found.rounds)
