"""A sensor channel that is defined in one file is simulated, read and fitted."""

import importlib.util

import numpy as np
import pytest

from calibration.audit.pressures import check_pressures
from calibration.inference.noise import channel_noise
from calibration.inference.problem import TankProblem
from calibration.measurements.records import Record, load_records
from calibration.model.plan import Resolution, plan_trial
from calibration.model.predict import predict_readings
from slider_jax.channels import REGISTERED, SLIDER_CHANNELS, register
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from slider_jax.io.csv import read_csv
from slider_jax.simulation.summary import trial_summary
from slider_jax.simulation.trial import simulate_trial
from tests.support.experiments import write_small_experiment

MID_BODY = '''
"""A camera marker at the middle node."""

from slider_jax.channels import Channel, register
from slider_jax.observables import lateral


def marker(x):
    y = lateral(x)
    return y[len(y) // 2]


register(Channel("marker", "marker_m", "m", "marker, lateral", "mm", 1e3, marker))
'''


@pytest.fixture(scope="module")
def marked(tmp_path_factory):
    """Returns the small experiment with a channel from a temporary file, and its simulated run."""
    folder = tmp_path_factory.mktemp("marked")
    path = write_small_experiment(folder)
    plain = simulate_trial(load(path))
    (folder / "mid_body.py").write_text(MID_BODY)
    spec = importlib.util.spec_from_file_location("mid_body", folder / "mid_body.py")
    spec.loader.exec_module(importlib.util.module_from_spec(spec))
    yield folder, path, plain
    REGISTERED.pop()


def test_a_channel_outside_the_package_is_simulated_read_and_fitted(marked):
    folder, path, plain = marked
    experiment = load(path)
    run = simulate_trial(experiment)
    assert experiment.channels.columns[-1] == "marker_m" and "marker_m" not in plain.columns
    for name in plain.columns:  # the other channels do not change
        np.testing.assert_allclose(run.columns[name], plain.columns[name], rtol=1e-9, atol=1e-12)
    ratio = np.ptp(run.columns["marker_m"]) / np.ptp(run.columns["tip_m"])
    assert 0.1 < ratio < 0.7

    measured = run.columns | {"marker_m": run.columns["marker_m"] + 1e-3}
    np.savetxt(
        folder / "trial_00.csv",
        np.stack(list(measured.values()), axis=1),
        delimiter=",",
        header=",".join(measured),
        comments="",
    )
    errors = trial_summary(experiment, simulate_trial(experiment))["rmse_to_measured"]
    assert errors["marker_m"] == pytest.approx(1e-3, rel=1e-6)
    assert errors["tip_m"] < 1e-12

    found = load_records(experiment)
    noise = channel_noise(
        experiment.sensors, experiment.channels["marker"], found[0].values[found[0].row("marker")]
    )
    assert 0.0 < noise.white and noise.tare == 0.0
    resolution = Resolution(11, 60, 4e-3)
    theta = np.array([3.0, 1.0, 0.087, 4.79e-7])
    predicted = predict_readings(
        plan_trial(experiment, found[0].trial, (), resolution, found[0].t), theta
    )
    assert predicted.shape == (6, len(found[0].t))
    off = predicted[found[0].row("marker")] - run.columns["marker_m"]
    assert np.abs(off).max() < 0.1 * np.ptp(run.columns["marker_m"])

    problem = TankProblem.of(experiment, found, (), fine=resolution, coarse=resolution)
    assert problem.channels == (*SLIDER_CHANNELS, "marker")
    residuals = problem.residuals([predicted], problem.whiteners([predicted]))
    assert np.isfinite(residuals[0, "marker"]).all() and residuals[0, "marker"].any()


def test_a_repair_of_swapped_columns_keeps_the_channel(marked):
    experiment = load(marked[1])
    records = []
    for trial, run in ((t, simulate_trial(experiment, t)) for t in experiment.trials):
        columns = run.columns.copy()
        t = columns.pop("t_s")
        columns["p_front_Pa"], columns["thrust_N"] = columns["thrust_N"], columns["p_front_Pa"]
        records.append(Record(trial, t, np.stack(list(columns.values())), experiment.channels))
    repaired, findings = check_pressures(records, None)
    assert {(x.kind, x.channel) for x in findings} == {("swapped_columns", "p_front_Pa, thrust_N")}
    for r, before in zip(repaired, records, strict=True):
        np.testing.assert_array_equal(r.values, before.values[[2, 1, 0, 3, 4, 5]])


@pytest.mark.slow
def test_the_command_writes_the_column(marked, tmp_path):
    from slider_jax.cli.main import main

    _, path, _ = marked
    assert main(["simulate", str(path), "--out", str(tmp_path / "out"), "--plot"]) == 0
    assert "marker_m" in read_csv(tmp_path / "out" / "trial_01.csv", ("t_s", "marker_m"))


@pytest.mark.parametrize("change", [{"name": "head"}, {"column": "head_m"}])
def test_a_name_or_a_column_is_registered_once(change):
    from dataclasses import replace

    with pytest.raises(
        InputError, match="another channel has this name or column; other channels: p_front"
    ):
        register(replace(SLIDER_CHANNELS["tip"], **change))
    assert not {"tip", "head"} & {x.name for x in REGISTERED}
