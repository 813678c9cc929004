"""How the tested trials judge a learned function."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.discrepancy.rounds import Growth
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.inference.gauss_newton import Fit
from calibration.inference.goodness import Excess, excess_removed
from calibration.inference.noise import channel_noise
from calibration.learning import learn
from calibration.learning.learn import Learning
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.sensor_tables import SensorsTable

FIT = Fit(np.zeros(1), np.array([0]), 0.0, 100, [], [0.0], True)


def conclude(monkeypatch, after, mean_square):
    """Returns the learning after the test of a function.

    The pressure's error is 5 times its noise floor without the function, and `after` times its
    noise floor with it. `mean_square` is the mean square of its whitened residual.
    """
    record = SimpleNamespace(trial=SimpleNamespace(file="a.csv"))
    problem = SimpleNamespace(
        discrepancies={"p_front": 0.002}, records=[record], predict=lambda theta: "predicted"
    )
    problem.part = lambda chosen: problem
    errors = {"p_front": {"before": 500.0, "after": 100.0 * after, "floor": 100.0}}
    monkeypatch.setattr(learn, "TankProblem", SimpleNamespace)
    for name, value in {
        "relative_changes": {"p_front": 0.1},
        "tested_excess": {"p_front": Excess(np.array([mean_square]), mean_square)},
        "growth_of_error": Growth(-0.01, 0.01),
        "channel_errors": errors,
        "widen_by_correlation": FIT,
    }.items():
        monkeypatch.setattr(learn, name, lambda *given, value=value: value)
    outcome = SimpleNamespace(
        held=[1],
        used_trials=[0],
        problem=problem,
        chosen=FIT,
        search=SimpleNamespace(settings=DEFAULT_SETTINGS),
    )
    entries = [SimpleNamespace(effect="flow_of_pressure")]
    known = SimpleNamespace(problem=problem, start=FIT, entries=entries, outcome=outcome)
    found = Learning(outcome)
    learn._conclude(found, known, FIT, ["flow_of_pressure"], {}, lambda text: None)
    return found


@pytest.mark.parametrize(("after", "kept"), [(4.9, False), (4.1, False), (3.9, True), (1.0, True)])
def test_a_function_above_the_noise_floor_has_to_remove_a_fifth_of_the_excess_error(
    monkeypatch, after, kept
):
    found = conclude(monkeypatch, after, mean_square=9.0)
    assert (found.model is not None) == kept
    too_little = "the function removes less than 20 % of the rms error above the noise floor"
    assert found.reason == ("" if kept else too_little)


def test_a_function_that_reaches_the_noise_floor_is_kept(monkeypatch):
    found = conclude(monkeypatch, 4.9, mean_square=1.0)
    assert found.model is not None and not found.reason


def test_the_removed_excess_weights_channels_by_their_noise_floors():
    pressure = {"before": 500.0, "after": 100.0, "floor": 100.0}
    tip = {"before": 5e-4, "after": 5e-4, "floor": 1e-4}
    assert excess_removed({"p_front": pressure}) == 1.0
    assert excess_removed({"tip": tip}) == 0.0
    both = excess_removed({"p_front": pressure, "tip": tip})
    assert both == pytest.approx(1.0 - np.sqrt(0.5))


def test_a_channel_without_noise_has_an_excess_error_too():
    floor = channel_noise(SensorsTable(), SLIDER_CHANNELS["p_front"], np.zeros(100)).white
    exact = {"before": 500.0, "after": 100.0, "floor": floor}
    constant = {"before": 0.0, "after": 0.0, "floor": floor}
    assert excess_removed({"p_front": exact}) == pytest.approx(0.8)
    assert excess_removed({"p_front": exact, "tip": constant}) == pytest.approx(0.8)


def test_no_excess_error_can_be_removed_at_the_noise_floor():
    assert excess_removed({"tip": {"before": 1e-4, "after": 2e-4, "floor": 1e-4}}) is None
