"""Messages between host and manifold (protocol 1), and their frames on the serial line.

A message is a type byte and its fields, little endian (table in docs/reference/rig_protocol.md).
Pressures are gauge pressures in whole pascals, because an integer cannot be NaN. The length of a
message gives the number of chambers. A frame is a message and its CRC-32, encoded by COBS and
followed by a zero byte. zlib and Ethernet use the same CRC. A CRC of only two bytes would accept
about 15 of a million damaged frames.
"""

import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple
from zlib import crc32

from cobs import cobs

PROTOCOL = 1
OTHER_CHANNELS = ("p_supply_Pa", "in_1_uV", "in_2_uV", "in_3_uV")
"""Channels of a reading after the chambers' gauge pressures: gauge pressure of the supply [Pa], and
three analogue inputs [uV]."""
WATCHDOG = 0.1
"""The manifold vents if it receives no valid command for this time [s]."""
MAX_SAMPLES_PER_PIECE = 8
"""Largest number of waveform samples in one `WavePiece` message (see `samples_per_piece`)."""
LONGEST_FRAME = 192
"""Largest number of bytes between two zero bytes. A longer sequence counts as a damaged frame."""


class ManifoldState(IntEnum):
    """State of the manifold. All chambers vent in the states BOOT, READY and FAULT."""

    BOOT = 0
    """The limits are not set yet."""
    READY = 1
    ARMED = 2
    """The valves follow `SetPressures`."""
    PLAYING = 3
    """The valves follow the uploaded waveform."""
    FAULT = 4
    """The manifold vented because of an error (see `Cause`). `SetLimits` clears the fault."""


class Answer(IntEnum):
    """Codes of the field `answer` of `Ack`: result of a command."""

    DONE = 0
    UNKNOWN = 1
    """Reserved for later protocols. The manifold ignores unknown types and wrong lengths."""
    WRONG_STATE = 2
    ABOVE_LIMIT = 3
    """A pressure exceeds the chamber's limit; `detail` is the chamber's index."""
    BELOW_ZERO = 4
    """A gauge pressure is below 0; `detail` is the chamber's index."""
    WRONG_PLACE = 5
    """Samples are outside the waveform, or the waveform is incomplete or has a wrong size."""


class Cause(IntEnum):
    """Codes of the field `cause` of `Event`. The manifold vents at each event except PLAYED."""

    RESET = 0
    """The manifold has just started."""
    STOPPED = 1
    WATCHDOG = 2
    """No valid command came for 0.1 s; `detail` is the time without a command [ms]."""
    OVER_PRESSURE = 3
    """A chamber's pressure exceeded 110 % of its limit + 5 kPa; `detail` is the chamber's index."""
    REFUSED = 4
    """The manifold refused a set pressure or a limit; `detail` is the chamber's index."""
    PLAYED = 5
    """The waveform has ended."""


class Hello(NamedTuple):
    """Asks the manifold for `Ident`. `protocol` is the number of the host's protocol."""

    protocol: int


class SetLimits(NamedTuple):
    """Sets each chamber's highest set pressure [Pa], clears a fault, and vents. Answer: `Ack`."""

    seq: int
    limits: tuple[int, ...]


class Arm(NamedTuple):
    """Changes the state from READY to ARMED, with set pressures of 0. Answer: `Ack`."""

    seq: int


class SetPressures(NamedTuple):
    """Sets the set pressures [Pa]. Answer: `Ack`, but only if the manifold refuses the command."""

    seq: int
    pressures: tuple[int, ...]


class Heartbeat(NamedTuple):
    """Keeps the watchdog from venting. The manifold does not answer."""

    seq: int


class Stop(NamedTuple):
    """Vents all chambers and disarms, in any state. Answer: `Ack`."""

    seq: int


class WaveBegin(NamedTuple):
    """Announces a waveform of `samples` samples, one every `period_us` [us]. Answer: `Ack`."""

    seq: int
    samples: int
    period_us: int


class WavePiece(NamedTuple):
    """Uploads samples of all chambers' pressures [Pa], one sample after the other.

    `first` is the first sample's index. Answer: `Ack`.
    """

    seq: int
    first: int
    pressures: tuple[int, ...]


class WavePlay(NamedTuple):
    """Plays the waveform `repeats` times (0: until `Stop`), only in ARMED. Answer: `Ack`."""

    seq: int
    repeats: int


class Ident(NamedTuple):
    """Firmware version and hard limits [Pa] of the manifold. No command can raise these limits.

    The number of limits is the number of the manifold's chambers.
    """

    protocol: int
    major: int
    minor: int
    patch: int
    samples: int
    """Largest number of samples in a waveform."""
    rate: int
    """Rate of the readings [1/s]."""
    limits: tuple[int, ...]


class Reading(NamedTuple):
    """Values of all channels at the time `device_us` on the manifold's clock [us]."""

    seq: int
    device_us: int
    state: int
    command: int
    """Field `seq` of the last accepted `SetPressures`."""
    channels: tuple[int, ...]
    """Gauge pressures [Pa] of the chambers, then the values of `OTHER_CHANNELS`."""

    @property
    def pressures(self) -> tuple[int, ...]:
        """Gauge pressures [Pa] of the chambers."""
        return self.channels[: -len(OTHER_CHANNELS)]


class Ack(NamedTuple):
    """Result of the command with number `seq` and type byte `kind`."""

    seq: int
    kind: int
    answer: int
    detail: int


class Event(NamedTuple):
    """Reports that the manifold started, vented, or ended a waveform."""

    device_us: int
    cause: int
    detail: int


class Follows(NamedTuple):
    """Set pressures [Pa] that the valves follow from now on.

    The manifold sends this message when it accepts `Arm` and at each change. The drive as played is
    computed from these messages, because a command arrives with a delay.
    """

    number: int
    """Index of the change; a gap in these indices shows that messages were lost."""
    device_us: int
    pressures: tuple[int, ...]


Message = (
    Hello | SetLimits | Arm | SetPressures | Heartbeat | Stop | WaveBegin | WavePiece | WavePlay
    | Ident | Reading | Ack | Event | Follows
)  # fmt: skip

_TABLE: dict[int, tuple[type, str, int]] = {
    0x01: (Hello, "<H", 0),
    0x02: (SetLimits, "<H", 1),
    0x03: (Arm, "<H", 0),
    0x04: (SetPressures, "<H", 1),
    0x05: (Heartbeat, "<H", 0),
    0x06: (Stop, "<H", 0),
    0x07: (WaveBegin, "<HHI", 0),
    0x08: (WavePiece, "<HH", 1),
    0x09: (WavePlay, "<HI", 0),
    0x81: (Ident, "<HBBBHH", 1),
    0x82: (Reading, "<IQBH", 1 + len(OTHER_CHANNELS)),
    0x83: (Ack, "<HBBi", 0),
    0x84: (Event, "<QBi", 0),
    0x85: (Follows, "<HQ", 1),
}
"""Class and fixed fields of each type. If the last number is not 0, the last field is a tuple with
at least so many integers (i32)."""
_LAYOUTS = {code: (kind, struct.Struct(fixed), n) for code, (kind, fixed, n) in _TABLE.items()}
_CODES = {kind: code for code, (kind, *_) in _TABLE.items()}


MOST_CHAMBERS = (LONGEST_FRAME - 2 - 1 - _LAYOUTS[_CODES[Reading]][1].size - 4) // 4 - len(
    OTHER_CHANNELS
)
"""Largest number of chambers with which a `Reading` fits into a frame. The frame has the COBS byte,
the final zero, the type byte and the CRC, besides the fields of the message."""


def channel_names(chambers: Sequence[str]) -> tuple[str, ...]:
    """Returns the names of a reading's channels, with their units."""
    return (*(f"p_{name}_Pa" for name in chambers), *OTHER_CHANNELS)


def samples_per_piece(chambers: int) -> int:
    """Returns the largest number of samples with which a `WavePiece` fits into a frame."""
    # The frame has the COBS byte, the type byte, the fixed fields and the CRC, besides the samples.
    room = LONGEST_FRAME - 2 - _LAYOUTS[_CODES[WavePiece]][1].size - 4
    return min(MAX_SAMPLES_PER_PIECE, room // (4 * chambers))


def type_byte(kind: type) -> int:
    """Returns the type byte of a message class."""
    return _CODES[kind]


def pack_message(message: Message) -> bytes:
    """Returns the message as bytes. Raises `struct.error` if a number does not fit into a field."""
    code = _CODES[type(message)]
    _, fixed, least = _LAYOUTS[code]
    if not least:
        return bytes([code]) + fixed.pack(*message)
    fields: list[Any] = list(message)
    numbers = fields.pop()
    return bytes([code]) + fixed.pack(*fields) + struct.pack(f"<{len(numbers)}i", *numbers)


def unpack_message(body: bytes) -> Message | None:
    """Returns the message in `body`; None if the message's type or length is unknown."""
    if not body or body[0] not in _LAYOUTS:
        return None
    kind, fixed, least = _LAYOUTS[body[0]]
    fields = body[1:]
    count, rest = divmod(len(fields) - fixed.size, 4)
    if rest or count < least or (count and not least):
        return None
    values = fixed.unpack_from(fields)
    if least:
        values += (struct.unpack_from(f"<{count}i", fields, fixed.size),)
    return kind(*values)


def encode_frame(message: Message) -> bytes:
    """Returns the frame of a message, with the zero byte at the end."""
    body = pack_message(message)
    return cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"


def decode_frame(frame: bytes) -> Message | None:
    """Returns the message of a frame without the final zero byte; None for a damaged frame."""
    try:
        content = cobs.decode(frame)
    except cobs.DecodeError:
        return None
    body, check = content[:-4], content[-4:]
    if len(check) != 4 or crc32(body).to_bytes(4, "little") != check:
        return None
    return unpack_message(body)


class FrameDecoder:
    """Decodes a stream of frames from pieces of any size. Drops and counts damaged frames."""

    def __init__(self, in_step: bool = True) -> None:
        """If `in_step` is False, the bytes up to the first zero byte are ignored."""
        self._in_step = in_step
        self.damaged = 0
        """Number of damaged frames, whose bytes are not a valid message."""
        self._rest, self._noise = b"", False

    def feed(self, piece: bytes) -> list[Message]:
        """Returns the messages that end in `piece`."""
        if not self._in_step:
            _, end, piece = piece.partition(b"\0")
            self._in_step = bool(end)
        *frames, self._rest = (self._rest + piece).split(b"\0")
        messages = []
        for frame in frames:
            message = None if self._noise or len(frame) > LONGEST_FRAME else decode_frame(frame)
            if message is not None:
                messages.append(message)
            elif frame or self._noise:
                self.damaged += 1
            self._noise = False
        if len(self._rest) > LONGEST_FRAME:
            self._rest, self._noise = b"", True
        return messages
