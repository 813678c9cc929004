"""Simulates a Net F/T box, which sends RDT records over UDP in real time, with optional faults.

`SimulatedForceBox` makes records. `LossyNetwork` drops, delays and duplicates records. These two
classes use no clock and no socket. `SimulatedForceSensor` sends the records over the network.
"""

import select
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Event, Thread

import numpy as np

from rig.errors import RigError
from rig.force import ati_rdt as rdt

Wrench = Callable[[float], np.ndarray]
"""Returns forces and torques (6,) [N, N m] at a time of the host's monotonic clock [s]."""

COUNTS = 1_000_000
"""Counts per newton and per newton metre."""
PAGE = (
    "<?xml version='1.0'?><netft><cfgcalsn>FT00000</cfgcalsn>"
    f"<cfgcpf>{COUNTS}</cfgcpf><cfgcpt>{COUNTS}</cfgcpt>"
    "<scfgfu>N</scfgfu><scfgtu>Nm</scfgtu></netft>"
).encode()


class LossyNetwork:
    """A network that drops, delays and duplicates datagrams, each with its own probability."""

    def __init__(
        self, drop: float = 0.0, reorder: float = 0.0, duplicate: float = 0.0, seed: int = 0
    ) -> None:
        for name, chance in (("drop", drop), ("reorder", reorder), ("duplicate", duplicate)):
            if not 0.0 <= chance <= 1.0:
                raise RigError.value(f"simulated force sensor, {name}", chance, "0 to 1")
        self.drop, self.reorder, self.duplicate = drop, reorder, duplicate
        self.dropped: list[int] = []
        """Indices of the dropped datagrams, counted from 0."""
        self.late = self.doubled = 0
        self._random = np.random.default_rng(seed)
        self._passed = 0
        self._held: list[tuple[int, bytes]] = []

    def transmit(self, datagram: bytes) -> list[bytes]:
        """Sends a datagram and returns the datagrams that arrive now. Delays: 1 to 8 datagrams."""
        out = []
        lost, late, twice = self._random.random(3) < (self.drop, self.reorder, self.duplicate)
        if lost:
            self.dropped.append(self._passed)
        elif late:
            self._held.append((self._passed + int(self._random.integers(1, 9)), datagram))
            self.late += 1
        else:
            out = [datagram] * (1 + int(twice))
            self.doubled += int(twice)
        out += [held for due, held in self._held if due <= self._passed]
        self._held = [(due, held) for due, held in self._held if due > self._passed]
        self._passed += 1
        return out


@dataclass
class SimulatedForceBox:
    """Makes records of `wrench`. All fields except `seed` may change while the box runs."""

    wrench: Wrench
    rate: float = 1000.0
    """Rate of the records [1/s]. The box uses the nearest rate of the form 7000 / whole number."""
    noise: float = 2e-3
    """Standard deviation of white noise [N, N m]."""
    limit: float = 1000.0
    """Force [N] or torque [N m] on an axis above which the sensor saturates."""
    stuck: bool = False
    """If True, all records repeat the last counts, as from a stuck sensor."""
    status: int = 0
    """Status bits of every record."""
    seed: int = 0
    zero: np.ndarray = field(default_factory=lambda: np.zeros(6))
    """Forces and torques (6,) that the box subtracts [N, N m]. The method `bias` sets them."""

    def __post_init__(self) -> None:
        if not 0 < self.limit <= 1000.0:  # so that biased counts also fit into 32 bits
            raise RigError.value("simulated force sensor, limit", self.limit, "above 0, up to 1000")
        if not 0 < self.rate <= rdt.INTERNAL_RATE:
            raise RigError.value(
                "simulated force sensor, rate", self.rate, "above 0, up to 7000 Hz"
            )
        self.step = round(rdt.INTERNAL_RATE / self.rate)
        self.period = self.step / rdt.INTERNAL_RATE
        """Time between records by the box's own clock [s]."""
        self._random = np.random.default_rng(self.seed)
        self._ft_seq = int(self._random.integers(2**32))  # as if powered up earlier
        self._last = (0,) * 6

    def record(self, number: int, t: float) -> bytes:
        """Returns record `number` of the stream, sampled at `t` [s]. Numbers are 0, 1, 2, ..."""
        load = np.asarray(self.wrench(t), float) + self.noise * self._random.standard_normal(6)
        status = self.status
        if np.any(np.abs(load) > self.limit):
            status |= rdt.ERROR | rdt.SATURATED
        if not self.stuck:
            measured = np.clip(load, -self.limit, self.limit) - self.zero
            self._last = tuple(np.rint(COUNTS * measured).astype(int).tolist())
        self._ft_seq = (self._ft_seq + self.step) % 2**32
        return rdt.RECORD.pack(number + 1, self._ft_seq, status, *self._last)

    def bias(self, t: float) -> None:
        """Subtracts the wrench at `t` [s] from all later records."""
        self.zero = np.clip(self.wrench(t), -self.limit, self.limit)


class SimulatedForceSensor:
    """A Net F/T box on the network, which runs in its own thread until it is closed.

    `drift` is the relative error of the box's clock (200e-6 is 200 ppm too fast). `box` and `line`
    may change while the thread runs. With `silent`, the box ignores requests and sends nothing.
    """

    def __init__(
        self,
        box: SimulatedForceBox,
        line: LossyNetwork | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
        drift: float = 0.0,
    ) -> None:
        self.box, self.line, self.drift = box, line or LossyNetwork(), drift
        self.silent = False
        self.begins: Callable[[float], float] = lambda t: t
        """Returns the time of the first record of a stream that is requested at `t` [s]."""
        self.page = PAGE
        """Content of the box's web page."""
        self.requests: list[int] = []
        """Received commands in order."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise RigError(
                f"simulated force sensor: {host}:{port} cannot be used ({error.strerror}); "
                "use another port, or 0 for any free port"
            ) from None
        self._socket.setblocking(False)
        self.host, self.port = self._socket.getsockname()
        self._client: tuple[str, int] | None = None
        self._start = 0.0
        self._sent = self._count = 0
        self._closed = Event()
        self._web: ThreadingHTTPServer | None = None
        self._thread = Thread(target=self._serve, daemon=True)
        self._thread.start()

    def serve_page(self, port: int = 0) -> int:
        """Serves the calibration page over HTTP and returns the port."""
        sensor = self

        class Page(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("Content-Length", str(len(sensor.page)))
                self.end_headers()
                self.wfile.write(sensor.page)

            def log_message(self, format: str, *args: object) -> None:
                pass

        self._web = ThreadingHTTPServer((self.host, port), Page)
        Thread(target=self._web.serve_forever, args=(0.05,), daemon=True).start()
        return self._web.server_port

    def _due(self) -> float:
        """Returns the sampling time of the next record on the host's clock [s]."""
        return self._start + self._sent * self.box.period / (1 + self.drift)

    def _serve(self) -> None:
        while not self._closed.is_set():
            wait = 0.02
            if self._client is not None:
                wait = min(wait, max(0.0, self._due() - time.monotonic()))
            if select.select([self._socket], [], [], wait)[0]:
                self._receive()
            now = time.monotonic()
            while self._client is not None and self._due() <= now:
                self._send()

    def _receive(self) -> None:
        with suppress(OSError):  # the client is gone
            message, sender = self._socket.recvfrom(64)
            if len(message) != 8 or self.silent:
                return
            header, command, count = struct.unpack(">HHI", message)
            if header != 0x1234:
                return
            self.requests.append(command)
            if command == rdt.START:
                self._client, self._start = sender, self.begins(time.monotonic())
                self._sent, self._count = 0, count
            elif command == rdt.STOP:
                self._client = None
            elif command == rdt.BIAS:
                self.box.bias(time.monotonic())

    def _send(self) -> None:
        record = self.box.record(self._sent, self._due())
        self._sent += 1
        for datagram in self.line.transmit(record):
            if self._client is not None and not self.silent:
                with suppress(OSError):
                    self._socket.sendto(datagram, self._client)
        if self._sent == self._count:
            self._client = None

    def close(self) -> None:
        self._closed.set()
        self._thread.join()
        self._socket.close()
        if self._web is not None:
            self._web.shutdown()
            self._web.server_close()

    def __enter__(self) -> "SimulatedForceSensor":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
