"""Both parts of the verdict, on a tank whose readings have a closed form.

Each effect adds a tone to the thrust; the effects' physical meaning is not used.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.discrepancy import close_loop
from calibration.discrepancy.close_loop import conclude
from calibration.discrepancy.page import loop_page
from calibration.discrepancy.report import (
    choice_sentence,
    effect_sentences,
    loop_model_toml,
    loop_record,
    residual_sentence,
)
from calibration.discrepancy.rounds import Alternative, Growth, relative_changes
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.discrepancy.verdict import EffectStatus
from calibration.inference.goodness import Excess
from calibration.inference.problem import summed
from calibration.inference.whiteness import SeriesTest
from calibration.measurements.records import Record
from calibration.model.extended import BASE, base_values
from slider_jax.channels import SLIDER_CHANNELS
from tests.support import closed_form_tank as tank

NAMES = ("carried_mass", "chamber_mismatch", "body_stiffness")
THETA = (3.0, 0.7, 0.08, 4.5e-7)
HELD = [2, 4]
FREQUENCIES = np.linspace(1.5, 3.5, 7).tolist()


def conclusion(size, held_out_sign=1.0):
    """Returns the outcome for tones of the given sizes; the last of four tones is no candidate.

    `held_out_sign`, a number or one for each tone, multiplies the tones in the held-out trials.
    """
    experiment = tank.experiment_of(FREQUENCIES)
    signs = [held_out_sign if i in HELD else 1.0 for i in range(len(FREQUENCIES))]
    thetas = [np.array([*THETA, *(sign * np.array(size))]) for sign in signs]
    records = tank.measured(experiment, thetas, 1)
    return conclude(
        experiment,
        NAMES,
        records,
        HELD,
        lambda chosen: tank.problem_of(experiment, list(chosen), NAMES),
        base_values(experiment),
        tuple(BASE),
        lambda text: None,
    )


@pytest.fixture(autouse=True)
def closed_form(monkeypatch):
    tank.replace_the_beam(monkeypatch)


def report(outcome):
    """Returns report.json, page and model file of an outcome."""
    record = json.loads(json.dumps(loop_record(outcome, 1.0, {"path": "a", "sha256": "0"})))
    return record, loop_page(outcome, record), loop_model_toml(outcome)


def statuses(record):
    return {x["name"]: x["status"] for x in record["effects"]}


@pytest.mark.slow
def test_two_effects_of_which_one_is_beyond_its_prior_are_both_in_the_model():
    outcome = conclusion((0.9, 0.25, 0.0, 0.0))
    record, page, model = report(outcome)
    assert record["verdict"] == "identified"
    assert statuses(record) == {"carried_mass": "beyond_prior", "chamber_mismatch": "identified"}
    mass = next(x for x in record["effects"] if x["name"] == "carried_mass")
    (beyond,) = mass["beyond_prior"]
    assert beyond["parameter"] == "dm" and beyond["value"] == pytest.approx(0.9, abs=0.02)
    assert beyond["range"] == [0.0, 0.4] and beyond["widened_range"] == pytest.approx([0.0, 1.2])
    assert not beyond["at_edge_of_widened_range"]
    assert record["residual"]["status"] == "at_floor"
    assert all(x["where"] is None for x in record["residual"]["channels"].values())
    assert "is outside its prior range of 0 to 0.4 kg/m (0.4 for water" in record["said"]
    assert record["said"].endswith("The residual is at the noise floor.")
    assert "<td>body and tail</td>" in page and mass["segments"] == ["body", "tail"]
    assert "<td>beyond_prior</td>" in page and "0.4 for water in folds" in page
    assert model.count("[[effects]]") == 2 and "dm = 0." in model
    assert record["held_out"]["thrust"]["after"] < 0.5 * record["held_out"]["thrust"]["before"]


def test_an_effect_at_the_edge_of_the_wider_range_is_kept():
    outcome = conclusion((2.0, 0.0, 0.0, 0.0))
    record, _, model = report(outcome)
    assert (record["verdict"], statuses(record)) == (
        "partly_explained",
        {"carried_mass": "beyond_prior"},
    )
    (beyond,) = record["effects"][0]["beyond_prior"]
    assert beyond["at_edge_of_widened_range"] and beyond["value"] == pytest.approx(1.2, abs=0.02)
    assert "also at an edge of the wider range" in record["said"]
    assert 'name = "carried_mass"' in model


def test_an_effect_that_leaves_a_residual_is_a_correction():
    outcome = conclusion((0.3, 0.0, 0.0, 0.5))
    record, page, model = report(outcome)
    assert record["verdict"] == "partly_explained"
    assert statuses(record) == {"carried_mass": "provisional"}
    assert record["effects"][0]["above_floor"] == ["thrust"]
    thrust = record["residual"]["channels"]["thrust"]
    assert record["residual"]["status"] == "above_floor"
    assert thrust["mean_square"] > 1.5 and thrust["where"]["trial"].startswith("trial_")
    turns = thrust["pattern"]["peak_Hz"] / thrust["where"]["frequency_Hz"]
    assert turns == pytest.approx(1.0 + 0.37 * 3, abs=0.1)
    assert record["residual"]["channels"]["p_front"]["pattern"] is None
    assert record["said"].startswith("As a correction, the loop's model contains: ")
    assert "The residual is above the noise floor in thrust" in record["said"]
    assert "The model lacked" not in record["said"]
    assert "<td>provisional</td>" in page and 'name = "carried_mass"' in model
    assert record["errors"]["thrust"]["after"] < record["errors"]["thrust"]["before"]


def test_an_effect_that_a_repeated_discrepancy_can_explain_may_be_absent(monkeypatch):
    """A discrepancy of all trials that shifts the mass by half its value."""
    assert conclusion((0.3, 0.0, 0.0, 0.0)).verdict == "identified"
    monkeypatch.setattr(
        close_loop,
        "shift_by_discrepancy",
        lambda problem, fit, along: fit._replace(
            discrepancy_products=0.16 * summed(fit.blocks)[0][fit.free == 4]
        ),
    )
    record, page, model = report(conclusion((0.3, 0.0, 0.0, 0.0)))
    assert record["verdict"] == "inconclusive"
    assert statuses(record) == {"carried_mass": "provisional"}
    assert record["effects"][0]["includes_null"] and not record["effects"][0]["above_floor"]
    assert record["said"].startswith("Inconclusive: no added effect is certain.")
    assert "As a correction, the loop's model contains" in record["said"]
    assert "carried_mass may be absent" in page and 'name = "carried_mass"' in model
    outcome = conclusion((0.3, 0.0, 0.0, 0.0))
    vetoed = replace(outcome.search, vetoed={"tip_mass": Growth(0.2, 0.05)})
    said = report(replace(outcome, search=vetoed))[0]["said"]
    assert said.startswith("Inconclusive: no added effect is certain.") and "tip_mass" in said


def test_each_correction_has_its_own_reason():
    """One effect changes a channel above the noise floor, and the other may be absent."""
    statuses = [
        EffectStatus("carried_mass", "provisional", [], ["tip"], [], True, False),
        EffectStatus("tip_mass", "provisional", [], [], [], True, True),
    ]
    said = effect_sentences(SimpleNamespace(statuses=statuses, replaceable=False))
    assert said[1:] == [
        "carried_mass may only resemble the cause, because the residual of tip is not only noise.",
        "The effect tip_mass may be absent: the 95 % interval of its size includes the null.",
    ]


def test_effects_that_a_function_can_replace_are_corrections_at_the_noise_floor():
    outcome = conclusion((0.9, 0.25, 0.0, 0.0))
    assert outcome.verdict == "identified"
    record, page, model = report(replace(outcome, verdict="learned", replaceable=True))
    assert statuses(record) == {"carried_mass": "beyond_prior", "chamber_mismatch": "provisional"}
    assert record["said"].startswith("As corrections, the loop's model contains: ")
    assert "explains the data better, or as well with fewer terms" in record["said"]
    assert "is not only noise" not in record["said"] and "The model lacked" not in record["said"]
    assert page.count("<td>provisional</td>") == 1
    assert "As corrections, the loop's model contains: " in " ".join(model.split("\n# "))


def test_a_residual_below_the_floor_with_a_pattern_is_not_called_larger_than_noise():
    hum = SeriesTest("trial_00.csv", "tip", 0.0, 1.0, 0.3, 1e-9, 13.0, 2e-4)
    trials = np.array([0.5])
    excess = {"tip": Excess(trials, 0.5, (hum,)), "thrust": Excess(np.array([4.0]), 4.0)}
    outcome = SimpleNamespace(
        excess=excess,
        search=SimpleNamespace(settings=DEFAULT_SETTINGS),
        problem=SimpleNamespace(
            records=[SimpleNamespace(trial=SimpleNamespace(file="a.csv"))],
            all_channels=SLIDER_CHANNELS,
        ),
        used_trials=[0],
    )
    assert residual_sentence(outcome) == (
        "The residual is above the noise floor in thrust (mean square 4 times the noise variance, "
        "largest in a.csv). The residual is as small as the noise, but is not white noise, in tip "
        "(trial_00.csv has a sine of 13 Hz with an amplitude of 0.2 mm)."
    )


def test_a_restricted_search_is_stated():
    def sentence(tested, only=(), without=()):
        return choice_sentence({"tested": tested, "known": 98, "only": only, "without": without})

    assert sentence(98) == ""
    assert sentence(2, only=["leakage", "valve_delay"]) == (
        "Only 2 of 98 candidates were tested (--only leakage valve_delay). "
        "Other effects may fit equally well."
    )
    assert "(--without leakage)" in sentence(97, without=["leakage"])
    outcome = conclusion((0.0, 0.25, 0.0, 0.0))
    record, page, _ = report(outcome)
    choice = {"tested": 3, "known": 98, "only": list(NAMES), "without": []}
    stated = choice_sentence(choice)
    assert stated not in page
    assert stated in loop_page(outcome, record | {"candidate_choice": choice})


def test_a_base_parameter_that_depends_on_the_equivalent_effect_is_stated():
    """The fit with the equivalent effect has another C_d, and a k inside the interval."""
    outcome = conclusion((0.0, 0.25, 0.0, 0.0))
    (round_,) = [r for r in outcome.search.rounds if r.chosen == "chamber_mismatch"]
    fit = outcome.search.final
    labels = [p.label for p in outcome.entries]
    C_d, k = labels.index("C_d"), labels.index("k")
    theta = fit.theta.copy()
    theta[C_d], theta[k] = 4.0, outcome.final.theta[k]
    round_.equivalent = ["body_stiffness"]
    other = Alternative(fit._replace(theta=theta), 0.5, {"thrust": 0.001}, {"thrust": 0.01})
    round_.alternatives = {"body_stiffness": other}
    record, page, model = report(outcome)
    value = outcome.final.theta[C_d]
    stated = (
        "C_d depends on which effect is the cause: "
        f"{value:.4g} with chamber_mismatch, 4 with body_stiffness."
    )
    assert stated in record["said"] and stated in page and stated in model
    assert "k depends on" not in record["said"]
    assert "(chamber_mismatch), or instead body_stiffness." in record["said"]
    (rival,) = record["effects"][0]["rivals"]
    assert rival["parameters"]["C_d"] == 4.0 and "C_d = 4," in page


def test_an_effect_that_the_held_out_trials_contradict_is_removed():
    outcome = conclusion((0.0, 0.25, 0.0, 0.0), held_out_sign=-1.0)
    record, page, model = report(outcome)
    (veto,) = record["vetoed"]
    assert veto["name"] == "chamber_mismatch"
    assert veto["log_growth"] > max(0.05, 2.0 * veto["standard_error"])
    assert (record["verdict"], record["effects"]) == ("unexplained", [])
    assert "increases the sum of squares in the held-out trials" in record["said"]
    assert "The model contains no added effect" in page and "[[effects]]" not in model
    step = next(r for r in outcome.search.rounds if r.taken_out)
    assert (step.taken_out, step.chosen) == ("chamber_mismatch", None)


def test_a_veto_removes_only_the_effect_that_is_contradicted():
    outcome = conclusion((0.3, 0.25, 0.0, 0.0), held_out_sign=np.array([1.0, -1.0, 1.0, 1.0]))
    assert list(outcome.search.vetoed) == ["chamber_mismatch"]
    assert outcome.effects == ["carried_mass"]


def test_the_effect_with_the_largest_growth_does_not_hide_another_contradicted_effect(monkeypatch):
    growths = iter([Growth(0.3, 0.2), Growth(0.2, 0.02), Growth(-1.0, 0.1)])
    monkeypatch.setattr(close_loop, "growth_of_error", lambda *given: next(growths))
    outcome = conclusion((0.3, 0.25, 0.0, 0.0))
    assert [x.mean for x in outcome.search.vetoed.values()] == [0.2]
    assert len(outcome.effects) == 1


def test_a_change_of_readings_that_were_not_measured_does_not_count():
    values = np.full((len(SLIDER_CHANNELS), 100), np.nan)
    values[SLIDER_CHANNELS.row("tip"), :50] = 1.0
    trial = tank.experiment_of(FREQUENCIES).trials[0]
    problem = SimpleNamespace(
        noise={(0, "tip"): None},
        all_channels=SLIDER_CHANNELS,
        records=[Record(trial, np.arange(100.0), values, SLIDER_CHANNELS)],
    )
    before, after = np.ones((2, 1, len(SLIDER_CHANNELS), 100))
    after[:, SLIDER_CHANNELS.row("tip"), 50:] = 3.0
    assert relative_changes(problem, before, after) == {"tip": 0.0}
    after[:, SLIDER_CHANNELS.row("tip"), :50] = 1.5
    assert relative_changes(problem, before, after) == {"tip": 0.5}


def test_a_residual_that_no_candidate_explains_is_unexplained():
    record, _, model = report(conclusion((0.0, 0.0, 0.0, 0.5)))
    assert (record["verdict"], record["effects"]) == ("unexplained", [])
    assert record["residual"]["status"] == "above_floor" and record["vetoed"] == []
    assert record["unexplained"] and record["nearest"] == [] and "[[effects]]" not in model
