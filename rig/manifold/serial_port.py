"""Lists, opens and reads serial ports."""

import errno
import os
import re
from typing import NamedTuple, Protocol

import serial
from serial.tools import list_ports

from rig.errors import RigError

BAUD = 2_000_000


class PortLost(RigError):
    """An open port disappeared."""


class Readable(Protocol):
    """The attributes of `serial.Serial` that `read_piece` needs."""

    @property
    def in_waiting(self) -> int: ...
    def read(self, size: int, /) -> bytes: ...


class SerialPortInfo(NamedTuple):
    """A serial port of this computer."""

    name: str
    description: str
    serial_number: str


def serial_ports() -> list[SerialPortInfo]:
    """Returns all serial ports, sorted by name."""
    return [
        SerialPortInfo(port.device, port.description or "", port.serial_number or "")
        for port in sorted(list_ports.comports(), key=lambda port: port.device)
    ]


def open_port(name: str, baud: int = BAUD) -> serial.Serial:
    """Opens the port for this process only. A read waits at most 50 ms, and a write at most 0.5 s.

    Raises `RigError` if the port is missing, busy, forbidden, or not a serial port.
    """
    try:
        port = serial.Serial(name, baud, timeout=0.05, write_timeout=0.5, exclusive=True)
        port.reset_input_buffer()
    except Exception as error:  # also termios.error, which not every system has
        raise RigError(_open_failure(name, error)) from None
    return port


def read_piece(port: Readable) -> bytes:
    """Returns the received bytes; empty if no byte arrives within the port's timeout.

    The first read waits for one byte, and the second read returns all further bytes. Without the
    second read, each frame would be recorded as two pieces.
    """
    piece = port.read(1)
    waiting = port.in_waiting if piece else 0
    return piece + port.read(waiting) if waiting else piece


def _open_failure(name: str, error: Exception) -> str:
    """Returns the message for a port that cannot be opened."""
    number = getattr(error, "errno", None)
    if number is None and error.__context__ is not None:
        number = getattr(error.__context__, "errno", None)
    if number is None and (code := re.search(r"\((\d+), ", str(error))):
        number = int(code[1])
    if number == errno.ENOENT or (os.name == "posix" and not os.path.exists(name)):
        ports = ", ".join(port.name for port in serial_ports()) or "none"
        return f"--port {name}: no such port; available ports: {ports}; is the device plugged in?"
    if number in (errno.EACCES, errno.EPERM):
        return (
            f"--port {name}: no permission; on Linux add yourself to the port's group "
            f"(sudo usermod -aG dialout $USER) and log in again"
        )
    if number in (errno.EAGAIN, errno.EBUSY) or "lock" in str(error):
        return f"--port {name}: busy; another program has opened the port; close that program"
    if number == errno.ENOTTY:
        return f"--port {name}: not a serial port; `slider rig ports` lists the serial ports"
    return f"--port {name}: cannot be opened ({error})"
