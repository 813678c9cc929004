"""Tests of the command `slider close-loop`, with a loop that is interrupted or ends at once."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.cli import close_loop as command
from slider_jax.cli.main import main
from tests.support.experiments import write_small_experiment
from tests.support.own_effects import restored_library, write_effect


class Loop:
    """Replaces the loop: caches an array and is then interrupted. Records candidates and work."""

    def __init__(self):
        self.candidates, self.computed = (), 0

    def __call__(self, experiment, names, inputs, memo, progress, seconds):
        def make():
            self.computed += 1
            return [np.zeros(1)]

        self.candidates = names
        memo.cached("array", [], make)
        raise KeyboardInterrupt


@pytest.fixture
def interrupted(tmp_path, monkeypatch, capsys):
    """A function that runs the command in a new library. Returns (loop, lines of stderr)."""
    loop, experiment = Loop(), write_small_experiment(tmp_path)
    monkeypatch.setattr(command, "_close_on_experiment", loop)

    def run(path):
        words = ["close-loop", experiment, "--out", tmp_path / "out", "--effects", path]
        with restored_library():
            assert main([str(word) for word in words]) == 130
        return loop, capsys.readouterr().err.splitlines()

    return run


def test_the_effects_of_the_file_are_candidates(tmp_path, interrupted):
    loop, _ = interrupted(write_effect(tmp_path / "wall.py"))
    assert loop.candidates[-1] == "wall_friction"


def test_an_interrupted_run_resumes_only_with_the_same_effect_file(tmp_path, interrupted):
    path = write_effect(tmp_path / "wall.py")
    interrupted(path)
    loop, lines = interrupted(path)
    assert loop.computed == 1
    assert lines[0].startswith("resuming the interrupted run from")

    write_effect(path, ("0.0, 10.0", "0.0, 20.0"))
    loop, lines = interrupted(path)
    assert loop.computed == 2
    assert "other effect files or with other content of these files" in lines[0]


@pytest.mark.parametrize("at_floor", [True, False])
def test_the_report_describes_the_outcome_after_learning(monkeypatch, at_floor):
    """A function at the noise floor proposes the next trial, and no other trial is searched for."""
    before, after = object(), object()
    learning = SimpleNamespace(outcome=after, reaches_floor=at_floor)
    written = {"status": "learned", "above_floor": [], "said": "F.", "test": "trial of F"}
    if not at_floor:
        written["above_floor"] = ["tip"]
    searched = []

    def following(outcome, progress):
        searched.append(outcome)
        return "another trial"

    for name, result in {
        "discrepancy.close_loop.close_loop_on_trials": lambda *_, **__: before,
        "learning.learn.learn_terms": lambda outcome, _: learning if outcome is before else None,
        "learning.report.learned_record": lambda *_: written,
        "experiment_design.next_experiment.next_experiment": following,
        "discrepancy.report.loop_record": lambda outcome, _, __, following: {
            "outcome": outcome,
            "said": "A.",
            "verdict": "unexplained",
            "next_experiment": following,
        },
    }.items():
        monkeypatch.setattr(f"calibration.{name}", result)
    monkeypatch.setattr("slider_jax.io.files.input_file", lambda path: {})
    outcome, record, _ = command._close_on_experiment(None, (), ["a.toml"], None, print, float)
    assert outcome is record["outcome"] is after
    assert searched == ([] if at_floor else [after])
    expected = ("learned", "trial of F") if at_floor else ("partly_explained", "another trial")
    assert (record["verdict"], record["next_experiment"]) == expected
