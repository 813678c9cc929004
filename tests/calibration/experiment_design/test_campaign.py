"""Measuring until it is settled: what is captured, what is added, and when it ends."""

import json
import shutil
from functools import partial
from types import SimpleNamespace

import pytest

from calibration.discrepancy.close_loop import close_loop_on_trials
from calibration.experiment_design import campaign as module
from calibration.experiment_design.campaign import campaign
from calibration.experiment_design.trial_search import limits_of
from calibration.measurements.synthetic import Truth, write_tank
from slider_jax.errors import InputError
from slider_jax.experiment import load as experiment
from tests.support.small_tank import BASE, MESH, RUNS, TANK

CANDIDATES = ("valve_delay", "clamp_compliance", "tangential_friction")


def tank(folder, effects, count, seed=0):
    """An experiment of a hidden tank whose trials are not measured; and what measures them."""
    whole = folder / "hidden"
    path = write_tank(whole, Truth(BASE, effects), RUNS[:count], seed, numerics=TANK)
    measured = folder / "measured"
    measured.mkdir()
    shutil.copy(path, measured / "experiment.toml")
    captured = []

    def capture(trials):
        for trial in trials:
            captured.append(trial.file)
            one = folder / f"one_{trial.file}"
            run = trial.model_dump(exclude_defaults=True)
            write_tank(one, Truth(BASE, effects), [run], seed + len(captured), numerics=TANK)
            shutil.copy(one / trial.file, measured / trial.file)

    return measured / "experiment.toml", capture, captured


class Answers:
    """A `close` that answers with given verdicts, without looking at the data."""

    def __init__(self, *verdicts):
        self.verdicts, self.counts, self.kept = list(verdicts), [], []

    def __call__(self, given, progress, memo, kept):
        self.counts.append(len(given.trials))
        self.kept.append(kept)
        return SimpleNamespace(verdict=self.verdicts.pop(0), effects=[])


@pytest.fixture(autouse=True)
def short_report(request, monkeypatch):
    """What a report says, where the outcome is an `Answers`' own."""
    if "slow" not in request.keywords:

        def told(outcome, seconds, source, following):
            found = outcome.verdict
            return {"verdict": found, "said": found, "next_experiment": following}

        monkeypatch.setattr(module, "loop_record", told)


def following(trial_file):
    table = f'[[trials]]\nfile = "{trial_file}"\nfrequency = 3.0\namplitude = 1e5\nduration = 0.8\n'
    return {"purpose": "repeat", "said": "once more", "trial": {"file": trial_file}, "toml": table}


def test_it_measures_until_the_verdict_is_settled(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 5)
    files = iter(["x.csv", "y.csv", "z.csv"])
    monkeypatch.setattr(module, "next_experiment", lambda *a: following(next(files)))
    close = Answers("inconclusive", "unexplained", "nothing_missing")
    found = campaign(path, capture, tmp_path / "out", close=close)
    assert close.counts == [5, 6, 7] and found.settled
    assert close.kept == [[], ["x.csv"], ["x.csv", "y.csv"]]
    assert captured == [t["file"] for t in RUNS[:5]] + ["x.csv", "y.csv"]
    assert [x.verdict for x in found.rounds] == ["inconclusive", "unexplained", "nothing_missing"]
    assert json.loads((tmp_path / "out" / "round_06.json").read_text())["verdict"] == "unexplained"


def test_it_ends_with_its_budget_unsettled(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 4)
    files = iter("abcdef")
    monkeypatch.setattr(module, "next_experiment", lambda *a: following(f"{next(files)}.csv"))
    close = Answers(*["inconclusive"] * 9)
    found = campaign(path, capture, tmp_path / "out", budget=6, close=close)
    assert not found.settled and len(captured) == 6
    with pytest.raises(InputError, match="budget: given 3; allowed 6 trials"):
        campaign(path, capture, tmp_path / "out", budget=3, close=close)


def test_a_class_without_a_proposal_ends_unsettled(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 4)
    none = {"purpose": None, "said": "none", "trial": None, "toml": ""}
    answers = iter([following("x.csv"), none])
    monkeypatch.setattr(module, "next_experiment", lambda *a: next(answers))
    found = campaign(path, capture, tmp_path / "out", close=Answers("class", "class"))
    assert not found.settled and len(captured) == 5


def test_a_class_that_no_number_of_trials_makes_smaller_is_settled(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 4)
    answers = iter([following("x.csv") | {"times": 7}, following("y.csv") | {"times": None}])
    monkeypatch.setattr(module, "next_experiment", lambda *a: next(answers))
    found = campaign(path, capture, tmp_path / "out", close=Answers("class", "class"))
    assert found.settled and len(captured) == 5


def test_what_is_measured_is_not_measured_again(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 4)
    capture(experiment.load(path).trials[:3])
    captured.clear()
    close = Answers("identified")
    none = {"purpose": None, "said": "none", "trial": None, "toml": ""}
    monkeypatch.setattr(module, "next_experiment", lambda *a: none)
    campaign(path, capture, tmp_path / "out", close=close)
    assert captured == [RUNS[3]["file"]]


@pytest.mark.slow
def test_a_hidden_delay_is_named_within_the_budget(tmp_path):
    path, capture, captured = tank(tmp_path, {"valve_delay": {"delay": 0.02}}, 4, seed=3)
    close = partial(close_loop_on_trials, effects=CANDIDATES, fine=MESH, coarse=MESH)

    def still(given):
        return limits_of(given, {"tow_speed": (0.0, 0.0)})

    found = campaign(path, capture, tmp_path / "out", budget=8, limits=still, close=close)
    assert found.settled and found.outcome.effects == ["valve_delay"]
    assert len(captured) <= 8
