"""Campaigns: which trials are captured and added, and when the campaign ends."""

import json
import shutil
from functools import partial
from types import SimpleNamespace

import pytest

from calibration.discrepancy.close_loop import close_loop_on_trials
from calibration.experiment_design import campaign as module
from calibration.experiment_design.campaign import run_campaign
from calibration.experiment_design.trial_search import limits_of
from calibration.measurements.synthetic import Truth, write_tank
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from slider_jax.io.files import LOADED_FILES
from tests.support.small_tank import BASE, MESH, RUNS, TANK

pytestmark = pytest.mark.optimised

CANDIDATES = ("valve_delay", "clamp_compliance", "tangential_friction")


def tank(folder, effects, count, seed=0):
    """Returns an experiment without measured trials, a function that captures them, and a log.

    The function captures trials of a hidden tank.
    """
    path = write_tank(folder / "hidden", Truth(BASE, effects), RUNS[:count], seed, numerics=TANK)
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


class FakeLoop:
    """Replaces `close` and returns the given verdicts, whatever the data."""

    def __init__(self, *verdicts):
        self.verdicts, self.counts, self.kept = list(verdicts), [], []

    def __call__(self, given, progress, memo, kept):
        self.counts.append(len(given.trials))
        self.kept.append(kept)
        return SimpleNamespace(verdict=self.verdicts.pop(0), effects=[])


@pytest.fixture(autouse=True)
def short_report(monkeypatch):
    """Replaces the report by the verdict of a `FakeLoop`."""
    whole = module.loop_record

    def loop_record(outcome, seconds, source, following):
        if not isinstance(outcome, SimpleNamespace):
            return whole(outcome, seconds, source, following)
        verdict = outcome.verdict
        return {"verdict": verdict, "said": verdict, "next_experiment": following}

    monkeypatch.setattr(module, "loop_record", loop_record)


def following(trial_file):
    table = f'[[trials]]\nfile = "{trial_file}"\nfrequency = 3.0\namplitude = 1e5\nduration = 0.8\n'
    return {"purpose": "repeat", "said": "once more", "trial": {"file": trial_file}, "toml": table}


@pytest.mark.slow
def test_a_campaign_measures_until_the_verdict_is_final(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 5)
    files = iter(["x.csv", "y.csv", "z.csv"])
    monkeypatch.setattr(module, "next_experiment", lambda *a: following(next(files)))
    close = FakeLoop("inconclusive", "unexplained", "nothing_missing")
    found = run_campaign(path, capture, tmp_path / "out", close=close)
    assert close.counts == [5, 6, 7] and found.settled
    assert close.kept == [[], ["x.csv"], ["x.csv", "y.csv"]]
    assert captured == [t["file"] for t in RUNS[:5]] + ["x.csv", "y.csv"]
    assert [x["verdict"] for x in found.rounds] == [
        "inconclusive",
        "unexplained",
        "nothing_missing",
    ]
    assert json.loads((tmp_path / "out" / "round_06.json").read_text())["verdict"] == "unexplained"


@pytest.mark.slow
def test_a_campaign_ends_at_its_budget_without_a_final_verdict(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 4)
    files = iter("abcdef")
    monkeypatch.setattr(module, "next_experiment", lambda *a: following(f"{next(files)}.csv"))
    close = FakeLoop(*["inconclusive"] * 9)
    found = run_campaign(path, capture, tmp_path / "out", budget=6, close=close)
    assert not found.settled and len(captured) == 6
    with pytest.raises(InputError, match="budget: given 3; allowed 6 "):
        run_campaign(path, capture, tmp_path / "out", budget=3, close=close)


@pytest.mark.slow
def test_a_campaign_ends_if_no_trial_is_proposed(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 4)
    none = {"purpose": None, "said": "none", "trial": None, "toml": ""}
    answers = iter([following("x.csv"), none])
    monkeypatch.setattr(module, "next_experiment", lambda *a: next(answers))
    found = run_campaign(path, capture, tmp_path / "out", close=FakeLoop("class", "class"))
    assert not found.settled and len(captured) == 5


def test_a_class_that_no_trial_makes_smaller_is_final(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 4)
    answers = iter([following("x.csv") | {"times": 7}, following("y.csv") | {"times": None}])
    monkeypatch.setattr(module, "next_experiment", lambda *a: next(answers))
    found = run_campaign(path, capture, tmp_path / "out", close=FakeLoop("class", "class"))
    assert found.settled and len(captured) == 5


def test_a_campaign_stops_if_an_effect_file_changes(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 4)
    monkeypatch.setattr(module, "next_experiment", lambda *a: following("x.csv"))
    monkeypatch.setitem(LOADED_FILES, tmp_path / "deleted.py", "digest")
    with pytest.raises(InputError, match=r"deleted.py: the effect file has changed or is missing"):
        run_campaign(path, capture, tmp_path / "out", close=FakeLoop("inconclusive"))
    assert len(captured) == 4 and not list(tmp_path.glob("out/round*"))


def test_measured_trials_are_not_captured_again(tmp_path, monkeypatch):
    path, capture, captured = tank(tmp_path, {}, 4)
    capture(load(path).trials[:3])
    captured.clear()
    close = FakeLoop("identified")
    none = {"purpose": None, "said": "none", "trial": None, "toml": ""}
    monkeypatch.setattr(module, "next_experiment", lambda *a: none)
    run_campaign(path, capture, tmp_path / "out", close=close)
    assert captured == [RUNS[3]["file"]]


@pytest.mark.slow
def test_a_campaign_names_a_hidden_delay_within_its_budget(tmp_path):
    path, capture, captured = tank(tmp_path, {"valve_delay": {"delay": 0.02}}, 4, seed=3)
    close = partial(close_loop_on_trials, effects=CANDIDATES, fine=MESH, coarse=MESH)

    def still(given):
        return limits_of(given, {"tow_speed": (0.0, 0.0)})

    found = run_campaign(path, capture, tmp_path / "out", budget=8, limits=still, close=close)
    assert found.settled and found.outcome.effects == ["valve_delay"]
    assert len(captured) <= 8
