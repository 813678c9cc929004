"""A pseudo-terminal for a simulated device, which programs open like a serial port."""

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
"""Largest number of unread bytes; older bytes are dropped, as in a ring buffer."""
MAX_START_TIME = 60.0
"""Longest time for a device to start in its own process [s]."""


class Device(Protocol):
    """A device that exchanges bytes with the host. Times are microseconds since power-up."""

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Takes bytes from the host and returns the answer."""
        ...

    def tick(self, now_us: int) -> bytes:
        """Advances to `now_us` and returns the bytes sent meanwhile."""
        ...


class ServedDevice(NamedTuple):
    """A running device on a pseudo-terminal."""

    path: str
    """Name of the port to open."""
    unplug: Callable[[], None]
    """Removes the port, as if its cable were pulled."""


class Terminal:
    """A pseudo-terminal connected to a device; `path` is the port's name."""

    def __init__(self, device: Device, backlog: int = BACKLOG):
        self.dropped = 0
        """Number of bytes that the host did not read in time."""
        self._device, self._backlog, self._out = device, backlog, b""
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.path = os.ttyname(self._theirs)

    def wait_for_host(self) -> None:
        """Waits until a program has opened the port."""
        os.close(self._theirs)
        self._theirs = -1
        listener = select.poll()
        listener.register(self._ours, select.POLLHUP)
        # The system reports POLLHUP while no program has opened the other end.
        while any(event & select.POLLHUP for _, event in listener.poll(0)):
            time.sleep(0.01)
        with suppress(OSError):  # fails, without harm, if the host has exclusive access
            self._theirs = os.open(self.path, os.O_RDWR | os.O_NOCTTY)

    def serve(self, ended: Callable[[], bool]) -> None:
        """Runs the device in real time until `ended()` is True, then removes the port."""
        start = time.monotonic_ns()
        try:
            while not ended():
                select.select([self._ours], [], [], STEP)
                now_us = (time.monotonic_ns() - start) // 1000
                received = self._read()
                sent = self._device.feed(received, now_us) if received else b""
                self._write(sent + self._device.tick(now_us))
        finally:
            os.close(self._ours)
            # `_theirs` stayed open until now, so that `_ours` could be read without a host.
            if self._theirs >= 0:
                os.close(self._theirs)

    def _read(self) -> bytes:
        try:
            return os.read(self._ours, 65_536)
        except OSError:  # no data, or no program has opened the port
            return b""

    def _write(self, sent: bytes) -> None:
        self._out += sent
        try:
            while self._out:
                self._out = self._out[os.write(self._ours, self._out) :]
        except BlockingIOError:
            pass
        excess = len(self._out) - self._backlog
        if excess > 0:
            self.dropped += excess
            self._out = self._out[excess:]


@contextmanager
def serve_in_thread(device: Device, backlog: int = BACKLOG) -> Iterator[ServedDevice]:
    """Runs the device in a thread of this process."""
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
    """Runs the device `make(*arguments)` in a process that ends when this process ends.

    `make` must be a function or class of a module, because the new process imports it. Raises
    `RigError` if the device does not start.
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
        if not here.poll(MAX_START_TIME):
            process.terminate()
            raise RigError(f"simulated device: not started within {MAX_START_TIME:g} s; try again")
        try:
            path = here.recv()
        except EOFError:
            raise RigError(
                "simulated device: did not start; its output above shows the reason"
            ) from None
        yield ServedDevice(path, unplug)
    finally:
        unplug()


def _serve(
    pipe: Connection, backlog: int, make: Callable[..., Device], arguments: tuple[object, ...]
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles Ctrl-C
    terminal = Terminal(make(*arguments), backlog)
    pipe.send(terminal.path)
    # The pipe becomes readable when `unplug` is called or the parent process ends.
    terminal.serve(pipe.poll)
