"""States that a trial visits."""

import numpy as np

from calibration.learning.states import visited_states
from calibration.model.extended import base_values, base_vector, model_parameters
from calibration.model.plan import Resolution, plan_trial
from calibration.model.predict import predict_readings
from slider_jax.effects.library import DICTIONARY
from slider_jax.experiment import load as experiment
from tests.support.data import ROOT

K, AMPLITUDE = 0.075, 2e5


def visited(duration, names):
    """Returns a trial's plan, predicted readings, and visited states of the terms `names`."""
    given = experiment.load(ROOT / "docs" / "experiment.toml")
    changes = {"frequency": 2.0, "amplitude": AMPLITUDE, "duration": duration}
    trial = given.with_values({f"trials.0.{k}": v for k, v in changes.items()})
    at = 2e-3 * np.arange(1, round(duration / 2e-3))
    p = plan_trial(trial, trial.trials[0], (), Resolution(11, 40, 5e-3), at)
    theta = base_vector(model_parameters(()), base_values(trial) | {"k": K})
    readings, terms = predict_readings(p, theta), {n: DICTIONARY[n]() for n in names}
    return p, readings, visited_states(p, p.extended.at(theta), readings, terms)


def test_the_states_of_each_kind_have_the_times_and_cells_of_the_trial():
    names = ("flow_of_pressure", "tip_reading_powers_by_sign", "moment_of_body", "moment_of_tail")
    p, readings, found = visited(1.0, names)  # several blocks of steps
    steps, tip = p.grid.steps, readings[list(p.extended.channels).index("tip")]
    assert found["flow_of_pressure"][""].size == 2 * steps
    reading = found["tip_reading_powers_by_sign"][""]
    np.testing.assert_allclose(reading / np.abs(reading).max(), tip / np.abs(tip).max(), atol=1e-9)
    body, tail = (found[n][""].reshape(steps, -1) for n in ("moment_of_body", "moment_of_tail"))
    assert body.shape[1] + tail.shape[1] == p.numerics.tail_cells + p.numerics.body_cells
    assert min(np.abs(x[-1]).max() for x in (body, tail)) > 0.0


def test_the_visited_pressures_are_the_step_response_of_the_lag():
    names = ("flow_of_pressure", "flow_of_difference")
    for duration in (0.1, 0.2):  # trials of different lengths use the same program
        p, _, found = visited(duration, names)
        expected = AMPLITUDE * (1.0 - np.exp(-np.asarray(p.grid.times[1:]) / K))
        front = found["flow_of_pressure"][""].reshape(p.grid.steps, 2)[:, 0]
        difference = found["flow_of_difference"][""].reshape(p.grid.steps, 2)[:, 0]
        np.testing.assert_allclose(front, expected, atol=1e-6)
        np.testing.assert_allclose(difference, AMPLITUDE - expected, atol=1e-6)
