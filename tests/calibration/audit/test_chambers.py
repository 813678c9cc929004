"""The audit compares the pressures of one to six chambers with their declared drives."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.audit.chamber_order import chamber_orders
from calibration.audit.lag_response import declared_drives
from calibration.audit.pressures import check_pressures
from calibration.measurements.records import Record
from slider_jax.channels import channels_of
from slider_jax.experiment.schema import Trial
from tests.support.damage import RATE, RUNS, lagged_square

COUNTS = (1, 2, 3)
PHASES = (0.3, 0.3, 0.0, 0.3, 0.3, 0.25, 0.0, 0.3)
LAST = 0.5


def channels(count):
    return channels_of([f"c{i}" for i in range(count)])


def records(count, **changes):
    """Undamaged records of eight trials with `count` chambers. Each chamber has its own gain."""
    found, rng = [], np.random.default_rng(count)
    gains = 1.0 + 0.03 * rng.normal(size=count)
    for i, ((f, amplitude, _, _, duration), phase) in enumerate(zip(RUNS, PHASES, strict=True)):
        content = {"frequency": f, "amplitude": amplitude, "rear_ratio": LAST, "phase": phase}
        content |= {"file": f"trial_{i:02d}.csv", "duration": 1.5 * duration} | changes
        if "ratios" in changes:
            del content["rear_ratio"]
        if "phases" in changes:
            del content["phase"]
        trial = Trial.model_validate(content)
        t = np.arange(round(trial.duration * RATE) + 1) / RATE
        values = np.full((count + 3, len(t)), np.nan)
        for c, x in enumerate(declared_drives(trial, count)):
            pressure = x.amplitude * lagged_square(t, f, x.phase)
            values[c] = gains[c] * pressure + 700.0 * rng.normal(size=len(t))
        values[count:] = 0.1 * rng.normal(size=(3, len(t)))
        found.append(Record(trial, t, values, channels(count)))
    return found


def altered(given, number, change):
    """The records, with the readings of one trial changed by `change(values)`."""
    r = given[number]
    return [*given[:number], replace(r, values=change(r.values.copy())), *given[number + 1 :]]


def with_row(row, change):
    def of_row(values):
        values[row] = change(values[row])
        return values

    return of_row


def kinds(findings):
    return [(x.trial, x.kind, x.channel, x.action) for x in findings]


def assert_mended(given, damaged, *expected):
    found, findings = check_pressures(damaged, RATE)
    assert kinds(findings) == list(expected), [str(x) for x in findings]
    for r, true in zip(found, given, strict=True):
        np.testing.assert_allclose(r.values, true.values, rtol=1e-12)


@pytest.mark.parametrize("count", [*COUNTS, 6])
def test_undamaged_pressures_give_no_finding(count):
    given = records(count)
    assert_mended(given, given)


@pytest.mark.parametrize("count", COUNTS)
def test_the_unit_and_the_sign_of_each_chamber_are_repaired(count):
    given, last = records(count), count - 1
    damaged = altered(given, 4, with_row(last, lambda p: 1e-3 * p))
    assert_mended(given, damaged, ("trial_04.csv", "units", f"p_c{last}", "mended"))
    damaged = altered(given, 4, with_row(last, lambda p: -p))
    assert_mended(given, damaged, ("trial_04.csv", "sign", f"p_c{last}", "mended"))


@pytest.mark.parametrize(
    ("count", "order"),
    [(2, [1, 0]), (3, [1, 2, 0]), (3, [2, 1, 0]), (6, [5, 1, 2, 3, 4, 0]), (6, [2, 0, 1, 3, 4, 5])],
)
@pytest.mark.parametrize("number", [4, 6])
@pytest.mark.slow
def test_the_order_of_the_pressure_columns_is_restored(count, order, number):
    """Trial 4 has different phases. The phases of trial 6 are 0, so its amplitudes are used."""
    given, columns = records(count), np.arange(count + 3)
    columns[:count] = order
    damaged = altered(given, number, lambda values: values[columns])
    moved = ", ".join(f"p_c{c}" for c in range(count) if order[c] != c)
    kind = ("swapped_columns", moved, "mended")
    assert_mended(given, damaged, (f"trial_{number:02d}.csv", *kind))


@pytest.mark.parametrize("count", COUNTS)
def test_a_pressure_in_the_column_of_a_force_is_moved_back(count):
    given, columns = records(count), np.arange(count + 3)
    columns[[count - 1, count]] = count, count - 1
    damaged = altered(given, 3, lambda values: values[columns])
    names = f"p_c{count - 1}_Pa, thrust_N"
    assert_mended(given, damaged, ("trial_03.csv", "swapped_columns", names, "mended"))


def test_more_chambers_than_six_have_the_exchanges_of_two_columns_only():
    assert [len(chamber_orders(n)) for n in (1, 3, 6, 7)] == [1, 6, 720, 22]
    assert chamber_orders(7)[0].tolist() == list(range(7))


@pytest.mark.parametrize("count", [2, 3])
def test_a_wrong_phase_of_one_chamber_is_found(count):
    given, c = records(count), count // 2
    declared = declared_drives(given[4].trial, count)[c]
    pressure = declared.amplitude * lagged_square(given[4].t, 3.0, declared.phase + 0.13)
    damaged = altered(given, 4, with_row(c, lambda _: pressure))
    found, findings = check_pressures(damaged, RATE)
    assert kinds(findings) == [("trial_04.csv", "wrong_phase", f"p_c{c}", "left out")]
    assert f"the c{c} pressure lags the c0 pressure by" in findings[0].detail
    assert [r.trial.file for r in found] == [r.trial.file for r in given if r is not given[4]]


@pytest.mark.parametrize("count", COUNTS)
def test_a_wrong_amplitude_of_all_chambers_and_a_wrong_drive_are_found(count):
    given = records(count)
    names = ", ".join(channels(count).pressures)
    damaged = altered(given, 3, with_row(slice(0, count), lambda p: 1.6 * p))
    _, findings = check_pressures(damaged, RATE)
    assert kinds(findings) == [("trial_03.csv", "wrong_amplitude", names, "left out")]
    other = 2.5e5 * lagged_square(given[3].t, 3.3, 0.0)
    _, findings = check_pressures(
        altered(given, 3, with_row(slice(0, count), lambda _: other)), RATE
    )
    assert kinds(findings) == [("trial_03.csv", "wrong_drive", names, "left out")]


@pytest.mark.parametrize("count", COUNTS)
def test_a_skewed_clock_is_repaired(count):
    given = records(count)
    damaged = [*given[:2], replace(given[2], t=given[2].t * 0.98), *given[3:]]
    found, findings = check_pressures(damaged, RATE)
    assert kinds(findings) == [("trial_02.csv", "clock_skew", "t_s", "mended")]
    np.testing.assert_allclose(found[2].t, given[2].t, rtol=1e-6)


def test_each_chamber_may_have_its_own_ratio_and_phase():
    """A negative ratio is half a period more; the trials have different frequencies."""
    given = records(3, ratios=[1.0, -0.8, 0.6], phases=[0.0, 0.1, -0.2])
    assert_mended(given, given)
    damaged = altered(given, 4, lambda values: values[[0, 2, 1, 3, 4, 5]])
    assert_mended(given, damaged, ("trial_04.csv", "swapped_columns", "p_c1, p_c2", "mended"))


def test_the_declared_drive_has_bias_limits_and_lead():
    trial = Trial(file="a.csv", frequency=2.0, amplitude=1e5, rear_ratio=0.5, phase=0.25,
                  duration=1.0, biases=[0.0, 2e4], lead_strides=1)  # fmt: skip
    drives = declared_drives(trial, 2, [(0.0, np.inf), (-np.inf, 6e4)])
    t = np.array([-0.6, -0.2, 0.1, 0.3, 0.4])
    unit = [x.amplitude * x.unit(t) for x in drives]
    np.testing.assert_allclose(unit[0], [0.0, 0.0, 1e5, 0.0, 0.0])
    np.testing.assert_allclose(unit[1], [0.0, 6e4, -3e4, 6e4, -3e4])


def test_an_undriven_trial_is_not_compared():
    trial = Trial(file="a.csv", frequency=2.0, amplitude=0.0, duration=1.0)
    assert declared_drives(trial, 3) is None and declared_drives(trial, 0) is None


@pytest.mark.parametrize(
    "ratios", [pytest.param([1.0, 0.0, 0.5], marks=pytest.mark.slow), [0.0, 1.0, 0.5]]
)
def test_a_chamber_without_amplitude_does_not_hide_faults_of_the_others(ratios):
    """The trials 0 and 4 drive two of the three chambers; the other trials drive all of them."""
    given = records(3)
    for i in (0, 4):
        given[i] = records(3, ratios=ratios)[i]
    own = [c for c in range(3) if ratios[c]]
    assert_mended(given, given)
    damaged = altered(given, 4, with_row(own[1], lambda p: 1e-3 * p))
    assert_mended(given, damaged, ("trial_04.csv", "units", f"p_c{own[1]}", "mended"))
    columns = np.arange(6)
    columns[own] = own[::-1]
    damaged = altered(given, 4, lambda values: values[columns])
    names = ", ".join(f"p_c{c}" for c in own)
    assert_mended(given, damaged, ("trial_04.csv", "swapped_columns", names, "mended"))
    late = lagged_square(given[4].t, 3.0, declared_drives(given[4].trial, 3)[own[1]].phase + 0.13)
    scale = ratios[own[1]] * given[4].trial.amplitude
    found = check_pressures(altered(given, 4, with_row(own[1], lambda _: scale * late)), RATE)[1]
    assert kinds(found) == [("trial_04.csv", "wrong_phase", f"p_c{own[1]}", "left out")]
    strong = altered(given, 4, with_row(own, lambda p: 1.6 * p))
    assert [x.kind for x in check_pressures(strong, RATE)[1]] == ["wrong_amplitude"]
    other = 2e5 * lagged_square(given[4].t, 3.7, 0.0)
    foreign = altered(given, 4, with_row(own, lambda p: other + 0.0 * p))
    assert [x.kind for x in check_pressures(foreign, RATE)[1]] == ["wrong_drive"]
