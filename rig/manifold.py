"""The manifold over its line: commands out, readings in, and a stop on every way out."""

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from types import TracebackType

import serial

from rig.clock import host_ns
from rig.errors import RigError
from rig.frames import Decoder, encode
from rig.messages import (
    CHAMBERS,
    PROTOCOL,
    SAMPLES_A_PIECE,
    Ack,
    Answer,
    Arm,
    Cause,
    Event,
    Follows,
    Heartbeat,
    Hello,
    Ident,
    Message,
    Reading,
    SetLimits,
    SetPressures,
    State,
    Stop,
    WaveBegin,
    WavePiece,
    WavePlay,
)
from rig.port import PortLost
from rig.safety import Limits, checked

PATIENCE, TRIES = 0.08, 8
"""For an answer [s], shorter than the watchdog's; then a command is sent once more."""
SILENCE = 0.5
"""Without a reading while armed [s]: who does not see what it drives has to stop."""
Sink = Callable[[int, bytes], None]
VENTS = "the manifold vents by itself 0.1 s after the last command"
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
        self.limits = Limits(0.0, 0.0, 0.0, 0.0)
        self._port, self._sink, self._sent = port, sink, sent
        self._on_reading, self._on_follows = on_reading, on_follows
        self._decoder, self._seq = Decoder(), 0
        self._news, self._writing = threading.Condition(), threading.Lock()
        self._acks: dict[int, Ack] = {}
        self._failure: RigError | None = None
        self._armed, self._heard = False, 0.0
        self._ends = threading.Event()
        self._reader = threading.Thread(target=self._read, name="manifold", daemon=True)

    @property
    def damaged(self) -> int:
        """Frames that came in damaged, and were dropped."""
        return self._decoder.damaged

    def __enter__(self) -> "Manifold":
        self._reader.start()
        try:
            self.ident = self._hello()
        except BaseException:
            self._close()
            raise
        if self.ident.protocol != PROTOCOL:
            self._close()
            version = ".".join(map(str, self.ident[1:4]))
            raise RigError(
                f"{self._port.name}: firmware {version} speaks protocol {self.ident.protocol}; "
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
        finally:
            self._close()
            if isinstance(error, RigError) and self.damaged:
                error.add_note(
                    f"until then {self.damaged} frames came damaged, and {self.lost} readings were "
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
        if self._failure is not None:
            raise self._failure
        silent = time.monotonic() - self._heard
        if self._armed and silent > SILENCE:
            raise RigError(
                f"{self._port.name}: no reading for {silent:.1f} s; check its line to the computer"
            )

    def configure(self, limits: Limits) -> None:
        """Sets the limits, which vents, and clears a fault."""
        assert self.ident is not None
        self.limits = limits.within(self.ident)
        # What was there before, such as a reset, is done with.
        self._failure = self._failure if isinstance(self._failure, PortLost) else None
        self._armed = False
        self._ask(lambda seq: SetLimits(seq, *(int(p) for p in limits)))

    def arm(self) -> None:
        """From now on set pressures are followed, and the watchdog watches."""
        self._ask(Arm)
        self._armed, self._heard = True, time.monotonic()

    def set(self, pressures: Sequence[float]) -> int:
        """Set gauge pressures (4,) [Pa]; returns the command's number. Raises `RigError`."""
        self.check()
        values = checked(pressures, self.limits)
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
        values = [checked(sample, self.limits) for sample in samples]
        self._ask(lambda seq: WaveBegin(seq, len(values), round(period * 1e6)))
        for first in range(0, len(values), SAMPLES_A_PIECE):
            flat = tuple(p for row in values[first : first + SAMPLES_A_PIECE] for p in row)
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
            self._write(encode(make(seq)))
        return seq

    def _write(self, frame: bytes) -> None:
        try:
            self._port.write(frame)
        except (serial.SerialException, OSError) as error:
            raise self._gone(error) from None
        if self._sent is not None:
            self._sent(host_ns(), frame)

    def _gone(self, error: Exception) -> PortLost:
        failure = PortLost(
            f"{self._port.name}: the port is gone ({error}); {VENTS}; check its plug and cable"
        )
        self._failure = failure
        with self._news:
            self._news.notify_all()
        return failure

    def _ask(self, make: Callable[[int], Message]) -> None:
        """A command whose answer is waited for, and which may be repeated."""
        for tried in range(TRIES):
            if isinstance(self._failure, PortLost):
                raise self._failure
            seq = self._tell(make)
            ack = self._answer(seq)
            if ack is not None:
                # The one before was obeyed, and its answer lost.
                obeyed = tried and make is Arm and ack.answer == Answer.WRONG_STATE
                if not (obeyed and self.latest and self.latest.state == State.ARMED):
                    self._judge(make(seq), ack)
                return
        self.check()
        name = type(make(0)).__name__
        raise RigError(f"{self._port.name}: no answer to {name}, asked {TRIES} times; {VENTS}")

    def _answer(self, seq: int) -> Ack | None:
        with self._news:
            self._news.wait_for(
                lambda: seq in self._acks or isinstance(self._failure, PortLost), PATIENCE
            )
            return self._acks.pop(seq, None)

    def _judge(self, message: Message, ack: Ack) -> None:
        if ack.answer == Answer.DONE:
            return
        self.check()
        names = {answer.value: answer.name for answer in Answer}
        answer = names.get(ack.answer, f"answer {ack.answer}")
        raise RigError(
            f"{self._port.name}: {type(message).__name__} was refused: {answer}, {ack.detail}"
        )

    def _hello(self) -> Ident:
        for _ in range(3 * TRIES):
            with self._writing:
                self._write(encode(Hello(PROTOCOL)))
            with self._news:
                self._news.wait_for(
                    lambda: self.ident or isinstance(self._failure, PortLost), PATIENCE
                )
            if isinstance(self._failure, PortLost):
                raise self._failure
            if self.ident is not None:
                return self.ident
        heard = f"{self.damaged} damaged frames" if self.damaged else "nothing"
        raise RigError(
            f"{self._port.name}: no manifold answers, {heard} came; is it switched on, does it run "
            "the firmware in rig/firmware? The published firmware needs `slider rig log`"
        )

    def _read(self) -> None:
        try:
            self._listen()
        except Exception as error:
            self._failure = RigError(f"{self._port.name}: stopped reading: {error!r}")

    def _listen(self) -> None:
        begun = False
        while not self._ends.is_set():
            try:
                piece = self._port.read(max(1, self._port.in_waiting))
            except (serial.SerialException, OSError, TypeError) as error:
                # TypeError: pyserial's, where the port is closed meanwhile.
                if not self._ends.is_set():
                    self._gone(error)
                return
            if not piece:
                continue
            now = host_ns()
            if self._sink is not None:
                self._sink(now, piece)
            if not begun:
                # The port was opened within a frame: what is left of that is no damage.
                _, end, piece = piece.partition(b"\0")
                begun = bool(end)
                if not begun:
                    continue
            for message in self._decoder.feed(piece):
                self._take(now, message)

    def _take(self, now: int, message: Message) -> None:
        match message:
            case Reading() if self.ident is not None:
                self._heard = time.monotonic()
                self._count(message)
                if self._armed and message.state not in (State.ARMED, State.PLAYING):
                    self._vented("its readings say so; why was lost on the line")
                if self._on_reading is not None:
                    self._on_reading(now, message)
            case Follows() if self._on_follows is not None:
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
                    self._decoder.damaged = 0
                with self._news:
                    self.ident = message
                    self._news.notify_all()
            case Event() if message.cause in _WHY:
                place = CHAMBERS[message.detail] if 0 <= message.detail < 4 else "a chamber"
                self._vented(
                    _WHY[Cause(message.cause)].format(detail=message.detail, chamber=place)
                )

    def _vented(self, why: str) -> None:
        if self._failure is None:
            self._failure = RigError(f"{self._port.name}: the manifold vented: {why}")

    def _count(self, reading: Reading) -> None:
        if self.latest is not None:
            ahead = (reading.seq - self.latest.seq) % 2**32
            if ahead == 0:
                self.duplicated += 1
                return
            # A reset starts over from 0.
            self.lost += ahead - 1 if ahead < 2**31 else 0
        self.latest = reading

    def _close(self) -> None:
        self._ends.set()
        self._reader.join(0.5)
        # A real port may wait long for bytes that nobody takes. One that is gone: termios.error.
        with suppress(Exception):
            self._port.reset_output_buffer()
        self._port.close()


def _piece(first: int, pressures: tuple[int, ...], seq: int) -> WavePiece:
    return WavePiece(seq, first, pressures)
