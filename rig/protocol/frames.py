"""Messages on the wire: a body, its CRC-32, stuffed by COBS, and a zero byte.

CRC-32 is that of zlib and Ethernet, little endian. Four bytes, not two: of a million damaged frames
sixteen bits would let some fifteen pass.
"""

from zlib import crc32

from cobs import cobs

from rig.protocol.messages import Message, pack, unpack

LONGEST = 192
"""Most bytes between two zeros: more are noise."""


def encode(message: Message) -> bytes:
    """The frame of a message."""
    body = pack(message)
    return cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"


def decode(frame: bytes) -> Message | None:
    """The message of the bytes before a zero; None where they are damaged."""
    try:
        content = cobs.decode(frame)
    except cobs.DecodeError:
        return None
    body, check = content[:-4], content[-4:]
    if len(check) != 4 or crc32(body).to_bytes(4, "little") != check:
        return None
    return unpack(body)


class Decoder:
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
            message = None if self._noise or len(frame) > LONGEST else decode(frame)
            if message is not None:
                found.append(message)
            elif frame or self._noise:
                self.damaged += 1
            self._noise = False
        if len(self._rest) > LONGEST:
            self._rest, self._noise = b"", True
        return found
