"""How the benchmark of the loop counts, on cases that are plain."""

import sys

import pytest

from tests.support.data import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
from summary import f1, hits, right, skills  # noqa: E402


def case(truth, causes, before=3.0, after=1.0):
    effects = [{"name": c[0], "class": list(c[1:])} for c in causes]
    return {
        "case": {"effects": dict.fromkeys(truth)},
        "verdict": "class" if any(len(c) > 1 for c in causes) else "identified",
        "effects": effects,
        "held_out_over_floor": {"refit only": before, "loop": after},
    }


def test_each_cause_counts_once_and_is_given_where_it_counts_most():
    assert hits([{"x", "y"}, {"x"}], ["x", "y"]) == 2
    assert hits([{"x", "y"}], ["x", "y"]) == 1
    assert hits([], ["x"]) == 0


def test_a_second_name_or_another_one_is_not_right():
    assert right(case(["x"], [["x"]])) and right(case(["x"], [["z", "x"]]))
    assert not right(case(["x"], [["z", "x"]]), most=1)
    assert not right(case(["x"], [["x"], ["z"]])) and not right(case(["x"], [["z"]]))


def test_f1_is_of_all_cases_together():
    found = [case(["x", "y"], [["x"], ["y"]]), case(["x", "y"], [["x"]])]
    assert f1(found) == pytest.approx(2 * 3 / (3 + 4))


def test_skill_is_of_what_stands_above_the_floor():
    found = [case(["x"], [["x"]], 3.0, 1.2), case(["x"], [["x"]], 1.05, 1.2)]
    assert skills(found) == [pytest.approx(0.9)]
