"""Tests of free swimming: speeds known from closed forms or long rollouts, and published speeds."""

import json
import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibration.free_swimming import published_speeds as published
from calibration.free_swimming.published_speeds import (
    FIRST,
    OPTIMUM,
    SpeedPrediction,
    UnresistedSwim,
    coefficient_at,
    paper_swimmer,
    steady_swim,
)
from calibration.free_swimming.report import CrossPrediction, allowed_error, speeds_verdict
from calibration.lamprey.animal import force_on_body, prescribe
from slider_jax.beam.parameters import Numerics
from slider_jax.cli.main import main
from slider_jax.dynamics.step import at_rest
from slider_jax.effects import ReactiveForce
from slider_jax.effects.water.head_added_mass import HeadAddedMass
from slider_jax.swimming.paper_optimum import HEAD_DRAG, HEAD_DRAG_70_MM, MEASURED_GAIT, PAPER_GAIT
from slider_jax.swimming.steady_state import SteadySettings, simulate_strides, with_added_velocity
from tests.support.swimming_animal import SHAPE, one_stride, wave

QUICK = SteadySettings(steps_per_stride=60, numerics=Numerics(4, 8))
GAIT = OPTIMUM.gaits["as the paper gives it"]
SWIMS = jnp.asarray(GAIT.frequency)


@pytest.mark.slow
def test_an_unpowered_body_is_decelerated_by_its_friction():
    """m dv/dt = -rho C_t 2 H v^2 / 2 per length, so 1/v grows linearly."""
    C_t, begin, count = 0.05, 0.3, 5
    model = paper_swimmer(GAIT._replace(front=0.0, rear=0.0), "tangential_friction", C_t)
    carry = with_added_velocity(at_rest(model, QUICK.numerics), jnp.array([begin, 0.0]))
    _, pace = jax.jit(lambda m, c: simulate_strides(m, SWIMS, c, count, QUICK))(model, carry)
    rate = 1000.0 * C_t * float(model.robot.body.height / model.robot.body.linear_density)
    middle = (count - 1.0) / GAIT.frequency
    v = 1.0 / (1.0 / begin + rate * middle)
    print(f"{float(pace.speed):.4f} m/s, {v:.4f} known")
    assert float(pace.speed) == pytest.approx(v, rel=3e-3)
    assert float(pace.acceleration) == pytest.approx(-rate * v**2, rel=0.01)


@pytest.mark.slow
def test_the_papers_equations_reach_more_than_five_times_the_published_speed(monkeypatch):
    monkeypatch.setattr(published, "FIRST", OPTIMUM._replace(gaits={}))
    monkeypatch.setattr(published, "HEAD_ADDED_MASSES", {"none": 0.0})
    (swim,) = published.unresisted_swims(QUICK, strides=40)
    print(f"{swim.by_stride[-1]:.3f} m/s after 40 strides, {swim.steady:.3f} m/s when steady")
    assert np.all(np.diff(swim.by_stride[10:]) > 0.0)
    assert 1.2 < swim.steady < np.inf and swim.by_stride[-1] < swim.steady


@pytest.mark.slow
@pytest.mark.parametrize("resisting", ["tangential_friction", "head_drag"])
def test_with_the_calibrated_coefficient_the_robot_swims_at_the_published_speed(resisting):
    coefficient = coefficient_at(OPTIMUM, GAIT, resisting, plan=QUICK)
    speed = float(steady_swim(paper_swimmer(GAIT, resisting, coefficient), GAIT, QUICK).speed)
    print(f"{resisting} = {coefficient:.4g}: {speed:.4f} m/s")
    assert speed == pytest.approx(OPTIMUM.speed, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gait", "area"), [(PAPER_GAIT, HEAD_DRAG), (MEASURED_GAIT, HEAD_DRAG_70_MM)]
)
def test_the_heads_drag_areas_belong_to_the_measured_speed_and_their_tails(gait, area):
    assert coefficient_at(OPTIMUM, gait, "head_drag") == pytest.approx(area, rel=5e-3)


def test_with_the_heads_added_mass_the_mean_force_is_the_tails_momentum_flux():
    """For a blunt body of uniform height over one stride; otherwise the head's flux is added."""
    moved = wave(0.01, one_stride(96))
    held = prescribe(moved, SHAPE)
    H = 0.006
    x = replace(held.x, height=H + 0.0 * held.x.height, height_s=0.0 * held.x.height)
    held = replace(held, x=x)
    m_A = math.pi * 1000.0 * H**2 / 4.0

    def flux(node):
        phi, V = moved.phi[:, node], moved.V[:, node]
        tau, n = np.stack([np.cos(phi), np.sin(phi)], 1), np.stack([-np.sin(phi), np.cos(phi)], 1)
        u_tau, u_n = ((V * e).sum(axis=1)[:, None] for e in (tau, n))
        return (m_A * (u_tau * u_n * n - 0.5 * u_n**2 * tau)).mean(axis=0)

    local, at_head = (
        np.asarray(force_on_body(e, held)).mean(axis=0)
        for e in (ReactiveForce(1.0), HeadAddedMass(1.0))
    )
    print(local, at_head, -flux(0), flux(-1))
    size = np.abs(flux(0)).max()
    np.testing.assert_allclose(local, flux(-1) - flux(0), atol=0.01 * size)
    np.testing.assert_allclose(local + at_head, -flux(0), atol=0.05 * size)


def predicted(speed, resisting="tangential_friction", coefficient=0.1):
    return SpeedPrediction(resisting, "h", FIRST.name, "g", coefficient, OPTIMUM.name, "o", speed,
                           OPTIMUM.speed)  # fmt: skip


def test_the_published_points_have_the_tails_and_the_errors_of_the_paper():
    """Fig. 7d: a tail of 60 mm, 21.3 +- 0.1. Optimum in hardware: a tail of 70 mm, 21.7 +- 0.4."""
    assert {g.tail_length for g in FIRST.gaits.values()} == {0.060}
    assert {g.tail_length for g in OPTIMUM.gaits.values()} == {0.070}
    assert (FIRST.speed, FIRST.error, OPTIMUM.speed, OPTIMUM.error) == (0.213, 0.001, 0.217, 0.004)
    assert allowed_error() == pytest.approx(0.0082, abs=1e-4)


def unresisted():
    return [UnresistedSwim(OPTIMUM.name, "g", "h", np.linspace(0.0, 1.3, 60), 2.4)]


@pytest.mark.parametrize(
    ("predictions", "verdict"),
    [
        ([predicted(0.213), predicted(0.19, "head_drag", 2e-3)], "class"),
        ([predicted(0.213), predicted(0.9, "head_drag", 2e-3)], "identified"),
        (
            [predicted(0.213), *3 * [predicted(0.15)], predicted(0.2, "head_drag", 2e-3)],
            "inconclusive",
        ),
        ([predicted(0.15), predicted(0.14, "head_drag", 2e-3)], "unexplained"),
        # The speed is right, but the friction exceeds its prior range.
        ([predicted(0.217, coefficient=0.9), predicted(0.15, "head_drag", 2e-3)], "unexplained"),
    ],
)
def test_the_verdict_on_the_published_speeds(predictions, verdict):
    assert speeds_verdict(CrossPrediction(unresisted(), predictions, []))[0] == verdict


def test_the_command_writes_its_report(tmp_path, capsys, monkeypatch):
    def predict(calibrated, checked, done):
        predictions = [predicted(0.213), predicted(0.19, "head_drag", 2e-3)]
        for x in predictions:
            done(x)
        return predictions

    monkeypatch.setattr(published, "unresisted_swims", unresisted)
    monkeypatch.setattr(published, "predicted_speeds", predict)
    assert main(["published", "--out", str(tmp_path / "out")]) == 0
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    assert record["verdict"] == "class" and record["effects"][0]["class"] == ["head_drag"]
    row = record["errors"]["speed_at_optimum"]
    assert row["before"] > 1.0 and row["after"] == pytest.approx(0.004)
    assert record["said"] in capsys.readouterr().out
    assert "data:image/png;base64" in (tmp_path / "out" / "report.html").read_text()
