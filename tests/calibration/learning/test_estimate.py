"""How the other half of the readings confirms terms, and how both halves estimate them."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.inference.gauss_newton import Fit
from calibration.inference.goodness import Excess
from calibration.inference.problem import FAILED, ChannelBlock
from calibration.learning import dictionary, learn
from calibration.learning.dictionary import Dictionary
from calibration.learning.learn import Learning
from calibration.learning.pursuit import PlaceGain
from calibration.model.extended import Parameter, model_parameters
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.effects import Prior
from slider_jax.effects.library import DICTIONARY

TRIALS = [0, 1, 2, 3, 4, 5]
HALF, BOTH = "half", "both"
PRIOR = Prior(0.0, -20.0, 20.0, "-", "")


FIRST, SECOND = "flow_of_pressure", "valve_opening"
ENTRIES = [Parameter("", "k", PRIOR), *(Parameter(name, "a", PRIOR) for name in (FIRST, SECOND))]


def estimate(monkeypatch, values, pulls, largest=np.inf, finer=None, accepted=lambda known: True):
    """Returns the learning, the fits as (readings, terms, start), and the arguments of `_conclude`.

    A fit ends at the `values` of the terms FIRST and SECOND. `pulls` (trials, terms) are the
    gradients that remain in each of the TRIALS. A fit that starts beyond `largest` fails. `finer`
    is the model with details, and `accepted` the test on the held-out trials.
    """
    entries = ENTRIES
    fits, concluded = [], []

    def fitted(problem, entries, theta, free, progress):
        names = [entries[i].effect for i in free[1:]]
        fits.append((problem.readings, names, theta[1:].tolist()))
        failed = np.abs(theta).max() > largest
        end = np.array([1.0, *values])
        b = np.array([[0.0, *pull] for pull in pulls])[:, free]
        A = 100.0 * np.eye(len(free))
        blocks = [
            ChannelBlock(i, "tip", A, np.full(len(A), np.nan) if failed else b[i], 0.0, 100)
            for i in TRIALS
        ]
        theta = np.where(np.isin(np.arange(3), free), end, 0.0)
        return Fit(theta, free, FAILED if failed else 0.0, 300, blocks, [], not failed)

    def conclude(found, known, fit, terms, confirmed, progress):
        concluded.append((known, terms, confirmed))
        found.model = fit if accepted(known) else None

    monkeypatch.setattr(learn, "_with_details", lambda *given: finer)
    monkeypatch.setattr(learn, "fit_gauss_newton", fitted)
    monkeypatch.setattr(learn, "_conclude", conclude)
    both = SimpleNamespace(readings=BOTH, during=lambda mask: SimpleNamespace(readings=HALF))
    settings = SimpleNamespace(max_halvings=4)
    outcome = SimpleNamespace(
        held=[6], used_trials=TRIALS, search=SimpleNamespace(settings=settings)
    )
    known = SimpleNamespace(
        problem=SimpleNamespace(part=lambda chosen: both),
        entries=entries,
        start=SimpleNamespace(free=np.array([0])),
    )
    found = Learning(outcome)
    start = SimpleNamespace(theta=np.array([1.0, 4.0, 4.0]))
    best = PlaceGain("Flow", [FIRST, SECOND], 9.0, 9.0, start)
    learn._estimate(found, known, best, 2, lambda text: None)
    return found, fits, concluded


QUIET = np.zeros((6, 2))


def test_confirmed_terms_are_fitted_to_both_halves(monkeypatch):
    found, fits, [(_, terms, confirmed)] = estimate(monkeypatch, [1.0, 1.0], QUIET)
    assert [x[0] for x in fits] == [HALF, BOTH]
    assert terms == [FIRST, SECOND] and not found.dropped
    assert all(x.p < 1e-9 and x.change == 0.0 for x in confirmed.values())


def test_an_insignificant_term_is_dropped_without_a_fit_to_both_halves(monkeypatch):
    found, fits, [(_, terms, _)] = estimate(monkeypatch, [1.0, 0.01], QUIET)
    assert terms == [FIRST] and list(found.dropped) == [SECOND]
    assert [x[:2] for x in fits] == [
        (HALF, [FIRST, SECOND]), (HALF, [FIRST]), (BOTH, [FIRST])
    ]  # fmt: skip


def test_a_term_that_changes_by_the_choice_of_trials_is_dropped(monkeypatch):
    """The first trial pulls the second term, and the other trials pull it back."""
    pulls = QUIET.copy()
    pulls[:, 1] = [500.0, *(5 * [-100.0])]
    found, _, [(_, terms, _)] = estimate(monkeypatch, [1.0, 1.0], pulls)
    assert terms == [FIRST] and found.dropped[SECOND].change == pytest.approx(1.0)


def test_terms_whose_sum_is_stable_are_kept(monkeypatch):
    """The second term alone would change by 60 %, but the whole function changes by 12 %."""
    pulls = QUIET.copy()
    pulls[:, 1] = [60.0, *(5 * [-12.0])]
    found, _, [(_, terms, confirmed)] = estimate(monkeypatch, [1.0, 0.2], pulls)
    assert terms == [FIRST, SECOND] and not found.dropped
    assert confirmed[SECOND].change == pytest.approx(0.6)


def test_a_function_that_is_too_large_for_the_other_half_starts_smaller(monkeypatch):
    _, fits, [(_, terms, _)] = estimate(monkeypatch, [1.0, 1.0], QUIET, largest=1.5)
    assert [x[2] for x in fits] == [[4.0, 4.0], [2.0, 2.0], [1.0, 1.0], [1.0, 1.0]]
    assert terms == [FIRST, SECOND]


def test_a_function_that_cannot_be_simulated_is_refused(monkeypatch):
    found, fits, concluded = estimate(monkeypatch, [1.0, 1.0], QUIET, largest=0.1)
    assert not concluded and len(fits) == 5 and f"{FIRST}, {SECOND} failed" in found.reason


def detailed(pull):
    """A model with a detail. In the first of the TRIALS, `pull` pulls the detail."""
    entries = [*ENTRIES, Parameter("valve_opening_fine", "a", PRIOR)]
    pulls = [pull, *(5 * [-pull / 5.0])]
    blocks = [
        ChannelBlock(i, "tip", 100.0 * np.eye(4), np.array([0.0, 0.0, 0.0, x]), 0.0, 100)
        for i, x in zip(TRIALS, pulls, strict=True)
    ]
    fit = Fit(np.ones(4), np.arange(4), 0.0, 300, blocks, [], True)
    return SimpleNamespace(entries=entries), fit


def test_a_function_has_details_if_trials_confirm_it(monkeypatch):
    finer = detailed(0.0)
    found, _, [(known, terms, _)] = estimate(monkeypatch, [1.0, 1.0], QUIET, finer=finer)
    assert known is finer[0] and found.model is finer[1] and terms == [FIRST, SECOND]


def test_details_that_other_trials_contradict_are_omitted(monkeypatch):
    """First, the fitted trials contradict them. Second, the held-out trials do."""
    finer = detailed(500.0)
    _, _, [(known, _, _)] = estimate(monkeypatch, [1.0, 1.0], QUIET, finer=finer)
    assert known is not finer[0]
    finer = detailed(0.0)
    found, _, [(first, _, _), (second, _, _)] = estimate(
        monkeypatch, [1.0, 1.0], QUIET, finer=finer, accepted=lambda known: known is not finer[0]
    )
    assert first is finer[0] and second is not finer[0] and found.model is not None


def test_a_dictionary_of_details_keeps_the_fit_and_starts_details_at_their_null(monkeypatch):
    names = ("leakage", "flow_of_pressure", "valve_opening")
    entries = model_parameters(names)
    theta = np.arange(1.0, 1.0 + len(entries))
    free = np.array([0, 1, 2, 3])
    start = Fit(theta, free, 0.0, 300, [], [], True)
    outcome = SimpleNamespace(effects=["leakage"])
    monkeypatch.setattr(dictionary, "_extended", lambda problem, names, swing: names)
    problem = SimpleNamespace(swing=None)
    known = Dictionary(outcome, [], problem, entries, start)
    found, kept = known.with_details(["valve_opening"])
    details = ["valve_opening_of_rear", "valve_opening_fine", "valve_opening_of_rear_fine"]
    assert found.problem == ("valve_opening", *details)
    assert [entries[i] for i in kept] == found.entries[: len(kept)]
    np.testing.assert_array_equal(found.start.theta[: len(kept)], theta[kept])
    np.testing.assert_array_equal(kept[found.start.free], free)
    scale = theta[[p.label for p in entries].index("valve_opening.scale")]
    for p, x in zip(found.entries[len(kept) :], found.start.theta[len(kept) :], strict=True):
        assert p.effect in details and x == (scale if p.is_shape else 0.0), p.label


@pytest.mark.parametrize(("channel", "all_terms"), [("p_rear", False), ("tip", True)])
def test_a_pressure_above_the_noise_floor_excludes_terms_of_forces(monkeypatch, channel, all_terms):
    above = {c: Excess(np.ones(1), 1.6 if c == channel else 1.4) for c in ("p_rear", "tip")}
    monkeypatch.setattr(dictionary, "channel_excess", lambda problem, fit: above)
    problem = SimpleNamespace(all_channels=SLIDER_CHANNELS)
    terms = dictionary._possible_terms(problem, None, DEFAULT_SETTINGS)
    assert {"rear_opening", "pressure_reading_drift", "rear_set_pressure"} < set(terms)
    assert ("drag_along_robot" in terms) == ("tip_reading_delay" in terms) == all_terms
    assert all_terms == (terms == list(DICTIONARY))
