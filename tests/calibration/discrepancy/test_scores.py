"""Scores of candidates, compared with least squares on the stacked rows."""

import numpy as np
import pytest

from calibration.discrepancy.rounds import agreement
from calibration.discrepancy.scores import least_squares_step, score, tangent_cosine
from calibration.inference.gauss_newton import Bounds, inverse, linear_optimum
from calibration.inference.problem import ChannelBlock, summed
from calibration.model.extended import Parameter
from slider_jax.effects import Prior

TRIALS, ROWS = 5, 60
FREE, GROUP, ALTERNATIVE = np.array([0, 1]), np.array([2, 3]), np.array([4])


def rows(seed=0):
    """Returns tangents (TRIALS, ROWS, 5) and white residuals (TRIALS, ROWS)."""
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(TRIALS, ROWS, 5))
    J[..., 4] = J[..., 2] + 0.5 * J[..., 0] + 1e-3 * J[..., 4]
    return J, rng.normal(size=(TRIALS, ROWS)) + 0.3 * J[..., 2]


def blocks(J, r):
    return [
        ChannelBlock(i, "thrust", j.T @ j, j.T @ x, float(x @ x), len(x))
        for i, (j, x) in enumerate(zip(J, r, strict=True))
    ]


def residual_square(J, r, columns):
    """Returns the sum of squares after least squares over `columns`."""
    flat = J[..., columns].reshape(-1, len(columns))
    return np.linalg.lstsq(flat, r.ravel(), rcond=None)[1][0]


def test_the_gain_is_the_reduction_by_joint_least_squares():
    J, r = rows()
    found = score("x", GROUP, FREE, blocks(J, r), 1.0, 10)
    both = np.concatenate([FREE, GROUP])
    gain = residual_square(J, r, FREE) - residual_square(J, r, both)
    assert found.gain == pytest.approx(gain, rel=1e-9)
    flat = J[..., :4].reshape(-1, 4)
    exact = np.linalg.lstsq(flat, r.ravel(), rcond=None)[0]
    np.testing.assert_allclose(found.step[:4], exact, rtol=1e-9)


def test_a_ridge_penalises_the_group_in_proportion_to_its_information():
    J, r = rows()
    found = score("x", GROUP, FREE, blocks(J, r), 1.0, 10, ridge=0.2)
    flat = J[..., :4].reshape(-1, 4)
    A, b = flat.T @ flat, flat.T @ r.ravel()
    cross = np.linalg.solve(A[:2, :2], A[:2, 2:])
    A[[2, 3], [2, 3]] += 0.2 * np.diag(A[2:, 2:] - A[2:, :2] @ cross)
    np.testing.assert_allclose(found.step[:4], np.linalg.solve(A, b), rtol=1e-9)


def test_with_a_ridge_short_trials_predict_a_longer_trial():
    """Only the first trial shows that the two functions of the group differ."""
    J, r = rows()
    J[..., 3] = J[..., 2] + 0.05 * J[..., 3]
    J[0, :, 3] *= 5.0
    r = 0.1 * np.random.default_rng(1).normal(size=r.shape) + 0.3 * J[..., 2]
    plain, ridged = (
        score("x", GROUP, FREE, blocks(J, r), 0.01, 10, ridge=x).held_gains[0] for x in (0.0, 0.01)
    )
    assert plain < 0.0 < ridged


def test_a_held_out_trial_is_predicted_from_the_other_trials():
    J, r = rows()
    found = score("x", GROUP, FREE, blocks(J, r), 1.0, 10)

    def predicted(trial, columns):
        others = [i for i in range(TRIALS) if i != trial]
        flat = J[others][..., columns].reshape(-1, len(columns))
        x = np.linalg.lstsq(flat, r[others].ravel(), rcond=None)[0]
        return np.sum((r[trial] - J[trial][:, columns] @ x) ** 2)

    both = np.concatenate([FREE, GROUP])
    exact = [np.log(predicted(i, FREE) / predicted(i, both)) for i in range(TRIALS)]
    np.testing.assert_allclose(found.left_out, exact, rtol=1e-8)


def test_null_gains_are_chi_squared_and_corrected_for_the_candidates():
    gains = []
    for seed in range(400):
        J, _ = rows(seed)
        noise = np.random.default_rng(seed + 10_000).normal(size=(TRIALS, ROWS))
        gains.append(score("x", GROUP, FREE, blocks(J, noise), 1.0, 1))
    assert np.mean([g.gain for g in gains]) == pytest.approx(2.0, abs=0.3)
    assert np.mean([g.p < 0.05 for g in gains]) == pytest.approx(0.05, abs=0.03)
    one = score("x", GROUP, FREE, blocks(*rows()), 1.0, 1)
    many = score("x", GROUP, FREE, blocks(*rows()), 1.0, 40)
    assert many.p == pytest.approx(min(1.0, 40 * one.p))


def test_tangents_that_differ_by_free_parameters_only_are_parallel():
    A, _ = summed(blocks(*rows()))
    assert tangent_cosine(A, np.array([2]), ALTERNATIVE, FREE) > 0.999
    assert tangent_cosine(A, np.array([3]), ALTERNATIVE, FREE) < 0.5
    assert tangent_cosine(A, GROUP, ALTERNATIVE, FREE) > 0.999


def test_a_direction_without_data_has_a_large_variance_and_no_step():
    A = np.diag([4.0, 0.0])
    assert inverse(A)[0, 0] == pytest.approx(0.25)
    assert inverse(A)[1, 1] > 1e9
    step = least_squares_step(A, np.array([2.0, 0.0]), np.array([0, 1]))
    np.testing.assert_allclose(step, [0.5, 0.0])


def test_the_bounded_optimum_is_exact_inside_and_at_the_bound_outside():
    entries = [
        Parameter("", "C_d", Prior(np.nan, 0.0, 10.0, "-", "")),
        Parameter("x", "delay", Prior(0.0, 0.0, 1.0, "s", "")),
    ]
    J, r = rows()
    A, b = summed(blocks(J, r))
    A, b = A[:2, :2], b[:2]
    start = np.array([5.0, 0.5])
    free = start + np.linalg.solve(A, b)
    assert 0.0 < free[1] < 1.0
    found = linear_optimum(A, b, start, Bounds.of(entries))
    np.testing.assert_allclose(found, free, rtol=1e-5)
    pushed = linear_optimum(A, b + A @ np.array([0.0, -5.0]), start, Bounds.of(entries))
    assert -0.05 <= pushed[1] < -0.04


def test_bounds_are_invertible():
    bounds = Bounds.of([Parameter("", "k", Prior(np.nan, 0.005, 0.5, "s", ""))])
    theta = np.array([0.087])
    np.testing.assert_allclose(bounds.theta_of(bounds.z_of(theta)), theta, rtol=1e-12)


def test_a_trial_without_change_is_not_cross_validated():
    J, r = rows()
    J = J.copy()
    J[2][:, GROUP] = 0.0
    found = score("x", GROUP, FREE, blocks(J, r), 1.0, 10)
    assert len(found.left_out) == TRIALS - 1


@pytest.mark.parametrize(
    ("left_out", "agreed"),
    [
        ((0.3, 0.2, 0.4, 0.3, 0.2), True),
        ((5.0, 0.2, 0.1, 0.2, 0.1), True),  # all improve, one far more
        ((0.384, 0.662, 0.03, 0.113, -0.085), False),  # rig logs; a held-out trial gets worse
        ((5.0, -0.2, 0.1, -0.2, 0.1), False),
        ((1.7, 1.2, 0.2), False),  # three trials without a large gain in each
    ],
)
def test_trials_agree_by_the_mean_or_by_the_signed_ranks(left_out, agreed):
    assert agreement(np.array(left_out), np.zeros(len(left_out))).agreed() is agreed


@pytest.mark.parametrize(
    ("gains", "agreed"), [((30.0, 2.5), True), ((30.0, 1.5), False), ((30.0,), False)]
)
def test_few_trials_agree_by_the_gain_of_every_trial(gains, agreed):
    assert agreement(np.ones(len(gains)), np.array(gains)).agreed() is agreed


@pytest.mark.parametrize(
    ("gains", "agreed"),
    [
        ((900.0, 60.0, 25.0, 0.5, -1.0, -2.0), True),  # acts in the three fast trials only
        ((900.0, 12.0, 4.0, 0.5, -1.0, -2.0), False),  # only one trial gains much
        ((900.0, 60.0, 25.0, 0.5, -1.0, -9.0), False),  # one trial becomes clearly worse
    ],
)
def test_trials_agree_if_several_gain_much_and_none_loses_much(gains, agreed):
    log_gains = np.array([3.0, 0.1, 0.05, 0.001, -0.001, -0.002])
    assert agreement(log_gains, np.array(gains)).agreed() is agreed


@pytest.mark.parametrize(
    ("trials", "most"),
    [
        pytest.param(2, 0.015, marks=pytest.mark.slow),
        (3, 0.035),
        pytest.param(4, 0.025, marks=pytest.mark.slow),
        pytest.param(8, 0.015, marks=pytest.mark.slow),
    ],
)
def test_few_absent_effects_are_confirmed_with_any_number_of_trials(trials, most):
    """The stated chances are 1.0, 2.5 and 1.7 % with two, three and four trials."""
    rng, confirmed, cases = np.random.default_rng(trials), 0, 1000
    for _ in range(cases):
        J = rng.normal(size=(trials, 3, 60))
        r = rng.normal(size=(trials, 60))
        normal = [
            ChannelBlock(i, "tip", J[i] @ J[i].T, J[i] @ r[i], float(r[i] @ r[i]), 60)
            for i in range(trials)
        ]
        found = score("x", np.array([2]), np.array([0, 1]), normal, 1.0, 1)
        confirmed += agreement(found.left_out, found.held_gains).agreed()
    assert confirmed / cases < most
