"""Audit and identification of a robot with three chambers, a marker and a yaw moment."""

import numpy as np
import pytest

from calibration.identification.identify import identify_parameters, parameter_table
from calibration.model.plan import Resolution
from slider_jax.experiment.load import load
from slider_jax.io.files import write_csv
from slider_jax.simulation.trial import simulate_trial
from tests.support.experiments import SMALL

pytestmark = pytest.mark.slow

MESH = Resolution(11, 40, 5e-3)
NOISE = {"Pa": 700.0, "N": 0.01, "N m": 1e-3, "m": 3e-4}
TRUTH = {"C_d": 3.0, "m_a": 1.0, "k": 0.087, "K_Q": 4.79e-7}
GIVEN = TRUTH | {"C_d": 3.6, "K_Q": 4.5e-7}
CHAMBERS = """
[[actuators]]
kind = "pneumatic"
name = "head"
span = [0.02, 0.1]

[[actuators]]
kind = "pneumatic"
name = "mid"
span = [0.11, 0.19]
K_Q_ratio = 1.1

[[actuators]]
kind = "pneumatic"
name = "rear"
span = [0.2, 0.28]

[[sensors.channels]]
kind = "yaw_moment"
columns = ["yaw_Nm"]
noise = 1e-3

[[sensors.channels]]
kind = "marker"
name = "joint"
columns = ["joint_m"]
s = 0.3
"""
TRIAL = """
[[trials]]
file = "trial_{i:02d}.csv"
frequency = {f}
amplitude = 200000.0
rear_ratio = 0.7
phase = 0.3
duration = 1.0
"""


def write_experiment(folder, parameters):
    robot, rest = SMALL.split("[[trials]]")[0].split("front_chamber")
    rest = rest[rest.index("water_density") :]
    for name, value in TRUTH.items():
        rest = rest.replace(f"{name} = {value}", f"{name} = {parameters[name]}")
    rest = rest.replace("sample_rate", "pressure_noise = 700.0\nforce_noise = 0.01\nsample_rate")
    trials = [TRIAL.format(i=i, f=f) for i, f in enumerate((2.0, 3.0, 4.0, 5.0))]
    path = folder / "experiment.toml"
    path.write_text(robot + rest + CHAMBERS + "".join(trials))
    return load(path)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The fit to four trials. In the last one, the three columns of the pressures are swapped."""
    folder, rng = tmp_path_factory.mktemp("three"), np.random.default_rng(0)
    truth = write_experiment(folder, TRUTH)
    for trial in truth.trials:
        columns = simulate_trial(truth, trial).columns
        for x in truth.channels.values():
            columns[x.column] = columns[x.column] + NOISE[x.unit] * rng.normal(
                size=len(columns["t_s"])
            )
        if trial is truth.trials[-1]:
            names = ("p_head_Pa", "p_mid_Pa", "p_rear_Pa")
            turned = [columns[name] for name in (names[2], names[0], names[1])]
            columns |= dict(zip(names, turned, strict=True))
        write_csv(folder / trial.file, columns)
    return identify_parameters(write_experiment(folder, GIVEN), fine=MESH, coarse=MESH)


def test_the_audit_restores_the_order_of_three_pressure_columns(found):
    (finding,) = found.audit
    assert (finding.trial, finding.kind, finding.action) == (
        "trial_03.csv", "swapped_columns", "mended",
    )  # fmt: skip
    assert finding.channel == "p_head, p_mid, p_rear"


def test_all_channels_are_fitted_and_the_intervals_contain_the_truth(found):
    names = ("p_head", "p_mid", "p_rear", "thrust", "recoil", "tip", "yaw_moment", "joint")
    assert found.problem.channels == names
    assert found.fit.converged and found.fit.square / found.fit.samples < 1.1
    for value, error, (name, true) in zip(
        found.fit.theta, found.fit.errors, TRUTH.items(), strict=True
    ):
        assert abs(value - true) < 4.0 * error + 0.01 * true, name
    assert "yaw_moment" in parameter_table(found)
    noise = {c: found.problem.noise[0, c].white for c in ("yaw_moment", "joint")}
    assert noise["yaw_moment"] == 1e-3  # declared in its table
    assert noise["joint"] == pytest.approx(3e-4, rel=0.2)  # estimated from the data
