"""Prior ranges that become wider because a fit ended at an edge."""

import numpy as np
import pytest

from calibration.discrepancy.ranges import at_edge, edge_parameters, inside, widened_prior
from calibration.discrepancy.selection import select_effects
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.inference.gauss_newton import Fit
from calibration.inference.problem import ChannelBlock
from calibration.model.extended import Parameter
from slider_jax.effects import Prior
from slider_jax.effects.library import LIBRARY
from tests.support.sums import Sums

PRIORS = [
    pytest.param(prior, id=f"{name}.{key}")
    for name, kind in LIBRARY.items()
    for key, prior in kind.priors().items()
]


@pytest.mark.parametrize("prior", PRIORS)
def test_a_wider_range_contains_the_declared_one_and_keeps_its_null_and_limits(prior):
    wide = widened_prior(prior, 3.0)
    least, most = prior.physical
    assert least <= wide.low <= prior.low and prior.high <= wide.high <= most
    if prior.null == prior.low:
        assert wide.low == prior.low
    if most == np.inf:
        assert wide.high - prior.null == pytest.approx(3.0 * (prior.high - prior.null))


def test_null_and_physical_limits_are_no_edges():
    delay = Prior(0.0, 0.0, 0.06, "s", "")
    assert at_edge(0.0599, delay, 0.01) and at_edge(0.07, delay, 0.01)
    assert not at_edge(0.0, delay, 0.01) and not at_edge(-0.001, delay, 0.01)
    share = Prior(0.0, -0.5, 1.0, "-", "", physical=(-np.inf, 1.0))
    assert not at_edge(1.0, share, 0.01) and at_edge(-0.499, share, 0.01)
    assert widened_prior(share, 3.0)[1:3] == (-1.5, 1.0)


def test_a_step_beyond_a_bound_ends_before_it_and_fixed_entries_keep_their_values():
    entries = [Parameter("leakage", "x", Prior(0.0, 0.0, 10.0, "-", "")) for _ in range(4)]
    theta, step = np.array([1.0, 1.0, 10.0, 1.0]), np.array([2.0, -5.0, 0.0, 50.0])
    moved = inside(theta, step, np.array([0, 1, 2]), entries, DEFAULT_SETTINGS)
    np.testing.assert_allclose(moved, [3.0, 0.2, 10.0, 51.0])
    half = inside(theta, step, np.array([0, 1, 2]), entries, DEFAULT_SETTINGS, 0.5)
    np.testing.assert_allclose(half, [2.0, 0.1, 10.0, 26.0])


def test_an_undetermined_parameter_that_scores_no_effect_is_not_at_an_edge():
    entries = [
        Parameter("firmware_valves", "fill", Prior(0.0, 0.0, 8.0, "1/s", "", 1.5)),
        Parameter("firmware_valves", "supply", Prior(4.0, 2.0, 9.0, "-", "")),
    ]

    def at(information, theta):
        A = np.diag([1e6, information])
        blocks = [ChannelBlock(0, "p_front", A, np.zeros(2), 1.0, 100)]
        fit = Fit(np.array(theta), np.arange(2), 100.0, 100, blocks, [], True)
        return edge_parameters(fit, entries, ["firmware_valves"], DEFAULT_SETTINGS)

    assert at(100.0, [1.0, 9.0]) == [1]
    assert at(0.01, [1.0, 9.0]) == []
    assert at(0.01, [8.0, 4.0]) == [0]


NAMES = ("regulator_gain", "tank_current", "force_gain")
ENTRIES = [Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", ""))] + [
    Parameter(name, "x", Prior(0.0, 0.0, 0.3, "-", "a test")) for name in NAMES
]
SHAPES = np.random.default_rng(4).normal(size=(4, 4, 300))


def select(truth):
    return select_effects(Sums(truth, SHAPES), ENTRIES, np.zeros(4), base_names=("k",))


def test_the_range_of_an_effect_at_its_edge_becomes_three_times_as_wide():
    truth = (1.0, 0.6, 0.0, 0.2)
    found = select(truth)
    assert set(found.effects) == {"regulator_gain", "force_gain"}
    np.testing.assert_allclose(found.final.theta, truth, atol=0.02)
    assert found.declared == {1: ENTRIES[1].prior}
    assert [p.prior.high for p in found.entries[1:]] == pytest.approx([0.9, 0.3, 0.3])


def test_an_effect_beyond_its_wider_range_stays_at_the_edge():
    found = select((1.0, 1.5, 0.0, 0.0))
    assert "regulator_gain" in found.effects
    assert found.final.theta[1] == pytest.approx(0.9, abs=0.01)
    assert found.entries[1].prior.high == pytest.approx(0.9)


def test_effects_inside_their_ranges_keep_these_ranges():
    found = select((1.0, 0.2, 0.0, 0.0))
    assert found.effects == ["regulator_gain"]
    assert found.declared == {} and list(found.entries) == ENTRIES


@pytest.mark.parametrize(
    ("effect", "parameter", "singular"),
    [("side_lag", "x", 1.0), ("stiffness_gradient", "g", 2.0), ("flow_exponent", "exponent", 1.0)],
)
def test_a_wider_range_does_not_reach_a_negative_lag_or_stiffness(effect, parameter, singular):
    wide = widened_prior(LIBRARY[effect].priors()[parameter], 3.0)
    assert max(abs(wide.low), abs(wide.high)) < singular
