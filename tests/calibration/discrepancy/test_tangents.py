"""Tangents for the scores of candidates."""

import numpy as np

from calibration.discrepancy.refits import (
    FitStart,
    Refits,
    ScoringTangents,
    effect_tangents,
    renewed_tangents,
)
from calibration.inference.gauss_newton import Fit
from calibration.model.extended import Parameter
from slider_jax.effects import Prior
from tests.support.sums import Sums

ENTRIES = [Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", ""))] + [
    Parameter("effect", str(i), Prior(0.0, -50.0, 50.0, "-", "")) for i in range(4)
]


class Squares(Sums):
    """Readings are s + 0.1 s^2 with the sum s, so the derivatives depend on all parameters."""

    def _sum(self, theta):
        s = np.tensordot(theta, self.shapes, 1)
        return self.size * (s + 0.1 * s**2)

    def tangents(self, theta, directions):
        found = np.stack(super().tangents(theta, directions))
        found[:, :, 4] *= 1.0 + 0.2 * np.tensordot(theta, self.shapes, 1)[:, None]
        return list(found)


def test_large_tangents_are_computed_again_for_other_whiteners(monkeypatch):
    """The result is the same as with kept tangents."""
    problem, theta = Sums(np.ones(5)), np.zeros(5)
    current = Fit(theta, np.array([0]), 1.0, 9, [], problem.predict(theta), True)
    raw = effect_tangents(problem, ENTRIES, theta, current.free)
    white = problem.whiteners(current.predicted)
    refits = Refits(problem, ENTRIES, white, print)
    kept = ScoringTangents.of(refits, current, raw)
    monkeypatch.setattr("calibration.discrepancy.refits.MOST_KEPT", 0)
    again = ScoringTangents.of(refits, current)
    assert kept.raw is raw and again.raw is None and again.white.keys() == kept.white.keys() != {}
    for key, x in kept.white.items():
        assert x.any()
        np.testing.assert_array_equal(again.white[key], x)


def test_only_tangents_of_near_effects_and_fitted_parameters_are_renewed():
    entries = [
        p._replace(effect=f"effect_{p.name}" if p.effect else "") for p in [*ENTRIES[:4]]
    ] + [Parameter("started", "s", Prior(0.0, -50.0, 50.0, "-", "", start=2.0))]
    problem, theta = Squares(np.ones(5)), np.zeros(5)
    before = effect_tangents(problem, entries, theta, np.array([0]))
    moved = np.array([3.0, 0.0, 0.0, 0.0, 0.0])
    current = Fit(moved, np.array([0]), 1.0, 9, [], problem.predict(moved), True)
    expected = effect_tangents(problem, entries, moved, np.array([0]))
    # A difference with the step 0.01 has the error 0.005 times the second derivative.
    error = 0.005 * 0.2 * problem.size * float(np.max(problem.shapes**2)) * 1.01
    last = [x.copy() for x in before]
    found = renewed_tangents(last, problem, entries, current, ["effect_1", "started"])
    for x, new, old in zip(found, expected, before, strict=True):
        np.testing.assert_allclose(x[[0, 2, 4]], new[[0, 2, 4]], rtol=1e-6, atol=error)
        np.testing.assert_array_equal(x[[1, 3]], old[[1, 3]])
        assert not np.allclose(new[[0, 1]], old[[0, 1]])


class Tones(Sums):
    """Readings depend on the last parameter like a sine, so a large step overshoots."""

    def _sum(self, theta):
        wave = np.sin(2.0 * theta[4]) * self.shapes[4]
        return self.size * (np.tensordot(theta[:4], self.shapes[:4], 1) + wave)


def test_a_refit_whose_start_is_worse_than_the_current_fit_starts_nearer():
    """Without shorter starts, the refit ends in a minimum above the current fit."""
    problem, theta = Tones([0.0, 0.0, 0.0, 0.0, 0.2]), np.zeros(5)
    predicted = problem.predict(theta)
    square = sum(float(r @ r) for r in problem.residuals(predicted, {}).values())
    current = Fit(theta, np.array([0]), square, 1200, [], predicted, True)
    refits = Refits(problem, ENTRIES, {}, print)
    J = {
        key: x.copy() for key, x in problem.whitened(problem.tangents(theta, np.eye(5)), {}).items()
    }
    far = np.array([0.0, 0.0, 0.0, 0.0, 2.0])
    (fit,) = refits.estimated(current, [FitStart(far, np.array([0, 4]), theta)], J)
    assert fit.square < 1300.0 < square
    np.testing.assert_allclose(fit.theta[4], 0.2, atol=0.01)
