"""The audit of units, signs, columns, clocks and settings."""

import numpy as np
import pytest

from calibration.audit.audit import audit_measurements
from slider_jax.experiment import load as experiment
from tests.support import damage
from tests.support.damage import (
    ROW,
    alter,
    audited,
    kinds,
    lines_of,
    only,
    predict,
    record,
    same_as_whole,
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return damage.write_experiment(tmp_path_factory.mktemp("whole")).parent


@pytest.fixture
def tank(whole, tmp_path):
    """A copy of the undamaged experiment; a test damages the copy."""
    for file in whole.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


# Units, signs, columns

ONE_OR_ALL = ["one", pytest.param("all", marks=pytest.mark.slow)]
"""Times in milliseconds and both forces in millinewton are tested in all trials by default."""
UNITS = [
    ("p_front", 1e-3, "kPa"), ("p_rear", 1e3, "mPa"), ("p_front", 1 / 6894.757, "psi"),
    ("thrust", 1e3, "mN"), ("recoil", 1e3, "mN"), ("recoil", 1e-3, "kN"), ("tip", 1e3, "mm"),
]  # fmt: skip


@pytest.mark.parametrize("which", ONE_OR_ALL)
@pytest.mark.parametrize(("channel", "factor", "unit"), UNITS)
def test_wrong_units_are_converted(tank, whole, channel, factor, unit, which):
    numbers = range(8) if which == "all" else [4]
    for i in numbers:
        scale = np.where(np.arange(5) == ROW[channel], factor, 1.0)[:, None]
        alter(tank, i, lambda t, v, scale=scale: (t, v * scale))
    found = audited(tank)
    assert kinds(found) == [("units", channel, "mended")] * len(numbers)
    assert all(unit in x.detail for x in found.findings)
    for i in numbers:
        same_as_whole(found, whole, i, ROW[channel])


def test_both_forces_in_millinewton_in_all_trials_are_converted(tank, whole):
    for i in range(8):
        alter(tank, i, lambda t, v: (t, v * np.array([1, 1, 1e3, 1e3, 1])[:, None]))
    found = audited(tank)
    assert len(found.findings) == 16 and {x.kind for x in found.findings} == {"units"}
    same_as_whole(found, whole, 3)


@pytest.mark.parametrize("which", ["one", "all"])
def test_times_in_milliseconds_are_converted(tank, whole, which):
    numbers = range(8) if which == "all" else [4]
    for i in numbers:
        alter(tank, i, lambda t, v: (1e3 * t, v))
    found = audited(tank)
    assert kinds(found) == [("units", "t_s", "mended")] * len(numbers)
    same_as_whole(found, whole, 4)


@pytest.mark.parametrize("channel", ["p_front", "thrust", "recoil", "tip"])
def test_an_inverted_sign_is_repaired(tank, whole, channel):
    sign = np.where(np.arange(5) == ROW[channel], -1.0, 1.0)[:, None]
    alter(tank, 1, lambda t, v: (t, v * sign))
    found = audited(tank)
    only(found, 1, ("sign", channel, "mended"))
    same_as_whole(found, whole, 1)


PAIRS = [(0, 1), (2, 3), (0, 2), (1, 3), (1, 4), (3, 4)]


@pytest.mark.parametrize("which", ONE_OR_ALL)
@pytest.mark.parametrize("pair", PAIRS)
def test_swapped_columns_are_repaired(tank, whole, pair, which):
    numbers = {"one": [3 + sum(pair) % 4], "all": range(8)}[which]
    order = np.arange(5)
    order[list(pair)] = pair[::-1]
    for i in numbers:
        alter(tank, i, lambda t, v: (t, v[order]))
    found = audited(tank)
    swapped = [x for x in found.findings if x.kind == "swapped_columns"]
    assert [x.trial for x in swapped] == [f"trial_{i:02d}.csv" for i in numbers]
    assert len(found.findings) == len(swapped), [str(x) for x in found.findings]
    for i in numbers:
        same_as_whole(found, whole, i)


# Clocks and settings


@pytest.mark.parametrize(("off", "number"), [(-0.02, 0), (-0.006, 4), (0.006, 7), (0.025, 1)])
def test_a_skewed_clock_with_a_skewed_rate_is_repaired(tank, whole, off, number):
    alter(tank, number, lambda t, v: (t * (1.0 + off), v))
    found = audited(tank)
    only(found, number, ("clock_skew", "t_s", "mended"))
    same_as_whole(found, whole, number)


def test_a_skewed_clock_with_the_declared_rate_is_left_out(tank):
    def drift(t, values):
        late = np.interp(t, 1.01 * t, t)
        for row in range(4):
            values[row] = np.interp(late, t, values[row])
        return t, values

    alter(tank, 4, drift)
    found = audited(tank)
    only(found, 4, ("clock_skew", "t_s", "left out"))


def test_a_clock_that_is_skewed_in_all_trials_is_repaired(tank, whole):
    for i in range(8):
        alter(tank, i, lambda t, v: (1.02 * t, v))
    found = audited(tank)
    assert kinds(found) == [("clock_skew", "t_s", "mended")] * 8
    same_as_whole(found, whole, 5)


@pytest.mark.parametrize("off", [0.04, -0.05, 0.15])
def test_a_trial_with_offset_times_is_left_out(tank, off):
    alter(tank, 3, lambda t, v: (t[t + off >= 0.0] + off, v[:, t + off >= 0.0]))
    found = audited(tank)
    assert ("time_offset", "t_s", "left out") in kinds(found, 3)
    assert len(found.records) == 7


def test_an_offset_of_a_few_milliseconds_is_no_fault(tank):
    alter(tank, 3, lambda t, v: (t[:-3] + 0.004, v[:, :-3]))
    assert kinds(audited(tank)) == []


def test_exchanged_files_are_left_out_and_their_findings_name_each_other(tank):
    a, b = tank / "trial_03.csv", tank / "trial_05.csv"
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)
    found = audited(tank)
    out = {x.trial: x for x in found.findings if x.action == "left out"}
    assert set(out) == {"trial_03.csv", "trial_05.csv"}
    assert "trial_05.csv" in out["trial_03.csv"].detail
    assert len(found.records) == 6


@pytest.mark.parametrize(
    ("number", "changes", "kind"),
    [(3, {"frequency": 2.5}, "wrong_drive"), (3, {"frequency": 2.24}, "clock_skew"),
     (4, {"phase": 0.3}, "wrong_phase"), (6, {"phase": 0.15}, "wrong_phase"),
     (2, {"amplitude": 250e3}, "wrong_amplitude"), (5, {"amplitude": 150e3}, "wrong_amplitude")],
)  # fmt: skip
def test_a_trial_with_wrong_settings_is_left_out(tank, number, changes, kind):
    loaded = experiment.load(tank / "experiment.toml")
    wrong = loaded.with_values({f"trials.{number}.{key}": x for key, x in changes.items()})
    found = audit_measurements(wrong, 3, predict)
    out = [(x.trial, x.kind) for x in found.findings if x.action == "left out"]
    assert out == [(f"trial_{number:02d}.csv", kind)]


@pytest.mark.parametrize("seed", range(3))
def test_one_corrupt_trial_among_eight_is_left_out(tank, seed):
    rng = np.random.default_rng(seed)
    number = int(rng.integers(8))
    size = np.array([2e5, 2e5, 0.3, 0.5, 0.03])[:, None]
    alter(tank, number, lambda t, v: (t, np.round(size * rng.normal(size=v.shape), 4)))
    found = audited(tank)
    out = [(x.trial, x.kind) for x in found.findings if x.action == "left out"]
    assert out == [(f"trial_{number:02d}.csv", "wrong_drive")]
    assert len(found.records) == 7


def test_a_force_without_correlation_to_its_prediction_is_masked(tank):
    rng = np.random.default_rng(1)

    def noise(t, values):
        values[3] = np.round(0.4 * rng.normal(size=len(t)), 4)
        return t, values

    alter(tank, 4, noise)
    found = audited(tank)
    only(found, 4, ("strange_channel", "recoil", "masked"))
    assert not record(found, 4).has("recoil")


def test_a_trial_with_another_sample_rate_is_reported_and_used(tank):
    lines_of(tank, 4, lambda x: [x[0], *x[1::2]])
    found = audited(tank)
    only(found, 4, ("sample_rate", "t_s", "used"))
    lines_of(tank, 5, lambda x: [x[0], *x[1:125], *x[125::2]])
    assert ("sample_rate", None, "used") in kinds(audited(tank), 5)
