"""Messages between host and manifold (protocol 1), and their frames on the serial line.

A message is a type byte and its fields, little endian (table in docs/reference/rig_protocol.md).
Pressures are gauge pressures in whole pascals, because an integer cannot be NaN. A frame is a
message and its CRC-32, encoded by COBS and followed by a zero byte. zlib and Ethernet use the same
CRC. A CRC of only two bytes would accept about 15 of a million damaged frames.
"""

import struct
from enum import IntEnum
from typing import NamedTuple
from zlib import crc32

from cobs import cobs

PROTOCOL = 1
CHAMBERS = ("front_left", "front_right", "rear_left", "rear_right")
CHANNELS = (*(f"p_{name}_Pa" for name in CHAMBERS), "p_supply_Pa", "in_1_uV", "in_2_uV", "in_3_uV")
"""Channels of a reading: gauge pressures [Pa], then three analogue inputs [uV]."""
WATCHDOG = 0.1
"""The manifold vents if it receives no valid command for this time [s]."""
MAX_SAMPLES_PER_PIECE = 8
"""Largest number of waveform samples in one `WavePiece` message."""


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
    """A pressure exceeds the chamber's limit; `detail` is the chamber's index in `CHAMBERS`."""
    BELOW_ZERO = 4
    """A gauge pressure is below 0; `detail` is the chamber's index in `CHAMBERS`."""
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
    front_left: int
    front_right: int
    rear_left: int
    rear_right: int


class Arm(NamedTuple):
    """Changes the state from READY to ARMED, with set pressures of 0. Answer: `Ack`."""

    seq: int


class SetPressures(NamedTuple):
    """Sets the set pressures [Pa]. Answer: `Ack`, but only if the manifold refuses the command."""

    seq: int
    front_left: int
    front_right: int
    rear_left: int
    rear_right: int


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
    """Uploads samples of 4 pressures [Pa]. `first` is the first sample's index. Answer: `Ack`."""

    seq: int
    first: int
    pressures: tuple[int, ...]


class WavePlay(NamedTuple):
    """Plays the waveform `repeats` times (0: until `Stop`), only in ARMED. Answer: `Ack`."""

    seq: int
    repeats: int


class Ident(NamedTuple):
    """Firmware version and hard limits [Pa] of the manifold. No command can raise these limits."""

    protocol: int
    major: int
    minor: int
    patch: int
    samples: int
    """Largest number of samples in a waveform."""
    rate: int
    """Rate of the readings [1/s]."""
    front_left: int
    front_right: int
    rear_left: int
    rear_right: int


class Reading(NamedTuple):
    """Values of all channels at the time `device_us` on the manifold's clock [us]."""

    seq: int
    device_us: int
    state: int
    command: int
    """Field `seq` of the last accepted `SetPressures`."""
    channels: tuple[int, ...]
    """(8,) values in the order of `CHANNELS`."""


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
    """Returns the type byte of a message class."""
    return _CODES[kind]


def pack_message(message: Message) -> bytes:
    """Returns the message as bytes. Raises `struct.error` if a number does not fit into a field."""
    code = _CODES[type(message)]
    layout = _LAYOUTS[code][1]
    if isinstance(message, Reading):
        return bytes([code]) + layout.pack(*message[:4], *message.channels)
    if isinstance(message, WavePiece):
        samples = struct.pack(f"<{len(message.pressures)}i", *message.pressures)
        return bytes([code]) + layout.pack(message.seq, message.first) + samples
    return bytes([code]) + layout.pack(*message)


def unpack_message(body: bytes) -> Message | None:
    """Returns the message in `body`; None if the message's type or length is unknown."""
    if not body or body[0] not in _LAYOUTS:
        return None
    kind, layout = _LAYOUTS[body[0]]
    fields = body[1:]
    if kind is WavePiece:
        samples, rest = divmod(len(fields) - layout.size, _SAMPLE.size)
        if rest or not 1 <= samples <= MAX_SAMPLES_PER_PIECE:
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
"""Largest number of bytes between two zero bytes. A longer sequence counts as a damaged frame."""


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
