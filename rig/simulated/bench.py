"""A complete simulated rig: a manifold on a pseudo-terminal, and a force sensor on the network."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import ceil
from typing import NamedTuple

import numpy as np

from rig.recording.reader import RecordedStream
from rig.simulated.force_sensor import SimulatedForceBox, SimulatedForceSensor
from rig.simulated.rig import STEP, TIP_PER_VOLT, SimulatedRig
from rig.simulated.terminal import Terminal

MADE_UP = "The rig that `slider rig simulate` made up"
LEAD_US = 5
"""Time [us] by which the first force record precedes a step of the tank. Without this margin,
rounding could move the record to after the step, and the record would wait for the next step."""
MAX_TANK_WAIT = 0.2
"""Longest time for which a force record waits for the tank's state [s]."""


class HostClockedRig:
    """A simulated rig that returns forces at times of the host's clock."""

    def __init__(self, rig: SimulatedRig, on_time: Callable[[float], None] = lambda seconds: None):
        self.rig, self._on_time = rig, on_time
        self._zero_ns: int | None = None

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Implements `Device.feed`: takes bytes from the host and returns the answer."""
        return self.rig.feed(piece, now_us)

    def tick(self, now_us: int) -> bytes:
        """Implements `Device.tick`, and calls `on_time` with the time since the start [s]."""
        zero = time.monotonic_ns() - 1000 * now_us
        self._zero_ns = zero if self._zero_ns is None else min(zero, self._zero_ns)
        self._on_time(1e-6 * now_us)
        return self.rig.tick(now_us)

    def wrench(self, host_s: float) -> np.ndarray:
        """Returns forces [N] and torques [N m] (6,) at a host time [s]. x is thrust, y recoil."""
        zero = self._zero_ns or time.monotonic_ns()
        at = round((1e9 * host_s - zero) / 1000)
        # If the tank's computation is late, the record waits for the force at its sampling time.
        # The host can detect a late record, but not a wrong force.
        deadline = time.monotonic() + MAX_TANK_WAIT
        while self.rig.reached_us < at and time.monotonic() < deadline:
            time.sleep(2e-4)
        now = self.rig.state_at(at)
        return np.array([now.thrust, now.recoil, 0.0, 0.0, 0.0, 0.0])

    def on_step(self, host_s: float) -> float:
        """Returns the next host time [s] that precedes a step of the tank by `LEAD_US`.

        A record that is sampled between two steps would wait for the next step and be late.
        """
        zero, reached = self._zero_ns or time.monotonic_ns(), self.rig.reached_us
        steps = ceil((1e-3 * (1e9 * host_s - zero) - reached) / STEP)
        return 1e-9 * (zero + 1000 * (reached + STEP * steps - LEAD_US))


class ServedRig(NamedTuple):
    """Addresses of a running simulated rig."""

    port: str
    force: SimulatedForceSensor
    page_port: int

    def settings(self) -> str:
        """Returns the text of a rig file for this rig."""
        return (
            f"# {MADE_UP}.\n"
            "[force]\n"
            f'host = "{self.force.host}"\n'
            f"port = {self.force.port}\n"
            f"page_port = {self.page_port}\n\n"
            "[[analogue]]\n"
            'column = "tip_m"\n'
            "input = 1\n"
            f"scale = {TIP_PER_VOLT}  # m/V\n"
        )


@contextmanager
def serve_rig(
    rig: SimulatedRig,
    force_noise: float = 2e-3,
    on_time: Callable[[float], None] = lambda seconds: None,
    seed: int = 0,
) -> Iterator[ServedRig]:
    """Runs the rig in threads of this process until the block ends.

    `force_noise` [N] is the forces' rms noise. `on_time` gets the time since the start [s]."""
    device, ends = HostClockedRig(rig, on_time), threading.Event()
    terminal = Terminal(device)
    sensor = SimulatedForceSensor(SimulatedForceBox(device.wrench, noise=force_noise, seed=seed))
    sensor.begins = device.on_step
    thread = threading.Thread(target=terminal.serve, args=(ends.is_set,), daemon=True)
    thread.start()
    try:
        yield ServedRig(terminal.path, sensor, sensor.serve_page())
    finally:
        ends.set()
        thread.join()
        sensor.close()


class ReplayDevice:
    """A device without input that sends a recorded stream, `speed` times as fast as recorded."""

    def __init__(self, stream: RecordedStream, speed: float = 1.0):
        start = int(stream.host_ns[0]) if len(stream.host_ns) else 0
        self._due = [(int(t) - start) / (1000 * speed) for t in stream.host_ns]
        self._pieces, self._next = stream.pieces(), 0

    @property
    def ended(self) -> bool:
        """True after the device has sent the whole stream."""
        return self._next == len(self._pieces)

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Ignores bytes from the host."""
        return b""

    def tick(self, now_us: int) -> bytes:
        """Returns the bytes that are due up to `now_us`."""
        first = self._next
        while not self.ended and self._due[self._next] <= now_us:
            self._next += 1
        return b"".join(self._pieces[first : self._next])
