"""What another pressure model changes for the robot: thrust under a square-wave drive."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from slider_jax.experiment.load import Experiment, assemble
from slider_jax.observables.strides import stride_means
from slider_jax.simulation.effect_signature import FREQUENCY, built_in
from slider_jax.simulation.trial import simulate


class Consequence(NamedTuple):
    """The built-in robot's last stride at `FREQUENCY`, for one pressure model."""

    mean_thrust_N: float
    recoil_rms_N: float
    tip_half_range_m: float
    pressure_half_range_Pa: float
    """Of the front chamber."""


def consequence(parameters: Mapping[str, float], effects: list[dict]) -> Consequence:
    """Run the built-in robot with its square wave, `parameters` and `effects` replaced.

    Both as an experiment file has them. Raises `SolverError` where a step fails.
    """
    experiment = built_in()
    content = experiment.model_dump() | {"effects": effects}
    content["parameters"] = content["parameters"] | dict(parameters)
    return _last_stride(assemble(content, "built-in robot", experiment.folder))


def _last_stride(experiment: Experiment) -> Consequence:
    run = simulate(experiment)
    half = run.clock.half_period
    assert half is not None
    last = slice(len(run.t) - 2 * half, len(run.t))
    thrust = stride_means(jnp.asarray(run.series["thrust"][1:]), 2 * half)
    return Consequence(
        float(thrust[-1]),
        float(np.sqrt(np.mean(run.series["recoil"][last] ** 2))),
        0.5 * float(np.ptp(run.series["tip"][last])),
        0.5 * float(np.ptp(run.series["pressure"][last, 0])),
    )


def compared(models: Mapping[str, tuple[Mapping[str, float], list[dict]]]) -> dict:
    """`consequence` of several models by name, with the drive that they share."""
    trial = built_in().trials[0]
    return {
        "frequency_Hz": FREQUENCY,
        "waveform": trial.waveform,
        "amplitude_Pa": trial.amplitude,
        "robot": "built-in",
        **{name: consequence(*model)._asdict() for name, model in models.items()},
    }
