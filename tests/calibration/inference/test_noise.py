"""Whitening of declared noise, and the noise model of a channel."""

import tracemalloc

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular

from calibration.inference.noise import (
    BLOCK,
    DISCREPANCY_STRIDES,
    DISCREPANCY_TIME,
    WHOLE,
    Noise,
    StationaryWhitener,
    Whitener,
    channel_noise,
    discrepancy_correlation,
    discrepancy_memory,
    discrepancy_scale,
    quantisation_step,
)
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.sensor_tables import SensorsTable

T = np.arange(1000) / 500.0
NOISE = Noise(white=0.02, slow=0.01, slow_time=0.1, tare=0.01, gain=0.01, discrepancy=0.07)
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
    white = Whitener(T, NOISE, SIGNAL)(sampled_noise(200))
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.02)
    spectrum = np.mean(np.abs(np.fft.rfft(white, axis=1)) ** 2, axis=0) / len(T)
    assert spectrum[:5].mean() == pytest.approx(1.0, abs=0.15)
    assert spectrum[-100:].mean() == pytest.approx(1.0, abs=0.05)


def dense_root(t, noise, model, frequency, spans=()):
    """Returns the Cholesky factor of the declared covariance, without any approximation."""
    lag = np.abs(t[:, None] - t)
    scale = discrepancy_scale(noise, model)
    cov = noise.slow**2 * np.exp(-lag / noise.slow_time)
    memory = discrepancy_memory(t, frequency)
    cov += scale**2 * discrepancy_correlation(lag, frequency, memory) + noise.tare**2
    for row in (noise.gain * model, *spans):
        cov += np.outer(row, row)
    return cholesky(cov + np.diag(np.broadcast_to(np.square(noise.white), t.shape)), lower=True)


@pytest.mark.parametrize("frequency", [None, 1.0, 4.8])
@pytest.mark.parametrize("n", [20, BLOCK, WHOLE])
def test_a_short_series_is_whitened_by_the_exact_covariance(n, frequency):
    rng = np.random.default_rng(4)
    t = np.sort(rng.uniform(0.0, n / 500.0, n))
    noise = NOISE._replace(white=0.02 * np.exp(rng.normal(size=n)))
    signal, spans = 0.3 * np.sin(9.0 * t), 0.1 * rng.normal(size=(2, n))
    series = rng.normal(size=(4, n))
    white = Whitener(t, noise, signal, frequency, spans)(series)
    exact = solve_triangular(dense_root(t, noise, signal, frequency, spans), series.T, lower=True)
    scale = np.abs(exact.T @ exact).max()
    np.testing.assert_allclose(white @ white.T, exact.T @ exact, rtol=0.0, atol=1e-10 * scale)


def test_the_scale_of_the_discrepancy_is_rounded_by_at_most_half_a_percent():
    signals = [(1.0 + 1e-4 * i) * np.sin(9.0 * T) for i in range(1000)]
    scales = np.array([discrepancy_scale(NOISE, x) for x in signals])
    exact = NOISE.discrepancy * np.std(signals, axis=1)
    assert np.abs(scales / exact - 1.0).max() < 0.00502
    assert len(set(scales)) < 12
    assert discrepancy_scale(NOISE, np.zeros(5)) == 0.0


def test_a_whitener_for_the_same_noise_can_be_shared_and_for_other_noise_not():
    scale = discrepancy_scale(NOISE, SIGNAL)
    known = StationaryWhitener(T, NOISE, scale, 2.0)
    assert known.serves(T.copy(), NOISE._replace(gain=0.5), scale, 2.0)
    assert not known.serves(T, NOISE, 1.1 * scale, 2.0)
    assert not known.serves(T, NOISE, scale, None)
    assert not known.serves(T[:-1], NOISE, scale, 2.0)
    assert not known.serves(T, NOISE._replace(white=0.03), scale, 2.0)
    series = sampled_noise(3)
    shared = Whitener(T, NOISE, SIGNAL, 2.0, stationary=known)(series)
    np.testing.assert_array_equal(shared, Whitener(T, NOISE, SIGNAL, 2.0)(series))


EVEN = np.arange(3000) / 500.0
UNEVEN = np.sort(np.random.default_rng(5).uniform(0.0, 6.0, 3000))
LONG = np.arange(4000) / 125.0
GAPS = EVEN + 0.7 * (EVEN > 0.2) + 1.9 * (EVEN > 3.3)
LOUD = NOISE._replace(white=0.02 * np.exp(0.5 * np.random.default_rng(6).normal(size=3000)))
RECOIL = NOISE._replace(discrepancy=0.012)
PRESSURE = Noise(white=750.0, gain=0.002, discrepancy=0.002)


@pytest.mark.parametrize(
    ("t", "noise", "amplitude", "frequency"),
    [
        (EVEN, NOISE, 0.3, None),
        (EVEN, NOISE, 0.3, 1.0),
        pytest.param(EVEN, NOISE, 0.3, 2.2, marks=pytest.mark.slow),
        pytest.param(EVEN, RECOIL, 2.0, 4.8, marks=pytest.mark.slow),
        pytest.param(EVEN, PRESSURE, 2e5, 1.0, marks=pytest.mark.slow),
        pytest.param(EVEN, PRESSURE, 2e5, 2.2, marks=pytest.mark.slow),
        (EVEN, PRESSURE, 2e5, 4.8),
        (UNEVEN, NOISE, 0.3, 2.2),
        (GAPS, RECOIL, 2.0, 2.2),
        (EVEN, LOUD, 0.3, 2.2),
        (LONG, RECOIL, 2.0, 4.8),
    ],
)
@pytest.mark.slow
def test_a_long_series_is_whitened_as_by_the_dense_covariance(t, noise, amplitude, frequency):
    """The tolerances were chosen before the comparison: 2 % of the variance, 5 % of information."""
    f = frequency or 1.0
    signal = amplitude * np.sin(2 * np.pi * f * t)
    root = dense_root(t, noise, signal, frequency)
    whiten = Whitener(t, noise, signal, frequency)
    sampled = np.random.default_rng(7).normal(size=(40, len(t))) @ root.T
    white = whiten(sampled)
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.02)
    blocks = np.mean(white.reshape(40, 10, -1) ** 2, axis=(0, 2))
    assert np.abs(blocks - 1.0).max() < 0.06
    tangents = np.stack(
        [
            np.sin(2 * np.pi * f * t),
            np.cos(2 * np.pi * f * t),
            np.sin(2 * np.pi * 0.3 * t),
            t,
            np.ones_like(t),
            1.0 * (t > 2.2),
            np.sign(np.sin(2 * np.pi * f * t + 0.1)),
        ]
    )
    exact = np.sum(solve_triangular(root, tangents.T, lower=True) ** 2, axis=0)
    np.testing.assert_allclose(np.sum(whiten(tangents) ** 2, axis=1), exact, rtol=0.05)


def test_no_sample_of_a_long_trial_is_averaged_away():
    """The error is a change of shape with 20 % of the amplitude, in a trial of 100 s."""
    t = np.arange(50_000) / 500.0
    error = 2e4 * np.sign(np.cos(2 * np.pi * 2.083 * t))
    whiten = Whitener(t, PRESSURE, 1e5 * np.sin(2 * np.pi * 2.083 * t), 2.083)
    white = whiten(error)
    assert white.shape == (1, len(t))
    assert np.mean(white**2) > 10.0


def memory(n):
    """Returns the bytes that a whitener of n samples keeps, and the peak when it whitens."""
    t = np.arange(n) / 500.0
    series = np.random.default_rng(8).normal(size=(5, n))
    signal = 1e6 * np.sin(2 * np.pi * 2.2 * t)  # The state then has its largest size.
    tracemalloc.start()
    whiten = Whitener(t, PRESSURE, signal, 2.2)
    kept = tracemalloc.get_traced_memory()[0]
    tracemalloc.reset_peak()
    whiten(series)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return kept, peak - kept


def test_memory_grows_by_few_numbers_per_sample():
    """The gains need the most memory. Their number grows with the logarithm of the duration."""
    (kept, peak), (more, higher) = memory(60_000), memory(90_000)
    assert more - kept < 25 * 8 * 30_000
    assert higher - peak < 2 * 5 * 8 * 30_000


def test_a_gain_within_its_share_counts_less_than_a_change_of_shape():
    signal = 0.3 * np.sin(2 * np.pi * 3 * T)
    whiten = Whitener(T, RECOIL, signal)
    gain, shape = whiten(np.stack([0.01 * signal, 0.01 * np.cos(2 * np.pi * 3 * T)]))
    assert np.sum(gain**2) < 1.5
    assert np.sum(shape**2) > 5 * np.sum(gain**2)


def test_the_quantisation_step_is_estimated_from_the_data():
    rng = np.random.default_rng(2)
    p = 932.8 * np.round(rng.normal(scale=2e5, size=3000) / 932.8)
    assert quantisation_step(p) == pytest.approx(932.8, rel=1e-6)
    assert quantisation_step(rng.normal(size=3000)) == 0.0
    sensors = SensorsTable(pressure_noise=700.0)
    found = channel_noise(sensors, SLIDER_CHANNELS["p_front"], p)
    assert found.white == pytest.approx(np.hypot(700.0, 932.8 / np.sqrt(12.0)))


def test_undeclared_white_noise_is_estimated_from_the_data():
    tip = np.sin(2 * np.pi * T) + 5e-4 * np.random.default_rng(3).normal(size=len(T))
    assert channel_noise(SensorsTable(), SLIDER_CHANNELS["tip"], tip).white == pytest.approx(
        5e-4, rel=0.1
    )


@pytest.mark.parametrize("frequency", [0.6, 2.0, 6.0])
def test_the_discrepancy_is_correlated_over_strides(frequency):
    t = np.arange(600) / 500.0
    lag = np.abs(t[:, None] - t[None])
    memory = discrepancy_memory(t, frequency)
    cov = discrepancy_correlation(lag, frequency, memory)
    assert np.linalg.eigvalsh(cov).min() > -1e-9
    stride = discrepancy_correlation(np.array([0.0, 0.5, 1.0, 2.0]) / frequency, frequency, memory)
    half = np.exp(-1.0 / (np.pi * frequency * DISCREPANCY_TIME) - 0.5 / DISCREPANCY_STRIDES)
    np.testing.assert_allclose(stride, [1.0, half, np.exp(-0.1), np.exp(-0.2)], rtol=1e-9)
    np.testing.assert_allclose(discrepancy_correlation(lag, None), np.exp(-lag / DISCREPANCY_TIME))


def test_strides_do_not_average_out_a_periodic_discrepancy():
    signal = 3.0 * np.sin(2 * np.pi * 5 * T)
    series = 0.05 * np.cos(2 * np.pi * 5 * T)
    steady, fresh = (np.sum(Whitener(T, NOISE, signal, f)(series) ** 2) for f in (5.0, None))
    assert fresh > 3.0 * steady


def test_the_strides_of_a_long_trial_do_not_average_out_a_periodic_discrepancy():
    """Ten times as many strides carry at most 1.5 times as much information on such an error."""

    def information(strides):
        t = np.arange(100 * strides) / 500.0
        signal = 3.0 * np.sin(2 * np.pi * 5 * t)
        error = np.cos(2 * np.pi * 5 * t) + 0.5 * np.cos(2 * np.pi * 15 * t)
        return np.sum(Whitener(t, RECOIL, signal, 5.0)(error) ** 2)

    assert information(200) < 1.5 * information(20)


def test_blocks_whose_gains_differ_little_share_one():
    t = np.arange(40_000) / 500.0
    signal = 2.0 * np.sin(2 * np.pi * 2.2 * t)
    scale = discrepancy_scale(RECOIL, signal)
    gains = StationaryWhitener(t, RECOIL, scale, 2.2)._gains
    assert len(gains) == 157
    assert len({id(x) for x in gains}) < 60


def test_no_other_block_shares_the_gain_of_a_block_with_other_noise():
    t, loud = np.arange(40_000) / 500.0, 100
    white = np.full(len(t), RECOIL.white)
    white[BLOCK * loud : BLOCK * (loud + 1)] *= 1.0001
    scale = discrepancy_scale(RECOIL, 2.0 * np.sin(2 * np.pi * 2.2 * t))
    gains = StationaryWhitener(t, RECOIL._replace(white=white), scale, 2.2)._gains
    assert sum(x is gains[loud] for x in gains) == 1
    assert gains[loud - 1] is gains[loud + 1]


def test_non_finite_readings_stay_non_finite():
    white = Whitener(T, NOISE, SIGNAL)(np.stack([np.full_like(T, np.nan), T]))
    assert np.isnan(white[0]).any() and np.isfinite(white[1]).all()
