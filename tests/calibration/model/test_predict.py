"""Predictions of trials at arbitrary sample times."""

import numpy as np
import pytest

from calibration.model.predict import Resolution, plan_trial, predict_readings
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
