"""A heaving and pitching foil against linear elongated-body theory, as in `examples/foil`."""

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from slider_jax.experiment import load
from slider_jax.supports import Clamped
from tests.support.data import ROOT
from tests.support.helpers import arrays, march, order

FOLDER = ROOT / "examples" / "foil"
STEPS, CHUNK = 3200, 800
"""Steps per period. The first quarter of a period is omitted."""


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("foil_example", FOLDER / "foil.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def errors(example):
    """rms of simulation minus theory over the rms of the theory, for thrust and side force."""
    experiment = load.load(FOLDER / "experiment.toml")
    trial = experiment.trials[0]
    model, (numerics, _) = load.to_model(experiment, trial), load.to_numerics(experiment)
    foil, found = example.foil_of(model.robot), {}
    for scale in (1.0, 2.0, 4.0):
        motion = example.Motion(
            trial.clamp_frequency,
            scale * trial.heave,
            scale * trial.pitch,
            trial.pitch_phase,
            trial.tow_speed,
        )
        support = Clamped(motion.speed, motion.heave, motion.pitch, motion.frequency, motion.phase)
        run = arrays(replace(model, support=support))
        h = 1.0 / (motion.frequency * STEPS)
        t, saved = march(run, h, 5 * STEPS // 4, numerics=numerics, chunk=CHUNK)
        t, saved = t[-STEPS:], saved[-STEPS:, :2]
        theory = np.stack(example.linear_forces(foil, motion, t), axis=1)
        found[scale] = np.sqrt(np.mean((saved - theory) ** 2, 0) / np.mean(theory**2, 0))
        print(f"amplitude {scale}: error of thrust and side force {100 * found[scale]} %")
    return found


@pytest.mark.slow
def test_forces_in_time_are_those_of_linear_theory(errors):
    """1 % of the rms (declared before) at heave/length 0.03 and pitch 0.05 rad."""
    assert np.all(errors[1.0] < 0.01)


@pytest.mark.slow
def test_error_falls_with_the_square_of_the_amplitude(errors):
    """Order 2 of both forces, between four and two times the amplitudes of the example."""
    thrust, side = (order([2.0, 4.0], [errors[2.0][i], errors[4.0][i]]) for i in range(2))
    print(f"order of thrust {thrust:.2f}, of side force {side:.2f}")
    assert thrust == pytest.approx(2.0, abs=0.2) and side == pytest.approx(2.0, abs=0.2)
