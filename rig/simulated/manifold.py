"""Simulates the state machine of the firmware in `rig/firmware`, in virtual time."""

from collections.abc import Sequence

from rig.chambers import SLIDER
from rig.protocol import messages as wire

HARD_LIMIT = 500_000
"""Hard limit of a chamber: gauge pressure [Pa] that no command can exceed."""
Pressures = tuple[int, ...]


class ManifoldCore:
    """The state machine of docs/reference/rig_protocol.md. Times are device times [us].

    The manifold has one chamber for each of the `hard_limits` [Pa].
    """

    def __init__(
        self,
        hard_limits: Pressures = (HARD_LIMIT,) * len(SLIDER.names),
        version: tuple[int, int, int] = (1, 1, 0),
        longest: int = 2000,
        rate: int = 500,
        protocol: int = wire.PROTOCOL,
    ):
        self.state = wire.ManifoldState.BOOT
        self._ident = wire.Ident(protocol, *version, longest, rate, hard_limits)
        self._hard, self._longest, self._period = hard_limits, longest, 1_000_000 // rate
        self._decoder, self._foreign = wire.FrameDecoder(), 0
        self._zero: Pressures = (0,) * len(hard_limits)
        self._limits = self._set = self._zero
        self._command = self._readings = self._last_command = self._changes = 0
        self._due: int | None = None
        self._wave: list[Pressures | None] = []
        self._wave_period = self._wave_start = self._repeats = 0

    @property
    def chambers(self) -> int:
        """Number of the chambers."""
        return len(self._hard)

    @property
    def set_pressures(self) -> Pressures | None:
        """Set pressures (chambers,) [Pa] that the valves follow; None while all chambers vent."""
        return (
            self._set
            if self.state in (wire.ManifoldState.ARMED, wire.ManifoldState.PLAYING)
            else None
        )

    @property
    def damaged(self) -> int:
        """Number of received frames that are not a valid command."""
        return self._decoder.damaged + self._foreign

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Takes bytes from the host and returns the answer."""
        replies = self._watch(now_us)
        for message in self._decoder.feed(piece):
            if self._is_command(message):
                self._last_command = now_us
                replies += self._obey(message, now_us)
            else:
                self._foreign += 1
        return b"".join(map(wire.encode_frame, replies))

    def _is_command(self, message: wire.Message) -> bool:
        """Returns whether the host may send a message of this type and length."""
        match message:
            case wire.SetLimits():
                return len(message.limits) == self.chambers
            case wire.SetPressures():
                return len(message.pressures) == self.chambers
            case wire.WavePiece():
                samples, rest = divmod(len(message.pressures), self.chambers)
                return not rest and samples <= wire.MAX_SAMPLES_PER_PIECE
        return wire.type_byte(type(message)) < 0x80

    def delay_last_command(self, now_us: int, fed_us: int) -> None:
        """Sets the time of the last valid command to `now_us` if the command came at `fed_us`."""
        if self._last_command == fed_us:
            self._last_command = now_us

    def tick(self, now_us: int, channels: Sequence[int]) -> bytes:
        """Runs the main loop once with a reading's channels, and returns the bytes sent."""
        sent: list[wire.Message] = []
        if self._due is None:
            self._due = now_us + self._period
            sent.append(wire.Event(now_us, wire.Cause.RESET, 0))
        sent += self._watch(now_us) + self._play(now_us)
        if self.set_pressures is not None:
            for chamber, limit in enumerate(self._limits):
                if 10 * channels[chamber] > 11 * limit + 50_000:
                    sent.append(self._fault(now_us, wire.Cause.OVER_PRESSURE, chamber))
                    break
        while self._due <= now_us:
            sent.append(
                wire.Reading(self._readings, self._due, self.state, self._command, tuple(channels))
            )
            self._readings = (self._readings + 1) % 2**32
            self._due += self._period
        return b"".join(map(wire.encode_frame, sent))

    def _watch(self, now_us: int) -> list[wire.Message]:
        silence = now_us - self._last_command
        if self.set_pressures is None or silence < wire.WATCHDOG * 1e6:
            return []
        return [self._fault(now_us, wire.Cause.WATCHDOG, silence // 1000)]

    def _fault(self, now_us: int, cause: wire.Cause, detail: int) -> wire.Event:
        self.state = wire.ManifoldState.FAULT
        return wire.Event(now_us, cause, detail)

    def _play(self, now_us: int) -> list[wire.Message]:
        if self.state != wire.ManifoldState.PLAYING:
            return []
        sample = (now_us - self._wave_start) // self._wave_period
        ended = self._repeats and sample >= self._repeats * len(self._wave)
        now = self._wave[-1 if ended else sample % len(self._wave)]
        assert now is not None
        changes = self._change(now, now_us)
        if not ended:
            return changes
        self.state = wire.ManifoldState.ARMED
        return [*changes, wire.Event(now_us, wire.Cause.PLAYED, 0)]

    def _change(self, pressures: Pressures, now_us: int) -> list[wire.Message]:
        changed, self._set = pressures != self._set, pressures
        return [self._follows(now_us)] if changed else []

    def _follows(self, now_us: int) -> wire.Follows:
        message = wire.Follows(self._changes, now_us, self._set)
        self._changes = (self._changes + 1) % 2**16
        return message

    def _obey(self, message: wire.Message, now_us: int) -> list[wire.Message]:
        match message:
            case wire.Hello():
                return [self._ident]
            case wire.Heartbeat():
                return []
            case wire.Stop():
                if self.set_pressures is not None:
                    self.state = wire.ManifoldState.READY
                return [self._ack(message), wire.Event(now_us, wire.Cause.STOPPED, 0)]
            case wire.SetLimits():
                return self._limit(message, now_us)
            case wire.SetPressures():
                return self._follow(message, now_us)
            case wire.Arm():
                if self.state != wire.ManifoldState.READY:
                    return [self._ack(message, wire.Answer.WRONG_STATE)]
                self.state, self._set = wire.ManifoldState.ARMED, self._zero
                return [self._ack(message), self._follows(now_us)]
            case wire.WaveBegin() | wire.WavePiece() if self.state not in (
                wire.ManifoldState.READY,
                wire.ManifoldState.ARMED,
            ):
                return [self._ack(message, wire.Answer.WRONG_STATE)]
            case wire.WaveBegin():
                return [self._ack(message, *self._begin(message))]
            case wire.WavePiece():
                return [self._ack(message, *self._take(message))]
            case wire.WavePlay():
                if self.state != wire.ManifoldState.ARMED:
                    return [self._ack(message, wire.Answer.WRONG_STATE)]
                if not self._wave or None in self._wave:
                    return [self._ack(message, wire.Answer.WRONG_PLACE)]
                self.state, self._wave_start = wire.ManifoldState.PLAYING, now_us
                self._repeats = message.repeats
                return [self._ack(message), *self._play(now_us)]
        raise AssertionError(message)

    def _limit(self, message: wire.SetLimits, now_us: int) -> list[wire.Message]:
        wrong = _outside(message.limits, self._hard)
        if wrong is None:
            self.state, self._limits, self._wave = wire.ManifoldState.READY, message.limits, []
            return [self._ack(message)]
        refused: list[wire.Message] = [self._ack(message, *wrong)]
        if self.state in (wire.ManifoldState.BOOT, wire.ManifoldState.FAULT):
            return refused
        return [*refused, self._fault(now_us, wire.Cause.REFUSED, wrong[1])]

    def _follow(self, message: wire.SetPressures, now_us: int) -> list[wire.Message]:
        if self.state != wire.ManifoldState.ARMED:
            return [self._ack(message, wire.Answer.WRONG_STATE)]
        wrong = _outside(message.pressures, self._limits)
        if wrong is None:
            self._command = message.seq
            return self._change(message.pressures, now_us)
        return [self._ack(message, *wrong), self._fault(now_us, wire.Cause.REFUSED, wrong[1])]

    def _begin(self, message: wire.WaveBegin) -> tuple[wire.Answer, int]:
        if not 2 <= message.samples <= self._longest or not 500 <= message.period_us <= 1_000_000:
            return wire.Answer.WRONG_PLACE, 0
        self._wave, self._wave_period = [None] * message.samples, message.period_us
        return wire.Answer.DONE, 0

    def _take(self, message: wire.WavePiece) -> tuple[wire.Answer, int]:
        flat, n = message.pressures, self.chambers
        samples = [flat[i : i + n] for i in range(0, len(flat), n)]
        if message.first + len(samples) > len(self._wave):
            return wire.Answer.WRONG_PLACE, 0
        for sample in samples:
            wrong = _outside(sample, self._limits)
            if wrong is not None:
                self._wave = []
                return wrong
        self._wave[message.first : message.first + len(samples)] = samples
        return wire.Answer.DONE, 0

    @staticmethod
    def _ack(
        message: wire.Message, answer: wire.Answer = wire.Answer.DONE, detail: int = 0
    ) -> wire.Ack:
        return wire.Ack(message[0], wire.type_byte(type(message)), answer, detail)


def _outside(pressures: Pressures, limits: Pressures) -> tuple[wire.Answer, int] | None:
    """Returns the reason for a refusal and the first wrong chamber; None if nothing is wrong."""
    for chamber, (pressure, limit) in enumerate(zip(pressures, limits, strict=True)):
        if pressure < 0:
            return wire.Answer.BELOW_ZERO, chamber
        if pressure > limit:
            return wire.Answer.ABOVE_LIMIT, chamber
    return None
