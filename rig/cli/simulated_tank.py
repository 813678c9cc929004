"""The simulated robot as what a simulated rig drives and measures."""

from rig.simulated.tank import Measured
from slider_jax.experiment.load import Experiment
from slider_jax.realtime.plant import Plant

SUPPLY = 600e3
"""Gauge pressure of the made-up supply [Pa]."""
STEP = 1e-3
"""Of the plant [s]: of 2 ms each edge would leave a spike of a tenth of a newton in the recoil."""


class RobotTank:
    """A `rig.simulated.tank.Tank` of an experiment's robot, water and effects."""

    def __init__(self, experiment: Experiment):
        self.plant = Plant(experiment, step=STEP)

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> Measured:
        """As `Tank.advance`."""
        found = self.plant.advance(set_pressures or [None] * 4, seconds)
        a, b, c, d = (float(p) for p in found.pressures)
        return Measured((a, b, c, d), SUPPLY, found.thrust_N, found.recoil_N, found.tip_m)
