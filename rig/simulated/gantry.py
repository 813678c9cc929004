"""Simulates a GRBL axis in virtual time, and a robot that swims below the gantry's camera.

The axis receives bytes and the time in microseconds, and returns bytes. It can therefore run in a
test or on a pseudo-terminal. The axis supports the commands of `rig.gantry.axis`: `$$`, `$H`, `$X`,
`?`, `!`, Ctrl-X, and G1 in G21 G94.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
_WORD = re.compile(r"([GXF])(-?\d+(?:\.\d*)?)")


class GrblAxis:
    """One axis with GRBL's `settings` (mm, minutes). With homing on ($22=1), it starts locked."""

    def __init__(self, settings: dict[int, float] | None = None, position: float = 0.0) -> None:
        """`position` [m] is the carriage's position at power-up."""
        self.settings = {20: 0.0, 22: 1.0, 110: 30000.0, 120: 500.0, 130: 3000.0}
        self.settings |= settings or {}
        self.switch_at: float | None = None
        """Position of a limit switch [m], or None."""
        self.deaf = False
        """If True, the axis no longer answers, but continues to move."""
        self.state = "Alarm" if self.settings[22] else "Idle"
        self._pieces = [(0.0, 1e3 * position, 0.0, 0.0)]
        """Pieces of the motion: start [s], position [mm], speed [mm/s], acceleration [mm/s^2]."""
        self._rest, self._feed, self._relative = b"", 0.0, False

    def feed(self, data: bytes, now_us: int) -> bytes:
        """Takes bytes from the host and returns the answer."""
        out = self.tick(now_us)
        for byte in data:
            char = bytes([byte])
            if self.deaf:
                continue
            if char == b"?":
                out += b"" if self.state == "Home" else self._report(now_us)
            elif char == b"!":
                self._hold(now_us)
            elif char == b"\x18":
                out += self._reset(now_us)
            elif char in b"\r\n":
                line, self._rest = self._rest.decode("ascii", "replace").strip(), b""
                out += self._answer(line, now_us) if line else b""
            else:
                self._rest += char
        return out

    def tick(self, now_us: int) -> bytes:
        """Advances to `now_us`, and returns the messages that GRBL sends without a request."""
        if self.state == "Run":
            position = self._motion(now_us)[0]
            if self.switch_at is not None and position >= 1e3 * self.switch_at:
                self._halt_at(position, now_us)
                self.state = "Alarm"
                return b"" if self.deaf else b"ALARM:1\r\n[MSG:Reset to continue]\r\n"
        if self.state in ("Run", "Hold:1", "Home") and now_us / 1e6 >= self._pieces[-1][0]:
            homed = self.state == "Home"
            self.state = "Hold:0" if self.state == "Hold:1" else "Idle"
            return b"ok\r\n" if homed and not self.deaf else b""
        return b""

    def position(self, now_us) -> np.ndarray:
        """Returns past, present or planned positions [m] at times `now_us` [us] of any shape."""
        t = np.asarray(now_us, float) / 1e6
        table = np.array(self._pieces)
        piece = table[np.searchsorted(table[1:, 0], t, side="right")]
        start, position, speed, slope = np.moveaxis(piece, -1, 0)
        return (position + speed * (t - start) + 0.5 * slope * (t - start) ** 2) / 1e3

    def speed(self, now_us: int) -> float:
        """Returns the speed [m/s]."""
        return self._motion(now_us)[1] / 1e3

    def _motion(self, now_us: int) -> tuple[float, float]:
        """Returns position [mm] and speed [mm/s]."""
        start, position, speed, slope = next(
            p for p in reversed(self._pieces) if p[0] <= now_us / 1e6
        )
        t = now_us / 1e6 - start
        return position + (speed + 0.5 * slope * t) * t, speed + slope * t

    def _halt_at(self, position: float, now_us: int) -> None:
        self._pieces = [p for p in self._pieces if p[0] < now_us / 1e6]
        self._pieces.append((now_us / 1e6, position, 0.0, 0.0))

    def _answer(self, line: str, now_us: int) -> bytes:
        if line == "$$":
            table = "".join(f"${n}={value:.3f}\r\n" for n, value in self.settings.items())
            return table.encode() + b"ok\r\n"
        if line == "$X":
            self.state = "Idle" if self.state == "Alarm" else self.state
            return b"[MSG:Caution: Unlocked]\r\nok\r\n"
        if line == "$H":
            if not self.settings[22]:
                return b"error:5\r\n"
            self._go(-self._motion(now_us)[0], 1500.0, now_us)
            self.state = "Home"
            return self.tick(now_us)
        if line.startswith("$"):
            return b"error:3\r\n"
        if self.state == "Alarm":
            return b"error:9\r\n"
        return self._block(line, now_us)

    def _block(self, line: str, now_us: int) -> bytes:
        words = _WORD.findall(line)
        if "".join(letter + number for letter, number in words) != line.replace(" ", ""):
            return b"error:20\r\n"
        distance = None
        for letter, number in words:
            if letter == "F":
                self._feed = float(number)
            elif letter == "X":
                distance = float(number)
            elif number in ("90", "91"):
                self._relative = number == "91"
            elif number not in ("1", "21", "94"):
                return b"error:20\r\n"
        if distance is None:
            return b"ok\r\n"
        if self._feed <= 0.0:
            return b"error:22\r\n"
        if self.state != "Idle":
            return b"error:8\r\n"
        here = self._motion(now_us)[0]
        distance -= 0.0 if self._relative else here
        if self.settings[20] and not 0.0 <= here + distance <= self.settings[130]:
            self.state = "Alarm"
            return b"ALARM:2\r\n[MSG:Reset to continue]\r\n"
        self._go(distance, min(self._feed, self.settings[110]), now_us)
        return b"ok\r\n"

    def _go(self, distance: float, feed: float, now_us: int) -> None:
        """Moves from rest to rest over a distance [mm] at a feed [mm/min]."""
        t, position, sign = now_us / 1e6, self._motion(now_us)[0], 1.0 if distance > 0.0 else -1.0
        slope = self.settings[120]
        speed = min(feed / 60.0, sqrt(slope * abs(distance)))
        if distance == 0.0:
            return
        ramp = speed / slope
        cruise = abs(distance) / speed - ramp
        way = sign * speed * ramp / 2.0
        self._pieces += [
            (t, position, 0.0, sign * slope),
            (t + ramp, position + way, sign * speed, 0.0),
            (t + ramp + cruise, position + distance - way, sign * speed, -sign * slope),
            (t + 2.0 * ramp + cruise, position + distance, 0.0, 0.0),
        ]
        self.state = "Run"

    def _hold(self, now_us: int) -> None:
        if self.state not in ("Run", "Idle"):
            return
        t, (position, speed) = now_us / 1e6, self._motion(now_us)
        slope = -self.settings[120] if speed > 0 else self.settings[120]
        rest = abs(speed) / self.settings[120]
        self._pieces = [p for p in self._pieces if p[0] < t]
        self._pieces += [
            (t, position, speed, slope if speed else 0.0),
            (t + rest, position + 0.5 * speed * rest, 0.0, 0.0),
        ]
        self.state = "Hold:1" if speed else "Hold:0"

    def _reset(self, now_us: int) -> bytes:
        out = b""
        if self.state in ("Run", "Hold:1", "Home"):
            out = b"ALARM:6\r\n" if self.state == "Home" else b"ALARM:3\r\n"
            self._halt_at(self._motion(now_us)[0], now_us)
            self.state = "Alarm"
        elif self.state == "Hold:0":
            self.state = "Idle"
        self._rest, self._feed, self._relative = b"", 0.0, False
        return out + BANNER

    def _report(self, now_us: int) -> bytes:
        position, speed = self._motion(now_us)
        report = f"<{self.state}|MPos:{position:.3f},0.000,0.000|FS:{60.0 * abs(speed):.0f},0>\r\n"
        return report.encode()


@dataclass(frozen=True)
class Swimmer:
    """A robot that starts from rest at the start of a film.

    The forward speed is U (1 - exp(-t / start_up)) cos(turn t) plus a ripple with the period of a
    stride. The final speed U and the turn rate differ between runs.
    """

    speed: float
    """Mean of U [m/s]."""
    start_up: float = 0.3
    """Time constant of the start [s]."""
    ripple: float = 0.004
    """Amplitude of the position's ripple [m]."""
    stride: float = 0.4
    """Period of a stride [s]."""
    turn: float = 0.0
    """Standard deviation of the turn rate [rad/s]."""
    scatter: float = 0.0
    """Standard deviation of U between runs [m/s]."""

    def swim(self, t, random: np.random.Generator) -> np.ndarray:
        """Returns the positions [m] at times t [s] of one run."""
        speed = self.speed + self.scatter * random.normal()
        turn, phase = self.turn * random.normal() + 1e-12, 2.0 * np.pi * random.random()
        steady = np.expm1(1j * turn * t) / (1j * turn)
        decay = 1j * turn - 1.0 / self.start_up
        transient = np.expm1(decay * t) / decay
        ripple = np.sin(2.0 * np.pi * t / self.stride + phase) - np.sin(phase)
        return speed * np.real(steady - transient) + self.ripple * ripple


@dataclass
class SimulatedFilm:
    """Simulates a camera that a `GrblAxis` moves above a `Swimmer`."""

    axis: GrblAxis
    swimmer: Swimmer
    clock_us: Callable[[], float]
    """Returns the virtual time [us]."""
    scale: float = 0.5e-3
    """Size of a pixel [m]."""
    noise: float = 0.2
    """Standard deviation of the noise in the marker's position [px]."""
    view: float = 0.5
    """Half of the field of view along the travel [m]."""
    rate: float = 60.0
    """Frame rate [1/s]."""
    blinks: float = 0.01
    """Probability that the marker is lost in a frame."""
    blind: float = 0.0
    """Probability that the marker is lost in a whole run."""
    seed: int = 0

    def __post_init__(self):
        self.random = np.random.default_rng(self.seed)

    def __call__(self, move) -> tuple[np.ndarray, np.ndarray]:
        """Calls `move()`. Returns times [s] and marker positions [m], NaN for a lost marker."""
        start = self.clock_us()
        move()
        t = np.arange(0.0, (self.clock_us() - start) / 1e6, 1.0 / self.rate)
        camera = self.axis.position(start + 1e6 * t) - self.axis.position(start)
        x = self.swimmer.swim(t, self.random) - camera
        x += self.scale * self.noise * self.random.normal(size=len(t))
        lost = (np.abs(x) > self.view) | (self.random.random(len(t)) < self.blinks)
        if self.random.random() < self.blind:
            lost[:] = True
        return start / 1e6 + t, np.where(lost, np.nan, x)
