"""Serial ports: found, opened, and what is said when that fails."""

import errno
import os
import re
from typing import NamedTuple, Protocol

import serial
from serial.tools import list_ports

from rig.errors import RigError

BAUD = 2_000_000


class PortLost(RigError):
    """The port was there, and is not any more."""


class Readable(Protocol):
    """What is read of `serial.Serial`."""

    @property
    def in_waiting(self) -> int: ...
    def read(self, size: int, /) -> bytes: ...


class SerialPortInfo(NamedTuple):
    """A port of this computer."""

    name: str
    description: str
    serial_number: str


def serial_ports() -> list[SerialPortInfo]:
    """All serial ports, by name."""
    return [
        SerialPortInfo(port.device, port.description or "", port.serial_number or "")
        for port in sorted(list_ports.comports(), key=lambda port: port.device)
    ]


def open_port(name: str, baud: int = BAUD) -> serial.Serial:
    """The port, for this process alone. Reads wait 50 ms at most, writes half a second.

    Raises `RigError` for a port that is missing, busy, forbidden, or no serial port.
    """
    try:
        port = serial.Serial(name, baud, timeout=0.05, write_timeout=0.5, exclusive=True)
        port.reset_input_buffer()
    except Exception as error:  # also termios.error, which not every system has
        raise RigError(_why(name, error)) from None
    return port


def read_piece(port: Readable) -> bytes:
    """What came, waiting for it as long as the port's reads do; as a rule whole frames or lines.

    Asked for what waits, or else for a byte, a frame would come in two pieces, its first byte
    alone, and cost its listener and its recorder twice.
    """
    piece = port.read(1)
    waiting = port.in_waiting if piece else 0
    return piece + port.read(waiting) if waiting else piece


def _why(name: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number is None and error.__context__ is not None:
        number = getattr(error.__context__, "errno", None)
    if number is None and (told := re.search(r"\((\d+), ", str(error))):
        number = int(told[1])
    if number == errno.ENOENT or (os.name == "posix" and not os.path.exists(name)):
        there = ", ".join(port.name for port in serial_ports()) or "none"
        return f"--port {name}: no such port; there are: {there}; is it plugged in?"
    if number in (errno.EACCES, errno.EPERM):
        return (
            f"--port {name}: no permission; on Linux add yourself to its group "
            f"(sudo usermod -aG dialout $USER) and log in again"
        )
    if number in (errno.EAGAIN, errno.EBUSY) or "lock" in str(error):
        return f"--port {name}: busy; another program has it open: close that one"
    if number == errno.ENOTTY:
        return f"--port {name}: is no serial port; `slider rig ports` lists them"
    return f"--port {name}: cannot be opened ({error})"
