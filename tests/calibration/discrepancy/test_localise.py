"""Localisation of known residuals."""

import numpy as np
import pytest

from calibration.discrepancy.localise import (
    locate_residuals,
    residual_text,
    residual_timing,
    significant_trend,
)
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.inference.goodness import Excess
from calibration.measurements.records import Record
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.schema import Trial

T = np.arange(0.0, 2.0, 0.002)
MODEL = np.sin(2.0 * np.pi * T)


def record(residual, frequency=1.0, amplitude=1e5):
    values = np.full((5, len(T)), np.nan)
    values[2] = MODEL + residual
    content = {"file": f"{frequency:g}.csv", "frequency": frequency, "amplitude": amplitude}
    return Record(Trial.model_validate(content | {"duration": 2.0}), T, values, SLIDER_CHANNELS)


def test_the_phase_of_the_residual_is_found():
    found = residual_timing(
        record(np.where((T % 1.0 > 0.4) & (T % 1.0 < 0.48), 0.3, 0.0)), "thrust", MODEL
    )
    assert found["phase"] == [0.375, 0.5] and found["share"] == pytest.approx(1.0)
    assert found["mean"] == pytest.approx(np.sqrt(0.08), rel=0.05)


def test_growing_is_the_share_while_the_reading_moves_away_from_its_mean():
    growing = MODEL * np.gradient(MODEL) > 0.0
    assert residual_timing(record(0.1 * growing), "thrust", MODEL)["growing"] > 0.95
    assert residual_timing(record(0.1 * ~growing), "thrust", MODEL)["growing"] < 0.05


def located(amplitudes, squares):
    """Returns the record of a thrust whose residual grows with the frequency."""
    records = [record(0.1 * f, f, a) for f, a in enumerate(amplitudes, start=1)]
    left = {"thrust": Excess(squares, 13.2), "tip": Excess(np.ones(len(squares)), 1.1)}
    predicted = [np.tile(MODEL, (5, 1))] * len(squares)
    (found,) = locate_residuals(records, predicted, left, DEFAULT_SETTINGS.noise_floor)
    return found


def test_a_trend_with_a_setting_is_reported():
    squares = np.array([2.0, 5.0, 9.0, 20.0, 30.0, 40.0])
    found = located((1e5, 3e5, 2e5, 3e5, 2e5, 1e5), squares)
    assert (found["channel"], found["worst_trial"]) == ("thrust", "6.csv")
    grows = found["grows_with"]
    assert grows["frequency"] == pytest.approx(1.0)
    assert grows["amplitude"] is None and grows["tow_speed"] is None
    text = residual_text(found)
    assert "thrust: mean square 13.2 times the noise floor, worst in 6.csv (6 Hz, 100 kPa)" in text
    assert "grows with frequency" in text and "amplitude" not in text.split(";", 1)[1]


def test_five_trials_are_too_few_for_one_of_six_trends():
    """Two of 120 orders of five trials have a perfect trend."""
    found = located((1e5, 3e5, 2e5, 3e5, 1e5), np.array([2.0, 5.0, 9.0, 20.0, 30.0]))
    assert set(found["grows_with"].values()) == {None}


def test_the_frequency_of_a_hum_is_found_despite_missing_samples():
    r = record(0.1 * np.sin(2.0 * np.pi * 13.0 * T + 0.3))
    r.values[2, np.arange(len(T)) % 7 == 0] = np.nan
    found = residual_timing(r, "thrust", MODEL)
    assert found["peak_Hz"] == pytest.approx(13.0, abs=0.2) and found["peak_share"] > 0.95


def test_a_constant_or_uncorrelated_setting_has_no_trend():
    assert significant_trend([1.0] * 5, np.arange(5.0)) is None
    assert significant_trend([None, 1.0, 2.0, 3.0, 4.0], np.arange(5.0)) is None
    assert significant_trend([1.0, 2.0, 3.0, 4.0, 5.0], np.array([1.0, 3.0, 2.0, 5.0, 1.5])) is None
