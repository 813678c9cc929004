"""Noise measured from the differences of readings, against the noise in simulated series."""

import numpy as np
import pytest

from calibration.inference.measured_noise import (
    HIGH_BAND,
    NOT_MEASURED,
    STRIDES,
    THINNED,
    measured_noises,
    robust_noise_floor,
)
from calibration.inference.noise import Noise
from calibration.measurements.records import Record
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.schema import Trial
from slider_jax.experiment.sensor_tables import SensorsTable

SENSORS = SensorsTable(
    pressure_noise=700.0, force_noise=0.02, force_slow_noise=0.01, force_slow_time=0.1
)
RATE, SECONDS = 500.0, 2.5


def square_response(t, f):
    """Returns a first-order lag of 0.08 s behind a square wave of 250 kPa, with its kinks."""
    p, found = 0.0, []
    for x in t:
        p += (2.5e5 * np.sign(np.sin(2.0 * np.pi * f * x + 1e-9)) - p) / (0.08 * RATE)
        found.append(p)
    return np.array(found)


def slow_noise(n, rng):
    keep, x, found = np.exp(-1.0 / (RATE * 0.1)), rng.normal(), []
    for fresh in rng.normal(size=n):
        x = keep * x + np.sqrt(1.0 - keep**2) * fresh
        found.append(x)
    return 0.01 * np.array(found)


def records(pressure=700.0, force=0.02, step=0.0, seed=0, filtered=0):
    """Returns trials of 0.6 to 6 Hz with readings of the front pressure and the recoil."""
    rng, t, found = np.random.default_rng(seed), np.arange(RATE * SECONDS) / RATE, []
    for f in np.geomspace(0.6, 6.0, 8):
        trial = Trial(file="a.csv", frequency=float(f), amplitude=2.5e5, duration=SECONDS)
        values = np.full((len(SLIDER_CHANNELS), len(t)), np.nan)
        p = square_response(t, f) + pressure * rng.normal(size=len(t))
        values[SLIDER_CHANNELS.row("p_front")] = step * np.round(p / step) if step else p
        recoil = 1.5 * np.sin(2.0 * np.pi * f * t) + 0.3 * np.sin(6.0 * np.pi * f * t)
        white = rng.normal(size=len(t) + 2 * filtered)
        if filtered:
            window = np.ones(2 * filtered + 1) / np.sqrt(2.0 * filtered + 1.0)
            white = np.convolve(white, window, "valid")
        values[SLIDER_CHANNELS.row("recoil")] = recoil + slow_noise(len(t), rng) + force * white
        found.append(Record(trial, t, values, SLIDER_CHANNELS))
    return found


def test_the_right_declared_noise_is_measured_within_a_tenth_and_kept():
    for seed in range(3):
        for name, x in measured_noises(SENSORS, records(seed=seed)).items():
            assert x.measured == pytest.approx(x.declared, rel=0.1), name
            assert x.used == x.declared and not x.replaced
            noise = Noise(x.declared, tare=1.0)
            assert x.of_trial(noise) is noise


def test_the_scatter_of_few_readings_does_not_replace_the_right_noise():
    few, rng, replaced = SENSORS.model_copy(update={"tip_noise": 5e-4}), np.random.default_rng(0), 0
    for _ in range(300):
        found = []
        for f, seconds in ((0.6, 1.65), (0.95, 1.05), (2.4, 0.66), (3.8, 0.66), (6.0, 0.66)):
            t = np.arange(100.0 * seconds) / 100.0
            values = np.full((len(SLIDER_CHANNELS), len(t)), np.nan)
            signal = 0.03 * np.sin(2.0 * np.pi * f * t)
            values[SLIDER_CHANNELS.row("tip")] = signal + 5e-4 * rng.normal(size=len(t))
            trial = Trial(file="a.csv", frequency=f, amplitude=2.5e5, duration=seconds)
            found.append(Record(trial, t, values, SLIDER_CHANNELS))
        replaced += measured_noises(few, found)["tip"].replaced
    # Of 300 normal variables, about one deviates by more than three standard errors.
    assert replaced <= 3


@pytest.mark.parametrize("ratio", [0.6, 1.4, 2.0])
def test_a_wrong_declared_noise_is_replaced(ratio):
    found = measured_noises(SENSORS, records(700.0 * ratio, 0.02 * ratio))
    assert found["p_front"].used == pytest.approx(700.0 * ratio, rel=0.1)
    assert found["recoil"].used == pytest.approx(0.02 * ratio, rel=0.1)
    for x in found.values():
        assert x.replaced and x.method in (HIGH_BAND, STRIDES, THINNED)
        assert x.of_trial(Noise(x.declared, tare=1.0)) == Noise(x.used, tare=1.0)


def test_the_measured_noise_contains_the_quantisation_and_is_not_below_it():
    x = measured_noises(SENSORS, records(step=933.0))["p_front"]
    assert x.declared == pytest.approx(np.hypot(700.0, 933.0 / np.sqrt(12.0)))
    assert x.measured == pytest.approx(x.declared, rel=0.1) and not x.replaced
    coarse = measured_noises(SENSORS, records(pressure=1.0, step=2000.0))["p_front"]
    assert coarse.used >= 2000.0 / np.sqrt(12.0)


def test_readings_without_noise_keep_half_of_the_discrepancy_as_noise():
    x = measured_noises(SENSORS, records(force=0.0))["recoil"]
    size = np.std([r.values[SLIDER_CHANNELS.row("recoil")] for r in records(force=0.0)])
    assert x.replaced
    assert x.used == pytest.approx(0.5 * SLIDER_CHANNELS["recoil"].discrepancy * size, rel=0.1)


def test_a_filtered_sensor_keeps_its_declared_noise():
    """Successive readings of a sensor with a low-pass filter have similar errors."""
    x = measured_noises(SENSORS, records(filtered=1))["recoil"]
    assert x.measured < 0.75 * x.declared and not x.replaced


def test_a_channel_without_declared_noise_or_with_few_readings_is_not_replaced():
    undeclared = measured_noises(SensorsTable(), records())["p_front"]
    assert undeclared.declared is None and not undeclared.replaced
    assert undeclared.measured == pytest.approx(700.0, rel=0.1)
    short = [Record(r.trial, r.t[:25], r.values[:, :25], r.channels) for r in records()]
    x = measured_noises(SENSORS, short)["p_front"]
    assert (x.measured, x.method, x.replaced) == (None, NOT_MEASURED, False)


def test_outliers_do_not_change_the_noise_floor():
    x = np.random.default_rng(1).normal(size=4000)
    x[::200] += 50.0
    assert robust_noise_floor(x, 4) == pytest.approx(1.0, abs=0.1)


def test_a_coarsely_quantised_camera_keeps_at_least_its_quantisation_noise():
    """Most successive readings are equal, so their differences say nothing about the noise."""
    camera, step = SENSORS.model_copy(update={"tip_noise": 5e-4}), 2e-3
    t, found = np.arange(2000) / 200.0, []
    for f in (0.3, 0.5, 1.0):
        values = np.full((len(SLIDER_CHANNELS), len(t)), np.nan)
        values[SLIDER_CHANNELS.row("tip")] = step * np.round(
            8e-3 * np.sin(2.0 * np.pi * f * t) / step
        )
        found.append(
            Record(
                Trial(file="a.csv", frequency=f, amplitude=2e5, duration=10.0),
                t,
                values,
                SLIDER_CHANNELS,
            )
        )
    x = measured_noises(camera, found)["tip"]
    assert min(x.declared, step / np.sqrt(12.0)) <= x.used <= 2.0 * step
