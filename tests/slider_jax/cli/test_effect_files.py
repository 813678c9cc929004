"""Tests of the option --effects, which adds effects of the user's own files to the library."""

import hashlib
import json

import pytest

from slider_jax.cli.commands import COMMANDS
from slider_jax.cli.main import main
from slider_jax.simulation import trial
from tests.support.experiments import write_small_experiment
from tests.support.own_effects import restored_library, write_effect

TABLE = '[[effects]]\nname = "wall_friction"\nc = 2.0\n[sensors]'
FLOOR = (("class WallFriction", "class FloorFriction"),)


@pytest.fixture(autouse=True)
def library():
    with restored_library() as before:
        yield before


@pytest.fixture
def experiment(tmp_path):
    second = ("duration = 0.9", "duration = 0.25")
    return write_small_experiment(tmp_path, ("[sensors]", TABLE), ("= 0.75", "= 0.25"), second)


def refused(capsys, *words):
    """Returns the only line of the message of a command that ends with code 2."""
    assert main([str(word) for word in words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_the_option_can_be_repeated(tmp_path, capsys):
    paths = write_effect(tmp_path / "wall.py"), write_effect(tmp_path / "floor.py", *FLOOR)
    words = [word for path in paths for word in ("--effects", str(path))]
    assert main(["effects", *words]) == 0
    text = capsys.readouterr().out
    assert "  wall_friction " in text and "  floor_friction " in text


@pytest.mark.slow
def test_an_experiment_may_contain_effects_of_the_file_which_the_result_records(
    tmp_path, experiment, capsys
):
    path, out = write_effect(tmp_path / "wall.py"), tmp_path / "out"
    line = refused(capsys, "simulate", experiment, "--out", out)
    assert "effects.0.name: given 'wall_friction'" in line and "--effects FILE.py" in line
    assert main(["simulate", str(experiment), "--out", str(out), "--effects", str(path)]) in (
        None,
        0,
    )
    record = json.loads((out / "summary.json").read_text())
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert record["effect_files"] == [{"path": str(path), "sha256": digest}]


@pytest.mark.parametrize("end", ["changed", pytest.param("deleted", marks=pytest.mark.slow)])
def test_a_file_that_changes_during_the_run_gives_an_error_and_no_result(
    end, tmp_path, experiment, capsys, monkeypatch
):
    path, out = write_effect(tmp_path / "wall.py"), tmp_path / "out"
    simulate = trial.simulate_prepared

    def changed_during(*arguments, **options):
        path.unlink(missing_ok=True)
        if end == "changed":
            write_effect(path, ("-self.c", "-2.0 * self.c"))
        return simulate(*arguments, **options)

    monkeypatch.setattr(trial, "simulate_prepared", changed_during)
    assert main(["simulate", str(experiment), "--out", str(out), "--effects", str(path)]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith(
        f"slider: error: {path}: the effect file has changed or is missing since"
    )
    assert "repeat the command" in line
    assert not out.exists()


def test_a_file_with_an_error_stops_the_command_before_the_experiment_is_read(tmp_path, capsys):
    path = write_effect(tmp_path / "wall.py", ("(self, x):", "(self, x)"))
    words = ("simulate", "no_such.toml", "--out", tmp_path / "out", "--effects", path)
    assert f"{path}: line 19: invalid Python" in refused(capsys, *words)


def test_the_simulated_rig_needs_an_experiment_for_effects(tmp_path, capsys):
    words = ("rig", "simulate", "--rig-file", tmp_path / "rig.toml", "--effects", "wall.py")
    assert refused(capsys, *words) == (
        "slider: error: --effects wall.py: needs an experiment file; give a file, or omit --effects"
    )
    assert "--published: given with --effects" in refused(
        capsys, *words[:2], "--published", *words[4:]
    )


def test_every_command_that_simulates_an_experiment_has_the_option(capsys):
    """The other commands have no experiment, do not simulate, or run without JAX."""
    with_option = set()
    for name in COMMANDS:
        with pytest.raises(SystemExit):
            main([*name.split(), "--help"])
        if "--effects FILE.py" in capsys.readouterr().out:
            with_option.add(name)
    without = {"demo", "export", "statics", "lamprey", "published", "warm-up"}
    without |= {"calibrate manifold", "calibrate statics"}
    rig = {"rig ports", "rig check", "rig run", "rig log", "rig replay"}
    assert set(COMMANDS) - with_option == without | rig
