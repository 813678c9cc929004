"""Defines the built-in robot on its way from the water to the wall, with an optimised schedule."""

from pathlib import Path
from typing import Any

from slider_jax import paper
from slider_jax.beam.parameters import SLIDER
from slider_jax.experiment.load import Experiment, assemble
from slider_jax.swimming.paper_optimum import HEAD_DRAG

SWIM = {
    "frequency": 4.503,
    "front": 443.7e3,
    "rear": 444.1e3,
    "phase": 0.1768,
    "grip_phase": 0.001789,
}
CLIMB = {
    "frequency": 3.494,
    "front": 172.3e3,
    "rear": 172.0e3,
    "phase": -0.1745,
    "grip_phase": 0.001789,
}
SWITCH = 2.795
"""Time [s] at which the swimming gait ends."""
TAIL = {"tail_length": 0.04461, "EI_tail": 0.02094}
"""The optimum of `slider optimize transition --generations 60`, rounded."""


def example_crosser() -> Experiment:
    """Returns the built-in robot, neutrally buoyant, 1 m below the surface under a wall."""
    robot: dict[str, Any] = dict(SLIDER)
    K_Q = robot.pop("K_Q")
    schedule = [{"time": 0.0, **SWIM}, {"time": SWITCH, **SWIM}, {"time": SWITCH + 0.5, **CLIMB}]
    content = {
        "name": "transition",
        "robot": robot | {"density": 1000.0} | TAIL,
        "parameters": {"C_d": 3.0, "m_a": 1.0, "k": paper.PRESSURE_LAG, "K_Q": K_Q},
        "effects": [{"name": "head_drag", "area": HEAD_DRAG}],
        "numerics": {"nodes": 31, "step": 2.5e-3},
        "transition": {"depth": 1.0, "height": 0.5, "wall_from": -0.1, "duration": 40.0,
                       "schedule": schedule},
        "trials": [{"file": "transition.csv", "frequency": 5.5, "amplitude": 400e3,
                    "duration": 60.0}],
    }  # fmt: skip
    return assemble(content, "the built-in crosser", Path("."))
