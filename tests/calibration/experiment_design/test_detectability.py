"""Detection limits and discrimination of effects, on two short trials with a coarse mesh."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import norm

from calibration.discrepancy.rounds import effect_entries
from calibration.discrepancy.scores import score, tangent_cosine
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.experiment_design.detectability import (
    DETECTION_MARGIN,
    detectability_matrix,
    effects_at_limits,
    required_gain,
)
from calibration.experiment_design.detectability_report import detectability_record, matrix_table
from calibration.experiment_design.information import SensorModel, information, predict_information
from calibration.experiment_design.pair_distance import effect_pairs, separating_trial
from calibration.experiment_design.trial_search import SearchEffort, limits_of, trial_toml
from calibration.inference.cache import Memo
from calibration.inference.noise import Whitener
from calibration.inference.problem import ChannelBlock, TankProblem
from calibration.measurements.records import Record
from calibration.model.extended import BASE, candidate_effects
from calibration.model.plan import Resolution
from calibration.model.predict import predict_readings
from calibration.model.tangents import reading_tangents
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.cli.main import COMMANDS, find, main
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from tests.support import closed_form_tank
from tests.support.experiments import write_small_experiment
from tests.support.still_tank import EFFECTS, LIMITS, MESH, STILL

FEW = SearchEffort(spread=5, rounds=1)


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """The detectability matrix of an experiment in still water without data."""
    return detectability_matrix(
        load(write_small_experiment(tmp_path_factory.mktemp("still"), *STILL)), EFFECTS, coarse=MESH
    )


@pytest.fixture(scope="module")
def entries(still):
    return still.information.entries


def limit_of(still, effect):
    (found,) = still.limit[effect]
    return found


def measured(still, theta, seed):
    """Returns records of the trials at `theta` with the declared noise."""
    rng, found = np.random.default_rng(seed), []
    for trial in still.information.experiment.trials:
        p = still.information.plan(trial)
        y = predict_readings(p, theta)
        for channel, noise in still.information.sensing.noise.items():
            # The covariance's Cholesky factor times white noise has the declared covariance.
            row = SLIDER_CHANNELS.row(channel)
            white = Whitener(p.at, noise, y[row], p.trial.frequency)
            y[row] += np.linalg.solve(white(np.eye(len(p.at))).T, rng.normal(size=len(p.at)))
        found.append(Record(trial, p.at, y, SLIDER_CHANNELS))
    return found


def gain(still, effect, size, seed):
    """Returns the score of an effect of the true `size` on noisy readings."""
    f = still.information
    theta, group = f.theta.copy(), effect_entries(f.entries)[effect]
    theta[group] += size
    problem = TankProblem.of(
        f.experiment, measured(still, theta, seed), EFFECTS, SLIDER_CHANNELS, MESH, MESH
    )
    predicted = problem.predict(f.theta)
    white = problem.whiteners(predicted)
    residuals = problem.residuals(predicted, white)
    blocks = problem.blocks(residuals, problem.tangents(f.theta, np.eye(len(theta))), white)
    return score(effect, group, np.arange(len(BASE)), blocks, 1.0, len(candidate_effects())).gain


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["axial_added_mass", "pressure_gain"])
def test_an_effect_of_three_times_the_limit_is_significant_and_a_null_effect_is_not(still, effect):
    size = limit_of(still, effect).significant
    assert gain(still, effect, 3.0 * size, seed=1) > 3.0 * DEFAULT_SETTINGS.min_gain
    assert gain(still, effect, 0.0, seed=2) < DEFAULT_SETTINGS.min_gain


@pytest.mark.slow
def test_the_expected_gain_at_the_limit_is_the_required_gain(still, entries):
    A = information(still.channels)
    i = effect_entries(entries)["force_gain"]
    size = limit_of(still, "force_gain").significant
    block = [ChannelBlock(0, "", A, size * A[:, i[0]], 0.0, 1)]
    found = score("force_gain", i, np.arange(4), block, 1.0, len(candidate_effects()))
    assert found.gain == pytest.approx(required_gain(1, len(candidate_effects())), rel=1e-6)


@pytest.mark.slow
def test_nine_of_ten_effects_are_detected_at_the_limit(still, entries):
    A, i = information(still.channels), effect_entries(entries)["force_gain"]
    found = limit_of(still, "force_gain")
    size = found.significant + DETECTION_MARGIN * found.error
    rng = np.random.default_rng(0)
    values, vectors = np.linalg.eigh(A)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    passed = 0
    for _ in range(600):
        b = size * A[:, i[0]] + root @ rng.normal(size=len(A))
        block = [ChannelBlock(0, "", A, b, 0.0, 1)]
        gain = score("force_gain", i, np.arange(4), block, 1.0, len(candidate_effects())).gain
        passed += gain > required_gain(1, len(candidate_effects()))
    assert passed / 600 == pytest.approx(0.9, abs=0.03)


@pytest.mark.slow
def test_a_nameable_effect_changes_a_channel_by_its_discrepancy(still, entries):
    """The reference is least squares on the stacked rows."""
    f, i = still.information, effect_entries(entries)["carried_mass"][0]
    white, raw, signal = [], {c: [] for c in SLIDER_CHANNELS}, {c: [] for c in SLIDER_CHANNELS}
    for trial in f.experiment.trials:
        p = f.plan(trial)
        y, J = (
            predict_readings(p, f.theta),
            reading_tangents(p, f.theta, np.eye(len(f.theta))[[0, 1, 2, 3, i]]),
        )
        for row, channel in enumerate(SLIDER_CHANNELS):
            noise = f.sensing.noise[channel]
            whiten = Whitener(p.at, noise, y[row], trial.frequency)
            white.append(whiten(J[:, row]))
            raw[channel].append(J[:, row])
            signal[channel].append(y[row])
    rows = np.concatenate(white, axis=1).T
    absorbed = np.linalg.lstsq(rows[:, :4], -rows[:, 4], rcond=None)[0]
    shares = []
    for channel in SLIDER_CHANNELS:
        change = np.append(absorbed, 1.0) @ np.concatenate(raw[channel], axis=1)
        share = np.sqrt(np.mean(change**2) / np.mean(np.concatenate(signal[channel]) ** 2))
        shares.append(
            limit_of(still, "carried_mass").nameable * share / SLIDER_CHANNELS[channel].discrepancy
        )
    assert max(shares) == pytest.approx(1.0, rel=1e-5)


@pytest.mark.slow
def test_gains_of_sensor_and_regulator_form_a_class(still):
    """K_Q compensates for a larger pressure, because the lag is linear."""
    i, j = still.names.index("pressure_gain"), still.names.index("regulator_gain")
    assert still.cosines[i, j] > 0.9999
    assert ["pressure_gain", "regulator_gain"] in still.classes
    assert "cannot discriminate between" in matrix_table(still)


def test_signs_discriminate_between_opposite_effects(still):
    i, j = still.names.index("actuator_saturation"), still.names.index("actuator_quadratic")
    assert still.cosines[i, j] > 0.9999 and still.opposed[i, j]
    assert not any("actuator_quadratic" in group for group in still.classes)
    pair = "actuator_saturation, actuator_quadratic"
    assert f"discriminated by the sign only: {pair}" in matrix_table(still)


def test_a_nonlinear_effect_gets_a_secant(still, entries):
    assert {entries[i].effect for i in still.information.secants} == {"surge_compliance"}
    assert limit_of(still, "surge_compliance").finite


def test_pressure_sensors_alone_do_not_observe_the_body(tmp_path, still):
    path = write_small_experiment(tmp_path, ("[sensors]\n", "[sensors]\npressure_noise = 700.0\n"))
    found = detectability_matrix(load(path), EFFECTS, coarse=MESH)
    assert list(found.information.sensing.noise) == ["p_front", "p_rear"]
    assert limit_of(found, "carried_mass").share == 0.0
    assert limit_of(found, "pressure_gain").share > 0.5
    assert "carried_mass" not in sum(found.classes, [])
    assert "not detectable" in matrix_table(found)
    assert np.isnan(found.cosines[found.names.index("carried_mass")]).all()


def test_an_experiment_without_noise_is_refused(tmp_path):
    with pytest.raises(InputError, match="add sensors.pressure_noise"):
        predict_information(load(write_small_experiment(tmp_path)), EFFECTS)


def test_measured_trials_keep_their_samples_and_channels(tmp_path, still):
    experiment = load(write_small_experiment(tmp_path, *STILL))
    t = np.arange(0.0, 0.7, 0.005)
    tip = [f"{1e-3 * np.sin(x):.6f}" if i % 5 == 0 else "" for i, x in enumerate(t)]
    rows = [f"{x:.4f},{1e5 * np.sin(x):.1f},{y}" for x, y in zip(t, tip, strict=True)]
    text = "\n".join(["t_s,p_front_Pa,tip_m", *rows])
    (tmp_path / "trial_00.csv").write_text(text + "\n")
    found = SensorModel.of(experiment)
    assert list(found.noise) == ["p_front", "tip"]
    assert found.every == {"p_front": 1, "tip": 5}
    assert found.samples(experiment.trials[0], "tip", len(t)).sum() == 28
    assert found.samples(experiment.trials[1], "tip", 100).sum() == 20


def proposal(still, tow):
    names = ("carried_mass", "axial_added_mass")
    limits = limits_of(still.information.experiment, LIMITS | {"tow_speed": tow})
    return separating_trial(*effects_at_limits(still, names), limits, FEW)


@pytest.fixture(scope="module")
def towed(still):
    return proposal(still, (0.0, 0.25))


@pytest.mark.slow
def test_a_towed_trial_discriminates_mass_from_axial_added_mass(still, towed):
    (pair,) = towed["pairs"]
    assert pair["cos_before"] > DEFAULT_SETTINGS.parallel_cosine
    assert towed["trial"]["tow_speed"] > 0.1
    (without,) = proposal(still, (0.0, 0.0))["pairs"]
    assert pair["cos_after"] < 0.9 < without["cos_after"]
    assert pair["sigmas_after"] > 1.5 * without["sigmas_after"]


@pytest.mark.slow
def test_the_proposed_trial_has_the_predicted_information(still, towed, tmp_path):
    path = write_small_experiment(tmp_path, *STILL)
    path.write_text(f"{path.read_text()}\n{towed['toml']}")
    experiment = load(path)
    assert experiment.trials[2].tow_speed == towed["trial"]["tow_speed"]
    assert trial_toml(experiment.trials[2]) == towed["toml"]
    f, before, indices, _ = effects_at_limits(still, ("carried_mass", "axial_added_mass"))
    A = before + information(replace(f, experiment=experiment).trial(experiment.trials[2]))
    cos = tangent_cosine(A, *indices.values(), np.arange(4))
    assert cos == pytest.approx(towed["pairs"][0]["cos_after"], rel=1e-9)


def test_a_predicted_trial_is_not_simulated_again(still, tmp_path, monkeypatch):
    f = replace(still.information, memo=Memo(tmp_path))
    trial = f.experiment.trials[0]
    first = f.trial(trial)
    for name in ("predict_readings", "predict_each"):
        monkeypatch.setattr(f"calibration.experiment_design.information.{name}", None)
    for one, other in zip(first, f.trial(trial), strict=True):
        np.testing.assert_array_equal(one.A, other.A)
    others = (
        f,
        replace(f, chosen=f.chosen[:-1]),
        replace(f, secants={int(f.chosen[-1]): 0.02}),
        replace(f, coarse=Resolution(15, 40, 6.0e-3)),
    )
    louder = trial.model_copy(update={"amplitude": 1.01 * trial.amplitude})
    for other, x in zip(others, (louder, trial, trial, trial), strict=True):
        with pytest.raises(TypeError):
            other.trial(x)


def test_an_unreachable_discrimination_is_reported(still):
    limits = limits_of(still.information.experiment, LIMITS)
    names = ("pressure_gain", "regulator_gain")
    found = separating_trial(
        *effects_at_limits(still, names), limits, SearchEffort(spread=2, rounds=0)
    )
    assert found["pairs"][0]["sigmas_after"] < 0.1
    assert "No trial within the limits reaches" in found["said"]


def test_default_limits_are_the_ranges_of_the_trials_widened(still):
    found = limits_of(still.information.experiment)
    assert found.frequency == (2.25, 4.4)
    assert found.amplitude == (135e3, 275e3)
    assert found.phase == (0.09, 0.11)
    assert found.tow_speed == (0.0, 0.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--separate", "carried_mas", "tip_mass"], "did you mean carried_mass?"),
        (["--only", "gravity"], "--only: given 'gravity'"),
        (["--separate", "tip_mass"], "--separate: given one effect; allowed two or more"),
        (["--frequency", "1", "2"], "--frequency: works only with --separate"),
        (["--frequency", "3", "2"], "--frequency: given 3 2; allowed LOW HIGH"),
        (["--amplitude", "100", "300"], "--amplitude: given 100; allowed 0, or 1000 to 2e+06 Pa"),
        (["--tow-speed", "0", "9"], "--tow-speed: given 9; allowed -3 to 3 m/s"),
    ],
)
def test_invalid_options_are_refused_by_name(options, message, tmp_path, capsys):
    pair = ["--separate", "tip_mass", "carried_mass"]
    extra = pair if "allowed" in message and "--separate" not in options else []
    out = tmp_path / "out"
    arguments = [str(write_small_experiment(tmp_path, *STILL)), "--out", str(out), *options, *extra]
    assert main(["effects", "matrix", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_the_command_writes_json_picture_and_trial(still, tmp_path, monkeypatch, capsys):
    calls = []

    def fake_matrix(*arguments, memo):
        assert memo.folder.parent == out
        calls.append(arguments)
        return still

    monkeypatch.setattr(
        "calibration.experiment_design.detectability.detectability_matrix", fake_matrix
    )
    monkeypatch.setattr(
        "calibration.experiment_design.pair_distance.separating_trial",
        partial(separating_trial, effort=SearchEffort(2, 0)),
    )
    path, out = write_small_experiment(tmp_path, *STILL), tmp_path / "out"
    arguments = ["--out", str(out), "--separate", "force_gain", "carried_mass"]
    assert main(["effects", "matrix", str(path), *arguments]) == 0
    assert calls[0][1] == ("force_gain", "carried_mass")
    record = json.loads((out / "matrix.json").read_text())
    n = len(EFFECTS)
    assert np.array(record["alike"]).shape == (n, n) and len(record["limits"]) == n
    assert record["settings"]["name"] == "small" and "jax" in record["versions"]
    assert (out / "matrix.png").stat().st_size > 1e4
    assert (out / "next_trial.toml").read_text() == record["next_trial"]["toml"]
    text = capsys.readouterr().out
    assert "[[trials]]" in text and "standard deviations" in text


def test_the_record_agrees_with_the_table(still):
    record = detectability_record(still, {})
    assert ["pressure_gain", "regulator_gain"] in record["classes"]
    assert record["told_by_sign"] == [["actuator_saturation", "actuator_quadratic"]]
    (row,) = [x for x in record["limits"] if x["effect"] == "force_gain"]
    decided = max(row["significant_from"], row["worth_naming_from"])
    assert row["limit"] == pytest.approx(decided + norm.ppf(0.9) * row["standard_error"], rel=1e-4)


def test_matrix_is_a_command_and_other_words_after_effects_are_effects():
    assert find(["effects", "matrix", "x.toml"]) == ("effects matrix", ["x.toml"])
    assert find(["effects", "gravity"]) == ("effects", ["gravity"])
    assert main(["effects"]) == 0
    assert list(COMMANDS).index("effects matrix") < list(COMMANDS).index("effects")


@pytest.mark.parametrize("sizes", [(0.1, 2.0), (2.0, 0.1)])
def test_the_distance_of_a_pair_is_the_smaller_least_squares_residual(sizes):
    J = np.random.default_rng(0).normal(size=(60, 4))
    J[:, 3] += 2.0 * J[:, 2] + J[:, 0]
    indices = {"a": np.array([2]), "b": np.array([3])}
    at = {name: np.array([size]) for name, size in zip("ab", sizes, strict=True)}
    (pair,) = effect_pairs(J.T @ J, indices, at, np.array([0, 1]))

    def residual(i, others, size):
        square = np.linalg.lstsq(J[:, others], size * J[:, i], rcond=None)[1][0]
        return np.sqrt(square)

    both = residual(2, [0, 1, 3], sizes[0]), residual(3, [0, 1, 2], sizes[1])
    assert pair.sigmas == pytest.approx(min(both), rel=1e-9)
    assert min(both) < 0.5 * max(both)


def test_shapes_have_no_detection_limit_and_do_not_shift_the_other_limits(monkeypatch):
    closed_form_tank.replace_the_beam(monkeypatch)
    experiment = closed_form_tank.experiment_of((2.0, 3.0))
    names = ("internal_friction", "valve_deadband", "carried_mass")
    found = detectability_matrix(experiment, names, coarse=closed_form_tank.MESH)
    limits = {x.parameter.label: x for x in found.limits}
    assert len(limits) == 3 and "internal_friction.kappa_c" not in limits
    assert [x.finite for x in limits.values()] == [False, True, False]
    assert all(np.isfinite(x.size) for x in limits.values())
