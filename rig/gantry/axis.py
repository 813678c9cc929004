"""Drives the gantry's axis with a GRBL 1.1 controller, and measures runs above the robot.

GRBL computes the trapezoidal speed from its acceleration ($120) and from the feed (speed) of each
command. If this computer fails, GRBL still completes the move. Limits are checked before a move.
Source: https://github.com/gnea/grbl, doc/markdown (commands, interface, settings).
"""

import re
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from rig.errors import RigError
from rig.gantry.profile import MotionProfile
from rig.gantry.speed_search import GantryPass, fit_drift
from rig.manifold.serial_port import Readable, read_piece

HOLD, RESET, STATUS = b"!", b"\x18", b"?"
PAUSE = 0.05
"""Longest wait of a read from the port [s], which separates the status requests in a move."""
ARRIVED = 0.5e-3
"""Largest distance between the axis and the target at the end of a move [m]."""
ALARMS = {
    1: "the axis hit a limit switch; its position is lost",
    2: "the move leaves the soft limits ($130)",
    3: "the axis was reset while moving; its position is lost",
    4: "the probe was in the wrong state before the move",
    5: "the probe made no contact",
    6: "a reset interrupted homing",
    7: "the door interrupted homing",
    8: "homing did not clear the limit switch; increase $27 or check the wires",
    9: "homing did not find the limit switch; check the switch, or increase $130",
}
ERRORS = {
    1: "a letter is missing",
    2: "a number is invalid",
    3: "unknown $ command",
    5: "homing is off ($22=0)",
    8: "the command needs an idle axis",
    9: "the axis is locked; home or unlock it first",
    15: "the move leaves the soft limits",
    20: "unknown G-code",
    22: "the feed is missing",
}


class GrblPort(Readable, Protocol):
    """The part of `serial.Serial` that `GantryAxis` needs. GRBL uses 115200 baud."""

    timeout: float | None

    def write(self, data: bytes, /) -> int | None: ...


class GantryLimits(NamedTuple):
    """The lab's limits of the gantry. Positions are measured from the origin of `GantryAxis`."""

    low: float
    """Lowest position [m]."""
    high: float
    """Highest position [m]."""
    speed: float
    """Highest speed [m/s]."""
    acceleration: float
    """Highest allowed acceleration in GRBL's settings [m/s^2]."""


class GantryAxis:
    """Context manager of the X axis of a GRBL controller on an open port.

    On entry, the driver resets GRBL and reads GRBL's settings. If GRBL is locked, the axis moves to
    the home position, which is the origin. With `homed=False` (no limit switches), the axis is only
    unlocked, and the position on entry is the origin. At the end or after an error, the axis slows
    down (feed hold) and GRBL is reset. Raises `RigError` for GRBL's errors and for a lost port.
    """

    def __init__(
        self,
        port: GrblPort,
        limits: GantryLimits,
        homed: bool = True,
        clock: Callable[[], float] = time.monotonic,
        patience: float = 60.0,
    ) -> None:
        """`clock` returns the host's time [s]; `patience` is the longest duration of homing [s]."""
        self.limits, self.started = limits, float("nan")
        """`started` is the host's time [s] at the start of the last move."""
        self._port, self._homed, self._clock, self._patience = port, homed, clock, patience
        self._rest, self._settings, self._origin = b"", dict[int, float](), 0.0

    def __enter__(self) -> "GantryAxis":
        try:
            self._connect()
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
        """Slows the axis down to rest and then resets GRBL, also if GRBL does not answer."""
        deadline = self._clock() + 1.0 + self.limits.speed / self._acceleration()
        try:
            self._send(HOLD)
            while self._clock() < deadline:
                if self._status()[0] in ("Hold:0", "Alarm", "Idle"):
                    break
        finally:
            self._send(RESET)

    def profile(self, travel: float, speed: float) -> MotionProfile:
        """Returns the profile of a move over `travel` [m] at `speed` [m/s], with GRBL's $120."""
        fastest = min(self.limits.speed, self._settings[110] / 60e3)
        if not 0.0 < speed <= fastest:
            advice = "the limit is the lower of the lab's limit and GRBL's $110"
            raise RigError.value(
                "gantry speed", f"{speed:g} m/s", f"above 0 to {fastest:g} m/s", advice
            )
        return MotionProfile(travel, speed, self._acceleration())

    def position(self) -> float:
        """Returns the axis' position [m]."""
        return self._status()[1] - self._origin

    def move(self, profile: MotionProfile, back: bool = False) -> float:
        """Moves the axis, waits for the end of the move, and returns the host's start time [s]."""
        profile = self.profile(profile.travel, profile.speed)
        start, travel = self.position(), -profile.travel if back else profile.travel
        if not self.limits.low - 1e-6 <= start + travel <= self.limits.high + 1e-6:
            raise RigError.value(
                "gantry move",
                f"{start:.4f} m to {start + travel:.4f} m",
                f"{self.limits.low:g} to {self.limits.high:g} m",
                "shorten the travel or start at another position",
            )
        self._request(f"G21 G91 G94 G1 X{1e3 * travel:.3f} F{60e3 * profile.speed:.3f}")
        self.started = self._clock()
        patience = 1.1 * profile.duration + 1.0
        while self._clock() < self.started + patience:
            state, now = self._status()
            if state == "Idle" and abs(now - self._origin - start - travel) < ARRIVED:
                return self.started
            self._rest += self._receive()
        raise RigError(
            f"gantry: the axis has not arrived {patience:.1f} s after the start of a move of "
            f"{profile.duration:.1f} s (GRBL reports {state}); check whether the axis is blocked"
        )

    def _connect(self) -> None:
        try:
            self._port.timeout = PAUSE
        except OSError as error:
            raise _port_lost(error) from None
        self._send(RESET)
        self._until(lambda line: line.startswith("Grbl "), 3.0)
        for line in self._request("$$"):
            if setting := re.match(r"\$([0-9]+)=([0-9]+\.?[0-9]*)", line):
                self._settings[int(setting[1])] = float(setting[2])
        missing = {22, 110, 120} - self._settings.keys()
        if missing:
            raise RigError(f"gantry: GRBL does not report ${min(missing)}; GRBL 1.1 is needed")
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
                "gantry: homing is off ($22=0), so the position is unknown; install limit switches "
                "and set $22=1, or use homed=False if the axis is at its start"
            )
        if locked:
            self._request("$H" if self._homed else "$X", self._patience)
        self._origin = 0.0 if self._homed else self._status()[1]

    def _acceleration(self) -> float:
        """Returns GRBL's acceleration [m/s^2], or the lab's limit before the settings are read."""
        return self._settings.get(120, 1e3 * self.limits.acceleration) / 1e3

    def _status(self) -> tuple[str, float]:
        """Returns the state, and the position in GRBL's coordinates [m]."""
        self._send(STATUS)
        report = self._until(lambda line: line.startswith("<") and line.endswith(">"), 1.0)[-1]
        found = re.match(r"<([A-Za-z:0-9]+)\|MPos:(-?[0-9]+\.[0-9]+),", report)
        if not found:
            raise RigError(f"gantry: GRBL's report {report!r} has no MPos; set $10=1")
        return found[1], float(found[2]) / 1e3

    def _request(self, line: str, patience: float = 1.0) -> list[str]:
        """Sends a line and returns the answer's lines before `ok`."""
        self._send(line.encode() + b"\n")
        return self._until(lambda answer: answer == "ok", patience, line)[:-1]

    def _until(self, wanted: Callable[[str], bool], patience: float, asked: str = "") -> list[str]:
        """Returns the lines up to the first wanted line. Raises `RigError` for GRBL's errors."""
        deadline, lines, late = self._clock() + patience, list[str](), False
        while not late:
            late = self._clock() >= deadline  # bytes that arrived before the deadline still count
            self._rest += self._receive()
            while b"\n" in self._rest:
                line, self._rest = self._rest.split(b"\n", 1)
                lines.append(line.decode("ascii", "replace").strip())
                _raise_refusal(lines[-1], asked)
                if wanted(lines[-1]):
                    return lines
        raise RigError(
            f"gantry: no answer{f' to {asked}' if asked else ''} within {patience:g} s; check that "
            "GRBL 1.1 is on this port at 115200 baud"
        )

    def _send(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except OSError as error:
            raise _port_lost(error) from None

    def _receive(self) -> bytes:
        try:
            return read_piece(self._port)
        except OSError as error:
            raise _port_lost(error) from None


def _raise_refusal(text: str, asked: str) -> None:
    for prefix, meanings in (("ALARM:", ALARMS), ("error:", ERRORS)):
        if text.startswith(prefix):
            number = text.removeprefix(prefix)
            code = int(number) if number.isdigit() else 0
            meaning = meanings.get(code, "see GRBL's table of codes")
            raise RigError(f"gantry: {f'{asked}: ' if asked else ''}GRBL reports {text}: {meaning}")


def _port_lost(error: OSError) -> RigError:
    return RigError(
        f"gantry: the port is gone ({error}); the axis still completes the last move; use the "
        "emergency stop if necessary, then plug in the cable and home the axis"
    )


def gantry_measurement(
    axis: GantryAxis,
    travel: float,
    film: Callable[[Callable[[], float]], tuple[np.ndarray, np.ndarray]],
    settle: float,
    stride: float,
) -> Callable[[float], GantryPass | None]:
    """Returns the argument `measure` of `find_swimming_speed`: a run over `travel` [m], and back.

    `film` starts robot and camera, and then calls its argument, a function that moves the gantry.
    `film` returns the marker's track: times on the axis' clock [s], and positions ahead of the
    camera [m], NaN if the marker is lost. Frames of the first `settle` [s] are ignored. `stride` is
    the period of a stride [s].
    """

    def measure(speed: float) -> GantryPass | None:
        profile = axis.profile(travel, speed)
        t, x = film(lambda: axis.move(profile))
        move_start = axis.started
        axis.move(profile, back=True)
        start = move_start + max(profile.ramp, settle)
        return fit_drift(t, x, start, move_start + profile.ramp + profile.cruise, stride)

    return measure
