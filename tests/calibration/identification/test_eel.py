"""The eel with three chambers, as in `examples/eel`, through the commands."""

import importlib.util
import json
from dataclasses import replace

import numpy as np
import pytest

from calibration.experiment_design.parameter_trial import feasible_trials
from calibration.experiment_design.trial_search import limits_of, trial_at, trial_text
from calibration.identification.identify import identify_parameters
from calibration.inference.uncertainty import confidence_interval
from calibration.model.plan import Resolution
from slider_jax.cli.main import main
from slider_jax.experiment.load import load, to_model
from slider_jax.optimise.design_space import gait_bounds, models, to_toml, with_gait
from slider_jax.swimming.gait import Gait
from tests.support.data import ROOT

FILE = ROOT / "examples" / "eel" / "experiment.toml"
SMALL = {"numerics.nodes": 15, "numerics.step": 4e-3} | {
    f"trials.{i}.duration": 1.0 for i in range(5)
}
TANK = {"numerics.nodes": 15, "numerics.step": 2e-3}
MESH = Resolution(15, 40, 4.0e-3)
PRESSURES = ("p_head", "p_middle", "p_rear")
TRUE = {"C_d": 3.0, "m_a": 0.8, "k": 0.08, "K_Q": 4.6e-7}


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
    """A measured eel without an undeclared effect, whose columns of two pressures are swapped."""
    folder = tmp_path_factory.mktemp("eel")
    path = eel_in(folder)
    example.measure(load(path), folder, example.TRUTH | TANK | {"effects": []})
    swapped = folder / "falling.csv"
    header, *rows = swapped.read_text().splitlines()
    names = header.replace("p_middle", "p_").replace("p_rear", "p_middle").replace("p__", "p_rear_")
    swapped.write_text("\n".join([names, *rows]))
    return load(path)


def test_a_changed_experiment_keeps_the_drive_of_each_chamber():
    experiment = load(FILE)
    changed = experiment.with_values({"numerics.nodes": 15})
    assert changed.trials == experiment.trials
    waves = to_model(changed, 2).drive.waves
    np.testing.assert_allclose([x.amplitude for x in waves], [300e3, 240e3, 150e3])
    np.testing.assert_allclose([x.phase for x in waves], [0.0, 0.2, 0.4])


def test_calibration_finds_the_parameters_and_a_swap_of_two_of_three_pressures(tank):
    found = identify_parameters(tank, fine=MESH, coarse=MESH)
    (finding,) = found.audit
    assert finding.kind == "swapped_columns" and finding.channel == "p_middle, p_rear"
    assert finding.detail == (
        "p_middle_Pa and p_rear_Pa are swapped: each fits another chamber's drive"
    )
    assert found.problem.channels == (*PRESSURES, "thrust", "recoil", "tip", "waist", "joint")
    for i, entry in enumerate(found.entries):
        value, low, high = confidence_interval(found.fit, found.entries, i)
        assert low < TRUE[entry.label] < high, (entry.label, low, value, high)


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
