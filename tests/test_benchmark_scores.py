"""Tests of the scores of the loop's benchmark on simple cases."""

import sys

import numpy as np
import pytest

from tests.support.data import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
from summary import f1, is_right, matched_effects, rated_location, skills  # noqa: E402
from tanks import MemoryCache  # noqa: E402


def case(truth, causes, before=3.0, after=1.0):
    effects = [
        {"name": c[0], "class": list(c[1:]), "status": "", "above_floor": []} for c in causes
    ]
    return {
        "case": {"effects": dict.fromkeys(truth)},
        "verdict": "class" if any(len(c) > 1 for c in causes) else "identified",
        "effects": effects,
        "held_out_over_floor": {"refit only": before, "loop": after},
    }


def test_each_cause_counts_once_in_the_best_assignment():
    assert matched_effects([{"x", "y"}, {"x"}], ["x", "y"]) == 2
    assert matched_effects([{"x", "y"}], ["x", "y"]) == 1
    assert matched_effects([], ["x"]) == 0


def test_an_additional_or_different_name_is_incorrect():
    assert is_right(case(["x"], [["x"]])) and is_right(case(["x"], [["z", "x"]]))
    assert not is_right(case(["x"], [["z", "x"]]), most=1)
    assert not is_right(case(["x"], [["x"], ["z"]])) and not is_right(case(["x"], [["z"]]))


def test_f1_is_computed_over_all_cases():
    found = [case(["x", "y"], [["x"], ["y"]]), case(["x", "y"], [["x"]])]
    assert f1(found) == pytest.approx(2 * 3 / (3 + 4))


def test_skill_omits_cases_without_a_residual():
    found = [case(["x"], [["x"]], 3.0, 1.2), case(["x"], [["x"]], 1.05, 1.2)]
    assert skills(found) == [pytest.approx(0.9)]


@pytest.mark.parametrize(
    ("effect", "place", "rating"),
    [
        ("shop_tracker", "Instrument (tip)", "right place"),
        ("shop_tracker", "Instrument (recoil)", "wrong place"),
        ("shop_multiplexer_ghost", "Instrument (pressure)", "right place"),
        ("shop_multiplexer_ghost", "Flow", "wrong place"),
        ("shop_protrusions", "ForceDensity", "right place"),
    ],
)
def test_the_place_of_a_function_includes_its_sensor(effect, place, rating):
    found = case([effect], []) | {"learned": {"terms": ["a term"], "place": place}}
    found["case"]["kind"] = "workshop"
    assert rated_location(found) == rating


def test_the_loop_may_change_arrays_of_the_cache():
    """The loop changes the tangents that it receives; a later method must not see this."""
    cache, at = MemoryCache(), [np.zeros(2)]
    made = cache.cached("tangents", at, lambda: [np.ones(3)])
    made[0][:] = 7.0
    (again,) = cache.cached("tangents", at, lambda: [np.zeros(3)])
    np.testing.assert_array_equal(again, np.ones(3))
    again[:] = 8.0
    np.testing.assert_array_equal(cache.load("tangents", at)[0], np.ones(3))
