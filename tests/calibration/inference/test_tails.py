"""Detection of heavy-tailed noise, and the fit with its weights."""

import numpy as np
import pytest

from calibration.inference.tails import MAX_SQUARE, Tails, heavy_tails, student_tails


def residuals(series):
    return {(i, "thrust"): x for i, x in enumerate(series)}


def heavy(shape, seed=0, freedom=3.0):
    """Returns noise of Student's t-distribution with unit variance."""
    x = np.random.default_rng(seed).standard_t(freedom, size=shape)
    return x * np.sqrt((freedom - 2.0) / freedom)


@pytest.mark.parametrize("freedom", [3.0, 5.0])
def test_the_degrees_of_freedom_and_the_scale_are_found(freedom):
    found = heavy_tails(residuals(heavy((6, 1000), freedom=freedom)))["thrust"]
    assert found.freedom == pytest.approx(freedom, rel=0.2)
    assert found.scale == pytest.approx(np.sqrt((freedom - 2.0) / freedom), rel=0.1)


def test_normal_noise_has_no_heavy_tails():
    rng = np.random.default_rng(1)
    for _ in range(10):
        sizes = np.exp(0.3 * rng.normal(size=(6, 1)))
        assert heavy_tails(residuals(sizes * rng.normal(size=(6, 1000)))) == {}


def test_the_residual_of_a_missing_effect_has_no_heavy_tails():
    """A pulse in each stride has a heavy-tailed distribution, but neighbours are similar."""
    t, rng = np.arange(1000) / 500.0, np.random.default_rng(2)
    pulse = 6.0 * np.exp(-0.5 * (((t * 2.0) % 1.0 - 0.5) / 0.03) ** 2)
    series = rng.normal(size=(6, 1000)) + pulse
    assert student_tails(series.ravel())[1] > 100.0
    assert np.mean(series**2) < MAX_SQUARE
    assert heavy_tails(residuals(series)) == {}


def test_a_residual_far_above_the_noise_keeps_normal_noise():
    assert heavy_tails(residuals(2.0 * heavy((6, 1000)))) == {}


def test_weights_make_the_mean_as_accurate_as_the_information_allows():
    """The variance of the mean is (nu + 3)/(nu + 1) scale^2/n, half that of the plain mean."""
    x = heavy((400, 500), seed=3)
    tails = Tails(3.0, np.sqrt(1.0 / 3.0))
    means, variances = [], []
    for row in x:
        weight = 1.0 / tails.variances(row - np.median(row))
        means.append(np.average(row, weights=weight))
        variances.append(1.0 / weight.sum())
    expected = 6.0 / 4.0 / 3.0 / 500.0
    assert np.var(means) == pytest.approx(expected, rel=0.2)
    assert np.mean(variances) == pytest.approx(expected, rel=0.05)
    assert np.var(x.mean(axis=1)) > 1.6 * np.var(means)
