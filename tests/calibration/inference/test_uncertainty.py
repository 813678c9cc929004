"""Hausman's test: the forces' means against their variation."""

from dataclasses import dataclass

import numpy as np
import pytest

from calibration.inference.gauss_newton import fit_gauss_newton
from calibration.inference.noise import Noise
from calibration.inference.problem import AbstractProblem
from calibration.inference.uncertainty import confidence_interval, hausman_check
from calibration.measurements.records import Record
from calibration.model.extended import Parameter
from calibration.reporting.parameters import parameter_record, parameter_text
from slider_jax.effects import Prior
from slider_jax.experiment.schema import Trial

T = np.arange(0.0, 2.0, 0.01)
TARE, TRIALS = 0.02, 8
ENTRIES = [Parameter("drag", "a", Prior(0.0, 0.0, 4.0, "-", ""))]


def force(mean, varying):
    values = np.zeros((5, len(T)))
    values[2] = mean + 0.3 * varying * np.sin(2.0 * np.pi * T)
    return values


@dataclass(frozen=True)
class Drag(AbstractProblem):
    """thrust = a (1 + 0.3 sin)."""

    def _predict(self, theta):
        return [force(theta[0], theta[0])] * TRIALS

    def _tangents(self, theta, directions):
        return [directions[0, 0] * force(1.0, 1.0)[None]] * TRIALS

    def _coarse(self, thetas):
        return [np.stack(x) for x in zip(*(self._predict(t) for t in thetas), strict=True)]

    def spans(self):
        return None


def fitted(seed: int, varying: float):
    """Returns the tested fit to data with a = 1 in the mean and a = `varying` in the variation."""
    rng = np.random.default_rng(seed)
    trial = Trial.model_validate(
        {"file": "a.csv", "frequency": 1.0, "amplitude": 1e5, "duration": 2.0}
    )
    shown = np.array([False, False, True, False, False])[:, None]
    found = []
    for _ in range(TRIALS):
        noise = rng.normal(0.0, TARE) + rng.normal(0.0, 0.05, len(T))
        found.append(Record(trial, T, np.where(shown, force(1.0, varying) + noise, np.nan)))
    noise = {(i, "thrust"): Noise(0.05, tare=TARE) for i in range(TRIALS)}
    problem = Drag(records=found, channels=("thrust",), noise=noise)
    fit = fit_gauss_newton(problem, ENTRIES, np.array([1.0]), np.arange(1))
    return hausman_check(problem, ENTRIES, fit)


def test_consistent_data_do_not_widen_the_interval():
    found = [fitted(seed, 1.0) for seed in range(20)]
    widened = [float(f.widening[0]) for f in found if f.difference[0] != 0.0]
    assert all((f.widening[0] > 1.0) == (f.difference[0] != 0.0) for f in found)
    assert len(widened) <= 3 and all(x < 3.5 for x in widened)


@pytest.mark.parametrize("varying", [0.6, 1.4])
def test_a_disagreement_is_recorded_and_widens_the_interval(varying):
    found = fitted(0, varying)
    value, low, high = confidence_interval(found, ENTRIES, 0)
    assert found.difference[0] + value == pytest.approx(varying, abs=0.06)
    assert found.widening[0] > 3.0 and low < 1.0 < high
    narrow = found._replace(difference=None, widening=1.0)
    record = parameter_record(found, ENTRIES, 0)
    assert record["by_variation_alone"] == pytest.approx(varying, abs=0.06)
    assert "without the mean forces" in parameter_text(record)
    assert "forces" not in parameter_text(parameter_record(narrow, ENTRIES, 0))
    assert high - low > 2.0 * np.diff(confidence_interval(narrow, ENTRIES, 0)[1:])[0]
