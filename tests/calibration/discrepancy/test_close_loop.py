"""The loop closed on tanks with a known answer, over a few candidates on a coarse mesh."""

import json

import numpy as np
import pytest

from calibration.discrepancy import close_loop as closing
from calibration.discrepancy.page import loop_page
from calibration.discrepancy.report import (
    error_lines,
    loop_model_toml,
    loop_record,
    parameter_lines,
)
from calibration.measurements.synthetic import Truth, write_tank
from slider_jax.errors import InputError
from slider_jax.experiment import load as experiment
from tests.support.damage import RUNS as MADE_UP, write_experiment
from tests.support.small_tank import BASE, CANDIDATES, MESH, RUNS, TANK, closed

SOURCE = {"path": "tank.toml", "sha256": 4 * "abcdef"}


@pytest.fixture(scope="module")
def null(tmp_path_factory):
    return closed(tmp_path_factory.mktemp("null"), {})


@pytest.fixture(scope="module")
def delayed(tmp_path_factory):
    return closed(tmp_path_factory.mktemp("delayed"), {"valve_delay": {"delay": 0.02}}, 1)


def covers(outcome, name, truth):
    index = next(i for i, p in enumerate(outcome.entries) if p.label == name)
    _, low, high = outcome.interval(index)
    return low < truth < high


def test_it_stays_silent_on_data_that_lack_nothing(null):
    assert (null.verdict, null.search.effects) == ("nothing_missing", [])
    for name, value in BASE.items():
        assert covers(null, name, value), name


def test_it_names_the_effect_and_its_size(delayed):
    assert (delayed.verdict, delayed.search.effects) == ("identified", ["valve_delay"])
    assert covers(delayed, "valve_delay.delay", 0.02)
    for name, value in BASE.items():
        assert covers(delayed, name, value), name


def test_trials_it_never_saw_are_predicted_at_the_floor(delayed):
    for channel, floor in delayed.held_out.floor.items():
        assert delayed.held_out.after[channel] < 1.3 * floor
    assert delayed.held_out.before["p_front"] > 5 * delayed.held_out.after["p_front"]


def test_the_report_is_whole_and_the_model_runs(delayed, tmp_path):
    told = json.loads(json.dumps(loop_record(delayed, 1.0, SOURCE), default=float))
    assert told["verdict"] == "identified" and told["effects"][0]["name"] == "valve_delay"
    assert set(told["parameters"]) == {"C_d", "m_a", "k", "K_Q"}
    k = told["parameters"]["k"]
    assert k["given"] == delayed.experiment.parameters.k
    assert k["without_effects"] > k["high"]  # the lag alone has to stand for the delay
    assert max(told["left_over_noise"].values()) < 1.1
    assert told["errors"]["p_front"]["after"] < 0.2 * told["errors"]["p_front"]["before"]
    assert {row["name"] for row in told["candidates"]} == set(CANDIDATES)
    html = loop_page(delayed, told)
    assert html.count("data:image/png") == 2 and "valve_delay" in html
    assert "Verdict: identified. From tank.toml (sha256 abcdefabcdef)" in html
    (line,) = parameter_lines(told)
    assert line.startswith("valve_delay.delay = 0.0") and line.endswith(") s")
    assert error_lines(told)[0].startswith("p_front, held-out trials: rms ")
    tried = [x for x in told["candidates"] if "explained" in x]
    assert html.count(">chosen<") == 1 and html.count("<td>1: ") == len(tried) > 0
    assert "without the effects" in html and "above it" not in html
    assert told["audit"] == [] and "No fault was found in the data" in html
    (tmp_path / "model.toml").write_text(loop_model_toml(delayed))
    file = delayed.experiment.folder / "experiment.toml"
    again = experiment.load(file, tmp_path / "model.toml")
    assert again.effects[0].name == "valve_delay"
    np.testing.assert_allclose(again.parameters.k, delayed.final.theta[2], rtol=1e-8)


@pytest.mark.slow
def test_the_order_of_the_trials_and_the_noise_change_no_verdict(delayed, tmp_path):
    truth = Truth(BASE, {"valve_delay": {"delay": 0.02}})
    turned = write_tank(tmp_path / "turned", truth, RUNS, 1, numerics=TANK)
    text = turned.read_text()
    head, *trials_told = text.split("[[trials]]")
    turned.write_text("[[trials]]".join([head, *(x + "\n" for x in reversed(trials_told))]))
    again = closing.close_loop_on_trials(
        experiment.load(turned), CANDIDATES, fine=MESH, coarse=MESH
    )
    assert (again.verdict, again.search.effects) == (delayed.verdict, delayed.search.effects)
    np.testing.assert_allclose(again.final.theta, delayed.final.theta, rtol=1e-5)
    for seed in (5, 6):
        other = closed(tmp_path / f"seed_{seed}", truth.effects, seed)
        assert (other.verdict, other.search.effects) == ("identified", ["valve_delay"])


def test_what_none_of_the_candidates_explains_is_said_to_be_unexplained(tmp_path):
    outcome = closed(tmp_path / "odd", {"stiffening": {"beta": 5e-4}}, 2)
    assert outcome.verdict == "unexplained"
    told = loop_record(outcome, 1.0, {})
    assert told["effects"] == [] and "[[effects]]" not in loop_model_toml(outcome)
    assert told["unexplained"] and outcome.used.after == outcome.used.before
    assert [x["name"] for x in told["nearest"]] == outcome.search.effects


def test_too_few_trials_are_refused(tmp_path):
    path = write_experiment(tmp_path / "two", runs=MADE_UP[:2])
    with pytest.raises(InputError, match="holds 2 measured trials"):
        closing.close_loop_on_trials(experiment.load(path), ())
