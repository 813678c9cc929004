"""When numbered samples were taken on the host's clock: from their numbers, not their arrival."""

import numpy as np

from rig.errors import RigError
from rig.recording.clock import align

LATEST = 0.5
"""Samples of which half came later than this [s] were not taken at the rate that is claimed."""


def host_sample_times(
    number: np.ndarray, arrived_ns: np.ndarray, rate: float, at: np.ndarray
) -> np.ndarray:
    """Host times [ns], int64, of the samples numbered `at`.

    `number` (n,), rising, are the samples that arrived at `arrived_ns` (n,); `rate` [Hz] is the
    sensor's, right to what crystals differ. Raises `RigError` where they did not come at that rate.
    """
    start = arrived_ns.min()  # so that a double holds nanoseconds
    clock = align((number - number[0]) / rate, 1e-9 * (arrived_ns - start))
    if clock.late_median > LATEST:
        raise RigError(
            f"force sensor: half of {len(number)} samples came {clock.late_median:.2g} s late and "
            f"more, by a rate of {rate:.5g} Hz; see that the sensor is set to that rate, and that "
            "this computer is not too busy to receive them"
        )
    return start + np.rint(1e9 * clock.to_host((at - number[0]) / rate)).astype(np.int64)
