"""The loop on pressure logs: from a chamber with known valves, from a lag, and from the rig."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.discrepancy.report import loop_model_toml, loop_record
from calibration.inference.cache import Memo, resumable
from calibration.model.extended import base_values, base_vector, model_parameters
from calibration.pressure_logs.close_loop import close_loop_on_logs
from calibration.pressure_logs.problem import PressureLogProblem, log_candidates, log_experiment
from calibration.pressure_logs.read import read_log
from calibration.pressure_logs.synthetic import Valves, write_logs
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.errors import InputError
from tests.support.synthetic_log import log_lines, write_log

TRUTH = Valves(fill=2.4, vent=1.9, supply=420e3, critical=0.35, dead=0.1)
NAMES = ("firmware_valves", "pulsed_valves")
FREQUENCIES = (0.8, 1.1, 1.5, 2.0, 2.6)
RIG_FREQUENCIES = ("0.55556", "0.86111", "1.1667", "1.4722", "1.7778")


def shortened(log, samples):
    """Returns the first `samples` of a log."""
    here = np.round(log.t / log.period) < samples
    series = {n: getattr(log, n)[here] for n in ("t", "command", "pressure", "fill", "vent")}
    return replace(log, **series)


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    paths = write_logs(tmp_path_factory.mktemp("valves"), TRUTH, FREQUENCIES, cycles=1.5)
    return [read_log(path) for path in paths]


class Stopped(Exception):
    pass


def stop_at(message):
    """Returns a progress function that ends the run at a text that begins with `message`."""

    def progress(text):
        if text.startswith(message):
            raise Stopped

    return progress


@pytest.fixture(scope="module")
def outcome(logs, tmp_path_factory):
    """The outcome of a run that was interrupted and resumed."""
    memo = Memo(tmp_path_factory.mktemp("memo"))
    with pytest.raises(Stopped):
        close_loop_on_logs(logs, NAMES, stop_at("refitting with each of:"), memo)
    before = {path: path.stat().st_mtime_ns for path in memo.folder.iterdir()}
    assert len(before) > 5
    found = close_loop_on_logs(logs, NAMES, memo=memo)
    assert {path: path.stat().st_mtime_ns for path in before} == before, "a cached file changed"
    return found


@pytest.mark.slow
def test_the_valves_are_identified_with_their_parameters(outcome):
    assert outcome.verdict == "identified"
    assert outcome.search.effects == ["firmware_valves"]
    labels = [p.label for p in outcome.entries]
    for name, value in TRUTH._asdict().items():
        _, low, high = outcome.interval(labels.index(f"firmware_valves.{name}"))
        assert low < value < high, name


@pytest.mark.slow
def test_held_out_logs_are_predicted_to_the_noise(outcome):
    errors = outcome.held_out["p_front"]
    held = [outcome.problem.records[i] for i in outcome.held]
    assert [r.trial.frequency for r in held] == [1.1, 1.1, 2.0, 2.0]
    assert errors["before"] > 10.0 * errors["after"]
    assert errors["after"] < 1.1 * errors["floor"]


def test_the_halves_of_a_log_are_two_trials_of_one_simulation(logs):
    problem = PressureLogProblem.of_logs(logs[1:3], NAMES)
    theta = base_vector(model_parameters(NAMES), base_values(log_experiment(logs[0], None, {})))
    predicted = [x[SLIDER_CHANNELS.row("p_front")] for x in problem.predict(theta)]
    for i, log in enumerate(logs[1:3]):
        halves = problem.records[2 * i : 2 * i + 2]
        np.testing.assert_array_equal(np.concatenate([r.t for r in halves]), log.t)
        measured = np.concatenate([r.values[SLIDER_CHANNELS.row("p_front")] for r in halves])
        np.testing.assert_array_equal(measured, log.pressure_Pa)
        alone = PressureLogProblem.of_logs([log], NAMES).predict(theta)
        whole = np.concatenate(predicted[2 * i : 2 * i + 2])
        np.testing.assert_allclose(
            whole, np.concatenate([x[SLIDER_CHANNELS.row("p_front")] for x in alone]), atol=1e-3
        )
        assert whole[0] == log.pressure_Pa[0]
    names = [r.trial.file for r in problem.records[:2]]
    assert names == ["1.1.txt, first half", "1.1.txt, second half"]


@pytest.mark.slow
def test_the_alternative_effect_is_refitted_and_has_a_larger_residual(outcome):
    tried = {t.name: t for t in outcome.search.rounds[0].refitted}
    assert "pulsed_valves" in tried
    best = tried.pop("firmware_valves")
    assert all(t.fit.square > 3.0 * best.fit.square for t in tried.values())


@pytest.mark.slow
def test_a_resumed_run_gives_the_result_of_an_uninterrupted_one(outcome, logs):
    again = close_loop_on_logs(logs, NAMES)
    np.testing.assert_array_equal(again.final.theta, outcome.final.theta)
    assert loop_model_toml(again) == loop_model_toml(outcome)


@pytest.mark.slow
def test_the_verdict_on_logs_of_a_lag_is_nothing_missing(tmp_path):
    made = [
        read_log(write_log(tmp_path / f"{f:g}.txt", log_lines(0.12, f, noise=1.7, seed=i)))
        for i, f in enumerate(FREQUENCIES)
    ]
    found = close_loop_on_logs(made, NAMES)
    assert (found.verdict, found.search.effects) == ("nothing_missing", [])
    assert found.interval(2)[1] < 0.12 < found.interval(2)[2]


@pytest.mark.slow
def test_the_rigs_logs_lack_the_firmwares_valves(data):
    """Five of the rig's logs, cut to the length of the synthetic ones to share their programs."""
    whole = [read_log(data / "manifold" / f"{f}.txt") for f in RIG_FREQUENCIES]
    outcome = close_loop_on_logs([shortened(log, 938) for log in whole], NAMES)
    record = loop_record(outcome, 0.0, {})
    assert record["verdict"] == outcome.verdict == "partly_explained"
    (effect,) = record["effects"]
    assert (effect["name"], effect["status"]) == ("firmware_valves", "provisional")
    assert record["residual"]["channels"]["p_front"]["mean_square"] > 1.5
    squares = {t.name: t.fit.square for t in outcome.search.rounds[0].refitted}
    assert squares["pulsed_valves"] > 2.0 * squares["firmware_valves"]
    assert "code_density" in [x["kind"] for x in record["audit"]]
    for errors in (record["errors"]["p_front"], record["held_out"]["p_front"]):
        assert errors["after"] < 0.2 * errors["before"]


def test_too_few_logs_are_refused(logs):
    with pytest.raises(InputError, match=r"2 logs given; .* needs 5 or more"):
        close_loop_on_logs(logs[:2], NAMES)


def test_a_truncated_cache_file_is_recomputed(tmp_path):
    memo = Memo(tmp_path)
    memo.cached("a", [], lambda: [np.arange(1000.0)])
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:-100])
    (found,) = memo.cached("a", [], lambda: [np.arange(1000.0)])
    np.testing.assert_array_equal(found, np.arange(1000.0))


def test_a_run_that_fails_before_the_first_simulation_leaves_no_folder(tmp_path):
    with pytest.raises(InputError), resumable(tmp_path / "out", {}):
        raise InputError("the arguments are wrong")
    assert not (tmp_path / "out").exists()


def test_the_clock_of_the_drive_is_no_candidate_because_the_logs_have_one_clock():
    assert "valve_delay" in log_candidates() and "drive_clock" not in log_candidates()
