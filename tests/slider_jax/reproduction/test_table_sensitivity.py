"""The sensitivity of the paper's table: definitions of a wavelength, and changed models."""

import json
import runpy

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax import paper
from slider_jax.beam.parameters import Numerics, uniform_robot
from slider_jax.dynamics.statics import Loads
from slider_jax.experiment.load import Experiment
from slider_jax.reproduction.table_sensitivity import (
    AS_STATED,
    CHANGES,
    K_Q_OF_THE_TIP,
    NO_LAG,
    RECALIBRATED,
    fit_head_drag,
    steady_row,
)
from slider_jax.reproduction.wavelengths import (
    course_coordinates,
    rms_tail_slope,
    wavelengths,
    without_recoil,
    zeros_wavelength,
)
from slider_jax.swimming.free_swim import free_swimmer
from slider_jax.swimming.paper_optimum import PUBLISHED, optimum
from slider_jax.swimming.performance import Stride
from slider_jax.swimming.steady_state import SteadySettings
from tests.support.data import ROOT
from tests.support.helpers import static_state

F, STEPS, A, LAMBDA = 4.0, 60, 0.004, 0.2
S = np.linspace(0.0, 0.4, 161)  # two waves
T = np.arange(1.0, STEPS + 1.0) / (STEPS * F)
QUICK = SteadySettings(steps_per_stride=48, numerics=Numerics(4, 8))


def made(standing=0.0, turned=0.0):
    """Returns a stride of a small wave towards the tail, on a course at an angle `turned` [rad]."""
    phase, k = 2 * np.pi * F * T[:, None], 2 * np.pi / LAMBDA
    y = 0.05 + A * (np.sin(phase + k * S) + standing * np.sin(phase - k * S)) / (1.0 + standing)
    x = S + 0.3 * T[:, None]
    c, s = np.cos(turned), np.sin(turned)
    midline = np.stack([c * x - s * y, s * x + c * y], axis=1)
    ahead = np.array([c, s])
    velocity = np.tile(0.3 * ahead, (STEPS, 1))
    none = np.zeros(STEPS)
    return Stride(T, midline, velocity, none, none, velocity[0], ahead, np.array(True))


@pytest.mark.slow
def test_every_definition_gives_the_length_of_a_travelling_wave():
    found = wavelengths(made(turned=0.7), S, F)
    for name, wavelength in found.items():
        print(f"{name}: {1e3 * wavelength:.1f} mm")
        assert wavelength == pytest.approx(LAMBDA, rel=0.03), name


@pytest.mark.slow
@pytest.mark.parametrize("standing", [0.5, 1.0])
def test_definitions_by_shape_also_give_the_length_of_a_standing_wave(standing):
    found = wavelengths(made(standing), S, F)
    assert found["shape"] == pytest.approx(LAMBDA, rel=5e-3)
    assert found["zeros"] == pytest.approx(LAMBDA, rel=0.01)


def test_the_rms_slope_equals_that_of_a_sine():
    """It is 2 pi A/(lambda sqrt 2). The paper's A_t/(lambda/4) = 0.51 corresponds to 0.57."""
    assert rms_tail_slope(*course_coordinates(made())) == pytest.approx(
        2 * np.pi * A / LAMBDA / np.sqrt(2), rel=5e-3
    )
    own, stated = PUBLISHED["shape_tail_slope"].model, PUBLISHED["tail_slope"].model
    assert own * np.pi / np.sqrt(8) == pytest.approx(stated, abs=0.005)


def test_recoil_is_a_straight_line_and_a_shape_may_have_no_zeros():
    line = np.outer(np.sin(7.0 * T), 1.0 + 2.0 * S)
    np.testing.assert_allclose(without_recoil(line, S), 0.0, atol=1e-14)
    assert np.isnan(zeros_wavelength(1.0 + 0.0 * line, S))


def test_each_change_changes_one_parameter():
    experiment = optimum()
    _, model = free_swimmer(experiment, experiment.trials[0])
    (_, stated), *others = CHANGES.items()
    assert set(RECALIBRATED) < set(CHANGES)

    def differences(a, b):
        leaves = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
        return sum(not np.allclose(x, y, rtol=1e-12) for x, y in leaves)

    assert differences(stated(model), model) == 0
    for name, change in others:
        changed = change(model)
        assert jax.tree.structure(changed) == jax.tree.structure(model), name
        assert 1 <= differences(changed, model) <= 4, name


@pytest.mark.slow
def test_the_k_q_of_the_tip_gives_the_papers_tip_displacement():
    """45 kPa in both chambers of the table's robot: 102 mm; its other K_Q gives 31 mm."""

    @jax.jit
    def tip(K_Q):
        model = paper.head_fixed(4.8, uniform_robot(K_Q=K_Q))
        found = static_state(model, Loads(jnp.zeros(2), jnp.array([45e3, 45e3])))
        return found.shape[1, 0], found.ok

    for K_Q, known in ((K_Q_OF_THE_TIP, 0.102), (uniform_robot().K_Q, 0.031)):
        found, ok = tip(jnp.asarray(K_Q))
        assert bool(ok) and abs(float(found)) == pytest.approx(known, rel=0.01)


@pytest.mark.slow
def test_a_model_with_fitted_head_drag_has_the_required_speed():
    experiment = optimum()
    frequency, model = free_swimmer(experiment, experiment.trials[0])
    found = fit_head_drag(model, frequency, 0.15, QUICK)
    again = steady_row(CHANGES["twice the axial resistance"](model), frequency, QUICK)
    print(f"{1e4 * found.area:.1f} cm^2; {float(again.performance.speed):.4f} m/s at 35.8")
    assert float(found.performance.speed) == pytest.approx(0.15, rel=2e-3)
    assert found.slopes()["shape"] == pytest.approx(float(found.performance.shape_tail_slope))
    assert again.area == pytest.approx(2.0 * 1.79e-3)


def coarse() -> Experiment:
    return optimum().with_values({"numerics.nodes": 17, "numerics.step": 0.004})


@pytest.mark.slow
def test_the_script_prints_and_writes_the_table(tmp_path, capsys, monkeypatch):
    script = ROOT / "scripts" / "table_performance.py"
    main = runpy.run_path(str(script))["main"]
    few = {name: CHANGES[name] for name in (AS_STATED, NO_LAG)}
    for name, value in (("CHANGES", few), ("RECALIBRATED", (NO_LAG,)), ("optimum", coarse)):
        monkeypatch.setitem(main.__globals__, name, value)
    assert main([str(tmp_path)]) == 0
    content, printed = json.loads((tmp_path / "table.json").read_text()), capsys.readouterr().out
    stated, unlagged, again = content["swims"].values()
    assert again["speed_m_per_s"] == pytest.approx(0.217, rel=2e-3)
    assert again["head_drag_area_m2"] > 3.0 * stated["head_drag_area_m2"]
    assert unlagged["rms_tail_slope"] > 2.0 * stated["rms_tail_slope"]
    assert content["head_fixed_thrust_N"][NO_LAG] > 3.0 * content["head_fixed_thrust_N"][AS_STATED]
    assert content["versions"]["jax"] and content["settings"]["nodes"] == 17
    assert f"{stated['shape_tail_slope']:.3f}" in printed and "paper: 60 mN" in printed
    assert (tmp_path / "table.png").stat().st_size > 20_000
