"""A trial is prepared once: its files are read once and its model is built once."""

from collections import Counter

import numpy as np
import pytest

from slider_jax.cli.main import main
from slider_jax.experiment import load as loading, playback, prepare
from tests.support.experiments import write_small_experiment


@pytest.mark.slow
def test_one_simulate_command_reads_each_file_and_builds_each_model_once(tmp_path, monkeypatch):
    path = write_small_experiment(tmp_path)
    for name, end in (("trial_00", 0.7), ("trial_01", 0.8)):
        t = np.arange(0.0, end, 2e-3)
        rows = [f"{x:.4f},{0.01 * np.sin(9.0 * x):.6f}" for x in t]
        (tmp_path / f"{name}.csv").write_text("\n".join(["t_s,tip_m", *rows]))
    (tmp_path / "trial_01.played.csv").write_text(
        "t_s,set_front_Pa,set_rear_Pa\n0,250000,250000\n0.2,-250000,-250000\n0.9,0,0\n"
    )
    read, built = Counter(), Counter()

    def reading(file, *arguments, **options):
        read[file.name] += 1
        return read_csv(file, *arguments, **options)

    def building(experiment, trial=0):
        built[trial.file] += 1
        return to_model(experiment, trial)

    read_csv, to_model = loading.read_csv, loading.to_model
    for module in (loading, playback):
        monkeypatch.setattr(module, "read_csv", reading)
    for module in (loading, prepare):
        monkeypatch.setattr(module, "to_model", building)
    assert main(["simulate", str(path), "--out", str(tmp_path / "out"), "--plot"]) == 0
    assert read == {"trial_00.csv": 1, "trial_01.csv": 1, "trial_01.played.csv": 1}
    assert built == {"trial_00.csv": 1, "trial_01.csv": 1}
