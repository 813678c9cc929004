"""State machine of a manifold in virtual time, equivalent to that in `rig/firmware`."""

from collections.abc import Sequence

from rig.protocol.messages import (
    PROTOCOL,
    WATCHDOG,
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
    ManifoldState,
    Message,
    Reading,
    SetLimits,
    SetPressures,
    Stop,
    WaveBegin,
    WavePiece,
    WavePlay,
    encode_frame,
    type_byte,
)

HARD_LIMITS = (500_000, 500_000, 500_000, 500_000)
"""Hard limits: gauge pressures [Pa] that no command can exceed."""
FROM_HOST = (
    Hello, SetLimits, Arm, SetPressures, Heartbeat, Stop, WaveBegin, WavePiece, WavePlay
)  # fmt: skip
Pressures = tuple[int, ...]


class ManifoldCore:
    """The state machine of docs/reference/rig_protocol.md. Times are the device's microseconds."""

    def __init__(
        self,
        hard_limits: Pressures = HARD_LIMITS,
        version: tuple[int, int, int] = (1, 1, 0),
        longest: int = 2000,
        rate: int = 500,
        protocol: int = PROTOCOL,
    ):
        self.state = ManifoldState.BOOT
        self._ident = Ident(protocol, *version, longest, rate, *hard_limits)
        self._hard, self._longest, self._period = hard_limits, longest, 1_000_000 // rate
        self._decoder, self._foreign = FrameDecoder(), 0
        self._limits: Pressures = (0, 0, 0, 0)
        self._set: Pressures = (0, 0, 0, 0)
        self._command = self._readings = self._last_command = self._changes = 0
        self._due: int | None = None
        self._wave: list[Pressures | None] = []
        self._wave_period = self._wave_start = self._repeats = 0

    @property
    def set_pressures(self) -> Pressures | None:
        """Set pressures (4,) [Pa] that the valves follow; None while all vent."""
        return self._set if self.state in (ManifoldState.ARMED, ManifoldState.PLAYING) else None

    @property
    def damaged(self) -> int:
        """Number of frames that were not a command."""
        return self._decoder.damaged + self._foreign

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Take bytes from the host and return the answer."""
        replies = self._watch(now_us)
        for message in self._decoder.feed(piece):
            if isinstance(message, FROM_HOST):
                self._last_command = now_us
                replies += self._obey(message, now_us)
            else:
                self._foreign += 1
        return b"".join(map(encode_frame, replies))

    def delay_last_command(self, now_us: int, fed_us: int) -> None:
        """Set the time of the last valid command, if fed at `fed_us`, to `now_us`."""
        if self._last_command == fed_us:
            self._last_command = now_us

    def tick(self, now_us: int, channels: Sequence[int]) -> bytes:
        """Make one pass of the main loop with channels (8,); return the bytes sent."""
        sent: list[Message] = []
        if self._due is None:
            self._due = now_us + self._period
            sent.append(Event(now_us, Cause.RESET, 0))
        sent += self._watch(now_us) + self._play(now_us)
        if self.set_pressures is not None:
            for chamber, limit in enumerate(self._limits):
                if 10 * channels[chamber] > 11 * limit + 50_000:
                    sent.append(self._fault(now_us, Cause.OVER_PRESSURE, chamber))
                    break
        while self._due <= now_us:
            sent.append(
                Reading(self._readings, self._due, self.state, self._command, tuple(channels))
            )
            self._readings = (self._readings + 1) % 2**32
            self._due += self._period
        return b"".join(map(encode_frame, sent))

    def _watch(self, now_us: int) -> list[Message]:
        silence = now_us - self._last_command
        if self.set_pressures is None or silence < WATCHDOG * 1e6:
            return []
        return [self._fault(now_us, Cause.WATCHDOG, silence // 1000)]

    def _fault(self, now_us: int, cause: Cause, detail: int) -> Event:
        self.state = ManifoldState.FAULT
        return Event(now_us, cause, detail)

    def _play(self, now_us: int) -> list[Message]:
        if self.state != ManifoldState.PLAYING:
            return []
        sample = (now_us - self._wave_start) // self._wave_period
        ended = self._repeats and sample >= self._repeats * len(self._wave)
        now = self._wave[-1 if ended else sample % len(self._wave)]
        assert now is not None
        changes = self._change(now, now_us)
        if not ended:
            return changes
        self.state = ManifoldState.ARMED
        return [*changes, Event(now_us, Cause.PLAYED, 0)]

    def _change(self, pressures: Pressures, now_us: int) -> list[Message]:
        changed, self._set = pressures != self._set, pressures
        return [self._follows(now_us)] if changed else []

    def _follows(self, now_us: int) -> Follows:
        message = Follows(self._changes, now_us, *self._set)
        self._changes = (self._changes + 1) % 2**16
        return message

    def _obey(self, message: Message, now_us: int) -> list[Message]:
        match message:
            case Hello():
                return [self._ident]
            case Heartbeat():
                return []
            case Stop():
                if self.set_pressures is not None:
                    self.state = ManifoldState.READY
                return [self._ack(message), Event(now_us, Cause.STOPPED, 0)]
            case SetLimits():
                return self._limit(message, now_us)
            case SetPressures():
                return self._follow(message, now_us)
            case Arm():
                if self.state != ManifoldState.READY:
                    return [self._ack(message, Answer.WRONG_STATE)]
                self.state, self._set = ManifoldState.ARMED, (0, 0, 0, 0)
                return [self._ack(message), self._follows(now_us)]
            case WaveBegin() | WavePiece() if self.state not in (
                ManifoldState.READY,
                ManifoldState.ARMED,
            ):
                return [self._ack(message, Answer.WRONG_STATE)]
            case WaveBegin():
                return [self._ack(message, *self._begin(message))]
            case WavePiece():
                return [self._ack(message, *self._take(message))]
            case WavePlay():
                if self.state != ManifoldState.ARMED:
                    return [self._ack(message, Answer.WRONG_STATE)]
                if not self._wave or None in self._wave:
                    return [self._ack(message, Answer.WRONG_PLACE)]
                self.state, self._wave_start = ManifoldState.PLAYING, now_us
                self._repeats = message.repeats
                return [self._ack(message), *self._play(now_us)]
        raise AssertionError(message)

    def _limit(self, message: SetLimits, now_us: int) -> list[Message]:
        wrong = _outside(message[1:], self._hard)
        if wrong is None:
            self.state, self._limits, self._wave = ManifoldState.READY, message[1:], []
            return [self._ack(message)]
        refused: list[Message] = [self._ack(message, *wrong)]
        if self.state in (ManifoldState.BOOT, ManifoldState.FAULT):
            return refused
        return [*refused, self._fault(now_us, Cause.REFUSED, wrong[1])]

    def _follow(self, message: SetPressures, now_us: int) -> list[Message]:
        if self.state != ManifoldState.ARMED:
            return [self._ack(message, Answer.WRONG_STATE)]
        wrong = _outside(message[1:], self._limits)
        if wrong is None:
            self._command = message.seq
            return self._change(message[1:], now_us)
        return [self._ack(message, *wrong), self._fault(now_us, Cause.REFUSED, wrong[1])]

    def _begin(self, message: WaveBegin) -> tuple[Answer, int]:
        if not 2 <= message.samples <= self._longest or not 500 <= message.period_us <= 1_000_000:
            return Answer.WRONG_PLACE, 0
        self._wave, self._wave_period = [None] * message.samples, message.period_us
        return Answer.DONE, 0

    def _take(self, message: WavePiece) -> tuple[Answer, int]:
        flat = message.pressures
        samples = [flat[i : i + 4] for i in range(0, len(flat), 4)]
        if message.first + len(samples) > len(self._wave):
            return Answer.WRONG_PLACE, 0
        for sample in samples:
            wrong = _outside(sample, self._limits)
            if wrong is not None:
                self._wave = []
                return wrong
        self._wave[message.first : message.first + len(samples)] = samples
        return Answer.DONE, 0

    @staticmethod
    def _ack(message: Message, answer: Answer = Answer.DONE, detail: int = 0) -> Ack:
        return Ack(message[0], type_byte(type(message)), answer, detail)


def _outside(pressures: Pressures, limits: Pressures) -> tuple[Answer, int] | None:
    """Return why the pressures are refused and the first wrong chamber, or None."""
    for chamber, (pressure, limit) in enumerate(zip(pressures, limits, strict=True)):
        if pressure < 0:
            return Answer.BELOW_ZERO, chamber
        if pressure > limit:
            return Answer.ABOVE_LIMIT, chamber
    return None
