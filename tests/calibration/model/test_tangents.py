"""Tangents of the readings, compared with differences of readings."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.model import compiled, tangents
from calibration.model.extended import (
    Part,
    acting_part,
    base_values,
    base_vector,
    changed_part,
    model_parameters,
)
from calibration.model.plan import Resolution, plan_trial
from calibration.model.predict import predict_readings
from calibration.model.tangents import reading_tangents
from slider_jax.experiment.load import load
from tests.support.data import ROOT

NAMES = ("leakage", "clamp_compliance", "force_crosstalk", "valve_deadband")


@pytest.fixture(scope="module")
def trial():
    given = load(ROOT / "docs" / "experiment.toml")
    changes = {"trials.0.frequency": 2.0, "trials.0.amplitude": 1.5e5, "trials.0.duration": 0.2}
    given = given.with_values(changes)
    p = plan_trial(given, given.trials[0], NAMES, Resolution(11, 40, 5e-3), 5e-3 * np.arange(40))
    return p, base_vector(model_parameters(NAMES), base_values(given))


@pytest.mark.slow
def test_tangents_agree_with_differences_of_readings(trial):
    p, theta = trial
    entries = model_parameters(NAMES)
    theta = theta.copy()
    chosen = [i for i, x in enumerate(entries) if not x.is_shape and x.effect != "valve_deadband"]
    for i in chosen[4:]:  # away from the nulls, where some laws have a kink
        theta[i] += 0.2 * (entries[i].prior.high - theta[i])
    unit = np.eye(len(theta))[chosen]
    found = reading_tangents(p, theta, unit)
    for row, i in zip(found, chosen, strict=True):
        step = 1e-4 * (entries[i].prior.high - entries[i].prior.low) * unit[chosen.index(i)]
        change = (predict_readings(p, theta + step) - predict_readings(p, theta - step)) / (
            2.0 * step[i]
        )
        scale = np.abs(change).max(axis=1, keepdims=True)
        assert np.all(np.abs(row - change) <= 2e-4 * scale + 1e-9), entries[i].label


@pytest.mark.slow
def test_an_omitted_effect_changes_no_tangent(trial):
    """Without a direction of `valve_deadband`, the programs do not contain the effect."""
    p, theta = trial
    band = [x.effect for x in model_parameters(NAMES)].index("valve_deadband")
    unit = np.eye(len(theta))
    rest = np.delete(unit, band, axis=0)
    for directions, names in ((rest, ("leakage",)), (unit, ("leakage", "valve_deadband"))):
        part = acting_part(p.extended, Part.PRESSURES, theta, directions)
        assert part.extended.effects == names
    omitted = reading_tangents(p, theta, rest)
    present = np.delete(reading_tangents(p, theta, unit), band, axis=0)
    scale = np.abs(present).max(axis=2, keepdims=True)
    assert present.any(axis=(1, 2)).all()
    assert np.all(np.abs(omitted - present) <= 1e-9 * scale)


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [True, False])
def test_long_series_are_computed_in_parts(trial, monkeypatch, sensors):
    p, theta = trial
    entries, unit = model_parameters(NAMES), np.eye(len(theta))
    if not sensors:
        unit = unit[[x.effect != "force_crosstalk" for x in entries]]
    whole = reading_tangents(p, theta, unit)
    monkeypatch.setattr(compiled, "MOST_VALUES", 1)
    parts = reading_tangents(p, theta, unit, np.float32)
    scale = np.abs(whole).max(axis=2, keepdims=True)
    assert parts.dtype == np.float32 and np.all(np.abs(parts - whole) <= 1e-6 * scale)


@pytest.mark.slow
def test_each_of_several_calls_contains_only_the_effects_that_it_changes(trial, monkeypatch):
    of_body = ("tail_stiffness", "tail_drag", "carried_mass", "linear_friction", "tip_mass")
    of_body += ("tangential_friction", "internal_friction", "tail_friction")
    names = (*of_body, "leakage")
    p = replace(trial[0], extended=replace(trial[0].extended, effects=names))
    entries = model_parameters(names)
    theta = np.concatenate([trial[1][:4], [x.prior.null for x in entries[4:]]])
    unit = np.eye(len(theta))[[i for i, x in enumerate(entries) if not x.is_shape]]
    whole = reading_tangents(p, theta, unit)
    contained = []

    def recorded(*arguments):
        contained.append(changed_part(*arguments))
        return contained[-1]

    monkeypatch.setattr(compiled, "MOST_DIRECTIONS", 8)
    monkeypatch.setattr(tangents, "changed_part", recorded)
    found = reading_tangents(p, theta, unit)
    bodies = [x.extended.effects for x in contained if "leakage" not in x.extended.effects]
    assert set().union(*bodies) == set(of_body)
    assert max(map(len, bodies)) < len(of_body)
    scale = np.abs(whole).max(axis=2, keepdims=True)
    assert whole.any(axis=(1, 2)).all()
    assert np.all(np.abs(found - whole) <= 1e-9 * scale)
    moved = theta.copy()
    moved[4] += 0.1 * (entries[4].prior.high - theta[4])
    contained.clear()
    reading_tangents(p, moved, unit)
    assert not contained
