"""The loop on trials with wrongly declared noise, heavy-tailed noise and mains hum."""

import json

import numpy as np
import pytest

from calibration.discrepancy.close_loop import close_loop_on_trials
from calibration.discrepancy.page import loop_page
from calibration.discrepancy.report import loop_record
from calibration.model.extended import BASE
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.load import assemble
from slider_jax.experiment.prepare import prepare
from slider_jax.io.files import write_csv
from tests.support import closed_form_tank as tank

THETA = np.array([3.0, 0.7, 0.08, 4.5e-7])
FREQUENCIES = (1.5, 1.8, 2.2, 2.6, 3.0)


@pytest.fixture(autouse=True)
def closed_form(monkeypatch):
    tank.replace_the_beam(monkeypatch)


def normal(rng, n):
    return rng.normal(size=n)


def heavy(rng, n):
    """Returns noise of Student's t-distribution with 3 degrees of freedom and unit variance."""
    return rng.standard_t(3, size=n) / np.sqrt(3.0)


def outcome(folder, shape=normal, declared=1.0, hum=0.0, late=1.0, sensors=tuple(SLIDER_CHANNELS)):
    """Returns the loop's outcome for trials of 1 s without a missing effect, with these `sensors`.

    The declared noise is multiplied by `declared`. `hum` is the amplitude [N] of a sine of 13 Hz in
    the thrust of trial 2. `late` multiplies m_a in the last three trials.
    """
    content = tank.experiment_of(FREQUENCIES, duration=1.0).model_dump()
    for key in ("pressure_noise", "force_noise", "tip_noise"):
        content["sensors"][key] *= declared
    # Readings in closed form have no discretisation error. A single mesh cannot measure this.
    content["sensors"]["thrust_discrepancy"] = 0.01
    experiment = assemble(content, "closed", folder)
    rng = np.random.default_rng(0)
    for number, trial in enumerate(experiment.trials):
        t = prepare(experiment, trial).sample_times
        theta = THETA * np.array([1.0, late if number >= 2 else 1.0, 1.0, 1.0])
        values = tank.readings(trial, t, theta)
        columns = {"t_s": t}
        for x, (name, channel) in zip(values, SLIDER_CHANNELS.items(), strict=True):
            noisy = x + tank.NOISE[name] * shape(rng, len(t))
            if name == "thrust" and number == 2:
                noisy = noisy + hum * np.sin(2.0 * np.pi * 13.0 * t + 1.0)
            if name in sensors:
                columns[channel.column] = noisy
        write_csv(folder / trial.file, columns)
    return close_loop_on_trials(experiment, (), fine=tank.MESH, coarse=tank.MESH)


def report(found):
    """Returns report.json and the page of an outcome."""
    record = json.loads(json.dumps(loop_record(found, 1.0, {"path": "a", "sha256": "0"})))
    return record, loop_page(found, record)


@pytest.mark.slow
def test_correct_noise_is_used_as_declared(tmp_path):
    found = outcome(tmp_path)
    assert found.verdict == "nothing_missing"
    record, page = report(found)
    assert not record["instability"] and not record["whiteness"]["patterns"]
    for x in record["noise"].values():
        assert x["used"] == x["declared"] and x["freedom"] is None
        assert x["measured"] == pytest.approx(x["declared"], rel=0.1)
    assert "The residual is at the noise floor." in record["said"]
    assert "Noise of the sensors" in page and "standard errors" not in record["said"]


@pytest.mark.parametrize("declared", [0.75, pytest.param(2.0, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_wrong_declared_noise_does_not_change_the_verdict(tmp_path, declared):
    found = outcome(tmp_path, declared=declared)
    assert found.verdict == "nothing_missing"
    record, page = report(found)
    # Every third reading, at 83 Hz, also contains a part of the signal.
    assert 630.0 < record["noise"]["p_front"]["used"] < 875.0
    assert "The declared white noise of p_front" in record["said"] and "p_front (kPa)" in page


@pytest.mark.parametrize("declared", [0.75, pytest.param(1.0, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_heavy_tailed_noise_does_not_change_the_verdict(tmp_path, declared):
    found = outcome(tmp_path, heavy, declared)
    assert found.verdict == "nothing_missing"
    record, page = report(found)
    for x in record["noise"].values():
        assert 2.0 < x["freedom"] < 7.0
    assert "degrees of freedom" in record["said"] and "degrees of freedom" in page
    plain = outcome(tmp_path)
    assert np.all(found.final.errors < 1.02 * plain.final.errors)


@pytest.mark.slow
def test_a_hum_is_reported_with_its_frequency_and_amplitude(tmp_path):
    found = outcome(tmp_path, hum=0.02)
    assert found.verdict == "unexplained" and found.excess["thrust"].all < 1.5
    record, page = report(found)
    (x,) = record["whiteness"]["patterns"]
    assert (x["trial"], x["channel"], x["has_line"]) == ("trial_02.csv", "thrust", True)
    assert x["frequency_Hz"] == pytest.approx(13.0, rel=0.01)
    assert x["amplitude"] == pytest.approx(0.02, rel=0.1)
    assert "trial_02.csv has a sine of 13 Hz with an amplitude of" in record["said"]
    assert "thrust: trial_02.csv has a sine of 13 Hz" in page
    assert record["residual"]["channels"]["thrust"]["where"]["trial"] == "trial_02.csv"


@pytest.mark.slow
def test_a_parameter_that_changes_between_trials_is_reported(tmp_path):
    found = outcome(tmp_path, late=1.2)
    (x,) = [x for x in found.unstable if x.name == "m_a"]
    assert x.second / x.first == pytest.approx(1.2, abs=0.05)
    record, page = report(found)
    assert "m_a is 0.69" in record["said"] and "m_a is 0.69" in page


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensors", "undetermined"),
    [
        (("tip",), {"C_d", "m_a", "K_Q"}),
        (("p_front", "p_rear", "tip"), {"C_d", "m_a", "K_Q"}),
        (("thrust", "recoil"), set()),
        (("p_front",), {"C_d", "m_a", "K_Q"}),
    ],
)
def test_any_subset_of_the_sensors_is_enough(tmp_path, sensors, undetermined):
    found = outcome(tmp_path, sensors=sensors)
    assert found.verdict == "nothing_missing" and set(found.excess) == set(sensors)
    record, _ = report(found)
    for name, value in zip(("C_d", "m_a", "k", "K_Q"), THETA, strict=True):
        x, prior = record["parameters"][name], BASE[name]
        whole = x["low"] <= prior.low and x["high"] >= prior.high
        assert x["low"] < value < x["high"] and whole == (name in undetermined), name
