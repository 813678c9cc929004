"""Predictions of trials at arbitrary sample times."""

import numpy as np
import pytest

from calibration.model.extended import BASE, base_values, base_vector, model_parameters
from calibration.model.predict import (
    Resolution,
    _simulate,
    plan_trial,
    predict_readings,
    without_null_effects,
)
from slider_jax.experiment import load as experiment
from tests.support.data import ROOT

K, AMPLITUDE, SPACING = 0.075, 2e5, 2e-3


@pytest.mark.parametrize("begin", [0.0, 1.3e-4, 1.344e-3, 1.99e-3, 5.3e-3])
def test_the_first_sample_may_be_between_steps(begin):
    """The closed form is the lag's step response."""
    file = ROOT / "docs" / "experiment.toml"
    changes = {"trials.0.frequency": 2.0, "trials.0.amplitude": AMPLITUDE, "trials.0.duration": 0.4}
    given = experiment.load(file).with_values(changes)
    at = begin + SPACING * np.arange(100)
    p = plan_trial(given, given.trials[0], (), Resolution(11, 40, 5e-3), at)
    front = predict_readings(p, np.array([2.0, 0.5, K, 4.79e-7]))[0]
    np.testing.assert_allclose(front, AMPLITUDE * (1.0 - np.exp(-at / K)), atol=1e-6)


def test_the_base_model_gives_the_readings_of_effects_at_their_nulls():
    """Effects that change no reading are left out of the simulation, but not acting effects."""
    given = experiment.load(ROOT / "docs" / "experiment.toml")
    names = ("clamp_compliance", "leakage", "force_crosstalk")
    at = SPACING * np.arange(100)
    p = plan_trial(given, given.trials[0], names, Resolution(11, 40, 5e-3), at)
    entries = model_parameters(names)
    base = base_vector(entries, base_values(given))
    small, theta = without_null_effects(p, base)
    assert small.extended.effects == () and len(theta) == len(BASE)
    with_all = _simulate([(p, base)])[0]
    np.testing.assert_allclose(predict_readings(p, base), with_all, rtol=1e-12, atol=1e-15)
    acting = base.copy()
    acting[[x.effect for x in entries].index("leakage")] = 0.5
    assert without_null_effects(p, acting)[0] is p
    assert np.abs(predict_readings(p, acting) - with_all)[0].max() > 100.0
