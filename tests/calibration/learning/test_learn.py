"""Learning on a small simulated tank whose cause is outside the library."""

import json
from dataclasses import replace

import numpy as np
import pytest

from calibration.discrepancy.close_loop import close_loop_on_trials
from calibration.discrepancy.page import loop_page
from calibration.discrepancy.report import loop_record
from calibration.experiment_design.trial_search import SearchEffort
from calibration.learning.learn import learn_terms
from calibration.learning.report import (
    learned_lines,
    learned_model_toml,
    learned_parts,
    learned_record,
    with_learned,
)
from calibration.measurements.synthetic import Truth, random_trials, write_tank
from calibration.model.plan import Resolution
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.effects.library import load_effects
from slider_jax.experiment.load import load
from slider_jax.simulation.trial import simulate_trial
from tests.support.own_effects import restored_library
from tests.support.small_tank import BASE, CANDIDATES, NULLS, TANK

pytestmark = [pytest.mark.optimised, pytest.mark.slow]

SQUARED_FLOW = '''"""A valve that closes with the squared pressure."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class SquaredFlow(Flow):
    """dp/dt = (1 - c (p/250 kPa)^2) (p_set - p)/k. Source: this test."""

    title = "valve that closes with the squared pressure"

    c: Scalar = parameter(0.0, 0.0, 1.0, "-", "the range of this test")

    def rate(self, rate, x):
        return rate * (1.0 - self.c * (x.p / 250e3) ** 2)
'''
SHARE = 0.3
MESH = Resolution(13, 40, 4.0e-3)
RUNS = [run | {"duration": 0.8} for run in random_trials(3, count=12)[4:]]


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("squared")
    (folder / "own.py").write_text(SQUARED_FLOW)
    with restored_library():
        load_effects(folder / "own.py")
        truth = Truth(BASE, NULLS | {"squared_flow": {"c": SHARE}})
        path = write_tank(folder / "tank", truth, RUNS, 0, numerics=TANK)
    outcome = close_loop_on_trials(load(path), CANDIDATES, fine=MESH, coarse=MESH)
    return outcome, learn_terms(outcome)


def test_the_place_and_the_function_of_an_unknown_cause_are_learned(learned):
    outcome, learning = learned
    assert outcome.verdict in ("unexplained", "partly_explained")
    assert learning.places[0].place == "Flow" and not learning.equal_places
    assert learning.model.tested == outcome.held and outcome.held


def test_the_report_states_the_function_and_the_model_file_contains_it(learned, tmp_path):
    outcome, learning = learned
    part = learned_record(learning, effort=SearchEffort(2, 0))
    record = with_learned(loop_record(outcome, 1.0, {"path": "x", "sha256": 64 * "0"}), part)
    record = json.loads(json.dumps(record, default=float))
    assert (record["verdict"], record["learned"]["status"]) == ("learned", "learned")
    for channel in ("p_front", "p_rear"):
        x = record["learned"]["errors"][channel]
        assert x["excess_removed"] > 0.8 and x["before"] > 2.0 * x["floor"]
    front = next(x for x in learned_lines(record) if x.startswith("p_front"))
    error = record["learned"]["errors"]["p_front"]
    assert f"rms {error['before']:.3g} without, {error['after']:.3g} with" in front
    assert learned_lines(record | {"learned": None}) == []
    (curve,) = record["learned"]["curves"]
    p, low, high = (np.array(curve[key]) for key in ("state", "low", "high"))
    true = -SHARE * (p / 250e3) ** 2 / BASE["k"]
    assert (curve["state_unit"], p.max() > 150e3) == ("Pa", True)
    inside = (low - 0.05 <= true) & (true <= high + 0.05)
    assert inside.all()
    assert record["next_experiment"]["purpose"] == "test_learned"
    html = loop_page(outcome, record, learned_parts(record["learned"], SLIDER_CHANNELS))
    assert html.count("data:image/png") == 3 and "Learned function" in html
    replaced = record["learned"]["replaced_effects"]
    assert replaced == learning.model.dictionary.replaced == outcome.corrections
    assert ("The model without the function does not contain" in html) == bool(replaced)
    assert record["learned"]["converged"] in (True, False)
    (tmp_path / "model.toml").write_text(learned_model_toml(outcome, learning))
    again = load(outcome.experiment.folder / "experiment.toml", tmp_path / "model.toml")
    assert [x.name for x in again.effects] == learning.model.terms
    assert np.isfinite(simulate_trial(again, 0).series["thrust"]).all()


def test_too_few_trials_teach_nothing(learned):
    outcome, _ = learned
    few = learn_terms(replace(outcome, held=[*outcome.held, outcome.used_trials[0]], excess={}))
    assert few.model is None and "eight usable trials" in few.reason
    assert learn_terms(replace(outcome, verdict="nothing_missing")) is None
