"""A small simulated tank and a coarse mesh; the loop's tests share the compiled programs."""

from calibration.discrepancy.close_loop import close_loop_on_trials
from calibration.measurements.synthetic import Truth, random_trials, write_tank
from calibration.model.plan import Resolution
from slider_jax.experiment.load import load

CANDIDATES = ("valve_delay", "clamp_compliance", "force_gain")
OF_ONE_BODY = ("valve_delay", "force_gain")
"""Candidates that leave the program of robot and water as it is."""

BASE = {"C_d": 3.2, "m_a": 0.6, "k": 0.08, "K_Q": 4.6e-7}

TANK = {"nodes": 13, "step": 2e-3, "scheme": "sdirk2"}

RUNS = [run | {"duration": 0.5} for run in random_trials(3, count=6)[2:]] + [
    run | {"duration": 0.5, "file": f"again_{i}.csv"}
    for i, run in enumerate(random_trials(4, count=6)[4:])
]

MESH = Resolution(13, 40, 6.0e-3)
"""Mesh of residuals and tangents; the tank is simulated with another step."""


NULLS = {"valve_delay": {"delay": 0.0}, "stiffening": {"beta": 0.0}}
"""Every tank contains these effects, so one compiled program simulates all tanks."""


def close_small_tank(folder, effects, seed=0, candidates=CANDIDATES):
    path = write_tank(folder, Truth(BASE, NULLS | effects), RUNS, seed, numerics=TANK)
    return close_loop_on_trials(load(path), candidates, fine=MESH, coarse=MESH)
