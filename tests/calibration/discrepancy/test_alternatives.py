"""Alternative effects compared after the selection, on sums of known series."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.discrepancy.alternatives import better_alternative, judge_alternatives
from calibration.discrepancy.refits import Refits
from calibration.discrepancy.rounds import Agreement
from calibration.discrepancy.selection import select_effects
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.discrepancy.verdict import judge_effects
from calibration.inference import goodness
from calibration.model.extended import Parameter
from slider_jax.effects import Prior
from tests.support.sums import SAMPLES, TRIALS, Sums

NAMES = ("firmware_valves", "pulsed_valves", "tank_current")
"""The first two replace the same law, so they exclude each other."""
ENTRIES = [Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", ""))] + [
    Parameter(name, "x", Prior(0.0, -50.0, 50.0, "-", "")) for name in NAMES
]
across = np.linalg.qr(np.random.default_rng(3).normal(size=(TRIALS * SAMPLES, 4)))[0]
ONE, CURRENT, OTHER, BASE = across.T.reshape(4, TRIALS, SAMPLES) * np.sqrt(TRIALS * SAMPLES)

ONE_WITH_CURRENT = ONE + 0.04 * CURRENT + 0.05 * OTHER


def select(truth, alternative, current=CURRENT, **more):
    """Returns the selection with an `alternative` (trials, samples) to the first effect `ONE`."""
    sums = Sums(truth, np.stack([BASE, ONE, alternative, current]), **more)
    return select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))


def test_an_alternative_that_explains_nearly_as_much_is_excluded_after_the_selection():
    found = select((1.0, 0.5, 0.0, 0.3), ONE + 0.1 * OTHER)
    round_ = found.rounds[0]
    one, other = (next(t for t in round_.refitted if t.name == n) for n in NAMES[:2])
    assert DEFAULT_SETTINGS.equal_gain_share * one.gain < other.gain < one.gain
    assert found.effects == ["firmware_valves", "tank_current"] and not round_.equivalent
    gap = round_.alternatives["pulsed_valves"].loss
    assert gap == pytest.approx(TRIALS * SAMPLES * (0.5 * 0.1 / 0.1) ** 2 / 1.01, rel=0.2)


def test_effects_that_the_data_cannot_discriminate_form_a_class():
    for difference in (0.0, 0.004):
        found = select((1.0, 0.5, 0.0, 0.3), ONE + difference * OTHER)
        assert len(found.rounds[0].equivalent) == 1
        assert {found.rounds[0].chosen, *found.rounds[0].equivalent} == set(NAMES[:2])


def test_a_difference_below_the_discrepancy_excludes_no_alternative():
    found = select((1.0, 0.3, 0.0, 0.3), ONE + 0.015 * OTHER, noise=0.001)
    gap = found.rounds[0].alternatives["pulsed_valves"].loss
    assert gap > 1000.0 and found.rounds[0].equivalent == ["pulsed_valves"]


@pytest.mark.parametrize("seed", range(8))
def test_the_right_alternative_replaces_a_wrong_effect_chosen_before_it(seed):
    truth = (1.0, 0.5, 0.0, 0.05)
    found = select(truth, ONE_WITH_CURRENT, seed=seed)
    first = found.rounds[0]
    right, wrong = (next(t for t in first.refitted if t.name == n) for n in NAMES[:2])
    assert DEFAULT_SETTINGS.contender_gain_share * wrong.gain < right.gain < wrong.gain
    assert (first.chosen, first.replaced) == ("firmware_valves", "pulsed_valves")
    assert found.effects == ["firmware_valves", "tank_current"] and not first.equivalent
    np.testing.assert_allclose(found.final.theta, truth, atol=0.01)


def test_a_residual_above_the_noise_floor_excludes_no_alternative():
    sums = Sums((1.0, 0.5, 0.0, 0.3), np.stack([BASE, ONE, ONE + 0.1 * OTHER, CURRENT]))
    sums.y += 1.2 * np.sin(np.arange(SAMPLES))
    found = select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))
    assert DEFAULT_SETTINGS.noise_floor < found.final.inflation < 2.0
    first = found.rounds[0]
    assert first.equivalent == ["pulsed_valves"] and first.alternatives["pulsed_valves"].loss > 20.0


def test_an_alternative_that_is_already_in_the_model_is_excluded():
    sums = Sums((1.0, 0.5, 0.0, 0.3), np.stack([BASE, ONE, OTHER, CURRENT]))
    found = select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))
    first = found.rounds[0]
    assert first.chosen == "firmware_valves" and not first.alternatives
    first.equivalent = ["tank_current"]
    judge_alternatives(Refits(sums, ENTRIES, {}, print), found)
    assert better_alternative(found) is None and not first.equivalent
    assert set(first.alternatives["tank_current"].fit.free) == {0, 3}


def test_above_the_noise_floor_a_class_contains_no_effect_that_the_model_also_needs():
    sums = Sums((1.0, 0.5, 0.0, 0.3), np.stack([BASE, ONE, OTHER, CURRENT]))
    sums.y += 1.2 * np.sin(np.arange(SAMPLES))
    found = select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))
    assert found.effects == ["firmware_valves", "tank_current"]
    assert found.final.inflation > DEFAULT_SETTINGS.noise_floor
    first = found.rounds[0]
    first.equivalent = ["tank_current", "pulsed_valves"]
    judge_alternatives(Refits(sums, ENTRIES, {}, print), found)
    assert first.equivalent == ["pulsed_valves"]


def test_an_alternative_whose_law_is_replaced_already_stays_equivalent():
    sums = Sums((1.0, 0.5, 0.0, 0.3), np.stack([BASE, ONE, OTHER, CURRENT]))
    found = select_effects(sums, ENTRIES, np.zeros(4), base_names=("k",))
    second = found.rounds[1]
    assert second.chosen == "tank_current"
    second.equivalent = ["pulsed_valves"]
    judge_alternatives(Refits(sums, ENTRIES, {}, print), found)
    assert second.equivalent == ["pulsed_valves"] and not second.alternatives


def test_an_alternative_without_agreement_replaces_nothing():
    found = select((1.0, 0.5, 0.0, 0.3), ONE + 0.1 * OTHER)
    first = found.rounds[0]
    ((name, x),) = first.alternatives.items()
    first.alternatives[name] = x._replace(loss=-x.loss)
    assert better_alternative(found) == (first, name)
    first.alternatives[name] = x._replace(loss=-x.loss, agreement=Agreement(0.0, 1.0, 1.0, 0.0))
    assert better_alternative(found) is None


def test_a_trial_with_a_missing_effect_contradicts_the_right_alternative_only_at_first():
    """Without the current, cross-validation fails for the right effect in the second trial."""
    own = np.eye(TRIALS)[1][:, None]
    current = 0.4 * CURRENT - 0.7 * own * ONE
    wrong = ONE - 0.35 * own * ONE + 0.1 * OTHER
    found = select((1.0, 0.5, 0.0, 0.5), wrong, current=current, noise=0.2)
    first = found.rounds[0]
    right = next(t for t in first.refitted if t.name == "firmware_valves")
    assert not right.agreement.agreed() and first.replaced == "pulsed_valves"
    assert found.effects == ["firmware_valves", "tank_current"]
    np.testing.assert_allclose(found.final.theta, (1.0, 0.5, 0.0, 0.5), atol=0.05)


def test_an_effect_that_another_missing_effect_hides_joins_the_class_by_an_exchange():
    """Alone, two of the effects explain little, so no round refits them instead of the first."""
    shapes = np.stack([BASE, ONE - 0.2 * OTHER, ONE - 2.0 * OTHER, OTHER])
    names = ("carried_mass", "tank_current", "force_gain")
    prior = Prior(0.0, -50.0, 50.0, "-", "")
    entries = [ENTRIES[0], *(Parameter(name, "x", prior) for name in names)]
    truth = (1.0, 1.0, 0.0, 0.2)  # the sum of the effects is ONE
    found = select_effects(Sums(truth, shapes), entries, np.zeros(4), base_names=("k",))
    first, second = found.rounds[:2]
    assert first.chosen == "carried_mass" and found.effects == [first.chosen, second.chosen]
    (other,) = set(names) - set(found.effects)
    assert not {other, second.chosen} & {t.name for t in first.refitted}
    assert other in first.exchanged and other in first.equivalent
    swapped = first.alternatives[other]
    assert abs(swapped.loss) < DEFAULT_SETTINGS.min_gain and swapped.fit.theta[1] == 0.0


def test_an_effect_that_explains_more_replaces_another_by_an_exchange():
    shapes = np.stack([BASE, ONE - 0.2 * OTHER + 0.1 * CURRENT, ONE - 2.0 * OTHER, OTHER])
    names = ("carried_mass", "tank_current", "force_gain")
    prior = Prior(0.0, -50.0, 50.0, "-", "")
    entries = [ENTRIES[0], *(Parameter(name, "x", prior) for name in names)]
    sums, truth = Sums((1.0, 0.0, 1.0, 2.0), shapes), (1.0, 0.0, 1.0, 2.0)
    settings = replace(DEFAULT_SETTINGS, max_effects=2)
    found = select_effects(sums, entries, np.zeros(4), base_names=("k",), settings=settings)
    first = found.rounds[0]
    assert first.replaced == "carried_mass" and set(found.effects) == set(names[1:])
    np.testing.assert_allclose(found.final.theta, truth, atol=0.02)
    after = goodness.tested_excess(sums, found.final)
    statuses = judge_effects(found, found.final, after, sums.all_channels)
    assert {x.name for x in statuses} == set(found.effects)
    record = next(t for t in first.refitted if t.name == first.chosen)
    # Without the effect, only the sum of the other effect and the base remains.
    assert record.gain > 1000.0 and record.sizes["tip"] > 0.1 and record.worth_naming


def test_a_single_effect_has_no_exchange():
    found = select((1.0, 0.5, 0.0, 0.0), ONE + 0.004 * OTHER)
    assert len(found.effects) == 1 and not found.rounds[0].exchanged
