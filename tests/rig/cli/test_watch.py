"""`slider rig watch` with a simulated rig keeps up, and raises an alarm when a chamber leaks."""

import json
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest

from tests.support.command import served, slider
from tests.support.data import ROOT
from tests.support.rig_experiment import EXPERIMENT, HANDLES_CTRL_C

pytestmark = pytest.mark.slow
LEAK = 34.0
"""Start of the leak on the rig's clock [s]. The watch starts some seconds after the rig, and learns
its bands for 8 s."""


def robot_in(folder):
    path = folder / "experiment.toml"
    text = EXPERIMENT.format(duration=60.0).replace("frequency = 5.0", "frequency = 2.5")
    path.write_text(text + "\n[numerics]\nnodes = 51\nstep = 0.002\n")
    return path


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    folder = tmp_path_factory.mktemp("watch")
    path = robot_in(folder)
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
    content = json.loads((out / "watch.json").read_text())
    (alarm,) = content["alarms"]
    assert 0.0 < content["t_0_device_s"] + alarm["t_s"] - LEAK < 2.0
    assert re.search("leak", alarm["said"]) and "front" in alarm["said"]
    assert "ALARM" in done.stdout


def test_the_model_keeps_up_with_the_rig(watched):
    rows = np.genfromtxt(watched[1] / "watch.csv", delimiter=",", names=True)
    assert len(rows) > 300
    assert np.percentile(rows["lag_s"], 95) < 0.05
    assert rows["t_s"][0] < 0.1
    late = rows["t_s"] > 5.0
    assert rows["k_s"][late][-1] == pytest.approx(0.05, rel=0.05)
    assert rows["residual_thrust_N"][late].mean() < 0.05


def test_a_healthy_robot_raises_no_alarm_and_ctrl_c_keeps_the_results(tmp_path):
    path, out = robot_in(tmp_path), tmp_path / "out"
    with served("rig", "simulate", path, cwd=tmp_path, code="import sys; ") as port:
        words = ("rig", "watch", path, "--port", port, "--rig", tmp_path / "simulated_rig.toml",
                 "--out", out)  # fmt: skip
        child = subprocess.Popen(
            [sys.executable, "-c", HANDLES_CTRL_C, *map(str, words)], stderr=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        for line in child.stderr:
            if re.match(r" +[234]\d\.\d s", line):
                break
        child.send_signal(signal.SIGINT)
        output, errors = child.communicate(timeout=60.0)
    assert child.returncode == 130, errors
    assert "ms late" in output and "ALARM" not in output
    content = json.loads((out / "watch.json").read_text())
    assert content["alarms"] == [] and content["ended"] == "stopped"
    rows = np.genfromtxt(out / "watch.csv", delimiter=",", names=True)
    assert rows["t_s"][-1] > 20.0
    # The model uses the played drive, so the pressures' residual is within their noise.
    assert rows["residual_p_front_Pa"][rows["t_s"] > 5.0].mean() < 1000.0
