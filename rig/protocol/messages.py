"""What host and manifold say to each other: the messages of protocol 1, and their bytes.

A message is a type byte and its fields, little endian: docs/reference/rig_protocol.md.
Pressures are whole pascals (gauge), so that none can be NaN.
"""

import struct
from enum import IntEnum
from typing import NamedTuple
from zlib import crc32

from cobs import cobs

PROTOCOL = 1
CHAMBERS = ("front_left", "front_right", "rear_left", "rear_right")
CHANNELS = (*(f"p_{name}_Pa" for name in CHAMBERS), "p_supply_Pa", "in_1_uV", "in_2_uV", "in_3_uV")
"""What a reading holds: gauge pressures [Pa], and three analogue inputs [uV]."""
WATCHDOG = 0.1
"""The manifold vents when no valid command came for so long [s]."""
SAMPLES_A_PIECE = 8
"""Most samples of a waveform in one message."""


class ManifoldState(IntEnum):
    """Of the manifold. All valves vent in every state but ARMED and PLAYING."""

    BOOT = 0
    """No limits yet."""
    READY = 1
    ARMED = 2
    """Follows SetPressures."""
    PLAYING = 3
    """Follows the waveform it was given."""
    FAULT = 4
    """Has vented for a reason of its own; `SetLimits` clears it."""


class Answer(IntEnum):
    """Codes of `Ack`."""

    DONE = 0
    UNKNOWN = 1
    """Type unknown, or of the wrong length."""
    WRONG_STATE = 2
    ABOVE_LIMIT = 3
    """`detail` is the chamber."""
    BELOW_ZERO = 4
    """A set gauge pressure under 0; `detail` is the chamber."""
    WRONG_PLACE = 5
    """A piece of a waveform outside it, or a waveform that is not complete or too long."""


class Cause(IntEnum):
    """Codes of `Event`: why the manifold vented."""

    RESET = 0
    """It has just started."""
    STOPPED = 1
    WATCHDOG = 2
    """No valid command for `WATCHDOG`; `detail` is the milliseconds without."""
    OVER_PRESSURE = 3
    """A chamber read more than its limit and a tenth; `detail` is the chamber."""
    REFUSED = 4
    """A set pressure outside the limits; `detail` is the chamber."""
    PLAYED = 5
    """The waveform is at its end."""


class Hello(NamedTuple):
    """Asks for `Ident`."""

    protocol: int


class SetLimits(NamedTuple):
    """Highest set pressure of each chamber [Pa]; clears a fault, and vents. Answered by `Ack`."""

    seq: int
    front_left: int
    front_right: int
    rear_left: int
    rear_right: int


class Arm(NamedTuple):
    """From READY to ARMED, at set pressures of 0. Answered by `Ack`."""

    seq: int


class SetPressures(NamedTuple):
    """Set pressures [Pa], at once. Not answered but when refused; readings tell the last `seq`."""

    seq: int
    front_left: int
    front_right: int
    rear_left: int
    rear_right: int


class Heartbeat(NamedTuple):
    """Says that the host is alive, and nothing else. Not answered."""

    seq: int


class Stop(NamedTuple):
    """Vents everything, in any state, and disarms. Answered by `Ack`."""

    seq: int


class WaveBegin(NamedTuple):
    """A waveform of `samples`, `period_us` apart, follows. Answered by `Ack`."""

    seq: int
    samples: int
    period_us: int


class WavePiece(NamedTuple):
    """Samples from `first` on, four pressures [Pa] each, chamber by chamber. Answered by `Ack`."""

    seq: int
    first: int
    pressures: tuple[int, ...]


class WavePlay(NamedTuple):
    """From ARMED to PLAYING, `repeats` times, or until stopped if 0. Answered by `Ack`."""

    seq: int
    repeats: int


class Ident(NamedTuple):
    """Which manifold this is, and the limits [Pa] that nothing can raise."""

    protocol: int
    major: int
    minor: int
    patch: int
    samples: int
    """Longest waveform."""
    rate: int
    """Readings a second."""
    front_left: int
    front_right: int
    rear_left: int
    rear_right: int


class Reading(NamedTuple):
    """All channels at one instant of the device's clock."""

    seq: int
    device_us: int
    state: int
    command: int
    """`seq` of the last `SetPressures` that was accepted."""
    channels: tuple[int, ...]
    """(8,) as in `CHANNELS`."""


class Ack(NamedTuple):
    """What came of the command `seq` of a type."""

    seq: int
    kind: int
    answer: int
    detail: int


class Event(NamedTuple):
    """The manifold vented by itself, or as it was told."""

    device_us: int
    cause: int
    detail: int


class Follows(NamedTuple):
    """The valves follow these set pressures [Pa] from now on: said when armed, and at each change.

    A command is late on its way, and a drive is what the valves were told, not what was meant.
    """

    number: int
    """Of the changes; a gap tells that some are lost."""
    device_us: int
    front_left: int
    front_right: int
    rear_left: int
    rear_right: int


Message = (
    Hello | SetLimits | Arm | SetPressures | Heartbeat | Stop | WaveBegin | WavePiece | WavePlay
    | Ident | Reading | Ack | Event | Follows
)  # fmt: skip

_TABLE: dict[int, tuple[type, str]] = {
    0x01: (Hello, "<H"),
    0x02: (SetLimits, "<H4i"),
    0x03: (Arm, "<H"),
    0x04: (SetPressures, "<H4i"),
    0x05: (Heartbeat, "<H"),
    0x06: (Stop, "<H"),
    0x07: (WaveBegin, "<HHI"),
    0x08: (WavePiece, "<HH"),
    0x09: (WavePlay, "<HI"),
    0x81: (Ident, "<HBBBHH4i"),
    0x82: (Reading, "<IQBH8i"),
    0x83: (Ack, "<HBBi"),
    0x84: (Event, "<QBi"),
    0x85: (Follows, "<HQ4i"),
}
_LAYOUTS = {code: (kind, struct.Struct(layout)) for code, (kind, layout) in _TABLE.items()}
_CODES = {kind: code for code, (kind, _) in _TABLE.items()}
_SAMPLE = struct.Struct("<4i")


def type_byte(kind: type) -> int:
    """The type byte of a kind of message."""
    return _CODES[kind]


def pack_message(message: Message) -> bytes:
    """Type byte and fields. Raises `struct.error` for a number that its field cannot hold."""
    code = _CODES[type(message)]
    layout = _LAYOUTS[code][1]
    if isinstance(message, Reading):
        return bytes([code]) + layout.pack(*message[:4], *message.channels)
    if isinstance(message, WavePiece):
        samples = struct.pack(f"<{len(message.pressures)}i", *message.pressures)
        return bytes([code]) + layout.pack(message.seq, message.first) + samples
    return bytes([code]) + layout.pack(*message)


def unpack_message(body: bytes) -> Message | None:
    """The message of these bytes; None if there is none such."""
    if not body or body[0] not in _LAYOUTS:
        return None
    kind, layout = _LAYOUTS[body[0]]
    fields = body[1:]
    if kind is WavePiece:
        samples, rest = divmod(len(fields) - layout.size, _SAMPLE.size)
        if rest or not 1 <= samples <= SAMPLES_A_PIECE:
            return None
        pressures = struct.unpack_from(f"<{4 * samples}i", fields, layout.size)
        seq, first = layout.unpack_from(fields)
        return WavePiece(seq, first, pressures)
    if len(fields) != layout.size:
        return None
    values = layout.unpack(fields)
    if kind is Reading:
        seq, device_us, state, command, *channels = values
        return Reading(seq, device_us, state, command, tuple(channels))
    return kind(*values)


LONGEST_FRAME = 192
"""Most bytes between two zeros: more are noise."""


def encode_frame(message: Message) -> bytes:
    """The frame of a message."""
    body = pack_message(message)
    return cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"


def decode_frame(frame: bytes) -> Message | None:
    """The message of the bytes before a zero; None where they are damaged."""
    try:
        content = cobs.decode(frame)
    except cobs.DecodeError:
        return None
    body, check = content[:-4], content[-4:]
    if len(check) != 4 or crc32(body).to_bytes(4, "little") != check:
        return None
    return unpack_message(body)


class FrameDecoder:
    """Messages of a stream of bytes, in pieces of any size; what is damaged is counted."""

    def __init__(self) -> None:
        self.damaged = 0
        """Runs of bytes between zeros that were no message."""
        self._rest, self._noise = b"", False

    def feed(self, piece: bytes) -> list[Message]:
        """The messages that end in this piece."""
        *frames, self._rest = (self._rest + piece).split(b"\0")
        found = []
        for frame in frames:
            message = None if self._noise or len(frame) > LONGEST_FRAME else decode_frame(frame)
            if message is not None:
                found.append(message)
            elif frame or self._noise:
                self.damaged += 1
            self._noise = False
        if len(self._rest) > LONGEST_FRAME:
            self._rest, self._noise = b"", True
        return found
