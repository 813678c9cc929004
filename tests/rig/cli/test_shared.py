"""Tests of the copy of an experiment file, and of drives that the rig cannot play."""

import pytest

from rig.cli.shared import copy_experiment, load_trials
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
    f'[[actuators]]\nkind = "pneumatic"\nname = "{name}"\nspan = [{near}, {near + 0.08}]'
    for name, near in (("head", 0.02), ("middle", 0.1), ("rear", 0.18))
)
OTHER_CHAMBERS = {
    "three chambers": (
        ("front_chamber = [0.02, 0.145]\nrear_chamber = [0.155, 0.28]\n", ""),
        ("[sensors]", f"{THREE}\n[sensors]"),
        "the robot's chambers: given head, middle, rear; allowed front, rear",
    ),
    "own phases": (
        ("rear_ratio = 0.9\nphase = 0.1\n", "phases = [0.1, 0.2]\n"),
        ("", ""),
        "trial trial_00.csv: phases: not available on the rig; use rear_ratio and phase",
    ),
}


@pytest.mark.parametrize("case", OTHER_CHAMBERS)
def test_the_rig_refuses_a_drive_that_its_manifold_cannot_play(case, tmp_path):
    *changes, message = OTHER_CHAMBERS[case]
    with pytest.raises(InputError, match=message):
        load_trials(write_small_experiment(tmp_path, *changes))
