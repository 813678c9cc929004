"""`slider swim` in three dimensions, on a coarse robot."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.spatial import Vec, about_b, about_tau
from slider_jax.cli.main import main
from slider_jax.dynamics.step import at_rest
from slider_jax.experiment.load import assemble, to_model
from slider_jax.io.csv import read_csv
from slider_jax.optimise.design_space import to_toml
from slider_jax.swimming.free_swim import steady_settings
from slider_jax.swimming.gait import to_swimmer
from slider_jax.swimming.paper_optimum import swimmer_content
from slider_jax.swimming.steady_state import simulate_strides
from slider_jax.swimming.swim_in_space import _alike, attitude_of

IN_SPACE = {
    "width": 0.02, "polar_inertia": 6e-5, "GJ_body": 0.03, "GJ_tail": 0.003, "EI_n_tail": 0.5
}  # fmt: skip


def coarse(dimension=3, **trial):
    content = swimmer_content(**({"frequency": 5.0, "amplitude": 300e3, "phase": 0.2} | trial))
    content |= {"numerics": {"nodes": 13, "step": 0.005}, "dimension": dimension}
    if dimension == 3:
        content["robot"] |= IN_SPACE
    return assemble(content, "coarse", Path("."))


def frame_of(yaw, pitch, roll):
    """Axes tau and b of a body that yaws, then pitches (head up), then rolls."""
    turned = about_b(jnp.asarray(yaw))
    half = 0.5 * pitch
    raised = turned._replace(
        w=jnp.cos(half), x=jnp.asarray(0.0), y=-jnp.sin(half), z=jnp.asarray(0.0)
    )
    q = turned.after(raised).after(about_tau(jnp.asarray(roll)))
    one, zero = jnp.asarray(1.0), jnp.asarray(0.0)
    return q.to_space(Vec(one, zero, zero)), q.to_space(Vec(zero, zero, one))


@pytest.mark.parametrize("angles", [(0.3, 0.0, 0.0), (0.0, -0.8, 0.5), (2.0, 1.1, -2.5)])
def test_the_attitude_is_yaw_then_pitch_then_roll(angles):
    tau, b = frame_of(*angles)
    found = attitude_of(0.7 * tau, 0.5 * b)
    np.testing.assert_allclose([found.yaw, found.pitch, found.roll], angles, rtol=0, atol=1e-12)


def strides(yaw=0.0, roll=0.0, slower=0.0):
    """Velocity, tau and b of three strides; yaw and roll change in each, the last is slower."""
    means = []
    for i in range(3):
        tau, b = frame_of(i * yaw, 0.0, i * roll)
        speed = 0.3 - (slower if i == 2 else 0.0)
        means.append([speed * np.array(tau), np.array(tau), np.array(b)])
    return means


def test_strides_of_a_screw_repeat_unless_the_body_has_a_weight():
    assert _alike(strides(roll=0.1), up=None)
    assert not _alike(strides(roll=0.1), up=np.array([0.0, 0.0, 1.0]))
    assert _alike(strides(yaw=0.1), up=np.array([0.0, 0.0, 1.0]))
    assert not _alike(strides(slower=1e-3), up=None)
    begun = strides(yaw=0.1)
    begun[0] = begun[1]
    assert not _alike(begun, up=None)


@pytest.fixture(scope="module")
def swum(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swum")
    (folder / "tank.toml").write_text(to_toml(coarse(roll=0.4)))
    assert main(["swim", str(folder / "tank.toml"), "--out", str(folder / "out")]) == 0
    return folder / "out"


@pytest.mark.slow
def test_a_rolled_robot_swims_as_the_planar_one(swum):
    (row,) = json.loads((swum / "swim.json").read_text())["swims"]
    velocity = np.array(row["from_rest"]["velocity_m_per_s"])
    flat = coarse(dimension=2)
    model, search = to_swimmer(to_model(flat, flat.trials[0])), steady_settings(flat, 5.0)
    _, pace = simulate_strides(model, 5.0, at_rest(model, search.numerics), 20, search)
    speed = np.linalg.norm(velocity[18:20].mean(axis=0))
    assert speed == pytest.approx(float(pace.speed), rel=1e-8)
    # No moment rights the body, so the error of each step remains: 800 steps of 1e-8 rad.
    assert row["roll_rad"] == pytest.approx(0.4, abs=8e-6)
    assert row["tail_amplitude_out_of_plane_m"] < 1e-4 * row["tail_amplitude_m"]


@pytest.mark.slow
def test_the_files_describe_the_last_stride(swum):
    (row,) = json.loads((swum / "swim.json").read_text())["swims"]
    columns = read_csv(swum / "swim_swim.csv", ("t_s", "velocity_x_m_per_s", "tip_z_m", "power_W"))
    assert columns["t_s"][-1] == pytest.approx(0.2)
    last = row["from_rest"]["velocity_m_per_s"][-1]
    assert columns["velocity_x_m_per_s"].mean() == pytest.approx(last[0], rel=1e-9)
    assert columns["power_W"].mean() == pytest.approx(row["power_W"], rel=1e-9)
    assert row["power_W"] > 0.0
    assert (swum / "swim_swim.png").stat().st_size > 10_000


def test_a_recorded_drive_is_refused(tmp_path, capsys):
    (tmp_path / "drive.csv").write_text("t_s,p_front_Pa,p_rear_Pa\n0,0,0\n1,1e5,1e5\n")
    drive = {"waveform": "recorded", "drive_file": "drive.csv"}
    (tmp_path / "tank.toml").write_text(to_toml(coarse(**drive, amplitude=None)))
    assert main(["swim", str(tmp_path / "tank.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "the drive is a recording" in capsys.readouterr().err
