"""Defines the paper's optimal swimmer as an experiment, and the published performance."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from slider_jax import paper
from slider_jax.beam.parameters import SLIDER
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, assemble, load
from slider_jax.swimming.gait import CAP, Gait

PAPER_GAIT = Gait(6.3, 448e3, 414e3, 0.14, 0.053, 0.017)
"""The paper's optimal gait, and the tail of the paper's model."""
MEASURED_GAIT = PAPER_GAIT._replace(tail_length=0.070)
"""The gait of the experiment: the paper adjusted the tail to 70 mm."""
MEASURED_SPEED = 0.217
"""Measured speed [m/s] with `MEASURED_GAIT`; the paper's table rounds it to 22 cm/s."""

HEAD_DRAG = 1.79e-3
"""Form-drag area [m^2] of the head of the built-in swimmer. With it, this model has the measured
speed with `PAPER_GAIT`, although this speed was measured with `MEASURED_GAIT`."""
HEAD_DRAG_70_MM = 1.917e-3
"""Form-drag area [m^2] with which this model has the measured speed with `MEASURED_GAIT`."""


class Published(NamedTuple):
    """A quantity in the paper: the value of the paper's model, and the measured value.

    The tail had 53 mm in the model and 70 mm in the experiment.
    """

    model: float
    experiment: float


PUBLISHED = {
    "speed_m_per_s": Published(0.232, MEASURED_SPEED),
    "slender_efficiency": Published(0.57, 0.57),
    "tail_amplitude_m": Published(0.036, 0.039),
    "strouhal": Published(1.96, 2.12),
    "tail_slope": Published(0.57, 0.59),
    "shape_wavelength_m": Published(0.28, 0.265),
    "shape_tail_slope": Published(0.51, 0.59),
}
"""Published values, with the keys of `swim_record`. The paper does not define its wavelength
lambda, which is compared with the wavelength of the shape. Its table states the tail slope 0.57 for
the model. With the model's tail amplitude A_t and lambda, A_t/(lambda/4) is 0.51. A sine wave with
this A_t and lambda has a root mean square slope of 0.57."""


def swimmer_content(**trial: Any) -> dict[str, Any]:
    """Returns the tables of an experiment: built-in robot, form drag at the head, and one trial."""
    robot = dict(SLIDER)
    K_Q = robot.pop("K_Q")
    return {
        "name": "swimmer",
        "robot": robot,
        "parameters": {"force_coefficients": "ramp", "k": paper.PRESSURE_LAG, "K_Q": K_Q},
        "effects": [{"name": "head_drag", "area": HEAD_DRAG}],
        "trials": [{"file": "swim.csv", "duration": 10.0} | trial],
    }


def optimum() -> Experiment:
    """Returns the experiment with `PAPER_GAIT`, the built-in robot and form drag at its head."""
    f, front, rear, phase, tail_length, EI_tail = PAPER_GAIT
    content = swimmer_content(frequency=f, amplitude=front, rear_ratio=rear / front, phase=phase)
    content["robot"] |= {"tail_length": tail_length, "EI_tail": EI_tail}
    return assemble(content, "the paper's optimum", Path("."))


def example_climber() -> Experiment:
    """Returns the built-in robot with an assumed climbing drive; the paper states no drive."""
    content = swimmer_content(file="climb.csv", frequency=2.0, amplitude=CAP)
    return assemble(content | {"effects": []}, "the built-in climber", Path("."))


def given_or(
    default: Callable[[], Experiment],
    path: Path | None,
    model: Path | None,
    *,
    spatial: bool = False,
) -> Experiment:
    """Returns the experiment of the file `path`, changed by the file `model`; see `load`.

    Without `path`, returns `default()`. Raises `InputError` as `load` does, and for a model file
    without an experiment.
    """
    if path is not None:
        return load(path, model, spatial=spatial)
    if model is not None:
        raise InputError("--model: this file changes an experiment; give EXPERIMENT.toml too")
    return default()
