"""The eel with three chambers, as in `examples/eel`, through the commands."""

import importlib.util
import json
from functools import partial

import numpy as np
import pytest

from calibration.audit.audit import audit_measurements
from calibration.discrepancy import close_loop
from calibration.experiment_design import detectability
from calibration.experiment_design.parameter_trial import feasible_trials
from calibration.experiment_design.trial_search import limits_of, trial_at, trial_text
from calibration.inference.problem import TankProblem
from calibration.model.plan import Resolution
from slider_jax.cli.main import main
from slider_jax.experiment.load import load, to_model
from slider_jax.io.csv import read_csv
from slider_jax.optimise.design_space import gait_bounds, models, to_toml, with_gait
from slider_jax.simulation.trial import simulate_trial
from slider_jax.swimming.gait import Gait
from tests.support.data import ROOT

FILE = ROOT / "examples" / "eel" / "experiment.toml"
SMALL: dict[str, object] = {"numerics.nodes": 15, "numerics.step": 4e-3} | {
    f"trials.{i}.duration": 1.0 for i in range(5)
}
TANK = {"numerics.nodes": 15, "numerics.step": 2e-3}
MESH = Resolution(15, 40, 4.0e-3)
CANDIDATES = ("lag_mismatch", "valve_delay")
PRESSURES = ("p_head", "p_middle", "p_rear")
TRUE = {"parameters.C_d": 3.0, "parameters.m_a": 0.8, "parameters.k": 0.08}


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("eel_example", FILE.parent / "tank.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def eel_in(folder, changes=SMALL):
    """Writes the eel with shorter trials to a folder; returns the file's path."""
    path = folder / "experiment.toml"
    path.write_text(to_toml(load(FILE).with_values(dict(changes))))
    return path


def evenly(count):
    """Returns changes of the eel to `count` equal chambers, whose trials have no own values."""
    ends = np.linspace(0.02, 0.415, count + 1).tolist()
    spans = zip(ends[:-1], ends[1:], strict=True)
    chambers = [
        {"kind": "pneumatic", "name": f"c{i}", "span": list(x)} for i, x in enumerate(spans)
    ]
    plain = {"ratios": None, "phases": None, "phase": 0.2}
    trials = [x.model_dump() | plain | {"duration": 1.0} for x in load(FILE).trials[1:4]]
    return {"actuators": chambers, "trials": trials} | TANK


@pytest.fixture(scope="module")
def tank(example, tmp_path_factory):
    """The eel's experiment with measured trials, and the true readings of each trial."""
    folder = tmp_path_factory.mktemp("eel")
    experiment = load(eel_in(folder))
    true = experiment.with_values(TANK | TRUE)
    example.measure(true, folder, {})
    readings = {x.file: simulate_trial(true, x).columns for x in true.trials}
    return experiment, readings


def test_a_changed_experiment_keeps_the_drive_of_each_chamber():
    experiment = load(FILE)
    changed = experiment.with_values({"numerics.nodes": 15})
    assert changed.trials == experiment.trials
    waves = to_model(changed, 2).drive.waves
    np.testing.assert_allclose([x.amplitude for x in waves], [300e3, 240e3, 150e3])
    np.testing.assert_allclose([x.phase for x in waves], [0.0, 0.2, 0.4])


@pytest.mark.slow
def test_the_audit_finds_a_swap_of_two_of_three_pressures(tank, tmp_path):
    experiment, true = tank
    for file in experiment.folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    swapped = tmp_path / "falling.csv"
    header, *rows = swapped.read_text().splitlines()
    names = header.split(",")
    names[2:4] = names[3:1:-1]
    swapped.write_text("\n".join([",".join(names), *rows]))

    def predict(records):
        return [
            np.stack([true[r.trial.file][x.column] for x in r.channels.values()])[:, : len(r.t)]
            for r in records
        ]

    assert audit_measurements(experiment, 3, predict).findings == []
    audited = audit_measurements(load(tmp_path / "experiment.toml"), 3, predict)
    (finding,) = audited.findings
    assert (finding.kind, finding.action) == ("swapped_columns", "mended")
    assert finding.detail == (
        "p_middle_Pa and p_rear_Pa are swapped: each fits another chamber's drive"
    )
    assert audited.records[2].channels.pressures == PRESSURES
    for c, name in enumerate(("p_head_Pa", "p_middle_Pa", "p_rear_Pa")):
        np.testing.assert_allclose(
            audited.records[2].pressures[c], true["falling.csv"][name], atol=4000.0
        )


def test_the_next_trial_has_the_phases_of_the_last_chamber():
    experiment = load(FILE)
    limits = limits_of(experiment)
    assert limits.phase == (0.235, 0.415)  # from 0.25 to 0.4, widened by a tenth of the width
    trial = trial_at(experiment, limits, np.full(4, 1.0))
    assert trial.phase == 0.415 and trial.phases is None and trial.ratios is None
    own = experiment.with_values({"trials.0.ratios": [1.0, 0.7, 0.5]})
    assert trial_at(own, limits, np.full(4, 0.0)).ratios == (1.0, 0.7, 0.5)
    assert "phases 0, 0.15, 0.3" in trial_text(experiment.trials[0])
    proposed = feasible_trials(experiment)
    assert {x.phase for x in proposed} == {0.25, 0.4}
    assert {x.ratios for x in proposed} == {(1.0, 1.0, 1.0)}


def test_an_optimised_gait_keeps_the_limits_of_the_chambers():
    changes = {"actuators.1.limit": 100e3, "trials.0.biases": [0.0, 1e4, 0.0]}
    experiment = load(FILE).with_values(changes)
    gait = Gait(2.0, 200e3, 300e3, 0.3, 0.05, 0.01)
    best = with_gait(experiment, gait)
    first = best.trials[0]
    assert first.ratios is None and first.phases is None and first.biases is None
    at = np.asarray(0.24), np.asarray(0.241)
    for model in (models(experiment)(gait), to_model(best)):
        head, middle, rear = (float(x.segment(*at).a0) for x in model.drive.waves)
        np.testing.assert_allclose([head, middle, rear], [200e3, 100e3, 300e3])
    assert gait_bounds({}).low.shape == (6,)


@pytest.fixture
def coarse(monkeypatch):
    """Coarse meshes for the commands that fit or predict."""
    of, loop, matrix = (
        TankProblem.of, close_loop.close_loop_on_trials, detectability.detectability_matrix
    )  # fmt: skip
    monkeypatch.setattr(
        TankProblem, "of", lambda *given, **options: of(*given[:4], fine=MESH, coarse=MESH)
    )
    monkeypatch.setattr(close_loop, "close_loop_on_trials", partial(loop, fine=MESH, coarse=MESH))
    monkeypatch.setattr(detectability, "detectability_matrix", partial(matrix, coarse=MESH))


def run(*words):
    assert main([str(word) for word in words]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 6])
def test_any_number_of_chambers_is_simulated_swept_and_calibrated(
    count, example, tmp_path, capsys, coarse
):
    path = eel_in(tmp_path, evenly(count))
    example.measure(load(path), tmp_path, TANK | TRUE)
    run("simulate", path, "--out", tmp_path / "simulated", "--plot")
    columns = read_csv(tmp_path / "simulated" / "linear.csv", ("t_s", f"p_c{count - 1}_Pa"))
    assert np.abs(columns[f"p_c{count - 1}_Pa"]).max() > 5e4
    field = "trials.1.amplitude"
    steps = ("--steps-per-stride", 40, "--strides", 3, "--transient", 1)
    out = tmp_path / "swept"
    run(
        "sweep",
        path,
        "--field",
        field,
        "--from",
        1e5,
        "--to",
        3e5,
        "--count",
        2,
        *steps,
        "--out",
        out,
    )
    run("calibrate", path, "--out", tmp_path / "fit")
    found = json.loads((tmp_path / "fit" / "calibration.json").read_text())
    assert found["audit"] == []
    for name, value in TRUE.items():
        x = found["parameters"][name.removeprefix("parameters.")]
        assert x["low"] < value < x["high"], name


@pytest.mark.slow
def test_every_command_without_measured_trials_runs_on_the_eel(tmp_path, capsys, coarse):
    path = eel_in(tmp_path)
    run("simulate", path, "--out", tmp_path / "simulated")
    assert "falling.csv   2.0 Hz  thrust" in capsys.readouterr().err
    steps = ("--steps-per-stride", 40, "--strides", 3, "--transient", 1)
    span = ("--from", 0.0, "--to", 0.4, "--count", 3)
    run("sweep", path, "--field", "trials.3.phase", *span, *steps, "--out", tmp_path / "swept")
    run("swim", path, "--trial", 2, "--out", tmp_path / "swum")
    search = ("--population", 4, "--generations", 1, "--steps-per-stride", 40)
    run("optimize", "swim", path, *search, "--out", tmp_path / "best")
    assert len(load(tmp_path / "best" / "best.toml").chambers) == 3
    run("effects", "matrix", path, "--only", *CANDIDATES, "--out", tmp_path / "matrix")


@pytest.mark.slow
def test_the_undeclared_lag_of_the_measured_eel_is_fitted_and_found(example, tmp_path, coarse):
    path = eel_in(tmp_path)
    example.measure(load(path), tmp_path, example.TRUTH | TANK)
    run("calibrate", path, "--also", "lag_mismatch", "--out", tmp_path / "fit")
    found = json.loads((tmp_path / "fit" / "calibration.json").read_text())
    x = found["parameters"]["lag_mismatch.x"]
    assert x["low"] < 0.3 < x["high"]
    run("close-loop", path, "--only", *CANDIDATES, "--out", tmp_path / "loop")
    report = json.loads((tmp_path / "loop" / "report.json").read_text())
    assert report["verdict"] == "identified"
    assert [x["name"] for x in report["effects"]] == ["lag_mismatch"]
