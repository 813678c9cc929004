"""`slider warm-up`: later processes neither trace nor compile the programs of the commands."""

import os
import subprocess
import sys
from typing import get_args

import pytest

from calibration.cli import warm_up
from slider_jax.cli.main import main
from slider_jax.experiment.load import load
from slider_jax.programs import FOLDER
from tests.support.data import ROOT
from tests.support.experiments import TINY

HEAD = f'{TINY}[[trials]]\nfile = "trial_00.csv"\n'
SQUARE = f"{HEAD}frequency = 4.8\namplitude = 250000.0\nduration = 0.4\n"
RECORDED = f'{HEAD}waveform = "recorded"\ndrive_file = "pressure.csv"\nduration = 1.0\n'


def test_each_part_is_reported_and_finished_parts_are_kept(monkeypatch, capsys):
    calls = []

    def stopped():
        raise KeyboardInterrupt

    work = {
        "swim": lambda: print("hidden"),
        "climb": lambda: calls.append("climb"),
        "demo": stopped,
    }
    monkeypatch.setattr(warm_up, "_work", lambda folder, experiments: work)
    assert main(["warm-up", "--parts", "swim", "climb"]) == 0
    out, err = capsys.readouterr()
    assert [line.split()[0] for line in out.splitlines()] == ["part", "swim", "climb"]
    assert "swim (1 of 2)" in err and "climb (2 of 2)" in err and calls == ["climb"]
    assert main(["warm-up", "--parts", "demo", "swim"]) == 130
    assert "finished programs are kept; repeat the command" in capsys.readouterr().err


def test_each_part_has_its_work(tmp_path):
    assert set(warm_up._work(tmp_path, ())) == set(get_args(warm_up.Part))


def test_without_the_cache_nothing_is_compiled(monkeypatch, capsys):
    monkeypatch.setenv("SLIDER_CACHE", "off")
    assert main(["warm-up"]) == 2
    assert "SLIDER_CACHE: given 'off'" in capsys.readouterr().err


def test_recorded_drives_are_refused(tmp_path):
    path = tmp_path / "tank.toml"
    path.write_text(RECORDED)
    with pytest.raises(warm_up.InputError, match="all drives are recordings"):
        warm_up._measured(tmp_path, path)


def test_the_trials_are_short_trials_of_the_experiment(tmp_path):
    (tmp_path / "tank.toml").write_text(SQUARE)
    made = load(warm_up._measured(tmp_path, tmp_path / "tank.toml"))
    given = load(tmp_path / "tank.toml")
    assert made.robot == given.robot and made.numerics == given.numerics
    assert len(made.trials) == 1 and (made.folder / made.trials[0].file).exists()


@pytest.mark.slow
def test_the_next_process_compiles_no_program(tmp_path):
    path = tmp_path / "tank.toml"
    path.write_text(SQUARE)
    given = {k: x for k, x in os.environ.items() if not k.startswith("JAX_")}
    given |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}

    def slider(*words):
        command = [sys.executable, "-m", "slider_jax.cli.main", *words]
        subprocess.run(command, env=given, cwd=ROOT, check=True, capture_output=True)
        return sorted((tmp_path / "cache").rglob(f"{FOLDER}/*/*"))

    found = slider("warm-up", str(path), "--parts", "simulate")
    assert len(found) == 3  # the state at rest, and the simulation with and without shapes
    assert slider("simulate", str(path), "--out", str(tmp_path / "out")) == found
    assert slider("simulate", str(path), "--out", str(tmp_path / "out"), "--plot") == found
