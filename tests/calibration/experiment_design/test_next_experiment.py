"""What the loop proposes to measure next, for every verdict, on outcomes made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.discrepancy.close_loop import Errors, LoopOutcome
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
from calibration.experiment_design.discriminate import TIMES, distance
from calibration.experiment_design.information import (
    ChannelInformation,
    SensorModel,
    TrialInformation,
    information,
)
from calibration.experiment_design.next_experiment import next_experiment
from calibration.experiment_design.trial_search import SearchEffort, limits_of
from calibration.inference.gauss_newton import Fit
from calibration.inference.goodness import Excess
from calibration.inference.problem import TankProblem
from calibration.measurements.records import Record
from calibration.model.extended import BASE, base_vector, parameters
from slider_jax.channels import CHANNELS
from slider_jax.experiment.load import load
from slider_jax.experiment.schema import Trial
from tests.support.experiments import write
from tests.support.still_tank import EFFECTS, LIMITS, MESH, STILL

FREE, FEW = np.arange(len(BASE)), SearchEffort(spread=3, rounds=0)
ENTRIES = parameters(EFFECTS)
MASS, FLUID = (effect_entries(ENTRIES)[name] for name in ("carried_mass", "axial_added_mass"))


@pytest.fixture(scope="module")
def tank(tmp_path_factory):
    """A problem of two trials, noise-free, at the experiment's own parameters, and these."""
    experiment = load(write(tmp_path_factory.mktemp("next"), *STILL))
    theta = base_vector(ENTRIES, {n: getattr(experiment.parameters, n) for n in BASE})
    samples = [np.arange(int(t.duration * 200) + 1) / 200 for t in experiment.trials]
    empty = [
        Record(trial, t, np.zeros((5, len(t))))
        for trial, t in zip(experiment.trials, samples, strict=True)
    ]
    plans = TankProblem.of(experiment, empty, EFFECTS, CHANNELS, MESH, MESH)
    found = [Record(r.trial, r.t, y) for r, y in zip(empty, plans.predict(theta), strict=True)]
    return experiment, TankProblem.of(experiment, found, EFFECTS, CHANNELS, MESH, MESH), theta


def fitted(tank, theta, free, weight=1.0):
    """A fit that ended at `theta`, its data `weight` times as informative as they are."""
    _, problem, _ = tank
    predicted = [r.values for r in problem.records]
    white = problem.whiteners(predicted)
    residuals = problem.residuals(predicted, white)
    blocks = problem.blocks(residuals, problem.tangents(theta, np.eye(len(theta))[free]), white)
    blocks = [x._replace(A=weight * x.A) for x in blocks]
    return Fit(theta, free, 0.0, sum(x.n for x in blocks), blocks, predicted, True)


def outcome(tank, verdict, final, rounds=(), after=None):
    experiment, problem, _ = tank
    excess = after or {c: Excess(np.ones(2), 1.0) for c in CHANNELS}
    none = dict.fromkeys(CHANNELS, 0.0)
    effects = [r.chosen for r in rounds if r.chosen]
    search = Selection(final, final, effects, list(rounds))
    used = Errors(none, none, none)
    return LoopOutcome(
        experiment, ENTRIES, verdict, search, final, problem, used, None, excess, excess, [], []
    )


@pytest.mark.parametrize("verdict", ["unexplained", "inconclusive", "class"])
def test_what_is_not_explained_is_to_be_measured_again_where_it_is_largest(tank, verdict):
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


def classed(tank, rival):
    """The outcome that found a carried mass, and a class with the `rival` fit."""
    theta = tank[2].copy()
    theta[MASS] = 0.1
    final = fitted(tank, theta, np.concatenate([FREE, MASS]))
    rivals = {"axial_added_mass": Alternative(rival, 0.0, {})}
    return outcome(
        tank, "class", final, [SelectionStep([], [], "carried_mass", list(rivals), rivals)]
    )


def test_a_class_asks_for_the_trial_that_makes_it_smaller(tank):
    theta = tank[2].copy()
    theta[FLUID] = 0.12
    found = classed(tank, fitted(tank, theta, np.concatenate([FREE, FLUID])))
    limits = limits_of(tank[0], LIMITS | {"tow_speed": (0.0, 0.25)})
    told = next_experiment(found, limits=limits, effort=FEW)
    assert told["purpose"] == "separate" and told["times"] == 1
    (pair,) = told["pairs"]
    assert (pair["first"], pair["second"]) == ("carried_mass", "axial_added_mass")
    assert told["trial"]["tow_speed"] > 0.1
    assert pair["sigmas_after"] > 1.3 * pair["sigmas_before"] > 0.0
    assert f"{pair['sigmas_after']:.1f} standard deviations" in told["said"]


def test_a_class_that_nothing_makes_smaller_says_so(tank):
    theta = tank[2].copy()
    theta[MASS] = 0.1  # a rival that reads the same
    found = classed(tank, fitted(tank, theta, np.concatenate([FREE, FLUID])))
    told = next_experiment(found, effort=FEW)
    assert told["times"] is None and f"run up to {TIMES} times" in told["said"]


def test_a_class_whose_rivals_were_not_fitted_proposes_nothing(tank):
    found = classed(tank, None)
    found.search.rounds[0].alternatives.clear()
    told = next_experiment(found, effort=FEW)
    assert told["trial"] is None and "none of the rivals can be fitted" in told["said"]


@pytest.fixture
def asked(monkeypatch):
    """What was asked of `split_class`, which makes the second class smaller and not the first."""
    calls = []

    def answer(name, predictions, unit, trials, *_):
        calls.append((name, list(predictions), unit, [t.file for t in trials]))
        return {"name": name, "times": 3 if len(calls) == 2 else None}

    monkeypatch.setattr(module, "split_class", answer)
    return calls


def test_the_first_class_that_a_trial_makes_smaller_is_asked_for(tank, asked):
    final = fitted(tank, tank[2], FREE)
    rounds = [
        SelectionStep([], [], name, [rival], {rival: Alternative(final, 0.0, {})})
        for name, rival in (("carried_mass", "axial_added_mass"), ("force_gain", "pressure_gain"))
    ]
    assert next_experiment(outcome(tank, "class", final, rounds))["name"] == "force_gain"
    assert [x[:2] for x in asked] == [
        ("carried_mass", ["axial_added_mass"]), ("force_gain", ["pressure_gain"])
    ]  # fmt: skip


def test_trials_that_the_search_did_not_see_are_not_counted(tank, asked):
    whole = classed(tank, fitted(tank, tank[2], FREE))
    next_experiment(whole)
    next_experiment(replace(whole, held=[1]))
    assert [x[3] for x in asked] == [["trial_00.csv", "trial_01.csv"], ["trial_00.csv"]]


def test_a_measured_trial_is_foreseen_at_the_times_of_its_record(tank):
    experiment, problem, theta = tank
    record = problem.records[0]
    some = np.delete(np.arange(len(record.t)), slice(30, 50))
    torn = Record(record.trial, record.t[some], record.values[:, some])
    sensing = SensorModel.of(experiment, [torn, problem.records[1]])
    channels = TrialInformation(experiment, EFFECTS, theta, FREE, sensing, {}, MESH).trial(
        record.trial
    )
    assert {x.n for x in channels} == {len(record.t) - 20}


def test_rivals_are_reported(tank):
    final = fitted(tank, tank[2], np.concatenate([FREE, MASS]))
    worse = Alternative(final, 88.0, {"tip": 0.01})
    tried = [Refit("carried_mass", final, 99.0, {"tip": 0.02}, Agreement(9.0, 0.01), True)]
    this = SelectionStep(
        [], tried, "carried_mass", [], {"axial_added_mass": worse}, None, "tip_mass"
    )
    done = outcome(tank, "identified", final, [this])
    told = loop_record(done, 1.0, {"path": "tank.toml", "sha256": "0"}, {})
    (effect,) = told["effects"]
    assert effect["in_place_of"] == "tip_mass"
    assert effect["rivals"] == [
        {"name": "axial_added_mass", "loss": 88.0, "channels": {"tip": 0.01}, "told_apart": True}
    ]
    html = loop_page(done, told | {"candidates": []})
    assert "axial_added_mass for carried_mass" in html and "tip 1 %" in html


def test_a_rival_is_as_far_as_its_model_cannot_follow():
    J = np.random.default_rng(2).normal(size=(400, 3))
    J[:, 2] += 2.0 * J[:, 1] + J[:, 0]
    square = float(J[:, 2] @ J[:, 2])
    step, rest = np.linalg.lstsq(J[:, :2], J[:, 2], rcond=None)[:2]
    channels = [
        ChannelInformation(i, "tip", J[half].T @ J[half], J[half].T @ J[half], 0.5 * square, 200)
        for i, half in enumerate((slice(200), slice(200, None)))
    ]
    found = distance(channels, unit=1.0)
    assert found.sigmas == pytest.approx(np.sqrt(rest[0]), rel=1e-9)
    assert distance(channels, unit=4.0).sigmas == pytest.approx(0.5 * found.sigmas)
    left = J[:, 2] - J[:, :2] @ step
    assert found.shares["tip"] == pytest.approx(np.sqrt(left @ left / square), rel=1e-9)
    assert found.of_enough == pytest.approx(
        min(
            rest[0] / DEFAULT_SETTINGS.min_gain,
            (found.shares["tip"] / CHANNELS["tip"].discrepancy) ** 2,
        )
    )


def test_a_complete_model_asks_for_what_narrows_the_widest_interval(tank):
    final = fitted(tank, tank[2], FREE, weight=0.01)
    before = np.sqrt(np.diag(final.covariance))
    found = next_experiment(outcome(tank, "nothing_missing", final), effort=FEW)
    place = [p.label for p in ENTRIES].index(found["parameter"])
    assert found["error_before"] == pytest.approx(before[place])
    assert found["error_after"] < 0.9 * found["error_before"]
    assert found["said"].count(found["parameter"]) == 1
    assert Trial.model_validate(found["trial"]).frequency == found["trial"]["frequency"]


def test_no_trial_is_proposed_where_none_would_narrow_an_interval(tank):
    final = fitted(tank, tank[2], FREE, weight=1e6)
    done = outcome(tank, "nothing_missing", final)
    found = next_experiment(done)
    assert found["trial"] is None and "would not narrow" in found["said"]
    told = loop_record(done, 1.0, {"path": "tank.toml", "sha256": "0"}, found)
    assert told["next_experiment"] is found
    html = loop_page(done, told | {"candidates": []})
    assert "<h2>Next experiment</h2>" in html and "above it" not in html
    loud = told | {"candidates": [], "left_over_noise": {"tip": 2.0}}
    assert "above it: tip." in loop_page(done, loud)


def test_recorded_drives_alone_propose_nothing_and_say_why(tank):
    experiment, problem, theta = tank
    drive = Trial(file="a.csv", waveform="recorded", drive_file="b.csv", duration=1.0)
    recorded = experiment.model_copy(update={"trials": (drive,)})
    found = next_experiment(
        outcome((recorded, problem, theta), "nothing_missing", fitted(tank, theta, FREE))
    )
    assert found["trial"] is None and "recorded drives only" in found["said"]


def test_the_information_of_the_fit_is_that_of_the_prediction(tank):
    """So that a trial's may be added to it."""
    experiment, _, theta = tank
    f = TrialInformation(experiment, EFFECTS, theta, FREE, SensorModel.of(experiment), {}, MESH)
    A = information(f.trials(experiment.trials))
    final = fitted(tank, theta, FREE)
    # The pressures' quantum is read off data alone, and these have none.
    np.testing.assert_allclose(np.sum([x.A for x in final.blocks], axis=0), A, rtol=1e-6)
