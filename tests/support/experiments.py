"""A small experiment for the tests, with a coarse mesh and step, so that it runs fast."""

from pathlib import Path

import pytest

from slider_jax.errors import InputError
from slider_jax.experiment.load import load

ROBOT_TABLE = """\
[robot]
body_length = 0.3
tail_length = 0.07
linear_density = 0.7
EI_body = 0.038
EI_tail = 0.0058
damping_time = 0.002
height = 0.03
front_chamber = [0.02, 0.145]
rear_chamber = [0.155, 0.28]
"""
TINY = f"""
name = "tiny"
{ROBOT_TABLE}[parameters]
C_d = 3.0
m_a = 1.0
k = 0.087
K_Q = 4.79e-7
[numerics]
nodes = 11
"""
"""A robot, its parameters and its mesh, without trials."""
SMALL = f"""\
name = "small"

{ROBOT_TABLE}water_density = 1000.0

[parameters]
C_d = 3.0
m_a = 1.0
k = 0.087
K_Q = 4.79e-07

[sensors]
sample_rate = 500.0

[numerics]
nodes = 11
step = 0.005

[[trials]]
file = "trial_00.csv"
frequency = 4.0
amplitude = 150000.0
rear_ratio = 0.9
phase = 0.1
tow_speed = 0.0
duration = 0.75

[[trials]]
file = "trial_01.csv"
frequency = 2.5
amplitude = 250000.0
tow_speed = 0.2
duration = 0.9
"""


def refusal_of(path: Path) -> str:
    """Returns the text of the error with which an experiment file is refused."""
    with pytest.raises(InputError) as caught:
        load(path)
    return str(caught.value)


def channel(kind, columns, **keys):
    """Returns a table [[sensors.channels]] with these keys."""
    lines = [
        f"{k} = {x!r}".replace("'", '"')
        for k, x in ({"kind": kind, "columns": columns} | keys).items()
    ]
    return "\n".join(["[[sensors.channels]]", *lines, ""])


def write_small_experiment(folder: Path, *changes: tuple[str, str]) -> Path:
    """Writes the small experiment with each (old, new) of `changes` replaced; returns its path."""
    text = SMALL
    for old, new in changes:
        assert old in text, f"{old!r} is not in the small experiment"
        text = text.replace(old, new, 1)
    path = folder / "experiment.toml"
    path.write_text(text)
    return path
