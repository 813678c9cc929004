"""Predictions of trials at arbitrary sample times."""

import numpy as np
import pytest

from calibration.model import compiled, predict
from calibration.model.compiled import LONG, in_batches
from calibration.model.extended import Part, acting_part, base_values, base_vector, model_parameters
from calibration.model.plan import Resolution, plan_trial
from calibration.model.predict import (
    advance_block,
    predict_each,
    predict_readings,
    pressure_histories,
)
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects.library import LIBRARY
from slider_jax.experiment import load as experiment
from slider_jax.experiment.declared_channels import KINDS, WHOLE
from slider_jax.programs import program_text
from slider_jax.simulation.trial import SavedSeries
from tests.support.data import ROOT
from tests.support.experiments import channel, write_small_experiment

K, AMPLITUDE, SPACING = 0.075, 2e5, 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("begin", [0.0, 1.3e-4, 1.344e-3, 1.99e-3, 5.3e-3])
def test_the_first_sample_may_be_between_steps(begin):
    """The closed form is the lag's step response."""
    file = ROOT / "docs" / "experiment.toml"
    changes = {"trials.0.frequency": 2.0, "trials.0.amplitude": AMPLITUDE, "trials.0.duration": 0.4}
    given = experiment.load(file).with_values(changes)
    at = begin + SPACING * np.arange(100)
    p = plan_trial(given, given.trials[0], (), Resolution(11, 40, 5e-3), at)
    front = predict_readings(p, np.array([2.0, 0.5, K, 4.79e-7]))[0]
    np.testing.assert_allclose(front, AMPLITUDE * (1.0 - np.exp(-at / K)), atol=1e-6)


def test_the_programs_of_all_effects_and_sensors_can_be_kept(tmp_path):
    """Otherwise, each later process would trace them again."""
    places = {kind: {} if kind in WHOLE else {"s": 0.2} for kind in KINDS}
    tables = "".join(channel(kind, [kind], name=kind, **s) for kind, s in places.items())
    file = write_small_experiment(tmp_path, ("[numerics]", f"{tables}\n[numerics]"))
    given = experiment.load(file)
    at = 5e-3 * np.arange(40)
    p = plan_trial(given, given.trials[0], tuple(LIBRARY), Resolution(11, 40, 5e-3), at)
    assert len(p.extended.channels) == 5 + len(KINDS)
    assert program_text(advance_block, (p.extended, p.numerics, p.scheme))
    model = p.extended.at(base_vector(model_parameters(p.extended.effects), base_values(given)))
    assert program_text(rollout, (model, SavedSeries(p.extended.channels, shape=True)))


@pytest.mark.slow
def test_each_part_of_the_model_has_only_its_own_effects():
    """The parts together give the readings of a simulation with all effects at once."""
    given = experiment.load(ROOT / "docs" / "experiment.toml")
    names = ("clamp_compliance", "leakage", "force_crosstalk", "line_lag")
    changes = {"trials.0.frequency": 2.0, "trials.0.amplitude": AMPLITUDE, "trials.0.duration": 0.2}
    given = given.with_values(changes)
    at = 5e-3 * np.arange(40)
    p = plan_trial(given, given.trials[0], names, Resolution(11, 40, 5e-3), at)
    assert p.grid.h == pytest.approx(5e-3)
    entries = model_parameters(names)
    theta = base_vector(entries, base_values(given))
    assert not any(acting_part(p.extended, part, theta).extended.effects for part in Part)
    for name in ("clamp_compliance", "leakage", "force_crosstalk"):
        i = [x.effect for x in entries].index(name)
        theta[i] += 0.3 * (entries[i].prior.high - theta[i])
    parts = {part: acting_part(p.extended, part, theta).extended.effects for part in Part}
    assert parts == {
        Part.PRESSURES: ("leakage", "line_lag"),
        Part.BODY: ("clamp_compliance",),
        Part.SENSORS: ("force_crosstalk",),
    }
    model = p.extended.at(theta)
    saved = SavedSeries(p.extended.channels)
    run = rollout(model, TimeGrid(p.grid.h, p.grid.steps), saved, p.numerics, p.scheme)
    true = {name: np.pad(x, (1, 0)) for name, x in run.saved.items()}
    recorded = p.extended.channels.recorded(model.effects, p.grid.times, true)
    found = predict_readings(p, theta)
    for name, expected in recorded.items():
        row = found[SLIDER_CHANNELS.row(name)]
        # The pressures have other Runge-Kutta steps here than in the rollout.
        atol = 1e-7 * np.abs(expected).max()
        np.testing.assert_allclose(row, expected[: len(at)], rtol=1e-7, atol=atol)


def test_trials_with_the_same_pressures_share_one_simulation_of_the_pressures(monkeypatch):
    given = experiment.load(ROOT / "docs" / "experiment.toml")
    p = plan_trial(given, given.trials[0], (), Resolution(11, 40, 5e-3), SPACING * np.arange(50))
    theta, other = (np.array([2.0, 0.5, k, 4.79e-7]) for k in (K, 2.0 * K))
    jobs = []

    def counted(work, items, *rest):
        jobs.append(len(items))
        return in_batches(work, items, *rest)

    monkeypatch.setattr("calibration.model.predict.in_batches", counted)
    soft = theta * np.array([1.0, 1.0, 1.0, 1.1])
    histories = pressure_histories([(p, theta), (p, soft), (p, other)])
    assert jobs == [2]
    assert histories[0] is histories[1] and histories[0] is not histories[2]


def test_readings_of_long_trials_are_computed_in_parts(monkeypatch):
    """The parts limit the memory, and the readings stay the same."""
    given = experiment.load(ROOT / "docs" / "experiment.toml")
    names = ("force_crosstalk",)
    p = plan_trial(given, given.trials[0], names, Resolution(11, 40, 5e-3), SPACING * np.arange(50))
    entries = model_parameters(names)
    thetas = [base_vector(entries, base_values(given)) for _ in range(3)]
    for share, theta in zip((0.1, 0.2, 0.3), thetas, strict=True):
        theta[-1] += share * (entries[-1].prior.high - theta[-1])
    pairs, lengths = [(p, theta) for theta in thetas], []

    def counted(jobs):
        lengths.append(len(jobs))
        return recorded_each(jobs)

    recorded_each = predict._recorded_each
    monkeypatch.setattr(predict, "_recorded_each", counted)
    together = predict_each(pairs)
    monkeypatch.setattr(compiled, "MOST_VALUES", 1)
    apart = predict_each(pairs)
    assert lengths == [6, 2, 2, 2]
    for one, other in zip(apart, together, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12 * np.abs(other).max())
    assert not np.allclose(together[0], together[2])


def test_batches_hold_items_of_one_kind_and_keep_the_order():
    seen = []

    def work(batch):
        seen.append(tuple(batch))
        return [10 * x for x in batch]

    assert in_batches(work, [1, 2, 3, 4, 5], "abaaa", [1, 2, 3, 4, 5], 3) == [10, 20, 30, 40, 50]
    assert sorted(seen) == [(1, 1, 1), (2, 2, 2), (5, 4, 3)]


@pytest.mark.parametrize(
    ("lengths", "batches"),
    [
        ([LONG, 100, 100], [(1,), (2,), (3,)]),
        ([LONG], [(1,)]),
        ([LONG, LONG, LONG], [(1, 2, 3, 3)]),
        ([LONG - 1, 100], [(1, 2, 2, 2)]),
    ],
)
def test_a_batch_with_few_long_items_is_computed_one_item_at_a_time(lengths, batches):
    seen = []

    def work(batch):
        seen.append(tuple(batch))
        return [10 * x for x in batch]

    items = list(range(1, len(lengths) + 1))
    assert in_batches(work, items, "a" * len(items), lengths, 4) == [10 * x for x in items]
    assert sorted(seen) == batches


@pytest.mark.slow
def test_trials_of_different_lengths_in_one_batch_have_the_readings_of_single_trials():
    given = experiment.load(ROOT / "docs" / "experiment.toml")
    names = ("leakage", "force_crosstalk")
    short, long = (
        plan_trial(given, given.trials[0], names, Resolution(11, 40, 5e-3), SPACING * np.arange(n))
        for n in (60, 700)
    )
    theta = base_vector(entries := model_parameters(names), base_values(given))
    theta[[bool(x.effect) for x in entries]] += 0.05
    together = predict_each([(short, theta), (long, theta)])
    for p, found in zip((short, long), together, strict=True):
        assert np.isfinite(found).all()
        scale = np.ptp(found, axis=1, keepdims=True)
        np.testing.assert_allclose(found / scale, predict_readings(p, theta) / scale, atol=1e-9)
