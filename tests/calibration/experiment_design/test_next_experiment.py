"""The next experiment for every verdict, on constructed outcomes."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.page import loop_page
from calibration.discrepancy.report import loop_record
from calibration.discrepancy.rounds import (
    Agreement,
    Alternative,
    Refit,
    Selection,
    SelectionStep,
    effect_entries,
)
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.experiment_design import next_experiment as module
from calibration.experiment_design.discriminate import MAX_REPEATS, model_distance
from calibration.experiment_design.information import (
    ChannelInformation,
    SensorModel,
    TrialInformation,
    information,
)
from calibration.experiment_design.next_experiment import next_experiment
from calibration.experiment_design.trial_search import FIRST, SearchEffort, limits_of
from calibration.inference.gauss_newton import Fit, reading_derivatives
from calibration.inference.goodness import Excess
from calibration.inference.problem import TankProblem
from calibration.measurements.records import Record
from calibration.model.extended import BASE, base_vector, model_parameters
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.load import load
from slider_jax.experiment.schema import Trial
from tests.support.experiments import write_small_experiment
from tests.support.still_tank import EFFECTS, LIMITS, MESH, STILL

FREE, FEW = np.arange(len(BASE)), SearchEffort(spread=3, rounds=0)
ENTRIES = model_parameters(EFFECTS)
MASS, FLUID = (effect_entries(ENTRIES)[name] for name in ("carried_mass", "axial_added_mass"))


@pytest.fixture(scope="module")
def tank(tmp_path_factory):
    """An experiment, its problem of two noise-free trials, and its parameters."""
    experiment = load(write_small_experiment(tmp_path_factory.mktemp("next"), *STILL))
    theta = base_vector(ENTRIES, {n: getattr(experiment.parameters, n) for n in BASE})
    samples = [np.arange(int(t.duration * 200) + 1) / 200 for t in experiment.trials]
    empty = [
        Record(trial, t, np.zeros((5, len(t))), experiment.channels)
        for trial, t in zip(experiment.trials, samples, strict=True)
    ]
    plans = TankProblem.of(experiment, empty, EFFECTS, SLIDER_CHANNELS, MESH, MESH)
    found = [
        Record(r.trial, r.t, y, r.channels)
        for r, y in zip(empty, plans.predict(theta), strict=True)
    ]
    return (
        experiment,
        TankProblem.of(experiment, found, EFFECTS, SLIDER_CHANNELS, MESH, MESH),
        theta,
    )


def fitted(tank, theta, free, weight=1.0):
    """Returns a fit at `theta` with the information of the data times `weight`."""
    _, problem, _ = tank
    predicted = [r.values for r in problem.records]
    white = problem.whiteners(predicted)
    residuals = problem.residuals(predicted, white)
    derivatives = reading_derivatives(problem, ENTRIES, theta, free)
    blocks = problem.blocks(residuals, derivatives, white)
    blocks = [x._replace(A=weight * x.A) for x in blocks]
    return Fit(theta, free, 0.0, sum(x.n for x in blocks), blocks, predicted, True)


def outcome(tank, verdict, final, rounds=(), after=None):
    experiment, problem, _ = tank
    excess = after or {c: Excess(np.ones(2), 1.0) for c in SLIDER_CHANNELS}
    effects = [r.chosen for r in rounds if r.chosen]
    limits = {"tip": 0.005}
    search = Selection(final, final, effects, list(rounds), entries=ENTRIES, discrepancies=limits)
    used = {c: {"before": 0.0, "after": 0.0, "floor": 0.0} for c in SLIDER_CHANNELS}
    return LoopOutcome(
        experiment, ENTRIES, verdict, search, final, problem, used, {}, excess, [], []
    )


@pytest.mark.parametrize("verdict", ["unexplained", "inconclusive", "partly_explained"])
@pytest.mark.slow
def test_the_trial_with_the_largest_residual_is_repeated(tank, verdict):
    after = {
        "thrust": Excess(np.array([2.0, np.nan]), 2.5),
        "recoil": Excess(np.array([1.0, 9.0]), 5.0),
    }
    final = fitted(tank, tank[2], FREE)
    found = next_experiment(outcome(tank, verdict, final, after=after))
    assert (found["purpose"], found["trial"]["frequency"]) == ("repeat", 2.5)
    assert found["trial"]["file"] == "trial_02.csv"
    assert "Repeat trial_01.csv" in found["said"] and "recoil" in found["said"]
    assert "9.0 times" in found["said"]


def class_outcome(tank, alternative):
    """Returns an outcome with a class of the carried mass and the fit `alternative`."""
    theta = tank[2].copy()
    theta[MASS] = 0.1
    final = fitted(tank, theta, np.concatenate([FREE, MASS]))
    alternatives = {"axial_added_mass": Alternative(alternative, 0.0, {}, {})}
    step = SelectionStep([], [], "carried_mass", list(alternatives), alternatives)
    return outcome(tank, "class", final, [step])


@pytest.mark.slow
def test_the_next_trial_makes_a_class_smaller(tank):
    theta = tank[2].copy()
    theta[FLUID] = 0.12
    found = class_outcome(tank, fitted(tank, theta, np.concatenate([FREE, FLUID])))
    limits = limits_of(tank[0], LIMITS | {"tow_speed": (0.0, 0.25)})
    record = next_experiment(found, limits=limits, effort=FEW)
    assert record["purpose"] == "separate" and record["times"] == 1
    (pair,) = record["pairs"]
    assert (pair["first"], pair["second"]) == ("carried_mass", "axial_added_mass")
    assert record["trial"]["tow_speed"] > 0.1
    assert pair["sigmas_after"] > 1.3 * pair["sigmas_before"] > 0.0
    assert f"{pair['sigmas_after']:.1f} standard deviations" in record["said"]


@pytest.mark.slow
def test_a_trial_that_leaves_a_part_of_a_class_names_this_part(tank):
    theta = tank[2].copy()
    theta[FLUID] = 0.12
    found = class_outcome(tank, fitted(tank, theta, np.concatenate([FREE, FLUID])))
    same = tank[2].copy()
    same[MASS] = 0.1  # this alternative has the same readings as the chosen effect
    alternatives = found.search.rounds[0].alternatives
    alternatives["tip_mass"] = Alternative(
        fitted(tank, same, np.concatenate([FREE, FLUID])), 0.0, {}, {}
    )
    found.search.rounds[0].equivalent.append("tip_mass")
    limits = limits_of(tank[0], LIMITS | {"tow_speed": (0.0, 0.25)})
    record = next_experiment(found, limits=limits, effort=FEW)
    assert record["times"] == 1 and "between carried_mass and axial_added_mass" in record["said"]
    rest = "This trial does not discriminate between carried_mass and tip_mass."
    assert record["said"].endswith(rest)


@pytest.mark.slow
def test_a_class_that_no_trial_makes_smaller_is_reported(tank):
    theta = tank[2].copy()
    theta[MASS] = 0.1  # the alternative has the same readings
    found, said = class_outcome(tank, fitted(tank, theta, np.concatenate([FREE, FLUID]))), []
    record = next_experiment(found, said.append, effort=SearchEffort(spread=2 * FIRST, rounds=1))
    assert record["times"] is None and f"run {MAX_REPEATS} times" in record["said"]
    assert sum(text.startswith("trial ") for text in said) == FIRST, "equal models need few trials"


def test_a_class_without_fitted_alternatives_proposes_no_trial(tank):
    found = class_outcome(tank, None)
    found.search.rounds[0].alternatives.clear()
    record = next_experiment(found, effort=FEW)
    assert record["trial"] is None and "no alternative can be fitted" in record["said"]


@pytest.fixture
def asked(monkeypatch):
    """Calls of a fake `discriminating_trial` that makes only the second class smaller."""
    calls = []

    def answer(name, predictions, unit, trials, *_):
        calls.append((name, list(predictions), unit, [t.file for t in trials]))
        return {"name": name, "times": 3 if len(calls) == 2 else None}

    monkeypatch.setattr(module, "discriminating_trial", answer)
    return calls


def test_the_trial_is_for_the_first_class_that_it_makes_smaller(tank, asked):
    final = fitted(tank, tank[2], FREE)
    rounds = [
        SelectionStep([], [], name, [other], {other: Alternative(final, 0.0, {}, {})})
        for name, other in (("carried_mass", "axial_added_mass"), ("force_gain", "pressure_gain"))
    ]
    assert next_experiment(outcome(tank, "class", final, rounds))["name"] == "force_gain"
    assert [x[:2] for x in asked] == [
        ("carried_mass", ["axial_added_mass"]), ("force_gain", ["pressure_gain"])
    ]  # fmt: skip


def test_held_out_trials_are_not_used(tank, asked):
    full = class_outcome(tank, fitted(tank, tank[2], FREE))
    next_experiment(full)
    next_experiment(replace(full, held=[1]))
    assert [x[3] for x in asked] == [["trial_00.csv", "trial_01.csv"], ["trial_00.csv"]]


def test_a_measured_trial_is_predicted_at_the_times_of_its_record(tank):
    experiment, problem, theta = tank
    record = problem.records[0]
    kept = np.delete(np.arange(len(record.t)), slice(30, 50))
    with_gap = Record(record.trial, record.t[kept], record.values[:, kept], record.channels)
    sensing = SensorModel.of(experiment, [with_gap, problem.records[1]])
    channels = TrialInformation(experiment, EFFECTS, theta, FREE, sensing, {}, MESH).trial(
        record.trial
    )
    assert {x.n for x in channels} == {len(record.t) - 20}


def test_the_report_lists_the_alternatives(tank):
    final = fitted(tank, tank[2], np.concatenate([FREE, MASS]))
    worse = Alternative(final, 88.0, {"tip": 0.01}, {"tip": 0.005})
    refits = [
        Refit("carried_mass", final, 99.0, {"tip": 0.02}, Agreement(9.0, 0.01, 0.01, 9.0), True)
    ]
    round_ = SelectionStep(
        [], refits, "carried_mass", [], {"axial_added_mass": worse}, None, "tip_mass"
    )
    done = outcome(tank, "identified", final, [round_])
    record = loop_record(done, 1.0, {"path": "tank.toml", "sha256": "0"}, {})
    (effect,) = record["effects"]
    assert effect["in_place_of"] == "tip_mass"
    (rival,) = effect["rivals"]
    assert rival["parameters"]["C_d"] == tank[2][0] and "carried_mass.dm" in rival["parameters"]
    rest = {key: x for key, x in rival.items() if key != "parameters"}
    assert rest == {
        "name": "axial_added_mass", "loss": 88.0, "channels": {"tip": 0.01}, "told_apart": True
    }  # fmt: skip
    html = loop_page(done, record | {"candidates": []})
    assert "axial_added_mass for carried_mass" in html and "tip 1 %" in html


def test_the_model_distance_is_the_least_squares_residual():
    J = np.random.default_rng(2).normal(size=(400, 3))
    J[:, 2] += 2.0 * J[:, 1] + J[:, 0]
    square = float(J[:, 2] @ J[:, 2])
    step, rest = np.linalg.lstsq(J[:, :2], J[:, 2], rcond=None)[:2]
    channels = [
        ChannelInformation(i, "tip", J[half].T @ J[half], J[half].T @ J[half], 0.5 * square, 200)
        for i, half in enumerate((slice(200), slice(200, None)))
    ]
    found = model_distance(channels, 1.0, {"tip": 0.004})
    assert found.sigmas == pytest.approx(np.sqrt(rest[0]), rel=1e-9)
    assert model_distance(channels, 4.0, {}).sigmas == pytest.approx(0.5 * found.sigmas)
    residual = J[:, 2] - J[:, :2] @ step
    assert found.shares["tip"] == pytest.approx(np.sqrt(residual @ residual / square), rel=1e-9)
    assert found.threshold_ratio == pytest.approx(
        min(rest[0] / DEFAULT_SETTINGS.min_gain, (found.shares["tip"] / 0.004) ** 2)
    )


def test_after_a_complete_model_the_next_trial_narrows_the_widest_interval(tank):
    final = fitted(tank, tank[2], FREE, weight=0.01)
    before = np.sqrt(np.diag(final.covariance))
    found = next_experiment(outcome(tank, "nothing_missing", final), effort=FEW)
    place = [p.label for p in ENTRIES].index(found["parameter"])
    assert found["error_before"] == pytest.approx(before[place])
    assert found["error_after"] < 0.9 * found["error_before"]
    assert found["said"].count(found["parameter"]) == 1
    assert Trial.model_validate(found["trial"]).frequency == found["trial"]["frequency"]


@pytest.mark.parametrize("weight", [0.01, 1e6])
def test_after_an_uncertain_effect_the_next_trial_narrows_its_size(tank, weight):
    theta = tank[2].copy()
    theta[MASS] = 0.1
    final = fitted(tank, theta, np.concatenate([FREE, MASS]), weight)
    refit = Refit("carried_mass", final, 99.0, {}, Agreement(9.0, 0.01, 0.01, 9.0), True)
    step = SelectionStep([], [refit], "carried_mass")
    found = next_experiment(outcome(tank, "inconclusive", final, [step]), effort=FEW)
    if weight > 1.0:
        assert found["trial"] is None and "the intervals of the added effects" in found["said"]
        return
    assert found["purpose"] == "narrow" and found["parameter"] == "carried_mass.dm"
    assert found["error_after"] < found["error_before"]
    wider = final._replace(converged=False)
    assert next_experiment(outcome(tank, "inconclusive", wider, [step]))["purpose"] == "repeat"


def test_no_trial_is_proposed_if_none_would_narrow_an_interval(tank):
    final = fitted(tank, tank[2], FREE, weight=1e6)
    done = outcome(tank, "nothing_missing", final)
    found = next_experiment(done)
    assert found["trial"] is None and "do not reduce this discrepancy" in found["said"]
    record = loop_record(done, 1.0, {"path": "tank.toml", "sha256": "0"}, found)
    assert record["next_experiment"] is found
    html = loop_page(done, record | {"candidates": []})
    assert "<h2>Next experiment</h2>" in html and "channels above" not in html
    loud = record | {"candidates": [], "left_over_noise": {"tip": 2.0}}
    assert "channels above the noise floor: tip." in loop_page(done, loud)


def test_no_trial_is_proposed_for_recorded_drives(tank):
    experiment, problem, theta = tank
    drive = Trial(file="a.csv", waveform="recorded", drive_file="b.csv", duration=1.0)
    recorded = experiment.model_copy(update={"trials": (drive,)})
    found = next_experiment(
        outcome((recorded, problem, theta), "nothing_missing", fitted(tank, theta, FREE))
    )
    assert found["trial"] is None and "has recorded drives only" in found["said"]


def test_fit_and_prediction_have_the_same_information(tank):
    experiment, _, theta = tank
    f = TrialInformation(experiment, EFFECTS, theta, FREE, SensorModel.of(experiment), {}, MESH)
    A = information(f.trials(experiment.trials))
    final = fitted(tank, theta, FREE)
    # These data have no quantisation, which the prediction does not know.
    np.testing.assert_allclose(np.sum([x.A for x in final.blocks], axis=0), A, rtol=1e-6)
