"""Rivals of what a search found, judged with everything in the model, on sums of a few series."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.discrepancy.alternatives import (
    better_alternative,
    judge_alternatives,
)
from calibration.discrepancy.refits import Refits
from calibration.discrepancy.rounds import Agreement
from calibration.discrepancy.selection import select_effects
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.model.extended import Parameter
from slider_jax.effects import Prior
from tests.support.sums import SAMPLES, TRIALS, Sums

NAMES = ("firmware_valves", "pulsed_valves", "tank_current")
"""The first two take the place of one law: neither can be added beside the other."""
ENTRIES = [Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", ""))] + [
    Parameter(name, "x", Prior(0.0, -50.0, 50.0, "-", "")) for name in NAMES
]
across = np.linalg.qr(np.random.default_rng(3).normal(size=(TRIALS * SAMPLES, 4)))[0]
ONE, CURRENT, OTHER, BASE = across.T.reshape(4, TRIALS, SAMPLES) * np.sqrt(TRIALS * SAMPLES)

WITH_SOMETHING_OF_THE_CURRENT = ONE + 0.04 * CURRENT + 0.05 * OTHER


def searched(truth, rival, **more):
    """With a `rival` (trials, samples) of the first effect, which is `ONE`."""
    sums = Sums(truth, np.stack([BASE, ONE, rival, CURRENT]), **more)
    return select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))


def test_a_rival_that_explains_nearly_as_much_is_told_apart_at_the_end():
    found = searched((1.0, 0.5, 0.0, 0.3), ONE + 0.1 * OTHER)
    this = found.rounds[0]
    one, other = (next(t for t in this.refitted if t.name == n) for n in NAMES[:2])
    assert DEFAULT_SETTINGS.equal_gain_share * one.gain < other.gain < one.gain
    assert found.effects == ["firmware_valves", "tank_current"] and not this.equivalent
    gap = this.alternatives["pulsed_valves"].loss
    assert gap == pytest.approx(TRIALS * SAMPLES * (0.5 * 0.1 / 0.1) ** 2 / 1.01, rel=0.2)


def test_what_the_readings_cannot_tell_stays_a_class():
    for difference in (0.0, 0.004):
        found = searched((1.0, 0.5, 0.0, 0.3), ONE + difference * OTHER)
        assert len(found.rounds[0].equivalent) == 1
        assert {found.rounds[0].chosen, *found.rounds[0].equivalent} == set(NAMES[:2])


def test_a_difference_below_that_of_correct_programs_tells_nothing_apart():
    quiet = {"noise": 0.001}
    found = searched((1.0, 0.3, 0.0, 0.3), ONE + 0.015 * OTHER, **quiet)
    gap = found.rounds[0].alternatives["pulsed_valves"].loss
    assert gap > 1000.0 and found.rounds[0].equivalent == ["pulsed_valves"]


@pytest.mark.parametrize("seed", range(8))
def test_the_right_rival_takes_the_place_of_the_wrong_one_that_came_first(seed):
    truth = (1.0, 0.5, 0.0, 0.05)
    found = searched(truth, WITH_SOMETHING_OF_THE_CURRENT, seed=seed)
    first = found.rounds[0]
    right, wrong = (next(t for t in first.refitted if t.name == n) for n in NAMES[:2])
    assert DEFAULT_SETTINGS.contender_gain_share * wrong.gain < right.gain < wrong.gain
    assert (first.chosen, first.replaced) == ("firmware_valves", "pulsed_valves")
    assert found.effects == ["firmware_valves", "tank_current"] and not first.equivalent
    np.testing.assert_allclose(found.final.theta, truth, atol=0.01)


def test_where_more_than_noise_is_left_no_rival_is_judged():
    sums = Sums((1.0, 0.5, 0.0, 0.3), np.stack([BASE, ONE, ONE + 0.1 * OTHER, CURRENT]))
    sums.y += 1.2 * np.sin(np.arange(SAMPLES))
    found = select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))
    assert DEFAULT_SETTINGS.noise_floor < found.final.inflation < 2.0
    assert found.rounds[0].equivalent == ["pulsed_valves"] and not found.rounds[0].alternatives


def test_what_is_needed_beside_a_rival_is_told_from_it():
    sums = Sums((1.0, 0.5, 0.0, 0.3), np.stack([BASE, ONE, OTHER, CURRENT]))
    found = select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))
    first = found.rounds[0]
    assert first.chosen == "firmware_valves" and not first.alternatives
    first.equivalent = ["tank_current"]
    judge_alternatives(Refits(sums, ENTRIES, {}, print), found)
    assert better_alternative(found) is None and not first.equivalent
    assert set(first.alternatives["tank_current"].fit.free) == {0, 3}


def test_a_rival_whose_law_another_effect_has_taken_stays_one():
    sums = Sums((1.0, 0.5, 0.0, 0.3), np.stack([BASE, ONE, OTHER, CURRENT]))
    found = select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))
    second = found.rounds[1]
    assert second.chosen == "tank_current"
    second.equivalent = ["pulsed_valves"]
    judge_alternatives(Refits(sums, ENTRIES, {}, print), found)
    assert second.equivalent == ["pulsed_valves"] and not second.alternatives


def test_a_better_rival_on_which_the_trials_did_not_agree_stays_where_it_is():
    found = searched((1.0, 0.5, 0.0, 0.3), ONE + 0.1 * OTHER)
    first = found.rounds[0]
    ((name, x),) = first.alternatives.items()
    first.alternatives[name] = x._replace(loss=-x.loss)
    assert better_alternative(found) == (first, name)
    first.refitted = [replace(t, agreement=Agreement(0.0, 1.0)) for t in first.refitted]
    assert better_alternative(found) is None


def test_what_was_judged_counts_no_more_where_noise_is_left():
    sums = Sums((1.0, 0.5, 0.0, 0.3), np.stack([BASE, ONE, ONE + 0.1 * OTHER, CURRENT]))
    found = select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))
    first = found.rounds[0]
    ((name, x),) = first.alternatives.items()
    first.alternatives[name] = x._replace(loss=-x.loss)
    sums.y += 1.2 * np.sin(np.arange(SAMPLES))
    judge_alternatives(Refits(sums, ENTRIES, {}, print), found)
    assert not first.alternatives and better_alternative(found) is None
