"""The verdict on selections with a known outcome."""

import numpy as np
import pytest

from calibration.discrepancy.rounds import Selection, SelectionStep
from calibration.discrepancy.verdict import reach_verdict, rms_reduction
from calibration.inference.gauss_newton import Fit
from calibration.inference.goodness import Excess
from calibration.model.extended import base_vector, model_parameters

ENTRIES = model_parameters(("valve_delay", "tank_current"))
BASE = {"C_d": 3.0, "m_a": 0.7, "k": 0.09, "K_Q": 4.8e-7}


def verdict(before: float, after: float, effects=("valve_delay",), equivalent=(), converged=True):
    """Returns the verdict for `effects` and the tip's mean squares `before` and `after`."""
    theta = base_vector(ENTRIES, BASE)
    fit = Fit(theta, np.arange(4), 1.0, 100, [], [], converged)
    rounds = [SelectionStep([], [], name, list(equivalent)) for name in effects]
    search = Selection(fit, fit, list(effects), rounds)
    excesses = [{"tip": Excess(np.full(4, x), x)} for x in (before, after)]
    return reach_verdict(search, ENTRIES, *excesses)


def test_a_residual_at_the_noise_floor_is_explained():
    assert verdict(1.1, 1.1, ()) == "nothing_missing"
    assert verdict(4.0, 1.1) == "identified"
    assert verdict(4.0, 1.1, equivalent=["tank_current"]) == "class"


def test_an_effect_that_leaves_more_than_a_tenth_of_the_rms_is_not_named():
    assert verdict(4.0, 4.0, ()) == "unexplained"
    assert verdict(95.0, 4.5) == "unexplained"  # 96 % of the square, 87 % of the rms
    assert verdict(400.0, 4.5) == "identified"


def test_a_fit_that_did_not_converge_is_inconclusive():
    assert verdict(400.0, 1.0, converged=False) == "inconclusive"


def test_the_reduction_is_a_share_of_the_rms_above_the_floor():
    assert rms_reduction(4.0, 1.0) == 1.0 and rms_reduction(4.0, 0.9) == 1.0
    assert rms_reduction(4.0, 2.25) == pytest.approx(0.5)
    assert rms_reduction(4.0, 9.0) == pytest.approx(-1.0) and rms_reduction(1.0, 1.0) == 0.0
