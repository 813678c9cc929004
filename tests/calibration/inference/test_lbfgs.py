"""L-BFGS and Gauss-Newton return the same optimum."""

import numpy as np
import pytest

from calibration.audit.audit import Audited
from calibration.identification import identify
from calibration.inference import lbfgs
from calibration.inference.gauss_newton import fit_gauss_newton
from calibration.inference.lbfgs import fit_lbfgs
from calibration.inference.problem import TankProblem
from calibration.measurements.records import load_records
from calibration.measurements.synthetic import START, Truth, random_trials, write_tank
from calibration.model.extended import base_vector, model_parameters
from calibration.model.plan import Resolution
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from tests.support import closed_form_tank as closed

pytestmark = pytest.mark.optimised

MESH = Resolution(21, 60, 3.0e-3)
TANK = {"nodes": 21, "step": 2e-3, "scheme": "sdirk2"}
TRUTH = {"C_d": 3.0, "m_a": 0.8, "k": 0.075, "K_Q": 4.5e-7}
MANY = ("leakage", "tangential_friction", "camera_scale", "force_gain", "tail_drag",
        "linear_drag", "tip_mass", "tank_current")  # fmt: skip


def difference(one, two):
    """Returns the difference of two fits in standard errors, for each entry."""
    return np.abs(one.theta - two.theta)[one.free] / np.sqrt(np.diag(one.covariance))


@pytest.mark.parametrize("effects", [(), pytest.param(MANY, marks=pytest.mark.slow)])
def test_both_methods_return_the_same_optimum(monkeypatch, effects):
    """From a distant start with 4 or 12 parameters, they agree within 0.1 standard errors."""
    closed.replace_the_beam(monkeypatch)
    experiment = closed.experiment_of((0.8, 1.5, 3.0, 5.0))
    entries = model_parameters(effects)
    truth = base_vector(entries, TRUTH)
    truth[4:] += 0.2 * np.array([p.prior.high - p.prior.low for p in entries[4:]])
    problem = closed.problem_of(experiment, closed.measured(experiment, [truth] * 4, 1), effects)
    initial, free = base_vector(entries, START), np.arange(len(entries))
    white = problem.whiteners(problem.predict(initial))
    one = fit_gauss_newton(problem, entries, initial, free, white=white)
    two = fit_lbfgs(problem, entries, initial, free, white=white)
    assert one.converged and two.converged
    assert difference(one, two).max() < 0.1
    assert two.square == pytest.approx(one.square, abs=0.02 * one.inflation)
    assert np.abs(initial - one.theta)[0] > 3.0 * np.sqrt(one.covariance[0, 0])


def test_a_fit_at_the_gradient_limit_does_not_converge(monkeypatch):
    closed.replace_the_beam(monkeypatch)
    monkeypatch.setattr(lbfgs, "MAX_GRADIENTS", 2)
    experiment, entries = closed.experiment_of((0.8, 3.0)), model_parameters(())
    records = closed.measured(experiment, [base_vector(entries, TRUTH)] * 2, 1)
    initial = base_vector(entries, START)
    found = fit_lbfgs(closed.problem_of(experiment, records), entries, initial, np.arange(4))
    assert not found.converged


@pytest.mark.slow
def test_both_methods_return_the_same_optimum_for_the_beam(tmp_path):
    runs = [run | {"duration": 0.8} for run in random_trials(5, count=5)[2:]]
    experiment = load(write_tank(tmp_path, Truth(TRUTH, {}), runs, 0, numerics=TANK))
    entries, free = model_parameters(()), np.arange(4)
    problem = TankProblem.of(experiment, load_records(experiment), (), fine=MESH, coarse=MESH)
    initial = base_vector(entries, START)
    white = problem.whiteners(problem.predict(initial))
    one = fit_gauss_newton(problem, entries, initial, free, white=white)
    two = fit_lbfgs(problem, entries, initial, free, white=white)
    assert one.converged and two.converged
    assert np.all(difference(one, two) < 0.1)


@pytest.mark.parametrize(
    ("effects", "method", "used"),
    [
        ((), "auto", "lm"),
        pytest.param(MANY, "auto", "lbfgs", marks=pytest.mark.slow),
        ((), "lbfgs", "lbfgs"),
        pytest.param(MANY, "lm", "lm", marks=pytest.mark.slow),
    ],
)
def test_lbfgs_is_the_default_for_many_parameters(monkeypatch, effects, method, used):
    closed.replace_the_beam(monkeypatch)
    experiment = closed.experiment_of((0.8, 1.5, 3.0, 5.0))
    truth = base_vector(model_parameters(effects), TRUTH)
    found = closed.measured(experiment, [truth] * 4, 1)
    monkeypatch.setattr(identify, "audit_measurements", lambda *_: Audited(found, []))
    result = identify.identify_parameters(experiment, effects, method=method)
    assert result.method == used and result.fit.converged


def test_an_unknown_method_is_refused():
    with pytest.raises(InputError, match="--method: given 'newton'; allowed auto, lm, lbfgs"):
        identify.identify_parameters(closed.experiment_of((1.0,)), method="newton")
