"""Tests of [[sensors.channels]]: readings against other observables, columns, noise, bad input."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from slider_jax.experiment.load import load
from slider_jax.simulation.trial import simulate_trial
from tests.support.experiments import channel, refusal_of, write_small_experiment

LENGTH = 0.37


def with_channels(folder, channels, *changes):
    """Writes the small experiment with the tables `channels`."""
    return write_small_experiment(folder, ("[numerics]", f"{channels}\n[numerics]"), *changes)


def run_with(folder, channels, *changes, trial=0):
    return simulate_trial(load(with_channels(folder, channels, *changes)), trial, shape=True)


def test_markers_read_the_midline(tmp_path):
    tables = channel("marker", ["y_end_m"], name="end", s=LENGTH)
    tables += channel("marker", ["x_end_m", "y2_m"], name="pair", s=LENGTH)
    tables += channel("marker", ["x_head_m", "y_head_m"], name="head", s=0.0)
    tables += channel("marker", ["y_joint_m"], name="joint", s=0.3)
    run = run_with(tmp_path, tables, trial=1)
    series, midline = run.series, run.series["midline"]
    for name in ("end", "pair_y"):
        np.testing.assert_allclose(series[name][1:], series["tip"][1:], atol=1e-12)
        assert abs(series[name][0]) < 1e-4  # the reading at t = 0 is extrapolated
    towed = 0.2 * run.t
    np.testing.assert_allclose(series["head_x"], towed, atol=1e-9)
    np.testing.assert_allclose((series["pair_x"] - towed)[1:], midline[1:, 0, 0], atol=1e-9)
    joint = 2  # the tail of 0.07 m has two of the ten cells
    np.testing.assert_allclose(series["joint"][1:], midline[1:, 1, joint], atol=1e-10)
    assert "y_joint_m" in run.columns and len(run.columns["y_joint_m"]) == len(run.columns["t_s"])


@pytest.mark.slow
def test_a_marker_between_nodes_is_on_the_smooth_midline(tmp_path):
    """A spline through the nodes is the reference. A chord would be wrong by about 0.06 mm."""
    marker = channel("marker", ["x_m", "y_m"], name="m", s=0.22)
    run = run_with(tmp_path, marker, ("nodes = 11", "nodes = 21"))
    line = run.series["midline"]
    s = np.concatenate([np.linspace(0.37, 0.3, 5)[:-1], np.linspace(0.3, 0.0, 17)])
    assert np.abs(s - 0.22).min() > 0.001
    spline = CubicSpline(s[::-1], line[:, :, ::-1], axis=2)(0.22)
    for axis, name in enumerate("xy"):
        np.testing.assert_allclose(run.series[f"m_{name}"][1:], spline[1:, axis], atol=5e-6)


@pytest.mark.slow
def test_angle_rate_curvature_and_moment_agree_with_the_motion(tmp_path):
    tables = "".join(
        channel(kind, [f"{kind}_{i}"], name=f"{kind}_{i}", s=s)
        for kind in ("angle", "turning_rate", "curvature")
        for i, s in enumerate((0.2, 0.22))
    )
    tables += channel("yaw_moment", ["Mz_N_m"])
    tables += channel("speed", ["u_m_per_s"])
    run = run_with(
        tmp_path, tables, ("step = 0.005", "step = 0.001"), ("nodes = 11", "nodes = 75"), trial=1
    )
    x = run.series
    rate = np.gradient(x["angle_0"], run.t)
    inner = slice(50, -50)
    np.testing.assert_allclose(
        x["turning_rate_0"][inner], rate[inner], atol=0.01 * np.abs(rate).max()
    )
    mean = (x["angle_0"] - x["angle_1"]) / 0.02  # towards the head
    bend = 0.5 * (x["curvature_0"] + x["curvature_1"])
    assert np.sqrt(np.mean((mean - bend) ** 2)) < 0.05 * np.sqrt(np.mean(bend**2))
    np.testing.assert_allclose(x["yaw_moment"][1:], -x["moment"][1:, -1], atol=1e-12)
    np.testing.assert_allclose(x["speed"], 0.2, atol=1e-12)


def test_a_table_renames_the_column_of_a_built_in_channel(tmp_path):
    tables = channel("pressure", ["P2_Pa"], actuator="rear", noise=500.0, gain=0.01)
    tables += channel("thrust", ["Fx_N"], discrepancy=0.02)
    channels = load(with_channels(tmp_path, tables)).channels
    assert channels.columns == ("t_s", "p_front_Pa", "P2_Pa", "Fx_N", "recoil_N", "tip_m")
    rear, thrust = channels["p_rear"], channels["thrust"]
    assert (rear.noise, rear.white, rear.gain) == ("", 500.0, 0.01)
    assert (thrust.noise, thrust.share_key, thrust.discrepancy) == ("force_noise", "", 0.02)


def test_equal_experiments_have_equal_channels(tmp_path):
    """Programs with equal channels are compiled once."""
    tables = channel("marker", ["x_m", "y_m"], name="m", s=0.16)
    first, second = (load(with_channels(tmp_path, tables)).channels for _ in range(2))
    assert first == second and hash(first) == hash(second)


CASES = {
    "unknown kind": (
        channel("strain", ["e"], name="e", s=0.1),
        "sensors.channels.0.kind: given 'strain'; allowed",
    ),
    "no columns": ('[[sensors.channels]]\nkind = "speed"\n', "sensors.channels.0.columns: missing"),
    "empty columns": (
        channel("speed", []),
        "sensors.channels.0.columns: Value should have at least 1 item",
    ),
    "marker without place": (
        channel("marker", ["y_m"], name="m"),
        "sensors.channels.0.s: given nothing; allowed a distance from the head in m",
    ),
    "marker without name": (
        channel("marker", ["y_m"], s=0.1), "sensors.channels.0.name: given nothing; allowed a name",
    ),
    "marker in millimetres": (
        channel("marker", ["y_m"], name="m", s=160.0),
        "sensors.channels.0.s: given 160.0; allowed 0 to 3",
    ),
    "marker beyond the robot": (
        channel("marker", ["y_m"], name="m", s=0.5),
        "sensors.channels.0.s: given 0.5; allowed 0 to 0.37 m, the robot's length",
    ),
    "three columns": (
        channel("marker", ["x_m", "y_m", "z_m"], name="m", s=0.1), "sensors.channels.0.columns: ",
    ),
    "two columns of an angle": (
        channel("angle", ["a", "b"], name="m", s=0.1),
        "sensors.channels.0.columns: given ['a', 'b']; allowed 1 column for the kind angle",
    ),
    "place of a force": (
        channel("thrust", ["Fx_N"], s=0.1), "sensors.channels.0.s: given 0.1; allowed a distance",
    ),
    "name of a force": (
        channel("thrust", ["Fx_N"], name="fx"),
        "sensors.channels.0.name: given 'fx'; allowed nothing",
    ),
    "pressure without actuator": (
        channel("pressure", ["P_Pa"]),
        "sensors.channels.0.actuator: given nothing; allowed the name",
    ),
    "pressure of an unknown actuator": (
        channel("pressure", ["P_Pa"], actuator="middle"),
        "sensors.channels.0.actuator: given 'middle'; allowed chambers: front, rear",
    ),
    "column of another channel": (
        channel("marker", ["tip_m"], name="m", s=0.1),
        "channel m (column tip_m): another channel has",
    ),
    "column of the time": (
        channel("speed", ["t_s"]),
        "channel speed (column t_s): another channel has this name or column",
    ),
    "same name twice": (
        channel("angle", ["a"], name="m", s=0.1) + channel("angle", ["b"], name="m", s=0.2),
        "channel m (column b): another channel has this name or column",
    ),
    "negative noise": (
        channel("speed", ["u"], noise=-1.0),
        "sensors.channels.0.noise: given -1.0; allowed 0 to 100000",
    ),
    "gain in percent": (
        channel("speed", ["u"], gain=2.0), "sensors.channels.0.gain: given 2.0; allowed 0 to 0.5",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_wrong_channels_are_one_clear_error(case, tmp_path):
    tables, message = CASES[case]
    assert message in refusal_of(with_channels(tmp_path, tables))
