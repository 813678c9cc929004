"""Conversion of device times to host times, in virtual time: 500 readings a second over USB."""

import numpy as np
import pytest

from rig.errors import RigError
from rig.recording.clock import RunningClock, fit_clock, host_ns, split_at_restarts, unwrap_counter

MILLISECOND = 1e-3


def arrivals(seed, seconds=600.0, ppm=200.0, wander_ppm=0.0, start=5000.0003):
    """Returns (device, host, true) times [s] of a device that sends every 2 ms of its own clock.

    Delays are exponential (0.5 ms). About once a second the host sleeps for up to 50 ms, then gets
    all messages at once. USB delivers at whole milliseconds. `wander_ppm` is the amplitude of one
    sine period of the rate over the record.
    """
    random = np.random.default_rng(seed)
    device = 12.5 + np.arange(0.0, seconds, 0.002)
    run = device - device[0]
    swing = wander_ppm * 1e-6 * seconds / (2 * np.pi) * np.sin(2 * np.pi * run / seconds)
    true = start + run / (1.0 + ppm * 1e-6) + swing
    host = true + random.exponential(0.0005, true.size)
    for begin in random.uniform(start, start + seconds, int(seconds)):
        end = begin + random.uniform(0.0, 0.05)
        host[(host > begin) & (host < end)] = end
    host = np.ceil(np.maximum.accumulate(host) / MILLISECOND) * MILLISECOND
    return device, host, true


def largest_error(device, host, true):
    return np.max(np.abs(fit_clock(device, host).to_host(device) - true))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("ppm", [200.0, -200.0])
def test_a_clock_that_drifts_200_ppm_is_aligned_within_a_millisecond_over_ten_minutes(seed, ppm):
    device, host, true = arrivals(seed, ppm=ppm)
    assert abs((device[-1] - device[0]) - (true[-1] - true[0])) > 0.1
    fit = fit_clock(device, host)
    assert np.max(np.abs(fit.to_host(device) - true)) < 0.1 * MILLISECOND
    assert fit.rate == pytest.approx(1.0 / (1.0 + ppm * 1e-6), abs=1e-6)
    assert fit.to_host(0.0) == pytest.approx(true[0] - device[0] * fit.rate, abs=MILLISECOND)
    assert fit.early_max < 0.1 * MILLISECOND
    assert 0.5 * MILLISECOND < fit.late_median < 2.0 * MILLISECOND < fit.late_99 < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_the_error_of_a_clock_synchronous_with_usb_is_less_than_one_frame(seed):
    assert largest_error(*arrivals(seed, ppm=0.0)) < MILLISECOND


@pytest.mark.parametrize("seed", range(3))
def test_a_rate_that_wanders_by_30_ppm_is_followed_within_a_millisecond(seed):
    device, host, true = arrivals(seed, wander_ppm=30.0)
    straight = np.polynomial.Polynomial.fit(device, true, 1)
    assert np.max(np.abs(straight(device) - true)) > MILLISECOND
    assert largest_error(device, host, true) < 0.5 * MILLISECOND


@pytest.mark.parametrize("seed", range(3))
def test_a_record_of_ten_seconds_is_aligned_within_a_millisecond(seed):
    assert largest_error(*arrivals(seed, seconds=10.0)) < MILLISECOND


@pytest.mark.parametrize("seed", range(20))
def test_the_line_equals_the_result_of_an_exhaustive_search_over_all_pairs(seed):
    random = np.random.default_rng(seed)
    x = np.sort(random.uniform(0.0, 50.0, 40))
    y = 7.0 + 1.0002 * x + random.exponential(0.001, 40)
    highest = -np.inf
    for i in range(40):
        for j in range(i):
            slope = (y[i] - y[j]) / (x[i] - x[j])
            line = y[i] + slope * (x - x[i])
            if np.all(y - line > -1e-12):
                highest = max(highest, np.mean(line))
    assert fit_clock(x, y).to_host(x.mean()) == pytest.approx(highest, abs=1e-12)


def test_one_arrival_determines_only_the_offset():
    fit = fit_clock([3.0], [10.0])
    assert fit.rate == pytest.approx(1.0, abs=1e-12)
    assert fit.to_host(5.0) == pytest.approx(12.0)


def test_times_outside_the_record_are_extrapolated():
    x = np.arange(0.0, 300.0, 0.1)
    fit = fit_clock(x, 100.0 + 1.0001 * x)
    np.testing.assert_allclose(fit.to_host([-50.0, 350.0]), [49.995, 450.035], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_running_clock_is_within_half_a_millisecond_after_ten_seconds(seed):
    device, host, true = arrivals(seed, seconds=150.0, wander_ppm=10.0)
    clock, found = RunningClock(), []
    for pair in zip(device.tolist(), host.tolist(), strict=True):
        clock.add(*pair)
        found.append(clock.to_host(pair[0]))
    error = np.abs(found - true)
    assert np.max(error) < 3.0 * MILLISECOND
    assert np.max(error[5000:]) < 0.5 * MILLISECOND
    assert len(clock._blocks) <= 120


def test_the_running_clock_starts_again_when_the_device_restarts():
    clock = RunningClock()
    with pytest.raises(RigError, match="no message has arrived"):
        clock.to_host(0.0)
    for i in range(1000):
        clock.add(50.0 + 0.01 * i, 100.0 + 0.01 * i)
    assert clock.to_host(60.0) == pytest.approx(110.0)
    clock.add(0.5, 200.0)
    assert clock.resets == 1
    assert clock.to_host(1.5) == pytest.approx(201.0)


def test_a_restart_of_the_device_is_refused_and_each_slice_can_be_fitted():
    device = np.concatenate([np.arange(50.0, 60.0, 0.01), np.arange(0.0, 20.0, 0.01)])
    host = np.arange(device.size) * 0.01 + 500.0
    with pytest.raises(
        RigError, match="decreases from 59.99 s to 0 s at sample 1000.*split_at_restarts"
    ):
        fit_clock(device, host)
    first, second = split_at_restarts(device)
    assert (first, second) == (slice(0, 1000), slice(1000, 3000))
    assert fit_clock(device[first], host[first]).to_host(0.0) == pytest.approx(450.0)
    assert fit_clock(device[second], host[second]).to_host(0.0) == pytest.approx(510.0)


@pytest.mark.parametrize(
    ("device", "host", "message"),
    [
        (np.arange(20.0), 1.002 * np.arange(20.0), "1000 ppm"),
        (1000.0 * np.arange(20.0), np.arange(20.0), "by 19000 s and host time by 19 s"),
        ([1.0, 2.0], [1.0], r"arrays \(2,\) and \(1,\)"),
        ([], [], "n > 0"),
        ([1.0, np.nan], [1.0, 2.0], "not finite"),
    ],
)
def test_times_without_a_clock_fit_are_refused(device, host, message):
    with pytest.raises(RigError, match=message):
        fit_clock(device, host)


def test_a_wrapped_counter_increases_and_a_restarted_counter_decreases():
    true = np.arange(0, 70000, 7)
    np.testing.assert_array_equal(unwrap_counter(true % 2**10, 2**10), true)
    counts = np.array([2**32 - 2, 2**32 - 1, 1, 0, 2], np.uint32)
    assert (unwrap_counter(counts, 2**32) - 2**32).tolist() == [-2, -1, 1, 0, 2]
    assert len(split_at_restarts(unwrap_counter(np.array([5, 900_000, 0, 7]), 2**32))) == 2


def test_the_host_clock_does_not_decrease():
    times = [host_ns() for _ in range(1000)]
    assert times == sorted(times)
    assert times[-1] > times[0]
