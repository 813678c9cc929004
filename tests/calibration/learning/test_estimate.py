"""How the other half of the trials confirms terms, and how both halves estimate them."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.inference.gauss_newton import Fit
from calibration.inference.problem import FAILED, ChannelBlock
from calibration.learning import learn
from calibration.learning.learn import Learning
from calibration.learning.pursuit import PlaceGain
from calibration.model.extended import Parameter
from slider_jax.effects import Prior

HALF, BOTH = [1, 3, 5], [0, 1, 2, 3, 4, 5]
PRIOR = Prior(0.0, -20.0, 20.0, "-", "")


def estimate(monkeypatch, values, pulls, largest=np.inf):
    """Returns the learning, the fits as (trials, terms, start), and the arguments of `_conclude`.

    A fit ends at the `values` of the terms "first" and "second". `pulls` (trials, terms) are the
    gradients that remain in the trials of BOTH. A fit that starts beyond `largest` fails.
    """
    entries = [Parameter("", "k", PRIOR), *(Parameter(n, "a", PRIOR) for n in ("first", "second"))]
    fits, concluded = [], []

    def fitted(problem, entries, theta, free, progress):
        names = [entries[i].effect for i in free[1:]]
        fits.append((problem, names, theta[1:].tolist()))
        failed = np.abs(theta).max() > largest
        end = np.array([1.0, *values])
        b = np.array([[0.0, *pull] for pull in pulls])[:, free]
        A = 100.0 * np.eye(len(free))
        blocks = [
            ChannelBlock(i, "tip", A, np.full(len(A), np.nan) if failed else b[i], 0.0, 100)
            for i in problem
        ]
        theta = np.where(np.isin(np.arange(3), free), end, 0.0)
        return Fit(theta, free, FAILED if failed else 0.0, 300, blocks, [], not failed)

    def conclude(found, known, problem, terms, fit, confirmed, progress):
        concluded.append((problem, terms, confirmed))

    monkeypatch.setattr(learn, "fit_gauss_newton", fitted)
    monkeypatch.setattr(learn, "_conclude", conclude)
    settings = SimpleNamespace(max_halvings=4)
    outcome = SimpleNamespace(held=[6], used_trials=BOTH, search=SimpleNamespace(settings=settings))
    known = SimpleNamespace(
        problem=SimpleNamespace(part=lambda chosen: chosen),
        entries=entries,
        start=SimpleNamespace(free=np.array([0])),
    )
    found = Learning(outcome, [0, 2, 4], HALF)
    start = SimpleNamespace(theta=np.array([1.0, 4.0, 4.0]))
    best = PlaceGain("Flow", ["first", "second"], 9.0, 9.0, start)
    learn._estimate(found, known, best, 2, lambda text: None)
    return found, fits, concluded


QUIET = np.zeros((6, 2))


def test_confirmed_terms_are_fitted_to_both_halves(monkeypatch):
    found, fits, [(problem, terms, confirmed)] = estimate(monkeypatch, [1.0, 1.0], QUIET)
    assert [x[0] for x in fits] == [HALF, BOTH] and problem == BOTH
    assert terms == ["first", "second"] and not found.dropped
    assert all(x.p < 1e-9 and x.change == 0.0 for x in confirmed.values())


def test_an_insignificant_term_is_dropped_without_a_fit_to_both_halves(monkeypatch):
    found, fits, [(_, terms, _)] = estimate(monkeypatch, [1.0, 0.01], QUIET)
    assert terms == ["first"] and list(found.dropped) == ["second"]
    assert [x[:2] for x in fits] == [
        (HALF, ["first", "second"]), (HALF, ["first"]), (BOTH, ["first"])
    ]  # fmt: skip


def test_a_term_that_changes_by_the_choice_of_trials_is_dropped(monkeypatch):
    """The first trial pulls the second term, and the other trials pull it back."""
    pulls = QUIET.copy()
    pulls[:, 1] = [500.0, *(5 * [-100.0])]
    found, _, [(_, terms, _)] = estimate(monkeypatch, [1.0, 1.0], pulls)
    assert terms == ["first"] and found.dropped["second"].change == pytest.approx(1.0)


def test_terms_whose_sum_is_stable_are_kept(monkeypatch):
    """The second term alone would change by 60 %, but the whole function changes by 12 %."""
    pulls = QUIET.copy()
    pulls[:, 1] = [60.0, *(5 * [-12.0])]
    found, _, [(_, terms, confirmed)] = estimate(monkeypatch, [1.0, 0.2], pulls)
    assert terms == ["first", "second"] and not found.dropped
    assert confirmed["second"].change == pytest.approx(0.6)


def test_a_function_that_is_too_large_for_the_other_half_starts_smaller(monkeypatch):
    _, fits, [(_, terms, _)] = estimate(monkeypatch, [1.0, 1.0], QUIET, largest=1.5)
    assert [x[2] for x in fits] == [[4.0, 4.0], [2.0, 2.0], [1.0, 1.0], [1.0, 1.0]]
    assert terms == ["first", "second"]


def test_a_function_that_cannot_be_simulated_is_refused(monkeypatch):
    found, fits, concluded = estimate(monkeypatch, [1.0, 1.0], QUIET, largest=0.1)
    assert not concluded and len(fits) == 5 and "first, second failed" in found.reason
