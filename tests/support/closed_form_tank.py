"""A tank whose readings are closed forms of the parameters, for fast tests without the beam."""

from pathlib import Path

import numpy as np

from calibration.experiment_design import information
from calibration.inference import problem
from calibration.inference.problem import TankProblem
from calibration.measurements.records import Record
from calibration.measurements.synthetic import ROBOT, START
from calibration.model.plan import Resolution
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.load import assemble
from slider_jax.experiment.prepare import prepare

MESH = Resolution(11, 20, 1e-2)
NOISE = {"p_front": 700.0, "p_rear": 700.0, "thrust": 0.01, "recoil": 0.01, "tip": 5e-4}


def readings(trial, t, theta):
    """Returns the readings (5, n) of a trial for theta = (C_d, m_a, k, K_Q, ...).

    Drag grows with f, added mass with f squared. Each further parameter adds a tone to the thrust.
    """
    C_d, m_a, k, K_Q, *rest = theta
    f, q = trial.frequency, K_Q / START["K_Q"]
    turn = 2.0 * np.pi * f
    late = turn * (t - trial.phase / f) - np.arctan(turn * k)
    on = turn * t - np.arctan(turn * k)
    size = trial.amplitude / 250e3 / np.sqrt(1.0 + (turn * k) ** 2)
    drag, mass = 0.1 * f * C_d * q**2 * size**2, 0.1 * f**2 * m_a * q * size
    thrust = mass * np.cos(2.0 * on) - drag * np.abs(np.sin(on)) - 0.3 * C_d * trial.tow_speed
    for number, x in enumerate(rest):
        thrust = thrust + 0.3 * x * np.sin((1.0 + 0.37 * number) * turn * t + number)
    return np.stack(
        [
            size * 250e3 * np.sin(on),
            size * 250e3 * trial.rear_ratio * np.sin(late),
            thrust,
            0.3 * mass * np.sin(late) + 0.2 * drag * np.cos(late),
            0.05 * q * size * np.sin(late) / (1.0 + 0.05 * C_d + 0.1 * m_a),
        ]
    )


def predict(plan, theta):
    return readings(plan.trial, plan.at, theta)


def tangents(plan, theta, directions, dtype=float):
    """Returns the derivatives (k, 5, n) by central differences, with the type `dtype`."""
    h = 1e-4 * np.array([3.0, 1.0, 0.08, 4.5e-7] + [1.0] * (len(theta) - 4))
    each = [
        (predict(plan, theta + step) - predict(plan, theta - step)) / (2.0 * step.sum())
        for step in np.diag(h)
    ]
    return np.tensordot(directions, np.stack(each), 1).astype(dtype)


def replace_the_beam(monkeypatch):
    """Replaces the simulation of trials by `readings`."""
    monkeypatch.setattr(information, "predict_readings", predict)
    for module in (problem, information):
        each = lambda pairs: [predict(*pair) for pair in pairs]  # noqa: E731
        monkeypatch.setattr(module, "predict_each", each)
        monkeypatch.setattr(module, "reading_tangents", tangents)


def experiment_of(frequencies, **changes):
    """Returns an experiment with a trial of one second for each frequency."""
    trials = [
        {
            "file": f"trial_{i:02d}.csv", "frequency": f, "amplitude": 250e3, "rear_ratio": 0.9,
            "phase": 0.15, "tow_speed": 0.2 * (i % 2), "duration": 1.0,
        }
        | changes
        for i, f in enumerate(frequencies)
    ]  # fmt: skip
    sensors = {
        "pressure_noise": 700.0,
        "force_noise": 0.01,
        "tip_noise": 5e-4,
        "sample_rate": 250.0,
    }
    content = {"name": "closed", "robot": ROBOT, "parameters": START, "sensors": sensors}
    return assemble(content | {"trials": trials}, "closed", Path("nowhere"))


def measured(experiment, thetas, seed):
    """Returns records of the trials at `thetas`, with noise and a random gain for every channel."""
    rng, found = np.random.default_rng(seed), []
    for trial, theta in zip(experiment.trials, thetas, strict=True):
        t = prepare(experiment, trial).sample_times
        values = np.array(readings(trial, t, theta))
        for row, name in enumerate(SLIDER_CHANNELS):
            values[row] *= 1.0 + SLIDER_CHANNELS[name].gain * rng.normal()
            values[row] += NOISE[name] * rng.normal(size=len(t))
        found.append(Record(trial, t, values, experiment.channels))
    return found


def problem_of(experiment, records, effects=()):
    return TankProblem.of(experiment, records, effects, fine=MESH, coarse=MESH)
