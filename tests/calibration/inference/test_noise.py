"""Whitening of declared noise, and the noise model of a channel."""

import numpy as np
import pytest

from calibration.inference.noise import (
    DISCREPANCY_STRIDES,
    DISCREPANCY_TIME,
    Noise,
    Whitener,
    _discrepancy_correlation,
    channel_noise,
    quantisation_step,
)
from slider_jax.experiment.schema import SensorsTable

T = np.arange(1000) / 500.0
NOISE = Noise(white=0.02, slow=0.01, slow_time=0.1, tare=0.01)
SIGNAL = 1e-9 * np.sin(2 * np.pi * T)


def sampled_noise(count, seed=0):
    """Returns series (count, n) of white, slow and constant noise."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-1.0 / (500.0 * NOISE.slow_time))
    slow = np.zeros((count, len(T)))
    slow[:, 0] = NOISE.slow * rng.normal(size=count)
    for i in range(1, len(T)):
        fresh = NOISE.slow * np.sqrt(1 - keep**2) * rng.normal(size=count)
        slow[:, i] = keep * slow[:, i - 1] + fresh
    tare = NOISE.tare * rng.normal(size=(count, 1))
    return NOISE.white * rng.normal(size=slow.shape) + slow + tare


def test_the_whitener_makes_declared_noise_white():
    white = Whitener(T, NOISE, SIGNAL, "thrust")(sampled_noise(200))
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.02)
    spectrum = np.mean(np.abs(np.fft.rfft(white, axis=1)) ** 2, axis=0) / len(T)
    assert spectrum[:5].mean() == pytest.approx(1.0, abs=0.15)
    assert spectrum[-100:].mean() == pytest.approx(1.0, abs=0.05)


def test_a_long_series_is_averaged_and_stays_white():
    t = np.arange(4000) / 500.0
    noise = Noise(white=0.02)
    series = 0.02 * np.random.default_rng(1).normal(size=(50, len(t)))
    white = Whitener(t, noise, 0.0 * t, "tip")(series)
    assert white.shape[1] <= 1250
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.03)


def test_a_gain_within_its_share_counts_less_than_a_change_of_shape():
    signal = 0.3 * np.sin(2 * np.pi * 3 * T)
    whiten = Whitener(T, NOISE, signal, "recoil")
    gain, shape = whiten(np.stack([0.01 * signal, 0.01 * np.cos(2 * np.pi * 3 * T)]))
    assert np.sum(gain**2) < 1.5
    assert np.sum(shape**2) > 5 * np.sum(gain**2)


def test_the_quantisation_step_is_estimated_from_the_data():
    rng = np.random.default_rng(2)
    p = 932.8 * np.round(rng.normal(scale=2e5, size=3000) / 932.8)
    assert quantisation_step(p) == pytest.approx(932.8, rel=1e-6)
    assert quantisation_step(rng.normal(size=3000)) == 0.0
    sensors = SensorsTable(pressure_noise=700.0)
    found = channel_noise(sensors, "p_front", p)
    assert found.white == pytest.approx(np.hypot(700.0, 932.8 / np.sqrt(12.0)))


def test_undeclared_white_noise_is_estimated_from_the_data():
    tip = np.sin(2 * np.pi * T) + 5e-4 * np.random.default_rng(3).normal(size=len(T))
    assert channel_noise(SensorsTable(), "tip", tip).white == pytest.approx(5e-4, rel=0.1)


@pytest.mark.parametrize("frequency", [0.6, 2.0, 6.0])
def test_the_discrepancy_is_correlated_over_strides(frequency):
    t = np.arange(600) / 500.0
    lag = np.abs(t[:, None] - t[None])
    cov = _discrepancy_correlation(lag, frequency)
    assert np.linalg.eigvalsh(cov).min() > -1e-9
    stride = _discrepancy_correlation(np.array([0.0, 0.5, 1.0, 2.0]) / frequency, frequency)
    half = np.exp(-1.0 / (np.pi * frequency * DISCREPANCY_TIME) - 0.5 / DISCREPANCY_STRIDES)
    np.testing.assert_allclose(stride, [1.0, half, np.exp(-0.1), np.exp(-0.2)], rtol=1e-9)
    np.testing.assert_allclose(_discrepancy_correlation(lag, None), np.exp(-lag / DISCREPANCY_TIME))


def test_strides_do_not_average_out_a_periodic_discrepancy():
    signal = 3.0 * np.sin(2 * np.pi * 5 * T)
    series = 0.05 * np.cos(2 * np.pi * 5 * T)
    steady, fresh = (
        np.sum(Whitener(T, NOISE, signal, "thrust", f)(series) ** 2) for f in (5.0, None)
    )
    assert fresh > 3.0 * steady


def test_non_finite_readings_stay_non_finite():
    white = Whitener(T, NOISE, SIGNAL, "thrust")(np.stack([np.full_like(T, np.nan), T]))
    assert np.isnan(white[0]).any() and np.isfinite(white[1]).all()
