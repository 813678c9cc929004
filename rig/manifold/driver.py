"""Drives the manifold: sends commands, receives readings, and vents all chambers at the end."""

import threading
import time
from collections.abc import Callable, Sequence
from functools import partial

import serial

from rig.errors import RigError
from rig.manifold.connection import VENTS, Connection
from rig.manifold.limits import PressureLimits
from rig.manifold.serial_port import PortLost
from rig.protocol import messages as wire
from rig.recording.clock import Sink

ANSWER_WAIT, TRIES = 0.08, 8
"""Longest wait for an answer [s], below the watchdog's 0.1 s; largest number of attempts."""
MAX_SILENCE = 0.5
"""If an armed manifold sends no reading for this time [s], the host stops the drive."""
_VENT_REASONS = {
    wire.Cause.RESET: "it has reset (power, or its hardware watchdog)",
    wire.Cause.WATCHDOG: "it received no command for {detail} ms",
    wire.Cause.OVER_PRESSURE: "the pressure of {chamber} exceeds its limit by more than a tenth",
    wire.Cause.REFUSED: "a set pressure was outside the limit of {chamber}",
}


class Manifold:
    """Context manager of a manifold, which vents all chambers at the end, also after an error.

    The receiving thread calls `sink(host time [ns], bytes)` for the bytes of each read. It also
    calls `on_reading(host time [ns], Reading)` and `on_follows(Follows)`, in the order of arrival.
    The thread that sends a frame calls `sent(host time [ns], bytes)`.
    """

    def __init__(
        self,
        port: serial.Serial,
        sink: Sink | None = None,
        sent: Sink | None = None,
        on_reading: Callable[[int, wire.Reading], None] | None = None,
        on_follows: Callable[[wire.Follows], None] | None = None,
    ):
        self.ident: wire.Ident | None = None
        self.latest: wire.Reading | None = None
        self.lost = self.duplicated = 0
        """Numbers of missing readings and of repeated readings, from the sequence numbers."""
        self.limits = PressureLimits((), ())
        self._line = Connection(port, self._take, self._notify, sink, sent)
        self._on_reading, self._on_follows = on_reading, on_follows
        self._changed, self._writing, self._seq = threading.Condition(), threading.Lock(), 0
        self._acks: dict[int, wire.Ack] = {}
        self._own_vent: RigError | None = None
        self._armed, self._last_reading = False, 0.0

    @property
    def damaged(self) -> int:
        """Number of damaged frames, which are dropped."""
        return self._line.damaged

    def __enter__(self) -> "Manifold":
        self._line.start()
        try:
            self.ident = self._hello()
        except BaseException:
            self._line.close()
            raise
        if self.ident.protocol != wire.PROTOCOL:
            self._line.close()
            version = ".".join(map(str, self.ident[1:4]))
            raise RigError(
                f"{self._line.name}: firmware {version} uses protocol {self.ident.protocol}, this "
                f"program uses {wire.PROTOCOL}; flash the firmware in rig/firmware, or install a "
                "program version with this protocol"
            )
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
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
                f"before the error, {self.damaged} frames arrived damaged and {self.lost} readings "
                "were lost; check the cable and the plugs"
            )

    def stop_after(self, error: BaseException | None) -> None:
        """Vents all chambers. If this fails, adds a note to `error`, or raises if it is None."""
        try:
            self.stop()
        except RigError as failure:
            if error is None:
                raise
            note = f"the manifold did not confirm the stop: {failure}"
            if str(failure) != str(error) and note not in getattr(error, "__notes__", ()):
                error.add_note(note)

    def check(self) -> None:
        """Raises `RigError` if the port is lost, the manifold has vented, or no readings arrive."""
        failure = self._line.failure or self._own_vent
        if failure is not None:
            raise failure
        silent = time.monotonic() - self._last_reading
        if self._armed and silent > MAX_SILENCE:
            raise RigError(
                f"{self._line.name}: no reading for {silent:.1f} s; check the cable to the computer"
            )

    def configure(self, limits: PressureLimits) -> None:
        """Sends the limits. The manifold then vents and changes to the state READY.

        Raises `RigError` if the manifold has another number of chambers.
        """
        assert self.ident is not None
        self.limits = limits.within(self.ident)
        # The new limits clear an earlier fault, such as a reset.
        self._own_vent = None
        self._armed = False
        self._request(lambda seq: wire.SetLimits(seq, tuple(int(p) for p in limits.pressures)))

    def arm(self) -> None:
        """Arms the manifold: the valves follow set pressures, and the watchdog is active."""
        self._request(wire.Arm)
        self._armed, self._last_reading = True, time.monotonic()

    def set(self, pressures: Sequence[float]) -> int:
        """Sends gauge pressures (chambers,) [Pa] and returns the command's number.

        Raises `RigError` for a pressure outside its limits, and the errors of `check`.
        """
        self.check()
        values = self.limits.checked(pressures)
        return self._send(lambda seq: wire.SetPressures(seq, values))

    def heartbeat(self) -> None:
        """Sends a heartbeat, which keeps the watchdog from venting."""
        self.check()
        self._send(wire.Heartbeat)

    def stop(self) -> None:
        """Vents all chambers. Raises `RigError` if the manifold does not confirm the command."""
        self._armed = False
        self._request(wire.Stop)

    def upload(self, samples: Sequence[Sequence[float]], period: float) -> None:
        """Sends a waveform of set pressures (n, chambers) [Pa] at intervals of `period` [s]."""
        assert self.ident is not None
        if not 2 <= len(samples) <= self.ident.samples:
            allowed = f"2 to {self.ident.samples}, the manifold's memory"
            raise RigError.value("waveform", f"{len(samples)} samples", allowed)
        if not 500e-6 <= period <= 1.0:
            raise RigError.value("waveform's period", f"{period:g} s", "0.0005 to 1 s")
        values = [self.limits.checked(sample) for sample in samples]
        self._request(lambda seq: wire.WaveBegin(seq, len(values), round(period * 1e6)))
        count = wire.samples_per_piece(len(self.limits.chambers))
        for first in range(0, len(values), count):
            flat = tuple(p for row in values[first : first + count] for p in row)
            self._request(partial(_wave_piece, first, flat))

    def play(self, repeats: int = 1) -> None:
        """Plays the waveform `repeats` times (0: until `stop`). The caller sends heartbeats."""
        self._request(lambda seq: wire.WavePlay(seq, repeats))

    def _send(self, make: Callable[[int], wire.Message]) -> int:
        with self._writing:
            seq = self._seq = (self._seq + 1) % 2**16
            self._line.write(make(seq))
        return seq

    def _notify(self) -> None:
        with self._changed:
            self._changed.notify_all()

    @property
    def _is_gone(self) -> bool:
        return isinstance(self._line.failure, PortLost)

    def _request(self, make: Callable[[int], wire.Message]) -> None:
        """Sends a command, and sends it again if no answer arrives."""
        for tried in range(TRIES):
            if self._is_gone:
                self.check()
            seq = self._send(make)
            ack = self._wait_for_ack(seq)
            if ack is not None:
                # If the answer to an accepted `Arm` was lost, the manifold refuses the next `Arm`.
                obeyed = tried and make is wire.Arm and ack.answer == wire.Answer.WRONG_STATE
                if not (obeyed and self.latest and self.latest.state == wire.ManifoldState.ARMED):
                    self._raise_refusal(make(seq), ack)
                return
        self.check()
        name = type(make(0)).__name__
        raise RigError(f"{self._line.name}: {name} was sent {TRIES} times without answer; {VENTS}")

    def _wait_for_ack(self, seq: int) -> wire.Ack | None:
        with self._changed:
            self._changed.wait_for(lambda: seq in self._acks or self._is_gone, ANSWER_WAIT)
            return self._acks.pop(seq, None)

    def _raise_refusal(self, message: wire.Message, ack: wire.Ack) -> None:
        if ack.answer == wire.Answer.DONE:
            return
        self.check()
        names = {answer.value: answer.name for answer in wire.Answer}
        answer = names.get(ack.answer, f"answer {ack.answer}")
        raise RigError(
            f"{self._line.name}: {type(message).__name__} was refused: {answer}, {ack.detail}"
        )

    def _hello(self) -> wire.Ident:
        for _ in range(3 * TRIES):
            with self._writing:
                self._line.write(wire.Hello(wire.PROTOCOL))
            with self._changed:
                self._changed.wait_for(lambda: self.ident or self._is_gone, ANSWER_WAIT)
            if self._is_gone:
                self.check()
            if self.ident is not None:
                return self.ident
        received = f"{self.damaged} damaged frames" if self.damaged else "nothing"
        raise RigError(
            f"{self._line.name}: no manifold answers, {received} arrived; check that the manifold "
            "is on and runs the firmware in rig/firmware; the published firmware needs "
            "`slider rig log`"
        )

    def _take(self, now: int, message: wire.Message) -> None:
        match message:
            case wire.Reading() if self.ident is not None:
                self._last_reading = time.monotonic()
                self._count(message)
                if self._armed and message.state not in (
                    wire.ManifoldState.ARMED,
                    wire.ManifoldState.PLAYING,
                ):
                    self._set_own_vent("its readings show this; the cause was not received")
                if self._on_reading is not None:
                    self._on_reading(now, message)
            case wire.Follows() if self.ident is not None and self._on_follows is not None:
                self._on_follows(message)
            case wire.Ack():
                with self._changed:
                    self._acks[message.seq] = message
                    while len(self._acks) > 64:
                        self._acks.pop(next(iter(self._acks)))
                    self._changed.notify_all()
            case wire.Ident():
                if self.ident is None:
                    # Messages before the first Ident are old: they were waiting in buffers.
                    self.latest, self.lost, self.duplicated = None, 0, 0
                    self._line.reset_counts()
                with self._changed:
                    self.ident = message
                    self._changed.notify_all()
            case wire.Event() if message.cause in _VENT_REASONS:
                known = dict(enumerate(self.limits.chambers))
                chamber = known.get(message.detail, "a chamber")
                self._set_own_vent(
                    _VENT_REASONS[wire.Cause(message.cause)].format(
                        detail=message.detail, chamber=chamber
                    )
                )

    def _set_own_vent(self, why: str) -> None:
        if self._own_vent is None:
            self._own_vent = RigError(f"{self._line.name}: the manifold vented: {why}")

    def _count(self, reading: wire.Reading) -> None:
        if self.latest is not None:
            ahead = (reading.seq - self.latest.seq) % 2**32
            if ahead == 0:
                self.duplicated += 1
                return
            # After a reset of the manifold, the sequence numbers restart from 0.
            self.lost += ahead - 1 if ahead < 2**31 else 0
        self.latest = reading


def _wave_piece(first: int, pressures: tuple[int, ...], seq: int) -> wire.WavePiece:
    return wire.WavePiece(seq, first, pressures)
