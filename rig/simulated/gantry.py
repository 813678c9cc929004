"""A GRBL axis in virtual time, and a robot that swims under it, seen by the gantry's camera.

The axis takes bytes and microseconds and gives bytes, so that a test or a pseudo-terminal can stand
before it. It knows what `rig.gantry.axis` needs: `$$`, `$H`, `$X`, `?`, `!`, Ctrl-X, and G1 in G21
G94.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
_WORD = re.compile(r"([GXF])(-?\d+(?:\.\d*)?)")


class GrblAxis:
    """One axis; `settings` are GRBL's own, in mm and minutes. Powered up locked if it can home."""

    def __init__(self, settings: dict[int, float] | None = None, place: float = 0.0) -> None:
        """`place` [m] is where the carriage stands when power comes."""
        self.settings = {20: 0.0, 22: 1.0, 110: 30000.0, 120: 500.0, 130: 3000.0}
        self.settings |= settings or {}
        self.switch_at: float | None = None
        """Where a limit switch is met [m], if anywhere."""
        self.deaf = False
        """Answers nothing any more, and moves on."""
        self.state = "Alarm" if self.settings[22] else "Idle"
        self._pieces = [(0.0, 1e3 * place, 0.0, 0.0)]
        """From when [s] on: place [mm], speed [mm/s] and acceleration [mm/s^2]; never forgotten."""
        self._rest, self._feed, self._relative = b"", 0.0, False

    def feed(self, data: bytes, now_us: int) -> bytes:
        """What it answers to bytes that arrive now."""
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
        """What it says by itself, by now."""
        if self.state == "Run":
            place = self._motion(now_us)[0]
            if self.switch_at is not None and place >= 1e3 * self.switch_at:
                self._pieces = [p for p in self._pieces if p[0] < now_us / 1e6]
                self._pieces.append((now_us / 1e6, place, 0.0, 0.0))
                self.state = "Alarm"
                return b"" if self.deaf else b"ALARM:1\r\n[MSG:Reset to continue]\r\n"
        if self.state in ("Run", "Hold:1", "Home") and now_us / 1e6 >= self._pieces[-1][0]:
            homed = self.state == "Home"
            self.state = "Hold:0" if self.state == "Hold:1" else "Idle"
            return b"ok\r\n" if homed and not self.deaf else b""
        return b""

    def place(self, now_us) -> np.ndarray:
        """Where it is, was, or will be [m]; any shape of times."""
        t = np.asarray(now_us, float) / 1e6
        table = np.array(self._pieces)
        piece = table[np.searchsorted(table[1:, 0], t, side="right")]
        start, place, speed, slope = np.moveaxis(piece, -1, 0)
        return (place + speed * (t - start) + 0.5 * slope * (t - start) ** 2) / 1e3

    def speed(self, now_us: int) -> float:
        """How fast it goes [m/s]."""
        return self._motion(now_us)[1] / 1e3

    def _motion(self, now_us: int) -> tuple[float, float]:
        """Place [mm] and speed [mm/s]."""
        t = now_us / 1e6
        start, place, speed, slope = next(p for p in reversed(self._pieces) if p[0] <= t)
        return place + (speed + 0.5 * slope * (t - start)) * (t - start), speed + slope * (
            t - start
        )

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
        """From rest to rest over a distance [mm] at a feed [mm/min]."""
        t, place, sign = now_us / 1e6, self._motion(now_us)[0], 1.0 if distance > 0.0 else -1.0
        slope = self.settings[120]
        speed = min(feed / 60.0, sqrt(slope * abs(distance)))
        if distance == 0.0:
            return
        ramp = speed / slope
        cruise = abs(distance) / speed - ramp
        way = sign * speed * ramp / 2.0
        self._pieces += [
            (t, place, 0.0, sign * slope),
            (t + ramp, place + way, sign * speed, 0.0),
            (t + ramp + cruise, place + distance - way, sign * speed, -sign * slope),
            (t + 2.0 * ramp + cruise, place + distance, 0.0, 0.0),
        ]
        self.state = "Run"

    def _hold(self, now_us: int) -> None:
        if self.state not in ("Run", "Idle"):
            return
        t, (place, speed) = now_us / 1e6, self._motion(now_us)
        slope = -self.settings[120] if speed > 0 else self.settings[120]
        rest = abs(speed) / self.settings[120]
        self._pieces = [p for p in self._pieces if p[0] < t]
        self._pieces += [
            (t, place, speed, slope if speed else 0.0),
            (t + rest, place + 0.5 * speed * rest, 0.0, 0.0),
        ]
        self.state = "Hold:1" if speed else "Hold:0"

    def _reset(self, now_us: int) -> bytes:
        out = b""
        if self.state in ("Run", "Hold:1", "Home"):
            out = b"ALARM:6\r\n" if self.state == "Home" else b"ALARM:3\r\n"
            place = self._motion(now_us)[0]
            self._pieces = [p for p in self._pieces if p[0] < now_us / 1e6]
            self._pieces.append((now_us / 1e6, place, 0.0, 0.0))
            self.state = "Alarm"
        elif self.state == "Hold:0":
            self.state = "Idle"
        self._rest, self._feed, self._relative = b"", 0.0, False
        return out + BANNER

    def _report(self, now_us: int) -> bytes:
        place, speed = self._motion(now_us)
        report = f"<{self.state}|MPos:{place:.3f},0.000,0.000|FS:{60.0 * abs(speed):.0f},0>\r\n"
        return report.encode()


@dataclass(frozen=True)
class Swimmer:
    """A robot that starts from rest when filming begins.

    Its forward speed is U (1 - exp(-t / start_up)) cos(turn t) plus the stride's ripple; U and turn
    differ from run to run.
    """

    speed: float
    """U in the mean [m/s]."""
    start_up: float = 0.3
    """[s]."""
    ripple: float = 0.004
    """Amplitude of the place's ripple [m]."""
    stride: float = 0.4
    """[s]."""
    turn: float = 0.0
    """Standard deviation of the drift of its heading [rad/s]."""
    scatter: float = 0.0
    """Standard deviation of U [m/s]."""

    def swim(self, t, random: np.random.Generator) -> np.ndarray:
        """Places [m] at times t [s] of one run."""
        speed = self.speed + self.scatter * random.normal()
        turn, phase = self.turn * random.normal() + 1e-12, 2.0 * np.pi * random.random()
        steady = np.expm1(1j * turn * t) / (1j * turn)
        decay = 1j * turn - 1.0 / self.start_up
        transient = np.expm1(decay * t) / decay
        ripple = np.sin(2.0 * np.pi * t / self.stride + phase) - np.sin(phase)
        return speed * np.real(steady - transient) + self.ripple * ripple


@dataclass
class SimulatedFilm:
    """The camera on a `GrblAxis` above a `Swimmer`: the `film` of
    `rig.gantry.axis.gantry_measurement`."""

    axis: GrblAxis
    swimmer: Swimmer
    clock_us: Callable[[], float]
    """Gives the virtual time [us]."""
    scale: float = 0.5e-3
    """Metres of a pixel."""
    noise: float = 0.2
    """Standard deviation of the marker's place [px]."""
    view: float = 0.5
    """Half of what the camera sees along the travel [m]."""
    rate: float = 60.0
    """Frames a second."""
    blinks: float = 0.01
    """Share of single frames that lose the marker."""
    blind: float = 0.0
    """Share of runs that lose it altogether."""
    seed: int = 0

    def __post_init__(self):
        self.random = np.random.default_rng(self.seed)

    def __call__(self, move) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and places [m] of the marker, NaN where lost, while `move()` is made."""
        start = self.clock_us()
        move()
        t = np.arange(0.0, (self.clock_us() - start) / 1e6, 1.0 / self.rate)
        camera = self.axis.place(start + 1e6 * t) - self.axis.place(start)
        x = self.swimmer.swim(t, self.random) - camera
        x += self.scale * self.noise * self.random.normal(size=len(t))
        lost = (np.abs(x) > self.view) | (self.random.random(len(t)) < self.blinks)
        if self.random.random() < self.blind:
            lost[:] = True
        return start / 1e6 + t, np.where(lost, np.nan, x)
