"""Problems of measured trials: which channels count."""

from dataclasses import replace

import numpy as np

from calibration.discrepancy.refits import Refits
from calibration.inference import problem
from calibration.inference.cache import Memo
from calibration.inference.gauss_newton import Fit
from calibration.inference.problem import TankProblem, normal_equations, summed, trial_equations
from calibration.measurements.records import Record
from calibration.model import compiled
from calibration.model.plan import Resolution
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.load import load
from tests.support import closed_form_tank as tank
from tests.support.experiments import write_small_experiment

MESH = Resolution(11, 20, 1e-2)


def test_a_channel_that_no_trial_measures_is_no_evidence(tmp_path):
    """Without a force sensor, a change of the predicted thrust does not count."""
    experiment = load(write_small_experiment(tmp_path))
    t = np.arange(100) / 200.0
    readings = np.sin(20.0 * t) * np.ones((len(SLIDER_CHANNELS), 1))
    readings[[SLIDER_CHANNELS.row("thrust"), SLIDER_CHANNELS.row("recoil")]] = np.nan
    records = [Record(trial, t, readings, experiment.channels) for trial in experiment.trials]
    measured = TankProblem.of(experiment, records, (), fine=MESH, coarse=MESH)
    before = [np.ones_like(readings) for _ in records]
    after = [x.copy() for x in before]
    for x in after:
        x[SLIDER_CHANNELS.row("thrust")] *= 2.0
    first, second = (
        Fit(np.zeros(0), np.zeros(0, int), 0.0, 0, [], predicted, True)
        for predicted in (before, after)
    )
    sizes = Refits(measured, [], {}, print).sizes(first, second)
    assert sizes == {"p_front": 0.0, "p_rear": 0.0, "tip": 0.0}


def test_no_tangent_is_computed_for_the_shape_of_an_effect_at_its_null(monkeypatch):
    tank.replace_the_beam(monkeypatch)
    computed = []

    def tangents(plan, theta, directions, dtype=float):
        computed.append(int(directions.any(axis=1).sum()))
        return tank.tangents(plan, theta, directions, dtype)

    monkeypatch.setattr(problem, "reading_tangents", tangents)
    experiment = tank.experiment_of((2.0,))
    theta = np.array([3.0, 0.7, 0.08, 4.5e-7, 0.0, 0.3])
    records = tank.measured(experiment, [theta], 0)
    found = tank.problem_of(experiment, records, ("internal_friction",))
    (absent,) = found.tangents(theta, np.eye(6)[[5, 4]])
    assert not absent[0].any() and absent[1].any()
    theta[4] = 0.01
    (present,) = found.tangents(theta, np.eye(6)[[5]])
    assert present[0].any() and computed == [5, 6]


def test_tangents_of_an_effect_scored_by_secants_are_computed_if_they_are_asked_for(monkeypatch):
    tank.replace_the_beam(monkeypatch)
    computed = []

    def tangents(plan, theta, directions, dtype=float):
        computed.append([int(i) for i in np.nonzero(directions)[1]])
        return tank.tangents(plan, theta, directions, dtype)

    monkeypatch.setattr(problem, "reading_tangents", tangents)
    experiment = tank.experiment_of((2.0,))
    theta = np.array([3.0, 0.7, 0.08, 4.5e-7, 0.0])
    records = tank.measured(experiment, [theta], 0)
    found = tank.problem_of(experiment, records, ("valve_deadband",))
    found.tangents(theta, np.eye(5)[[0]])
    (asked,) = found.tangents(theta, np.eye(5)[[4]])
    theta[4] = 1e4
    found.tangents(theta, np.eye(5)[[4]])
    assert computed == [[0, 1, 2, 3], [4], [0, 1, 2, 3, 4]] and asked.any()


def test_a_row_for_each_entry_takes_the_kept_tangents(monkeypatch):
    """The scoring wants such rows; a row of zeros in the directions is a row of zeros."""
    tank.replace_the_beam(monkeypatch)
    experiment, theta = tank.experiment_of((2.0,)), np.array([3.0, 0.7, 0.08, 4.5e-7, 0.0])
    records = tank.measured(experiment, [theta], 0)
    found = tank.problem_of(experiment, records, ("regulator_gain",))
    (whole,) = tank.problem_of(experiment, records, ("regulator_gain",)).tangents(theta, np.eye(5))
    (some,) = found.tangents(theta, np.eye(5)[[3, 1]])
    assert whole.shape == (5, *records[0].values.shape) and whole.any(axis=(1, 2)).all()
    np.testing.assert_array_equal(some, whole[[3, 1]])
    (kept,) = found._last.values()
    (without,) = found.tangents(theta, np.diag([1.0, 1.0, 0.0, 1.0, 1.0]))
    assert without is kept[0] and not without[2].any() and not found._last
    np.testing.assert_array_equal(np.delete(without, 2, 0), np.delete(whole, 2, 0))


def test_rows_of_zeros_are_neither_whitened_nor_multiplied(monkeypatch):
    tank.replace_the_beam(monkeypatch)
    experiment, theta = tank.experiment_of((2.0,)), np.array([3.0, 0.7, 0.08, 4.5e-7])
    records = tank.measured(experiment, [theta], 0)
    found = tank.problem_of(experiment, records)
    predicted, changes = found.predict(theta), found.tangents(theta, np.eye(4)[[3, 0, 1]])
    white = found.whiteners(predicted)
    expected = {key: x(changes[0][:, records[0].row(key[1])]) for key, x in white.items()}
    whole = found.whitened(changes, white)
    rows = {key: [] for key in white}

    def counting(key):
        return lambda series: rows[key].append(len(series)) or white[key](series)

    found.whitened(changes, {key: counting(key) for key in white})
    assert rows[0, "p_front"] == [] and rows[0, "thrust"] == [3]
    residuals = found.residuals([1.1 * x for x in predicted], white)
    for block in normal_equations(residuals, whole):
        key = block.trial, block.channel
        np.testing.assert_allclose(whole[key], expected[key], rtol=1e-6, atol=1e-6)
        x = whole[key].astype(float)
        np.testing.assert_allclose(block.A, x @ x.T, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(block.b, x @ residuals[key], rtol=1e-12, atol=1e-9)


def test_tangents_are_whitened_in_their_own_memory(monkeypatch):
    """Also with channels that do not measure at all times."""
    tank.replace_the_beam(monkeypatch)
    experiment, theta = tank.experiment_of((2.0, 1.5)), np.array([3.0, 0.7, 0.08, 4.5e-7])
    records = tank.measured(experiment, [theta] * 2, 0)
    records[1].values[records[1].row("tip"), ::3] = np.nan
    found = tank.problem_of(experiment, records)
    white = found.whiteners(found.predict(theta))
    changes = found.tangents(theta, np.eye(4))
    expected = found.whitened(changes, white)
    in_place = found.whitened(changes, white, in_place=True)
    assert expected.keys() == in_place.keys() and expected[1, "tip"].any()
    for key, x in in_place.items():
        np.testing.assert_array_equal(x, expected[key])
        assert np.shares_memory(x, changes[key[0]])
        assert not np.shares_memory(expected[key], changes[key[0]])


def test_normal_equations_of_single_precision_derivatives_have_double_precision(monkeypatch):
    """A sum of single-precision products would lose the difference between both derivatives."""
    rng = np.random.default_rng(0)
    first = rng.normal(size=20000).astype(np.float32)
    J = np.stack([first, first + np.float32(1e-4) * rng.normal(size=20000).astype(np.float32)])
    r = rng.normal(size=20000)
    (found,) = normal_equations({(0, "tip"): r}, {(0, "tip"): J})
    exact = J.astype(float)
    np.testing.assert_allclose(found.A, exact @ exact.T, rtol=1e-13)
    apart = np.array([1.0, -1.0])
    distance = np.sum((exact[0] - exact[1]) ** 2)
    np.testing.assert_allclose(apart @ found.A @ apart, distance, rtol=1e-6)
    monkeypatch.setattr(compiled, "MOST_VALUES", 300)
    (parts,) = normal_equations({(0, "tip"): r}, {(0, "tip"): J})
    np.testing.assert_allclose(parts.A, found.A, rtol=1e-13)
    np.testing.assert_allclose(parts.b, found.b, rtol=1e-9)


def test_the_equations_of_a_trial_are_the_sum_over_its_channels():
    rng = np.random.default_rng(1)
    keys = [(0, "tip"), (1, "tip"), (0, "thrust"), (0, "recoil")]
    residuals = {key: rng.normal(size=20 + i) for i, key in enumerate(keys)}
    J = {key: rng.normal(size=(3, len(r))) for key, r in residuals.items()}
    of_channels = normal_equations(residuals, J)
    found = trial_equations(residuals, J)
    assert [(x.trial, x.n) for x in found] == [(0, 20 + 22 + 23), (1, 21)]
    for x in found:
        own = [y for y in of_channels if y.trial == x.trial]
        A, b = summed(own)
        np.testing.assert_allclose(x.A, A)
        np.testing.assert_allclose(x.b, b)
        assert np.isclose(x.c, sum(y.c for y in own))


def test_problems_of_different_trials_share_the_cache_of_each_trial(monkeypatch, tmp_path):
    simulated = []

    def predict_each(pairs):
        simulated.extend(plan.trial.file for plan, _ in pairs)
        return [tank.predict(*pair) for pair in pairs]

    monkeypatch.setattr(problem, "predict_each", predict_each)
    theta = np.array([3.0, 0.7, 0.08, 4.5e-7])
    experiment = tank.experiment_of((1.5, 1.8, 2.2))
    plain = tank.problem_of(experiment, tank.measured(experiment, [theta] * 3, 0))
    expected = plain.predict(theta), plain.coarse([theta, 1.01 * theta])
    simulated.clear()
    cached = replace(plain, memo=Memo(tmp_path))
    cached.part([2, 0]).predict(theta)
    assert simulated == ["trial_02.csv", "trial_00.csv"]
    found = cached.predict(theta), cached.coarse([theta, 1.01 * theta])
    assert simulated[2:] == ["trial_01.csv"] + [f"trial_0{i // 2}.csv" for i in range(6)]
    for each, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(each, other)
    for path in tmp_path.iterdir():
        path.write_bytes(b"damaged")
    np.testing.assert_array_equal(cached.predict(theta), expected[0])


def test_a_problem_of_some_readings_has_only_these_and_their_noise(monkeypatch):
    tank.replace_the_beam(monkeypatch)
    theta = np.array([3.0, 0.7, 0.08, 4.5e-7])
    experiment = tank.experiment_of((1.5, 1.8))
    whole = tank.problem_of(experiment, tank.measured(experiment, [theta] * 2, 0))
    n = len(whole.records[0].t)
    white = np.linspace(0.5, 1.5, n)
    uneven = whole.noise[0, "tip"]._replace(white=white)
    whole = replace(whole, noise=whole.noise | {(0, "tip"): uneven})
    part = whole.during(lambda record: record.t < 0.5 * record.t[-1])
    early = whole.records[0].t < 0.5 * whole.records[0].t[-1]
    assert part.records[0].there("tip").tolist() == early.tolist()
    np.testing.assert_array_equal(part.noise[0, "tip"].white, white[early])
    assert part.noise[1, "tip"] == whole.noise[1, "tip"]
    predicted = part.predict(theta)
    residuals = part.residuals(predicted, part.whiteners(predicted))
    assert residuals.keys() == whole.noise.keys()
    assert all(len(r) == early.sum() for r in residuals.values())
    one = whole.during(lambda record: np.full(n, record.trial is experiment.trials[0]))
    assert {i for i, _ in one.noise} == {0}
