"""A population on one device, on two, and in two processes: the same scores to the last bit."""

import io
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.experiment.load import assemble
from slider_jax.io.files import read_with_digest
from slider_jax.optimise.design_space import gait_bounds, models
from slider_jax.optimise.population import CHUNK, Evaluation
from slider_jax.swimming.paper_optimum import swimmer_content
from slider_jax.swimming.steady_state import SteadySettings, find_steady
from tests.support.data import ROOT

pytestmark = pytest.mark.optimised

CODE = """
import os, sys, time
from slider_jax.precision import enable_float64
from slider_jax.optimise.population import Evaluation, start_devices
enable_float64()
cores, coordinator, processes, process, out = sys.argv[1:]
start_devices(int(cores), coordinator, int(processes), int(process))
import jax, numpy as np
import jax.numpy as jnp
from tests.slider_jax.optimise.test_population import MEMBERS, OBJECTIVES
objective = OBJECTIVES[os.environ["OBJECTIVE"]]()
assert len(jax.devices()) == max(2, int(cores)) * int(processes), jax.devices()
time.sleep(float(os.environ.get("LATE", "0")))
np.save(out, Evaluation(objective)(MEMBERS))
"""
MEMBERS = np.random.default_rng(0).uniform(size=(37, 6))


def waves(x):
    """A number that takes a loop whose length is the member's own."""

    def on(state):
        return state[1] > 1e-3

    def step(state):
        return state[0] + jnp.sin(7.0 * state[0]) * state[1], state[1] * (0.5 + 0.4 * x[0])

    return jax.lax.while_loop(on, step, (jnp.sum(jnp.cos(3.0 * x)), jnp.ones(())))[0]


def coarse_swimmer():
    content = swimmer_content(frequency=5.0, amplitude=365e3)
    numerics = {"nodes": 17, "step": 0.004}
    experiment = assemble(content | {"numerics": numerics}, "coarse", Path("."))
    search = SteadySettings(
        settling=2, corrections=2, steps_per_stride=48, numerics=Numerics(4, 12)
    )
    speed = models(experiment)

    def swum(x):
        gait = gait_bounds({}).gait(x)
        return find_steady(speed(gait), gait.frequency, search).speed

    return swum


OBJECTIVES = {"waves": lambda: waves, "robot": coarse_swimmer}


def test_scores_are_in_the_order_of_the_individuals():
    found = Evaluation(waves)(MEMBERS)
    np.testing.assert_allclose(found, [jax.jit(waves)(x) for x in MEMBERS], rtol=1e-12)
    few = Evaluation(waves)(MEMBERS[: CHUNK - 3])
    np.testing.assert_array_equal(few, found[: CHUNK - 3])


def started(cores, out, coordinator="", processes=1, process=0, late=0.0, objective="waves"):
    words = [str(x) for x in (cores, coordinator, processes, process, out)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu", "LATE": str(late)}
    environment["OBJECTIVE"] = objective
    return subprocess.Popen([sys.executable, "-c", CODE, *words], env=environment, cwd=ROOT)


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.slow
def test_two_devices_give_the_same_scores_as_one(tmp_path: Path, processes):
    cores = 2 // processes
    where = f"127.0.0.1:{free_port()}" if processes > 1 else ""
    outs = [tmp_path / f"{i}.npy" for i in range(processes)]
    runs = [started(cores, out, where, processes, i) for i, out in enumerate(outs)]
    assert [run.wait(timeout=120) for run in runs] == [0] * processes
    for out in outs:
        np.testing.assert_array_equal(np.load(out), Evaluation(waves)(MEMBERS))


@pytest.mark.slow
def test_a_swimmer_is_as_fast_on_one_core_as_on_two_and_in_two_processes(tmp_path: Path):
    """To the last bit, or another number of cores would lead a search elsewhere."""
    where = f"127.0.0.1:{free_port()}"
    plans = {"one": (1,), "two": (2,), "first": (1, where, 2, 0), "second": (1, where, 2, 1)}
    outs = {name: tmp_path / f"{name}.npy" for name in plans}
    runs = [
        started(plan[0], outs[name], *plan[1:], objective="robot") for name, plan in plans.items()
    ]
    assert [run.wait(timeout=500) for run in runs] == [0] * len(runs)
    one, *others = (np.load(out) for out in outs.values())
    assert np.isfinite(one).sum() > 0.5 * len(MEMBERS)
    for other in others:
        np.testing.assert_array_equal(one, other)


SHARING = """
import json, sys
from pathlib import Path
from slider_jax.precision import enable_float64
from slider_jax.optimise.population import Evaluation, shared_by_folder, start_devices
enable_float64()
start_devices(1)
from slider_jax.optimise.loop import run_optimiser
from slider_jax.optimise.optimiser import genetic
from tests.slider_jax.optimise.test_population import waves
folder, log = map(Path, sys.argv[1:])

class Logged(Evaluation):
    def __call__(self, population):
        with log.open("a") as file:
            file.write(population.tobytes().hex() + "\\n")
        return super().__call__(population)

evaluate = shared_by_folder(Logged(waves), folder, {"objective": "waves"})
run_optimiser(genetic(72, 6), lambda x, _: (evaluate(x), None), 4, 0, {}, folder, True)
"""


def test_two_processes_share_the_generations_of_a_search(tmp_path: Path):
    """As two tasks of a SLURM job: no individual twice, and the same bits as one process."""

    def tasks(name, count):
        (tmp_path / name).mkdir()
        logs = [tmp_path / f"{name}_{i}" for i in range(count)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "SLURM_NTASKS": str(count)}
        runs = [
            subprocess.Popen(
                [sys.executable, "-c", SHARING, str(tmp_path / name), str(log)],
                env=environment | {"SLURM_PROCID": str(i), "SLURM_STEP_NUM_TASKS": str(count)},
                cwd=ROOT,
            )
            for i, log in enumerate(logs)
        ]
        assert [run.wait(timeout=200) for run in runs] == [0] * count
        return [x for log in logs if log.exists() for x in log.read_text().splitlines()]

    one, two = tasks("one", 1), tasks("two", 2)
    assert len(two) == len(set(two)) == 4 * 5  # parts of 16 individuals in four generations
    assert sorted(one) == sorted(two)
    alone, shared = (np.load(_content(tmp_path / x / "checkpoint.npz")) for x in ("one", "two"))
    for key in alone.files:
        np.testing.assert_array_equal(alone[key], shared[key])


def _content(path: Path):
    return io.BytesIO(read_with_digest(path))


@pytest.mark.slow
def test_a_process_waits_for_one_that_is_late(tmp_path: Path):
    """By more than the 30 s that a collective waits."""
    where = f"127.0.0.1:{free_port()}"
    outs = [tmp_path / f"{i}.npy" for i in range(2)]
    runs = [started(1, out, where, 2, i, late=45.0 * i) for i, out in enumerate(outs)]
    assert [run.wait(timeout=200) for run in runs] == [0, 0]
    np.testing.assert_array_equal(np.load(outs[0]), np.load(outs[1]))
