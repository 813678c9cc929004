"""Tests of whiteness on series with a known spectrum."""

import numpy as np
import pytest

from calibration.inference.whiteness import (
    FALSE_ALARM_P,
    MIN_LINE,
    fisher_line,
    ljung_box,
    whiteness_tests,
)
from calibration.measurements.records import Record
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.schema import Trial

T = np.arange(1250) / 500.0


def results_of(raw, white, t=T, model=0.0):
    """Returns the tests of one trial per row of `raw` and `white` (trials, n), for the thrust.

    The discrepancy is 1 % of the rms of the predicted readings `model`.
    """
    found, zero = [], np.zeros((len(SLIDER_CHANNELS), len(t)))
    for number, x in enumerate(raw):
        trial = Trial(file=f"{number}.csv", frequency=2.0, amplitude=1e5, duration=t[-1])
        values = np.full_like(zero, np.nan)
        values[SLIDER_CHANNELS.row("thrust")] = x
        found.append(Record(trial, t, values, SLIDER_CHANNELS))
    residuals = {(i, "thrust"): x for i, x in enumerate(white)}
    predicted = zero + model
    for record in found:
        record.values[SLIDER_CHANNELS.row("thrust")] += model
    return whiteness_tests(found, [predicted] * len(found), residuals, {"thrust": 0.01})


def test_a_sine_within_the_discrepancy_does_not_count():
    """The sine has the amplitude 0.5 and the rms 0.354."""
    noise = np.random.default_rng(4).normal(size=(1, len(T)))
    sine = 0.5 * np.sin(2.0 * np.pi * 13.0 * T)
    for size, counts in ((50.0, False), (20.0, True)):
        model = size * np.sign(np.sin(2.0 * np.pi * 2.0 * T + 0.1))
        (found,) = results_of(noise + sine, noise + sine, model=model)
        assert found.least_amplitude == pytest.approx(1.5 * np.sqrt(2.0) * 0.01 * size, rel=1e-2)
        assert found.has_line == counts


def test_the_p_values_of_white_series_are_uniform():
    """Of 2000 series, a fraction q has a p-value below q, within three standard errors."""
    rng, place = np.random.default_rng(0), np.arange(400)
    pairs = [
        (ljung_box(x, place)[1], fisher_line(x, place)[1]) for x in rng.normal(size=(2000, 400))
    ]
    correlation, line = np.array(pairs).T
    for q in (0.01, 0.1):
        margin = 3.0 * np.sqrt(q / 2000.0)
        assert abs(np.mean(correlation < q) - q) < margin
        assert 0.4 * q - margin < np.mean(line < q) < q + margin


@pytest.mark.slow
def test_a_short_series_rarely_has_a_very_small_p_value():
    """With the chi-squared distribution, 65 of 20,000 series have a p-value below 2e-4."""
    place = np.arange(80)
    x = np.random.default_rng(6).normal(size=(20_000, 80))
    assert sum(ljung_box(row, place)[1] < 2e-4 for row in x) <= 15


def test_white_trials_cause_no_alarm():
    """The sizes alone suppress some alarms, so only the corrected p-values are compared."""
    rng, alarms = np.random.default_rng(1), 0
    for _ in range(50):
        x = rng.normal(size=(8, len(T)))
        alarms += any(min(s.correlation_p, s.line_p) < FALSE_ALARM_P for s in results_of(x, x))
    assert alarms <= 3


@pytest.mark.parametrize("hertz", [13.0, 13.2, 50.3])
def test_a_hum_is_found_with_its_frequency_and_amplitude(hertz):
    rng = np.random.default_rng(2)
    white = rng.normal(size=(6, len(T)))
    white[3] += np.sin(2.0 * np.pi * hertz * T + 1.0)
    found = results_of(0.02 * white, white)
    assert [s.has_line for s in found] == [False, False, False, True, False, False]
    assert found[3].frequency_Hz == pytest.approx(hertz, rel=0.01)
    assert found[3].amplitude == pytest.approx(0.02, rel=0.1)
    assert found[3].line == pytest.approx(1.0 / 3.0, rel=0.2)


def test_gaps_do_not_change_the_frequency_of_a_hum():
    rng = np.random.default_rng(3)
    kept = (T < 0.8) | (T > 1.53)
    white = (rng.normal(size=len(T)) + np.sin(2.0 * np.pi * 13.0 * T))[None, kept]
    (x,) = results_of(white, white, T[kept])
    assert x.has_line and x.frequency_Hz == pytest.approx(13.0, rel=0.01)


def test_a_correlated_series_is_found_and_a_weak_correlation_is_not_large_enough():
    """The sum of squared autocorrelations is rho^2/(1 - rho^2) for a correlation rho^k."""
    rng, t = np.random.default_rng(4), np.arange(20_000) / 500.0
    for rho, large in ((0.7, True), (0.2, False)):
        fresh, x = rng.normal(size=len(t)), 0.0
        series = np.array([x := rho * x + e for e in fresh])[None]
        (found,) = results_of(series, series, t)
        assert found.correlation == pytest.approx(rho**2 / (1.0 - rho**2), rel=0.1)
        assert found.correlation_p < 1e-6 and found.correlated == large


def test_a_significant_line_below_the_size_does_not_count():
    t = np.arange(20_000) / 500.0
    white = np.random.default_rng(5).normal(size=(1, len(t))) + 0.2 * np.sin(2.0 * np.pi * 13.0 * t)
    (x,) = results_of(white, white, t)
    assert x.line_p < 1e-6 and x.line < MIN_LINE and not x.has_line
