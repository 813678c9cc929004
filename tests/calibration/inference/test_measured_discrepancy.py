"""The measured discrepancy, against repeating errors of known size in closed-form readings."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calibration.inference.gauss_newton import fit_gauss_newton
from calibration.inference.measured_discrepancy import DiscrepancyMeter, fell
from calibration.inference.noise import DISCREPANCY_TIME, Noise, channel_noise
from calibration.inference.problem import AbstractProblem, TankProblem
from calibration.measurements.records import Record, load_records
from calibration.model.extended import base_values, base_vector, model_parameters
from calibration.model.plan import Resolution, plan_trial
from calibration.model.predict import predict_each
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.load import load
from slider_jax.experiment.schema import Trial
from slider_jax.experiment.sensor_tables import SensorsTable
from tests.support.data import ROOT

FREQUENCIES = (0.7, 1.3, 2.1, 2.9, 3.7, 4.6)
T = np.arange(1000) / 500.0
NOISE = Noise(0.02, 0.01, 0.1, 0.01, 0.01, SLIDER_CHANNELS["thrust"].discrepancy)
CELLS = 10.0 / 3.0
"""Number of cells of the fine mesh, divided by that of the coarse mesh."""


@dataclass(frozen=True)
class Rhythm(AbstractProblem):
    """Trials whose thrust is a sine of 0.4 N at the drive frequency."""

    def _predict(self, theta):
        raise NotImplementedError

    _tangents = _coarse = _predict

    def spans(self):
        return None

    @property
    def mesh_ratio(self):
        return CELLS


def thrust(values):
    """Returns readings (channels, n) of the thrust alone."""
    return np.where(
        np.arange(len(SLIDER_CHANNELS))[:, None] == SLIDER_CHANNELS.row("thrust"), values, np.nan
    )


def repeating_curve(t, f, rng):
    """Returns a random curve of unit variance with the period 1/f, from its dense covariance.

    Its correlation decreases to 1/e within `DISCREPANCY_TIME`. Without f, the curve has no period.
    """
    nodes = np.arange(0.0, 1.0 / f if f else t[-1] + 0.004, 0.004)
    gap = np.abs(nodes[:, None] - nodes)
    gap = np.abs(np.sin(np.pi * f * gap)) / (np.pi * f) if f else gap
    cov = np.exp(-gap / DISCREPANCY_TIME) + 1e-9 * np.eye(len(nodes))
    curve = np.linalg.cholesky(cov) @ rng.normal(size=len(nodes))
    return np.interp(t % (1.0 / f) if f else t, nodes, curve)


def slow_noise(rng):
    gap = np.abs(T[:, None] - T)
    return np.linalg.cholesky(np.exp(-gap / 0.1)) @ rng.normal(size=len(T))


def tank(share, seed=0, frequencies=FREQUENCIES, declared=None):
    """Returns a problem whose data have a repeating error `share`, and the model's readings."""
    rng, records, fine = np.random.default_rng(seed), [], []
    for f in frequencies:
        y = 0.4 * np.sin(2.0 * np.pi * (f or 2.0) * T)
        error = share * np.std(y) * repeating_curve(T, f, rng)
        noise = 0.02 * rng.normal(size=len(T)) + 0.01 * slow_noise(rng) + 0.01 * rng.normal()
        values = (1.0 + 0.01 * rng.normal()) * y + error + noise
        drive = {"frequency": f, "amplitude": 1e5} if f else {}
        recorded = {} if f else {"waveform": "recorded", "drive_file": "drive.csv"}
        trial = Trial(file="a.csv", duration=2.0, **drive, **recorded)
        records.append(Record(trial, T, thrust(values), SLIDER_CHANNELS))
        fine.append(thrust(y))
    problem = Rhythm(
        records=records,
        channels=("thrust",),
        noise={(i, "thrust"): NOISE for i in range(len(records))},
        declared={} if declared is None else {"thrust": declared},
    )
    return problem, fine


def measure(problem, fine, coarse=None):
    return DiscrepancyMeter(problem, fine, fine if coarse is None else coarse)(fine)["thrust"]


@pytest.mark.parametrize("frequencies", [FREQUENCIES, (None,) * 6])
@pytest.mark.parametrize("share", [0.02, 0.05])
def test_a_repeating_error_is_measured_within_a_quarter(share, frequencies):
    found = [measure(*tank(share, seed, frequencies)) for seed in range(2)]
    for x in found:
        assert x.measured == pytest.approx(share, rel=0.25)
        assert x.measured < x.used < 1.5 * share


def shifted(fine, share, order=2):
    """Returns readings of both meshes with an error of order `order`, `share` on the fine mesh."""
    error = [np.std(y[2]) * np.sqrt(2.0) * np.cos(7.0 * 2.0 * np.pi * T) for y in fine]
    pairs = list(zip(fine, error, strict=True))
    return [y + share * e for y, e in pairs], [y + CELLS**order * share * e for y, e in pairs]


def test_noise_alone_gives_the_discretisation_error():
    for seed in range(2):
        problem, y = tank(0.0, seed)
        x = measure(problem, y, shifted(y, 0.02)[1])
        assert x.measured < 0.5 * x.lower_limit and x.used == x.lower_limit
        assert measure(problem, y).used < 0.012


def test_an_error_of_second_order_is_extrapolated_to_its_size_with_a_safety_factor():
    """The tare and the gain of a trial absorb errors of their shape."""
    problem, y = tank(0.0)
    fine, coarse = shifted(y, 0.01)
    assert measure(problem, fine, coarse).lower_limit == pytest.approx(1.5 * 0.01, rel=0.05)
    absorbed = [3.0 + 1.2 * x for x in fine]
    assert measure(problem, fine, absorbed).lower_limit < 1e-9


def test_a_missing_effect_does_not_exceed_the_constant():
    x = measure(*tank(0.3))
    assert x.measured == x.used == SLIDER_CHANNELS["thrust"].discrepancy


def test_a_failed_simulation_gives_the_constant():
    problem, y = tank(0.02)
    failed = DiscrepancyMeter(problem, y, y)([np.full_like(x, np.nan) for x in y])["thrust"]
    assert failed.measured is None and failed.used == SLIDER_CHANNELS["thrust"].discrepancy


def test_a_declared_value_replaces_the_measured_value():
    x = measure(*tank(0.05, declared=0.003))
    assert x.measured == pytest.approx(0.05, rel=0.25)
    assert x.declared == x.used == 0.003


def test_declared_shares_are_part_of_the_noise():
    sensors = SensorsTable(thrust_gain=0.03, thrust_discrepancy=0.02, pressure_gain=0.004)
    noise = {c: channel_noise(sensors, x, np.sin(90.0 * T)) for c, x in SLIDER_CHANNELS.items()}
    assert (noise["thrust"].gain, noise["thrust"].discrepancy) == (0.03, 0.02)
    assert (noise["recoil"].gain, noise["recoil"].discrepancy) == (0.01, 0.012)
    assert noise["p_front"].gain == noise["p_rear"].gain == 0.004
    assert noise["tip"].discrepancy == SLIDER_CHANNELS["tip"].discrepancy


def test_only_a_clear_fall_changes_the_noise():
    found = {"thrust": measure(*tank(0.02))}
    used = found["thrust"].used
    assert fell(found, {"thrust": 1.3 * used}) and not fell(found, {"thrust": 1.2 * used})


@pytest.mark.slow
def test_the_lower_limit_is_1_to_2_5_times_the_error_of_coarse_meshes():
    experiment = load(ROOT / "docs" / "experiment.toml").with_values({"trials.0.duration": 2.0})
    trial, at = experiment.trials[0], T
    meshes = [Resolution(16, 50, 8e-3), Resolution(31, 100, 4e-3), Resolution(121, 400, 1e-3)]
    theta = np.array([3.0, 0.7, 0.08, 4.79e-7])
    plans = [plan_trial(experiment, trial, (), x, at) for x in meshes]
    coarse, fine, finest = (predict_each([(p, theta)])[0] for p in plans)
    noise = {
        (0, c): channel_noise(experiment.sensors, SLIDER_CHANNELS[c], fine[SLIDER_CHANNELS.row(c)])
        for c in SLIDER_CHANNELS
    }
    problem = TankProblem.of(
        experiment,
        [Record(trial, at, finest, SLIDER_CHANNELS)],
        (),
        fine=meshes[1],
        coarse=meshes[0],
    )
    found = DiscrepancyMeter(replace(problem, noise=noise), [fine], [coarse]).lower_limits
    for channel in ("thrust", "recoil", "tip"):
        y, error = fine[SLIDER_CHANNELS.row(channel)], (finest - fine)[SLIDER_CHANNELS.row(channel)]
        columns = np.stack([np.ones_like(y), y], axis=1)
        rest = error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]
        ratio = found[channel] * np.std(y) / np.std(rest)
        assert 1.0 < ratio < 2.5, (channel, ratio)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least", "most"), [("fine", 0.0, 0.012), ("open", 0.02, 0.06)])
def test_the_thrust_of_the_independent_program_has_its_known_error(data, name, least, most):
    """Steps of 0.2 ms (`open`) leave an error of 3 to 5 %, and steps of 0.05 ms about 1 %."""
    experiment = load(data / "sets" / f"{name}_null" / "experiment.toml")
    problem, entries = (
        TankProblem.of(experiment, load_records(experiment), ()),
        model_parameters(()),
    )
    start, free = base_vector(entries, base_values(experiment)), np.arange(len(entries))
    first = fit_gauss_newton(problem.on_coarse_mesh(), entries, start, free, exact=False)
    base = fit_gauss_newton(problem, entries, first.theta, free, exact=False)
    coarse = [x[0] for x in problem.coarse([base.theta])]
    x = DiscrepancyMeter(problem, base.predicted, coarse)(base.predicted)["thrust"]
    assert x.measured is not None and least <= x.measured <= x.used < most
    assert 0.002 < x.lower_limit < 0.006
