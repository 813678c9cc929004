"""A trial's initial swing counts as noise with the shape that the model gives."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from calibration.inference.noise import Noise, Whitener, channel_noise
from calibration.inference.problem import TankProblem
from calibration.measurements.records import Record
from calibration.model.initial_swing import first_mode, swing_spans
from calibration.model.plan import Resolution, plan_trial
from calibration.model.predict import predict_readings
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import at_rest, with_motion
from slider_jax.experiment.load import load
from slider_jax.experiment.sensor_tables import SensorsTable
from slider_jax.observables import tip
from tests.support.experiments import write_small_experiment

THETA = np.array([3.0, 1.0, 0.087, 4.79e-7])
MESH = Resolution(21, 80, 4e-3)


def planned(folder, **changes):
    experiment = load(write_small_experiment(folder)).with_values(changes)
    trial = experiment.trials[0]
    at = 2e-3 * np.arange(int(trial.duration * 500))
    return experiment, plan_trial(experiment, trial, (), MESH, at)


@eqx.filter_jit
def _swing(model, place, speed, times, numerics, scheme):
    mode = first_mode(model, numerics)

    def change(rows):
        moved = rows.at[..., 2, :].add(place * mode.angle)
        return moved.at[..., 1, :].add(speed * mode.place)

    carry = with_motion(at_rest(model, numerics), change)
    return rollout(model, times, tip, numerics, scheme, begin=carry).saved


def swinging_tip(p, place, speed):
    """Returns the tip (n,) at the steps of a trial with an initial swing."""
    model, times = p.extended.at(jnp.asarray(THETA)), TimeGrid(p.grid.h, p.grid.steps)
    saved = _swing(model, jnp.asarray(place), jnp.asarray(speed), times, p.numerics, p.scheme)
    return np.concatenate([[place], np.asarray(saved)])


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
def test_the_spans_of_the_tip_equal_the_difference_of_simulated_swings(tmp_path, which):
    _, p = planned(tmp_path)
    mode = first_mode(p.extended.at(jnp.asarray(THETA)), p.numerics)
    unit = np.array([1.0, float(mode.frequency)])[which]
    step = np.eye(2)[which] * 1e-5 * unit
    there, back = swinging_tip(p, *step), swinging_tip(p, *-step)
    expected = np.interp(p.at, p.grid.times, (there - back) / 2.0)
    found = swing_spans(p, THETA, 1e-5)[which, 4]
    assert np.abs(found - expected).max() < 0.02 * np.abs(expected).max()


@pytest.mark.slow
def test_a_released_body_swings_at_about_the_modes_frequency(tmp_path):
    """The body has no drive, and quadratic drag hardly damps a small swing."""
    _, p = planned(tmp_path, **{"trials.0.amplitude": 0.0, "trials.0.frequency": 1.0})
    frequency = float(first_mode(p.extended.at(jnp.asarray(THETA)), p.numerics).frequency)
    by_place, by_speed = swing_spans(p, THETA, 1e-3)[:, 4]
    assert by_place[0] == pytest.approx(1e-3) and abs(by_speed[0]) < 1e-9
    quarter = 0.5 * np.pi / frequency
    crosses = p.at[np.argmax(by_place < 0.0)]
    assert crosses == pytest.approx(quarter, rel=0.1)
    assert by_speed.max() == pytest.approx(1e-3, rel=0.1)
    assert p.at[np.argmax(by_speed)] == pytest.approx(quarter, rel=0.2)


def test_whitening_suppresses_a_known_shape_of_unknown_size():
    t = np.arange(400) / 500.0
    shape = np.stack([np.exp(-3 * t) * np.cos(8 * t), np.exp(-3 * t) * np.sin(8 * t)])
    noise, still = Noise(1e-5), 0.0 * t
    series = 2e-4 * (0.7 * shape[0] - shape[1])
    known = Whitener(t, noise, still, spans=2e-4 * shape)(series)
    plain = Whitener(t, noise, still)(series)
    assert np.sum(known**2) < 2.0 < 1e3 < np.sum(plain**2)
    other = Whitener(t, noise, still, spans=2e-4 * shape)(1e-4 * np.cos(40 * t))
    assert np.sum(other**2) > 1e3


@pytest.mark.slow
@pytest.mark.parametrize(("size", "least", "most"), [(0.0, 5.0, np.inf), (1e-3, 0.0, 1.3)])
def test_a_declared_swing_explains_the_residual_of_a_swinging_trial(tmp_path, size, least, most):
    experiment, p = planned(tmp_path, **{"sensors.tip_noise": 5e-5, "sensors.start_swing": size})
    rng, moved = np.random.default_rng(5), predict_readings(p, THETA)
    tip = swinging_tip(p, 8e-4, -4e-3)
    moved[4] = np.interp(p.at, p.grid.times, tip) + 5e-5 * rng.normal(size=len(p.at))
    record = Record(experiment.trials[0], p.at, moved, experiment.channels)
    problem = TankProblem.of(experiment, [record], (), ("tip",), MESH, MESH)
    white = problem.whiteners(problem.predict(THETA))
    (r,) = problem.residuals(problem.predict(THETA), white).values()
    assert least < np.mean(r**2) < most


def test_a_declared_swing_is_the_tare_of_the_tip_only():
    tip = np.random.default_rng(1).normal(size=300)
    sensors = SensorsTable(tip_noise=1e-4, start_swing=3e-4)
    assert channel_noise(sensors, SLIDER_CHANNELS["tip"], tip).tare == 3e-4
    assert channel_noise(sensors, SLIDER_CHANNELS["p_front"], tip).tare == 0.0
