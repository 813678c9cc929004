"""The manifold over its line: commands out, readings in, and a stop on every way out."""

import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType

import serial

from rig.errors import RigError
from rig.manifold.connection import VENTS, Connection, Sink
from rig.manifold.limits import PressureLimits, checked_pressures
from rig.manifold.serial_port import PortLost
from rig.protocol.messages import (
    CHAMBERS,
    MAX_SAMPLES_PER_PIECE,
    PROTOCOL,
    Ack,
    Answer,
    Arm,
    Cause,
    Event,
    Follows,
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
)

PATIENCE, TRIES = 0.08, 8
"""For an answer [s], shorter than the watchdog's; then a command is sent once more."""
SILENCE = 0.5
"""Without a reading while armed [s]: who does not see what it drives has to stop."""
_WHY = {
    Cause.RESET: "it has reset (power, or its hardware watchdog)",
    Cause.WATCHDOG: "it heard no command for {detail} ms",
    Cause.OVER_PRESSURE: "{chamber} reads more than its limit and a tenth",
    Cause.REFUSED: "it was asked for a pressure outside the limit of {chamber}",
}


class Manifold:
    """A context: at its end, however that comes, the manifold is told to vent.

    `sink` gets (host time [ns], bytes) of all that comes in, `sent` of all that goes out,
    `on_reading` (host time, `Reading`), `on_follows` what the valves follow. They are called by the
    reader's thread, in the order of the line, `sent` by that of the command.
    """

    def __init__(
        self,
        port: serial.Serial,
        sink: Sink | None = None,
        sent: Sink | None = None,
        on_reading: Callable[[int, Reading], None] | None = None,
        on_follows: Callable[[Follows], None] | None = None,
    ):
        self.ident: Ident | None = None
        self.latest: Reading | None = None
        self.lost = self.duplicated = 0
        """Readings that their sequence numbers miss, or have twice."""
        self.limits = PressureLimits(0.0, 0.0, 0.0, 0.0)
        self._line = Connection(port, self._take, self._tell_news, sink, sent)
        self._on_reading, self._on_follows = on_reading, on_follows
        self._news, self._writing, self._seq = threading.Condition(), threading.Lock(), 0
        self._acks: dict[int, Ack] = {}
        self._own_vent: RigError | None = None
        self._armed, self._heard = False, 0.0

    @property
    def damaged(self) -> int:
        """Frames that came in damaged, and were dropped."""
        return self._line.damaged

    def __enter__(self) -> "Manifold":
        self._line.start()
        try:
            self.ident = self._hello()
        except BaseException:
            self._line.close()
            raise
        if self.ident.protocol != PROTOCOL:
            self._line.close()
            version = ".".join(map(str, self.ident[1:4]))
            raise RigError(
                f"{self._line.name}: firmware {version} speaks protocol {self.ident.protocol}; "
                f"this program speaks {PROTOCOL}: flash the firmware in rig/firmware, or install "
                "the program that goes with it"
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.stop_after(error)
        except RigError as failure:
            self._blame_line(failure)
            raise
        finally:
            self._line.close()
        if isinstance(error, RigError):
            self._blame_line(error)

    def _blame_line(self, error: RigError) -> None:
        if self._line.is_bad:
            error.add_note(
                f"until then {self.damaged} frames came damaged and {self.lost} readings were "
                "lost: see to the line, its cable and plugs"
            )

    def stop_after(self, error: BaseException | None) -> None:
        """Stops; what goes wrong with that is noted on the `error` that led here, if any."""
        try:
            self.stop()
        except RigError as failure:
            if error is None:
                raise
            note = f"and the stop was not confirmed: {failure}"
            if str(failure) != str(error) and note not in getattr(error, "__notes__", ()):
                error.add_note(note)

    def check(self) -> None:
        """Raises what has happened: a lost port, a vent of the manifold's own, no readings."""
        failure = self._line.failure or self._own_vent
        if failure is not None:
            raise failure
        silent = time.monotonic() - self._heard
        if self._armed and silent > SILENCE:
            raise RigError(
                f"{self._line.name}: no reading for {silent:.1f} s; check its line to the computer"
            )

    def configure(self, limits: PressureLimits) -> None:
        """Sets the limits, which vents, and clears a fault."""
        assert self.ident is not None
        self.limits = limits.within(self.ident)
        # What was there before, such as a reset, is done with.
        self._own_vent = None
        self._armed = False
        self._ask(lambda seq: SetLimits(seq, *(int(p) for p in limits)))

    def arm(self) -> None:
        """From now on set pressures are followed, and the watchdog watches."""
        self._ask(Arm)
        self._armed, self._heard = True, time.monotonic()

    def set(self, pressures: Sequence[float]) -> int:
        """Set gauge pressures (4,) [Pa]; returns the command's number. Raises `RigError`."""
        self.check()
        values = checked_pressures(pressures, self.limits)
        return self._tell(lambda seq: SetPressures(seq, *values))

    def heartbeat(self) -> None:
        """Says that the host is alive."""
        self.check()
        self._tell(Heartbeat)

    def stop(self) -> None:
        """Vents all chambers, and waits until the manifold says so. Raises `RigError` if not."""
        self._armed = False
        self._ask(Stop)

    def upload(self, samples: Sequence[Sequence[float]], period: float) -> None:
        """A waveform (n, 4) of set pressures [Pa], `period` [s] apart."""
        assert self.ident is not None
        if not 2 <= len(samples) <= self.ident.samples:
            allowed = f"2 to {self.ident.samples}, which the manifold holds"
            raise RigError.value("waveform", f"{len(samples)} samples", allowed)
        if not 500e-6 <= period <= 1.0:
            raise RigError.value("waveform's period", f"{period:g} s", "0.0005 to 1 s")
        values = [checked_pressures(sample, self.limits) for sample in samples]
        self._ask(lambda seq: WaveBegin(seq, len(values), round(period * 1e6)))
        for first in range(0, len(values), MAX_SAMPLES_PER_PIECE):
            flat = tuple(p for row in values[first : first + MAX_SAMPLES_PER_PIECE] for p in row)
            self._ask(partial(_piece, first, flat))

    def play(self, repeats: int = 1) -> None:
        """Starts the waveform; 0 repeats it until the stop. Heartbeats have to keep it alive."""
        self._ask(lambda seq: WavePlay(seq, repeats))

    def _number(self) -> int:
        self._seq = (self._seq + 1) % 2**16
        return self._seq

    def _tell(self, make: Callable[[int], Message]) -> int:
        with self._writing:
            seq = self._number()
            self._line.write(make(seq))
        return seq

    def _tell_news(self) -> None:
        with self._news:
            self._news.notify_all()

    @property
    def _is_gone(self) -> bool:
        return isinstance(self._line.failure, PortLost)

    def _ask(self, make: Callable[[int], Message]) -> None:
        """A command whose answer is waited for, and which may be repeated."""
        for tried in range(TRIES):
            if self._is_gone:
                self.check()
            seq = self._tell(make)
            ack = self._answer(seq)
            if ack is not None:
                # The one before was obeyed, and its answer lost.
                obeyed = tried and make is Arm and ack.answer == Answer.WRONG_STATE
                if not (obeyed and self.latest and self.latest.state == ManifoldState.ARMED):
                    self._judge(make(seq), ack)
                return
        self.check()
        name = type(make(0)).__name__
        raise RigError(f"{self._line.name}: no answer to {name}, asked {TRIES} times; {VENTS}")

    def _answer(self, seq: int) -> Ack | None:
        with self._news:
            self._news.wait_for(lambda: seq in self._acks or self._is_gone, PATIENCE)
            return self._acks.pop(seq, None)

    def _judge(self, message: Message, ack: Ack) -> None:
        if ack.answer == Answer.DONE:
            return
        self.check()
        names = {answer.value: answer.name for answer in Answer}
        answer = names.get(ack.answer, f"answer {ack.answer}")
        raise RigError(
            f"{self._line.name}: {type(message).__name__} was refused: {answer}, {ack.detail}"
        )

    def _hello(self) -> Ident:
        for _ in range(3 * TRIES):
            with self._writing:
                self._line.write(Hello(PROTOCOL))
            with self._news:
                self._news.wait_for(lambda: self.ident or self._is_gone, PATIENCE)
            if self._is_gone:
                self.check()
            if self.ident is not None:
                return self.ident
        heard = f"{self.damaged} damaged frames" if self.damaged else "nothing"
        raise RigError(
            f"{self._line.name}: no manifold answers, {heard} came; is it switched on, does it run "
            "the firmware in rig/firmware? The published firmware needs `slider rig log`"
        )

    def _take(self, now: int, message: Message) -> None:
        match message:
            case Reading() if self.ident is not None:
                self._heard = time.monotonic()
                self._count(message)
                if self._armed and message.state not in (
                    ManifoldState.ARMED,
                    ManifoldState.PLAYING,
                ):
                    self._vented("its readings say so; why was lost on the line")
                if self._on_reading is not None:
                    self._on_reading(now, message)
            case Follows() if self.ident is not None and self._on_follows is not None:
                self._on_follows(message)
            case Ack():
                with self._news:
                    self._acks[message.seq] = message
                    while len(self._acks) > 64:
                        self._acks.pop(next(iter(self._acks)))
                    self._news.notify_all()
            case Ident():
                if self.ident is None:
                    # What was left in buffers from before tells nothing of this line.
                    self.latest, self.lost, self.duplicated = None, 0, 0
                    self._line.forget()
                with self._news:
                    self.ident = message
                    self._news.notify_all()
            case Event() if message.cause in _WHY:
                place = CHAMBERS[message.detail] if 0 <= message.detail < 4 else "a chamber"
                self._vented(
                    _WHY[Cause(message.cause)].format(detail=message.detail, chamber=place)
                )

    def _vented(self, why: str) -> None:
        if self._own_vent is None:
            self._own_vent = RigError(f"{self._line.name}: the manifold vented: {why}")

    def _count(self, reading: Reading) -> None:
        if self.latest is not None:
            ahead = (reading.seq - self.latest.seq) % 2**32
            if ahead == 0:
                self.duplicated += 1
                return
            # A reset starts over from 0.
            self.lost += ahead - 1 if ahead < 2**31 else 0
        self.latest = reading


def _piece(first: int, pressures: tuple[int, ...], seq: int) -> WavePiece:
    return WavePiece(seq, first, pressures)
