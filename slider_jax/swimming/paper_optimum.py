"""Defines the paper's optimal swimmer as an experiment, and the published performance."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from slider_jax import paper
from slider_jax.beam.parameters import SLIDER
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, assemble, load
from slider_jax.swimming.gait import CAP, Gait

HEAD_DRAG = 1.79e-3
"""Form-drag area [m^2] of the head, calibrated so that this model's speed at the paper's optimum
equals the measured speed."""

PAPER_GAIT = Gait(6.3, 448e3, 414e3, 0.14, 0.053, 0.017)
"""The paper's optimal gait."""


class Published(NamedTuple):
    """A quantity in the paper: the value of the paper's model, and the measured value."""

    model: float
    experiment: float | None


MEASURED_SPEED = 0.217
"""Measured speed [m/s] at `PAPER_GAIT`."""
PUBLISHED = {
    "speed_m_per_s": Published(0.232, MEASURED_SPEED),
    "tail_slope": Published(0.57, None),
    "shape_tail_slope": Published(0.51, None),
}
"""Published values, with the keys of `swim_record`. The paper states the tail slope 0.57. With the
paper's tail amplitude A_t and wavelength lambda, A_t/(lambda/4) is 0.51. A sine wave with this A_t
and lambda has a root mean square slope of 0.57."""


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
