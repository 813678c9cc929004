"""The five head-fixed cases of an independent program."""

import json

import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.experiment import load as experiment
from tests.support.helpers import arrays, march

pytestmark = pytest.mark.optimised

MESH = Numerics(tail_cells=10, body_cells=40)
LARGEST_STEP, CHUNK = 5e-4, 100


def simulated(folder, trial_number=0):
    """Times, (thrust, recoil, tip) of our run, on steps locked to the stride."""
    case = experiment.load(folder / "experiment.toml")
    trial = case.trials[trial_number]
    model = arrays(experiment.to_model(case, trial))
    per_stride = 2 * int(np.ceil(0.5 / (trial.frequency * LARGEST_STEP)))
    h = 1.0 / (trial.frequency * per_stride)
    chunks = int(np.ceil(trial.duration / h / CHUNK))
    t, saved = march(model, h, chunks * CHUNK, numerics=MESH, chunk=CHUNK)
    return trial, t, saved


def nrmse(found, given):
    return np.sqrt(np.mean((found - given) ** 2)) / np.std(given)


@pytest.mark.parametrize(
    "name",
    [
        "inertial_4p8Hz",
        "towed_4p8Hz",
        *(
            pytest.param(x, marks=pytest.mark.slow)
            for x in ("mixed_2p2Hz", "drag_1Hz", "large_1Hz")
        ),
    ],
)
def test_agrees_with_the_independent_program(name, data):
    folder = data / "verification" / name
    cases = json.loads((folder.parent / "cases.json").read_text())
    case = next(c for c in cases if c["case"] == name)
    given = np.genfromtxt(folder / "trial_00.csv", delimiter=",", names=True)
    trial, t, saved = simulated(folder)

    at = given["t_s"][1:]
    thrust, recoil, tip = (np.interp(at, t, column) for column in saved.T)
    cycles = int(case["averaged"].split()[1])
    last = at > trial.duration - cycles / trial.frequency - 1e-9
    mean = 1e3 * thrust[last].mean()
    rms = np.sqrt(np.mean(recoil[last] ** 2))
    half_range = 500.0 * np.ptp(tip[last])
    recoil_off, tip_off = nrmse(recoil, given["recoil_N"][1:]), nrmse(tip, given["tip_m"][1:])
    print(
        f"{name}: thrust {mean:.2f} / {case['mean_thrust_mN']} mN, "
        f"recoil {rms:.4f} / {case['recoil_rms_N']} N, "
        f"tip {half_range:.2f} / {case['tip_half_range_mm']} mm, "
        f"nRMSE recoil {recoil_off:.4f}, tip {tip_off:.4f}"
    )
    assert mean == pytest.approx(case["mean_thrust_mN"], rel=0.02, abs=1.0)
    assert rms == pytest.approx(case["recoil_rms_N"], rel=0.02)
    assert half_range == pytest.approx(case["tip_half_range_mm"], rel=0.01)
    assert recoil_off < 0.06
    assert tip_off < 0.03
