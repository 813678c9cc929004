"""The gantry's trapezoidal speed profile: acceleration, constant speed (cruise), deceleration."""

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from rig.errors import RigError


@dataclass(frozen=True)
class MotionProfile:
    """A move from rest to rest over `travel` [m] at `speed` [m/s] and `acceleration` [m/s^2].

    Each ramp takes speed / acceleration [s] and covers speed^2 / (2 acceleration) [m]. The cruise
    covers the remaining travel. Raises `RigError` if the ramps are longer than the travel.
    """

    travel: float
    speed: float
    acceleration: float

    def __post_init__(self):
        for name, unit in (("travel", "m"), ("speed", "m/s"), ("acceleration", "m/s^2")):
            if not 0.0 < getattr(self, name) < inf:
                where = f"gantry {name}"
                raise RigError.value(where, getattr(self, name), f"a number above 0 {unit}")
        shortest = self.speed**2 / self.acceleration
        if self.travel < shortest * (1.0 - 1e-9):
            raise RigError.value(
                "gantry travel",
                f"{self.travel:g} m",
                f"at least {shortest:g} m at {self.speed:g} m/s and {self.acceleration:g} m/s^2",
                f"use a longer travel, or at most {sqrt(self.travel * self.acceleration):g} m/s",
            )

    @property
    def ramp(self) -> float:
        """Duration of one ramp [s], which is also the start time of the cruise."""
        return self.speed / self.acceleration

    @property
    def cruise(self) -> float:
        """Duration of the cruise [s]."""
        return max(self.travel / self.speed - self.ramp, 0.0)

    @property
    def duration(self) -> float:
        """Duration of the move [s]."""
        return self.cruise + 2.0 * self.ramp

    def speed_at(self, t) -> np.ndarray:
        """Returns the speed [m/s] at times t [s] after the start; 0 before and after the move."""
        t = np.asarray(t, float)
        slope = self.acceleration * np.minimum(t, self.duration - t)
        return np.clip(slope, 0.0, self.speed)

    def position(self, t) -> np.ndarray:
        """Returns the travelled distance [m] at times t [s] after the start."""
        t = np.clip(np.asarray(t, float), 0.0, self.duration)
        up, down = np.minimum(t, self.ramp), np.minimum(self.duration - t, self.ramp)
        cruised = np.clip(t - self.ramp, 0.0, self.cruise)
        ramps = 0.5 * self.acceleration * (up**2 + self.ramp**2 - down**2)
        return ramps + self.speed * cruised
