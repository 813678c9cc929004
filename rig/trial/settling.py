"""Whether a robot has come to rest, by the analogue sensors: a trial begins from rest."""

import time
from collections import deque
from collections.abc import Sequence

import numpy as np

from rig.manifold.driver import Manifold
from rig.protocol.messages import Reading
from rig.recording.table import AnalogueSensor, format_value

WINDOW = 2.5
"""A slow swing shows itself within so long [s]."""
NOISES = 6.0
"""Standard deviations of a reading's noise that some fifty of them may range over."""
STILL = 0.005
"""Of a sensor's range in the trial before: what moves less counts as at rest."""


class Stillness:
    """Watches readings of a pause. Sensors are judged by their `ranges` in the trial before, and
    the `noise` of a reading, by column."""

    def __init__(
        self, sensors: Sequence[AnalogueSensor], ranges: dict[str, float], noise: dict[str, float]
    ):
        self._sensors = [x for x in sensors if ranges.get(x.column, 0.0) > 0.0]
        self._allowed = [
            max(STILL * ranges[x.column], NOISES * noise.get(x.column, 0.0)) for x in self._sensors
        ]
        self._seen: deque[tuple[float, np.ndarray]] = deque()

    def add(self, t: float, reading: Reading) -> None:
        """What was read `t` [s] after the pause began."""
        channels = np.array(reading.channels, float)
        self._seen.append((t, np.array([x.signal(channels) for x in self._sensors])))
        while self._seen and self._seen[0][0] < t - WINDOW:
            self._seen.popleft()

    @property
    def reached(self) -> bool:
        """At rest; also where no sensor can tell."""
        if not self._sensors:
            return True
        if not self._seen or self._seen[-1][0] - self._seen[0][0] < 0.9 * WINDOW:
            return False
        return bool((self._moved() <= self._allowed).all())

    @property
    def waits_for(self) -> str:
        """Of which sensor it is waited that it is still, in words; nothing once all are."""
        moved = self._moved() if self._seen else np.zeros(len(self._sensors))
        return "".join(
            f", until {sensor.column} moves by less than {format_value(sensor.column, allowed)} "
            f"(now {format_value(sensor.column, x)}),"
            for sensor, x, allowed in zip(self._sensors, moved, self._allowed, strict=True)
            if x > allowed
        )

    def _moved(self) -> np.ndarray:
        """(sensors,) the range of each over the last `WINDOW`."""
        return np.ptp(np.array([x for _, x in self._seen]), axis=0)


def sensor_noise(
    manifold: Manifold, sensors: Sequence[AnalogueSensor], count: int = 50
) -> dict[str, float]:
    """Standard deviation of what one reading of a sensor does not share with the next, by column.

    Of `count` readings, or as many as come in a second; a slow swing does not count.
    """
    seen: dict[int, tuple[int, ...]] = {}
    end = time.monotonic() + 1.0
    while sensors and len(seen) < count and time.monotonic() < end:
        latest = manifold.latest
        if latest is not None:
            seen[latest.seq] = latest.channels
        time.sleep(1e-3)
    if len(seen) < 3:
        return {}
    channels = np.array(list(seen.values()), float)
    # Second differences: of two a swing at 3 Hz and 100 times the noise would still show.
    return {x.column: float(np.diff(x.signal(channels), 2).std() / np.sqrt(6.0)) for x in sensors}
