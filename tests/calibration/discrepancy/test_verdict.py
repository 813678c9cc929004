"""The verdict on selections with a known outcome."""

from types import MappingProxyType

import numpy as np
import pytest

from calibration.discrepancy.rounds import Agreement, Growth, Refit, Selection, SelectionStep
from calibration.discrepancy.verdict import judge_effects, reach_verdict
from calibration.inference.gauss_newton import Fit
from calibration.inference.goodness import Excess
from calibration.inference.problem import ChannelBlock
from calibration.model.extended import base_vector, model_parameters
from slider_jax.channels import SLIDER_CHANNELS

ENTRIES = model_parameters(("valve_delay", "tank_current", "actuator_hysteresis"))
BASE = {"C_d": 3.0, "m_a": 0.7, "k": 0.09, "K_Q": 4.8e-7}
DELAY, CURRENT, AMPLITUDE, WIDTH = 4, [5, 6], 7, 8
ONLY_TIP = MappingProxyType({"tip": 0.1, "thrust": 0.001})


def judged(
    left=(),
    effects=("valve_delay",),
    equivalent=(),
    delay=0.02,
    widened=None,
    converged=True,
    sizes=ONLY_TIP,
    current=(0.06, 0.0),
    error=0.001,
    correlation=0.0,
    fields=MappingProxyType({}),
):
    """Returns the verdict and the statuses of `effects`, which change the channels by `sizes`.

    The channels in `left` have a mean square of 4. `widened` is the upper end of the delay's range.
    All parameters have the standard error `error`. The errors of the two components of the current
    have a `correlation`, and so have the errors of the hysteresis' amplitude and width. `fields`
    replace fields of the final fit.
    """
    theta = base_vector(ENTRIES, BASE)
    theta[DELAY], theta[CURRENT], theta[AMPLITUDE] = delay, current, current[0]
    covariance = error**2 * np.eye(len(ENTRIES))
    for i, j in (CURRENT, (AMPLITUDE, WIDTH)):
        covariance[i, j] = covariance[j, i] = correlation * error**2
    block = ChannelBlock(0, "tip", np.linalg.inv(covariance), np.zeros(len(theta)), 1.0, 100)
    fit = Fit(theta, np.arange(len(theta)), 1.0, 100, [block], [], converged)
    agreed = Agreement(9.0, 0.01, 0.01, 9.0)
    rounds = [
        SelectionStep([], [Refit(n, fit, 99.0, sizes, agreed, True)], n, list(equivalent))
        for n in effects
    ]
    search = Selection(fit, fit, list(effects), rounds, entries=list(ENTRIES))
    search.discrepancies = {"tip": 0.005, "thrust": 0.07, "p_front": 0.002, "p_rear": 0.002}
    if widened is not None:
        p = ENTRIES[DELAY]
        search.entries[DELAY] = p._replace(prior=p.prior._replace(high=widened))
        search.declared[DELAY] = p.prior
    after = {c: Excess(np.full(4, 1.0), 4.0 if c in left else 1.0) for c in search.discrepancies}
    found = judge_effects(search, fit._replace(**fields), after, SLIDER_CHANNELS)
    return reach_verdict(search, found, after), {x.name: x.status for x in found}


def test_a_residual_at_the_noise_floor_is_explained():
    assert judged(effects=()) == ("nothing_missing", {})
    assert judged() == ("identified", {"valve_delay": "identified"})
    assert judged(equivalent=["tank_current"]) == ("class", {"valve_delay": "class"})


def test_a_residual_without_an_effect_is_unexplained():
    assert judged(["tip"], effects=()) == ("unexplained", {})


def test_an_effect_in_a_channel_above_the_noise_floor_is_provisional():
    assert judged(["tip"]) == ("partly_explained", {"valve_delay": "provisional"})
    assert judged(["tip"], equivalent=["tank_current"])[1] == {"valve_delay": "provisional"}


def test_an_effect_is_identified_although_another_channel_is_above_the_noise_floor():
    assert judged(["thrust"]) == ("partly_explained", {"valve_delay": "identified"})


def test_an_effect_of_the_motion_is_provisional_if_a_pressure_is_above_the_noise_floor():
    """A wrong pressure moves the tip, and an effect that moves the tip may only correct this."""
    assert judged(["p_front"]) == ("partly_explained", {"valve_delay": "provisional"})
    both = {"tip": 0.1, "p_rear": 0.1}
    assert judged(["p_front"], sizes=both)[1] == {"valve_delay": "identified"}
    assert judged(["p_rear"], sizes=both)[1] == {"valve_delay": "provisional"}


@pytest.mark.parametrize(
    ("delay", "left", "verdict", "status"),
    [
        (0.09, [], "identified", "beyond_prior"),
        (0.18, ["tip"], "partly_explained", "beyond_prior"),  # at the edge of the wider range
        (0.05, [], "identified", "identified"),  # another effect moved the delay back
    ],
)
def test_an_effect_outside_its_declared_range_is_beyond_its_prior(delay, left, verdict, status):
    assert judged(left, delay=delay, widened=0.18) == (verdict, {"valve_delay": status})


def test_equivalent_effects_take_precedence_over_the_prior_range():
    found = judged(delay=0.09, widened=0.18, equivalent=["tank_current"])
    assert found == ("class", {"valve_delay": "class"})


def test_two_effects_have_a_status_each():
    found = judged(effects=("valve_delay", "tank_current"), delay=0.09, widened=0.18)
    assert found == ("identified", {"valve_delay": "beyond_prior", "tank_current": "identified"})


def test_an_effect_whose_interval_includes_the_null_may_be_absent():
    assert judged(delay=0.02, error=0.0105) == ("inconclusive", {"valve_delay": "provisional"})
    assert judged(delay=0.02, error=0.0099) == ("identified", {"valve_delay": "identified"})
    found = judged(delay=0.02, error=0.0105, equivalent=["tank_current"])
    assert found == ("inconclusive", {"valve_delay": "provisional"})
    found = judged(["thrust"], delay=0.02, error=0.0105)
    assert found == ("partly_explained", {"valve_delay": "provisional"})


def test_an_effect_that_may_be_absent_does_not_hide_another():
    found = judged(effects=("valve_delay", "tank_current"), delay=0.001)
    assert found == ("identified", {"valve_delay": "provisional", "tank_current": "identified"})


def test_the_joint_region_of_several_parameters_decides():
    """The interval of each parameter includes the null, but the data exclude that both are null."""
    for values, status in (((0.017, -0.017), "identified"), ((0.017, 0.017), "provisional")):
        found = judged(effects=["tank_current"], current=values, error=0.01, correlation=0.9)
        assert found[1] == {"tank_current": status}


@pytest.mark.parametrize(("correlation", "status"), [(0.9, "identified"), (0.0, "provisional")])
def test_an_uncertain_shape_does_not_make_an_effect_absent(correlation, status):
    """The interval of the amplitude includes the null, but not for any one width."""
    assert ENTRIES[WIDTH].is_shape and ENTRIES[AMPLITUDE].effect == "actuator_hysteresis"
    values = {"current": (0.017, 0.0), "error": 0.01, "correlation": correlation}
    assert judged(effects=["actuator_hysteresis"], **values)[1] == {"actuator_hysteresis": status}


@pytest.mark.parametrize(
    ("fields", "status"),
    [
        ({}, "identified"),
        ({"widening": np.where(np.arange(len(ENTRIES)) == AMPLITUDE, 2.0, 1.0)}, "provisional"),
        ({"correlation": np.where(np.arange(len(ENTRIES)) == AMPLITUDE, 2.0, 1.0)}, "provisional"),
        ({"widening": np.where(np.arange(len(ENTRIES)) == WIDTH, 2.0, 1.0)}, "identified"),
        # A discrepancy that shifts the amplitude by 0.02
        ({"discrepancy_products": 2e4 * np.eye(len(ENTRIES))[[AMPLITUDE]]}, "provisional"),
        ({"discrepancy_products": 2e4 * np.eye(len(ENTRIES))[[WIDTH]]}, "identified"),
    ],
)
def test_all_errors_of_the_interval_count(fields, status):
    found = judged(effects=["actuator_hysteresis"], current=(0.003, 0.0), fields=fields)
    assert found[1] == {"actuator_hysteresis": status}


def test_an_effect_without_a_finite_error_may_be_absent():
    n = len(ENTRIES)
    block = ChannelBlock(0, "tip", np.full((n, n), np.inf), np.zeros(n), 1.0, 100)
    assert judged(fields={"blocks": [block]})[1] == {"valve_delay": "provisional"}


def test_an_effect_beyond_its_prior_may_be_absent():
    found = judged(delay=0.09, widened=0.18, error=0.05)
    assert found == ("inconclusive", {"valve_delay": "beyond_prior"})


def test_a_fit_that_did_not_converge_is_inconclusive():
    assert judged(converged=False) == ("inconclusive", {"valve_delay": "provisional"})
    assert judged(["tip"], effects=(), converged=False) == ("inconclusive", {})


def test_a_fit_that_did_not_converge_still_shows_what_the_effects_do_not_explain():
    found = judged(["thrust"], converged=False)
    assert found == ("partly_explained", {"valve_delay": "provisional"})


def test_a_growth_below_the_margin_or_within_chance_vetoes_nothing():
    assert Growth(0.2, 0.05).vetoes()
    assert not Growth(0.04, 0.001).vetoes() and not Growth(0.2, 0.11).vetoes()
