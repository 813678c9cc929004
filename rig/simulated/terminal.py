"""A simulated device behind a pseudo-terminal: a name that a program opens as it opens a port."""

import multiprocessing
import os
import pty
import select
import signal
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import NamedTuple, Protocol

from rig.errors import RigError

STEP = 0.001
"""Longest time between two ticks of a device [s]."""
BACKLOG = 65_536
"""Bytes kept for a host that does not read; the oldest are thrown away, as of a ring buffer."""
STARTED = 60.0
"""Most time that a device takes to start in a process of its own [s]."""


class Device(Protocol):
    """Says bytes. Its time is its own, in microseconds since it was switched on."""

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Takes bytes from the host; returns what is said to them."""
        ...

    def tick(self, now_us: int) -> bytes:
        """Goes on to `now_us`; returns what is said meanwhile."""
        ...


class ServedDevice(NamedTuple):
    """A device that runs."""

    path: str
    """Of the port to open."""
    unplug: Callable[[], None]
    """Pulls the cable: who reads or writes now finds the port gone."""


class Terminal:
    """A pseudo-terminal with a device on it; `path` is the port's name."""

    def __init__(self, device: Device, backlog: int = BACKLOG):
        self.thrown = 0
        """Bytes that nobody read in time."""
        self._device, self._backlog, self._out = device, backlog, b""
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.path = os.ttyname(self._theirs)

    def wait_for_host(self) -> None:
        """Until a program has opened the port."""
        os.close(self._theirs)
        self._theirs = -1
        listener = select.poll()
        listener.register(self._ours, select.POLLHUP)
        # A terminal whose other end nobody holds is hung up.
        while any(event & select.POLLHUP for _, event in listener.poll(0)):
            time.sleep(0.01)
        with suppress(OSError):  # of a host that wants it for itself; the port ends with that one
            self._theirs = os.open(self.path, os.O_RDWR | os.O_NOCTTY)

    def serve(self, ended: Callable[[], bool]) -> None:
        """The device's main loop, in real time, until `ended`; then the cable is pulled."""
        begun = time.monotonic_ns()
        try:
            while not ended():
                select.select([self._ours], [], [], STEP)
                now_us = (time.monotonic_ns() - begun) // 1000
                heard = self._read()
                said = self._device.feed(heard, now_us) if heard else b""
                self._write(said + self._device.tick(now_us))
        finally:
            os.close(self._ours)
            # Open all the while, where it can be, else `_ours` could not be read without a host.
            if self._theirs >= 0:
                os.close(self._theirs)

    def _read(self) -> bytes:
        try:
            return os.read(self._ours, 65_536)
        except OSError:  # nothing has come, or nobody holds the other end
            return b""

    def _write(self, said: bytes) -> None:
        self._out += said
        try:
            while self._out:
                self._out = self._out[os.write(self._ours, self._out) :]
        except BlockingIOError:
            pass
        excess = len(self._out) - self._backlog
        if excess > 0:
            self.thrown += excess
            self._out = self._out[excess:]


@contextmanager
def serve_in_thread(device: Device, backlog: int = BACKLOG) -> Iterator[ServedDevice]:
    """The device in a thread of this process."""
    terminal, end = Terminal(device, backlog), threading.Event()
    thread = threading.Thread(target=terminal.serve, args=(end.is_set,), name="device", daemon=True)

    def unplug() -> None:
        end.set()
        thread.join()

    thread.start()
    try:
        yield ServedDevice(terminal.path, unplug)
    finally:
        unplug()


@contextmanager
def serve_in_process(
    make: Callable[..., Device], *arguments: object, backlog: int = BACKLOG
) -> Iterator[ServedDevice]:
    """The device `make(*arguments)` in a process of its own, which ends with this one.

    `make` is a module's function or class, for the process is a fresh one. Raises `RigError` if
    the device does not start.
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(
        target=_serve, args=(there, backlog, make, arguments), name="device", daemon=True
    )

    def unplug() -> None:
        here.close()
        process.join()

    process.start()
    there.close()
    try:
        if not here.poll(STARTED):
            process.terminate()
            raise RigError(f"simulated device: not started within {STARTED:g} s; try again")
        try:
            path = here.recv()
        except EOFError:
            raise RigError(
                "simulated device: did not start; what it wrote above says why"
            ) from None
        yield ServedDevice(path, unplug)
    finally:
        unplug()


def _serve(
    pipe: Connection, backlog: int, make: Callable[..., Device], arguments: tuple[object, ...]
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program that started this one
    terminal = Terminal(make(*arguments), backlog)
    pipe.send(terminal.path)
    # The other end is only ever closed, by `unplug` or by the other process's end.
    terminal.serve(pipe.poll)
