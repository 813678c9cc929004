"""The frequency of a sine that is the same in all trials."""

import numpy as np
import pytest

from calibration.learning.frequencies import WhiteSeries, common_sine

NOISE, RATE = 0.5, 100.0


def series(rng, seconds, frequency, amplitude):
    """A trial with a sine and white noise. The whitener divides by the noise."""
    t = np.arange(0.0, seconds, 1.0 / RATE)
    y = amplitude * np.sin(2.0 * np.pi * frequency * t + 0.8) + NOISE * rng.normal(size=len(t))
    return WhiteSeries(t, y / NOISE, lambda x: np.atleast_2d(x) / NOISE)


@pytest.mark.parametrize("frequency", [0.75, 1.2, 4.0])
def test_all_trials_together_determine_the_frequency(frequency):
    """The longest trial has 1.5 periods of the slowest sine. The noise is as large as the sine."""
    errors = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        trials = [series(rng, s, frequency, NOISE) for s in (1.0, 1.0, 1.2, 1.5, 1.7, 2.0)]
        share, found = common_sine(trials, 5.0)
        errors.append(found - frequency)
        assert share == pytest.approx(1.0 / 3.0, abs=0.1)
    assert np.abs(errors).max() < 0.07


def test_noise_has_no_common_sine():
    rng = np.random.default_rng(1)
    share, _ = common_sine([series(rng, 2.0, 1.0, 0.0) for _ in range(6)], 5.0)
    assert share < 0.02


def test_a_fast_sine_is_found_at_the_peak_of_one_trial():
    rng = np.random.default_rng(2)
    _, found = common_sine([series(rng, 2.0, 31.0, NOISE) for _ in range(3)], 31.0)
    assert found == 31.0


def test_the_share_of_a_sine_that_multiplies_readings_is_that_of_least_squares():
    rng, trials = np.random.default_rng(3), []
    for seconds in (1.0, 1.3, 2.0):
        x = series(rng, seconds, 1.2, NOISE)
        trials.append(x._replace(envelope=1.0 + x.t**2))
    share, hertz = common_sine(trials, 5.0)
    turn = 2.0 * np.pi * hertz * np.concatenate([x.t for x in trials])
    envelope = np.concatenate([x.envelope for x in trials])
    y = np.concatenate([x.residual for x in trials])
    rows = envelope[:, None] * np.stack([np.sin(turn), np.cos(turn)], axis=1) / NOISE
    left = np.linalg.lstsq(rows, y)[1][0]
    assert share == pytest.approx(1.0 - left / (y @ y), rel=1e-9)
