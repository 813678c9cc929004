"""Whether a robot has come to rest, by the analogue sensors: a trial begins from rest."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from rig.columns import Analogue
from rig.messages import Reading

WINDOW = 2.5
"""A slow swing shows itself within so long [s]."""
AVERAGED = 5
"""Readings that are averaged, against noise."""
NOISES = 5.0
"""Standard deviations of such a mean, by successive readings, that noise may make of a range."""
STILL = 0.005
"""Of a sensor's range in the trial before: what moves less counts as at rest."""


class Stillness:
    """Watches readings of a pause. Sensors are judged by their `ranges` in the trial before."""

    def __init__(self, sensors: Sequence[Analogue], ranges: dict[str, float]):
        self._judged = [
            (x, STILL * ranges[x.column]) for x in sensors if ranges.get(x.column, 0.0) > 0.0
        ]
        self._seen: deque[tuple[float, np.ndarray]] = deque()

    def add(self, t: float, reading: Reading) -> None:
        """What was read `t` [s] after the pause began."""
        channels = np.array(reading.channels, float)
        self._seen.append((t, np.array([x.signal(channels) for x, _ in self._judged])))
        while self._seen and self._seen[0][0] < t - WINDOW:
            self._seen.popleft()

    @property
    def reached(self) -> bool:
        """At rest; also where no sensor can tell."""
        if not self._judged:
            return True
        if not self._seen or self._seen[-1][0] - self._seen[0][0] < 0.9 * WINDOW:
            return False
        seen = np.array([x for _, x in self._seen])
        means = [x.mean(axis=0) for x in np.array_split(seen, len(seen) // AVERAGED)]
        noise = np.std(np.diff(seen, axis=0), axis=0) / np.sqrt(2.0 * AVERAGED)
        allowed = np.maximum([x for _, x in self._judged], NOISES * noise)
        return bool((np.ptp(means, axis=0) <= allowed).all())
