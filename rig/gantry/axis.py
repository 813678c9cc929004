"""The gantry's axis, driven in G-code as GRBL 1.1 speaks it, and its passes over the robot.

GRBL shapes the trapezoid itself, from its own acceleration ($120) and the feed of each line. A pass
ends by itself, within the limits checked before it was sent, if this computer dies.
Source: https://github.com/gnea/grbl, doc/markdown (commands, interface, settings).
"""

import re
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from rig.errors import RigError
from rig.gantry.profile import Profile
from rig.gantry.speed_search import GantryPass, fit_drift
from rig.manifold.serial_port import Readable, read_piece

HOLD, RESET, STATUS = b"!", b"\x18", b"?"
PAUSE = 0.05
"""Between two questions for the status [s]; GRBL wants no more than some ten a second."""
ARRIVED = 0.5e-3
"""How near its target a move ends [m]."""
ALARMS = {
    1: "it ran into a limit switch; its position is lost",
    2: "the move leaves its soft limits ($130)",
    3: "it was reset while moving; its position is lost",
    4: "the probe was not as it should be before the move",
    5: "the probe met nothing",
    6: "homing was cut short by a reset",
    7: "homing was cut short by the door",
    8: "homing did not clear the limit switch; raise $27 or see the wires",
    9: "homing did not find the limit switch; see the switch, or raise $130",
}
ERRORS = {
    1: "a letter was missing",
    2: "a number was malformed",
    3: "it does not know the $ command",
    5: "homing is off ($22=0)",
    8: "that needs it idle",
    9: "it is locked; home or unlock it first",
    15: "the move leaves its soft limits",
    20: "it does not know the G-code",
    22: "no feed was given",
}


class Port(Readable, Protocol):
    """What is used of `serial.Serial`; GRBL runs at 115200 baud."""

    timeout: float | None

    def write(self, data: bytes, /) -> int | None: ...


class GantryLimits(NamedTuple):
    """What a lab allows its gantry. Places count from home, or from where the axis was on entry."""

    low: float
    """Lowest place [m]."""
    high: float
    """Highest place [m]."""
    speed: float
    """Highest speed [m/s]."""
    acceleration: float
    """Highest acceleration [m/s^2] that GRBL may be set to."""


class GantryAxis:
    """The X axis of a GRBL on an open port; a context that stops it on every way out.

    On entry GRBL is reset and its settings are read. If its position is not known, it is homed;
    with `homed=False` (no limit switches) its place on entry counts as 0 instead, and it is
    unlocked. On the way out the axis is slowed down (feed hold), then reset. Raises `RigError` for
    whatever GRBL refuses, for an alarm, and for a port that is gone.
    """

    def __init__(
        self,
        port: Port,
        limits: GantryLimits,
        homed: bool = True,
        clock: Callable[[], float] = time.monotonic,
        patience: float = 60.0,
    ) -> None:
        """`clock` gives the host's time [s]; `patience` is how long homing may take [s]."""
        self.limits, self.started = limits, float("nan")
        """`started` is the host's time [s] at which the last move began."""
        self._port, self._homed, self._clock, self._patience = port, homed, clock, patience
        self._rest, self._settings, self._origin = b"", dict[int, float](), 0.0

    def __enter__(self) -> "GantryAxis":
        try:
            self._begin()
        except BaseException as error:
            self.__exit__(type(error))
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_) -> None:
        try:
            self.stop()
        except RigError:
            if kind is None or not issubclass(kind, RigError):
                raise

    def stop(self) -> None:
        """Slow down to rest and drop what is left of the move; without an answer, reset anyway."""
        deadline = self._clock() + 1.0 + self.limits.speed / self._acceleration()
        try:
            self._send(HOLD)
            while self._clock() < deadline:
                if self._status()[0] in ("Hold:0", "Alarm", "Idle"):
                    break
        finally:
            self._send(RESET)

    def profile(self, travel: float, speed: float) -> Profile:
        """The move over `travel` [m] at `speed` [m/s], as GRBL's acceleration makes it."""
        fastest = min(self.limits.speed, self._settings[110] / 60e3)
        if not 0.0 < speed <= fastest:
            advice = "the limit is the lower of the lab's and GRBL's $110"
            raise RigError.value(
                "gantry speed", f"{speed:g} m/s", f"above 0 to {fastest:g} m/s", advice
            )
        return Profile(travel, speed, self._acceleration())

    def place(self) -> float:
        """Where the axis is [m]."""
        return self._status()[1] - self._origin

    def run(self, profile: Profile, back: bool = False) -> float:
        """Make the move, or the same backwards, and wait for its end; the time [s] it began."""
        profile = self.profile(profile.travel, profile.speed)
        place, travel = self.place(), -profile.travel if back else profile.travel
        if not self.limits.low - 1e-6 <= place + travel <= self.limits.high + 1e-6:
            raise RigError.value(
                "gantry move",
                f"{place:.4f} m to {place + travel:.4f} m",
                f"{self.limits.low:g} to {self.limits.high:g} m",
                "shorten the travel or start elsewhere",
            )
        self._ask(f"G21 G91 G94 G1 X{1e3 * travel:.3f} F{60e3 * profile.speed:.3f}")
        self.started = self._clock()
        patience = 1.1 * profile.duration + 1.0
        while self._clock() < self.started + patience:
            state, now = self._status()
            if state == "Idle" and abs(now - self._origin - place - travel) < ARRIVED:
                return self.started
            self._rest += self._receive()
        raise RigError(
            f"gantry: has not arrived {patience:.1f} s after a move of {profile.duration:.1f} s "
            f"began (GRBL says {state}); see whether it is held"
        )

    def _begin(self) -> None:
        try:
            self._port.timeout = PAUSE
        except OSError as error:
            raise _gone(error) from None
        self._send(RESET)
        self._until(lambda line: line.startswith("Grbl "), 3.0)
        for line in self._ask("$$"):
            if setting := re.match(r"\$([0-9]+)=([0-9]+\.?[0-9]*)", line):
                self._settings[int(setting[1])] = float(setting[2])
        missing = {22, 110, 120} - self._settings.keys()
        if missing:
            raise RigError(f"gantry: GRBL does not tell ${min(missing)}; GRBL 1.1 is needed")
        if self._acceleration() > self.limits.acceleration * (1.0 + 1e-9):
            raise RigError.value(
                "gantry acceleration",
                f"{self._acceleration():g} m/s^2 (GRBL's $120)",
                f"up to {self.limits.acceleration:g} m/s^2",
                f"set $120={1e3 * self.limits.acceleration:g}",
            )
        locked = self._status()[0] == "Alarm"
        if self._homed and not self._settings[22]:
            raise RigError(
                "gantry: homing is off ($22=0), so that its place is not known; fit switches and "
                "set $22=1, or say homed=False where it stands at its start"
            )
        if locked:
            self._ask("$H" if self._homed else "$X", self._patience)
        self._origin = 0.0 if self._homed else self._status()[1]

    def _acceleration(self) -> float:
        """GRBL's [m/s^2]; the lab's limit until it has been read."""
        return self._settings.get(120, 1e3 * self.limits.acceleration) / 1e3

    def _status(self) -> tuple[str, float]:
        """State, and place in GRBL's own coordinates [m]."""
        self._send(STATUS)
        report = self._until(lambda line: line.startswith("<") and line.endswith(">"), 1.0)[-1]
        found = re.match(r"<([A-Za-z:0-9]+)\|MPos:(-?[0-9]+\.[0-9]+),", report)
        if not found:
            raise RigError(f"gantry: GRBL's report {report!r} has no MPos; set $10=1")
        return found[1], float(found[2]) / 1e3

    def _ask(self, line: str, patience: float = 1.0) -> list[str]:
        """The lines that answer a line, before its `ok`."""
        self._send(line.encode() + b"\n")
        return self._until(lambda answer: answer == "ok", patience, line)[:-1]

    def _until(self, wanted: Callable[[str], bool], patience: float, asked: str = "") -> list[str]:
        """Lines up to the first that is wanted; raises for an error or alarm among them."""
        deadline, lines, late = self._clock() + patience, list[str](), False
        while not late:
            late = self._clock() >= deadline  # what came meanwhile still counts
            self._rest += self._receive()
            while b"\n" in self._rest:
                line, self._rest = self._rest.split(b"\n", 1)
                lines.append(line.decode("ascii", "replace").strip())
                _raise_refusal(lines[-1], asked)
                if wanted(lines[-1]):
                    return lines
        raise RigError(
            f"gantry: no answer{f' to {asked}' if asked else ''} within {patience:g} s; see that "
            "GRBL 1.1 is on this port at 115200 baud"
        )

    def _send(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except OSError as error:
            raise _gone(error) from None

    def _receive(self) -> bytes:
        try:
            return read_piece(self._port)
        except OSError as error:
            raise _gone(error) from None


def _raise_refusal(text: str, asked: str) -> None:
    for word, meanings in (("ALARM:", ALARMS), ("error:", ERRORS)):
        if text.startswith(word):
            number = text.removeprefix(word)
            code = int(number) if number.isdigit() else 0
            meaning = meanings.get(code, "see GRBL's table of codes")
            raise RigError(f"gantry: {f'{asked}: ' if asked else ''}GRBL says {text}: {meaning}")


def _gone(error: OSError) -> RigError:
    return RigError(
        f"gantry: the port is gone ({error}); it ends its last move by itself; use its emergency "
        "stop if that must not be, then plug it in again and home it"
    )


def gantry_measurement(
    axis: GantryAxis,
    travel: float,
    film: Callable[[Callable[[], float]], tuple[np.ndarray, np.ndarray]],
    settle: float,
    stride: float,
) -> Callable[[float], GantryPass | None]:
    """Return the `measure` of `find_swimming_speed`: one pass over `travel` [m], and back.

    `film` starts robot and camera, calls its argument, which makes the pass, and returns the track
    of the marker: times [s, on the axis' clock] and positions [m, ahead of the camera, NaN where
    the marker is lost]. The first `settle` seconds are ignored; `stride` is a stride's period [s].
    """

    def measure(speed: float) -> GantryPass | None:
        profile = axis.profile(travel, speed)
        t, x = film(lambda: axis.run(profile))
        began = axis.started
        axis.run(profile, back=True)
        start = began + max(profile.ramp, settle)
        return fit_drift(t, x, start, began + profile.ramp + profile.cruise, stride)

    return measure
