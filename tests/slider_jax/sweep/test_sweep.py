"""`slider sweep`: interrupted equals uninterrupted, a member equals a single run, and bad input."""

import csv
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from slider_jax.cli.main import main
from slider_jax.errors import InputError
from slider_jax.experiment.load import load, to_model, to_numerics
from slider_jax.io.files import LOADED_FILES
from slider_jax.observables import stride_means, thrust
from slider_jax.paper import force_coefficients
from slider_jax.sweep import sweep as sweeping
from slider_jax.sweep.report import FILES
from slider_jax.sweep.sweep import Axis, Sweep, groups_of, run_sweep
from tests.support.data import ROOT
from tests.support.experiments import TINY
from tests.support.helpers import march

EXPERIMENT = f"""{TINY}[[trials]]
file = "trial_00.csv"
frequency = 4.8
amplitude = 250000.0
phase = 0.15
duration = 1.0
[[trials]]
file = "trial_01.csv"
waveform = "recorded"
drive_file = "pressure.csv"
duration = 1.0
"""
SHORT = ["--strides", "3", "--transient", "1", "--steps-per-stride", "40"]


@pytest.fixture
def experiment(tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text(EXPERIMENT)
    return path


def tiny(path, **changes):
    axis = Axis.spaced("trials.0.frequency", 2.0, 5.0, 5)
    return Sweep(load(path), (axis,), 0, strides=3, transient=1, steps_per_stride=40)._replace(
        **changes
    )


@pytest.fixture
def one_core_chunks_of_two(monkeypatch):
    monkeypatch.setattr(sweeping, "available_cores", lambda: 1)
    monkeypatch.setattr(sweeping, "LARGEST_CHUNK", 2)


class Killed(Exception):
    pass


@pytest.mark.slow
def test_interrupted_sweep_goes_on_and_ends_as_an_uninterrupted_one(
    experiment, tmp_path, one_core_chunks_of_two, monkeypatch
):
    task, calls = tiny(experiment), []

    def killed_in_the_second_chunk():
        calls.append(1)
        if len(calls) == 5:
            raise Killed

    (tmp_path / "a").mkdir()
    with pytest.raises(Killed):
        run_sweep(task, tmp_path / "a", on_stride=killed_in_the_second_chunk)
    kept = sorted(p.name for p in (tmp_path / "a" / "partial").glob("chunk*"))
    assert kept == ["chunk_00000.json"]

    begun, later = [], []
    resumed = run_sweep(
        task, tmp_path / "a", lambda *numbers: begun.append(numbers), lambda: later.append(1)
    )
    assert begun == [(9, 3)]  # three chunks of three strides, of which one chunk was there
    assert len(later) == 6

    (tmp_path / "b").mkdir()
    whole = run_sweep(task, tmp_path / "b")
    assert list(whole) == list(resumed)
    for name in whole:
        np.testing.assert_array_equal(whole[name], resumed[name])

    with pytest.raises(InputError, match=r"other settings \(strides\)"):
        run_sweep(task._replace(strides=4), tmp_path / "a")
    monkeypatch.setitem(LOADED_FILES, tmp_path / "wall.py", "digest")
    with pytest.raises(InputError, match=r"other settings \(effect_files\)"):
        run_sweep(task, tmp_path / "a")


@pytest.mark.slow
def test_a_member_of_the_batch_is_what_a_run_of_its_own_gives(
    experiment, tmp_path, one_core_chunks_of_two
):
    task = tiny(experiment)
    whole = run_sweep(task, _made(tmp_path / "whole"))
    changed = task.experiment.with_values({"trials.0.frequency": whole["trials.0.frequency_Hz"][3]})
    model, h = to_model(changed), 1.0 / (changed.trials[0].frequency * 40)
    _, single = march(model, h, 120, thrust, to_numerics(changed)[0])
    expected = np.asarray(stride_means(single, 40))[1:].mean()
    np.testing.assert_allclose(whole["thrust_mean_N"][3], expected, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_nodes_are_swept_like_any_number(experiment, tmp_path, one_core_chunks_of_two):
    """Each number of nodes is a program of its own; rows are those of sweeps at fixed nodes."""
    drag = Axis("parameters.C_d", (2.0, 4.0))
    both = tiny(experiment, axes=(drag, Axis("numerics.nodes", (11.0, 12.0))))
    table = run_sweep(both, _made(tmp_path / "both"))
    np.testing.assert_array_equal(table["numerics.nodes"], [11, 12, 11, 12])
    for i, nodes in enumerate((11, 12)):
        fixed = both.experiment.with_values({"numerics.nodes": nodes})
        alone = tiny(experiment, experiment=fixed, axes=(drag,))
        expected = run_sweep(alone, _made(tmp_path / str(nodes)))["thrust_mean_N"]
        np.testing.assert_array_equal(table["thrust_mean_N"][i::2], expected)
        assert np.ptp(expected) > 1e-3
    assert np.abs(np.diff(table["thrust_mean_N"][:2])) > 1e-5


def _made(folder):
    folder.mkdir()
    return folder


def test_a_swept_step_sets_the_steps_per_stride(experiment):
    groups = groups_of(tiny(experiment, axes=(Axis("numerics.step", (0.001, 0.005, 0.006)),)))
    # At 4.8 Hz a stride has 208.3, 41.7, 34.7 of them; multiples of 20, and 40 at least.
    assert [group.plan.steps_per_stride for group in groups] == [220, 60, 40]
    assert [list(group.points) for group in groups] == [[0], [1], [2]]


def test_a_swept_tail_keeps_its_cells(experiment):
    tails = Axis("robot.tail_length", (0.03, 0.07, 0.11))
    task = tiny(experiment, axes=(tails, Axis("numerics.nodes", (11.0, 21.0))))
    # 0.07 of 0.37 m, as in the file: 2 of 10 cells, 4 of 20.
    cells = [(g.plan.numerics.tail_cells, g.plan.numerics.body_cells) for g in groups_of(task)]
    assert cells == [(2, 8), (4, 16)]
    np.testing.assert_array_equal(groups_of(task)[0].members.model.robot.tail.lengths, tails.values)


def test_the_ramp_follows_a_swept_frequency(experiment):
    ramp = EXPERIMENT.replace("C_d = 3.0\nm_a = 1.0", 'force_coefficients = "ramp"')
    experiment.write_text(ramp.split('[[trials]]\nfile = "trial_01')[0])
    (group,) = groups_of(tiny(experiment))
    drag, reactive = group.members.model.effects
    C_d, m_a = np.transpose([force_coefficients(f) for f in group.members.frequency])
    np.testing.assert_array_equal(drag.C_d, C_d)
    np.testing.assert_array_equal(reactive.m_a, m_a)
    assert list(drag.C_d) == [4.0, 3.25, 3.0, 3.0, 3.0]


@pytest.fixture
def without_physics(monkeypatch, one_core_chunks_of_two):
    """Replaces the simulation of a sweep: every thrust is 1 N."""
    names = ("thrust_mean_N", "recoil_rms_N", "tip_half_range_m", "chamber_power_W")
    monkeypatch.setattr(sweeping, "run_strides", lambda *args: None)
    monkeypatch.setattr(
        sweeping, "steady_quantities", lambda *args: {name: np.ones(2) for name in names}
    )


def test_what_is_done_is_said_and_not_done_again(
    experiment, tmp_path, capsys, monkeypatch, without_physics
):
    out, calls = tmp_path / "out", []
    field = ["--field", "trials.0.frequency", "--from", "2", "--to", "5", "--count", "5"]
    command = ["sweep", str(experiment), *field, "--out", str(out), *SHORT]

    def run_strides(*args):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(sweeping, "run_strides", run_strides)
    assert main(command) == 130
    assert "repeat the same command to resume" in capsys.readouterr().err
    assert [p.name for p in out.iterdir()] == ["partial"]

    assert main(command) == 0
    assert "resuming: 2 of 3 chunks are complete" in capsys.readouterr().err
    assert len(calls) == 4
    written = (out / "sweep.json").stat().st_mtime_ns

    assert main(command) == 0
    assert "already contains all 5 points of this sweep" in capsys.readouterr().err
    assert len(calls) == 4 and (out / "sweep.json").stat().st_mtime_ns == written

    assert main([*command, "--transient", "2"]) == 0  # another sweep, in place of it
    assert len(calls) == 7
    (out / "sweep.json").write_text("{")
    assert main([*command, "--transient", "2"]) == 0
    assert len(calls) == 10


def test_two_fields_from_the_command_line(experiment, tmp_path, one_core_chunks_of_two):
    out = tmp_path / "out"
    fields = ["--field", "robot.EI_tail", "--from", "0.003", "--to", "0.009", "--count", "2"]
    second = ["--field2", "parameters.C_d", "--from2", "2", "--to2", "4", "--count2", "3"]
    assert main(["sweep", str(experiment), *fields, *second, "--out", str(out), *SHORT]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["sweep.csv", "sweep.json", "sweep.png"]
    with open(out / "sweep.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    points = [(float(r["robot.EI_tail_N_m2"]), float(r["parameters.C_d"])) for r in rows]
    assert points == [(e, c) for e in (0.003, 0.009) for c in (2.0, 3.0, 4.0)]
    thrusts = [float(row["thrust_mean_N"]) for row in rows]
    assert len(set(thrusts)) == 6 and np.isfinite(thrusts).all()
    record = json.loads((out / "sweep.json").read_text())
    assert record["settings"]["fields"]["parameters.C_d"] == [2.0, 3.0, 4.0]
    assert record["versions"]["jax"] and record["input"]["sha256"] and record["failed_rows"] == []


@pytest.mark.parametrize(
    "changes, named",
    [
        ({"--field": "robot.EI_fin"}, "no such field"),
        ({"--field": "robot"}, "robot"),
        ({"--field": "trials.0.waveform"}, "waveform"),
        ({"--field": "trials.0.duration", "--from": "1", "--to": "2"}, "--strides sets the number"),
        (
            {"--field": "sensors.tip_noise", "--from": "0", "--to": "0.01"},
            "does not affect the strides",
        ),
        ({"--field": "numerics.nodes", "--from": "11", "--to": "14"}, "given 12.5; allowed whole"),
        ({"--field": "numerics.nodes", "--from": "3", "--to": "5"}, "numerics.nodes: given 3"),
        ({"--field": "robot.body_length", "--from": "300", "--to": "400"}, "metres"),
        ({"--field": "trials.7.frequency"}, "trials.N: given 7"),
        ({"--to": "2"}, "two different"),
        ({"--to": "nan"}, "finite"),
        ({"--count": "1"}, "2 or more"),
        ({"--trial": "1"}, "recording"),
        ({"--trial": "9"}, "--trial"),
        ({"--transient": "3"}, "--transient"),
        ({"--steps-per-stride": "50"}, "multiple of 20"),
        ({"--field2": "parameters.C_d"}, "--from2"),
        (
            {"--field2": "trials.0.frequency", "--from2": "2", "--to2": "3", "--count2": "2"},
            "other than --field",
        ),
    ],
)
def test_bad_sweeps_are_refused_in_one_line_and_leave_nothing(
    experiment, tmp_path, capsys, changes, named
):
    out = tmp_path / "out"
    options = {"--field": "trials.0.frequency", "--from": "2", "--to": "5", "--count": "3"}
    options |= dict(zip(SHORT[::2], SHORT[1::2], strict=True)) | changes | {"--out": str(out)}
    arguments = [word for pair in options.items() for word in pair]
    assert main(["sweep", str(experiment), *arguments]) == 2
    message = capsys.readouterr().err
    assert message.startswith("slider: error: ") and message.count("\n") == 1
    assert named in message and "Traceback" not in message
    assert not out.exists() or not list(out.iterdir())


def test_columns_carry_the_fields_units():
    columns = {
        "trials.0.frequency": "trials.0.frequency_Hz",
        "robot.EI_tail": "robot.EI_tail_N_m2",
        "parameters.K_Q": "parameters.K_Q_m3",
        "parameters.C_d": "parameters.C_d",
        "trials.2.tow_speed": "trials.2.tow_speed_m_per_s",
        "trials.0.phase": "trials.0.phase",
        "robot.EA_body": "robot.EA_body_N",
    }
    for field, column in columns.items():
        assert Axis(field, (0.0, 1.0)).column == column


SHARED = """
import sys
from pathlib import Path
from slider_jax.cli.main import main
from slider_jax.sweep import sweep
sweep.available_cores, sweep.LARGEST_CHUNK = lambda: 1, 2
log, *words = sys.argv[1:]
simulated = sweep.run_strides

def run_strides(plan, batch, *others):
    with open(log, "a") as file:
        file.write(str(batch.frequency.tolist()) + "\\n")
    return simulated(plan, batch, *others)

sweep.run_strides = run_strides
sys.exit(main(words))
"""


@pytest.mark.slow
def test_two_processes_share_a_sweep(experiment, tmp_path):
    """As two tasks of a SLURM job: no chunk twice, and the same bytes as one process."""
    field = ["--field", "trials.0.frequency", "--from", "2", "--to", "5", "--count", "12"]

    def tasks(name, count):
        words = ["sweep", str(experiment), *field, "--out", str(tmp_path / name), *SHORT]
        logs = [tmp_path / f"{name}_{i}" for i in range(count)]
        given = {**os.environ, "PYTHONPATH": str(ROOT), "SLURM_NTASKS": str(count)}
        runs = [
            subprocess.Popen(
                [sys.executable, "-c", SHARED, str(log), *words],
                env=given | {"SLURM_PROCID": str(i)},
                cwd=ROOT,
            )
            for i, log in enumerate(logs)
        ]
        assert [run.wait(timeout=500) for run in runs] == [0] * count
        return [x for log in logs if log.exists() for x in log.read_text().splitlines()]

    one, two = tasks("one", 1), tasks("two", 2)
    assert len(two) == len(set(two)) == 6 and sorted(one) == sorted(two)
    for file in ("sweep.csv", "sweep.json"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    assert sorted(x.name for x in (tmp_path / "two").iterdir()) == sorted(FILES)
