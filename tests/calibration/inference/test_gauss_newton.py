"""Convergence of the Gauss-Newton fit on a curve, compared with SciPy's optimum."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from calibration.inference.gauss_newton import (
    FRESH_DISTANCE,
    STALLED,
    derivatives_of_fit,
    fit_gauss_newton,
)
from calibration.inference.problem import FAILED
from calibration.model.extended import Parameter
from slider_jax.effects import Prior

T = np.linspace(0.0, 4.0, 10_000)
TRUTH = np.array([2.0, 0.8])
ENTRIES = [Parameter("", n, Prior(0.0, 0.0, 10.0, "-", "")) for n in ("a", "k")]


def curve(theta):
    return theta[0] * np.exp(-theta[1] * T)


class Curve:
    """A problem with noise of unit variance and a sine of amplitude `lack` outside the model."""

    def __init__(self, lack=0.0):
        rng = np.random.default_rng(0)
        self.y = curve(TRUTH) + rng.normal(size=len(T)) + lack * np.sin(9.0 * T)
        self.simulated = 0

    def predict(self, theta):
        self.simulated += 1
        return [curve(theta)]

    def tangents(self, theta, directions):
        J = np.stack([np.exp(-theta[1] * T), -T * curve(theta)])
        return [directions @ J]

    def whiteners(self, predicted):
        return {}

    def residuals(self, predicted, white):
        return {(0, "y"): self.y - predicted[0]}

    def whitened(self, changes, white, in_place=False):
        return {(0, "y"): changes[0]}


@pytest.mark.parametrize(("lack", "share"), [(0.0, 0.15), (5.0, 0.15), (8.0, 0.72)])
def test_a_fit_ends_within_a_share_of_a_standard_error(lack, share):
    """The share is a seventh, or two thirds if the residual is many times the noise."""
    problem = Curve(lack)
    found = fit_gauss_newton(problem, ENTRIES, np.array([3.5, 2.0]), np.arange(2))
    best = least_squares(lambda x: curve(x) - problem.y, TRUTH, xtol=1e-14, gtol=1e-14)
    error = np.sqrt(np.diag(found.covariance))
    assert found.converged
    assert np.all(np.abs(found.theta - best.x) < share * error)
    assert problem.simulated < 12


def test_a_fit_that_moves_little_ends_with_the_derivatives_of_its_start():
    problem, computed = Curve(), []
    best = fit_gauss_newton(problem, ENTRIES, np.array([3.5, 2.0]), np.arange(2))
    problem.tangents = lambda theta, d: computed.append(theta) or Curve.tangents(problem, theta, d)
    start = best.theta + np.array([0.0, 0.2 / np.sqrt(np.linalg.inv(best.covariance)[1, 1])])
    found = fit_gauss_newton(problem, ENTRIES, start, np.arange(2))
    assert found.converged and np.any(found.theta != start)
    derivatives_of_fit(problem, ENTRIES, found)
    np.testing.assert_array_equal(computed, [start, start])


def test_derivatives_far_from_the_end_of_a_fit_are_computed_again():
    problem, computed = Curve(), []
    problem.tangents = lambda theta, d: computed.append(theta) or Curve.tangents(problem, theta, d)
    found = fit_gauss_newton(problem, ENTRIES, np.array([3.5, 2.0]), np.arange(2))
    derivatives_of_fit(problem, ENTRIES, found)
    step = found.theta - computed[-1]
    assert step @ np.linalg.inv(found.covariance) @ step < FRESH_DISTANCE**2


class Wall(Curve):
    """A curve that cannot be simulated for k > 1."""

    beyond = 0

    def predict(self, theta):
        (y,) = super().predict(theta)
        self.beyond += theta[1] > 1.0
        return [np.full_like(y, np.nan) if theta[1] > 1.0 else y]


def test_a_step_that_cannot_be_simulated_is_shortened():
    problem = Wall()
    found = fit_gauss_newton(problem, ENTRIES, np.array([0.3, 0.3]), np.arange(2))
    assert problem.beyond and found.converged
    np.testing.assert_allclose(found.theta, TRUTH, rtol=0.1)


def test_a_start_that_cannot_be_simulated_does_not_converge_and_raises_nothing():
    found = fit_gauss_newton(Wall(), ENTRIES, np.array([1.0, 1.2]), np.arange(2))
    assert not found.converged and found.square >= FAILED


def test_a_fit_without_finite_tangents_does_not_converge():
    problem = Curve()
    problem.tangents = lambda theta, directions: [np.full((2, len(T)), np.nan)]
    found = fit_gauss_newton(problem, ENTRIES, TRUTH, np.arange(2))
    assert not found.converged and np.isinf(found.covariance).all()


def test_a_fit_without_an_improving_step_does_not_converge(monkeypatch):
    monkeypatch.setattr(
        "calibration.inference.gauss_newton.linear_optimum", lambda A, b, start, bounds: start - 0.5
    )
    assert not fit_gauss_newton(Curve(), ENTRIES, np.array([1.0, 0.9]), np.arange(2)).converged


def test_a_fit_ends_when_its_steps_gain_nothing():
    """Tangents that are too large by a factor of 1e7 predict a large gain and give tiny steps."""
    problem = Curve()
    exact = problem.tangents
    problem.tangents = lambda theta, directions: [1e7 * exact(theta, directions)[0]]
    found = fit_gauss_newton(problem, ENTRIES, np.array([1.0, 0.9]), np.arange(2))
    assert not found.converged and problem.simulated == 1 + STALLED


class Biased(Curve):
    """A curve whose optimum seems to be `bias` standard errors beyond the true optimum.

    The sign of the error changes with each computation of the derivatives.
    """

    def __init__(self, bias):
        super().__init__()
        best = least_squares(lambda x: curve(x) - self.y, TRUTH, xtol=1e-14, gtol=1e-14)
        self.best, self.computed, self.J = best.x, 0, []
        A = best.jac.T @ best.jac
        self.error = np.sqrt(np.linalg.inv(A)[1, 1])
        self.direction = np.linalg.inv(A)[1] / self.error  # one standard error of k
        residual = self.y - curve(best.x)
        self.bias = bias / self.error * residual / (residual @ residual)

    def tangents(self, theta, directions):
        (J,) = super().tangents(theta, directions)
        self.computed += 1
        self.J = J - (-1.0) ** self.computed * np.outer(directions[:, 1], self.bias)
        return [self.J]


def test_a_fit_ends_at_the_optimum_if_its_derivatives_predict_a_small_gain():
    problem = Biased(0.25)  # the predicted gain is 0.06, and shorter steps are not tried
    found = fit_gauss_newton(problem, ENTRIES, problem.best, np.arange(2))
    assert found.converged and problem.simulated == 2
    np.testing.assert_array_equal(found.theta, problem.best)
    derivatives_of_fit(problem, ENTRIES, found)
    assert problem.computed == 2  # at the start of the fit, whose derivatives a cache contains
    np.testing.assert_array_equal(found.linearised_at, problem.best)


def test_a_step_with_new_derivatives_that_gains_too_little_is_not_repeated():
    """The first step has the predicted gain 0.34 and the gain 0.012."""
    problem = Biased(0.28)
    start = problem.best - 0.3 * problem.direction
    found = fit_gauss_newton(problem, ENTRIES, start, np.arange(2))
    assert found.converged and problem.simulated == 2 and problem.computed == 2
    beyond = (found.theta - problem.best) @ np.linalg.inv(found.covariance) @ problem.direction
    assert beyond == pytest.approx(0.28, abs=0.02)
    # The step is too long for the derivatives of the start: the result contains new derivatives.
    np.testing.assert_allclose(found.blocks[0].A, problem.J @ problem.J.T)
