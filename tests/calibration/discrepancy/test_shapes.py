"""Shape parameters of the selected effects, on readings that are known functions of them."""

import numpy as np
import pytest

from calibration.discrepancy.alternatives import judge_alternatives
from calibration.discrepancy.ranges import fix_undetermined_shapes, widened_prior
from calibration.discrepancy.refits import FitStart, Refits, shape_starts
from calibration.discrepancy.rounds import Agreement, Alternative, effect_entries, scoring_entries
from calibration.discrepancy.selection import select_effects
from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.inference.uncertainty import confidence_interval
from calibration.model.extended import Parameter, model_parameters
from calibration.reporting.parameters import parameter_record, parameter_text
from slider_jax.effects import Prior
from slider_jax.effects.library import LIBRARY
from tests.support.sums import SAMPLES, TRIALS, Sums

K, SIZE, LAG, OTHER, MASS = range(5)
DEFAULT = 0.3
ENTRIES = [
    Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", "")),
    Parameter("internal_friction", "z_c", Prior(0.0, -50.0, 50.0, "-", "")),
    Parameter("internal_friction", "kappa_c", Prior(DEFAULT, 0.05, 10.0, "1/m", ""), True),
    Parameter("stress_relaxation", "x", Prior(0.0, -50.0, 50.0, "-", "")),
    Parameter("carried_mass", "x", Prior(0.0, -50.0, 50.0, "-", "")),
]
START = np.array([0.0, 0.0, DEFAULT, 0.0, 0.0])
across = np.linalg.qr(np.random.default_rng(5).normal(size=(TRIALS * SAMPLES, 5)))[0]
BASE, SINE, COSINE, MORE, LAST = across.T.reshape(5, TRIALS, SAMPLES) * np.sqrt(TRIALS * SAMPLES)


def lagged(c, turn=1.0):
    """Series of unit rms whose phase depends on the shape parameter; with `turn` 1 as in a lag."""
    phase = turn * np.arctan(c)
    return np.cos(phase) * SINE - np.sin(phase) * COSINE


class Lagged(Sums):
    """Readings with an effect of the size theta[SIZE] and the shape theta[LAG]."""

    def __init__(self, truth, seed=0, turn=1.0):
        self.turn = turn
        super().__init__(truth, seed=seed)

    def _sum(self, theta):
        rival = lagged(1.0) + 0.3 * MORE
        linear = theta[K] * BASE + theta[OTHER] * rival + theta[MASS] * LAST
        return self.size * (linear + theta[SIZE] * lagged(theta[LAG], self.turn))

    def tangents(self, theta, directions):
        found = np.zeros((TRIALS, len(directions), 5, SAMPLES))
        for k, along in enumerate(directions):
            change = self._sum(theta + 1e-6 * along) - self._sum(theta - 1e-6 * along)
            found[:, k, 4] = change / 2e-6
        return list(found)


COMPLETE = SelectionSettings(complete_refits=True)


def select(size, lag, mass=0.0, seed=0, turn=1.0, settings=DEFAULT_SETTINGS):
    problem = Lagged((1.0, size, lag, 0.0, mass), seed, turn)
    return select_effects(problem, ENTRIES, START, base_names=("k",), settings=settings)


@pytest.mark.parametrize("settings", [DEFAULT_SETTINGS, COMPLETE], ids=["raced", "complete"])
@pytest.mark.parametrize("lag", [0.1, 1.0, 5.0])
def test_an_effect_with_another_shape_is_found_with_its_shape(lag, settings):
    found = select(0.5, lag, settings=settings)
    assert found.effects == ["internal_friction"]
    value, low, high = confidence_interval(found.final, ENTRIES, LAG)
    assert low < lag < high and high - low < 0.5 * (1.0 + lag**2)
    assert found.final.theta[SIZE] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("lag", [0.1, 5.0])
def test_a_complete_refit_reaches_nearly_the_gain_of_an_exact_fit(lag):
    problem = Lagged((1.0, 0.5, lag, 0.0, 0.0))
    refits = Refits(problem, ENTRIES, {}, lambda text: None, COMPLETE)
    current = refits.fit(START, np.array([K]))
    free = np.array([K, SIZE, LAG])
    J = problem.whitened(problem.tangents(current.theta, np.eye(5)), {})
    theta = current.theta.copy()
    theta[SIZE] = 0.1
    (fit,) = refits.raced(current, [FitStart(theta, free, current.theta)], J)
    exact = refits.fit(np.array([1.0, 0.5, lag, 0.0, 0.0]), free, exact=True)
    share = COMPLETE.complete_tolerance_share
    assert current.square - fit.square > (1.0 - share) * (current.square - exact.square)


def test_with_its_default_shape_the_effect_would_lose_against_a_wrong_effect():
    """The rival's score is more than twice as large, so the test above tests the refits."""
    first = select(0.5, 5.0).rounds[0]
    assert [s.name for s in first.scores[:2]] == ["stress_relaxation", "internal_friction"]
    own = next(s for s in first.scores if s.name == "internal_friction")
    assert own.gain < DEFAULT_SETTINGS.min_score_share * first.scores[0].gain


def test_a_shape_that_the_data_do_not_determine_has_its_default():
    found = select(0.03, DEFAULT, turn=0.1)
    assert found.effects == ["internal_friction"]
    assert LAG not in found.final.free and found.final.theta[LAG] == DEFAULT
    record = parameter_record(found.final, ENTRIES, LAG)
    assert record["value"] is None and record["not_determined_by_these_data"]
    assert (record["low"], record["high"], record["fixed_at"]) == (0.05, 10.0, DEFAULT)
    assert parameter_text(record).startswith("not determined by these data, fixed at 0.3")


def test_a_shape_whose_default_fits_worse_stays_free_with_one_open_end():
    found = select(0.04, 8.0)
    assert found.effects == ["internal_friction"] and found.final.theta[LAG] > 2.0
    record = parameter_record(found.final, found.entries, LAG)
    assert record["value"] is None and "fixed_at" not in record


def test_a_shape_stays_free_in_the_rounds_after_its_effect():
    found = select(0.5, 1.0, mass=0.2)
    assert set(found.effects) == {"internal_friction", "carried_mass"}
    np.testing.assert_allclose(found.final.theta, [1.0, 0.5, 1.0, 0.0, 0.2], atol=0.05)
    assert LAG in next(t.fit.free for t in found.rounds[1].refitted if t.name == "carried_mass")


def test_a_weak_effect_with_its_default_shape_needs_only_the_gain_of_one_parameter():
    """The gain is between the required gains of one and of two parameters."""
    found = select(0.0091, DEFAULT, seed=3)
    (refit,) = [t for t in found.rounds[0].refitted if t.name == "internal_friction"]
    assert DEFAULT_SETTINGS.least_gain(1) < refit.gain < DEFAULT_SETTINGS.least_gain(2)
    assert LAG not in refit.fit.free and refit.worth_naming


def test_the_removal_of_an_effect_removes_its_shape():
    problem = Lagged((1.0, 0.0, DEFAULT, 0.0, 0.4))
    refits = Refits(problem, ENTRIES, {}, lambda text: None)
    start = np.array([1.0, 0.01, 9.0, 0.0, 0.4])
    current = refits.fit(start, np.array([K, MASS, SIZE, LAG]))
    less = refits.without(current, "internal_friction")
    assert less is not None and set(less.free) == {K, MASS}
    assert (less.theta[SIZE], less.theta[LAG]) == (0.0, DEFAULT)
    known = [x._replace(A=np.diag([1e6, 1e6, 1.0, 1e3])) for x in current.blocks]
    again = refits.without(current._replace(blocks=known), "internal_friction")
    assert again is not None  # a shape far from its default does not make an effect necessary


def test_free_shapes_continue_a_fit_with_the_defaults():
    refits = Refits(Lagged((1.0, 0.5, 1.0, 0.0, 0.0)), ENTRIES, {}, lambda text: None)
    fixed = refits.fit(np.array([1.0, 0.4, DEFAULT, 0.0, 0.0]), np.array([K, SIZE]))
    free = refits.freed(fixed, ["internal_friction"])
    assert free.free.tolist() == [K, SIZE, LAG]
    assert free.theta[LAG] == pytest.approx(1.0, abs=0.1)
    assert refits.freed(free, ["internal_friction"]) is free
    assert refits.freed(fixed, ["carried_mass"]) is fixed


def test_the_shape_of_an_alternative_is_fitted_when_it_is_substituted():
    problem = Lagged((1.0, 0.0, DEFAULT, 0.06, 0.0))
    found = select_effects(problem, ENTRIES, START, base_names=("k",))
    (round_,) = [r for r in found.rounds if r.chosen]
    assert found.effects == ["stress_relaxation"]
    for refit in round_.refitted:
        refit.fit.theta[LAG] = DEFAULT
    judge_alternatives(Refits(problem, ENTRIES, {}, lambda text: None), found)
    alternative = round_.alternatives["internal_friction"]
    assert alternative.fit.theta[LAG] == pytest.approx(1.0, abs=0.3) and alternative.fewer == -1


def test_the_widest_of_two_undetermined_shapes_is_fixed_first():
    entries = [*ENTRIES[:3], *(p._replace(is_shape=True) for p in ENTRIES[3:])]
    found = select(0.5, 1.0)
    found.entries, order = entries, []

    def refit(fit, entries):
        order.append(set(range(5)) - set(fit.free.tolist()))
        return with_information(found, fit.free)._replace(theta=fit.theta)

    wide = with_information(found, [K, SIZE, LAG, OTHER, MASS])
    fix_undetermined_shapes(found, wide, refit)
    assert order[0] == {OTHER} and order[1] == {OTHER, MASS}


def test_a_shape_far_from_its_default_needs_no_refit_if_only_correlation_widens_its_interval():
    found = select(0.5, 1.0)
    wide = found.final._replace(correlation=1e3)
    assert LAG in wide.free and confidence_interval(wide, ENTRIES, LAG)[1] <= 0.05

    def refit(fit, entries):
        raise AssertionError("the predicted loss is far above the limit")

    assert fix_undetermined_shapes(found, wide, refit) is wide


def with_information(found, free):
    """Returns the final fit with little information on OTHER, and less than needed on MASS."""
    A = np.diag(np.array([1e6, 1e6, 1e6, 1e-4, 1e-3])[free])
    blocks = [found.final.blocks[0]._replace(A=A, b=np.zeros(len(free)))]
    return found.final._replace(free=np.array(free), blocks=blocks, converged=True)


def test_the_required_gain_grows_with_the_number_of_parameters():
    gains = [DEFAULT_SETTINGS.least_gain(n) for n in (1, 2, 3)]
    assert gains == pytest.approx([20.0, 23.5, 26.4], abs=0.1)
    sizes = {"tip": 1.0}
    assert DEFAULT_SETTINGS.worth_naming(22.0, sizes, {"tip": 0.5})
    assert not DEFAULT_SETTINGS.worth_naming(22.0, sizes, {"tip": 0.5}, 2)
    assert DEFAULT_SETTINGS.worth_naming(24.0, sizes, {"tip": 0.5}, 2)
    assert not DEFAULT_SETTINGS.worth_naming(24.0, sizes, {"tip": 1.1}, 2)


def test_an_alternative_with_fewer_parameters_is_excluded_by_a_larger_loss():
    fit, sizes, limits = select(0.5, 1.0).final, {"tip": 1.0}, {"tip": 0.5}
    assert Alternative(fit, 22.0, sizes, limits, fewer=0).is_excluded()
    assert not Alternative(fit, 22.0, sizes, limits, fewer=1).is_excluded()
    assert Alternative(fit, 22.0, sizes, limits, fewer=-1).is_excluded()
    agreed = Agreement(5.0, 0.01, 0.06, 10.0)
    assert Alternative(fit, -22.0, sizes, limits, 1, agreed).is_better()
    assert not Alternative(fit, -22.0, sizes, limits, -1, agreed).is_better()
    assert not Alternative(fit, -22.0, sizes, limits, 1).is_better()


def test_starts_are_inside_the_range_and_begin_with_the_default():
    entries = model_parameters(("keulegan_carpenter_drag",))
    exponent, KC_min = (
        i for i, p in enumerate(entries) if p.name in ("exponent", "KC_min") and p.is_shape
    )
    theta = np.array([p.prior.null if p.effect else 1.0 for p in entries])
    theta[KC_min] = 2.0
    found = np.array(shape_starts(entries, theta, [exponent, KC_min]))[:, [exponent, KC_min]]
    default = 1.0 / 3.0, 0.3
    edges = 0.7 - 0.02 * 0.65, 0.05 + 0.02 * 2.95
    expected = [default, (default[0] / 3.0, 0.3), (edges[0], 0.3)]
    expected += [(default[0], 2.0), (default[0], edges[1]), (default[0], 0.9)]
    np.testing.assert_allclose(found, expected)
    assert len(shape_starts(entries, theta, [])) == 1


def test_shapes_belong_to_their_effect_but_do_not_score_it():
    assert effect_entries(ENTRIES)["internal_friction"].tolist() == [SIZE, LAG]
    assert scoring_entries(ENTRIES)["internal_friction"].tolist() == [SIZE]


SHAPES = {
    f"{name}.{key}": prior for name, kind in LIBRARY.items() for key, prior in kind.shapes().items()
}


@pytest.mark.parametrize("prior", SHAPES.values(), ids=SHAPES)
def test_a_wider_range_of_a_shape_stays_positive_and_within_its_limits(prior):
    wide = widened_prior(prior, 3.0, is_shape=True)
    assert 0.0 < wide.low < prior.low and prior.high < wide.high <= prior.physical[1]
