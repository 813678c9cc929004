"""The pursuit of dictionary terms on sums of known series."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.discrepancy.refits import Refits
from calibration.discrepancy.rounds import Agreement, agreement
from calibration.discrepancy.scores import Score
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.inference.gauss_newton import Fit, fit_gauss_newton
from calibration.inference.problem import ChannelBlock, total
from calibration.learning import pursuit
from calibration.learning.pursuit import Stability, in_selection, place_gains, stability
from calibration.model.extended import Parameter
from slider_jax.effects import Prior
from tests.support.sums import TRIALS, Sums

SHAPES = np.random.default_rng(2).normal(size=(7, TRIALS, 300))
"""Readings per unit of the base parameter and of six parameters in three groups."""
ENTRIES = [Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", ""))] + [
    Parameter("term", str(i), Prior(0.0, -50.0, 50.0, "-", "")) for i in range(6)
]
PLACES = {
    "Flow": {"first": np.array([1, 2]), "second": np.array([3])},
    "ForceDensity": {"third": np.array([4, 5, 6])},
}


def found(truth, seed=0, shapes=SHAPES, kind=Sums):
    problem = kind(truth, shapes, seed=seed)
    start = fit_gauss_newton(problem, ENTRIES, np.zeros(7), np.array([0]))
    residuals = problem.residuals(start.predicted, {})
    assert np.isclose(total(residuals), start.square)
    refits = Refits(problem, ENTRIES, {}, lambda text: None, DEFAULT_SETTINGS)
    J = problem.whitened(problem.tangents(start.theta, np.eye(7)), {})
    return place_gains(refits, start, PLACES, J)


def test_the_pursuit_finds_the_groups_and_the_place():
    best, other = found([1.0, 0.5, -0.3, 0.4, 0.0, 0.0, 0.0])
    assert best.place == "Flow" and best.groups == ["first", "second"]
    np.testing.assert_allclose(best.fit.theta, [1.0, 0.5, -0.3, 0.4, 0.0, 0.0, 0.0], atol=0.02)
    assert (other.place, other.groups, other.gain) == ("ForceDensity", [], 0.0)


def test_a_group_that_the_base_parameter_can_absorb_is_not_found():
    shapes = SHAPES.copy()
    shapes[3] = shapes[0]
    assert not any(x.groups for x in found([1.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0], shapes=shapes))


def test_a_group_that_is_nearly_parallel_to_the_base_parameter_is_found():
    """Only a tenth of its readings is orthogonal to those of the base parameter."""
    shapes = SHAPES.copy()
    shapes[3] = shapes[0] + 0.1 * SHAPES[3]
    best, _ = found([1.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0], shapes=shapes)
    assert best.groups == ["second"]


class Turning(Sums):
    """The readings grow with the parameter x of the group "second" as x + 5 x^2 up to x = 1."""

    def _sum(self, theta):
        moved, x = np.array(theta, float), theta[3]
        moved[3] = x + 5.0 * x**2 if x < 1.0 else 26.0 - 20.0 * x
        return super()._sum(moved)


def test_a_group_is_found_although_the_linear_step_is_far_too_long(monkeypatch):
    """The linear step to the truth of 0.5 is 1.75."""
    truth = [1.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
    (best, _) = found(truth, kind=Turning)
    assert best.groups == ["second"] and np.isclose(best.fit.theta[3], 0.5, atol=0.02)
    monkeypatch.setattr(pursuit, "START_SHARES", (1.0,))
    assert "second" not in found(truth, kind=Turning)[0].groups


def test_noise_alone_has_no_group(monkeypatch):
    """Each experiment adds a group with the declared probability of at most 0.001."""
    monkeypatch.setattr(pursuit, "agreement", lambda left_out: Agreement(np.inf, 0.0))
    assert not any(x.groups for seed in range(100) for x in found([1.0] + 6 * [0.0], seed))


def test_the_halves_are_alternate_quarters_of_a_trial():
    record = SimpleNamespace(t=np.arange(8) / 4.0, trial=SimpleNamespace(duration=2.0))
    assert in_selection(record).tolist() == 2 * [True, True, False, False]


def block(trial, A, b):
    return ChannelBlock(trial, "tip", np.array(A), np.array(b), 0.0, 100)


def fit_of(blocks, values):
    return Fit(np.array(values), np.arange(len(values)), 0.0, 300, blocks, [], True)


@pytest.mark.parametrize(("pull", "confirmed"), [(1.0, True), (30.0, False)])
def test_a_group_that_one_trial_determines_is_not_confirmed(pull, confirmed):
    """The first trial pulls the coefficient by `pull`/300, and the other trials pull it back."""
    A = [[100.0, 0.0], [0.0, 150.0]]
    blocks = [block(0, A, [0.0, pull])] + [block(i, A, [0.0, -0.5 * pull]) for i in (1, 2)]
    x = stability(fit_of(blocks, [1.0, 0.15]), np.array([1]), 1)
    assert x.change == pytest.approx(pull / 300.0 / 0.15)
    assert x.confirmed == confirmed and x.p < 0.01


def test_a_group_without_a_significant_gain_is_not_confirmed():
    assert not Stability(0.02, 0.0).confirmed
    blocks = [block(i, [[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0]) for i in range(3)]
    assert stability(fit_of(blocks, [1.0, 1.0]), np.array([1]), 1).p > 0.05


def test_the_fit_without_a_group_is_the_start():
    (best, *_) = found([1.0] + 6 * [0.0])
    assert isinstance(best.fit, Fit) and list(best.fit.free) == [0]


@pytest.mark.parametrize(("loss", "confirmed"), [(-40.0, True), (-150.0, False)])
def test_a_group_may_increase_the_error_of_a_trial_a_little(loss, confirmed):
    """The gains without the best trial are 180, and all gains are 980."""
    gains = np.array([loss, 30.0, 50.0, 100.0, 800.0])
    x = Score("one", 1e3, 0.0, np.zeros(1), np.array([-0.5, 0.01, 0.02, 0.05, 0.3]), gains)
    assert not agreement(x.left_out, gains).agreed()
    assert pursuit._predicts(x, DEFAULT_SETTINGS) == confirmed
