"""`slider swim` and `slider optimize swim` on a coarse robot."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import to_plane
from slider_jax.cli.main import main
from slider_jax.dynamics.rollout import rollout
from slider_jax.effects import total_force
from slider_jax.experiment.load import assemble, load, to_model
from slider_jax.io.csv import read_csv
from slider_jax.optimise.design_space import to_toml
from slider_jax.optimise.fastest_swimmer import Task, speed_at
from slider_jax.swimming.gait import Gait, to_swimmer
from slider_jax.swimming.paper_optimum import swimmer_content
from slider_jax.swimming.performance import next_stride, performance
from slider_jax.swimming.steady_state import SteadySettings, find_steady, stride_times
from tests.support.data import ROOT

COARSE = {"nodes": 17, "step": 0.004}
SEARCH = SteadySettings(steps_per_stride=48, numerics=Numerics(4, 12))


def coarse(**trial):
    content = swimmer_content(**({"frequency": 5.0, "amplitude": 365e3, "phase": 0.2} | trial))
    return assemble(content | {"numerics": COARSE}, "coarse", Path("."))


@pytest.fixture(scope="module")
def swum(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swum")
    (folder / "tank.toml").write_text(to_toml(coarse()))
    assert main(["swim", str(folder / "tank.toml"), "--out", str(folder / "out")]) == 0
    return folder / "out"


@pytest.mark.slow
def test_it_writes_what_it_found(swum):
    told = json.loads((swum / "swim.json").read_text())
    (row,) = told["swims"]
    U, f, A = row["speed_m_per_s"], 5.0, row["tail_amplitude_m"]
    assert row["steady"] and row["from_rest"]["repeats"]
    assert 6 <= row["strides_of_search"] < 4 + 2 * 14  # it ended before the largest number
    assert row["root_over_from_rest"] == pytest.approx(1.0, abs=0.01)
    assert row["strouhal"] == pytest.approx(2.0 * A * f / U)
    assert row["cost_of_transport"] == pytest.approx(row["power_W"] / (9.81 * 0.7 * 0.368 * U))
    assert row["froude_efficiency"] == pytest.approx(row["thrust_N"] * U / row["power_W"])
    bare = row["without_resistance"]
    assert bare["effects"] == "head_drag"
    assert bare["speed_m_per_s"][-1] > 2.0 * U and bare["gaining_m_per_s2"] > 0.01
    assert told["versions"]["jax"] and told["experiment"]["numerics"]["nodes"] == 17
    velocity = [f"velocity_{x}_m_per_s" for x in "xy"]
    columns = read_csv(swum / "swim_swim.csv", ("t_s", *velocity, "power_W"))
    speed = np.hypot(*(np.mean(columns[name]) for name in velocity))
    assert speed == pytest.approx(U, rel=1e-3)
    assert np.mean(columns["power_W"]) == pytest.approx(row["power_W"], rel=1e-3)
    assert (swum / "swim_swim.png").stat().st_size > 10_000


@pytest.mark.slow
def test_over_a_steady_stride_the_thrust_is_what_resists():
    """The force of drag and added mass, summed here from the sections of the same stride."""
    model, f = to_swimmer(to_model(coarse())), jnp.asarray(5.0)

    @jax.jit
    def forces(model):
        carry = find_steady(model, f, SEARCH).carry
        stride = next_stride(model, f, carry, SEARCH)

        def given(x):
            cell = x.section()
            F = jnp.stack(to_plane(*total_force(x.stage.effects[:2], cell), cell.phi))
            return x.mesh.grid.integral((1.0 + cell.strain) * F)

        times = stride_times(f, 2, SEARCH)
        run = rollout(model, times, given, SEARCH.numerics, begin=carry)
        found = performance(model, f, stride, SEARCH)
        return found, jnp.mean(run.saved[SEARCH.steps_per_stride :], axis=0), stride

    found, giving, stride = forces(model)
    along = np.asarray(stride.velocity).mean(axis=0) / float(found.speed)
    assert float(found.thrust) > 0.01
    assert float(found.thrust) == pytest.approx(np.asarray(giving) @ along, rel=5e-3)
    assert abs(float(found.turning)) < 1e-3


@pytest.mark.slow
def test_a_robot_that_is_not_driven_stays_where_it_is(tmp_path, capsys):
    (tmp_path / "still.toml").write_text(to_toml(coarse(amplitude=0.0)))
    assert main(["swim", str(tmp_path / "still.toml"), "--out", str(tmp_path / "out")]) == 0
    (row,) = json.loads((tmp_path / "out" / "swim.json").read_text())["swims"]
    assert row["steady"] and row["speed_m_per_s"] < 1e-6 and row["froude_efficiency"] is None
    assert "steady speed 0.00 cm/s" in capsys.readouterr().out


def test_a_recorded_drive_is_refused(tmp_path, capsys):
    text = to_toml(coarse())
    recorded = 'frequency = 5.0\nwaveform = "recorded"\ndrive_file = "drive.csv"'
    (tmp_path / "tank.toml").write_text(text.replace("frequency = 5.0", recorded))
    assert main(["swim", str(tmp_path / "tank.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "the drive is a recording, which has no strides" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def optimize(folder, *words):
    file = folder / "tank.toml"
    file.write_text(to_toml(coarse()))
    few = ["--population", "8", "--steps-per-stride", "48", "--seed", "1"]
    return main(["optimize", "swim", str(file), "--out", str(folder / "out"), *few, *words])


@pytest.fixture(scope="module")
def sought(tmp_path_factory):
    """Two generations, one of them taken up."""
    folder = tmp_path_factory.mktemp("sought")
    assert optimize(folder, "--generations", "1") == 0
    assert optimize(folder, "--generations", "2", "--resume") == 0
    return folder / "out"


@pytest.mark.slow
def test_the_best_design_swims_as_it_was_found_to(sought, tmp_path):
    told = json.loads((sought / "optimum.json").read_text())
    speed = told["speed_m_per_s"]
    assert [x["number"] for x in told["history"]] == [0, 1]
    assert told["history"][1]["best"] == speed >= told["history"][0]["best"]
    assert (sought / "optimum.png").stat().st_size > 5_000
    assert main(["swim", str(sought / "best.toml"), "--out", str(tmp_path)]) == 0
    (row,) = json.loads((tmp_path / "swim.json").read_text())["swims"]
    assert row["speed_m_per_s"] == pytest.approx(speed, rel=0.02)  # other steps per stride


@pytest.mark.slow
def test_the_sensitivity_is_that_of_the_speed(sought):
    """The gradient, along its own direction, by a difference of the searched-for speeds."""
    told = json.loads((sought / "optimum.json").read_text())
    task = Task.of(load(sought / "best.toml"), {}, 48)
    gradient, unit = (np.array(x) for x in (told["sensitivity"]["gradient"],
                                            task.box.unit(Gait(**told["gait"]))))  # fmt: skip
    way = 2e-3 * gradient / np.abs(gradient).max()
    fast, slow = (speed_at(task, task.box.gait(unit + x)) for x in (way, -way))
    assert fast - slow == pytest.approx(2.0 * gradient @ way, rel=0.02)


@pytest.mark.slow
def test_a_search_killed_at_any_moment_goes_on_as_if_it_had_not_been(tmp_path):
    """By the system, three times; its history and best design are those of one undisturbed."""
    file, moments = tmp_path / "tank.toml", np.random.default_rng(0).uniform(0.0, 1.0, 3)
    file.write_text(to_toml(coarse()))

    def begun(out, *words):
        few = ["--population", "16", "--generations", "8", "--steps-per-stride", "48"]
        command = [sys.executable, "-m", "slider_jax.cli.main", "optimize", "swim", str(file)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        return subprocess.Popen([*command, *few, "--out", str(out), *words], env=environment)

    whole, broken = tmp_path / "whole", tmp_path / "broken"
    begin = time.monotonic()
    assert begun(whole).wait() == 0
    lasted = time.monotonic() - begin
    for moment in moments:
        run = begun(broken, "--resume")
        time.sleep(moment * lasted)
        run.kill()
        run.wait()
    assert begun(broken, "--resume").wait() == 0
    one, other = (json.loads((x / "optimum.json").read_text()) for x in (whole, broken))
    for name in ("history", "gait", "speed_m_per_s", "last_population"):
        assert one[name] == other[name], (name, moments)


def test_bad_options_are_refused(tmp_path, capsys):
    for words, said in (
        (["--frequency", "5", "3"], "--frequency: given 5 3; allowed LOW HIGH"),
        (["--generations", "0"], "--generations: given 0; allowed 1 or more"),
        (["--seed", "-1"], "--seed: given -1; allowed 0 to"),
        (["--process", "1"], "--process: given 1; allowed 0 to 0"),
        (["--processes", "2"], "several processes need --coordinator HOST:PORT"),
        (["--steps-per-stride", "3"], "--steps-per-stride: given 3; allowed an even number"),
    ):
        assert optimize(tmp_path, *words) == 2
        assert said in capsys.readouterr().err
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_sweep_of_swimmers_gives_what_each_swims_alone(swum, tmp_path):
    (tmp_path / "tank.toml").write_text(to_toml(coarse()))
    words = ["--field", "trials.0.phase", "--from", "0.0", "--to", "0.2", "--count", "2", "--swim"]
    file, out = str(tmp_path / "tank.toml"), str(tmp_path / "out")
    assert main(["sweep", file, *words, "--steps-per-stride", "60", "--out", out]) == 0
    (alone,) = json.loads((swum / "swim.json").read_text())["swims"]
    names = ("speed_m_per_s", "strouhal", "power_W", "tail_amplitude_m")
    table = read_csv(tmp_path / "out" / "sweep.csv", ("trials.0.phase", *names))
    for name in names:
        assert table[name][1] == pytest.approx(alone[name], rel=0.02)  # 50 steps a stride there
        assert table[name][0] != pytest.approx(table[name][1], rel=0.02)
    assert json.loads((tmp_path / "out" / "sweep.json").read_text())["settings"]["swim"]
    assert (tmp_path / "out" / "sweep.png").stat().st_size > 10_000


@pytest.mark.slow
def test_two_tasks_of_a_slurm_job_find_what_one_finds(tmp_path):
    """The job script with a `srun` that starts two tasks here; one of them is killed."""
    file, programs = tmp_path / "tank.toml", tmp_path / "bin"
    file.write_text(to_toml(coarse()))
    programs.mkdir()
    srun = """#!/bin/bash
while [[ "$1" == --* ]]; do shift; done
for task in $(seq 0 $((SLURM_NTASKS - 1))); do
    SLURM_PROCID=$task "$@" &
    echo $! >> "$TASKS"
done
wait
"""
    slider = f'#!/bin/bash\nexec {sys.executable} -m slider_jax.cli.main "$@"\n'
    for name, text in (("srun", srun), ("slider", slider)):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    few = ["--population", "48", "--generations", "3", "--steps-per-stride", "48"]
    few += ["--algorithm", "cma-es"]

    def job(name, tasks):
        given = {"SLURM_NTASKS": str(tasks), "SLURM_CPUS_PER_TASK": "1", "PYTHONPATH": str(ROOT)}
        given |= {"PATH": f"{programs}:{os.environ['PATH']}", "TASKS": str(tmp_path / "tasks")}
        script = ["bash", str(ROOT / "scripts" / "optimize.slurm"), str(tmp_path / name), str(file)]
        return subprocess.Popen([*script, *few], env={**os.environ, **given}, cwd=ROOT)

    assert job("one", 1).wait() == 0
    (tmp_path / "tasks").unlink()
    run = job("two", 2)
    while not (tmp_path / "two" / "checkpoint.npz").exists():
        time.sleep(0.05)
        assert run.poll() is None
    os.kill(int((tmp_path / "tasks").read_text().split()[0]), signal.SIGKILL)
    assert run.wait() == 0
    one, two = (json.loads((tmp_path / x / "optimum.json").read_text()) for x in ("one", "two"))
    for name in ("history", "gait", "speed_m_per_s", "last_population", "sensitivity"):
        assert one[name] == two[name], name
    files = [x.name for x in (tmp_path / "two" / "scores").glob("*/*")]
    assert len(files) == len(list((tmp_path / "one" / "scores").glob("*/*"))) == 3 * 3
