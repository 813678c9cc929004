"""The manifold's C++ core sends the same bytes as its Python twin, on this computer."""

import subprocess
import zlib
from functools import cache
from random import Random

import numpy as np
import pytest
from cobs import cobs

from calibration.pressure_logs.read import read_log
from rig.protocol.messages import (
    MOST_CHAMBERS,
    Ack,
    Answer,
    Arm,
    Cause,
    Event,
    Follows,
    FrameDecoder,
    Heartbeat,
    Hello,
    Ident,
    Message,
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
    unpack_message,
)
from rig.simulated.manifold import ManifoldCore
from tests.support.firmware_host import SKETCH, ask, build, compiler, sanitizers
from tests.support.rig_dialogues import (
    HARD,
    LONGEST,
    START,
    Dialogue,
    all_codes,
    channels_of,
    count_codes,
    expected_reply,
)
from tests.support.rig_vectors import VECTORS

PA_PER_COUNT = 932.8
FROM_MANIFOLD = (Ident, Reading, Ack, Event, Follows)


@pytest.fixture(scope="module", params=["plain", "sanitized"])
def program(request, tmp_path_factory):
    """Returns the compiled core with stdin and stdout, without and with sanitizers."""
    folder = tmp_path_factory.mktemp(request.param)
    if request.param == "plain":
        return build("host.cpp", folder)
    flags = sanitizers(folder)
    if not flags:
        pytest.skip("this compiler has no address and undefined behaviour sanitizers")
    return build("host.cpp", folder, *flags)


def bodies(sent):
    """Returns the bodies that the decoder passes on, each after its size."""
    found = []
    while sent:
        found.append(sent[1 : 1 + sent[0]])
        sent = sent[1 + sent[0] :]
    return found


def test_frames_are_cobs_and_the_crc_of_zlib(program):
    longest = Reading(1, 2, 1, 0, tuple(range(MOST_CHAMBERS + 4)))
    bodies = b"123456789", b"\0\0", bytes(187), pack_message(longest)
    reply = ask(program, [(b"E", 0, body) for body in bodies])
    assert reply[0].sent == b"\x0e123456789" + (0xCBF43926).to_bytes(4, "little") + b"\0"
    assert reply[1].sent == b"\1\1\5" + zlib.crc32(b"\0\0").to_bytes(4, "little") + b"\0"
    assert reply[2].sent == b""
    assert reply[3].sent == encode_frame(longest)


def test_every_message_has_the_same_bytes_in_both_languages(program):
    assert {type(message) for message, _ in VECTORS} == {
        *(Hello, SetLimits, Arm, SetPressures, Heartbeat, Stop, WaveBegin, WavePiece, WavePlay),
        *FROM_MANIFOLD,
    }
    for message, text in VECTORS:
        frame = bytes.fromhex(text)
        assert encode_frame(message) == frame
        assert decode_frame(frame[:-1]) == message
    made = ask(program, [(b"E", 0, pack_message(message)) for message, _ in VECTORS])
    assert [reply.sent.hex() for reply in made] == [text for _, text in VECTORS]
    stream = b"".join(bytes.fromhex(text) for _, text in VECTORS)
    (heard,) = ask(program, [(b"D", 0, stream)])
    assert bodies(heard.sent) == [pack_message(message) for message, _ in VECTORS]
    assert heard.damaged == 0


@cache
def dialogues():
    """Returns the dialogues, computed once for both builds, because the twin is slow."""
    return [Dialogue(seed).run(500) for seed in range(30)]


def test_random_dialogues_have_the_twins_replies(program):
    talks = dialogues()
    replies = ask(program, [request for talk in talks for request in talk.requests])
    expected = [reply for talk in talks for reply in talk.expected]
    for i, (given, wanted) in enumerate(zip(replies, expected, strict=True)):
        assert given == wanted, f"request {i}"
    met = count_codes(replies)
    assert set(met) == all_codes()
    assert min(met.values()) >= 5


def fuzzed(rng, frames):
    """Returns the frames' stream with 1 % of its bytes changed, dropped or inserted."""
    stream = np.frombuffer(b"".join(frames), np.uint8)
    fate = rng.random(len(stream))
    flip, drop, more = fate < 0.0033, (0.0033 <= fate) & (fate < 0.0067), fate > 0.9967
    stream = stream ^ np.where(flip, rng.integers(1, 256, len(stream)), 0).astype(np.uint8)
    stray = rng.integers(0, 256, int(more.sum()), np.uint8)
    at = np.flatnonzero(more) - np.searchsorted(np.flatnonzero(drop), np.flatnonzero(more))
    return np.insert(stream[~drop], at, stray).tobytes()


def some_frame(random, number):
    """Returns a frame of a random kind that is unique for this number."""
    values = [random.randint(-(2**31), 2**31 - 1) for _ in range(8)]
    low, high = number % 65_536, number // 65_536
    message: Message = random.choice(
        (
            SetPressures(low, (high, *values[:3])),
            SetLimits(low, (high, 0, 0, 0)),
            WaveBegin(low, high, number),
            WavePiece(low, high, tuple(values[:4] * random.randint(1, 8))),
            WavePlay(low, number),
            Reading(number, 2000 * number, 2, low, tuple(values)),
            Event(number, 5, high),
        )
    )
    return encode_frame(message)


def fuzz(program, count):
    """Damage `count` frames; both decoders must return exactly the undamaged ones."""
    random, rng, decoder = Random(1), np.random.default_rng(2), FrameDecoder()
    whole = damaged = 0
    for first in range(0, count, 20_000):
        frames = [some_frame(random, first + i) for i in range(min(20_000, count - first))]
        sent, stream = {frame[:-1] for frame in frames}, fuzzed(rng, frames) + b"\0"
        # A run of bytes between zeros is damaged if it equals none of the sent frames.
        runs = [run for run in stream.split(b"\0") if run]
        sound = [run for run in runs if run in sent]
        before = decoder.damaged
        twin = [
            message
            for i in range(0, len(stream), 997)
            for message in decoder.feed(stream[i : i + 997])
        ]
        assert [encode_frame(message)[:-1] for message in twin] == sound
        assert decoder.damaged - before == len(runs) - len(sound)
        pieces = [(b"D", 0, stream[i : i + 50_000]) for i in range(0, len(stream), 50_000)]
        replies = ask(program, pieces)
        heard = [body for reply in replies for body in bodies(reply.sent)]
        assert [unpack_message(body) for body in heard] == twin
        assert replies[-1].damaged == decoder.damaged - before
        whole, damaged = whole + len(sound), damaged + len(runs) - len(sound)
    assert whole > 0.5 * count and damaged > 0.2 * count


def test_only_undamaged_frames_of_a_fuzzed_stream_are_accepted(program):
    fuzz(program, 10_000)


@pytest.mark.slow
def test_no_damaged_frame_of_a_million_is_accepted(program):
    fuzz(program, 1_000_000)


def test_noise_of_any_length_counts_as_one_damaged_frame(program):
    lengths = (1, 191, 192, 193, 1000)
    stream = b"".join(b"\7" * length + b"\0\0" + encode_frame(Arm(length)) for length in lengths)
    (reply,) = ask(program, [(b"D", 0, stream)])
    assert bodies(reply.sent) == [pack_message(Arm(length)) for length in lengths]
    assert reply.damaged == len(lengths)


def framed(body):
    """Returns a frame of any body with a correct CRC."""
    return cobs.encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0"


def test_the_longest_frame_has_192_bytes(program):
    (reply,) = ask(program, [(b"D", 0, framed(bytes(187)) + framed(bytes(188)))])
    assert bodies(reply.sent) == [bytes(187)]
    assert reply.damaged == 1


def test_a_truncated_frame_is_not_completed_by_the_previous_one(program):
    frame = framed(pack_message(Arm(3)))
    (reply,) = ask(program, [(b"D", 0, frame + frame[:-2] + b"\0")])
    assert bodies(reply.sent) == [pack_message(Arm(3))]
    assert reply.damaged == 1


def test_core_and_twin_accept_the_same_types_and_lengths(program):
    twin, frames, expected = ManifoldCore(HARD, (3, 2, 1), LONGEST), [], []
    for kind in (*range(0x0C), *range(0x80, 0x86), 0xFF):
        for length in range(180):
            frames.append(framed(bytes([kind]) + bytes(length)))
            expected.append(expected_reply(twin, twin.feed(frames[-1], 0)))
    replies = ask(program, [(b"I", 0, START), *((b"F", 0, frame) for frame in frames)])[1:]
    assert replies == expected
    assert twin.damaged == len(frames) - 8 - 8


def backlog(program, passes):
    """Returns the reply to a host that sends Stop after `passes` unread readings."""
    idle = channels_of(*range(8))
    waiting = [(b"B", 2000 * i, idle) for i in range(passes + 1)]
    stop = (b"F", 2000 * passes, encode_frame(Stop(9)))
    return ask(program, [(b"I", 0, START), *waiting, stop])[-1]


def test_a_host_that_reads_nothing_for_two_seconds_loses_nothing(program):
    reply = backlog(program, 1000)
    event, *readings, ack, stopped = FrameDecoder().feed(reply.sent)
    assert [r.seq for r in readings] == list(range(1000))
    assert [r.device_us for r in readings] == [2000 * i for i in range(1, 1001)]
    assert (event.cause, stopped.cause) == (Cause.RESET, Cause.STOPPED)
    assert ack == Ack(9, 6, Answer.DONE, 0)
    assert reply.lost == 0


def test_a_full_ring_buffer_drops_whole_readings_and_the_core_still_answers(program):
    reply, decoder = backlog(program, 2000), FrameDecoder()
    _, *readings, ack, stopped = decoder.feed(reply.sent)
    assert [r.seq for r in readings] == list(range(len(readings)))
    assert reply.lost == 2000 - len(readings) > 0
    assert ack == Ack(9, 6, Answer.DONE, 0)
    assert stopped.cause == Cause.STOPPED
    assert decoder.damaged == 0


def duties(program, errors):
    """Returns the valves' duties (n, 2) at pressure errors in the published firmware's counts."""
    pascals = np.round(PA_PER_COUNT * np.asarray(errors)).astype("<i4")
    pairs = np.stack([pascals, np.zeros_like(pascals)], axis=1)
    pieces = [pairs[i : i + 5000].tobytes() for i in range(0, len(pairs), 5000)]
    output = b"".join(reply.sent for reply in ask(program, [(b"L", 0, p) for p in pieces]))
    return np.frombuffer(output, np.uint8).reshape(-1, 2)


def test_the_valves_follow_the_published_law(program):
    found = duties(program, [0.0, 1.25, -1.25, 24.95, 25.5, -1000.0, 1000.0])
    expected = [(0, 0), (12, 0), (0, 12), (249, 0), (250, 0), (0, 250), (250, 0)]
    assert [tuple(row) for row in found.tolist()] == expected


def test_the_valves_duties_equal_those_in_the_published_firmwares_logs(program, data):
    for path in sorted((data / "manifold").glob("*.txt")):
        log = read_log(path)
        found = duties(program, log.command - log.pressure)
        # The logs' error is rounded to 0.01 counts, a tenth of a duty.
        np.testing.assert_allclose(found[:, 0], log.fill, atol=1.0)
        np.testing.assert_allclose(found[:, 1], log.vent, atol=1.0)


def test_the_core_uses_no_heap_and_no_exceptions(tmp_path):
    parts = sorted(SKETCH.glob("*.cpp"))
    command = [compiler(), "-std=c++17", "-O1", "-c", *map(str, parts)]
    subprocess.run(command, cwd=tmp_path, check=True)
    objects = [str(tmp_path / f"{part.stem}.o") for part in parts]
    command = ["nm", "--undefined-only", "--demangle", *objects]
    needed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    for word in ("operator new", "operator delete", "malloc", "free", "__cxa_throw"):
        assert word not in needed
    assert "slider::" in needed
