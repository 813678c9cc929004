"""A simulated rig as a whole: a manifold on a pseudo-terminal, a force sensor on the network."""

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
BEFORE = 5
"""By which a record is taken before a step, as times are rounded [us]."""
PATIENCE = 0.2
"""Longest that a force waits for its tank [s]."""


class HostClockedRig:
    """A rig whose device time is known on the host's clock, once it runs."""

    def __init__(self, rig: SimulatedRig, at: Callable[[float], None] = lambda seconds: None):
        self.rig, self._at = rig, at
        self._zero_ns: int | None = None

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """As `Device.feed`."""
        return self.rig.feed(piece, now_us)

    def tick(self, now_us: int) -> bytes:
        """As `Device.tick`; `at` hears of the seconds since the start."""
        zero = time.monotonic_ns() - 1000 * now_us
        self._zero_ns = zero if self._zero_ns is None else min(zero, self._zero_ns)
        self._at(1e-6 * now_us)
        return self.rig.tick(now_us)

    def wrench(self, host_s: float) -> np.ndarray:
        """(6,) forces [N] and torques [N m] at a time of the host: thrust along x, recoil y."""
        zero = self._zero_ns or time.monotonic_ns()
        at = round((1e9 * host_s - zero) / 1000)
        # A tank that is behind its time has no force of now yet: a record that waits is late, and
        # that can be seen; one that guesses is wrong.
        patience = time.monotonic() + PATIENCE
        while self.rig.reached_us < at and time.monotonic() < patience:
            time.sleep(2e-4)
        now = self.rig.measured(at)
        return np.array([now.thrust, now.recoil, 0.0, 0.0, 0.0, 0.0])

    def on_step(self, host_s: float) -> float:
        """The next time of the host [s] at which the tank makes a step, or just before.

        Records between steps would all wait for the next one, and be late by the same. Steps begin
        with the first tick, at whatever time of the device that came.
        """
        zero, reached = self._zero_ns or time.monotonic_ns(), self.rig.reached_us
        steps = ceil((1e-3 * (1e9 * host_s - zero) - reached) / STEP)
        return 1e-9 * (zero + 1000 * (reached + STEP * steps - BEFORE))


class ServedRig(NamedTuple):
    """Where a simulated rig is found."""

    port: str
    force: SimulatedForceSensor
    page_port: int

    def settings(self) -> str:
        """A rig file that suits it."""
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
    at: Callable[[float], None] = lambda seconds: None,
    seed: int = 0,
) -> Iterator[ServedRig]:
    """The rig in threads of this process, until the block ends. `force_noise` [N]."""
    device, ends = HostClockedRig(rig, at), threading.Event()
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
    """A device that sends a recording's stream, and hears nothing. Silent at its end."""

    def __init__(self, stream: RecordedStream, speed: float = 1.0):
        start = int(stream.host_ns[0]) if len(stream.host_ns) else 0
        self._due = [(int(t) - start) / (1000 * speed) for t in stream.host_ns]
        self._pieces, self._next = stream.pieces(), 0

    @property
    def ended(self) -> bool:
        """Whether all is said."""
        return self._next == len(self._pieces)

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Nothing is answered."""
        return b""

    def tick(self, now_us: int) -> bytes:
        """What was said up to then."""
        first = self._next
        while not self.ended and self._due[self._next] <= now_us:
            self._next += 1
        return b"".join(self._pieces[first : self._next])
