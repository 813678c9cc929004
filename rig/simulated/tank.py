"""What a simulated rig controls and measures; the simulator's robot can take its place."""

from math import exp
from random import Random
from typing import NamedTuple, Protocol


class TankState(NamedTuple):
    """True values at one instant."""

    chambers: tuple[float, float, float, float]
    """Gauge pressures [Pa]."""
    supply: float
    """Gauge pressure [Pa]."""
    thrust: float
    """[N]"""
    recoil: float
    """[N]"""
    tip: float
    """[m]"""


class Tank(Protocol):
    """A robot in water, or in what stands for it."""

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> TankState:
        """Its state so much later, under set gauge pressures (4,) [Pa]; None vents all."""
        ...


class BenchTank:
    """Chambers with a first-order lag, and a tail without water that follows them.

    Enough to try every command of the rig, and to see in thrust and tip what was set; it is no
    model of swimming. `lag` and `tail` [s] are what chambers and tail take to follow; `leak` [1/s]
    is the rate at which a chamber's pressure is lost, `gain` [m/Pa] how far the tip goes.
    """

    def __init__(
        self, lag: float = 0.05, supply: float = 600e3, gain: float = 2e-7, tail: float = 0.02
    ):
        self.lag, self.supply, self.gain, self.tail = lag, supply, gain, tail
        self.leak = [0.0, 0.0, 0.0, 0.0]
        self._p = [0.0, 0.0, 0.0, 0.0]
        self._tip = 0.0

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> TankState:
        """Exact for set pressures that are held over the step; the tail to first order."""
        wanted = set_pressures or (0, 0, 0, 0)
        for i, target in enumerate(wanted):
            rate = 1.0 / self.lag + self.leak[i]
            steady = target / (self.lag * rate)
            self._p[i] = steady + (self._p[i] - steady) * exp(-rate * seconds)
        a, b, c, d = self._p
        aim = self.gain * (a - b + c - d)
        self._tip = aim + (self._tip - aim) * exp(-seconds / self.tail)
        speed = (aim - self._tip) / self.tail
        return TankState((a, b, c, d), self.supply, 2.0 * speed**2, -1e-6 * (a - b), self._tip)


class BenchChamber:
    """One chamber behind a fill and a vent valve, as the published firmware drives them.

    Flow is in proportion to a valve's duty and to the pressure across it: open all the time the
    fill valve takes `lag` [s] to close the gap to the supply to 37 %, the vent valve to the room.
    """

    def __init__(self, lag: float = 0.12, supply: float = 550e3, noise: float = 0.0, seed: int = 0):
        self.lag, self.supply, self.noise = lag, supply, noise
        self._random, self._p = Random(seed), 0.0

    def __call__(self, fill: int, vent: int, seconds: float) -> float:
        """The gauge pressure that is read [Pa] after `seconds` at duties of 0 to 255."""
        into, out = fill / 255.0 / self.lag, vent / 255.0 / self.lag
        if into + out > 0.0:
            steady = into * self.supply / (into + out)
            self._p = steady + (self._p - steady) * exp(-(into + out) * seconds)
        return self._p + (self._random.gauss(0.0, self.noise) if self.noise else 0.0)
