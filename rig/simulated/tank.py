"""What a simulated rig controls and measures; the simulator's robot can take its place."""

from math import exp
from typing import NamedTuple, Protocol


class Measured(NamedTuple):
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

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> Measured:
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

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> Measured:
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
        return Measured((a, b, c, d), self.supply, 2.0 * speed**2, -1e-6 * (a - b), self._tip)
