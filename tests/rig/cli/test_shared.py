"""Tests of the copy of an experiment file, and of the chambers and drives of a file."""

import jax.numpy as jnp
import numpy as np
import pytest

from rig.chambers import SLIDER
from rig.cli.shared import copy_experiment, layout_in, load_trials
from rig.errors import RigError
from rig.manifold.limits import PressureLimits
from slider_jax.errors import InputError
from slider_jax.experiment.load import load, to_model
from tests.support.experiments import SMALL, write_small_experiment

SEGMENTS = """
[[robot.segments]]
length = 0.3
profile = "body.csv"
"""


def test_the_copy_of_an_experiment_contains_the_profiles(tmp_path):
    start, end = SMALL.index("body_length"), SMALL.index("front_chamber")
    common = "linear_density = 0.7\ndamping_time = 0.002\nheight = 0.03\n"
    text = SMALL[:start] + common + SMALL[end:]
    given, copy = tmp_path / "given", tmp_path / "copy"
    given.mkdir()
    copy.mkdir()
    path = given / "robot.toml"
    path.write_text(text.replace("\n[parameters]", f"{SEGMENTS}\n[parameters]"))
    (given / "body.csv").write_text("s_m,EI_N_m2\n0,0.04\n0.3,0.03\n")
    copy_experiment(path, copy)
    assert to_model(load(copy / "experiment.toml")).robot.body.EI.tolist() == [[0.04, 0.03]]


THREE = "\n".join(
    f'[[actuators]]\nkind = "pneumatic"\nname = "{name}"\nspan = [{near}, {near + 0.08}]\n{more}'
    for name, near, more in (
        ("head", 0.02, ""),
        ("middle", 0.1, 'side = "left"'),
        ("rear", 0.18, 'side = "right"'),
    )
)
CHAMBERS = "front_chamber = [0.02, 0.145]\nrear_chamber = [0.155, 0.28]\n"
OWN = (
    "rear_ratio = 0.9\nphase = 0.1\n",
    "ratios = [1.0, 0.8, -0.7]\nphases = [0.0, 0.1, 0.3]\nbiases = [1e4, 2e4, -3e4]\n",
)
PRESSURE = """
[[sensors.channels]]
kind = "pressure"
actuator = "middle"
columns = ["P2_Pa"]
"""


def three_chambers(folder, *changes):
    """Writes an experiment with a pair and two single chambers, and returns its path."""
    return write_small_experiment(
        folder, (CHAMBERS, ""), ("[sensors]", f"{THREE}\n[sensors]"), *changes
    )


def test_the_chambers_are_those_of_the_experiment_file(tmp_path):
    path = three_chambers(tmp_path, ("[numerics]", f"{PRESSURE}\n[numerics]"))
    layout = layout_in(path)
    assert layout.names == ("head_left", "head_right", "middle", "rear")
    assert layout.columns == ("p_head_Pa", "P2_Pa", "p_rear_Pa")
    assert layout_in(None) == SLIDER


@pytest.mark.parametrize(
    "changes",
    [
        (),
        (OWN,),
        (OWN, ("frequency = 4.0", 'frequency = 4.0\nwaveform = "sine"')),
        (OWN, ("frequency = 4.0", 'frequency = 4.0\nwaveform = "trapezoid"')),
    ],
)
def test_the_rig_plays_the_drive_that_the_simulator_simulates(changes, tmp_path):
    path = three_chambers(tmp_path, *changes)
    _, (trial, _) = load_trials(path)
    assert_equals_the_simulated_drive(trial.drive, to_model(load(path)).drive)


def assert_equals_the_simulated_drive(drive, simulated):
    for t in np.random.default_rng(0).uniform(0.0, 0.7, 100):
        at = jnp.asarray(t), jnp.asarray(t + 1e-7)
        expected = [float(wave.segment(*at).a0) for wave in simulated.waves]
        assert drive.signed(float(t)) == pytest.approx(expected, abs=1.0)


def test_the_rig_plays_a_recorded_drive_of_three_chambers(tmp_path):
    recorded = ("frequency = 4.0", 'waveform = "recorded"\ndrive_file = "drive.csv"')
    path = three_chambers(tmp_path, recorded)
    t = np.arange(0.0, 0.76, 0.01)
    waves = [2e5 * np.sin(20.0 * t - shift) for shift in (0.0, 1.0, 2.0)]
    rows = "\n".join(",".join(f"{x:.6g}" for x in row) for row in zip(t, *waves, strict=True))
    (tmp_path / "drive.csv").write_text(f"t_s,p_head_Pa,p_middle_Pa,p_rear_Pa\n{rows}\n")
    drive = load_trials(path)[1][0].drive
    cut = np.clip(waves, [[-2e6], [0.0], [-2e6]], [[2e6], [2e6], [0.0]])
    for i in (3, 11, 40):
        assert drive.signed(float(t[i])) == pytest.approx(cut[:, i], abs=2.0)


def test_a_drive_above_the_limit_of_an_actuator_is_refused(tmp_path):
    limited = ('side = "left"', 'side = "left"\nlimit = 1.2e5')
    path = three_chambers(tmp_path, limited)
    layout = layout_in(path)
    limits = PressureLimits.of([250e3], layout)
    assert limits.pressures == (250e3, 250e3, 1.2e5, 250e3)
    _, (trial, _) = load_trials(path)
    with pytest.raises(RigError, match="of middle: given 142500 Pa; allowed 0 to its limit, 1200"):
        trial.check(limits)


def test_more_chambers_than_a_frame_holds_are_refused(tmp_path):
    many = "\n".join(
        f'[[actuators]]\nkind = "pneumatic"\nname = "c{i}"\nspan = [{i / 100}, {i / 100 + 0.009}]'
        for i in range(20)
    )
    path = write_small_experiment(tmp_path, (CHAMBERS, ""), ("[sensors]", f"{many}\n[sensors]"))
    with pytest.raises(InputError, match="the robot's chambers: given 40; allowed at most 38"):
        load_trials(path)


def test_a_robot_without_chambers_is_refused(tmp_path):
    path = write_small_experiment(
        tmp_path, (CHAMBERS, ""), ("amplitude = 150000.0", "amplitude = 0.0"),
        ("amplitude = 250000.0", "amplitude = 0.0"),
    )  # fmt: skip
    with pytest.raises(InputError, match="the robot's chambers: given none; allowed one or more"):
        load_trials(path)
