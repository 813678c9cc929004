"""Reads an ATI Net F/T box: the calibration from the box's web page, and the stream over UDP."""

import socket
import time
import urllib.request
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from http.client import HTTPException

import numpy as np

from rig.errors import RigError
from rig.force import ati_rdt as rdt
from rig.force.sensor import (
    NEWTON_METRES,
    NEWTONS,
    Forces,
    ForceSource,
    Health,
    ReaderThread,
    check_positive,
    unit_in_si,
)
from rig.recording.clock import Sink

PAGE = "netftapi2.xml"
TRIES = 3
"""Largest number of times that a request is sent, because UDP may lose requests."""


@dataclass(frozen=True)
class NetCalibration:
    """Counts per newton and counts per newton metre of a Net F/T box."""

    counts_per_N: float
    counts_per_Nm: float
    serial: str = ""

    def __post_init__(self) -> None:
        check_positive(
            "force sensor's calibration",
            counts_per_N=self.counts_per_N,
            counts_per_Nm=self.counts_per_Nm,
        )

    @classmethod
    def from_page(cls, page: bytes, where: str) -> "NetCalibration":
        """Reads `netftapi2.xml`: counts per unit (cfgcpf, cfgcpt), and the units (scfgfu, scfgtu).

        Raises `RigError` for an incomplete page or an unknown unit. The error names `where`.
        """
        advice = "reload the page, or set counts_per_N and counts_per_Nm in the rig file"
        try:
            root = ET.fromstring(page)
        except ET.ParseError as error:
            raise RigError(f"{where}: incomplete XML ({error}); {advice}") from None

        def text(name: str) -> str:
            found = root.findtext(f".//{name}")
            if not found or not found.strip():
                raise RigError(f"{where}: {name} is missing; {advice}")
            return found.strip()

        def per_unit(name: str) -> float:
            try:
                return float(text(name))
            except ValueError:
                raise RigError.value(
                    f"{where}, {name}", repr(text(name)), "a number", advice
                ) from None

        return cls(
            per_unit("cfgcpf") / unit_in_si(text("scfgfu"), NEWTONS, f"{where}, scfgfu"),
            per_unit("cfgcpt") / unit_in_si(text("scfgtu"), NEWTON_METRES, f"{where}, scfgtu"),
            (root.findtext(".//cfgcalsn") or "").strip(),
        )

    @classmethod
    def fetch(cls, host: str, port: int = 80, timeout: float = 3.0) -> "NetCalibration":
        """Reads the web page of the box at `host`. Raises `RigError` if the box does not answer."""
        where = f"http://{host}:{port}/{PAGE}"
        direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        try:
            with direct.open(where, timeout=timeout) as answer:
                page = answer.read(10**6)
        except (OSError, HTTPException) as error:
            raise RigError(
                f"{where}: cannot be read ({getattr(error, 'reason', error)}); check that the "
                f"box has power and `ping {host}` answers, or set counts_per_N and counts_per_Nm "
                "in the rig file"
            ) from None
        return cls.from_page(page, where)

    def wrench(self, counts: np.ndarray) -> np.ndarray:
        """Returns forces [N] and torques [N m] (..., 6) from counts (..., 6)."""
        return counts / np.repeat([self.counts_per_N, self.counts_per_Nm], 3)

    def forces(self, host_ns: Sequence[int], datagrams: Sequence[bytes]) -> Forces:
        """Returns the forces of one stream. Raises `RigError` if the stream is empty or damaged."""
        records = rdt.record_table(host_ns, datagrams)
        wrench = self.wrench(records.counts)
        wrench[~records.present] = np.nan
        return Forces(records.times(), wrench, records.doubtful, records.findings())


class NetForce(ForceSource):
    """A Net F/T box that streams over UDP.

    Raises `RigError` if `host` is unreachable. `start` raises `RigError` if the box is silent.
    """

    def __init__(
        self,
        host: str,
        calibration: NetCalibration,
        port: int = rdt.PORT,
        patience: float = 1.0,
        buffer: int = 4 << 20,
    ) -> None:
        if not 0 < port < 65536:
            raise RigError.value("force sensor's port", port, "1 to 65535; a box uses 49152")
        self.calibration = calibration
        self.name = f"force sensor {host}:{port}"
        self.patience = patience
        """Longest allowed time without data [s], at the start and during the stream."""
        self.tally = rdt.StreamTally()
        self._reader: ReaderThread | None = None
        self._sink: Sink
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        # The kernel needs about 0.7 kB per record, and may grant a smaller buffer than requested.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        try:
            self._socket.connect((host, port))  # accepts datagrams of this box only
        except (OSError, UnicodeError) as error:
            self._socket.close()
            raise self._unreachable(getattr(error, "strerror", None) or str(error)) from None

    def _unreachable(self, why: str) -> RigError:
        host, port = self.name.removeprefix("force sensor ").rsplit(":", 1)
        return RigError(
            f"{self.name}: {why}; check that the box has power and a link, that this computer "
            f"has an address in its subnet (`ping {host}`), that RDT is enabled on http://{host}/, "
            f"and that no firewall blocks UDP {port}"
        )

    def _send(self, command: int) -> None:
        try:
            self._socket.send(rdt.request_bytes(command))
        except OSError as error:
            raise self._unreachable(error.strerror or str(error)) from None

    def _receive(self, wait: float = 0.1) -> bytes | None:
        self._socket.settimeout(wait)
        try:
            return self._socket.recv(2048)
        except TimeoutError:
            return None
        except OSError as error:
            raise self._unreachable(error.strerror or str(error)) from None

    def _take(self, now: int, datagram: bytes) -> None:
        self._sink(now, datagram)
        rdt.check_size(datagram, self.name)
        seq, _, status, *counts = rdt.RECORD.unpack(datagram)
        self.tally.count(seq, status)
        self._last = now, np.array(counts)

    def start(self, sink: Sink) -> None:
        """Ends the stream of an earlier run if that stream still runs, then starts a new stream."""
        self.stop()
        self.tally, self._last, self._sink = rdt.StreamTally(), None, sink
        for _ in range(TRIES):
            self._send(rdt.STOP)
            quiet_by = time.monotonic() + self.patience
            while self._receive(0.05) is not None and time.monotonic() < quiet_by:
                pass
            self._send(rdt.START)
            first = self._receive(self.patience / TRIES)
            if first is not None:
                break
        else:
            raise self._unreachable(f"no answer to {TRIES} requests within {self.patience:g} s")
        pieces = [first]

        def receive() -> bytes | None:
            return pieces.pop() if pieces else self._receive()

        self._reader = ReaderThread(self.name, receive, self._take, self.patience)

    def bias(self) -> None:
        """Sets the present load as zero. The box subtracts this load until it loses power."""
        for _ in range(TRIES):  # the box does not confirm the request, which may be lost
            self._send(rdt.BIAS)

    def health(self) -> Health:
        return Health(self.tally.received, len(self.tally.missing), self.tally.saturated)

    def check(self) -> None:
        """Raises `RigError` like `ForceSource.check`, but not for saturation; see `health`."""
        if self._reader is not None:
            self._reader.check()
        if self.tally.fault:
            raise RigError(
                f"{self.name}: {rdt.status_text(self.tally.fault)}; switch the box off and on"
            )

    def stop(self) -> None:
        if self._reader is None:
            return
        for _ in range(2 * TRIES):
            try:
                self._socket.send(rdt.request_bytes(rdt.STOP))
            except OSError:
                pass  # an unreachable box needs no stop
            if self._reader.end(0.25):
                break
        else:
            self._reader.abandon()
        self._reader = None

    def close(self) -> None:
        self.stop()
        self._socket.close()
