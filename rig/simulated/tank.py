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
    model of swimming. `lag` [s]; `leak` [1/s] is the rate at which a chamber's pressure is lost,
    `gain` [m/Pa] how far the tip goes.
    """

    def __init__(self, lag: float = 0.05, supply: float = 600e3, gain: float = 2e-7):
        self.lag, self.supply, self.gain = lag, supply, gain
        self.leak = [0.0, 0.0, 0.0, 0.0]
        self._p = [0.0, 0.0, 0.0, 0.0]

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> Measured:
        """Exact for pressures that are held over the step."""
        wanted = set_pressures or (0, 0, 0, 0)
        before = self.gain * (self._p[0] - self._p[1] + self._p[2] - self._p[3])
        for i, target in enumerate(wanted):
            rate = 1.0 / self.lag + self.leak[i]
            steady = target / (self.lag * rate)
            self._p[i] = steady + (self._p[i] - steady) * exp(-rate * seconds)
        a, b, c, d = self._p
        tip = self.gain * (a - b + c - d)
        speed = (tip - before) / seconds
        return Measured((a, b, c, d), self.supply, 2.0 * speed**2, -1e-6 * (a - b), tip)
