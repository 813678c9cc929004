"""The model beside a simulated rig: followed in time, and an alarm when a chamber leaks."""

import json
import re

import numpy as np
import pytest

from tests.test_rig_cli import served, slider
from tests.test_rig_vents import EXPERIMENT

pytestmark = pytest.mark.slow
LEAK = 24.0
"""When it begins, on the rig's own clock [s]: the watch begins some seconds after the rig, and
learns its bands for eight."""


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    folder = tmp_path_factory.mktemp("watch")
    path = folder / "experiment.toml"
    told = EXPERIMENT.format(duration=60.0).replace("frequency = 5.0", "frequency = 2.5")
    path.write_text(told + "\n[numerics]\nnodes = 21\nstep = 0.002\n")
    leak = f"leak_front_left=4@{LEAK:g}"
    simulate = ("rig", "simulate", path, "--inject", leak)
    with served(*simulate, cwd=folder, code="import sys; ") as port:
        done = slider(
            "rig", "watch", path, "--port", port, "--rig", folder / "simulated_rig.toml",
            "--out", folder / "out", timeout=240.0, code="import sys; ",
        )  # fmt: skip
    return done, folder / "out"


def test_a_leak_raises_an_alarm_that_names_it(watched):
    done, out = watched
    assert done.returncode == 1, done.stderr
    told = json.loads((out / "watch.json").read_text())
    (alarm,) = told["alarms"]
    assert 0.0 < alarm["t_s"] - LEAK < 2.0
    assert re.search("leak", alarm["said"]) and "front" in alarm["said"]
    assert "ALARM" in done.stdout


def test_the_model_keeps_up_with_the_rig(watched):
    rows = np.genfromtxt(watched[1] / "watch.csv", delimiter=",", names=True)
    assert len(rows) > 300
    assert np.percentile(rows["lag_s"], 95) < 0.05
    late = rows["t_s"] > rows["t_s"][0] + 5.0
    assert rows["k_s"][late][-1] == pytest.approx(0.05, rel=0.05)
    assert rows["residual_thrust_N"][late].mean() < 0.05
