"""The parameter vector of the extended model."""

import numpy as np

from calibration.model.extended import (
    Part,
    acting_entries,
    acting_part,
    base_vector,
    model_parameters,
    tangent_entries,
)
from calibration.model.plan import Resolution, plan_trial
from slider_jax.effects.library import LIBRARY
from slider_jax.experiment.load import load
from tests.support.data import ROOT

NAMES = ("internal_friction", "carried_mass", "keulegan_carpenter_drag")
ENTRIES = model_parameters(NAMES)
LABELS = [p.label for p in ENTRIES]
THETA = base_vector(ENTRIES, {"C_d": 3.0, "m_a": 0.7, "k": 0.08, "K_Q": 4.5e-7})


def test_shapes_follow_the_other_parameters_of_their_effect_and_have_their_defaults():
    assert LABELS[4:] == [
        "internal_friction.z_c",
        "internal_friction.kappa_c",
        "carried_mass.dm",
        "keulegan_carpenter_drag.C",
        "keulegan_carpenter_drag.exponent",
        "keulegan_carpenter_drag.KC_min",
    ]
    assert [p.name for p in ENTRIES if p.is_shape] == ["kappa_c", "exponent", "KC_min"]
    np.testing.assert_allclose(THETA[4:], [0.0, 0.3, 0.0, 0.0, 1.0 / 3.0, 0.3])


def test_the_model_has_the_shapes_of_the_vector():
    experiment = load(ROOT / "docs" / "experiment.toml")
    at = 0.002 * np.arange(20)
    p = plan_trial(experiment, experiment.trials[0], NAMES, Resolution(11, 40, 5e-3), at)
    theta = THETA + 0.01 * np.arange(len(THETA))
    effects = {x.name(): x for x in p.extended.at(theta).effects}
    for i in range(4, len(theta)):
        entry = ENTRIES[i]
        assert getattr(effects[entry.effect], entry.name) == theta[i], entry.label


def test_shapes_of_effects_at_their_null_do_not_act():
    def acting(**sizes):
        theta = THETA.copy()
        for name, x in sizes.items():
            theta[[p.effect for p in ENTRIES].index(name)] = x
        return [LABELS[i] for i in acting_entries(ENTRIES, theta) if ENTRIES[i].is_shape]

    assert acting() == [] and acting(carried_mass=0.1) == []
    assert acting(internal_friction=0.01) == ["internal_friction.kappa_c"]
    assert len(acting(internal_friction=0.01, keulegan_carpenter_drag=1.0)) == 3
    moved = THETA.copy()
    moved[LABELS.index("internal_friction.kappa_c")] = 1.0  # without the effect, no influence
    assert not [i for i in acting_entries(ENTRIES, moved) if ENTRIES[i].is_shape]


def test_effects_that_are_scored_by_secants_take_part_only_if_they_act():
    names = ("leakage", "valve_deadband", "carried_mass")
    entries = model_parameters(names)
    theta = base_vector(entries, {"C_d": 3.0, "m_a": 0.7, "k": 0.08, "K_Q": 4.5e-7})
    leak, band, mass = range(4, 7)
    given = load(ROOT / "docs" / "experiment.toml")
    at = 0.002 * np.arange(20)
    p = plan_trial(given, given.trials[0], names, Resolution(11, 40, 5e-3), at)

    def effects(theta, *moved):
        directions = np.eye(len(theta))[list(moved)]
        part = acting_part(p.extended, Part.PRESSURES, theta, directions)
        assert len(part.theta) == len(part.entries) == len(model_parameters(part.extended.effects))
        return part.extended.effects

    assert list(tangent_entries(entries, theta)) == [0, 1, 2, 3, leak, mass]
    assert effects(theta, 0, mass) == ()
    assert effects(theta, 2, leak) == ("leakage",)
    assert effects(theta, band) == ("leakage", "valve_deadband")
    theta[band] = 1e4
    assert list(tangent_entries(entries, theta)) == [0, 1, 2, 3, leak, band, mass]
    assert effects(theta, 2, leak) == ("leakage", "valve_deadband")


def test_no_effect_has_more_than_two_shapes():
    assert max(len(kind.shapes()) for kind in LIBRARY.values()) == 2
