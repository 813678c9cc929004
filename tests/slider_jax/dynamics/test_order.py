"""Order of convergence in space and time of a bent, driven swimmer in water, by regression."""

import itertools

import numpy as np
import pytest

from slider_jax.actuation import SineWave
from slider_jax.beam.parameters import Numerics
from slider_jax.dynamics.time_schemes import BACKWARD_EULER, SDIRK2
from tests.support.helpers import SMALL, march, order, swimmer

NAMES = ("thrust", "recoil", "tip")
SPAN = 0.2


def smooth_swimmer():
    """Driven by a sine, so that the order is the scheme's and not that of an edge."""
    return swimmer(wave=SineWave, frequency=4.8, phase=0.0, C_d=2.0)


def series(numerics, scheme, steps, keep):
    """(keep, 3) samples of thrust, recoil and tip at common times."""
    _, saved = march(smooth_swimmer(), SPAN / steps, steps, numerics=numerics, scheme=scheme)
    return saved[steps // keep - 1 :: steps // keep]


def changes(runs):
    """rms of the change from each run to the next finer one, over the finest run's rms: (k, 3)."""
    size = np.sqrt(np.mean(runs[-1] ** 2, axis=0))
    return [np.sqrt(np.mean((a - b) ** 2, axis=0)) / size for a, b in itertools.pairwise(runs)]


@pytest.mark.parametrize(
    "scheme", [pytest.param(BACKWARD_EULER, marks=pytest.mark.slow), SDIRK2], ids=lambda s: s.name
)
def test_order_in_time_is_the_schemes_own(scheme):
    steps = [160, 320, 640, 1280]
    error = np.array(changes([series(SMALL, scheme, n, 80) for n in steps]))
    slopes = [-order(steps[:-1], column) for column in error.T]
    print(scheme.name, dict(zip(NAMES, slopes, strict=True)), error[-1])
    assert np.allclose(slopes, scheme.order, atol=0.2)


@pytest.mark.slow
def test_order_in_space_is_two():
    cells = [10, 20, 40, 80]
    meshes = [Numerics(tail_cells=n // 5, body_cells=n - n // 5) for n in cells]
    error = np.array(changes([series(mesh, SDIRK2, 160, 80) for mesh in meshes]))
    slopes = [-order(cells[:-1], column) for column in error.T]
    print("space", dict(zip(NAMES, slopes, strict=True)), error[-1])
    assert np.allclose(slopes, 2.0, atol=0.3)
