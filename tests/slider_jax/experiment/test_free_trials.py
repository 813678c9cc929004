"""Tests of trials of a free robot, and of trials that begin in periodic motion."""

import json

import numpy as np
import pytest

from slider_jax.cli.main import main
from slider_jax.experiment.load import load, to_model
from slider_jax.simulation.summary import trial_summary
from slider_jax.simulation.trial import simulate_trial
from slider_jax.supports import Free
from tests.support.experiments import write_small_experiment

FREE = ("tow_speed = 0.0\n", 'support = "free"\n')
WHERE = """
[[sensors.channels]]
kind = "marker"
name = "head"
s = 0.0
columns = ["x_m", "y_m"]

[[sensors.channels]]
kind = "speed"
columns = ["u_m_per_s"]

[[sensors.channels]]
kind = "angle"
name = "yaw"
s = 0.0
columns = ["yaw_rad"]

[[trials]]"""


def run_with(folder, *changes, **options):
    path = write_small_experiment(folder, FREE, ("\n[[trials]]", WHERE), *changes)
    return simulate_trial(load(path), **options)


def test_a_free_robot_feels_no_clamp_and_moves(tmp_path):
    series = run_with(tmp_path).series
    np.testing.assert_allclose(series["thrust"], 0.0, atol=1e-9)
    np.testing.assert_allclose(series["recoil"], 0.0, atol=1e-9)
    assert abs(series["head_x"][-1]) > 1e-4 and np.ptp(series["yaw"]) > 0.01


def test_the_heading_turns_the_path_and_nothing_else(tmp_path):
    straight = run_with(tmp_path).series
    turned = run_with(tmp_path, ('support = "free"', 'support = "free"\nheading = 0.7')).series
    np.testing.assert_allclose(turned["speed"], straight["speed"], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(turned["yaw"] - 0.7, straight["yaw"], atol=1e-9)
    x, y = straight["head_x"], straight["head_y"]
    c, s = np.cos(0.7), np.sin(0.7)
    np.testing.assert_allclose(turned["head_x"], c * x - s * y, atol=1e-9)
    np.testing.assert_allclose(turned["head_y"], s * x + c * y, atol=1e-9)


def test_a_free_robot_without_drive_coasts(tmp_path):
    """No force of the model resists straight motion, so the speed stays."""
    still = ("amplitude = 150000.0", "amplitude = 0.0")
    series = run_with(
        tmp_path, still, ('support = "free"', 'support = "free"\nstart_speed = 0.3')
    ).series
    np.testing.assert_allclose(series["speed"], 0.3, rtol=1e-9)
    t = np.linspace(0.0, 0.75, len(series["head_x"]))
    np.testing.assert_allclose(series["head_x"], 0.3 * t, atol=1e-9)


RHO, C_T, H, M, C, START = 1000.0, 0.02, 0.03, 0.7, 0.4, 0.3
FRICTIONS = {
    f'name = "tangential_friction"\nC_t = {C_T}': lambda t: (
        START / (1.0 + RHO * C_T * H / M * START * t)
    ),
    f'name = "linear_friction"\nc = {C}': lambda t: START * np.exp(-C / M * t),
}


@pytest.mark.parametrize(
    "friction", [pytest.param(x, marks=pytest.mark.slow) if "tang" in x else x for x in FRICTIONS]
)
def test_a_straight_robot_coasts_against_friction(tmp_path, friction):
    """The increments of Newton's method are rounding errors, and the steps converge.

    m dV/dt = -rho C_t H V^2 or -c V. The error of steps of 5 ms is of order (c h/m)^2 < 1e-5.
    """
    series = run_with(
        tmp_path,
        ("amplitude = 150000.0", "amplitude = 0.0"),
        ('support = "free"', f'support = "free"\nstart_speed = {START}'),
        ("\n[[trials]]", f"\n[[effects]]\n{friction}\n\n[[trials]]"),
    ).series
    t = np.linspace(0.0, 0.75, len(series["speed"]))
    np.testing.assert_allclose(series["speed"][1:], FRICTIONS[friction](t[1:]), rtol=1e-5)
    np.testing.assert_array_equal(series["head_y"], 0.0)


@pytest.mark.slow
def test_the_momentum_of_a_free_robot_in_air_stays(tmp_path):
    """Without water, the chambers cannot move the centre of mass: dp/dt = 0 in both directions."""
    air = ("C_d = 3.0\nm_a = 1.0", "C_d = 0.0\nm_a = 0.0")
    short = ("step = 0.005", "step = 0.001")
    run = run_with(tmp_path, air, short, shape=True)
    line = (
        run.series["midline"] + np.stack([run.series["head_x"], run.series["head_y"]], 1)[..., None]
    )
    ds = np.linalg.norm(np.diff(line[0], axis=1), axis=0)
    centre = (0.5 * (line[..., 1:] + line[..., :-1]) * ds).sum(-1) / ds.sum()
    moved = np.abs(centre - centre[0]).max()
    assert moved < 0.01 * np.ptp(line[..., 0], axis=0).max()


def test_lead_strides_begin_the_trial_in_later_strides(tmp_path):
    """The trial with a lead equals the end of a longer trial from rest."""
    whole = run_with(tmp_path, ("duration = 0.75", "duration = 1.25"))
    late = run_with(tmp_path, ('support = "free"', 'support = "free"\nlead_strides = 2'))
    assert late.columns["t_s"][0] == 0.0 and late.t[0] == 0.0
    n = len(late.t)
    for name, values in whole.series.items():
        np.testing.assert_allclose(late.series[name], values[-n:], rtol=1e-9, atol=1e-12)
    columns = whole.columns["t_s"] >= 0.5 - 1e-9
    np.testing.assert_allclose(
        late.columns["x_m"], whole.columns["x_m"][columns], rtol=1e-9, atol=1e-12
    )


def test_the_summary_of_a_free_trial_has_speed_and_course_and_no_forces(tmp_path):
    """A robot without drive keeps its speed; backwards, its speed is negative."""
    for speed in (0.3, -0.3):
        free = f'support = "free"\nstart_speed = {speed}\nheading = 0.4'
        changes = ("amplitude = 150000.0", "amplitude = 0.0"), ('support = "free"', free)
        path = write_small_experiment(tmp_path, FREE, *changes)
        result = trial_summary(load(path), simulate_trial(load(path)))
        assert result["mean_thrust_N"] is None and result["recoil_rms_N"] is None
        assert result["forward_speed_m_per_s"] == pytest.approx(speed, rel=1e-9)
        assert result["course_rad"] == pytest.approx(0.4 if speed > 0.0 else 0.4 - np.pi)
        assert result["periodic"]


@pytest.mark.slow
def test_a_changing_speed_is_not_periodic(tmp_path, capsys):
    """The robot starts at rest, so its speed differs from stride to stride."""
    path = write_small_experiment(tmp_path, FREE)
    assert main(["simulate", str(path), "--out", str(tmp_path / "out")]) == 0
    free, clamped = (
        next(x for x in lines if "Hz" in x and name in x)
        for lines in [capsys.readouterr().err.splitlines()]
        for name in ("trial_00", "trial_01")
    )
    assert "forward speed" in free and "course" in free and "thrust" not in free
    assert "thrust" in clamped and "speed" not in clamped
    result, _ = json.loads((tmp_path / "out" / "summary.json").read_text())["trials"]
    assert result["periodic"] is False and "forward speed from" in result["warnings"][0]


def test_the_support_comes_from_the_trial(tmp_path):
    path = write_small_experiment(
        tmp_path, ("tow_speed = 0.0", 'support = "free"\nstart_speed = 0.1')
    )
    support = to_model(load(path)).support
    assert isinstance(support, Free) and support.speed == pytest.approx(0.1)
