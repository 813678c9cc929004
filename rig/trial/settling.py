"""Detects whether the robot is at rest before a trial, with the analogue sensors."""

import time
from collections import deque
from collections.abc import Sequence

import numpy as np

from rig.manifold.driver import Manifold
from rig.protocol.messages import Reading
from rig.recording.table import AnalogueSensor, format_value

WINDOW = 2.5
"""The test uses the readings of this time [s], which is long enough to detect a slow swing."""
MAX_NOISE_RANGE = 6.0
"""Largest range due to noise of about 50 readings, in standard deviations of the noise."""
MAX_REST_RANGE = 0.005
"""Largest range of a sensor at rest, as a fraction of the sensor's range in the previous trial."""


class Stillness:
    """Tests whether the readings of a pause show that the robot is at rest.

    For each column, in the column's unit, `ranges` contains the range in the previous trial, and
    `noise` contains the standard deviation of a reading's noise.
    """

    def __init__(
        self, sensors: Sequence[AnalogueSensor], ranges: dict[str, float], noise: dict[str, float]
    ):
        self._sensors = [x for x in sensors if ranges.get(x.column, 0.0) > 0.0]
        self._allowed = [
            max(MAX_REST_RANGE * ranges[x.column], MAX_NOISE_RANGE * noise.get(x.column, 0.0))
            for x in self._sensors
        ]
        self._seen: deque[tuple[float, np.ndarray]] = deque()

    def add(self, t: float, reading: Reading) -> None:
        """Adds the reading at `t` [s] after the pause began."""
        channels = np.array(reading.channels, float)
        self._seen.append((t, np.array([x.signal(channels) for x in self._sensors])))
        while self._seen and self._seen[0][0] < t - WINDOW:
            self._seen.popleft()

    @property
    def reached(self) -> bool:
        """Whether all sensors are at rest; True if there are no sensors."""
        if not self._sensors:
            return True
        if not self._seen or self._seen[-1][0] - self._seen[0][0] < 0.9 * WINDOW:
            return False
        return bool((self._moved() <= self._allowed).all())

    @property
    def waits_for(self) -> str:
        """Text with column and limit of each sensor whose readings still change; empty at rest."""
        moved = self._moved() if self._seen else np.zeros(len(self._sensors))
        return "".join(
            f", until the range of {sensor.column} is below {format_value(sensor.column, allowed)} "
            f"(now {format_value(sensor.column, x)}),"
            for sensor, x, allowed in zip(self._sensors, moved, self._allowed, strict=True)
            if x > allowed
        )

    def _moved(self) -> np.ndarray:
        """Returns the range of each sensor in the last `WINDOW` seconds, shape (sensors,)."""
        return np.ptp(np.array([x for _, x in self._seen]), axis=0)


def sensor_noise(
    manifold: Manifold, sensors: Sequence[AnalogueSensor], count: int = 50
) -> dict[str, float]:
    """Returns the standard deviation of each column's noise, without the effect of a slow swing.

    The function waits for `count` readings, at most for one second. Noise is the part of a signal
    that is independent between consecutive readings.
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
    # Second differences remove a swing at 3 Hz of 100 times the noise; first differences do not.
    return {x.column: float(np.diff(x.signal(channels), 2).std() / np.sqrt(6.0)) for x in sensors}
