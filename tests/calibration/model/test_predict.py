"""Predictions of trials at the times at which a rig happened to sample them."""

import numpy as np
import pytest

from calibration.model.predict import Resolution, plan, predict
from slider_jax.experiment import load as experiment
from tests.support.data import ROOT

K, AMPLITUDE, SPACING = 0.075, 2e5, 2e-3


@pytest.mark.parametrize("begin", [0.0, 1.3e-4, 1.344e-3, 1.99e-3, 5.3e-3])
def test_samples_may_begin_anywhere_between_steps(begin):
    """The chambers' lag is known in closed form."""
    file = ROOT / "docs" / "experiment.toml"
    told = {"trials.0.frequency": 2.0, "trials.0.amplitude": AMPLITUDE, "trials.0.duration": 0.4}
    given = experiment.load(file).with_values(told)
    at = begin + SPACING * np.arange(100)
    p = plan(given, given.trials[0], (), Resolution(11, 40, 5e-3), at)
    front = predict(p, np.array([2.0, 0.5, K, 4.79e-7]))[0]
    np.testing.assert_allclose(front, AMPLITUDE * (1.0 - np.exp(-at / K)), atol=1e-6)
