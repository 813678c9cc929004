"""Hausman's test, intervals for correlated residuals, and parameters that change between trials."""

from dataclasses import dataclass, fields

import numpy as np
import pytest

from calibration.inference.gauss_newton import Fit, fit_gauss_newton
from calibration.inference.noise import Noise
from calibration.inference.problem import AbstractProblem, ChannelBlock, summed
from calibration.inference.uncertainty import (
    EFFECT_DISCREPANCY,
    confidence_interval,
    hausman_check,
    includes_null,
    shift_by_discrepancy,
    unstable_parameters,
    widen_by_correlation,
)
from calibration.measurements.records import Record
from calibration.model.extended import Parameter
from calibration.reporting.parameters import parameter_record, parameter_text
from slider_jax.channels import SLIDER_CHANNELS
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


def fitted(*given, **named):
    """Returns the tested fit of `fitted_problem`."""
    return fitted_problem(*given, **named)[0]


def fitted_problem(seed: int, varying: float = 1.0, late: float = 1.0, rho: float = 0.0, tare=TARE):
    """Returns the tested fit, the problem and the fit, without its tests.

    The data have a = 1 in the mean and a = `varying` in the variation. In the second half of the
    trials, the force is multiplied by `late`. The noise of neighbouring samples has the correlation
    `rho`.
    """
    rng = np.random.default_rng(seed)
    trial = Trial.model_validate(
        {"file": "a.csv", "frequency": 1.0, "amplitude": 1e5, "duration": 2.0}
    )
    shown = np.array([False, False, True, False, False])[:, None]
    found = []
    for number in range(TRIALS):
        noise = rng.normal(0.0, tare) + correlated(rng, rho)
        size = late if 2 * number >= TRIALS else 1.0
        own = trial.model_copy(update={"file": f"{number}.csv"})
        values = np.where(shown, size * force(1.0, varying) + noise, np.nan)
        found.append(Record(own, T, values, SLIDER_CHANNELS))
    noise = {(i, "thrust"): Noise(0.05, tare=tare) for i in range(TRIALS)}
    problem = Drag(records=found, channels=("thrust",), noise=noise)
    fit = fit_gauss_newton(problem, ENTRIES, np.array([1.0]), np.arange(1))
    tested = widen_by_correlation(problem, hausman_check(problem, ENTRIES, fit))
    return tested, problem, fit


@dataclass(frozen=True)
class MeshedDrag(Drag):
    """The coarse mesh adds sines of 1 and 2 Hz to the thrust."""

    @property
    def mesh_ratio(self):
        return 2.0

    def _coarse(self, thetas):
        error = force(0.0, 0.1)
        error[2] += 0.03 * np.sin(4.0 * np.pi * T)
        return [x + error for x in super()._coarse(thetas)]


def correlated(rng, rho):
    """Returns noise (n,) with a standard deviation of 0.05 and the correlation rho^k at lag k."""
    noise = rng.normal(0.0, 0.05, len(T))
    for i in range(1, len(T) if rho else 0):
        noise[i] = rho * noise[i - 1] + np.sqrt(1.0 - rho**2) * noise[i]
    return noise


def test_consistent_data_do_not_widen_the_interval():
    found = [fitted(seed, 1.0) for seed in range(20)]
    widened = [float(f.widening[0]) for f in found if f.difference[0] != 0.0]
    assert all((f.widening[0] > 1.0) == (f.difference[0] != 0.0) for f in found)
    assert len(widened) <= 3 and all(x < 3.5 for x in widened)


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_a_discrepancy_of_all_trials_shifts_the_parameter_by_its_share(share):
    """Without the mean forces, `a` is the amplitude of the sine, and the discrepancy changes it."""
    _, problem, _ = fitted_problem(0, tare=1e3)
    noise = {key: x._replace(discrepancy=share) for key, x in problem.noise.items()}
    parts = {x.name: getattr(problem, x.name) for x in fields(problem)} | {"noise": noise}
    meshed = MeshedDrag(**parts)
    fit = fit_gauss_newton(meshed, ENTRIES, np.array([1.0]), np.arange(1))
    shifted = shift_by_discrepancy(meshed, fit, meshed.tangents(fit.theta, np.eye(1)))
    shift = np.linalg.norm(shifted.shifts[:, 0])
    assert shift == pytest.approx(share, rel=0.1)
    value, low, high = confidence_interval(shifted, ENTRIES, 0)
    least = max(EFFECT_DISCREPANCY * value, shift)
    assert high - low == pytest.approx(3.92 * np.hypot(fit.errors[0], least))
    assert shift_by_discrepancy(problem, fit, problem.tangents(fit.theta, np.eye(1))) is fit


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


def test_a_parameter_that_changes_between_the_halves_is_unstable():
    """A change of 0.3 is 7 standard errors, with the discretisation error of each half."""
    calm = [unstable_parameters(fitted(seed), ENTRIES) for seed in range(4)]
    assert calm == [[]] * 4
    (found,) = unstable_parameters(fitted(0, late=1.3), ENTRIES)
    assert found.name == "drag.a" and found.sigma > 3.0
    assert found.first == pytest.approx(1.0, abs=0.08)
    assert found.second == pytest.approx(1.3, abs=0.08)


def test_correlated_noise_widens_the_interval_by_its_correlation_time():
    """Noise with the correlation rho^k has an effective number of samples n (1 - rho)/(1 + rho)."""
    white = [fitted(seed) for seed in range(3)]
    assert all(np.all(f.correlation == 1.0) for f in white)
    found = [fitted(seed, rho=0.6) for seed in range(3)]
    assert np.median([f.correlation[0] for f in found]) == pytest.approx(2.0, rel=0.2)
    for f in found:
        error = np.maximum(f.correlation, f.widening) * np.sqrt(np.diag(f.covariance))
        np.testing.assert_allclose(f.errors, error)
        assert parameter_record(f, ENTRIES, 0)["widened_by_correlation"] == f.correlation[0]
    assert "widened_by_correlation" not in parameter_record(white[0], ENTRIES, 0)


@pytest.mark.parametrize("null", [0.0, 1.0])
@pytest.mark.parametrize("distance", [0.006, 0.018, 0.022, 0.03, 0.042])
def test_a_single_entry_includes_its_null_if_its_interval_does(null, distance):
    """An error of 0.01, and 2 % of the value for the discretisation."""
    entries = [Parameter("drag", "a", Prior(null, 0.0, 4.0, "-", ""))]
    block = ChannelBlock(0, "thrust", np.array([[1e4]]), np.zeros(1), 1.0, 100)
    fit = Fit(np.array([null + distance]), np.arange(1), 1.0, 100, [block], [], True)
    _, low, high = confidence_interval(fit, entries, 0)
    assert includes_null(fit, entries, np.array([0])) == (low < null < high)


def test_a_fixed_entry_leaves_the_other_entries():
    A = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -1.0], [0.5, -1.0, 2.0]])
    rows = np.array([[0.1, 0.2, 0.3], [-0.3, 0.4, 0.2]])
    block, each = ChannelBlock(0, "thrust", A, np.arange(3.0), 1.0, 100), np.array([1.0, 2.0, 3.0])
    fit = Fit(np.zeros(9), np.array([2, 5, 7]), 1.0, 100, [block], [], True, widening=each)
    fixed = fit._replace(correlation=each[::-1], discrepancy_products=rows).with_fixed([5, 8])
    kept = [0, 2]
    assert fixed.free.tolist() == [2, 7]
    assert (fixed.widening.tolist(), fixed.correlation.tolist()) == ([1.0, 3.0], [3.0, 1.0])
    inverse = np.linalg.inv(A[np.ix_(kept, kept)])
    np.testing.assert_allclose(fixed.shifts, rows[:, kept] @ inverse)
    np.testing.assert_allclose(fixed.covariance, inverse)
    np.testing.assert_array_equal(summed(fixed.blocks)[1], [0.0, 2.0])
