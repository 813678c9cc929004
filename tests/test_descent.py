"""L-BFGS finds what Levenberg and Marquardt find, by gradients alone."""

import numpy as np
import pytest

from calibration.descent import descend
from calibration.evidence import Problem
from calibration.fit import fit
from calibration.forward import Resolution
from calibration.identify import identify
from calibration.measured import records
from calibration.plant import parameters, start
from calibration.synthetic import START, Truth, trials, write_tank
from slider_jax.errors import InputError
from slider_jax.experiment import load

MESH = Resolution(21, 60, 3.0e-3)
TANK = {"nodes": 21, "step": 2e-3, "scheme": "sdirk2"}
TRUTH = {"C_d": 3.0, "m_a": 0.8, "k": 0.075, "K_Q": 4.5e-7}


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    runs = [run | {"duration": 0.8} for run in trials(5, count=5)[2:]]
    return load(
        write_tank(tmp_path_factory.mktemp("tank"), Truth(TRUTH, {}), runs, 0, numerics=TANK)
    )


def test_both_methods_find_the_same_optimum(experiment):
    """From the same far start, with the same noise: within 0.1 standard errors."""
    entries = parameters(())
    problem = Problem.of(experiment, records(experiment), (), fine=MESH, coarse=MESH)
    begun, free = start(entries, START), np.arange(4)
    white = problem.whiteners(problem.predict(begun))
    one = fit(problem, entries, begun, free, white=white)
    two = descend(problem, entries, begun, free, white=white)
    error = np.sqrt(np.diag(one.covariance))
    apart = np.abs(one.theta - two.theta) / error
    print("standard errors apart", apart, "squares", one.square, two.square)
    assert one.converged and two.converged
    assert np.all(np.abs(begun - one.theta) > 3.0 * error)
    assert np.all(apart < 0.1)
    assert two.square == pytest.approx(one.square, abs=0.02 * one.inflation)


def test_an_unknown_method_is_refused(experiment):
    with pytest.raises(InputError, match="--method newton: unknown; allowed auto, lm, lbfgs"):
        identify(experiment, method="newton")
