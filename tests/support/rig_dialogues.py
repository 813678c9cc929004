"""Random dialogues of a host with the firmware's Python twin, and the expected replies."""

from collections import Counter
from random import Random

import numpy as np

from rig.protocol.messages import (
    Ack,
    Answer,
    Arm,
    Cause,
    Event,
    FrameDecoder,
    Heartbeat,
    Hello,
    Ident,
    ManifoldState,
    Reading,
    SetLimits,
    SetPressures,
    Stop,
    WaveBegin,
    WavePiece,
    WavePlay,
    encode_frame,
    pack_message,
    type_byte,
)
from rig.simulated.manifold import ManifoldCore
from tests.support.firmware_host import Reply

HARD = (400_000, 300_000, 200_000, 100_000)
LONGEST = 12
START = pack_message(Ident(1, 3, 2, 1, LONGEST, 500, HARD))[1:]


def channels_of(*values):
    return np.array(values, "<i4").tobytes()


def expected_reply(twin, sent):
    """Returns the expected reply of the firmware after its twin has sent these bytes."""
    return Reply(sent, twin.state, twin.set_pressures or (-1,) * 4, twin.damaged, 0)


class Dialogue:
    """A host that sends valid and invalid messages over a line that damages some frames."""

    def __init__(self, seed):
        self.random = Random(seed)
        self.twin = ManifoldCore(HARD, (3, 2, 1), LONGEST)
        self.now = self.random.choice((0, 2**32 - 500_000, 2**53))
        self.limits, self.line = HARD, b""
        self.requests, self.expected = [(b"I", 0, START)], []
        self._expect(b"")

    def run(self, steps):
        for _ in range(steps):
            self.now += self.random.choice((0, 1, 137, 700, 2000, 2001, 4000, 10_000))
            if self.random.random() < 0.02:
                self.now += self.random.choice((60_000, 99_999, 100_000, 1_000_000))
            if self.random.random() < 0.6:
                self._pass()
            else:
                self._talk()
        return self

    def _expect(self, sent):
        self.expected.append(expected_reply(self.twin, sent))

    def _pass(self):
        channels = [self.random.randint(-2000, limit) for limit in self.limits]
        channels += [self.random.randint(-(2**31), 2**31 - 1) for _ in range(4)]
        if self.random.random() < 0.03:
            i = self.random.randrange(4)
            highest = (11 * self.limits[i] + 50_000) // 10
            channels[i] = self.random.choice((highest, highest + 1, 2**31 - 1, -(2**31)))
        self.requests.append((b"T", self.now, channels_of(*channels)))
        self._expect(self.twin.tick(self.now, channels))

    def _talk(self):
        for message in self._messages():
            frame = bytearray(encode_frame(message))
            if self.random.random() < 0.05:
                frame[self.random.randrange(len(frame))] = self.random.randrange(256)
            if self.random.random() < 0.02:
                del frame[self.random.randrange(len(frame))]
            self.line += frame
        cut = len(self.line) - self.random.choice((0, 0, 0, 1, 7))
        piece, self.line = self.line[: max(cut, 0)], self.line[max(cut, 0) :]
        self.requests.append((b"F", self.now, piece))
        self._expect(self.twin.feed(piece, self.now))

    def _messages(self):
        dice, seq = self.random, self.random.randrange(65_536)
        fitting = {
            ManifoldState.BOOT: ("limits",),
            ManifoldState.FAULT: ("limits",),
            ManifoldState.READY: ("arm", "arm", "arm", "upload", "piece"),
            ManifoldState.ARMED: ("follow", "follow", "follow", "upload", "piece", "play", "beat"),
            ManifoldState.PLAYING: ("beat",),
        }[self.twin.state]
        anything = (
            *("limits", "arm", "follow", "upload", "play", "beat", "stop", "hello"),
            *("wild", "begin", "piece", "foreign"),
        )
        move = dice.choice(fitting if dice.random() < 0.8 else anything)
        match move:
            case "limits":
                self.limits = tuple(dice.choice((0, hard // 2, hard)) for hard in HARD)
                if dice.random() < 0.15:
                    return [SetLimits(seq, self._pressures(HARD, wild=True))]
                return [SetLimits(seq, self.limits)]
            case "arm":
                return [Arm(seq)]
            case "follow":
                return [SetPressures(seq, self._pressures(self.limits))]
            case "wild":
                return [SetPressures(seq, self._pressures(self.limits, wild=True))]
            case "upload":
                return self._upload(seq)
            case "begin":
                return [WaveBegin(seq, dice.choice((0, 1, 2, 12, 13)), dice.choice((499, 500)))]
            case "piece":
                wild = self._pressures(self.limits, wild=dice.random() < 0.5)
                piece = WavePiece(seq, dice.randrange(LONGEST), wild * dice.randint(1, 8))
                return [piece] if dice.random() < 0.2 else [WaveBegin(seq, LONGEST, 500), piece]
            case "play":
                return [WavePlay(seq, dice.choice((0, 1, 2, 2**32 - 1)))]
            case "beat":
                return [Heartbeat(seq)]
            case "stop":
                return [Stop(seq)]
            case "hello":
                return [Hello(dice.choice((0, 1, 2)))]
            case "foreign":
                return [Ack(seq, 3, 0, 0), Event(seq, 1, 0)]
        raise AssertionError(move)

    def _pressures(self, limits, wild=False):
        found = [self.random.randint(0, limit) for limit in limits]
        if wild:
            i = self.random.randrange(4)
            found[i] = self.random.choice((-1, limits[i], limits[i] + 1, 2**31 - 1, -(2**31)))
        return tuple(found)

    def _upload(self, seq):
        samples = self.random.randint(2, LONGEST)
        pieces, first = [], 0
        while first < samples:
            many = min(self.random.randint(1, 8), samples - first)
            flat = sum((self._pressures(self.limits) for _ in range(many)), ())
            pieces.append(WavePiece(seq, first, flat))
            first += many
        self.random.shuffle(pieces)
        period = self.random.choice((500, 2000, 9999, 1_000_000))
        whole = [WaveBegin(seq, samples, period), *pieces]
        if self.random.random() < 0.1:
            whole.pop()
        return [*whole, WavePlay(seq, self.random.randint(0, 3))]


def count_codes(replies):
    """Returns the number of occurrences of each (kind of message, code) in the replies."""
    count = Counter()
    for message in FrameDecoder().feed(b"".join(reply.sent for reply in replies)):
        match message:
            case Reading():
                count["state", ManifoldState(message.state)] += 1
            case Event():
                count["event", Cause(message.cause)] += 1
            case Ack():
                count[message.kind, Answer(message.answer)] += 1
            case Ident():
                count["ident"] += 1
    return count


def all_codes():
    """Returns all (kind of message, code) that the dialogues must contain."""
    done, state = Answer.DONE, Answer.WRONG_STATE
    refused, place = (Answer.ABOVE_LIMIT, Answer.BELOW_ZERO), Answer.WRONG_PLACE
    answers = {
        SetLimits: (done, *refused),
        Arm: (done, state),
        SetPressures: (state, *refused),
        Stop: (done,),
        WaveBegin: (done, state, place),
        WavePiece: (done, state, place, *refused),
        WavePlay: (done, state, place),
    }
    met = {(type_byte(kind), answer) for kind, some in answers.items() for answer in some}
    return met | {("state", s) for s in ManifoldState} | {("event", c) for c in Cause} | {"ident"}
