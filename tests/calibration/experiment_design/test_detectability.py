"""What an experiment could find and separate, on two short trials of a coarse mesh."""

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
    POWER,
    at_limits,
    detectability_matrix,
    required_gain,
)
from calibration.experiment_design.detectability_report import detectability_record, matrix_table
from calibration.experiment_design.information import (
    SensorModel,
    as_block,
    information,
    predict_information,
)
from calibration.experiment_design.pair_distance import pairs_of, separate
from calibration.experiment_design.trial_search import SearchEffort, limits_of, trial_toml
from calibration.inference.cache import Memo
from calibration.inference.noise import Whitener
from calibration.inference.problem import ChannelBlock, TankProblem
from calibration.measurements.records import Record
from calibration.model.extended import BASE, candidates
from calibration.model.predict import Resolution, predict, tangents
from slider_jax.channels import CHANNELS, row_of
from slider_jax.cli.main import COMMANDS, find, main
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from tests.support.experiments import write
from tests.support.still_tank import EFFECTS, LIMITS, MESH, STILL

FEW = SearchEffort(spread=5, rounds=1)


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """Of an experiment in still water, nothing measured."""
    return detectability_matrix(
        load(write(tmp_path_factory.mktemp("still"), *STILL)), EFFECTS, coarse=MESH
    )


@pytest.fixture(scope="module")
def entries(still):
    return still.information.entries


def limit_of(still, effect):
    (found,) = still.limit[effect]
    return found


def measured(still, theta, seed):
    """The trials' readings at `theta`, with noise as it is declared."""
    rng, found = np.random.default_rng(seed), []
    for trial in still.information.experiment.trials:
        p = still.information.plan(trial)
        y = predict(p, theta)
        for channel, noise in still.information.sensing.noise.items():
            # A lower-triangular factor times white noise is noise of the whitener's covariance.
            row = row_of(channel)
            white = Whitener(p.at, noise, y[row], channel, p.trial.frequency)
            y[row] += np.linalg.solve(white(np.eye(len(p.at))).T, rng.normal(size=len(p.at)))
        found.append(Record(trial, p.at, y))
    return found


def gain(still, effect, size, seed):
    """The search's score of an effect that is there at `size`, on noisy readings."""
    f = still.information
    theta, group = f.theta.copy(), effect_entries(f.entries)[effect]
    theta[group] += size
    problem = TankProblem.of(
        f.experiment, measured(still, theta, seed), EFFECTS, CHANNELS, MESH, MESH
    )
    predicted = problem.predict(f.theta)
    white = problem.whiteners(predicted)
    residuals = problem.residuals(predicted, white)
    blocks = problem.blocks(residuals, problem.tangents(f.theta, np.eye(len(theta))), white)
    return score(effect, group, np.arange(len(BASE)), blocks, 1.0, len(candidates())).gain


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["axial_added_mass", "pressure_gain"])
def test_three_times_the_limit_is_found_in_noise_and_nothing_is_not(still, effect):
    size = limit_of(still, effect).significant
    assert gain(still, effect, 3.0 * size, seed=1) > 3.0 * DEFAULT_SETTINGS.min_gain
    assert gain(still, effect, 0.0, seed=2) < DEFAULT_SETTINGS.min_gain


@pytest.mark.slow
def test_the_expected_gain_at_the_limit_is_what_the_search_asks_for(still, entries):
    A = information(still.channels)
    i = effect_entries(entries)["force_gain"]
    size = limit_of(still, "force_gain").significant
    block = [ChannelBlock(0, "", A, size * A[:, i[0]], 0.0, 1)]
    found = score("force_gain", i, np.arange(4), block, 1.0, len(candidates()))
    assert found.gain == pytest.approx(required_gain(1, len(candidates())), rel=1e-6)


def test_nine_of_ten_are_found_at_the_detection_limit(still, entries):
    A, i = information(still.channels), effect_entries(entries)["force_gain"]
    found = limit_of(still, "force_gain")
    # Of the two bounds the one by chance; the other is a size, passed by as much.
    size = found.significant + POWER * found.error
    rng = np.random.default_rng(0)
    values, vectors = np.linalg.eigh(A)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    passed = 0
    for _ in range(600):
        b = size * A[:, i[0]] + root @ rng.normal(size=len(A))
        block = [ChannelBlock(0, "", A, b, 0.0, 1)]
        gain = score("force_gain", i, np.arange(4), block, 1.0, len(candidates())).gain
        passed += gain > required_gain(1, len(candidates()))
    assert passed / 600 == pytest.approx(0.9, abs=0.03)


def test_what_is_worth_naming_changes_a_channel_by_what_programs_differ_by(still, entries):
    """Against least squares on the stacked rows."""
    f, i = still.information, effect_entries(entries)["carried_mass"][0]
    white, raw, signal = [], {c: [] for c in CHANNELS}, {c: [] for c in CHANNELS}
    for trial in f.experiment.trials:
        p = f.plan(trial)
        y, J = predict(p, f.theta), tangents(p, f.theta, np.eye(len(f.theta))[[0, 1, 2, 3, i]])
        for row, channel in enumerate(CHANNELS):
            noise = f.sensing.noise[channel]
            whiten = Whitener(p.at, noise, y[row], channel, trial.frequency)
            white.append(whiten(J[:, row]))
            raw[channel].append(J[:, row])
            signal[channel].append(y[row])
    rows = np.concatenate(white, axis=1).T
    absorbed = np.linalg.lstsq(rows[:, :4], -rows[:, 4], rcond=None)[0]
    shares = []
    for channel in CHANNELS:
        change = np.append(absorbed, 1.0) @ np.concatenate(raw[channel], axis=1)
        share = np.sqrt(np.mean(change**2) / np.mean(np.concatenate(signal[channel]) ** 2))
        shares.append(
            limit_of(still, "carried_mass").nameable * share / CHANNELS[channel].discrepancy
        )
    assert max(shares) == pytest.approx(1.0, rel=1e-5)


def test_a_gain_of_the_sensor_and_one_of_the_regulator_are_one_class(still):
    """K_Q makes up for what a larger pressure bends, as the lag is linear."""
    i, j = still.names.index("pressure_gain"), still.names.index("regulator_gain")
    assert still.alike[i, j] > 0.9999
    assert ["pressure_gain", "regulator_gain"] in still.classes
    assert "cannot be told apart" in matrix_table(still)


def test_opposite_changes_are_told_apart_by_their_sign(still):
    i, j = still.names.index("actuator_saturation"), still.names.index("actuator_quadratic")
    assert still.alike[i, j] > 0.9999 and still.opposed[i, j]
    assert not any("actuator_quadratic" in group for group in still.classes)
    assert "told apart by the sign alone: actuator_saturation, actuator_quadratic" in matrix_table(
        still
    )


def test_a_mounting_whose_tangent_says_little_gets_a_finite_start(still, entries):
    assert {entries[i].effect for i in still.information.secants} == {"surge_compliance"}
    assert limit_of(still, "surge_compliance").finite


def test_without_force_and_tip_sensors_the_body_cannot_be_seen(tmp_path, still):
    path = write(tmp_path, ("[sensors]\n", "[sensors]\npressure_noise = 700.0\n"))
    found = detectability_matrix(load(path), EFFECTS, coarse=MESH)
    assert list(found.information.sensing.noise) == ["p_front", "p_rear"]
    assert limit_of(found, "carried_mass").share == 0.0
    assert limit_of(found, "pressure_gain").share > 0.5
    assert "carried_mass" not in sum(found.classes, [])
    assert "not detectable" in matrix_table(found)
    assert np.isnan(found.alike[found.names.index("carried_mass")]).all()


def test_without_any_noise_it_says_what_to_declare(tmp_path):
    with pytest.raises(InputError, match="add sensors.pressure_noise"):
        predict_information(load(write(tmp_path)), EFFECTS)


def test_measured_trials_count_their_own_samples_and_a_missing_channel(tmp_path, still):
    experiment = load(write(tmp_path, *STILL))
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


def proposed(still, tow):
    names = ("carried_mass", "axial_added_mass")
    limits = limits_of(still.information.experiment, LIMITS | {"tow_speed": tow})
    return separate(*at_limits(still, names), limits, FEW)


@pytest.fixture(scope="module")
def towed(still):
    return proposed(still, (0.0, 0.25))


def test_mass_and_axial_added_mass_look_alike_in_still_water_and_a_towed_trial_is_chosen(
    still, towed
):
    (pair,) = towed["pairs"]
    assert pair["cos_before"] > DEFAULT_SETTINGS.parallel_cosine
    assert towed["trial"]["tow_speed"] > 0.1
    (without,) = proposed(still, (0.0, 0.0))["pairs"]
    assert pair["cos_after"] < 0.9 < without["cos_after"]
    assert pair["sigmas_after"] > 1.5 * without["sigmas_after"]


def test_the_trial_that_is_proposed_does_what_it_says(still, towed, tmp_path):
    path = write(tmp_path, *STILL)
    path.write_text(f"{path.read_text()}\n{towed['toml']}")
    experiment = load(path)
    assert experiment.trials[2].tow_speed == towed["trial"]["tow_speed"]
    assert trial_toml(experiment.trials[2]) == towed["toml"]
    f, before, members, _ = at_limits(still, ("carried_mass", "axial_added_mass"))
    A = before + information(replace(f, experiment=experiment).trial(experiment.trials[2]))
    cos = tangent_cosine(*members.values(), np.arange(4), as_block(A))
    assert cos == pytest.approx(towed["pairs"][0]["cos_after"], rel=1e-9)


def test_a_trial_that_was_foreseen_is_not_simulated_again(still, tmp_path, monkeypatch):
    f = replace(still.information, memo=Memo(tmp_path))
    trial = f.experiment.trials[0]
    first = f.trial(trial)
    monkeypatch.setattr("calibration.experiment_design.information.predict", None)
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


def test_what_no_trial_separates_is_said_so(still):
    limits = limits_of(still.information.experiment, LIMITS)
    names = ("pressure_gain", "regulator_gain")
    found = separate(*at_limits(still, names), limits, SearchEffort(spread=2, rounds=0))
    assert found["pairs"][0]["sigmas_after"] < 0.1
    assert "no trial within the limits does" in found["said"]


def test_limits_are_the_experiments_own_slightly_widened(still):
    found = limits_of(still.information.experiment)
    assert found.frequency == (2.25, 4.4)
    assert found.amplitude == (135e3, 275e3)
    assert found.phase == (0.09, 0.11)
    assert found.tow_speed == (0.0, 0.0)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--separate", "carried_mas", "tip_mass"], "did you mean carried_mass?"),
        (["--effects", "gravity"], "--effects: given 'gravity'"),
        (["--separate", "tip_mass"], "--separate: given one effect; allowed two or more"),
        (["--frequency", "1", "2"], "--frequency: is a limit of the next trial"),
        (["--frequency", "3", "2"], "--frequency: given 3 2; allowed LOW HIGH"),
        (["--amplitude", "100", "300"], "--amplitude: given 100; allowed 0, or 1000 to 2e+06 Pa"),
        (["--tow-speed", "0", "9"], "--tow-speed: given 9; allowed -3 to 3 m/s"),
    ],
)
def test_bad_options_are_refused_by_name(options, said, tmp_path, capsys):
    pair = ["--separate", "tip_mass", "carried_mass"]
    extra = pair if "allowed" in said and "--separate" not in options else []
    out = tmp_path / "out"
    arguments = [str(write(tmp_path, *STILL)), "--out", str(out), *options, *extra]
    assert main(["effects", "matrix", *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


def test_the_command_writes_json_picture_and_a_trial(still, tmp_path, monkeypatch, capsys):
    asked = []

    def asked_for(*given, memo):
        assert memo.folder.parent == out
        asked.append(given)
        return still

    monkeypatch.setattr(
        "calibration.experiment_design.detectability.detectability_matrix", asked_for
    )
    monkeypatch.setattr(
        "calibration.experiment_design.pair_distance.separate",
        partial(separate, effort=SearchEffort(2, 0)),
    )
    path, out = write(tmp_path, *STILL), tmp_path / "out"
    arguments = ["--out", str(out), "--separate", "force_gain", "carried_mass"]
    assert main(["effects", "matrix", str(path), *arguments]) == 0
    assert asked[0][1] == ("force_gain", "carried_mass")
    told = json.loads((out / "matrix.json").read_text())
    n = len(EFFECTS)
    assert np.array(told["alike"]).shape == (n, n) and len(told["limits"]) == n
    assert told["settings"]["name"] == "small" and "jax" in told["versions"]
    assert (out / "matrix.png").stat().st_size > 1e4
    assert (out / "next_trial.toml").read_text() == told["next_trial"]["toml"]
    said = capsys.readouterr().out
    assert "[[trials]]" in said and "standard deviations apart" in said


def test_json_holds_what_the_table_says(still):
    told = detectability_record(still, {})
    assert ["pressure_gain", "regulator_gain"] in told["classes"]
    assert told["told_by_sign"] == [["actuator_saturation", "actuator_quadratic"]]
    (row,) = [x for x in told["limits"] if x["effect"] == "force_gain"]
    decided = max(row["significant_from"], row["worth_naming_from"])
    assert row["limit"] == pytest.approx(decided + norm.ppf(0.9) * row["standard_error"], rel=1e-4)


def test_names_after_effects_are_effects_and_matrix_is_a_command():
    assert find(["effects", "matrix", "x.toml"]) == ("effects matrix", ["x.toml"])
    assert find(["effects", "gravity"]) == ("effects", ["gravity"])
    assert main(["effects"]) == 0
    assert list(COMMANDS).index("effects matrix") < list(COMMANDS).index("effects")


@pytest.mark.parametrize("sizes", [(0.1, 2.0), (2.0, 0.1)])
def test_the_distance_of_a_pair_is_what_least_squares_leaves_of_the_smaller(sizes):
    J = np.random.default_rng(0).normal(size=(60, 4))
    J[:, 3] += 2.0 * J[:, 2] + J[:, 0]
    members = {"a": np.array([2]), "b": np.array([3])}
    at = {name: np.array([size]) for name, size in zip("ab", sizes, strict=True)}
    (pair,) = pairs_of(J.T @ J, members, at, np.array([0, 1]))

    def left(i, others, size):
        square = np.linalg.lstsq(J[:, others], size * J[:, i], rcond=None)[1][0]
        return np.sqrt(square)

    ways = left(2, [0, 1, 3], sizes[0]), left(3, [0, 1, 2], sizes[1])
    assert pair.sigmas == pytest.approx(min(ways), rel=1e-9)
    assert ways[0] < 0.5 * ways[1] or ways[1] < 0.5 * ways[0]
