"""Defines the robot, mesh and time step of the speed benchmark."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from slider_jax import (
    enable_float64,  # noqa: E402
    observables as obs,  # noqa: E402
)
from slider_jax.actuation import FirstOrderLag, SquareWave  # noqa: E402
from slider_jax.beam.grid import split_cells  # noqa: E402
from slider_jax.beam.parameters import Numerics, uniform_robot  # noqa: E402
from slider_jax.dynamics.model import Drive, Model  # noqa: E402
from slider_jax.dynamics.rollout import TimeGrid, rollout  # noqa: E402
from slider_jax.effects import NormalDrag, ReactiveForce  # noqa: E402
from slider_jax.supports import Clamped  # noqa: E402

enable_float64()

FREQUENCY = 4.8
"""Drive frequency [Hz]."""
STRIDES = 6
SECONDS = STRIDES / FREQUENCY
NODES, STEPS = 31, 60
"""Number of nodes, and number of time steps per stride, of the timed runs."""
SHEET = {"EI_tail": 2.9e9 * 0.03 * 0.93e-3**3 / 12, "EA_tail": 2.9e9 * 0.03 * 0.93e-3}
"""Bending and axial stiffness of a tail made of a sheet, 0.93 mm by 30 mm, with E = 2.9 GPa."""


def model(amplitude=250e3, **robot) -> Model:
    """Returns a robot that is clamped in still water and driven by a square wave of 4.8 Hz."""
    drive = Drive((SquareWave(FREQUENCY, amplitude), SquareWave(FREQUENCY, 0.9 * amplitude, 0.15)))
    body = uniform_robot(**({"body_length": 0.3, "tail_length": 0.07} | robot))
    whole = Model(
        body, (NormalDrag(3.0), ReactiveForce(1.0)), FirstOrderLag(0.087), drive, Clamped()
    )
    return jax.tree.map(lambda x: jnp.asarray(x, float), whole)


def numerics(nodes: int) -> Numerics:
    """Returns a mesh of `nodes`, divided between tail and body in proportion to their lengths."""
    return Numerics(*split_cells(nodes, 0.07, 0.3))


def run(model: Model, nodes=NODES, steps=STEPS, strides=STRIDES, checkpoint=False):
    """Returns thrust [N] and tip [m] at every step, (steps, 2), and whether all steps converged."""

    def save(x):
        return jnp.stack([obs.thrust(x), obs.tip(x)])

    times = TimeGrid.per_stride(FREQUENCY, steps, strides)
    out = rollout(model, times, save, numerics(nodes), checkpoint=checkpoint)
    return out.saved, out.ok


def with_amplitude(model: Model, amplitude) -> Model:
    """Returns the robot with the given amplitude of the set pressure [Pa]."""
    where = lambda m: tuple(wave.amplitude for wave in m.drive.waves)  # noqa: E731
    return eqx.tree_at(where, model, (amplitude, 0.9 * amplitude))


def mean_thrust_and_range(series, steps) -> np.ndarray:
    """Returns the mean thrust [N] and the tip's range [m] of the last stride."""
    last = np.asarray(series)[-steps:]
    return np.array([last[:, 0].mean(), np.ptp(last[:, 1])])
