"""The manifold's frames: no damaged frame is accepted, and no intact frame is missed."""

import hashlib
import random
import struct
import zlib

import pytest

from rig.manifold.serial_port import read_piece
from rig.protocol.messages import (
    LONGEST_FRAME,
    Ack,
    Arm,
    Event,
    Follows,
    FrameDecoder,
    Heartbeat,
    Hello,
    Ident,
    Reading,
    SetLimits,
    SetPressures,
    Stop,
    WaveBegin,
    WavePiece,
    WavePlay,
    decode_frame,
    encode_frame,
    pack_message,
    samples_per_piece,
    unpack_message,
)
from tests.support.rig_dialogues import Dialogue
from tests.support.rig_vectors import VECTORS

EACH = (
    Hello(1),
    SetLimits(2, (100, 200, 300, 400)),
    Arm(3),
    SetPressures(65535, (0, 256, 65536, 500_000)),
    Heartbeat(4),
    Stop(5),
    WaveBegin(6, 2000, 500),
    WavePiece(7, 1992, tuple(range(32))),
    WavePlay(8, 0),
    Ident(1, 1, 2, 3, 2000, 500, (5, 6, 7, 8)),
    Reading(2**32 - 1, 2**40, 2, 9, (-(2**31), 2**31 - 1, 0, -1, 1, 2, 3, 4)),
    Ack(10, 4, 3, -1),
    Event(2**50, 2, 105),
)


def make_readings(count):
    return [Reading(i, 2000 * i, 2, i % 65536, tuple(range(i, i + 8))) for i in range(count)]


def damage(frames, share, random):
    """Flip, drop or insert a share of the frames' bytes; return the bytes, and which frames were
    touched."""
    wire, touched = bytearray(), []
    for frame in frames:
        hit = False
        for byte in frame:
            if random.random() >= share:
                wire.append(byte)
                continue
            hit = True
            match random.randrange(3):
                case 0:
                    wire.append(byte ^ (1 << random.randrange(8)))
                case 1:
                    wire += bytes([random.randrange(256), byte])
        touched.append(hit)
    return bytes(wire), touched


@pytest.mark.parametrize("message", EACH, ids=lambda m: type(m).__name__)
def test_every_message_is_recovered_from_its_frame(message):
    frame = encode_frame(message)
    assert frame[-1] == 0 and 0 not in frame[:-1] and len(frame) <= LONGEST_FRAME + 1
    assert decode_frame(frame[:-1]) == message


@pytest.mark.parametrize("chambers", [1, 3, 6, 38])
def test_the_length_of_a_message_gives_the_number_of_chambers(chambers):
    p = tuple(range(-1, chambers - 1))
    for message in (
        *(SetLimits(1, p), SetPressures(2, p), Ident(1, 1, 2, 3, 2000, 500, p)),
        *(Reading(1, 2, 3, 4, (*p, 5, 6, 7, 8)), Follows(1, 2, p)),
        WavePiece(3, 4, p * samples_per_piece(chambers)),
    ):
        frame = encode_frame(message)
        assert len(frame) <= LONGEST_FRAME + 1 and decode_frame(frame[:-1]) == message
    assert Reading(1, 2, 3, 4, (*p, 5, 6, 7, 8)).pressures == p


@pytest.mark.parametrize(("message", "text"), VECTORS)
def test_frames_of_four_chambers_have_the_bytes_of_recorded_trials(message, text):
    assert encode_frame(message).hex() == text
    assert decode_frame(bytes.fromhex(text)[:-1]) == message


def test_a_dialogue_with_four_chambers_has_the_bytes_of_earlier_versions():
    """The digests were computed with the version in which every message had four pressures."""
    talk = Dialogue(0).run(500)
    asked = hashlib.sha256(b"".join(payload for _, _, payload in talk.requests)).hexdigest()
    sent = hashlib.sha256(b"".join(reply.sent for reply in talk.expected)).hexdigest()
    assert asked == "5bdfd499e6c24f401b75fb27a6c7fbb67d650f2941c6c310bcf901c3db0fefd1"
    assert sent == "a2ade5bb0cf5d3498ee0bfb051e06c438ca787e90451e967058534a4bff87f64"


def test_a_frame_equals_that_of_the_protocol_page():
    """The frame by hand: type 3, sequence 0x0102, the CRC of these three bytes, in COBS."""
    body = bytes([0x03, 0x02, 0x01])
    check = struct.pack("<I", zlib.crc32(body))
    assert 0 not in check
    assert encode_frame(Arm(0x0102)) == bytes([8]) + body + check + b"\0"


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_messages_are_decoded_from_pieces_of_any_size(size):
    wire = b"".join(map(encode_frame, EACH))
    decoder, found = FrameDecoder(), []
    for i in range(0, len(wire), size):
        found += decoder.feed(wire[i : i + size])
    assert found == list(EACH) and decoder.damaged == 0


@pytest.mark.parametrize(
    "body",
    [b"", b"\x55", b"\x03\x01", pack_message(Arm(1)) + b"\0", b"\x08\0\0\0\0", b"\x82" + bytes(10)],
)
def test_unknown_types_and_lengths_are_not_messages(body):
    assert unpack_message(body) is None


def test_every_flipped_bit_is_detected():
    for message in EACH:
        frame = encode_frame(message)
        for bit in range(8 * (len(frame) - 1)):
            wire = bytearray(frame)
            wire[bit // 8] ^= 1 << bit % 8
            decoder = FrameDecoder()
            assert decoder.feed(bytes(wire)) == [] and decoder.damaged >= 1


def test_after_damage_at_most_two_frames_are_lost():
    intact = make_readings(3)
    for cut in range(len(encode_frame(intact[0]))):
        wire = encode_frame(intact[0])[:cut] + encode_frame(intact[1]) + encode_frame(intact[2])
        decoder = FrameDecoder()
        found = decoder.feed(wire)
        assert found[-1] == intact[2] and len(found) >= 1
        assert decoder.damaged == (0 if cut == 0 else 1)


def test_noise_without_a_zero_byte_is_dropped_and_counted_once():
    decoder = FrameDecoder()
    for _ in range(100):
        assert decoder.feed(bytes([7]) * 50) == []
    assert len(decoder._rest) <= LONGEST_FRAME
    assert decoder.feed(b"\0" + encode_frame(Arm(1))) == [Arm(1)] and decoder.damaged == 1


def fuzzed(count, seed, share=0.01):
    """Returns messages sent, which were touched, messages decoded, damaged count of a bad line."""
    chance, sent = random.Random(seed), make_readings(count)
    wire, touched = damage([encode_frame(m) for m in sent], share, chance)
    decoder, found = FrameDecoder(), []
    at = 0
    while at < len(wire):
        size = chance.randrange(1, 400)
        found += decoder.feed(wire[at : at + size])
        at += size
    return sent, touched, found, decoder.damaged


def check_fuzzed(count, seed=7):
    sent, touched, found, count_damaged = fuzzed(count, seed)
    untouched = {m.seq for m, hit in zip(sent, touched, strict=True) if not hit}
    seen = [m.seq for m in found]
    assert all(sent[m.seq] == m for m in found)
    assert len(set(seen)) == len(seen)
    # Noise inserted before a frame's first byte may leave the touched frame valid. If a frame's
    # end is lost, the untouched next frame is lost too.
    assert len(untouched - set(seen)) <= count_damaged
    assert len(sent) - len(seen) <= 2 * count_damaged and 0.3 * count < sum(touched) < 0.6 * count


def test_no_damaged_frame_of_a_bad_line_is_accepted():
    check_fuzzed(20_000)


@pytest.mark.slow
def test_no_damaged_frame_of_a_million_is_accepted():
    for seed in range(10):
        check_fuzzed(100_000, seed)


class LatePort:
    """A port without waiting bytes; a read waits for the next frame."""

    def __init__(self, *frames):
        self.frames, self.waiting = list(frames), b""

    @property
    def in_waiting(self):
        return len(self.waiting)

    def read(self, size):
        if not self.waiting and self.frames:
            self.waiting = self.frames.pop(0)
        piece, self.waiting = self.waiting[:size], self.waiting[size:]
        return piece


def test_a_frame_is_read_as_one_piece():
    frames = [encode_frame(Heartbeat(i)) for i in range(3)]
    port = LatePort(*frames)
    assert [read_piece(port) for _ in range(4)] == [*frames, b""]
