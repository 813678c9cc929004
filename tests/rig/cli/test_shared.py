"""Tests of the copy of an experiment file."""

from rig.cli.shared import copy_experiment
from slider_jax.experiment.load import load, to_model
from tests.support.experiments import SMALL

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
