"""Simple models of the chambers and the tail for the simulated rig."""

from math import exp
from random import Random
from typing import NamedTuple, Protocol

from rig.chambers import SLIDER, ChamberLayout


class TankState(NamedTuple):
    """True state of a tank at one time."""

    chambers: tuple[float, ...]
    """Gauge pressures of the chambers [Pa]."""
    supply: float
    """Gauge pressure of the supply [Pa]."""
    thrust: float
    """Thrust [N]."""
    recoil: float
    """Recoil [N]."""
    tip: float
    """Lateral position of the tip [m]."""


class Tank(Protocol):
    """Model of a robot in water, or a simpler model with the same signals."""

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> TankState:
        """Returns the state after `seconds` at set gauge pressures (chambers,) [Pa]; None vents."""
        ...


class BenchTank:
    """Chambers with a first-order lag, and a tail in air that follows the sum of signed pressures.

    This tank is for trying the rig's commands: thrust and tip depend on the set pressures, but the
    tank is not a model of swimming. `lag` and `tail` [s] are the time constants of chambers and
    tail. `leak` [1/s] is the relative loss rate of each chamber's pressure. `gain` [m/Pa] is the
    tip's excursion per sum of the signed pressures.
    """

    def __init__(
        self,
        layout: ChamberLayout = SLIDER,
        lag: float = 0.05,
        supply: float = 600e3,
        gain: float = 2e-7,
        tail: float = 0.02,
    ):
        self.lag, self.supply, self.gain, self.tail = lag, supply, gain, tail
        self._layout = layout
        self.leak = [0.0] * len(layout.names)
        self._p = [0.0] * len(layout.names)
        self._tip = 0.0

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> TankState:
        """Implements `Tank.advance`. Pressures are exact; the tip's error is of order `seconds`."""
        wanted = set_pressures or (0,) * len(self._p)
        for i, target in enumerate(wanted):
            rate = 1.0 / self.lag + self.leak[i]
            steady = target / (self.lag * rate)
            self._p[i] = steady + (self._p[i] - steady) * exp(-rate * seconds)
        signed = self._layout.signed(self._p)
        aim = self.gain * sum(signed)
        self._tip = aim + (self._tip - aim) * exp(-seconds / self.tail)
        speed = (aim - self._tip) / self.tail
        forces = 2.0 * speed**2, -1e-6 * signed[0]
        return TankState(tuple(self._p), self.supply, *forces, self._tip)


class BenchChamber:
    """One chamber with a fill and a vent valve, as driven by the published firmware.

    The flow is proportional to a valve's duty and to the pressure difference across the valve. If
    the valve is fully open, this difference decreases to 37 % within `lag` [s].
    """

    def __init__(self, lag: float = 0.12, supply: float = 550e3, noise: float = 0.0, seed: int = 0):
        self.lag, self.supply, self.noise = lag, supply, noise
        self._random, self._p = Random(seed), 0.0

    def __call__(self, fill: int, vent: int, seconds: float) -> float:
        """Returns the measured gauge pressure [Pa] after `seconds` at duties of 0 to 255."""
        into, out = fill / 255.0 / self.lag, vent / 255.0 / self.lag
        if into + out > 0.0:
            steady = into * self.supply / (into + out)
            self._p = steady + (self._p - steady) * exp(-(into + out) * seconds)
        return self._p + (self._random.gauss(0.0, self.noise) if self.noise else 0.0)
