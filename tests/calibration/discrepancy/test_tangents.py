"""Tangents for the scores of candidates."""

import numpy as np

from calibration.discrepancy.refits import Refits, ScoringTangents, effect_tangents, kept_tangents
from calibration.inference.gauss_newton import Fit
from calibration.model.extended import Parameter
from slider_jax.effects import Prior
from tests.support.sums import Sums

ENTRIES = [Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", ""))] + [
    Parameter("effect", str(i), Prior(0.0, -50.0, 50.0, "-", "")) for i in range(4)
]


class Caching(Sums):
    """Returns the same list of tangents in every call, like a cache in memory."""

    stored = None

    def tangents(self, theta, directions):
        if self.stored is None:
            self.stored = super().tangents(theta, directions)
        return self.stored


def test_cached_tangents_are_not_changed():
    problem = Caching(np.ones(5))
    first, again = (effect_tangents(problem, ENTRIES, np.zeros(5), np.array([0])) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(first[0][:, 4], problem.size * problem.shapes[:, 0], rtol=1e-6)


def test_large_tangents_are_computed_again_for_other_whiteners(monkeypatch):
    """The result is the same as with kept tangents."""
    problem, theta = Sums(np.ones(5)), np.zeros(5)
    current = Fit(theta, np.array([0]), 1.0, 9, [], problem.predict(theta), True)
    raw = effect_tangents(problem, ENTRIES, theta, current.free)
    white = problem.whiteners(current.predicted)
    refits = Refits(problem, ENTRIES, white, print)
    kept = ScoringTangents(current, kept_tangents(raw), {}).whitened_again(refits)
    monkeypatch.setattr("calibration.discrepancy.refits.MOST_KEPT", 0)
    again = ScoringTangents(current, kept_tangents(raw), {}).whitened_again(refits)
    assert kept.raw is raw and again.raw is None and again.white.keys() == kept.white.keys() != {}
    for key, x in kept.white.items():
        assert x.any()
        np.testing.assert_array_equal(again.white[key], x)
